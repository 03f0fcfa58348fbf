"""The experiment of a small network over an editable material: its factor, one for all texels, times what the maps give.

``python scripts/bench/correction.py [--data leather stones] [--set effort=0.5]``. The maps stay what they are, so what is
painted on them keeps its meaning: a diffuse colour painted red is red under the factor too, which is measured besides. Each
row has the errors of the material as exported, without and with the factor, and the network's at the same relief.
"""

from __future__ import annotations

import argparse
import math
import time
from typing import Any

import torch
from measure import save
from protocol import load
from torch import Tensor

import torchmat as tm
from torchmat.fitting.evaluate import predict
from torchmat.metrics import SampleErrors
from torchmat.models import Material
from torchmat.models.neural import angles
from torchmat.text_file import parse_value

HIDDEN, STEPS, IMAGES, RATE, MOST = 16, 1500, 8, 5e-3, 0.7  # MOST: of the factor's logarithm, so that no texel is lost


class Factor(torch.nn.Module):
    """exp of a network of what a texel's `latent` numbers, light and view say, near 1 at first."""

    def __init__(self, latent: int, size: tuple[int, int], seed: int) -> None:
        super().__init__()
        generator = torch.Generator().manual_seed(seed)
        self.latent = torch.nn.Parameter(0.1 * torch.randn(latent, *size, generator=generator))
        self.layers = torch.nn.ModuleList([torch.nn.Conv2d(a, b, 1) for a, b in ((latent + 8, HIDDEN), (HIDDEN, HIDDEN), (HIDDEN, 3))])
        for layer in self.layers:
            torch.nn.init.normal_(layer.weight, std=1 / math.sqrt(layer.in_channels), generator=generator)
            torch.nn.init.zeros_(layer.bias)
        torch.nn.init.zeros_(self.layers[-1].weight)

    def forward(self, light: Tensor, view: Tensor) -> Tensor:
        known = angles(light, view).expand(-1, -1, *self.latent.shape[-2:])
        found = torch.cat((self.latent.expand(len(known), -1, -1, -1), known), dim=1)
        for layer in self.layers[:-1]:
            found = layer(found).relu()
        return (MOST * torch.tanh(self.layers[-1](found) / MOST)).exp()


def corrected(material: Material, btf: tm.Btf, train: Tensor, latent: int, seed: int) -> Factor:
    """Fit the factor to training samples, on the root of the values, by Adam."""
    factor = Factor(latent, (btf.height, btf.width), seed)
    adam = torch.optim.Adam(factor.parameters(), RATE)
    generator = torch.Generator().manual_seed(seed)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(adam, STEPS)
    seen = predict(material, btf, train).half()
    for _ in range(STEPS):
        some = torch.randint(len(train), (IMAGES,), generator=generator)
        rows = train[some]
        light, view = (d[rows][:, :, None, None].float() for d in (btf.light, btf.view))
        values = seen[some].float() * factor(light, view)
        loss = ((values + 1e-3) ** (1 / 2.2) - (btf.images(rows) + 1e-3).clamp(min=1e-3) ** (1 / 2.2)).square().mean()
        adam.zero_grad()
        loss.backward()
        adam.step()
        schedule.step()
    return factor


@torch.no_grad()
def errors(material: Material, btf: tm.Btf, rows: Tensor, factor: Factor | None = None) -> dict[str, float]:
    """Return dB and relative error of some samples, with a factor or without."""
    found = SampleErrors()
    for some in rows.split(32):
        light, view = (d[some][:, :, None, None].float() for d in (btf.light, btf.view))
        values = predict(material, btf, some) * (1 if factor is None else factor(light, view))
        target = btf.images(some)
        looked_at = torch.zeros(len(some), dtype=torch.bool)
        found.add(values, target, btf.valid(some), btf.saturated(some, target), looked_at)
    report = found.report()
    return {"dB": report["psnr_db"], "error": report["relative_error"]}


@torch.no_grad()
def redness(material: Material, btf: tm.Btf, rows: Tensor, factor: Factor | None) -> float:
    """Return the share of red in what is seen after the diffuse colour has been painted red."""
    name = material.diffuse_map
    assert name is not None
    red = torch.tensor([0.8, 0.02, 0.02])[:, None, None].expand_as(material.maps[name])
    painted, total = material.with_maps(**{name: red.clone()}), torch.zeros(3)
    for some in rows.split(32):
        light, view = (d[some][:, :, None, None].float() for d in (btf.light, btf.view))
        values = predict(painted, btf, some) * (1 if factor is None else factor(light, view))
        total += values.sum(dim=(0, 2, 3))
    return float(total[0] / total.sum())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", nargs="+", default=["leather", "stones", "wallpaper"])
    parser.add_argument("--latent", nargs="+", type=int, default=[2, 4])
    parser.add_argument("--set", nargs="*", default=[], help="options of the material's fit, such as effort=0.5")
    given = parser.parse_args()
    options: dict[str, Any] = {name: parse_value(value) for name, value in (one.split("=", 1) for one in given.set)}
    rows = []
    for data in given.data:
        btf, _ = load(data)
        result = tm.fit(btf, "distribution", geometry="recover", measure=False, progress=False, **options)
        material, split = result.material.as_exported(), result.split
        row = {"data": data, "bytes": material.bytes_per_texel, "without": errors(material, btf, split.held_out)}
        row["red"] = redness(material, btf, split.held_out, None)
        for latent in given.latent:
            start = time.perf_counter()
            factor = corrected(material, btf, split.train, latent, 0)
            row[f"with {latent} more bytes"] = {
                **errors(material, btf, split.held_out, factor), "seconds": time.perf_counter() - start,
                "red": redness(material, btf, split.held_out, factor),
            }
        rows.append(row)
        print(row, flush=True)
        save("correction", rows)


if __name__ == "__main__":
    main()
