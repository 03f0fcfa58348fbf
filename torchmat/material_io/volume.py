"""The shading map's own file, ``.3pm`` (Kautz 2005, GPU Gems 2, ch. 11): a head in ASCII, then 8-bit slices.

The head is ``VL\\n#components 3\\n256 256 8\\n255\\n``: width, height, number of slices, largest code. Slices follow
from the darkest on, rows from the top, RGB side by side. Codes are linear: in the chapter's own file the means of the
slices grow by equal steps of codes, as the resampling makes the means of the radiance grow.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchmat.errors import DataError, RangeError, TorchmatError, check_finite, message
from torchmat.material_io.exporter import Exporter, Losses
from torchmat.models import Material, ShadingMap

SUFFIX = ".3pm"
_LINE = 64  # no line of the head is longer
_LEVELS = 255


class _Head(NamedTuple):
    width: int
    height: int
    slices: int
    levels: int
    bytes: int

    @property
    def codes(self) -> int:
        """Number of bytes that the head says follow it."""
        return 3 * self.width * self.height * self.slices


def is_volume(path: str | Path) -> bool:
    """Return whether a path names a ``.3pm`` file and not a folder."""
    return Path(path).suffix.lower() == SUFFIX and not os.path.isdir(path)


def read_volume(path: str | Path) -> ShadingMap:
    """Return the shading map of a ``.3pm`` file.

    The file holds slices and nothing else. The BRDF is the user's to choose; until then it is Lambert's (the chapter's
    Phong without a highlight), as bright along the normal as the brightest slice on average: r then runs through the
    whole stack. `brightest` is that slice's mean. Textures are stored as half, which holds 8-bit codes exactly.
    Raises DataError, which names the file, for a head that is not understood or says another size than the file has;
    nothing is read before that is checked.
    """
    path = Path(path)
    try:
        with open(path, "rb") as stream:
            head = _read_head(path, stream, os.fstat(stream.fileno()).st_size)
            codes = np.frombuffer(stream.read(head.codes), np.uint8)
    except OSError as error:
        raise DataError(message(str(path), "the volume", "be readable", str(error), "Check the path.")) from error
    _check_codes(path, head, codes)
    planes = codes.reshape(head.slices, head.height, head.width, 3).transpose(0, 3, 1, 2)
    slices = torch.from_numpy(np.ascontiguousarray(planes, np.float32)) / head.levels
    try:
        return _with_lambert(slices.flatten(0, 1), head.slices)
    except TorchmatError as error:
        raise DataError(f"{path}: {error}") from error


def _with_lambert(slices: Tensor, count: int) -> ShadingMap:
    brightest = slices[-3:].double().mean().float().reshape(1)
    maps = {"slices": slices, "lobe": brightest.repeat(3), "brightest": brightest}
    return ShadingMap(maps, slices=count, brdf="lambert")


def _read_head(path: Path, stream: BinaryIO, size: int) -> _Head:
    if _next_line(path, stream) != ["VL"]:
        step = "Check that it is a shading map's volume."
        raise DataError(message(str(path), "the first line", "be VL", "it is something else", step))
    components = _next_line(path, stream)
    if components[:1] != ["#components"] or _numbers(path, "#components", components[1:], 1) != [3]:
        fact = f"it is {' '.join(components)!r}"
        raise DataError(message(str(path), "the second line", "be '#components 3'", fact, "Convert it to RGB."))
    width, height, slices = _numbers(path, "width, height and slices", _next_line(path, stream), 3)
    (levels,) = _numbers(path, "the largest code", _next_line(path, stream), 1)
    head = _Head(width, height, slices, levels, stream.tell())
    if levels > _LEVELS:
        step = "Convert it to 8 bits."
        raise DataError(message(str(path), "the largest code", f"be at most {_LEVELS}", f"it is {levels}", step))
    if head.codes != size - head.bytes:
        fact = f"{width} x {height} x {slices} x 3 are {head.codes} bytes and {size - head.bytes} follow the head"
        step = "The file is truncated, or its head is wrong: restore it from the original."
        raise DataError(message(str(path), "the file", "have the size that its head says", fact, step))
    return head


def _next_line(path: Path, stream: BinaryIO) -> list[str]:
    line = stream.readline(_LINE)
    try:
        text = line.decode("ascii")
    except UnicodeDecodeError:
        text = ""
    if not text.endswith("\n"):
        step = "Check that it is a shading map's volume and complete."
        fact = f"a line starts with {line[:16]!r}"
        raise DataError(message(str(path), "the head", "be four short lines of ASCII", fact, step))
    return text.split()


def _numbers(path: Path, name: str, words: list[str], count: int) -> list[int]:
    fits = len(words) == count and all(word.isdigit() and len(word) < 10 and int(word) > 0 for word in words)
    if not fits:
        fact = f"the head says {' '.join(words)!r}"
        requirement = f"be {count} positive whole number{'s' if count > 1 else ''}"
        raise DataError(message(str(path), name, requirement, fact, "Correct the head."))
    return [int(word) for word in words]


def _check_codes(path: Path, head: _Head, codes: np.ndarray) -> None:
    if codes.size != head.codes:
        fact = f"{codes.size} of {head.codes} bytes came"
        raise DataError(message(str(path), "the volume", "be readable to its end", fact, "Read it again."))
    above = int((codes > head.levels).sum()) if head.levels < _LEVELS else 0
    if above:
        fact, requirement = f"{above} of {codes.size} codes are not", f"be at most {head.levels} as the head says"
        raise DataError(message(str(path), "codes", requirement, fact, "Correct the head."))


def write_volume(material: Material, path: Path) -> Losses:
    """Write the slices of a shading map as the ``.3pm`` file `path`, whatever is there; return what it does not hold.

    8-bit linear codes, 255 standing for 1: a file that was read, and whose head says 255, is written back byte
    for byte. The BRDF, `brightest` and other options have no place in the file. Raises RangeError for another model,
    for more than one azimuth, for a relief, and for slices that leave [0, 1]. `save_material` and `export` take care
    that the file appears whole.
    """
    _check_writable(material, path)
    slices = material.maps["slices"].detach()
    count, (height, width) = material.options["slices"], material.size
    codes = (slices.double() * _LEVELS).round().to(torch.uint8)
    pixels = codes.unflatten(0, (count, 3)).permute(0, 2, 3, 1).contiguous().numpy()
    head = f"VL\n#components 3\n{width} {height} {count}\n{_LEVELS}\n".encode("ascii")
    path.write_bytes(head + pixels.tobytes())
    return _losses(material, _with_lambert(codes.float() / _LEVELS, count))


def _losses(material: Material, read: ShadingMap) -> Losses:
    """Return what differs in the shading map that `read_volume` makes of the file."""
    lost = {
        name: f"it is {value!r}, and the file is read as {read.options[name]!r}"
        for name, value in material.options.items() if value != read.options[name]
    }
    if material.tiles != read.tiles or material.cutout is not None:
        lost["tiling"] = "the file is read as a texture that repeats"
    for name in ("lobe", "brightest"):
        if not torch.equal(material.maps[name].detach().float(), read.maps[name].detach()):
            lost[name] = "the file is read with Lambert's BRDF, as bright as the last slice"
    return Losses.of_maps(material, read.maps, lost)


def _check_writable(material: Material, path: Path) -> None:
    where = str(path)
    if not isinstance(material, ShadingMap):
        step = "Save it as a folder, or fit it as 'shading_map'."
        fact = f"it is {material.name}"
        raise RangeError(message(where, "the material", "be a shading_map for a .3pm file", fact, step))
    if material.options["azimuths"] > 1:
        fact = f"it has {material.options['azimuths']}"
        step = "Save it as a folder, or fit it with azimuths=1."
        raise RangeError(message(where, "the material", "have one azimuth for a .3pm file", fact, step))
    if material.has_relief:
        step = "Save it as a folder, or save surface() without the height."
        raise RangeError(message(where, "the material", "be flat for a .3pm file", "it has a height map", step))
    if "opacity" in material.maps:
        step = "Save it as a folder, or save surface() without it."
        raise RangeError(message(where, "the material", "be whole for a .3pm file", "it has an opacity map", step))
    slices = material.maps["slices"].detach()
    check_finite(where, "slices", slices)
    low, high = float(slices.min()), float(slices.max())
    if low < 0 or high > 1:
        step = (
            f"Write material.with_maps(slices=material.maps['slices'] / {high:.6g}) and multiply the light by as much."
            if low >= 0 else "Correct the map; it is never clipped."
        )
        fact = f"they run from {low:.6g} to {high:.6g}"
        raise RangeError(message(where, "slices", "lie in [0, 1] for 8-bit codes", fact, step))


VOLUME = Exporter("3pm", "the shading map's own file: slices in 8 bits, without the BRDF", write_volume, SUFFIX)
