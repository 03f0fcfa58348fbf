"""The one table of hard cases: each numbered case for each kind of component, as a check or as the reason why there is none.

A check of a kind runs on every component of that kind that is registered when it runs, so a new model, solver, shape or
reader is covered without a change here. It asserts what must hold and returns a measured figure where there is one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

from tests.hard_cases import cases_files as files
from tests.hard_cases import cases_fitting as fitting
from tests.hard_cases import cases_rendering as rendering
from tests.hard_cases import cases_shading as shading
from tests.hard_cases.components import KINDS, Check, Component, Room, outcome

TITLES = {
    1: "equal, opposite and grazing directions",
    2: "N.L = N.V = 0 together",
    3: "normals tilted up to 89.9 degrees",
    4: "half vector at rim, edge and centre",
    5: "azimuth 0 and 2 pi, hue 0 and 360",
    6: "acos at and beyond its ends",
    7: "parameters at their ends",
    8: "1e-8 and 1e4 together",
    9: "too few or useless samples",
    10: "sizes of maps and sample counts",
    11: "NaN, Inf and damaged files",
    12: "deep relief at 75 degrees",
    13: "hard starts and objectives, float32",
    14: "NaN and oversized steps",
    15: "same seed, same bits",
    16: "kills and full disks",
    17: "ranges and export",
    18: "names, read-only and existing targets",
}
# Of the list, but held by no check yet: other makers' files, work changed by the user, and a busy machine.
NOT_YET_CHECKED = (19, 20, 21)


class Row(NamedTuple):
    """A check of one kind of component in one case.

    `figure` says what the number is that it returns, and `worst` which of several is to be told; `of` leaves out
    components that have nothing that the case is about.
    """

    check: Check
    figure: str = ""
    worst: Callable[[list[float]], float] = min
    of: Callable[[Component], bool] | None = None


DIGITS = "digits of float32"
_ANGLES = "readers turn angles into directions by `frames` alone, which the sweeps hold to 50 digits"
_NO_MAPS = "it stores maps; no direction is among them"
_MATERIALS = "materials and fits meet it; a picture only repeats their shading"

TABLE: dict[int, dict[str, Row | str]] = {
    1: {
        "model": Row(shading.equal_and_opposite, DIGITS), "solver": Row(fitting.hard_pairs), "reader": _ANGLES,
        "writer": _NO_MAPS, "renderer": Row(rendering.along_and_against),
    },
    2: {
        "model": Row(shading.into_the_horizon, "last change of value", max), "solver": Row(fitting.all_grazing),
        "reader": _ANGLES, "writer": _NO_MAPS, "renderer": Row(rendering.grazing),
    },
    3: {
        "model": Row(shading.steep), "solver": "normals of a fit are its material's; steep heights are case 12",
        "reader": "normals are read as textures, which case 11 damages",
        "writer": Row(files.rim_normals, "degrees off", max, files.has_maps),
        "renderer": Row(rendering.frames_hold, of=rendering.is_object),
    },
    4: {
        "model": Row(shading.half_vectors, DIGITS), "solver": Row(fitting.half_vector_places), "reader": _ANGLES,
        "writer": _NO_MAPS, "renderer": _MATERIALS,
    },
    5: {
        "model": Row(shading.full_turn, "difference", max), "solver": Row(fitting.one_turn_more, "digits in common"),
        "reader": _ANGLES, "writer": Row(files.wrapped_angles, "degrees off", max, files.has_maps),
        "renderer": Row(rendering.wrapping_light, "difference", max),
    },
    6: {
        "model": Row(shading.ulp_from_unit, "digits in common"), "solver": Row(fitting.ulp_from_unit), "reader": _ANGLES,
        "writer": _NO_MAPS, "renderer": "directions become unit vectors where they enter; the sweeps measure that",
    },
    7: {
        "model": Row(shading.ends_of_maps), "solver": Row(fitting.black_and_white),
        "reader": "values out of range in files are case 11", "writer": "bounds come back exactly: checked for each model and storage",
        "renderer": Row(rendering.maps_at_bounds),
    },
    8: {
        "model": Row(shading.dark_beside_bright, "digits in common"),
        "solver": Row(fitting.dark_beside_highlight, "digits kept by dark texels"), "reader": "pixels are read as they are stored",
        "writer": Row(files.small_beside_large, "digits of 1e-8", min, files.takes_values),
        "renderer": Row(rendering.dark_beside_bright),
    },
    9: {
        "model": "a material has no samples", "solver": Row(fitting.too_little_data), "reader": "what samples are for is the fit's to say",
        "writer": "a material has no samples", "renderer": Row(rendering.black),
    },
    10: {
        "model": Row(shading.sizes), "solver": Row(fitting.sizes), "reader": "writers read back every size that they write",
        "writer": Row(files.sizes), "renderer": Row(rendering.sizes),
    },
    11: {
        "model": Row(shading.refused), "solver": Row(fitting.masked_values), "reader": Row(files.hostile, "refusals", min),
        "writer": Row(files.refused, of=files.takes_values), "renderer": Row(rendering.refused),
    },
    12: {
        "model": Row(shading.deep_relief), "solver": Row(fitting.over_a_step), "reader": "a height is read as any other image",
        "writer": Row(files.full_step, "share of the step", max, files.has_height), "renderer": Row(rendering.deep_relief),
    },
    13: {
        "model": Row(shading.precision, DIGITS), "solver": Row(fitting.precision, DIGITS), "reader": "nothing is solved",
        "writer": "nothing is solved", "renderer": Row(rendering.precision, DIGITS),
    },
    14: {
        "model": "nothing is solved", "solver": Row(fitting.named_reasons), "reader": "nothing is solved",
        "writer": "nothing is solved", "renderer": "nothing is solved",
    },
    15: {
        "model": Row(shading.same_bits), "solver": Row(fitting.same_bits), "reader": Row(files.read_twice),
        "writer": Row(files.same_bytes), "renderer": Row(rendering.same_bits),
    },
    16: {
        "model": "nothing is written", "solver": "a fit writes nothing; what tiles keep is killed in tests/fitting/test_tiled.py",
        "reader": Row(files.leaves_files), "writer": Row(files.full_disk, "writes that it stopped"), "renderer": "pictures are a writer",
    },
    17: {
        "model": Row(shading.export_ranges, "relative error, 8 bits", max),
        "solver": Row(fitting.stated_after_export, "change of error, 8 bits", max), "reader": "codes cannot leave their range",
        "writer": Row(files.after_export, "share of the largest", max),
        "renderer": Row(rendering.after_export, "relative error, 8 bits", max),
    },
    18: {
        "model": "nothing is written", "solver": "nothing is written", "reader": Row(files.named_folders),
        "writer": Row(files.read_only_target), "renderer": "pictures are a writer",
    },
}


class Entry(NamedTuple):
    """One test: a case, a component, and the row that says what is checked."""

    case: int
    component: Component
    row: Row

    @property
    def label(self) -> str:
        """Name of the test."""
        return f"case{self.case:02d}-{self.component.kind}-{self.component.name}".replace(" ", "_")


def entries() -> Iterator[Entry]:
    """Yield every case with every registered component that it is about."""
    for kind, components in KINDS.items():
        found = components()
        for case, rows in TABLE.items():
            row = rows[kind]
            if isinstance(row, str):
                continue
            yield from (Entry(case, one, row) for one in found if row.of is None or row.of(one))


def measured(entry: Entry, room: Room) -> dict:
    """Run one entry; return what the long form reports of it, whatever happens."""
    found = outcome(lambda: entry.row.check(entry.component.given, room))
    named = {"case": entry.case, "kind": entry.component.kind, "component": entry.component.name}
    return {**named, **found, "unit": entry.row.figure}


def summary(rows: list[dict]) -> list[dict]:
    """Return a row for each case and kind of component: how many passed, of how many, and the worst figure with its owner."""
    found = []
    for case, kinds in TABLE.items():
        for kind, row in kinds.items():
            if isinstance(row, str):
                found.append({"case": case, "kind": kind, "reason": row})
                continue
            own = [one for one in rows if (one["case"], one["kind"]) == (case, kind)]
            figures = [(one["figure"], one["component"]) for one in own if one["figure"] is not None]
            worst = row.worst(figures) if figures else (None, "")
            found.append({
                "case": case, "kind": kind, "passed": sum(one["passed"] is True for one in own),
                "skipped": sum(one["passed"] is None for one in own), "count": len(own), "figure": worst[0],
                "component": worst[1], "unit": row.figure,
            })
    return found
