"""A second set of images of the same texels, under other directions: measured beside what is held out, never fitted."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from torchmat.btf import Btf, Split, load_btf
from torchmat.btf.btf import unique_directions
from torchmat.errors import RangeError, ShapeError, message
from torchmat.fitting.evaluate import (
    MEASURES, Evaluation, NotMeasured, evaluate, evaluate_parts, few_samples, nothing_measured,
    spacing_of,
)
from torchmat.machine import give_back
from torchmat.models import Material
from torchmat.progress import working
from torchmat.sample import sample_path

SAMPLE = "sample"  # the random directions that ship with the package
TEST, TEST_AFTER_EXPORT = "test", "test_after_export"
# What says how pixels are read holds for both; lights, views and tables of them are the data's own.
_READ_ALIKE = ("encoding", "exposure", "crop", "downscale", "invalid", "duplicates", "normalise", "clipped_weight")


def unseen_of(btf: Btf, test: Btf | str | Path | None, data: Mapping[str, Any], progress: bool | None = False) -> Btf | None:
    """Return the images that a fit of `btf` is tested on, None where there are none.

    Args:
        btf: the images that are fitted, or held out.
        test: the other images, or the path of them, or "sample": the random directions beside the embedded sample.
        data: keywords of `load_btf`, of which those that say how pixels are read hold for a path too.
        progress: whether to show a bar; None shows it on a terminal.

    Raises ShapeError when the sizes differ, RangeError when it is the fitted data itself.
    """
    if test is None:
        return None
    if not isinstance(test, Btf):
        shipped = str(test) == SAMPLE and not Path(SAMPLE).exists()
        alike = {name: value for name, value in data.items() if name in _READ_ALIKE}
        test = load_btf(sample_path("random") if shipped else test, **alike, progress=progress)
    if (test.height, test.width) != (btf.height, btf.width):
        fact = f"it has {test.height} x {test.width} and {btf.source.path} {btf.height} x {btf.width}"
        step = "Crop or scale them alike: each texel is to show the same place of the sample."
        raise ShapeError(message(test.source.path, "the test images", "have the size of the data", fact, step))
    if test is btf or test.unmasked().digest() == btf.unmasked().digest():
        step = "Give images of other directions, or none: holdout keeps back some of the data itself."
        raise RangeError(message(test.source.path, "the test images", "be others than the data", "they are the same", step))
    return test if btf.mask is None else test.masked(btf.mask, btf.source.mask)


def unseen_source(btf: Btf, test: Btf | None) -> dict[str, Any]:
    """Return what a report says of test images: where they are from, how many, and how many pairs the data has too."""
    if test is None:
        return {}
    light, view = (unique_directions(torch.cat(both))[1] for both in ((btf.light, test.light), (btf.view, test.view)))
    pairs = light * (int(view.max()) + 1) + view
    known = int(torch.isin(pairs[len(btf) :], pairs[: len(btf)]).sum())
    return {"test_source": {"path": test.source.path, "kind": test.source.kind, "samples": len(test), "pairs_in_data": known}}


def measured(
    btf: Btf, test: Btf | None, material: Material, split: Split, how: str, progress: bool | None
) -> tuple[dict[str, Any], Evaluation | None]:
    """Return the figures of all parts of a report that `how` asks for, and what was measured on the held-out samples."""
    if how == MEASURES[0]:
        return nothing_measured() | ({} if test is None else _not_measured()), None
    quick, every = how == MEASURES[1], spacing_of(material, btf) if how == MEASURES[3] else 1
    with working("measuring", progress):
        errors, held_out = evaluate_parts(btf, material, split, progress, quick, every, how == MEASURES[2])
        errors |= {} if test is None else _tested(material, test, progress, quick, every)
        if every > 1:
            give_back()  # of large images the allocator keeps a hundred megabytes that nothing uses
        return errors, held_out


def _tested(material: Material, test: Btf, progress: bool | None, quick: bool, every: int) -> dict[str, Any]:
    """Return the figures of all test images, or of few, `quick`, or `every` so many texels; as fitted and as the textures hold it."""
    rows, few = torch.arange(len(test)), few_samples(test) if quick else None
    return {
        TEST: evaluate(material, test, rows, few, progress, every=every).report,
        TEST_AFTER_EXPORT: evaluate(material, test, rows, few, progress, every=every, exported=True).report,
    }


def _not_measured() -> dict[str, Any]:
    step = "Leave measure out, or measure now: tm.evaluate(result.material, test, torch.arange(len(test))).report."
    return {part: NotMeasured(part, "measure='none' left the errors out", step) for part in (TEST, TEST_AFTER_EXPORT)}
