"""Material: maps, and a pure function from light and view to colour."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar, Self

import torch
from torch import Tensor, nn

from torchmat.errors import RangeError, ShapeError, about_map, check_known_keys, check_option, message
from torchmat.geometry.rays import look_up
from torchmat.models.cutout import Cutout
from torchmat.models.indirect import check_between
from torchmat.models.relief_maps import COMMON_MAPS, FAST, OPACITY, RELIEF_MAPS, RELIEFS, covered, shade_points, shade_texels
from torchmat.models.storable import Storable
from torchmat.models.storage import STORAGES, MapSpec, StoredAs, check_map, check_stored
from torchmat.repeatable import wide_product


class Material(Storable):
    """A surface whose appearance is held by texture maps.

    Subclasses add keyword options, kept in `options`, and implement `own_specs` and `value`; `glsl` names the twin of
    `value` by which pages draw it (`torchmat/web/README.md`). Every model may have three
    more maps: `height` [1, H, W], in texture widths over the plane of the images, puts the surface on a relief with
    parallax and shadow, `ambient` [3, H, W] is the light that reaches a texel there by way of others, and `opacity`
    [1, H, W], 0 to 1, cuts the surface out: it scales all values, and a hole is black, for what lies behind is not seen.

    Args:
        maps: the parameters by name: [C, H, W] per texel, [C, rows, columns] for shared tables, [C] for constants, with the
            ranges that `specs` declares.
        storage: how textures are stored: "half", "float", "png8", "png16", "tiff8" or "tiff16".
        tiles: whether the surface repeats.
        stored: maps that are stored smaller or in another way, by name (`stored_at`); None is none.
        cutout: which part of a larger texture the maps are; None is all of it.
        relief: how a height is followed: "fast", texel by texel, or "fine", between texels, with shadow where each ray ends.
        options: what the subclass asks for.
    """

    name: ClassVar[str]
    isotropic: bool = False
    reciprocal: ClassVar[bool] = False
    diffuse_map: ClassVar[str | None] = None  # the map of what a texel sends of light that arrives from everywhere
    glsl: ClassVar[str | Path | None] = None  # file of the twin of `value` in GLSL, beside the module of its class
    unsure: ClassVar[str | None] = None  # why its maps have no standard errors of their own, where they have none
    bright_at_horizon: bool = False  # its value need not go to 0 as the light sets: pictures of objects fade it

    def __init__(
        self, maps: Mapping[str, Tensor], *, storage: str = "half", tiles: bool = True,
        stored: Mapping[str, StoredAs] | None = None, cutout: Cutout | None = None, relief: str = FAST, **options: Any,
    ) -> None:
        super().__init__()
        check_option(self.name, "storage", storage, STORAGES)
        check_option(self.name, "relief", relief, RELIEFS)
        check_known_keys(f"{self.name} options", options, _option_names(type(self)))
        self.storage = storage
        self.tiles = tiles
        self.cutout = cutout
        self.relief = relief
        self._check_cutout()
        self.options = options
        self._parts = tuple(one for one in COMMON_MAPS if one.name in maps)
        specs = self.specs()
        check_known_keys(self.name, maps, [spec.name for spec in specs])
        if "ambient" in maps and "height" not in maps:
            step = "Use on_relief(height, ambient)."
            raise ShapeError(message(self.name, "height", "be there for an ambient map", "it is not", step), map="ambient")
        missing = [spec.name for spec in specs if spec.name not in maps]
        if missing:
            fact = f"{', '.join(missing)} is missing"
            raise ShapeError(message(self.name, "maps", f"hold {', '.join(s.name for s in specs)}", fact))
        for name, value in maps.items():
            if not isinstance(value, Tensor) or not value.is_floating_point():
                fact = f"it is {value.dtype if isinstance(value, Tensor) else type(value).__name__}"
                raise RangeError(message(self.name, name, "be a floating-point tensor", fact), map=name)
        self.maps = nn.ParameterDict({spec.name: nn.Parameter(maps[spec.name].detach()) for spec in specs})
        self._check_shapes(specs)
        check_between(self.name, maps, self.diffuse_map)
        check_stored(self.name, stored or {}, specs, self.size)
        self.stored = {name: one for name, one in (stored or {}).items() if one != StoredAs()}
        self._compiled: Callable[..., Tensor] | None = None  # `value` of other maps, by `compiled`

    def _check_cutout(self) -> None:
        if self.cutout is not None and self.tiles and not self.cutout.is_whole:
            step = "Give tiles=False; the cutout itself says whether the whole texture repeats."
            raise RangeError(message(self.name, "a cutout", "not repeat", "tiles is true", step))

    def _check_shapes(self, specs: tuple[MapSpec, ...]) -> None:
        size = None
        for spec in specs:
            with about_map(spec.name):
                value = self.maps[spec.name]
                dimensions = 1 if spec.constant else 3
                if value.ndim != dimensions or value.shape[0] != spec.channels or 0 in value.shape:
                    shape = f"[{spec.channels}]" if spec.constant else f"[{spec.channels}, H, W]"
                    raise ShapeError(message(self.name, spec.name, f"be {shape}", f"it is {tuple(value.shape)}"))
                self._check_dtype(spec.name, value.dtype)
                check_map(self.name, spec, value)
                if spec.per_texel and not spec.constant:
                    size = size or tuple(value.shape[-2:])
                    if tuple(value.shape[-2:]) != size:
                        fact = f"it is {tuple(value.shape[-2:])} and other maps are {size}"
                        raise ShapeError(message(self.name, spec.name, "have the size of the other maps", fact))

    def _check_dtype(self, name: str, dtype: torch.dtype) -> None:
        wanted = self.dtype
        if dtype != wanted:
            step = "Convert with .to(dtype); one call has one precision."
            raise RangeError(message(self.name, name, f"be {wanted} as the maps are", f"it is {dtype}", step))

    def own_specs(self) -> tuple[MapSpec, ...]:
        """Return what each map of the model itself is."""
        raise NotImplementedError

    def specs(self) -> tuple[MapSpec, ...]:
        """Return what each map is, those of the relief among them where there is one."""
        return (*self.own_specs(), *self._parts)

    def in_codes(self) -> Self | None:
        """Return the flat material whose value is the code that a screen shows, which the maps sum to; None where they do not."""
        return None

    def value(self, light: Tensor, view: Tensor) -> Tensor:
        """Return the value for light and view above the horizon; what it says below is never used."""
        raise NotImplementedError

    @property
    def size(self) -> tuple[int, int]:
        """Height and width in texels."""
        for spec in self.specs():
            if spec.per_texel and not spec.constant:
                height, width = self.maps[spec.name].shape[-2:]
                return height, width
        return 1, 1

    @property
    def whole_size(self) -> tuple[int, int]:
        """Height and width, in texels like its own, of the texture that the material is a part of."""
        return self.size if self.cutout is None else self.cutout.whole_size(self.size)

    @property
    def dtype(self) -> torch.dtype:
        """The precision of the maps: all have one."""
        return next(iter(self.maps.values())).dtype

    @property
    def texels(self) -> int:
        """Height times width."""
        return math.prod(self.size)

    def shade(self, light: Tensor, view: Tensor) -> Tensor:
        """Return ``pi * f_r * cos(light)``, linear RGB, never negative.

        `light`, `view`: unit vectors [..., 3, H, W], one per texel, or [..., 3, 1, 1], one per image; they broadcast.
        The result is [..., 3, H, W]. Exactly 0, with gradient 0, where the light or the view is not above z = 0. With a
        height, texel (i, j) of the result is what the view's ray through that place of the plane meets.
        Raises ShapeError when the directions do not fit the maps.
        """
        self._check_directions(light, view)
        if self.has_relief:
            return shade_texels(self, light, view)
        return covered(self.maps, self._shade_flat(light, view))

    def shade_at(self, uv: Tensor, light: Tensor, view: Tensor) -> Tensor:
        """Return the value [..., 3, h, w] at texture coordinates `uv` [2, h, w] of the plane of the images.

        u runs to the right and v up, each texture spans 0..1 and repeats if the material tiles (else its border goes
        on). `light`, `view`: [..., 3, h, w] or [..., 3, 1, 1].
        """
        if not self.has_relief:
            return self.at(uv).shade(light, view)
        self._check_uv("shade_at", uv)
        self._check_directions(light, view, (uv.shape[-2], uv.shape[-1]))
        return shade_points(self, self._placed(uv).to(self.dtype), light, view)

    def in_one_pass(self, light: Tensor, view: Tensor) -> Tensor | None:
        """Return what is shown [..., 3, H, W] of `value`, by the compiled part; None where that is for plain torch.

        That is the value, not below 0, and 0 where light or view is not above the horizon, without gradients.
        """
        return None

    def _shade_flat(self, light: Tensor, view: Tensor) -> Tensor:
        if self._compiled is None and _goes_with_value(type(self)):
            found = self.in_one_pass(light, view)
            if found is not None:
                return found
        above = (light[..., 2:3, :, :] > 0) & (view[..., 2:3, :, :] > 0)
        if bool(above.all()):
            value = self._evaluate(light, view).clamp(min=0)
            # A model that does not look at the view gives one picture for all of them.
            return torch.broadcast_tensors(value, above)[0].contiguous()
        # Below the horizon the model sees the pole instead, where it is finite, so that the gradient is 0 and not NaN.
        pole = torch.zeros(3, 1, 1, dtype=light.dtype)
        pole[2] = 1
        value = self._evaluate(torch.where(above, light, pole), torch.where(above, view, pole))
        return torch.where(above, value.clamp(min=0), torch.zeros((), dtype=value.dtype))

    def _evaluate(self, light: Tensor, view: Tensor) -> Tensor:
        if self._compiled is None:
            return self.value(light, view)
        return self._compiled(dict(self.maps.items()), light, view)

    def _check_directions(self, light: Tensor, view: Tensor, size: tuple[int, int] | None = None) -> None:
        height, width = size or self.size
        for name, direction in (("light", light), ("view", view)):
            fits = direction.ndim >= 3 and direction.shape[-3] == 3
            fits = fits and tuple(direction.shape[-2:]) in ((1, 1), (height, width))
            if not fits:
                requirement = f"be [..., 3, 1, 1] or [..., 3, {height}, {width}]"
                step = "Vectors lie on dimension -3; `at` brings the maps to another size."
                raise ShapeError(message(f"{self.name}.shade", name, requirement, f"it is {tuple(direction.shape)}", step))
            self._check_dtype(name, direction.dtype)

    def with_maps(self, **maps: Tensor) -> Self:
        """Return a material with some maps replaced."""
        return self._like({**self.maps, **maps})

    def cut_from(self, cutout: Cutout | None) -> Self:
        """Return the same maps as a part of a larger texture."""
        return self._like(dict(self.maps), cutout=cutout)

    def repeating(self, tiles: bool) -> Self:
        """Return the same material, repeating at its borders or not."""
        return self._like(dict(self.maps), tiles=tiles)

    def with_relief(self, relief: str) -> Self:
        """Return the same maps on a relief that is followed as said: "fast" or "fine"."""
        return self if relief == self.relief else self._like(dict(self.maps), relief=relief)

    @property
    def has_relief(self) -> bool:
        """Whether the surface has a height map."""
        return any(part.name == "height" for part in self._parts)

    def on_relief(self, height: Tensor, ambient: Tensor | None = None, indirect: Tensor | None = None) -> Self:
        """Return the material on a relief: `height` [1, H, W] in texture widths, `ambient` [3, H, W] or `indirect` [1]."""
        parts = {"height": height} if ambient is None else {"height": height, "ambient": ambient}
        if indirect is not None:
            parts["indirect"] = indirect
        kept = {spec.name: self.maps[spec.name] for spec in self.specs() if spec not in RELIEF_MAPS}
        return self._like({**kept, **parts})

    def without_relief(self) -> Self:
        """Return the material with neither height nor ambient light, for good: its normals are those of its own maps."""
        return self._like({spec.name: self.maps[spec.name] for spec in self.own_specs()}) if self.has_relief else self

    def surface(self) -> Self:
        """Return the material without its relief and opacity: what one texel does with its light."""
        return self.sharing({spec.name: self.maps[spec.name] for spec in self.own_specs()})

    @property
    def derives_normal(self) -> bool:
        """Whether the normals of `surface` are made of the height."""
        normal = self.surface().maps.get("normal") if self.has_relief else None
        return normal is not None and normal is not self.maps.get("normal")

    def from_surface(self, maps: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Return the own maps of the material for `maps` of its `surface`: without what its height alone says."""
        return {name: value for name, value in maps.items() if name in self.maps}

    def sharing(self, maps: dict[str, Tensor]) -> Self:
        """Return a flat material of these very tensors, not of copies: gradients pass through to what they came from.

        They are not checked: what is no longer finite shows in the result.
        """
        parts = tuple(one for one in (OPACITY,) if one.name in maps)
        return self._unchecked(dict(maps), _parts=parts, stored={}, cutout=None)

    def _unchecked(self, maps: dict[str, Tensor] | nn.ParameterDict, **fields: Any) -> Self:
        """Return a material that differs from this one in these maps and fields: neither checked nor copied."""
        other = type(self).__new__(type(self))
        nn.Module.__init__(other)
        own = {name: value for name, value in vars(self).items() if name not in vars(other)}
        for name, value in {**own, **fields, "maps": maps}.items():
            setattr(other, name, value)
        return other

    def _check_uv(self, method: str, uv: Tensor) -> None:
        if uv.ndim != 3 or uv.shape[0] != 2:
            raise ShapeError(message(f"{self.name}.{method}", "uv", "be [2, H, W]", f"it is {tuple(uv.shape)}"))

    def at(self, uv: Tensor) -> Self:
        """Return the flat material as seen at texture coordinates `uv` [2, H, W]: a material of that size.

        u runs to the right and v up, each texture spans 0..1 and repeats if the material tiles (else its border
        goes on). Maps are filtered bilinearly, indices take the nearest texel. Of a material with a relief the view
        decides what is seen: use `shade_at`, or `surface().at(uv)`.
        """
        self._check_uv("at", uv)
        if self.has_relief:
            step = "Use shade_at(uv, light, view), or surface().at(uv) without the relief."
            raise RangeError(message(f"{self.name}.at", "the material", "be flat", "it has a height map", step))
        uv, found = self._placed(uv), {}
        for spec in self.specs():
            value = self.maps[spec.name]
            found[spec.name] = value if spec.constant or not spec.per_texel else self._look_up(value, uv, spec.index)
        return self.sharing(found)

    def _placed(self, uv: Tensor) -> Tensor:
        """Return coordinates of the whole texture as those of these maps."""
        return uv if self.cutout is None else self.cutout.place(uv)

    def _look_up(self, value: Tensor, uv: Tensor, nearest: bool) -> Tensor:
        return look_up(value[None], uv[None].to(value.dtype), self.tiles, "nearest" if nearest else "bilinear")[0]


def combine(weights: Tensor, layers: Tensor) -> Tensor:
    """Return the sum over K of weights [..., K, h, w] times layers [K, C, H, W] as [..., C, H, W].

    With one weight per image (h = w = 1) this is one matrix product; with one per texel it is summed plane by plane.
    """
    count, channels, height, width = layers.shape
    if weights.shape[-2:] == (1, 1):
        lead = weights.shape[:-3]
        flat = wide_product(weights.reshape(-1, count), layers.reshape(count, -1))
        return flat.reshape(*lead, channels, height, width)
    total = weights[..., 0:1, :, :] * layers[0]
    for index in range(1, count):
        total = total + weights[..., index : index + 1, :, :] * layers[index]
    return total


_WITH_VALUE: dict[type[Material], bool] = {}  # what was found of each class


def _goes_with_value(kind: type[Material]) -> bool:
    """Return whether a class's `in_one_pass` is that of its `value`: a class that changes the latter alone has none."""
    if kind not in _WITH_VALUE:
        first = next(base for base in kind.__mro__ if "value" in vars(base) or "in_one_pass" in vars(base))
        _WITH_VALUE[kind] = "in_one_pass" in vars(first)
    return _WITH_VALUE[kind]


_OPTION_NAMES: dict[type[Material], tuple[str, ...]] = {}  # what was found of each class


def _option_names(kind: type[Material]) -> tuple[str, ...]:
    """Return the keywords that the constructors of a model and of its bases take."""
    if kind not in _OPTION_NAMES:
        found: dict[str, None] = {}
        for base in kind.__mro__:
            if issubclass(base, Material) and "__init__" in vars(base):
                parameters = inspect.signature(base.__init__).parameters.values()
                found |= {p.name: None for p in parameters if p.kind is p.KEYWORD_ONLY}
        _OPTION_NAMES[kind] = tuple(found)
    return _OPTION_NAMES[kind]
