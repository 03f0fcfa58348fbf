"""A fit as a file: the TOML config and what it may hold."""

from __future__ import annotations

import copy
import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from torchmat.btf.split import HOLDOUT_WAYS
from torchmat.errors import RangeError, check_known_keys, check_option, message
from torchmat.fitting.between import AUTO as AUTO_LIGHT
from torchmat.fitting.between import WAYS
from torchmat.fitting.data_settings import DATA_KEYS, check_data_settings
from torchmat.fitting.geometry import check_word, is_path
from torchmat.fitting.recipe import recipe_of
from torchmat.fitting.recipes import AUTO, RECIPES, default_options, resolve_options
from torchmat.geometry.tiling import AUTO_TILES, check_tiles
from torchmat.fitting.wanted import Target, make_target
from torchmat.models.relief_maps import RELIEFS
from torchmat.models.uncertainty import check_sure
from torchmat.places import right_place
from torchmat.shipped import find_file, shipped_names
from torchmat.text_file import parse_value, read_toml


@dataclass(frozen=True)
class FitConfig:
    """Everything that decides a fit, apart from the data itself.

    Args:
        model: name of a registered model, or "auto" for the choice among them.
        options: the model's options by name (`describe_model`); those left out have their defaults.
        holdout: share of the samples that the fit never sees and is measured on, in [0, 1).
        holdout_by: what is held out: "pair", "light", "view", "both" or "arc" (`split_samples`).
        seed: seed of the split and of the solvers, from 0.
        test: path of other images of the same texels that are measured and never fitted, or "sample" for the random directions
            beside the embedded one; None is none.
        geometry: "flat", "recover", or the path of a height map; None is the model's own way (`Recipe.geometry`), and
            of the model "auto" leaves the relief to the data.
        relief: how the surface is followed where it has a height, "fast" or "fine" (`Material`); None is fine for a whole fit
            of one model on a relief that is recovered, else fast.
        finish: whether a fit on a fine relief ends with steps on the pictures themselves, where that pays.
        indirect: how light between the texels of a relief is told: "map", an ambient map; "radiosity", by the relief and the
            diffuse colours; "none"; or "auto", what a finish shows to be best.
        tiles: whether the surface repeats at its borders; "auto" asks the images (`tiling_of`).
        target: what is wanted: of "auto" `error` (relative), `psnr` (dB), `bytes` a texel, `highlights` (relative
            error there, 0.1); of any model `seconds`.
        tile_size: side, in texels, of the tiles that are fitted one after the other; 0 is no wish.
        memory_mb: what a fit may take, in MB, by tiles if need be; 0 is no wish.
        uncertainty: whether standard errors of the maps are found beside them (`tm.uncertainty`).
        data: keywords of `load_btf`, used by the command line.
    """

    model: str = "phong_srf"
    options: dict[str, Any] = field(default_factory=dict)
    holdout: float = 0.2
    holdout_by: str = "pair"
    seed: int = 0
    test: str | None = None
    geometry: str | None = None
    relief: str | None = None
    finish: bool = True
    indirect: str = AUTO_LIGHT
    tiles: bool | str = AUTO_TILES
    target: dict[str, Any] = field(default_factory=dict)
    tile_size: int = 0
    memory_mb: float = 0.0
    uncertainty: bool = False
    data: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        resolve_options(self.model, self.options)
        if self.geometry is not None:
            check_word("config", self.geometry, self.model == AUTO)
        if self.relief is not None:
            check_option("config", "relief", self.relief, RELIEFS)
        check_option("config", "indirect", self.indirect, WAYS)
        make_target("config [target]", self.target)
        for name in ("tile_size", "memory_mb"):
            if not 0 <= getattr(self, name) < math.inf:
                step = "0 leaves it open."
                raise RangeError(message("config", name, "be at least 0", f"it is {getattr(self, name)}", step))
        if self.uncertainty and self.model != AUTO:
            check_sure("config", recipe_of(self.model).material)
        others = [name for name in ("error", "psnr", "bytes", "highlights") if self.target.get(name) is not None]
        if others and self.model != AUTO:
            step = f'Fit "{AUTO}" to let the model be chosen, or leave {others[0]} out.'
            raise RangeError(message("fit", others[0], f'be wanted of the model "{AUTO}"', f"it is {self.model}", step))
        check_data_settings(self.data)
        check_tiles("config", self.tiles)
        check_option("config", "holdout_by", self.holdout_by, HOLDOUT_WAYS)
        if not 0 <= self.holdout < 1:
            step = "It is the share that is held out; 0.2 is usual."
            raise RangeError(message("config", "holdout", "lie in [0, 1)", f"it is {self.holdout}", step))

    @property
    def geometry_word(self) -> str:
        """What a report says of the geometry: flat, recover, given for a height map, or auto for the data's choice."""
        if self.geometry is None:
            return AUTO if self.model == AUTO else recipe_of(self.model).geometry
        return "given" if is_path(self.geometry) else self.geometry

    def read_as(self, keywords: Mapping[str, Any]) -> FitConfig:
        """Return this config with keywords of `load_btf` in place of those of its `data`; those of the cache are none."""
        chosen = {name: value for name, value in keywords.items() if name in DATA_KEYS}
        return dataclasses.replace(self, data={**self.data, **chosen})


def _typed(where: str, table: dict[str, Any]) -> dict[str, Any]:
    kinds: dict[str, Any] = {
        "model": str, "options": dict, "holdout": (int, float), "holdout_by": str, "seed": int, "test": str, "geometry": str,
        "relief": str, "finish": bool, "indirect": str, "tiles": (bool, str), "target": dict, "tile_size": int,
        "memory_mb": (int, float), "uncertainty": bool, "data": dict,
    }
    for key, value in table.items():
        if not isinstance(value, kinds[key]) or (isinstance(value, bool) and key not in ("tiles", "finish", "uncertainty")):
            wanted = getattr(kinds[key], "__name__", "number")
            raise RangeError(message(where, key, f"be a {wanted}", f"it is {value!r}"))
    return table


def make_config(table: dict[str, Any], where: str = "config") -> FitConfig:
    """Return the FitConfig of a parsed table; unknown keys are errors that suggest the nearest one.

    Every error begins with `where`, the file that the table comes from.
    """
    model = table.get("model", FitConfig.model)
    check_known_keys(where, table, [f.name for f in dataclasses.fields(FitConfig)], lambda key: _place(key, model))
    given = _typed(where, table)
    try:
        return FitConfig(**given)
    except RangeError as error:
        raise RangeError(str(error) if where == "config" else f"{where}: {error}") from error


def load_config(name: str | Path | Mapping[str, Any], overrides: Sequence[str] = ()) -> FitConfig:
    """Read a TOML config, or take a model with its defaults.

    Args:
        name: a text with a suffix or a folder, or a Path, is a TOML file: as it stands, or where there is none, the
            config of that name that ships with the package ("phong_srf_half_light.toml"). Every other text is the name
            of a model, or "auto". A table is a config that was read already.
        overrides: texts such as ``seed=3``, ``target.psnr=25``, ``options.terms=16`` or in short ``terms=16``: a key that
            no config has is an option of the model. A value that is not TOML counts as a plain string.

    Raises DataError or RangeError, naming the file or the key.
    """
    if isinstance(name, Mapping):
        table, where = copy.deepcopy(dict(name)), "config"
    elif isinstance(name, Path) or is_config(name):
        path = find_file(name)
        table, where = read_toml(path, "the config"), str(path)
    else:
        check_option("fit", "model", name, (*RECIPES, AUTO, *shipped_names()))
        table, where = {"model": name}, "config"
    for text in overrides:
        _override(table, text)
    return make_config(table, where)


def is_config(name: object) -> bool:
    """Return whether a text names the file of a config rather than a model."""
    return isinstance(name, str) and (bool(Path(name).suffix) or len(Path(name).parts) > 1)


def _place(key: str, model: object) -> str:
    """Return where a key belongs that stands beside the model, as `right_place` says it."""
    options = {name: tuple(recipe.options) for name, recipe in RECIPES.items()}
    fields = [field.name for field in dataclasses.fields(FitConfig)]
    tables = {"target": [field.name for field in dataclasses.fields(Target)], "data": DATA_KEYS}
    return right_place(key, str(model), options, fields, tables)


def _override(table: dict[str, Any], text: str) -> None:
    name, separator, value = text.partition("=")
    if not separator or not name.strip():
        step = "For example --set residual=half_light."
        raise RangeError(message("--set", repr(text), "be KEY=VALUE", "it has no key or no '='", step))
    *parents, key = name.strip().split(".")
    fields = [field.name for field in dataclasses.fields(FitConfig)]
    if not parents and key not in fields:
        options = default_options(table.get("model", FitConfig.model))
        check_known_keys("--set", [key], (*fields, *options), lambda key: _place(key, table.get("model", FitConfig.model)))
        parents = ["options"]
    for parent in parents:
        table = table.setdefault(parent, {})
        if not isinstance(table, dict):
            raise RangeError(message("--set", repr(text), "name a key inside a table", f"{parent} is a value"))
    table[key] = parse_value(value)
