"""Whether the surface of a BTF repeats: asked of some images of its most frontal view."""

from __future__ import annotations

from typing import Any

import torch

from torchmat.geometry.tiling import AUTO_TILES, Tiling, check_tiles, tiling_of

_IMAGES, _VALUES = 16, 2**25  # images that are looked at, and values of them


def btf_tiling(btf: Any) -> Tiling:
    """Return whether the surface of a Btf repeats, by up to 16 images, evenly among those of its most frontal view.

    What an object mask cuts out does not.
    """
    view = int(btf.views[:, 2].argmax())
    rows = ((btf.view_index == view) & (btf.light[:, 2] > 0)).nonzero()[:, 0]
    rows = rows if len(rows) else torch.arange(len(btf))
    count = min(len(rows), _IMAGES, max(1, _VALUES // (3 * btf.height * btf.width)))
    chosen = rows[torch.linspace(0, len(rows) - 1, count).round().long()]
    found = tiling_of(btf.images(chosen[n : n + 1]) for n in range(count))
    return found if btf.mask is None else found._replace(repeats=False, masked=True)


def decided(where: str, btf: Any, tiles: bool | str) -> tuple[bool, Tiling | None]:
    """Return whether a BTF is taken to repeat, and what that was decided by; None where `tiles` says it."""
    check_tiles(where, tiles)
    if tiles != AUTO_TILES:
        return bool(tiles), None
    found = btf_tiling(btf)
    return found.repeats, found
