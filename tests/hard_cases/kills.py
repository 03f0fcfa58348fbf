"""Hard case 16 at work: a process that loads, fits and exports is killed at random moments, over and over.

After each kill the material is the old one or the new one, whole; at the end a run that is left alone completes, the
cache holds what it should, and nothing lies beside the results. The engine runs in a process of its own, which has
loaded everything and forks for each run, so that a kill costs milliseconds: ``python kills.py FOLDER COUNT SEED``.
"""

from __future__ import annotations

import hashlib
import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

ENTRY = Path(__file__)
_HANGS = 1200  # seconds
EXAMPLE = ("shading_map", {"brdf": "phong", "azimuths": 1})
_LONGEST = 1.15  # times a run that is left alone: some kills come too late


def run(count: int, seed: int, folder: Path) -> list[dict]:
    """Kill `count` runs of each kind of work in `folder`; return a row each: case, component, count, passed, note."""
    done = subprocess.run(
        [sys.executable, str(ENTRY), str(folder), str(count), str(seed)], capture_output=True, text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"}, timeout=_HANGS,
    )
    if done.returncode:
        raise AssertionError(f"the engine of kills failed:\n{done.stderr[-4000:]}")
    return json.loads(done.stdout.strip().splitlines()[-1])


def digest(material) -> str:
    """Return a fingerprint of a material's maps."""
    content = b"".join(value.detach().contiguous().numpy().tobytes() for _, value in sorted(material.maps.items()))
    return hashlib.sha256(content).hexdigest()


class Work:
    """One kind of work in a folder of its own: what it writes, and what may be found there."""

    component = ""

    def __init__(self, folder: Path, source: Path) -> None:
        self.folder, self.source = folder, source
        folder.mkdir()
        self.wanted: set[str] = set()

    @property
    def target(self) -> Path:
        """What the work writes."""
        return self.folder / "material"

    def once(self) -> float:
        """Do all of it: one material, and another over it; return the seconds of the other."""
        self.one(0)
        start = time.perf_counter()
        self.one(1)
        return time.perf_counter() - start

    def one(self, which: int) -> None:
        """Write the one or the other."""
        raise NotImplementedError

    def found(self) -> str:
        """Return the fingerprint of what stands under the final name; raises when it is not whole."""
        from torchmat import load_material

        return digest(load_material(self.target))

    def rests(self) -> list[str]:
        """Return what lies beside the results."""
        return sorted(path.name for path in self.folder.iterdir() if path.name not in ("material", "cache"))


class Export(Work):
    """Save one material over another."""

    component = "save_material"

    def __init__(self, folder: Path, source: Path) -> None:
        super().__init__(folder, source)
        from tests.models.examples import make

        import torch

        self.both = [make("ptm", {}, 48, 48, dtype=torch.float32, seed=k, storage="png16") for k in (0, 1)]

    def one(self, which: int) -> None:
        from torchmat import save_material

        save_material(self.both[which], self.target)
        self.wanted.add(digest(self.both[which].as_exported()))


class Fitting(Work):
    """Load photographs through the cache, fit, and write the material with its report."""

    component = "load_btf, fit, write_fit"
    model, pictures, settings = "ptm", False, {}

    def one(self, which: int) -> None:
        import torchmat as tm
        from torchmat.report import write_fit

        btf = tm.load_btf(self.source, cache=self.folder / "cache", progress=False)
        result = tm.fit(btf, self.model, seed=which, progress=False, **self.settings)
        write_fit(btf, result, self.target, pictures=self.pictures)
        self.wanted.add(digest(result.material.as_exported()))

    def found(self) -> str:
        json.loads((self.target / "report.json").read_text("utf-8"))
        return super().found()


class Iterative(Fitting):
    """The same with an iterative fit."""

    component = "distribution fit, write_fit"
    model = "distribution"
    settings = {"geometry": "flat", "lobes": 1, "fresnel": False, "rotation": False, "specular_size": 8, "specular_spacing": "even", "effort": 0.01}


class Pictures(Fitting):
    """The same with the report's pictures."""

    component = "report with pictures"
    model, pictures = "texture", True


class Volume(Work):
    """Write a shading map over another as one file."""

    component = "write_volume (.3pm)"

    def __init__(self, folder: Path, source: Path) -> None:
        super().__init__(folder, source)
        from tests.models.examples import make

        import torch

        self.both = [make(*EXAMPLE, 32, 32, dtype=torch.float32, seed=k) for k in (0, 1)]

    @property
    def target(self) -> Path:
        return self.folder / "wool.3pm"

    def one(self, which: int) -> None:
        from torchmat import save_material

        save_material(self.both[which], self.target)
        self.wanted.add(self.found())

    def rests(self) -> list[str]:
        return sorted(path.name for path in self.folder.iterdir() if path.name != "wool.3pm")


WORKS = (Export, Fitting, Iterative, Pictures, Volume)


def photographs(folder: Path) -> Path:
    """Write a small folder of photographs with its manifest; return it."""
    from tests.support import all_pairs, hemisphere, plausible_images

    light, view = all_pairs(hemisphere(), hemisphere(((0, 1), (40, 3))))
    return written(folder, plausible_images(light, view, 12, 10), light, view)


def written(folder: Path, images, light, view) -> Path:
    """Write images [n, 3, H, W] as 16-bit photographs with their manifest; return the folder."""
    import numpy as np

    from torchmat.images import write_image

    folder.mkdir()
    lines = ["file,light_x,light_y,light_z,view_x,view_y,view_z"]
    for number, image in enumerate(images.clip(0, 1)):
        write_image(folder / f"{number:03d}.png", (image.transpose(1, 2, 0) * 65535).round().astype(np.uint16))
        lines.append(",".join([f"{number:03d}.png", *(f"{x:.9f}" for x in (*light[number], *view[number]))]))
    (folder / "manifest.csv").write_text("\n".join(lines) + "\n")
    return folder


def _killed(work: Work, after: float) -> bool:
    """Run `work` in a child that is killed `after` seconds; return whether the kill came before its end."""
    child = os.fork()
    if child == 0:
        code = 1
        try:
            work.once()
            code = 0
        finally:
            os._exit(code)
    time.sleep(after)
    os.kill(child, signal.SIGKILL)
    status = os.waitpid(child, 0)[1]
    assert status in (0, signal.SIGKILL), f"the run ended by itself with {status}"
    return status != 0


def torment(work: Work, count: int, seed: int) -> dict:
    """Kill `count` runs of `work`, look at what is left each time, and let one complete."""
    span = 2 * work.once()
    chance, early, states = random.Random(seed), 0, set()
    for number in range(count):
        if number % 5 == 4:
            _forget(work)
        early += _killed(work, chance.uniform(0, _LONGEST * span))
        if work.target.exists():
            found = work.found()
            assert found in work.wanted, "neither the old nor the new stands there"
            states.add(found)
    work.one(0)
    assert work.found() in work.wanted
    rests = work.rests()
    assert not rests, f"left behind: {rests}"
    note = f"{early} of {count} before their end; {len(states)} states seen"
    return {"case": 16, "component": work.component, "count": count, "passed": True, "figure": None, "note": note}


def _forget(work: Work) -> None:
    """Take the cache and the material away, so that kills meet the first run as well."""
    import shutil

    shutil.rmtree(work.folder / "cache", ignore_errors=True)
    if work.target.is_dir():
        shutil.rmtree(work.target)
    elif work.target.exists():
        work.target.unlink()


def main() -> None:
    """The process of its own."""
    sys.path.insert(0, str(ENTRY.parents[2]))
    folder, count, seed = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
    import torch

    torch.set_num_threads(1)
    source = photographs(folder / "photographs")
    rows = [torment(kind(folder / kind.__name__, source), count, seed + place) for place, kind in enumerate(WORKS)]
    print(json.dumps(rows))


if __name__ == "__main__":
    main()
