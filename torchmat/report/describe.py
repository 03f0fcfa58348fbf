"""What an input is, in words: for `torchmat info`."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchmat import frames
from torchmat.brdf import Brdf, MerlBrdf, RglBrdf, load_brdf
from torchmat.brdf.albedo import albedo_of, values_over_lights
from torchmat.btf import Btf
from torchmat.create.textures import find_textures
from torchmat.errors import DataError
from torchmat.images import read_picture
from torchmat.material_io import load_material, load_uncertainty
from torchmat.material_io.files import reader_of
from torchmat.material_io.folder import MANIFEST
from torchmat.material_io.gltf_material import has_material
from torchmat.models.storage import StoredAs
from torchmat.report.tables import number, object_text, text_table

_ENTRIES = 8  # of a table that is still shown
_ALBEDO_DEG = (0, 45, 75)
_STEPS = 128  # the albedo of Lambert is then right to 2e-4


def is_material(path: str | Path) -> bool:
    """Return whether `path` is a material folder, a shading map's ``.3pm`` file, or coefficients of an RTI program."""
    return os.path.isfile(Path(path) / MANIFEST) or (reader_of(path) is not None and os.path.exists(path))


def _polar_range(directions: Tensor) -> str:
    polar = torch.rad2deg(frames.to_polar(directions.double())[0])
    return f"{len(directions)}, polar {float(polar.min()):.1f} to {float(polar.max()):.1f} degrees"


def _read_as(btf: Btf) -> str:
    return "linear RGB, from CIE XYZ" if btf.source.xyz else btf.encoding


def describe_btf(btf: Btf) -> str:
    """Return a table: kind, samples, directions, size, range, clipped share, how full the grid of pairs is."""
    low, high = btf.value_range
    grid = len(btf.lights) * len(btf.views)
    source = btf.source
    rows: list[list[Any]] = [
        ["source", source.path],
        ["kind", source.kind],
        ["samples (images)", len(btf)],
        ["size", f"{btf.height} x {btf.width} texels"],
        *([["object", object_text(btf.source.mask, btf.object_share)]] if btf.mask is not None else []),
        ["lights", _polar_range(btf.lights)],
        ["views", _polar_range(btf.views)],
        *([["near", btf.near.sentence()]] if btf.near is not None else []),
        ["pairs covered", f"{len(btf)} of {grid} ({100 * len(btf) / grid:.1f} %)"],
        ["stored as", f"{btf.stored_dtype}, read as {_read_as(btf)}, exposure {number(btf.exposure)}"],
        ["linear range", f"{number(low)} to {number(high)}"],
        ["clipped share", f"{100 * btf.clipped_share:.4g} %"],
        ["invalid share", f"{100 * btf.invalid_share:.4g} %"],
        ["loaded in", f"{number(source.load_seconds)} s{' (from the cache)' if source.from_cache else ''}"],
    ]
    return text_table(["", ""], rows)


def describe_material(path: str | Path) -> str:
    """Return tables of a material: model, options, bytes, and the range of each map."""
    material = load_material(path)
    height, width = material.size
    facts = [
        ["material", str(path)],
        ["model", material.name],
        ["options", ", ".join(f"{k}={_brief(v)}" for k, v in material.options.items()) or "none"],
        ["size", f"{height} x {width} texels"],
        ["bytes per texel (+ shared)", f"{number(material.bytes_per_texel)} (+ {material.shared_bytes})"],
    ]
    if material.stored:
        facts.append(["stored otherwise", ", ".join(map(_stored_text, material.stored, material.stored.values()))])
    maps = []
    for spec in material.specs():
        value = material.maps[spec.name].detach()
        maps.append([spec.name, spec.meaning, str(tuple(value.shape)), float(value.min()), float(value.max())])
    return text_table(["", ""], facts) + "\n\n" + text_table(["map", "meaning", "shape", "least", "largest"], maps) + _errors_text(path)


def _errors_text(path: str | Path) -> str:
    """Return a table of the standard errors that stand in a material folder, behind an empty line; nothing where none do."""
    found = load_uncertainty(path) if os.path.isfile(Path(path) / MANIFEST) else None
    if found is None:
        return ""
    rows = [[name, one["median"], one["largest"], one["span"]] for name, one in found.as_table()["maps"].items()]
    return "\n\n" + text_table(["standard error of", "usual", "largest", "range of the map"], rows)


def describe_own_material(path: str | Path) -> str:
    """Return tables of the material that a mesh brings along, behind an empty line; nothing where it brings none.

    One that cannot be read is said in a line: the mesh is a mesh even so.
    """
    try:
        return f"\n\n{describe_material(path)}" if has_material(path) else ""
    except DataError as error:
        return f"\n\nmaterial   not read: {error}"


def describe_textures(path: str | Path) -> str:
    """Return a table of a folder of textures: which file each map is read from, its size, depth and range; and the rest.

    Ranges are those of the codes, 0 to 1, or of the numbers in a file of floating point. Raises DataError, which names
    the file, as `find_textures` does.
    """
    found = find_textures(path)
    rows = []
    for kind, file in found.rows():
        texture = found.files[kind]
        pixels, _ = read_picture(texture.path)
        values = pixels if texture.channel is None else pixels[:, :, texture.channel : texture.channel + 1]
        full = np.iinfo(values.dtype).max if np.issubdtype(values.dtype, np.integer) else 1
        span = [number(float(end) / full) for end in (values.min(), values.max())]
        rows.append([kind, file, f"{pixels.shape[0]} x {pixels.shape[1]}", f"{pixels.shape[2]} x {pixels.dtype}", *span])
    table = text_table(["map", "file", "size", "channels", "least", "largest"], rows)
    lines = [f"textures   {path}", "", table, "", "torchmat create makes a material of them.", *found.notes()]
    return "\n".join(lines)


def _brief(value: object) -> object:
    """Return an option, or of a long table its length."""
    return f"{len(value)} entries" if isinstance(value, list) and len(value) > _ENTRIES else value


def _stored_text(name: str, stored: StoredAs) -> str:
    size = "numbers" if stored.numbers else f"{stored.size[0]} x {stored.size[1]}" if stored.size else ""
    return " ".join(filter(None, (name, size, stored.storage)))


def describe_brdf(path: str | Path) -> str:
    """Return a table of a measured BRDF: kind, resolution, range of values, albedo at three angles, missing samples.

    The albedo is the share of even white light from all sides that leaves toward a view at that polar angle; the range
    is taken over the directions that it is summed over. Raises DataError, which names the file, as `load_brdf` does.
    """
    brdf = load_brdf(path)
    rows = [["source", str(path)], *_kind_rows(brdf)]
    low, high, albedos = math.inf, 0.0, []
    for polar_deg in _ALBEDO_DEG:
        value, weight = values_over_lights(brdf, math.radians(polar_deg), steps=_STEPS)
        albedos.append(albedo_of(value, weight))
        found = value[(weight > 0).expand(3, -1, -1)]
        low, high = min(low, float(found.min())), max(high, float(found.max()))
    rows.append(["pi f_r cos(light)", f"{number(low)} to {number(high)}"])
    for polar_deg, albedo in zip(_ALBEDO_DEG, albedos, strict=True):
        rows.append([f"albedo at {polar_deg} degrees (r, g, b)", ", ".join(number(float(part)) for part in albedo)])
    return text_table(["", ""], rows)


def _kind_rows(brdf: Brdf) -> list[list[str]]:
    """Return the rows that only a table of this kind has."""
    isotropic = "isotropic" if brdf.isotropic else "anisotropic"
    if isinstance(brdf, MerlBrdf):
        half, difference, azimuth = brdf.resolution
        entries = half * difference * azimuth
        percent = 100 * brdf.missing_count / entries
        return [
            ["kind", f"MERL table, {isotropic}, reciprocal"],
            ["resolution", f"{half} half x {difference} difference x {azimuth} azimuth angles, RGB"],
            ["missing samples", f"{brdf.missing_count} of {entries} ({percent:.4g} %), filled in"],
        ]
    if not isinstance(brdf, RglBrdf):
        return [["kind", f"{brdf.name}, {isotropic}"]]
    azimuths, polars, _, rows, columns = brdf.resolution
    return [
        ["kind", f"RGL measurement, {isotropic}, {brdf.measured_as}"],
        ["description", brdf.description or "none"],
        ["resolution", f"{azimuths} azimuth x {polars} polar angles, {rows} x {columns} each"],
        ["negative colours", f"{100 * brdf.negative_share:.4g} % (outside of sRGB; they count as 0)"],
    ]
