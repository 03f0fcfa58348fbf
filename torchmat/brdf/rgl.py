"""Measured BRDFs of the RGL database: Dupuy & Jakob 2018, "An adaptive parameterization for efficient material
acquisition and rendering", as `powitacq` and Mitsuba's `measured` evaluate them."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from torchmat import frames, safe
from torchmat.brdf.base import Brdf
from torchmat.brdf.spectral import rgb_weights
from torchmat.brdf.tensor_file import TensorFile
from torchmat.brdf.warp import Grid, Slices, Warp, find_slices
from torchmat.errors import DataError, RangeError, ShapeError, check_finite, message

_STEP = "Take a .bsdf file of the RGL database, version 1.0."


def _to_unit_polar(polar: Tensor) -> Tensor:
    return safe.sqrt(polar * (2 / math.pi))


def _to_unit_azimuth(azimuth: Tensor) -> Tensor:
    turns = (azimuth + math.pi) / (2 * math.pi)
    return turns - turns.detach().floor()


class RglBrdf(Brdf):
    """A BRDF measured on the grid that its own highlight shapes.

    `polar` [T] and `azimuth` [P] in radians are the angles of incidence. Grids have azimuth on rows and the square root
    of the polar angle on columns: the distribution of normals `ndf` [rows, columns] and its projected area `sigma`, the
    visible normals `vndf` [P, T, rows, columns]; `colours` [P, T, 3, n, n], linear RGB, lie on the square that the
    visible normals are warped to. One azimuth, or two, means isotropic. `jacobian` False: `colours` are the whole value
    and not a factor of ndf / (4 sigma). An anisotropic file may hold half or a quarter of the azimuths.

    The data are not exactly reciprocal, and what the authors call incident is the view here, as in a path tracer: then
    the value needs no division by a cosine. Where colours are negative (spectra outside of the gamut of sRGB) they
    count as 0 in `shade`. Raises ShapeError when shapes do not fit, RangeError for NaN or Inf and for azimuths that
    span another part of a turn.
    """

    name = "rgl"

    def __init__(
        self, polar: Tensor, azimuth: Tensor, ndf: Tensor, sigma: Tensor, vndf: Tensor, colours: Tensor, *,
        jacobian: bool = True, description: str = "", measured_as: str = "RGB", dtype: torch.dtype = torch.float32,
    ) -> None:
        counts = (len(azimuth), len(polar))
        _check_shapes(counts, ndf, sigma, vndf, colours)
        for label, value in (("ndf", ndf), ("sigma", sigma), ("vndf", vndf), ("colours", colours)):
            check_finite(self.name, label, value)
        self.dtype = dtype
        self.isotropic = len(azimuth) <= 2
        self.description = description
        self.resolution = tuple(colours.shape)
        self.negative_share = float((colours < 0).double().mean())
        self.measured_as = measured_as
        self._axes = azimuth.to(dtype), polar.to(dtype)
        self._jacobian = jacobian
        self._ndf, self._sigma = Grid(ndf[None].to(dtype)), Grid(sigma[None].to(dtype))
        self._warp = Warp(vndf.flatten(0, 1), dtype)
        self._colours = Grid(colours.flatten(0, 1).movedim(1, -1).to(dtype))
        self._folds = 1 if self.isotropic else _folds(azimuth)

    def value(self, light: Tensor, view: Tensor) -> Tensor:
        """Return ``pi * f_r * cos(light)``, [..., 3, h, w]; smooth in the directions but for the edges of cells."""
        light, view = self._fold(light, view)
        half = frames.half_vector(light, view)
        polar, azimuth = frames.to_polar(view, dim=-3)
        half_polar, half_azimuth = frames.to_polar(half, dim=-3)
        azimuth = torch.where(azimuth > math.pi, azimuth - 2 * math.pi, azimuth)  # as the axes of the files have it
        x = _to_unit_polar(half_polar)
        y = _to_unit_azimuth(half_azimuth - azimuth if self.isotropic else half_azimuth)
        slices = find_slices(self._axes, (azimuth, polar))
        value = self._colours.at(*self._warp.invert(x, y, slices), slices).movedim(-1, -3)
        if self._jacobian:
            one = Slices((torch.zeros((), dtype=torch.long),), (torch.ones((), dtype=self.dtype),))
            area = self._sigma.at(_to_unit_polar(polar), _to_unit_azimuth(azimuth), one)
            value = value * safe.divide(self._ndf.at(x, y, one), 4 * area).unsqueeze(-3)
        return math.pi * value

    def _fold(self, light: Tensor, view: Tensor) -> tuple[Tensor, Tensor]:
        """Mirror both directions into the azimuths that were measured: below the x axis, or left of the y axis too."""
        if self._folds < 2:
            return light, view
        x, y = view[..., 0:1, :, :].detach(), view[..., 1:2, :, :].detach()
        flip_y = torch.where(torch.signbit(y), torch.ones_like(y), -torch.ones_like(y))
        flip_x = torch.where(torch.signbit(x), torch.ones_like(x), -torch.ones_like(x)) if self._folds == 4 else flip_y
        flip = torch.cat((flip_x, flip_y, torch.ones_like(flip_x)), dim=-3)
        return light * flip, view * flip


def _folds(azimuth: Tensor) -> int:
    """Return how many times the measured azimuths fit into a turn."""
    span = float(azimuth[-1] - azimuth[0])
    folds = round(2 * math.pi / span)
    if folds not in (1, 2, 4):
        fact = f"they span {math.degrees(span):.4g} degrees"
        raise RangeError(message("rgl", "azimuths", "span a turn, a half or a quarter", fact))
    return folds


def _check_shapes(counts: tuple[int, int], ndf: Tensor, sigma: Tensor, vndf: Tensor, colours: Tensor) -> None:
    for label, value in (("ndf", ndf), ("sigma", sigma)):
        if value.ndim != 2 or min(value.shape) < 2:
            fact = f"it is {tuple(value.shape)}"
            raise ShapeError(message("rgl", label, "be [rows, columns], at least 2 x 2", fact))
    if vndf.ndim != 4 or vndf.shape[:2] != counts or min(vndf.shape[2:]) < 2:
        requirement = f"be [{counts[0]}, {counts[1]}, rows, columns], at least 2 x 2"
        raise ShapeError(message("rgl", "vndf", requirement, f"it is {tuple(vndf.shape)}"))
    if colours.ndim != 5 or colours.shape[:3] != (*counts, 3) or min(colours.shape[3:]) < 2:
        requirement = f"be [{counts[0]}, {counts[1]}, 3, rows, columns], at least 2 x 2"
        raise ShapeError(message("rgl", "colours", requirement, f"it is {tuple(colours.shape)}"))


def _floats(source: TensorFile, name: str, dimensions: int) -> np.ndarray:
    found = source.array(name)
    if found.dtype != np.float32 or found.ndim != dimensions:
        fact = f"it is {found.dtype} of shape {found.shape}"
        requirement = f"be float32 with {dimensions} dimensions"
        raise DataError(message(str(source.path), f"field {name!r}", requirement, fact, _STEP))
    return found


def _axis(source: TensorFile, name: str) -> Tensor:
    axis = torch.from_numpy(np.array(_floats(source, name, 1)))
    if not bool(torch.isfinite(axis).all()) or bool((axis.diff() <= 0).any()):
        fact = f"it is {axis[:9].tolist()}"
        raise DataError(message(str(source.path), f"field {name!r}", "be finite and increasing", fact, _STEP))
    return axis


def _tensor(source: TensorFile, name: str, dimensions: int, least: float = -math.inf) -> Tensor:
    found = torch.from_numpy(np.array(_floats(source, name, dimensions)))
    wrong = ~torch.isfinite(found) | (found < least)
    if bool(wrong.any()):
        requirement = "be finite" if least == -math.inf else f"be finite and at least {least:g}"
        first = tuple(wrong.nonzero()[0].tolist())
        fact = f"{int(wrong.sum())} of {found.numel()} values are not, first at index {first}"
        raise DataError(message(str(source.path), f"field {name!r}", requirement, fact, _STEP))
    return found


def _colours(source: TensorFile) -> Tensor:
    """Return [P, T, 3, n, n] linear RGB; spectra are integrated here, once, because the value is linear in them."""
    if "rgb" in source.fields:
        return _tensor(source, "rgb", 5)
    spectra, wavelengths = _floats(source, "spectra", 5), _axis(source, "wavelengths")
    if spectra.shape[2] != len(wavelengths):
        fact = f"its shape is {spectra.shape} and there are {len(wavelengths)} wavelengths"
        raise DataError(message(str(source.path), "field 'spectra'", "have a plane per wavelength", fact, _STEP))
    try:
        weights = rgb_weights(wavelengths.double()).float().numpy()
    except ValueError as error:
        fact = str(error)
        raise DataError(message(str(source.path), "field 'wavelengths'", "cover visible light", fact, _STEP)) from error
    # Slice by slice: the spectra of an anisotropic material take hundreds of megabytes.
    found = np.empty((*spectra.shape[:2], 3, *spectra.shape[3:]), np.float32)
    for place in np.ndindex(*spectra.shape[:2]):
        found[place] = np.tensordot(weights, spectra[place], axes=1)
    if not np.isfinite(found).all():
        fact = f"they give {int((~np.isfinite(found)).sum())} colours that are NaN or Inf"
        raise DataError(message(str(source.path), "field 'spectra'", "be finite", fact, _STEP))
    return torch.from_numpy(found)


def _measured_as(source: TensorFile) -> str:
    if "rgb" in source.fields:
        return "RGB"
    wavelengths = source.array("wavelengths")
    return f"{len(wavelengths)} wavelengths from {wavelengths[0]:g} to {wavelengths[-1]:g} nm"


def read_rgl(path: str | Path, dtype: torch.dtype = torch.float32) -> RglBrdf:
    """Read a `.bsdf` file of the RGL database, isotropic or anisotropic, RGB or spectral.

    Spectra become linear sRGB under D65, so that a white reflectance of 1 reads 1 in each channel (`spectral`). Raises
    DataError, which names the file, when it is not such a file or not whole.
    """
    source = TensorFile(path)
    jacobian = source.array("jacobian")
    if jacobian.dtype != np.uint8 or jacobian.shape != (1,):
        fact = f"it is {jacobian.dtype} of shape {jacobian.shape}"
        raise DataError(message(str(path), "field 'jacobian'", "be one uint8", fact, _STEP))
    words = source.array("description").tobytes() if "description" in source.fields else b""
    description = words.decode("utf-8", "backslashreplace").rstrip("\0")
    parts = (
        _axis(source, "theta_i"), _axis(source, "phi_i"), _tensor(source, "ndf", 2, 0), _tensor(source, "sigma", 2, 0),
        _tensor(source, "vndf", 4, 0), _colours(source),
    )
    try:
        return RglBrdf(
            *parts, jacobian=bool(jacobian[0]), description=description, measured_as=_measured_as(source), dtype=dtype
        )
    except (RangeError, ShapeError) as error:
        raise DataError(message(str(path), "the fields", "fit together", str(error).rstrip("."), _STEP)) from error
