"""What torch.compile buys: shading, and one step of a fit, plain and compiled, with the seconds that compiling takes."""

from __future__ import annotations

import time
from typing import Any

import torch
from measure import SHARED, timed

import torchmat as tm
from torchmat.models import Material, compiled
from torchmat.models.edit import resized

_SIZE, _BATCH, _REPEATS = 512, 12, 11
_MODELS: dict[str, dict[str, Any]] = {
    "lambert": {}, "hsh": {}, "phong_srf": {"residual": "half_light"},
    "distribution": {"geometry": "flat", "lobes": 1, "fresnel": True, "rotation": True, "effort": 0.05},
}


def _directions(*shape: int) -> torch.Tensor:
    """Return random directions [..., 3, H, W] above the horizon for `shape` (3, ..., H, W)."""
    found = torch.randn(*shape, generator=torch.Generator().manual_seed(shape[-1])).movedim(0, -3)
    found[..., 2, :, :] = found[..., 2, :, :].abs() + 0.3
    return found / found.norm(dim=-3, keepdim=True)


def _shading(name: str, material: Material, what: str, light: torch.Tensor, view: torch.Tensor) -> dict[str, Any]:
    with torch.no_grad():
        plain, exact = timed(lambda: material.shade(light, view), _REPEATS), material.shade(light, view)
        torch._dynamo.reset()  # it keeps eight programs of one function, and gives up on the ninth
        fast = compiled(material)
        start = time.perf_counter()
        found = fast.shade(light, view)
        waited = time.perf_counter() - start
        quick = timed(lambda: fast.shade(light, view), _REPEATS)
    return _row(name, what, plain, quick, waited, float((found - exact).abs().max() / exact.abs().max()))


def _step(name: str, material: Material) -> dict[str, Any]:
    """A gradient of the squared error of a batch of images, as a descent takes it at each step."""
    light = _directions(3, _BATCH, 1, 1)
    view = light.flip(0)

    def gradient(one: Material) -> torch.Tensor:
        return torch.cat([g.flatten() for g in torch.autograd.grad(one.shade(light, view).square().mean(), _floats(one))])

    torch._dynamo.reset()
    plain, exact, fast = timed(lambda: gradient(material), _REPEATS), gradient(material), compiled(material)
    start = time.perf_counter()
    found = gradient(fast)
    waited = time.perf_counter() - start
    quick = timed(lambda: gradient(fast), _REPEATS)
    return _row(name, f"gradient, {_BATCH} images", plain, quick, waited, float((found - exact).abs().max() / exact.abs().max()))


def _floats(material: Material) -> list[torch.Tensor]:
    return [value for value in material.maps.values() if value.requires_grad]


def _row(name: str, what: str, plain: dict, quick: dict, waited: float, difference: float) -> dict[str, Any]:
    gained = plain["seconds"] - quick["seconds"]
    row = {
        "model": name, "what": what, "plain (s)": plain, "compiled (s)": quick, "compiling (s)": waited,
        "times faster": plain["seconds"] / quick["seconds"], "pays after": round(waited / gained) if gained > 0 else None,
        "largest difference": difference,
    }
    print(name, what, f"{plain['seconds']:.4f} -> {quick['seconds']:.4f} s, compiling {waited:.1f} s, {difference:.1e}", flush=True)
    return row


def measure() -> list[dict[str, Any]]:
    """Every model's pictures of 512 x 512 with one light and with one for each pixel, and a step of a fit of 64 x 64."""
    path, rows = SHARED / "reference" / "leather.zip", []
    if not path.exists():
        print(f"skipped: {path.name} is absent")
        return rows
    btf = tm.load_btf(path)
    for name, options in _MODELS.items():
        small = tm.fit(btf, name, measure=False, **options).material
        large = resized(small, (_SIZE, _SIZE))
        for what, size in (("one light and view", 1), ("one for each pixel", _SIZE)):
            rows.append(_shading(name, large, what, _directions(3, size, size), _directions(3, size, size).flip(-1, -2)))
        rows.append(_step(name, small))
    return rows
