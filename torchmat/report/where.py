"""Where on the surface a material is wrong: a map of its error, to guide the hand that edits it (Liao 2011, section 5.3)."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor

from torchmat import colour
from torchmat.btf import Btf
from torchmat.errors import RangeError, ShapeError, message
from torchmat.fitting import predict
from torchmat.models import Material
from torchmat.report.pictures import plotting, save_figure

_VALUES = 1_000_000  # values of one batch, as in `evaluate`


def difference_map(material: Material, btf: Btf, indices: Tensor) -> Tensor:
    """Return the root mean square display error [1, H, W] of each texel over samples `indices` of `btf`.

    Display values are clamped to [0, 1] and sRGB-encoded, so the map's mean square is the error that `psnr_db` states.
    As there, invalid samples do not count, and above a clipped one nothing is wrong. NaN where no sample counts.
    Raises ShapeError when the sizes differ, RangeError for indices that the BTF does not have.
    """
    indices = _checked(material, btf, indices)
    total = torch.zeros(1, btf.height, btf.width, dtype=torch.float64)
    count = torch.zeros_like(total)
    for rows in indices.split(max(1, _VALUES // (3 * btf.height * btf.width))):
        prediction = predict(material, btf, rows)
        target, valid = btf.images(rows, prediction.dtype), btf.valid(rows)
        clipped = btf.saturated(rows, target)
        prediction = torch.where(clipped, torch.minimum(prediction, target), prediction)
        squared = (colour.display(prediction) - colour.display(target)).double().square()
        valid = valid.expand_as(squared)
        # Chosen, not multiplied: what stands where nothing was measured may be NaN.
        total += torch.where(valid, squared, torch.zeros_like(squared)).sum(dim=(0, 1))
        count += valid.sum(dim=(0, 1))
    return (total / count).sqrt().to(material.dtype)


def _checked(material: Material, btf: Btf, indices: Tensor) -> Tensor:
    if material.size != (btf.height, btf.width):
        fact = f"it is {material.size[0]} x {material.size[1]}"
        step = "Resample it with `resized`, or load the BTF in its size."
        raise ShapeError(message("difference_map", "material", f"be {btf.height} x {btf.width} as the images", fact, step))
    indices = torch.as_tensor(indices)
    whole = indices.ndim == 1 and len(indices) > 0 and not indices.is_floating_point() and indices.dtype != torch.bool
    if not whole or int(indices.min()) < 0 or int(indices.max()) >= len(btf):
        fact = f"it is {indices.dtype} {tuple(indices.shape)}"
        fact += f" from {int(indices.min())} to {int(indices.max())}" if whole else ""
        step = "For example result.split.held_out."
        requirement = f"be sample numbers [n] from 0 to {len(btf) - 1}"
        raise RangeError(message("difference_map", "indices", requirement, fact, step))
    return indices.long()


def difference_picture(material: Material, btf: Btf, indices: Tensor, path: Path) -> Path:
    """Draw the error of each texel beside what the surface looks like; texels that nothing measured stay white.

    The picture on the left is the diffuse map, or the mean of the samples for a model without one.
    """
    wrong = difference_map(material, btf, indices)[0]
    if "diffuse" in material.maps:
        looks, title = material.maps["diffuse"].detach().float(), "diffuse map"
    else:
        looks, title = _mean_image(btf, torch.as_tensor(indices).long()), "mean of the samples"
    # Bright enough to find one's way: maps of dark cloth would otherwise be black.
    scale = max(float(looks.flatten().sort().values[int(0.99 * (looks.numel() - 1))]), 1e-6)
    figure, axes = plotting().subplots(1, 2, figsize=(9, 4))
    axes[0].imshow(colour.display(looks / scale).permute(1, 2, 0).numpy(), interpolation="nearest")
    axes[0].set_title(f"{title} (shown {1 / scale:.1f}x brighter)", fontsize=9)
    drawn = axes[1].imshow(wrong.numpy(), vmin=0, cmap="magma", interpolation="nearest")
    axes[1].set_title(f"RMS display error of {len(indices)} samples", fontsize=9)
    figure.colorbar(drawn, ax=list(axes), shrink=0.8)
    for axis in axes:
        axis.set_axis_off()
    return save_figure(figure, Path(path))


def _mean_image(btf: Btf, indices: Tensor) -> Tensor:
    total, count = torch.zeros(3, btf.height, btf.width), torch.zeros(1, btf.height, btf.width)
    for rows in indices.split(max(1, _VALUES // (3 * btf.height * btf.width))):
        valid = btf.valid(rows)
        image = btf.images(rows, torch.float32)
        total += torch.where(valid, image, torch.zeros_like(image)).sum(dim=0)
        count += valid.sum(dim=0)
    return total / count.clamp(min=1)
