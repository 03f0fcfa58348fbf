"""Principal images under splines (`rbf`) beside what else takes as many bytes: unseen pairs of real and of reference data.

A fifth of the pairs is held out (of one view: of the lights), textures are of 8 bits, the surface is flat. Seconds are of the
processor, one thread, the fit alone.

    OMP_NUM_THREADS=1 python scripts/bench/splines.py [--only wall]
"""

from __future__ import annotations

import argparse
import time
from typing import Any

from measure import SHARED, save

import torchmat as tm
from torchmat.report.comparison import parse_model

DATA = {
    "real wallpaper": "real/ubo2003_wallpaper", "lion's head": "real/loewenkopf_rti",
    **{name: f"reference/{name}.zip" for name in ("stones", "leather", "wallpaper", "disk")}, "weave (8-bit, clipped)": "reference/weave_ubo2003.zip",
}
MODELS = (
    "rbf:components=9", "rbf", "rbf:components=27", "rbf:space=linear", "ptm", "hsh", "hsh:terms=16", "phong_srf:residual=half_light",
    "pca:components=6", "local_pca",
)


def run(name: str, btf: tm.Btf, text: str) -> dict[str, Any]:
    """Return the errors of one model, its bytes and the seconds of its fit."""
    model, options = parse_model(text)
    asked = {"geometry": "flat", "holdout": 0.2, "seed": 0, "storage": "png8", "progress": False, **options}
    start = time.process_time()
    tm.fit(btf, model, measure="none", **asked)
    seconds = time.process_time() - start
    report = tm.fit(btf, model, **asked).report
    found = {key: report[key] for key in ("bytes_per_texel", "shared_bytes")}
    for part in ("train", "held_out", "held_out_after_export"):
        found |= {f"{part}_{figure}": report[part][figure] for figure in ("relative_error", "psnr_db")}
    return {"data": name, "model": text, "processor_seconds": seconds, **found}


def main() -> None:
    """Run all rows and print them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", help="data whose name has this in it")
    only = parser.parse_args().only
    rows = []
    for name, place in DATA.items():
        path = SHARED / place
        if not path.exists() or (only and only not in name):
            continue
        btf = tm.load_btf(path, progress=False)
        for text in MODELS:
            row = run(name, btf, text)
            rows.append(row)
            print(
                f"{name:22s} {text:30s} {row['bytes_per_texel']:5.0f} B {row['shared_bytes']:7.0f} {row['processor_seconds']:6.2f} s  "
                f"seen {row['train_psnr_db']:5.2f} dB  unseen {row['held_out_after_export_psnr_db']:5.2f} dB "
                f"{row['held_out_after_export_relative_error']:.4f}", flush=True,
            )
            if not only:
                save("splines", rows)


if __name__ == "__main__":
    main()
