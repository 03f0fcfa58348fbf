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
    """Let what is built by parts, which hardly a test of the choice is about, take a tenth of a second."""
    monkeypatch.setattr(parts, "EFFORT", 0.002)
    with_parts(monkeypatch, (), effort=0.002, specular_size=8)
    recipe = RECIPES["microfacet"]
    ladder = replace(recipe.ladder, parts=(), bare={**recipe.ladder.bare, "effort": 0.002})
    monkeypatch.setitem(RECIPES, "microfacet", replace(recipe, ladder=ladder))


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


def lacquer(size: int = 6, alpha: float = 0.08) -> Btf:
    """Return a dark red with a waving albedo under a smooth coat: highlights far above white, at the mirror angle alone.

    The coat is GGX with Schlick's Fresnel of 0.04 and height-correlated Smith masking, for all texels the same.
    """
    around = hemisphere(((0, 1), (25, 6), (50, 8), (75, 10)))
    light, view = all_pairs(around, around)
    half = (light + view) / np.linalg.norm(light + view, axis=1, keepdims=True)
    n_l, n_v, n_h, a2 = light[:, 2], view[:, 2], half[:, 2], alpha**2
    density = a2 / (n_h**2 * (a2 - 1) + 1) ** 2
    visible = 0.5 / (n_l * np.sqrt(n_v**2 * (1 - a2) + a2) + n_v * np.sqrt(n_l**2 * (1 - a2) + a2))
    coat = density * visible * (0.04 + 0.96 * (1 - (view * half).sum(1)) ** 5) * n_l
    turn = 2 * np.pi * np.arange(size) / size
    albedo = np.array([0.35, 0.05, 0.04])[:, None, None] * (1 + 0.15 * np.sin(turn)[:, None] * np.cos(turn))
    images = n_l[:, None, None, None] * albedo + coat[:, None, None, None]
    return Btf.from_tensors(noisy(images), light.astype(np.float32), view.astype(np.float32))
