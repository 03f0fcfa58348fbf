"""Small BTFs whose smallest material is known, for the tests of the automatic choice."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from tests.support import all_pairs, hemisphere

from torchmat import Btf
from torchmat.fitting.choice import parts
from torchmat.fitting.recipe import RECIPES

LIGHT, VIEW = all_pairs(hemisphere(((0, 1), (25, 5), (50, 7), (70, 7))), hemisphere(((0, 1), (30, 3), (60, 4))))
ONE_VIEW = hemisphere(((10, 4), (30, 8), (50, 12), (65, 12)))
COLOUR = np.array([0.6, 0.4, 0.2])


def with_parts(monkeypatch, parts, **bare):
    """Let the distribution material be built of these parts, from the fewest with these options besides."""
    recipe = RECIPES["distribution"]
    ladder = replace(recipe.ladder, parts=tuple(parts), bare={**recipe.ladder.bare, **bare})
    monkeypatch.setitem(RECIPES, "distribution", replace(recipe, ladder=ladder))


def shorten_fits(monkeypatch) -> None:
    """Let the distribution material, which hardly a test of the choice is about, take a tenth of a second."""
    monkeypatch.setattr(parts, "EFFORT", 0.002)
    with_parts(monkeypatch, (), effort=0.002, specular_size=8)


def colours(size: int, detail: bool = True) -> np.ndarray:
    """Return albedos [3, H, W]: noise, or one wave across."""
    if detail:
        return np.random.default_rng(3).uniform(0.2, 0.8, (3, size, size))
    turn = 2 * np.pi * (np.arange(size) + 0.5) / size
    return np.broadcast_to(0.5 + 0.25 * np.cos(turn + np.arange(3)[:, None, None]), (3, size, size)).copy()


def noisy(images: np.ndarray, noise: float = 0.002) -> np.ndarray:
    """Return images with a little noise of their own, without which no error has a floor."""
    return np.maximum(0, images + noise * np.random.default_rng(5).standard_normal(images.shape)).astype(np.float32)


def diffuse(albedo: np.ndarray, light: np.ndarray = LIGHT, view: np.ndarray = VIEW, noise: float = 0.002) -> Btf:
    """Return albedo [3, H, W] times the cosine of the light."""
    images = noisy(light[:, 2, None, None, None] * albedo, noise)
    return Btf.from_tensors(images, light.astype(np.float32), view.astype(np.float32))


def constant(size: int = 12) -> Btf:
    """Return one colour everywhere."""
    return diffuse(np.broadcast_to(COLOUR[:, None, None], (3, size, size)))


def glossy(albedo: np.ndarray) -> Btf:
    """Return albedo times the cosine, and one Blinn lobe for all texels."""
    half = LIGHT + VIEW
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    images = LIGHT[:, 2, None, None, None] * albedo + 0.4 * half[:, 2, None, None, None] ** 25
    return Btf.from_tensors(noisy(images), LIGHT.astype(np.float32), VIEW.astype(np.float32))


def bumpy(size: int = 12) -> Btf:
    """Return Lambert texels, each of its own colour and normal, under one view."""
    random = np.random.default_rng(7)
    normal = np.stack((*random.uniform(-0.4, 0.4, (2, size, size)), np.ones((size, size))))
    normal /= np.linalg.norm(normal, axis=0)
    cosine = np.maximum(0, np.einsum("nk,khw->nhw", ONE_VIEW, normal))
    view = np.broadcast_to([0.0, 0.0, 1.0], ONE_VIEW.shape).astype(np.float32)
    return Btf.from_tensors(noisy(cosine[:, None] * colours(size)), ONE_VIEW.astype(np.float32), view)


def directions() -> tuple[torch.Tensor, torch.Tensor]:
    """Return a few lights and views [n, 3, 1, 1]."""
    return tuple(torch.from_numpy(rows[::9].astype(np.float32))[:, :, None, None] for rows in (LIGHT, VIEW))
