"""How true a material is on chosen samples of a BTF: pooled figures, and by polar angle."""

from __future__ import annotations

import math
import time
from functools import partial
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torchmat import frames
from torchmat.btf import Btf, Split
from torchmat.errors import NotMeasuredError, message
from torchmat.metrics import SampleErrors
from torchmat.models import Material
from torchmat.models.edit import resized
from torchmat.models.relief_maps import shade_under
from torchmat.progress import progress as progress_bar
from torchmat.progress import working

BAND_DEG = 15
# SSIM and CIEDE2000 cost far more than the rest: an even choice of samples, of large images the middle, is enough.
PERCEPTUAL_SAMPLES, PERCEPTUAL_TEXELS = 256, 2_000_000
_SHADED = 6  # times that a material is shaded for its rate, the first to warm up
_FEWEST = 8  # samples that are looked at, however large they are
MEASURES = ("none", "quick", "full", "auto")
SPLITS = ("train", "held_out", "held_out_after_export")
_TRAIN_SAMPLES, TRAIN_TEXELS = 512, 100_000_000  # "full" measures the training error on at most so much, evenly chosen
QUICK_TEXELS = 2_000_000  # of each part, where quick figures are asked for
# "auto" looks at every so-manieth row and column of images above so many texels: about so many of each; of so many in all
# for the training error, whatever the size.
LARGE_TEXELS, _OF_EACH, _OF_TRAIN = 1 << 20, 1 << 17, 1 << 21
# SSIM and CIEDE2000 take seven times what the other figures take: "auto" looks at so many texels of what is held out, and at
# fewer of what the fit saw, where they say least.
_PERCEPTUAL_SOME, _PERCEPTUAL_TRAIN = 1 << 19, 1 << 17
_VALUES = 1_000_000  # values of one batch: larger ones leave the processor's cache and take three times as long


class Evaluation(NamedTuple):
    """`report` holds the six figures, `relative_error_interval`, `samples`, and `by_angle`; `per_sample` [n] display errors."""

    report: dict[str, Any]
    per_sample: Tensor


def predict(material: Material, btf: Btf, indices: Tensor) -> Tensor:
    """Return the material's images [k, 3, H, W] for chosen samples of `btf`; near lights are those of texels as high as they are."""
    light, view = btf.directions(indices, material.dtype)
    with torch.no_grad():
        if btf.near is None or not material.has_relief or material.cutout is not None:
            return material.shade(light, view)
        raised = btf.with_near(btf.near.raised(material.maps["height"].detach()))
        return shade_under(material, raised.directions(indices, material.dtype)[0], view)


def evaluate(
    material: Material, btf: Btf, indices: Tensor, most: int | None = None, progress: bool | None = False,
    perceptual: bool = True, every: int = 1, exported: bool = False, perceptual_texels: int | None = None,
) -> Evaluation:
    """Measure a material against samples of a BTF: errors pooled, by polar angle, and of each sample.

    The relative error has its 95 % interval beside it, over samples drawn anew: a few near-mirror images can decide it.

    Args:
        material: the material; one that is smaller than the images, or a part of them, is brought to theirs.
        btf: the images.
        indices: numbers [n] of the samples, such as ``result.split.held_out``.
        most: the most samples that are looked at, evenly chosen; None is all.
        progress: whether to show a bar; None shows it on a terminal.
        perceptual: whether to include SSIM and CIEDE2000, which take most of the time.
        every: look at every so-manieth row and column alone (`spacing_of` says where that may be), of the middle for SSIM and
            CIEDE2000.
        exported: whether to measure the material as its textures hold it.
        perceptual_texels: about how many texels SSIM and CIEDE2000 look at; None is 2 million, and 2^19 with `every` above 1.
    """
    if most is not None and len(indices) > most:
        indices = indices[torch.linspace(0, len(indices) - 1, most).round().long()]
    part = comparable(material, btf)[1]
    if perceptual_texels is None:
        perceptual_texels = PERCEPTUAL_TEXELS if every == 1 else _PERCEPTUAL_SOME
    share = perceptual_share(len(indices), part.height, part.width, perceptual_texels)
    count, rows, columns = share
    looked_at = torch.zeros(len(indices), dtype=torch.bool)
    if perceptual:
        looked_at[torch.linspace(0, len(indices) - 1, count).round().long()] = True
    if every == 1:
        material = material.as_exported() if exported else material
        errors = sample_errors(material, btf, indices, looked_at, progress, (rows, columns))
    else:
        errors = _errors_of_some(material, btf, indices, looked_at, progress, every, exported, (rows, columns))
    report: dict[str, Any] = {
        "samples": len(indices), **errors.report(), "relative_error_interval": errors.relative_error_interval(),
    }
    if every > 1:
        report["every"] = every
    if perceptual:
        report |= {"perceptual_samples": count, "perceptual_size": [rows.stop - rows.start, columns.stop - columns.start]}
    report["by_angle"] = _bands(errors, btf.light[indices], "light") + _bands(errors, btf.view[indices], "view")
    return Evaluation(report, errors.per_sample_display())


def spacing_of(material: Material, btf: Btf) -> int:
    """Return of which so-manieth row and column "auto" measures a material: 1, all, unless the images are large.

    On a relief all are measured: what a texel sees lies beside it.
    """
    whole = material.size == (btf.height, btf.width) and material.cutout is None and not material.has_relief
    texels = btf.height * btf.width
    return math.ceil(math.sqrt(texels / _OF_EACH)) if whole and texels > LARGE_TEXELS else 1


def _errors_of_some(
    material: Material, btf: Btf, indices: Tensor, looked_at: Tensor, progress: bool | None, every: int, exported: bool,
    window: tuple[slice, slice],
) -> SampleErrors:
    """Return the errors on every so-manieth row and column, and SSIM and CIEDE2000 of samples that are `looked_at` in a window."""
    rows, columns = (slice(0, size, every) for size in (btf.height, btf.width))
    none = torch.zeros_like(looked_at)
    few = btf.window(0, 0, btf.height, btf.width, every)
    errors = sample_errors(material.some_texels(rows, columns, exported), few, indices, none, progress)
    if bool(looked_at.any()):
        rows, columns = window
        middle = btf.window(rows.start, columns.start, rows.stop - rows.start, columns.stop - columns.start)
        seen = indices[looked_at]
        found = sample_errors(material.some_texels(rows, columns, exported), middle, seen, torch.ones(len(seen), dtype=torch.bool), progress)
        errors.ssim, errors.delta_e = found.ssim, found.delta_e
    return errors


def perceptual_share(samples: int, height: int, width: int, most_texels: int = PERCEPTUAL_TEXELS) -> tuple[int, slice, slice]:
    """Return how many of so many samples get SSIM and CIEDE2000, and in which rows and columns: about `most_texels`.

    Up to 256 whole images; fewer, and of at least 8 the middle alone, where that would be more texels.
    """
    texels = height * width
    count = min(samples, PERCEPTUAL_SAMPLES, max(_FEWEST, most_texels // texels))
    most = most_texels / max(count, 1)
    short = math.ceil(min(1.0, math.sqrt(most / texels)) * min(height, width))
    long = min(max(height, width), math.ceil(most / short))
    rows, columns = (short, long) if height <= width else (long, short)
    top, left = (height - rows) // 2, (width - columns) // 2
    return count, slice(top, top + rows), slice(left, left + columns)


def comparable(material: Material, btf: Btf) -> tuple[Material, Btf]:
    """Return a material and the images of the texels that it covers, of one size.

    A material that is a part of a texture is compared with that part of the images, one of a lower resolution is brought
    to theirs: what it has lost counts as error.
    """
    if material.cutout is None:
        return material, btf
    part = material.cutout
    if (btf.height, btf.width) == (part.whole_height, part.whole_width):
        btf = btf.window(part.top, part.left, part.height, part.width)
    return resized(material, (btf.height, btf.width)), btf


def sample_errors(
    material: Material, btf: Btf, indices: Tensor, looked_at: Tensor, progress: bool | None = False,
    window: tuple[slice, slice] = (slice(None), slice(None)),
) -> SampleErrors:
    """Return the errors of `material` on samples `indices`, of which `looked_at` (bool) get SSIM and CIEDE2000 in `window`."""
    material, btf = comparable(material, btf)
    errors = SampleErrors()
    batch = max(1, _VALUES // (3 * btf.height * btf.width))
    parts = torch.arange(len(indices)).split(batch)
    for part in progress_bar(parts, "measuring", show=progress):
        rows = indices[part]
        prediction = predict(material, btf, rows)
        target = btf.images(rows, prediction.dtype)
        clipped = btf.saturated(rows, target)
        errors.add(prediction, target, btf.valid(rows), clipped, looked_at[part], window)
    return errors


class NotMeasured(dict[str, Any]):
    """The figures of a part that was not measured: an empty table, null in `report.json`, whose look-ups say why."""

    def __init__(self, part: str, fact: str, step: str) -> None:
        super().__init__()
        self.why = message("fit", f"report[{part!r}]", "be measured", fact, step)

    def __missing__(self, key: str) -> Any:
        raise NotMeasuredError(self.why)

    def __repr__(self) -> str:
        return f"NotMeasured({self.why!r})"


def nothing_measured() -> dict[str, Any]:
    """Return what stands for the figures of each of SPLITS in a fit that was told not to measure."""
    step = "Leave measure out, or measure now: tm.evaluate(result.material, btf, result.split.held_out).report."
    return {part: NotMeasured(part, "measure='none' left the errors out", step) for part in SPLITS}


def few_samples(btf: Btf) -> int:
    """Return on how many samples quick figures stand."""
    return max(_FEWEST, QUICK_TEXELS // (btf.height * btf.width))


def evaluate_parts(
    btf: Btf, material: Material, split: Split, progress: bool | None = False, quick: bool = False, every: int = 1, full: bool = False
) -> tuple[dict[str, Any], Evaluation | None]:
    """Return the figures of each of SPLITS, NotMeasured without held-out samples, and what was measured on those.

    On all held-out samples and some that the fit saw, or of both on few, `quick`; on `every` so-manieth row and column; SSIM and
    CIEDE2000 on as many texels as `evaluate` takes, `full`, or on fewer.
    """
    looks, glances = (None, None) if full else (_PERCEPTUAL_SOME, _PERCEPTUAL_TRAIN)
    texels = -(-btf.height // every) * -(-btf.width // every)
    few = few_samples(btf) if quick else None
    some = min(few or _TRAIN_SAMPLES, _TRAIN_SAMPLES, max(_FEWEST, (TRAIN_TEXELS if full else _OF_TRAIN) // texels))
    report: dict[str, Any] = {"train": evaluate(material, btf, split.train, some, progress, every=every, perceptual_texels=glances).report}
    measured = partial(evaluate, material, btf, split.held_out, few, progress, every=every, perceptual_texels=looks)
    held_out = measured() if len(split.held_out) else None
    if held_out is None:
        step = "Give holdout=0.2; report['train'] has the errors on samples that the fit saw."
        return report | {part: NotMeasured(part, "no samples are held out", step) for part in SPLITS[1:]}, None
    report["held_out"] = held_out.report
    with working("measuring after export", progress):
        report["held_out_after_export"] = measured(exported=True).report
    return report, held_out


def _bands(errors: SampleErrors, direction: Tensor, which: str) -> list[dict[str, Any]]:
    polar = torch.rad2deg(frames.to_polar(direction.double())[0])
    rows = []
    # Every sample is in one band: 90 degrees in the last above the horizon, lights below it in one of their own.
    for low, high in [(low, low + BAND_DEG) for low in range(0, 90, BAND_DEG)] + [(90, 180)]:
        # Rounding must not put 45 degrees into the band below: edges are met with a small tolerance.
        upper = high + 1e-3 if high >= 90 else high - 1e-3
        inside = ((polar > low + 1e-3) if low == 90 else (polar >= low - 1e-3)) & (polar < upper)
        if bool(inside.any()):
            rows.append({
                "angle": which, "from_deg": low, "to_deg": high, "samples": int(inside.sum()),
                **errors.pooled(inside),
            })
    return rows


def shading_rate(material: Material) -> float:
    """Return million texels shaded a second, one light and view an image: the median of several runs.

    Of a large flat material on some of its rows.
    """
    if material.texels > LARGE_TEXELS and not material.has_relief:
        rows = max(1, _OF_EACH // material.size[1])
        material = material.some_texels(slice(0, rows), slice(0, material.size[1]))
    light = torch.tensor([0.3, 0.2, math.sqrt(0.87)])[:, None, None]
    view = torch.tensor([-0.4, 0.1, math.sqrt(0.83)])[:, None, None]
    light, view = light.to(material.dtype), view.to(material.dtype)
    seconds = []
    with torch.no_grad():
        for _ in range(_SHADED):
            start = time.perf_counter()
            material.shade(light, view)
            seconds.append(time.perf_counter() - start)
    return material.texels / 1e6 / sorted(seconds[1:])[len(seconds[1:]) // 2]
