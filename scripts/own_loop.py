"""Train a material's maps by a loop of one's own: torch.optim on its parameters, through `shade` and through `tm.render`.

The loss, the optimiser and the order of the samples are yours here; `tm.fit(btf, material, objective=...)` is the short
way when only the loss is. Run it with `python scripts/own_loop.py --out out/own`.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor

import torchmat as tm
from torchmat.colour import linear_to_srgb
from torchmat.models import Lambert
from torchmat.progress import progress

LIGHTS = [(-0.4, 0.5, 0.77), (0.7, -0.2, 0.5), (0.1, 0.9, 0.4), (0.0, 0.0, 1.0)]


def shown(values: Tensor) -> Tensor:
    """Return values as a display shows them; what is too bright for it is white, and black has a slope."""
    return linear_to_srgb(values.clamp(1e-4, 1))


def into_range(material: tm.Material) -> None:
    """Bring maps back to where they may be: a step of an optimiser knows nothing of that."""
    with torch.no_grad():
        for spec in material.specs():
            if spec.low is not None:
                material.maps[spec.name].clamp_(spec.low, spec.high)


def grey(btf: tm.Btf) -> tm.Material:
    """Return a grey material of the images' size, which knows nothing of them."""
    up = torch.tensor([0.0, 0.0, 1.0])[:, None, None].expand(3, btf.height, btf.width)
    return Lambert({"albedo": torch.full((3, btf.height, btf.width), 0.3), "normal": up.clone()})


def loss_of_images(material: tm.Material, btf: tm.Btf, rows: Tensor) -> Tensor:
    """Return the error of some images, with a gradient in the maps through `shade`."""
    light, view = (directions[rows][:, :, None, None] for directions in (btf.light, btf.view))
    return (shown(material.shade(light, view)) - shown(btf.images(rows))).square().mean()


def loss_of_picture(material: tm.Material, scene: tm.Scene, wanted: Tensor) -> Tensor:
    """Return the error of a picture of an object, with a gradient in the maps through `tm.render`."""
    return (shown(tm.render(material, scene, gradient=True)) - wanted).square().mean()


def train(
    material: tm.Material, btf: tm.Btf, rows: Tensor, steps: int, rate: float,
    pictures: Sequence[tuple[tm.Scene, Tensor]] = (), batch: int = 24,
) -> list[float]:
    """Descend on random images, and on the pictures in turn where there are any; return the loss of each step."""
    optimiser = torch.optim.Adam(material.parameters(), lr=rate)
    generator, losses = torch.Generator().manual_seed(0), []
    for step in progress(range(steps), "training"):
        loss = loss_of_images(material, btf, rows[torch.randint(len(rows), (batch,), generator=generator)])
        if pictures:
            loss = loss + 10 * loss_of_picture(material, *pictures[step % len(pictures)])
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        into_range(material)
        losses.append(float(loss.detach()))
    return losses


def pictures_of(btf: tm.Btf, size: int) -> list[tuple[tm.Scene, Tensor]]:
    """Return scenes of a teapot under one light each, and how the measured images look on it."""
    scenes = [tm.Scene("teapot", [light], view=(0.3, 0.25, 1), size=size, repeat=2) for light in LIGHTS]
    return [(scene, shown(tm.render(tm.RawBtf(btf), scene))) for scene in scenes]


def main(arguments: list[str] | None = None) -> None:
    """Train a grey material on the images, then on pictures of a teapot too; say what each brought and save it."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--data", default=None, help="folder, zip or file of images (default: the sample)")
    parser.add_argument("--out", type=Path, default=Path("out/own"), help="folder of the material")
    parser.add_argument("--steps", type=int, default=300, help="steps on images, and a third as many on images and pictures")
    parser.add_argument("--size", type=int, default=160, help="rows and columns of the pictures")
    given = parser.parse_args(arguments)
    btf = tm.load_btf(given.data or tm.sample_path())
    split = tm.split_samples(btf)
    material = grey(btf)
    pictures = pictures_of(btf, given.size)
    for name, settings in (
        ("shade", {"steps": given.steps, "rate": 0.02}),
        ("shade and render", {"steps": max(1, given.steps // 3), "rate": 0.005, "pictures": pictures}),
    ):
        losses = train(material, btf, split.train, **settings)
        with torch.no_grad():
            picture = sum(float(loss_of_picture(material, *one)) for one in pictures) / len(pictures)
        held_out = tm.evaluate(material, btf, split.held_out, perceptual=False).report["psnr_db"]
        print(f"{name:16s} {len(losses):4d} steps, loss {losses[0]:.5f} -> {losses[-1]:.5f}; "
              f"pictures {picture:.6f}, held-out images {held_out:.2f} dB")
    print(f"material   {tm.save_material(material, given.out)}")


if __name__ == "__main__":
    main()
