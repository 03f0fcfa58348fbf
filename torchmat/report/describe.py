"""What an input is, in words: for `torchmat info`."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor

from torchmat import frames
from torchmat.btf import Btf
from torchmat.material_io import load_material
from torchmat.material_io.folder import MANIFEST
from torchmat.report.tables import number, text_table


def is_material(path: str | Path) -> bool:
    """Return whether `path` is a material folder."""
    return (Path(path) / MANIFEST).is_file()


def _polar_range(directions: Tensor) -> str:
    polar = torch.rad2deg(frames.to_polar(directions.double())[0])
    return f"{len(directions)}, polar {float(polar.min()):.1f} to {float(polar.max()):.1f} degrees"


def describe_btf(btf: Btf) -> str:
    """Return a table: kind, samples, directions, size, range, clipped share, how full the grid of pairs is."""
    low, high = btf.value_range
    grid = len(btf.lights) * len(btf.views)
    source = btf.source
    rows = [
        ["source", source.path],
        ["kind", source.kind],
        ["samples (images)", len(btf)],
        ["size", f"{btf.height} x {btf.width} texels"],
        ["lights", _polar_range(btf.lights)],
        ["views", _polar_range(btf.views)],
        ["pairs covered", f"{len(btf)} of {grid} ({100 * len(btf) / grid:.1f} %)"],
        ["stored as", f"{btf.stored_dtype}, read as {btf.encoding}, exposure {number(btf.exposure)}"],
        ["linear range", f"{number(low)} to {number(high)}"],
        ["clipped share", f"{100 * btf.clipped_share:.4g} %"],
        ["invalid share", f"{100 * btf.invalid_share:.4g} %"],
        ["loaded in", f"{number(source.load_seconds)} s{' (from the cache)' if source.from_cache else ''}"],
    ]
    return text_table(["", ""], rows)


def describe_material(path: str | Path) -> str:
    """Return tables of a material folder: model, options, bytes, and the range of each map."""
    material = load_material(path)
    height, width = material.size
    facts = [
        ["material", str(path)],
        ["model", material.name],
        ["options", ", ".join(f"{k}={v}" for k, v in material.options.items()) or "none"],
        ["size", f"{height} x {width} texels"],
        ["bytes per texel (+ shared)", f"{number(material.bytes_per_texel)} (+ {material.shared_bytes})"],
    ]
    maps = []
    for spec in material.specs():
        value = material.maps[spec.name].detach()
        maps.append([spec.name, spec.meaning, str(tuple(value.shape)), float(value.min()), float(value.max())])
    return text_table(["", ""], facts) + "\n\n" + text_table(["map", "meaning", "shape", "least", "largest"], maps)
