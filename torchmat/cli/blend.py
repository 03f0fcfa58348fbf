"""torchmat blend."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import tyro

from torchmat.cli.arguments import check_out
from torchmat.cli.known import FILTERS
from torchmat.progress import phase

_GREY = 0.02  # how far the channels of a picture of weights may lie apart, as those of a grey JPEG do


@dataclass
class Blend:
    """Make the material between two: everywhere by one weight, or here the one and there the other by a mask."""

    reads: ClassVar = ("first", "second", "mask")
    words: ClassVar = {"filter": FILTERS}
    bounds: ClassVar = {"weight": ("lie in [0, 1]", 0, 1)}

    first: Annotated[str, tyro.conf.Positional]
    """Material folder (or .3pm) where the weight is 0; the result has its size, tiling and storage."""
    second: Annotated[str, tyro.conf.Positional]
    """Material of the same model where the weight is 1; another size is resampled."""
    weight: float | None = None
    """From 0, the first material, to 1, the second (default: 0.5)."""
    mask: Path | None = None
    """Grey picture instead of a weight: black is the first material, white the second; its codes are the weights."""
    filter: str = "bilinear"
    """bilinear, nearest or area: how the second material and the mask are brought to the size of the first."""
    out: Path = Path("out")
    """Folder to write, another one than those of the materials; an earlier material there is replaced."""
    force: bool = False
    """Replace it even if it was painted or edited since, and keep it as NAME.backup-1."""
    no_pictures: bool = False
    """Write the material only."""

    def run(self) -> None:
        from torchmat import load_material
        from torchmat.errors import RangeError, message
        from torchmat.models import blend
        from torchmat.report.write import write_edited

        check_out("blend", self.out, self.first, self.second, force=self.force)  # before the work, not after it
        if self.weight is not None and self.mask is not None:
            step = "Leave one of them out."
            raise RangeError(message("blend", "--weight and --mask", "not both be given", "they are", step))
        with phase("reading the materials"):
            first, second = load_material(self.first), load_material(self.second)
        weight = (0.5 if self.weight is None else self.weight) if self.mask is None else self._weights(self.mask, first)
        with phase("blending"):
            mixed = blend(first, second, weight, self.filter)
        by = {"weight": weight} if self.mask is None else {"mask": self.mask.name}
        provenance = {"blend": {"of": [Path(path).resolve().name for path in (self.first, self.second)], **by}}
        print(f"material   {write_edited(mixed, self.out, provenance, pictures=not self.no_pictures, force=self.force)}")

    def _weights(self, mask: Path, first):
        from torchmat.btf.photographs import read_linear
        from torchmat.errors import RangeError, check_option, message
        from torchmat.models.resample import FILTERS, resample

        check_option("blend", "--filter", self.filter, FILTERS)
        picture = read_linear(mask, "linear")
        apart = float((picture.amax(dim=0) - picture.amin(dim=0)).max())
        if apart > _GREY:
            fact, step = f"its channels differ by up to {apart:.3g}", "Save it as grey."
            raise RangeError(message(str(mask), "the mask", "be grey", fact, step))
        weights = resample(picture.mean(dim=0, keepdim=True), first.size, self.filter, first.tiles)
        if tuple(picture.shape[1:]) != first.size:
            print(f"mask       {picture.shape[1]} x {picture.shape[2]}, resampled to {first.size[0]} x {first.size[1]}")
        return weights.to(first.dtype)
