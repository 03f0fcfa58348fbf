"""Where near lights stand: what is said beside a table of lights, and the positions that it makes of the table's vectors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from torchmat.btf.listing import Listing
from torchmat.btf.near import Grid, Near, unit
from torchmat.errors import DataError, RangeError, check_positive, message

_EXACT = 1e-9  # vectors of length 1 to so much come from angles or were normalised


@dataclass(frozen=True)
class Standing:
    """`width` of the pictured sample and `distance` of all lights, in the unit of a table's vectors; None is not said.

    `falloff` says whether images darken with the distance to their light; None leaves it to the table.
    """

    width: float | None = None
    distance: float | None = None
    falloff: bool | None = None

    @property
    def key(self) -> tuple[float | bool | None, ...]:
        """What a cached store must agree in; nothing where nothing is said."""
        said = (self.width, self.distance, self.falloff)
        return () if said == (None, None, None) else said

    def check(self) -> None:
        """Raise RangeError for numbers that are no lengths, and for a distance without a width to measure it by."""
        for name, value in (("near", self.width), ("distance", self.distance)):
            if value is not None:
                check_positive("load_btf", name, value, "It is a length, in the unit of the table of lights.")
        if self.distance is not None and self.width is None:
            step = "Give the width of the pictured sample in the same unit: near=WIDTH (--near WIDTH)."
            raise RangeError(message("load_btf", "distance", "come with the sample's width", "near is not given", step))

    def of(self, path: str, listing: Listing) -> Listing:
        """Return a listing with the positions of its lights, where they are said to be near, by the caller or else by a dome.

        Raises DataError where the table says where they stand itself, holds directions alone, or holds positions and nothing
        says how wide the picture is.
        """
        listing = listing if self.falloff is None else replace(listing, falloff=self.falloff)
        width, said = (listing.width, ", as the dome says") if self.width is None else (self.width, "")
        if width is None and not listing.near:
            return listing
        if width is None:
            step = "Give the sample's width in the unit of the positions, near=WIDTH (--near WIDTH), or imageWidth in the file."
            raise DataError(message(path, "positions of near lights", "come with the width of the picture", "nothing says it", step))
        if listing.light_position is not None:
            step = "Leave near=WIDTH (--near) out."
            raise DataError(message(path, "where near lights stand", "be said once", "the table has a sample_width", step))
        light = listing.light
        if self.distance is not None:
            light = unit(light) * self.distance
        elif bool(((light.norm(dim=1) - 1).abs() < _EXACT).all()):
            fact = "all vectors have length 1: they are directions"
            step = "Give the distance of the lights in the unit of the sample's width: distance=D (--distance D)."
            raise DataError(message(path, "the lights", "be positions with near=WIDTH (--near)", fact, step))
        note = f"lights are near: positions over a sample {width:g} wide{said}"
        return replace(listing, light_position=light / width, notes=(*listing.notes, note))


def near_of(listing: Listing, picture: Sequence[int], crop: Sequence[int] | None, downscale: int) -> Near | None:
    """Return where lights and cameras stand over the texels that are left of a `picture` (height, width); None if all are far.

    Raises RangeError, which names the sample, for positions that give no directions.
    """
    if listing.light_position is None and listing.view_position is None:
        return None
    grid = Grid.whole(picture[0], picture[1])
    top, left, height, width = crop or (0, 0, *picture)
    rows, columns = height // downscale, width // downscale
    grid = grid.window(slice(top, top + rows * downscale), slice(left, left + columns * downscale)).resized(rows, columns)
    light, view = (None if one is None else one.float() for one in (listing.light_position, listing.view_position))
    return Near(light, view, grid, listing.falloff)
