"""Small random materials of every registered model, for tests that hold for all of them.

A new model is found through `MATERIALS`; it must add example options here, and its tables if texels share any.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from tests.support import all_pairs, assert_close, hemisphere

from torchmat.models import MATERIALS, Material
from torchmat.models.distribution import DISTRIBUTION_PARTS, default_tilt
from torchmat.models.storage import MapSpec

EXAMPLE_OPTIONS: dict[str, list[dict]] = {
    "texture": [{}],
    "lambert": [{}],
    "ptm": [{}, {"space": "srgb"}],
    "lptm": [{}, {"space": "srgb"}],
    "hsh": [{"terms": 4}, {"terms": 9, "space": "srgb"}, {"terms": 16}],
    "phong_srf": [
        {"residual": residual, "base": base}
        for residual in ("half", "half_light", "quadratic") for base in ("phong", "ashikhmin_shirley")
    ],
    "pca": [{"components": 3}],
    "local_pca": [{"clusters": 3, "components": 2}],
    "rbf": [{"components": 2}, {"components": 3, "space": "srgb"}],
    "distribution": [
        {"lobes": 0, "parts": []},
        {"lobes": 1, "parts": ["specular_mask"]},
        {"lobes": 2, "parts": [part for part in DISTRIBUTION_PARTS if part != "masking"], "mask_channels": 3},
        {"lobes": 1, "parts": ["masking"]},
        {"lobes": 1, "parts": ["normal", "specular_mask", "fresnel", "rotation", "masking"]},
        {"lobes": 2, "parts": ["normal", "rotation", "masking"], "specular_spacing": "dense"},
    ],
    "shading_map": [
        {"slices": 4, "brdf": "phong"}, {"slices": 2, "brdf": "table"},
        {"slices": 3, "brdf": "ggx", "overflow": "scale", "azimuths": 4, "ambient_level": 0.05},
    ],
    "sphere_images": [{"angles_deg": [0.0, 45.0, 90.0]}, {"angles_deg": [0.0, 37.25, 75.0, 120.0, 150.0]}],
    "microfacet": [
        {"parts": []}, {"parts": ["normal", "anisotropy", "f90"]}, {"parts": ["sheen", "rolloff", "layered"]},
        {"parts": ["normal", "anisotropy", "f90", "coat", "sheen", "rolloff", "layered"]},
    ],
    "neural": [{"latent": 3, "hidden": 5, "layers": 1}, {"latent": 2, "hidden": 4, "layers": 3}],
}
# A microfacet fit that has no parts to decide, for tests that want any small fit.
PLAIN = dict.fromkeys(("anisotropy", "f90", "coat", "sheen", "rolloff", "layered"), False)
LOBES = {
    "phong": (0.4, 0.3, 0.2, 0.3, 0.2, 0.25, math.log(20.0)),
    "ashikhmin_shirley": (0.4, 0.3, 0.2, 0.08, 0.1, 0.05, math.log(40.0), math.log(10.0), 0.4),
}
_RINGS = ((0, 1), (50, 3))  # 16 pairs: more than the 12 neighbours, and few enough for central differences



def _said(value: object) -> str:
    return "+".join(map(str, value)) or "none" if isinstance(value, list) else str(value)


# The cases of the contract: (model name, options) of every registered model.
CASES = [
    pytest.param(name, options, id="-".join([name, *map(_said, (options or {}).values())]))
    for name in MATERIALS for options in EXAMPLE_OPTIONS.get(name, [None])
]


class _Found(Exception):
    pass


_SPECS: dict[tuple[type[Material], str], tuple[MapSpec, ...]] = {}  # what was found, by class and options


def specs_of(name: str, options: dict) -> tuple[MapSpec, ...]:
    """Return the specs of a model with options, before any map exists."""
    key = MATERIALS[name], repr(options)
    if key not in _SPECS:
        _SPECS[key] = _asked(name, options)
    return _SPECS[key]


def _asked(name: str, options: dict) -> tuple[MapSpec, ...]:
    class Asked(MATERIALS[name]):
        def specs(self):
            raise _Found(super().specs())

    try:
        Asked({}, **options)
    except _Found as found:
        return found.args[0]
    raise AssertionError(f"{name} does not ask for its specs")


def known_directions() -> torch.Tensor:
    """Return projected directions [4, 1, n] of a small measurement."""
    light, view = all_pairs(hemisphere(_RINGS), hemisphere(_RINGS))
    return torch.from_numpy(np.concatenate((light[:, :2], view[:, :2]), axis=1).T[:, None].copy())


def _table(name: str, options: dict, spec: MapSpec) -> torch.Tensor:
    directions = known_directions()
    samples = directions.shape[-1]
    if spec.name == "directions":
        return directions
    if (name, spec.name) == ("phong_srf", "lobe"):
        return torch.tensor(LOBES[options.get("base", "phong")], dtype=torch.float64)
    if (name, spec.name) == ("pca", "weight"):
        return torch.rand(spec.channels, 1, samples, dtype=torch.float64)
    if (name, spec.name) == ("local_pca", "reflectance"):
        return torch.rand(spec.channels, options["clusters"], samples, dtype=torch.float64)
    if name == "rbf":
        return _spline(spec)
    if (name, spec.name) == ("distribution", "specular"):
        return 0.4 * torch.rand(spec.channels, 6, 6, dtype=torch.float64)
    if name == "microfacet":
        return torch.tensor({"sheen_roughness": [0.6], "rolloff": [-0.2, 0.3]}[spec.name], dtype=torch.float64)
    if (name, spec.name) == ("distribution", "masking"):
        return torch.tensor([0.2, 0.6], dtype=torch.float64)
    if (name, spec.name) == ("distribution", "tilt"):
        # Not the default, and off both ends of its range, where differences could not be taken.
        return 0.05 + 0.85 * default_tilt(torch.float64) + 0.05 * torch.rand(1, 1, 91, dtype=torch.float64)
    if (name, spec.name) == ("shading_map", "lobe"):
        last = math.log({"phong": 20.0, "ggx": 0.3}[options["brdf"]])
        return torch.tensor((0.4, 0.3, 0.2, 0.03, 0.02, 0.04, last), dtype=torch.float64)
    if (name, spec.name) == ("shading_map", "brightest"):
        return torch.tensor([0.5], dtype=torch.float64)
    if (name, spec.name) == ("shading_map", "reflectance"):
        return 0.05 + 0.1 * torch.rand(1, 2, 36, dtype=torch.float64)
    if name == "neural":
        return _network(options)[int(spec.name.removeprefix("layer_"))]
    if (name, spec.name) == ("sphere_images", "images"):
        return 0.4 * torch.rand(spec.channels, 6, 6, dtype=torch.float64)
    if (name, spec.name) == ("sphere_images", "turn"):
        # The paper's one curve with few pictures; with more, one for either side of each interval.
        count = len(options["angles_deg"])
        return torch.rand(1, 1 if count < 4 else 2 * (count - 1), 3 if count < 4 else 5, dtype=torch.float64)
    pytest.fail(f"tests/models/examples.py has no example of the shared map {spec.name!r} of model {name!r}")


def _spline(spec: MapSpec) -> torch.Tensor:
    """Return a table of splines over five knots that bend little around mostly positive planes."""
    if spec.name == "half_scale":
        return torch.tensor([0.3], dtype=torch.float64)
    if spec.name == "knots":
        return torch.cat([directions(5, seed=seed).T for seed in (11, 12)])[:, None]
    if spec.name == "reach":
        return torch.tensor([-9.0, 9.0], dtype=torch.float64).repeat(spec.channels, 1, 1)
    table = 0.02 * torch.randn(spec.channels, 1, 14, dtype=torch.float64)
    table[..., 5] += 0.8
    return table


def _network(options: dict) -> list[torch.Tensor]:
    """Return tables [1, outputs, inputs + 1] of a network whose last biases keep most of its output positive."""
    hidden = [options["hidden"]] * options["layers"]
    widths = zip([*hidden, 3], [options["latent"] + 8, *hidden], strict=True)
    tables = [torch.randn(1, outputs, inputs + 1, dtype=torch.float64) / inputs**0.5 for outputs, inputs in widths]
    tables[-1][..., -1] = 0.6
    return tables


def make_maps(name: str, options: dict | None, height: int = 2, width: int = 3, dtype=torch.float64, seed: int = 0) -> dict:
    """Return random maps of a model, drawn in float64 so that both precisions see the same numbers."""
    if options is None:
        pytest.fail(f"tests/models/examples.py has no example options for model {name!r}")
    torch.default_generator.manual_seed(seed)
    maps = {}
    for spec in specs_of(name, options):
        shape = (spec.channels, height, width)
        if spec.constant or not spec.per_texel:
            value = _table(name, options, spec)
        elif spec.index:
            value = torch.randint(int(spec.low or 0), int(spec.high) + 1, shape).double()
        elif spec.name == "normal":
            tilt = torch.rand(2, height, width, dtype=torch.float64) - 0.5
            value = torch.nn.functional.normalize(torch.cat((tilt, torch.ones_like(tilt[:1]))), dim=0)
        elif spec.kind == "rotation":
            angle = 2 * math.pi * torch.rand(1, height, width, dtype=torch.float64)
            value = torch.cat((torch.cos(angle), torch.sin(angle)))
        elif (name, spec.name) == ("distribution", "index"):
            value = torch.rand(shape, dtype=torch.float64)
            value = value / value.sum(dim=0)
        elif spec.name.endswith("roughness"):
            value = 0.4 + 0.5 * torch.rand(shape, dtype=torch.float64)  # what is smooth is 0 nearly everywhere
        else:
            # Mostly positive, so that most of what is shaded is not clamped.
            low = -0.1 if spec.low is None else spec.low
            high = 0.4 if spec.high is None else spec.high
            value = low + (high - low) * torch.rand(shape, dtype=torch.float64)
        maps[spec.name] = value.to(dtype)
    return maps


def make(
    name: str, options: dict | None, height: int = 2, width: int = 3, dtype=torch.float64, seed: int = 0, **settings
) -> Material:
    """Return a small random material of a model."""
    maps = make_maps(name, options, height, width, dtype, seed)
    return MATERIALS[name](maps, **settings, **options)


def directions(count: int, dtype=torch.float64, seed: int = 1, lowest: float = 0.1) -> torch.Tensor:
    """Return random unit directions [count, 3] with z above `lowest`."""
    random = np.random.default_rng(seed)
    z = random.uniform(lowest, 1, count)
    azimuth = random.uniform(0, 2 * np.pi, count)
    radius = np.sqrt(1 - z * z)
    rows = np.stack((radius * np.cos(azimuth), radius * np.sin(azimuth), z), axis=1)
    return torch.from_numpy(rows).to(dtype)


def per_image(rows: torch.Tensor) -> torch.Tensor:
    """Return rows [n, 3] as [n, 3, 1, 1]."""
    return rows[:, :, None, None]


def per_texel(height: int, width: int, dtype=torch.float64, seed: int = 1, lowest: float = 0.1) -> torch.Tensor:
    """Return random directions [3, H, W]."""
    return directions(height * width, dtype, seed, lowest).T.reshape(3, height, width).contiguous()


def assert_same(actual: torch.Tensor, expected: torch.Tensor, tolerance: float | None = None) -> None:
    """Compare as `assert_close` does, values that may carry a graph."""
    assert_close(actual.detach(), expected.detach(), tolerance)
