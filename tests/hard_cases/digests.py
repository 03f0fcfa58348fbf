"""Stored digests of small fits of every model: a change of results is a decision, not an accident.

Bits differ between processors and between versions of the libraries, so each platform has digests of its own. The rounded
numbers beside them hold everywhere: on a platform that nobody stored they are what is compared.
In a process of its own: ``python digests.py [cached]`` prints them as JSON.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

STORED = Path(__file__).with_name("digests.json")
ENTRY = Path(__file__)
STORE = "python scripts/stress.py --store-digests"
_LIBRARIES = ("torch", "numpy", "scipy", "scikit-learn")
# Between platforms: rounding, which closed forms keep at float32 and steps multiply. Of each number, relative to it.
TOLERANCE = {"": 2e-3, "distribution": 5e-2, "microfacet": 5e-2, "neural": 1e-1, "local_pca": 5e-2, "lambert, recovered": 2e-2}
_GIVEN = "given"  # for the height that the photographs of the relief show


def platform_key() -> str:
    """Return what bits depend on: processor, what of it torch uses, and the libraries."""
    import torch

    found = {}
    if Path("/proc/cpuinfo").exists():
        lines = (line.split(":", 1) for line in Path("/proc/cpuinfo").read_text().splitlines() if ":" in line)
        for name, value in lines:
            found.setdefault(name.strip(), value.strip())
    maker = " ".join(found.get(name, "") for name in ("vendor_id", "cpu family", "model")).strip() or platform.processor()
    libraries = " ".join(f"{name} {version(name)}" for name in _LIBRARIES)
    return f"{platform.system()} {platform.machine()}, {maker}, {torch.backends.cpu.get_cpu_capability()}, {libraries}"


def fits() -> dict[str, tuple[str, dict[str, Any]]]:
    """Return model and options of each fit: every registered model, small and by its default solver, and a few variants.

    Then some on a relief that is given, one of each way there, and one on a relief that is recovered.
    """
    from tests.models.examples import PLAIN

    from torchmat.fitting.recipe import RECIPES

    small = {
        "pca": {"components": 4}, "local_pca": {"clusters": 3, "components": 3}, "rbf": {"components": 4},
        "distribution": {"lobes": 1, "fresnel": True, "rotation": True, "specular_size": 8, "effort": 0.02},
        "neural": {"latent": 2, "hidden": 4, "effort": 0.01},
        "microfacet": {"effort": 0.02, **PLAIN},
    }
    found = {model: (model, small.get(model, {})) for model in RECIPES}
    variants = {
        "phong_srf": ({"residual": "half_light"}, {"base": "ashikhmin_shirley"}, {"solver": "varpro"}),
        "ptm": ({"solver": "adam"}, {"solver": "lbfgs"}), "hsh": ({"terms": 16},),
    }
    found |= {
        f"{model}, {' '.join(map(str, one.values()))}": (model, one) for model, several in variants.items() for one in several
    }
    printed = "distribution", {**small["distribution"], "denominator": "ashikhmin"}
    found["distribution, as printed"] = printed
    found = {name: (model, {"geometry": "flat", **options}) for name, (model, options) in found.items()}
    for model in ("lambert", "hsh", "phong_srf", "pca", "distribution", "microfacet"):
        found[f"{model}, on a relief"] = model, {"geometry": _GIVEN, **small.get(model, {})}
    found["distribution, as printed, on a relief"] = printed[0], {"geometry": _GIVEN, **printed[1]}
    return found | {"lambert, recovered": ("lambert", {"geometry": "recover", "relief": "fast"})}


def results(cached: bool = False, only: Sequence[str] | None = None) -> dict[str, dict[str, Any]]:
    """Return, for each fit, the digest of its maps' bytes and a few rounded numbers.

    With `cached` the photographs come out of the cache that a first load has filled.
    """
    import torch
    from tests.fitting.reference_scene import relief_scene
    from tests.hard_cases.kills import photographs, written
    from tests.models.examples import directions, per_image

    import torchmat as tm
    from torchmat.colour import linear_to_srgb

    scene = relief_scene(12, 16, depth=0.1, views=((0, 1), (35, 3), (60, 3)), lights=((15, 1), (45, 4)))
    light, view = (per_image(directions(16, torch.float32, seed)) for seed in (1, 2))
    found = {}
    with tempfile.TemporaryDirectory() as room:
        flat = photographs(Path(room) / "photographs")
        codes = linear_to_srgb(torch.from_numpy(scene.images)).numpy()
        raised = written(Path(room) / "of a relief", codes, scene.light, scene.view)
        cache = Path(room) / "cache" if cached else False
        for _ in range(2 if cached else 1):
            on_flat, on_relief = (tm.load_btf(source, cache=cache, progress=False) for source in (flat, raised))
        for name, (model, options) in fits().items():
            if only is not None and name not in only:
                continue
            btf = on_flat if options["geometry"] == "flat" else on_relief
            asked = {**options, "geometry": scene.true_height} if options["geometry"] == _GIVEN else options
            result = tm.fit(btf, model, seed=3, progress=False, **asked)
            with torch.no_grad():
                shaded = result.material.shade(light, view)
            numbers = [result.report["held_out"]["relative_error"], float(shaded.mean()), float(shaded.std())]
            assert result.material.has_relief == (options["geometry"] != "flat"), name
            found[name] = {"digest": digest(result.material.maps), "numbers": [float(f"{x:.4g}") for x in numbers]}
    return found


def digest(maps) -> str:
    """Return the sha256 of the maps' names, shapes and bytes."""
    parts = hashlib.sha256()
    for name, value in sorted(maps.items()):
        value = value.detach().contiguous().numpy()
        parts.update(f"{name} {value.shape} {value.dtype.str}".encode() + np.ascontiguousarray(value).tobytes())
    return parts.hexdigest()


def stored() -> dict[str, Any]:
    """Return what is stored: `numbers` by fit, and `digests` by platform and fit."""
    return json.loads(STORED.read_text("utf-8")) if STORED.exists() else {"numbers": {}, "digests": {}}


def store(found: dict[str, dict[str, Any]]) -> None:
    """Make `found` what is right from now on, on this platform; digests of others stand for results of before and go."""
    before, numbers = stored(), {name: one["numbers"] for name, one in found.items()}
    kept = {} if differing(found, before["numbers"]) else before["digests"]
    digests = kept | {platform_key(): {name: one["digest"] for name, one in found.items()}}
    platforms = ",\n".join(f'  {json.dumps(name)}: {_lines(one, 3)}' for name, one in digests.items())
    text = f'{{\n "numbers": {_lines(numbers, 2)},\n "digests": {{\n{platforms}\n }}\n}}\n'
    STORED.write_text(text, encoding="utf-8")


def _lines(table: dict[str, Any], indent: int) -> str:
    """Return a table as JSON with one entry a line, so that a change shows as the lines that it changes."""
    inner = ",\n".join(f"{' ' * indent}{json.dumps(name)}: {json.dumps(value)}" for name, value in table.items())
    return f"{{\n{inner}\n{' ' * (indent - 1)}}}"


def differing(found: dict[str, dict[str, Any]], numbers: dict[str, list[float]]) -> list[str]:
    """Return what to say of each fit whose rounded numbers are not those stored, within TOLERANCE, or of none stored."""
    said = []
    for name, one in found.items():
        wanted, bound = numbers.get(name), TOLERANCE.get(name, TOLERANCE.get(fits()[name][0], TOLERANCE[""]))
        if wanted is None:
            said.append(f"{name}: nothing is stored")
        elif any(abs(a - b) > bound * abs(b) for a, b in zip(one["numbers"], wanted, strict=True)):
            said.append(f"{name}: {one['numbers']} instead of {wanted} (within {bound:g})")
    return said


def changed(found: dict[str, dict[str, Any]], kept: dict[str, Any] | None = None, key: str | None = None) -> list[str]:
    """Return what to say of each fit that is not as stored: by its bits where the platform has some of it, else by its numbers."""
    kept = stored() if kept is None else kept
    digests = kept["digests"].get(platform_key() if key is None else key)
    if digests is None:
        return differing(found, kept["numbers"])
    # A fit that another platform stored has no bits here yet.
    said = differing({name: one for name, one in found.items() if name not in digests}, kept["numbers"])
    return said + [
        f"{name}: other bits; its numbers are {one['numbers']}, stored {kept['numbers'].get(name)}"
        for name, one in found.items() if name in digests and digests[name] != one["digest"]
    ]


def in_fresh_process(threads: int, cached: bool) -> dict[str, dict[str, Any]]:
    """Return the results of a new process with so many threads."""
    done = subprocess.run(
        [sys.executable, str(ENTRY), *(["cached"] if cached else [])], capture_output=True, text=True, timeout=600,
        env={**os.environ, "OMP_NUM_THREADS": str(threads)},
    )
    if done.returncode:
        raise AssertionError(f"the process failed:\n{done.stderr[-2000:]}")
    return json.loads(done.stdout.strip().splitlines()[-1])


def run() -> list[dict]:
    """Return a row for each way to come to the same bits: as stored, two threads, fresh processes, out of the cache."""
    import torch

    found, threads = results(), torch.get_num_threads()
    try:
        torch.set_num_threads(3 - min(threads, 2))
        other = results()
    finally:
        torch.set_num_threads(threads)
    ways = {
        "as stored": changed(found), "another number of threads": unlike(found, other),
        "out of the cache": unlike(found, results(cached=True)),
        "fresh process, one thread": unlike(found, in_fresh_process(1, cached=False)),
        "fresh process, two threads, out of the cache": unlike(found, in_fresh_process(2, cached=True)),
    }
    known = platform_key() in stored()["digests"]
    return [
        {
            "case": "repeatability", "component": way, "count": len(found), "passed": not said, "figure": len(found) - len(said),
            "note": "; ".join(said) or ("" if known or way != "as stored" else "unknown platform: numbers were compared"),
        }
        for way, said in ways.items()
    ]


def unlike(first: dict[str, dict[str, Any]], second: dict[str, dict[str, Any]]) -> list[str]:
    """Return the names of fits whose digests differ."""
    return [name for name, one in first.items() if second[name]["digest"] != one["digest"]]


def main() -> None:
    """The process of its own."""
    sys.path.insert(0, str(ENTRY.parents[2]))
    print(json.dumps(results(cached="cached" in sys.argv[1:])))


if __name__ == "__main__":
    main()
