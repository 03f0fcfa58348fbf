"""A refit in a process of its own, which says how far it is line by line and can be ended at any time.

``python -m torchmat.studio.refitting FOLDER BTF OUT EFFORT MAP ...`` fits these maps of a material folder anew, keeps the
others, and writes the material to OUT. Each line that it prints is a JSON table: `what` and `share`, and at last `report`.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

from torchmat.errors import RangeError, TorchmatError, check_option, message

_BETWEEN = 0.2  # seconds between two lines


def refitted(folder: str, btf: str, out: str, effort: float, maps: list[str]) -> dict[str, Any]:
    """Fit some maps of a material folder anew, as `torchmat refit` with all others kept, and write it to `out`."""
    from torchmat.fitting.refit import refit
    from torchmat.material_io import load_material, save_material
    from torchmat.studio.measured import Measured

    material, measured = load_material(folder), Measured(btf, Path(folder))
    names = [spec.name for spec in material.specs()]
    for name in maps:
        check_option("refit", "a map", name, names)
    report = measured.report
    split = {name: report[name] for name in ("holdout", "holdout_by", "seed") if name in report}
    found = refit(measured.btf, material, [name for name in names if name not in maps], effort=effort, **split)
    if not found.report["improved"]:
        step = "Let more maps follow, or give more effort."
        fact = f"{found.report['train_after']['psnr_db']:.2f} dB before and after"
        raise RangeError(message("refit", "the new maps", "be better than the old ones", fact, step))
    save_material(found.material, out, force=True)
    figures = {part: (found.report[part] or {}).get("psnr_db") for part in ("held_out_before", "held_out_after", "train_before", "train_after")}
    return {"figures": figures, "seconds": found.report["seconds"]}


def main(arguments: list[str]) -> int:
    """Run it and say how it goes."""
    from torchmat.progress import told

    said = 0.0

    def tell(what: str, share: float | None) -> None:
        nonlocal said
        if time.monotonic() - said >= _BETWEEN:
            said = time.monotonic()
            print(json.dumps({"what": what, "share": share}), flush=True)

    folder, btf, out, effort, *maps = arguments
    try:
        with told(tell):
            report = refitted(folder, btf, out, float(effort), maps)
    except TorchmatError as error:
        print(json.dumps({"error": str(error)}), flush=True)
        return 2
    print(json.dumps({"report": report}), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
