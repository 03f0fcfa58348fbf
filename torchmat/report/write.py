"""The output folder of a fit: the material with its report and pictures, whole or not at all."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from torchmat.btf import Btf
from torchmat.fitting import FitResult, evaluate
from torchmat.fitting.evaluate import LARGE_TEXELS, comparable
from torchmat.frames import half_vector
from torchmat.machine import give_back
from torchmat.material_io import packed, save_material
from torchmat.models import Distribution, Material
from torchmat.progress import in_command, phase
from torchmat.report.decisions_page import decisions_picture, decisions_text
from torchmat.report.error_cards import error_cards
from torchmat.report.html import fit_page
from torchmat.report.map_cards import map_cards, parameter_rows
from torchmat.report.maps import hemisphere_picture, maps_picture
from torchmat.report.pictures import write_pictures
from torchmat.report.samples import Measured, Shown, shown_samples
from torchmat.report.tables import to_json
from torchmat.report.viewer import viewer_of


_PIECE = 1 << 20  # characters of a page that are written at a time
_DRAWN_TEXELS = 1 << 18  # of large images: more than any picture of a page shows


def write_fit(
    btf: Btf, result: FitResult, folder: str | Path, pictures: bool = True, force: bool = False
) -> Path:
    """Write the material of `result`, `report.json`, and unless told not to, `pictures/` and `report.html`.

    Of an automatic choice `decisions.txt` says what was tried and why it was kept or left.
    Everything appears together in one step; see `save_material` for what may be replaced.
    """

    report = _with_packing(btf, result)
    # Pictures compare texel by texel; what is stored stays as it is.
    shown, btf = comparable(result.material, btf)
    pictured, btf = _pictured(replace(result, material=shown), btf)
    drawn = result.material if shown is pictured.material else pictured.material

    def companions(building: Path) -> None:
        (building / "report.json").write_text(to_json(report), encoding="utf-8")
        choice = report["figures"].get("auto")
        if choice:
            (building / "decisions.txt").write_text(decisions_text(choice), encoding="utf-8")
        large = drawn is not result.material
        if large:
            give_back()  # measuring and writing textures leave hundreds of megabytes with the allocator
        if pictures:
            with phase("choosing photographs"):
                rows = shown_samples(btf, pictured)
            written = _fit_pictures(btf, pictured, drawn, building / "pictures", rows)
            if choice:
                written.insert(0, decisions_picture(choice, building / "pictures" / "decisions.png"))
            if large:
                give_back()
            with phase("writing the report"):
                cards, numbers = map_cards(result.material, building), parameter_rows(result.material)
                certain = [] if result.uncertainty is None else error_cards(result.material, result.uncertainty, building)
                viewer = viewer_of(result.material if certain else drawn, certain)
                if large:
                    give_back()
                page = fit_page(report, written, rows, cards, numbers, viewer, certain)
                del viewer  # as long as the page
                with open(building / "report.html", "w", encoding="utf-8", newline="\n") as file:
                    file.writelines(page[start : start + _PIECE] for start in range(0, len(page), _PIECE))  # not encoded in one go

    return save_material(result.material, folder, _provenance(result.report), companions, force, result.uncertainty)


def _pictured(result: FitResult, btf: Btf) -> tuple[FitResult, Btf]:
    """Return a fit and its images as pictures need them: of large flat ones every so-manieth row and column.

    A page shows 320 of thousands of texels beside each other; a relief's neighbours belong to what is seen, and it stays whole.
    """
    material = result.material
    texels = btf.height * btf.width
    if texels <= LARGE_TEXELS or material.has_relief:
        return result, btf
    step = math.ceil(math.sqrt(texels / _DRAWN_TEXELS))
    lines = slice(0, None, step)
    coverage = None if result.coverage is None else result.coverage[:, ::step, ::step]
    return replace(result, material=material.some_texels(lines, lines), coverage=coverage), btf.window(0, 0, btf.height, btf.width, step)


def _fit_pictures(btf: Btf, pictured: FitResult, drawn: Material, folder: Path, rows: Sequence[Shown]) -> list[Path]:
    """Write the pictures of a fit, `pictured` in the size of the images, of photographs `rows`; return their paths."""
    with phase("drawing pictures"):
        written = write_pictures(btf, pictured, folder, rows, in_command())
    if drawn.texels < pictured.report["texels"]:
        give_back()
    half = half_vector(btf.lights[:, None], btf.views[None], dim=-1).flatten(0, 1)
    with phase("drawing the maps"):
        written.append(maps_picture(drawn, folder / "maps.png", half))
        if drawn.texels < pictured.report["texels"]:
            give_back()
        written.append(hemisphere_picture(drawn, folder / "hemisphere.png", measured=Measured(btf.lights, btf.views)))
    return written


def write_edited(
    material: Material, folder: str | Path, provenance: dict[str, Any], report: dict[str, Any] | None = None,
    pictures: bool = True, force: bool = False,
) -> Path:
    """Write a material that was made of others: with `report.json` if there is a report, and pictures of its maps.

    Everything appears together in one step; see `save_material` for what may be replaced.
    """

    def companions(building: Path) -> None:
        if report is not None:
            (building / "report.json").write_text(to_json(report), encoding="utf-8")
        if pictures:
            (building / "pictures").mkdir()
            with phase("drawing the maps"):
                maps_picture(material, building / "pictures" / "maps.png")
                hemisphere_picture(material, building / "pictures" / "hemisphere.png")

    return save_material(material, folder, provenance, companions, force)


def _with_packing(btf: Btf, result: FitResult) -> dict[str, Any]:
    """Return the report; of a material that can be packed, with its held-out error after packing."""
    if not isinstance(result.material, Distribution) or not result.report.get("held_out"):
        return result.report
    with phase("measuring after packing"):
        after = evaluate(packed(result.material), btf, result.split.held_out).report
    return {**result.report, "held_out_after_packing": after}


def _provenance(report: dict[str, Any]) -> dict[str, Any]:
    kept = ("options", "seed", "holdout", "holdout_by", "samples", "source", "versions")
    return {name: report[name] for name in kept}
