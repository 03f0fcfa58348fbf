"""How much memory a fit takes, and so how large its tiles may be."""

from __future__ import annotations

import math

from torchmat.errors import RangeError, message
from torchmat.fitting.recipe import recipe_of
from torchmat.fitting.training import Training
from torchmat.models import Material

USUAL_SIDE = 128
LEAST_SIDE, _MOST_SIDE, STEP = 16, 1024, 16
FEWEST_TEXELS = LEAST_SIDE**2
_MB = 1e6
# Roomy where samples are held: a distribution in tiles of 240 x 240 under 441 samples, allowed 2500 MB, took 670.
_PROGRAM_MB = 90.0  # what a fit loads and keeps beside Python and torch, whose 250 MB are not counted
_BLOCKS_MB = 100.0  # a decoded block, its codes, and one more of each where samples have weights
_RECOVERY_MB = 1200.0  # to recover a relief, most of it to compare images of 96 x 96, whatever their own size


def _texel_bytes(training: Training, model: str, relief: bool) -> float:
    """Return the bytes that one texel of a tile takes while it is fitted."""
    wide = training.dtype.itemsize / 4
    tiling = recipe_of(model).tiling
    samples = int(training.used.sum()) if relief or tiling.holds_samples else 0
    copies = 2 if relief and not tiling.holds_samples else 1  # with and without shadow
    return wide * tiling.bytes_per_texel + copies * samples * (12 * wide + 1)


def _fixed_mb(training: Training, model: str, relief: bool) -> float:
    wide = training.dtype.itemsize / 4
    btf = training.btf
    seen = (len(btf.lights) * 4 * wide + len(btf.views)) * btf.height * btf.width / _MB if relief else 0.0
    return _PROGRAM_MB + _BLOCKS_MB * wide + recipe_of(model).tiling.kept_mb * wide + seen


def _joined_mb(material: Material, training: Training) -> float:
    """Return what the maps of all texels take, twice: as they are joined, and as the material that holds them."""
    channels = sum(spec.channels for spec in material.specs() if spec.per_texel and not spec.constant)
    return 2 * channels * training.dtype.itemsize * training.btf.height * training.btf.width / _MB


def most_texels(training: Training, model: str, relief: bool, memory_mb: float) -> int:
    """Return how many texels may be fitted at once in `memory_mb`, 0 for no limit; raises RangeError for too few."""
    if not memory_mb:
        return training.btf.height * training.btf.width
    left = memory_mb - _fixed_mb(training, model, relief)
    _require(training, model, relief, memory_mb, left)
    return int(left * _MB / _texel_bytes(training, model, relief))


def choose_side(
    training: Training, model: str, material: Material, relief: bool, tile_size: int, memory_mb: float
) -> int:
    """Return the side of the tiles; raises RangeError when not even small ones fit into `memory_mb`."""
    if not memory_mb:
        return tile_size or USUAL_SIDE
    left = memory_mb - _fixed_mb(training, model, relief) - _joined_mb(material, training)
    _require(training, model, relief, memory_mb, left)
    side = math.isqrt(int(left * _MB / _texel_bytes(training, model, relief)))
    if tile_size > side:
        step = f"Use tile_size={side} at most, or 0 to have it chosen."
        raise RangeError(message("fit", "tile_size", f"fit into {memory_mb:g} MB", f"it is {tile_size}", step))
    return tile_size or max(LEAST_SIDE, min(_MOST_SIDE, side // STEP * STEP))


def require_recovery(memory_mb: float) -> None:
    """Raise RangeError when `memory_mb` (0: no limit) is too little to recover a relief."""
    if 0 < memory_mb < _RECOVERY_MB:
        step = "Allow that, give a height map, or use geometry='flat'."
        fact = f"it is {memory_mb:g}, and recovering the relief takes that much"
        raise RangeError(message("fit", "memory_mb", f"be at least {_RECOVERY_MB:g}", fact, step))


def _require(training: Training, model: str, relief: bool, memory_mb: float, left: float) -> None:
    least = FEWEST_TEXELS * _texel_bytes(training, model, relief) / _MB
    if left < least:
        needed = math.ceil(memory_mb - left + least)
        fact = f"it is {memory_mb:g}, and {model} on this data takes {needed} MB with the smallest tiles"
        step = "Allow that, shrink the images with downscale, or fit fewer samples."
        raise RangeError(message("fit", "memory_mb", f"be at least {needed}", fact, step))
