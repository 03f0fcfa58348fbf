"""Diffuse + half-vector distributions: every map is a texture that an artist can paint (Liao 2011, over the g-BRDF).

``value = (C_d + pi * mask * C_s(H) * F(L.H) / D) * (N.L)`` with ``D = L.N + V.N - (L.N)(V.N)`` as the thesis prints it
(Ashikhmin's), or with Smith's masking in its place, past the thesis: what fits use. `C_s` is a parabolic map of the half
vector in the frame of the texel's normal. On a relief (`height`) parallax, shadow and ambient light come on top, and
normals are the height's.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import torch
import torch.nn.functional as functional
from torch import Tensor

from torchmat import frames, safe
from torchmat.errors import RangeError, ShapeError, check_option, check_positive, message
from torchmat.fast import distribution as fast_distribution
from torchmat.fast import distribution_shown
from torchmat.fast import frames as fast_frames
from torchmat.fast.distribution_misfit import Samples, misfit, serves
from torchmat.geometry import normals_from_slopes, slopes_from_height, slopes_from_normals
from torchmat.models.base import Material, combine
from torchmat.models.ggx import smith_denominator
from torchmat.models.parabolic import EVEN, SPACINGS, places
from torchmat.models.storage import MapSpec
from torchmat.repeatable import spread

DISTRIBUTION_PARTS = ("normal", "specular_mask", "fresnel", "rotation", "tilt", "masking")
_DENOMINATORS = ("tilt", "masking")  # parts that take the place of D as printed
TILT_SAMPLES = 91  # one a degree, 0 to 90
_MOST_LOBES = 12
# D and N.L reach 0 together, where their ratio depends on the way taken; with this much added the value goes to 0
# on all of them. It changes what is lit at 1 degree, and seen as flatly, by 0.3 %.
_GRAZING = 1e-4
_PARTS = 16
_FAST = ("diffuse", "specular_mask", "fresnel", "index", "specular")  # maps that the compiled part takes as they are
_LEAST_RISE = 1e-12  # that a logarithm is taken of


def distribution_specs(lobes: int, parts: Sequence[str], mask_channels: int = 1) -> tuple[MapSpec, ...]:
    """Return what each map of a distribution material of so many `lobes` and these optional `parts` is."""
    numbers = tuple(str(number + 1) for number in range(lobes))
    every = {
        "normal": MapSpec(
            "normal", "unit normal; on a relief, its refinement", low=-1.0, high=1.0, fixed_range=True, kind="normal",
        ),
        "specular_mask": MapSpec(
            "specular_mask", "scale of the specular colour", layer_channels=mask_channels, low=0.0,
            colour=True, linear=True,
        ),
        "fresnel": MapSpec("fresnel", "reflectance at normal incidence, r0", layer_channels=1, low=0.0, high=1.0),
        "rotation": MapSpec(
            "rotation", "cosine (x) and sine (y) of the turn of the specular map", layers=("x", "y"),
            layer_channels=1, low=-1.0, high=1.0, fixed_range=True, kind="rotation",
        ),
        # The whole material's curve: what is painted on some texels must not bend it.
        "tilt": MapSpec(
            "tilt", "1 - d for 0..90 degrees", layer_channels=1, low=0.0, high=1.0, per_texel=False, fixed=True,
        ),
        "masking": MapSpec(
            "masking", "roughness of Smith's masking along and across the turned tangent", layer_channels=2,
            low=0.0, constant=True,
        ),
    }
    specs = [MapSpec("diffuse", "diffuse colour", low=0.0, colour=True, linear=True)]
    specs += [every[part] for part in parts]
    if lobes > 1:
        weight = "weight of each specular map"
        specs.append(MapSpec(
            "index", weight, layers=numbers, layer_channels=1, low=0.0, high=1.0, linear=True, kind="weights",
        ))
    if lobes > 0:
        specular = "colour for each half vector, parabolic"
        specs.append(MapSpec("specular", specular, layers=numbers, low=0.0, per_texel=False, linear=True))
    return tuple(specs)


class Distribution(Material):
    """The artist's material: diffuse, and `lobes` specular maps that a mask, an index and a rotation place.

    `parts` names the optional maps, of which an absent one costs nothing: `normal` [3, H, W] (on a relief it refines
    the height's: slopes add up), `specular_mask` [1 or 3, H, W] (`mask_channels`), `fresnel` [1, H, W] (r0), `rotation`
    [2, H, W] (cosine and sine of the angle by which the lookup turns about the map's centre: filtered as a vector),
    `tilt` [1, 1, 91] (``1 - d`` for 0..90 degrees, d taking the place of the cosines in D) or, instead of it, `masking` [2]:
    a_u, a_v of Smith's height-correlated masking for GGX (Heitz 2014), whose denominator ``N.L sqrt((a_u v_x)^2 + (a_v v_y)^2
    + v_z^2) + N.V sqrt((a_u l_x)^2 + (a_v l_y)^2 + l_z^2)`` in the texel's turned frame stands for D. With neither, D is as
    printed, which cannot grow towards grazing as rough metal does. Always there: `diffuse` [3, H, W], and with `lobes` > 0 `specular` [3 lobes, S, S], row 0 at the top, h_y up; with `lobes` > 1 `index`
    [lobes, H, W], the weight of each. `fresnel_exponent` is Schlick's 5; 1 is the thesis's printed formula. `specular_spacing`
    of "dense" gives the specular maps more texels at their centres, for sharp highlights (`parabolic`); the thesis's are "even".
    """

    name = "distribution"
    glsl = "distribution.glsl"
    diffuse_map = "diffuse"

    def __init__(
        self, maps: Mapping[str, Tensor], *, lobes: int = 1, parts: Sequence[str] = ("specular_mask",),
        mask_channels: int = 1, fresnel_exponent: float = 5.0, specular_spacing: str = EVEN, **settings: Any,
    ) -> None:
        if not isinstance(lobes, int) or isinstance(lobes, bool) or not 0 <= lobes <= _MOST_LOBES:
            raise RangeError(message(self.name, "lobes", f"be a whole number from 0 to {_MOST_LOBES}", f"it is {lobes!r}"))
        check_positive(self.name, "fresnel_exponent", fresnel_exponent, "5 is Schlick's.")
        check_option(self.name, "mask_channels", mask_channels, (1, 3))
        check_option(self.name, "specular_spacing", specular_spacing, SPACINGS)
        for part in parts:
            check_option(self.name, "parts", part, DISTRIBUTION_PARTS)
        if all(part in parts for part in _DENOMINATORS):
            step = "Each takes the place of D: leave one out."
            raise RangeError(message(self.name, "parts", "hold tilt or masking", "they hold both", step))
        chosen = [part for part in DISTRIBUTION_PARTS if part in parts]
        self._kept_frame: tuple[list[Tensor], list[tuple], tuple[Tensor, Tensor | None]] | None = None
        options: dict[str, Any] = {"lobes": lobes, "parts": chosen, "mask_channels": mask_channels, "fresnel_exponent": fresnel_exponent}
        if specular_spacing != EVEN:
            options["specular_spacing"] = specular_spacing
        super().__init__(maps, **options, **settings)
        self._check_tables()

    @property
    def _lobes(self) -> int:
        return self.options["lobes"]

    @property
    def specular_spacing(self) -> str:
        """How the texels of the specular maps lie: "even" or "dense"."""
        return self.options.get("specular_spacing", EVEN)

    def _check_tables(self) -> None:
        if "specular" in self.maps and self.maps["specular"].shape[-1] != self.maps["specular"].shape[-2]:
            shape = tuple(self.maps["specular"].shape)
            raise ShapeError(message(self.name, "specular", "be square", f"it is {shape}"), map="specular")
        if "tilt" in self.maps and self.maps["tilt"].shape != (1, 1, TILT_SAMPLES):
            shape = tuple(self.maps["tilt"].shape)
            raise ShapeError(message(self.name, "tilt", f"be [1, 1, {TILT_SAMPLES}]", f"it is {shape}"), map="tilt")

    def own_specs(self) -> tuple[MapSpec, ...]:
        return distribution_specs(self._lobes, self.options["parts"], self.options["mask_channels"])

    def surface(self) -> Distribution:
        flat = super().surface()
        if not self.has_relief:
            return flat
        slopes = slopes_from_height(self.maps["height"], tiles=self.tiles)
        if "normal" in self.maps:
            slopes = slopes + slopes_from_normals(safe.normalise(self.maps["normal"]))
        parts = [part for part in DISTRIBUTION_PARTS if part in (*self.options["parts"], "normal")]
        return flat._unchecked({**flat.maps, "normal": normals_from_slopes(slopes)}, options={**self.options, "parts": parts})

    def with_rise(self, exponent: Tensor) -> Distribution:
        """Return a flat material of these very tensors whose Fresnel's exponent [1] a gradient reaches."""
        return self._unchecked(dict(self.maps), options={**self.options, "fresnel_exponent": exponent})

    @property
    def derives_normal(self) -> bool:
        return self.has_relief

    def from_surface(self, maps: Mapping[str, Tensor]) -> dict[str, Tensor]:
        found = super().from_surface(maps)
        if self.has_relief and "normal" in found:
            own = slopes_from_height(self.maps["height"], tiles=self.tiles)
            found["normal"] = normals_from_slopes(slopes_from_normals(maps["normal"]) - own)
        return found

    def value(self, light: Tensor, view: Tensor) -> Tensor:
        frame, normal = self._frame()
        if "masking" in self.maps and self._lobes:
            return self._masked(light, view, frame)
        n_dot_l, n_dot_v = (_dot(direction, normal).clamp(min=0) for direction in (light, view))
        if self._lobes == 0:
            return self.maps["diffuse"] * n_dot_l
        half, squared = _half(light, view)
        colour = self._looked_up(half if frame is None else combine(half, frame))
        a, b = (n_dot_l, n_dot_v) if "tilt" not in self.maps else (self._tilted(n_dot_l), self._tilted(n_dot_v))
        share = n_dot_l / torch.addcmul(a + (b + _GRAZING), a, b, value=-1)
        rise = self._rise(squared) if "fresnel" in self.maps else None
        return torch.addcmul(self._specular(colour, share, rise), self.maps["diffuse"], n_dot_l)

    def misfit(self, light: Tensor, view: Tensor, samples: Samples) -> Tensor | None:
        """Return the sum of the squared residuals of samples under directions [n, 3, 1, 1], a number.

        None where the compiled part does not serve: then it is what `value` gives, compared as `samples` say.
        """
        if "masking" not in self.maps or not self._lobes or not serves(light, view, *self.maps.values()):
            return None
        half, squared = _half(light, view)
        return misfit(light, view, half, self._for_smith(squared, self._frame()[0]), self.specular_spacing != EVEN, samples)

    def in_one_pass(self, light: Tensor, view: Tensor) -> Tensor | None:
        exponent = self.options["fresnel_exponent"]
        if "masking" not in self.maps or not self._lobes or isinstance(exponent, Tensor) or torch.is_grad_enabled():
            return None
        if light.shape[-2:] == (1, 1) and view.shape[-2:] == (1, 1):
            return None
        maps = self._for_smith(None, self._frame()[0])  # the rise is each texel's own
        return distribution_shown.shown(light, view, maps, self.specular_spacing != EVEN, exponent)

    def _for_smith(self, squared: Tensor | None, frame: Tensor | None) -> fast_distribution.Maps:
        """Return what the compiled part is given of the maps; `squared` are the lengths that Fresnel's rise comes from, None for no rise."""
        rise = self._rise(squared) if squared is not None and "fresnel" in self.maps else None
        own = {name: self.maps[name] for name in _FAST if name in self.maps}
        return fast_distribution.Maps(rise, frame, self.maps["masking"].square(), **own)

    def _masked(self, light: Tensor, view: Tensor, frame: Tensor | None) -> Tensor:
        """Return the value by Smith's denominator, of directions that are turned into the texels' frames."""
        half, squared = _half(light, view)  # before they are turned: rounding would decide it where they are opposite
        given = self._for_smith(squared, frame)
        found = fast_distribution.value(light, view, half, given, self.specular_spacing != EVEN, self._by_smith)
        return self._smiths(light, view, half, given.rise, frame, given.squares) if found is None else found

    def _by_smith(self, light: Tensor, view: Tensor, half: Tensor, given: fast_distribution.Maps) -> Tensor:
        """Return what `_smiths` does of other maps."""
        maps = {name: value for name, value in vars(given).items() if name in _FAST and value is not None}
        return self.sharing({**self.maps, **maps})._smiths(light, view, half, given.rise, given.frame, given.squares)

    def _smiths(
        self, light: Tensor, view: Tensor, half: Tensor, rise: Tensor | None, frame: Tensor | None, squares: Tensor
    ) -> Tensor:
        light, view, half = (d if frame is None else combine(d, frame) for d in (light, view, half))
        n_dot_l, denominator = smith_denominator(light, view, spread(squares, *light.shape[-2:]))
        share = n_dot_l / (denominator + _GRAZING)
        return torch.addcmul(self._specular(self._looked_up(half), share, rise), self.maps["diffuse"], n_dot_l)

    def _specular(self, colour: Tensor, share: Tensor, rise: Tensor | None) -> Tensor:
        """Return the specular part of what the half vector's `colour` gives: `share` is N.L / D, `rise` Fresnel's towards grazing."""
        maps = self.maps
        if rise is not None:
            share = share * (maps["fresnel"] + (1 - maps["fresnel"]) * rise)
        if "specular_mask" in maps:
            share = share * maps["specular_mask"]
        return colour * (math.pi * share)

    def _rise(self, squared: Tensor) -> Tensor:
        """Return how far reflectance rises to 1 where |L + V|^2 is `squared`."""
        grazing = (1 - torch.sqrt(squared) / 2).clamp(min=0)  # both have length 1: H.L is half of |L + V|
        exponent = self.options["fresnel_exponent"]
        if isinstance(exponent, Tensor):  # exp and log round alike in every thread's share, a power does not
            return (spread(exponent, *grazing.shape[-2:]) * grazing.clamp(min=_LEAST_RISE).log()).exp()
        if exponent >= 1:
            return grazing**exponent
        return safe.power(grazing, torch.tensor(exponent, dtype=grazing.dtype))  # its slope at 0 is infinite

    def _frame(self) -> tuple[Tensor | None, Tensor | None]:
        """Return tangent, bitangent and normal, turned by the rotation, as [xyz, 3, H, W], and the normal [xyz, 1, H, W].

        None stands for a frame, or a normal, that is the same everywhere.
        Without gradients they are kept for the next picture, as long as the maps are the same tensors, unchanged.
        """
        sources = [self.maps[name] for name in ("normal", "rotation") if name in self.maps]
        if not sources:
            return None, None
        # Tensors of inference mode have no version.
        if torch.is_grad_enabled() or any(tensor.is_inference() for tensor in sources):
            return self._make_frame()
        # `material.double()` puts other data into the same parameters, of the same version.
        versions = [(tensor._version, tensor.data_ptr(), tensor.dtype) for tensor in sources]
        known = self._kept_frame
        if known and known[1] == versions and all(a is b for a, b in zip(known[0], sources, strict=True)):
            return known[2]
        frame = self._make_frame()
        self._kept_frame = (sources, versions, frame)
        return frame

    def _make_frame(self) -> tuple[Tensor, Tensor | None]:
        normal, rotation = (self.maps[name] if name in self.maps else None for name in ("normal", "rotation"))
        frame = fast_frames.frames(normal, rotation, lambda normal, rotation: _frame_of(normal, rotation)[0])
        return _frame_of(normal, rotation) if frame is None else (frame, None if normal is None else frame[:, 2:])

    def _looked_up(self, local: Tensor) -> Tensor:
        """Return the specular colour [..., 3, h, w] for half vectors in the texels' frames."""
        lead, (rows, columns) = local.shape[:-3], local.shape[-2:]
        flat = local.reshape(-1, 3, rows, columns)
        place = places(flat, self.specular_spacing)
        grid = torch.stack((place[:, 0], -place[:, 1]), dim=-1)
        # Threads share out the batch: rows are cut into parts that look the same maps up.
        parts = math.gcd(len(flat) * rows, _PARTS)
        found = functional.grid_sample(
            self.maps["specular"][None].expand(parts, -1, -1, -1), grid.reshape(parts, -1, columns, 2),
            mode="bilinear", padding_mode="border", align_corners=False,
        ).transpose(0, 1)
        found = found.reshape(self._lobes, 3, *lead, rows, columns).movedim((0, 1), (-4, -3))
        if self._lobes == 1:
            return found.squeeze(-4)
        total = found[..., 0, :, :, :] * self.maps["index"][0]
        for number in range(1, self._lobes):
            total = total + found[..., number, :, :, :] * self.maps["index"][number]
        return total

    def _tilted(self, cosine: Tensor) -> Tensor:
        """Return d of a cosine: 1 - tilt at its angle, filtered linearly."""
        place = torch.rad2deg(safe.acos(cosine)).clamp(0, TILT_SAMPLES - 1)
        below = place.detach().floor().clamp(max=TILT_SAMPLES - 2).long()
        tilt = self.maps["tilt"].flatten()
        return 1 - torch.lerp(tilt[below], tilt[below + 1], place - below)


def _frame_of(given: Tensor | None, rotation: Tensor | None) -> tuple[Tensor, Tensor | None]:
    """Return tangent, bitangent and normal, turned by the rotation, as [xyz, 3, H, W], and the normal; one of both may not be there."""
    if given is None:
        assert rotation is not None
        normal = torch.zeros(3, *rotation.shape[1:], dtype=rotation.dtype)
        normal[2] = 1
    else:
        normal = safe.normalise(given)
    tangent, bitangent = frames.tangent_frame(normal)
    if rotation is not None:
        cosine, sine = safe.normalise(rotation).split(1)
        tangent, bitangent = cosine * tangent + sine * bitangent, cosine * bitangent - sine * tangent
    return torch.stack((tangent, bitangent, normal), dim=1), None if given is None else normal[:, None]


def _half(light: Tensor, view: Tensor) -> tuple[Tensor, Tensor]:
    """Return the half vector, and the squared length [..., 1, h, w] of the sum that it comes from."""
    # 2 + 2 L.V would cancel where they are nearly opposite; the bound keeps those of no half vector finite.
    total = light + view
    squared = (total * total).sum(dim=-3, keepdim=True).clamp(min=1e-24)
    return total * torch.rsqrt(squared), squared


def _dot(direction: Tensor, normal: Tensor | None) -> Tensor:
    """Return the cosine between directions and normals [3, 1, H, W], or with +z."""
    return direction[..., 2:3, :, :] if normal is None else combine(direction, normal)


def default_tilt(dtype: torch.dtype = torch.float32) -> Tensor:
    """Return the tilt curve [1, 1, 91] that makes d the cosine."""
    angle = torch.deg2rad(torch.arange(TILT_SAMPLES, dtype=torch.float64))
    return (1 - torch.cos(angle)).to(dtype)[None, None]
