"""export: a material in a form that others read, with a file that says what was lost on the way."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from torch import Tensor

from torchmat import atomic
from torchmat.btf import Btf
from torchmat.errors import RangeError, check_known_keys, message
from torchmat.machine import package_version
from torchmat.material_io.as_microfacet import held_out_error, shading_error
from torchmat.material_io.exporter import (
    EXPORTERS, LOSS, LOSS_FORMAT, Exporter, Losses, chosen_exporter, loss_file,
)
from torchmat.models import Material
from torchmat.progress import phase
from torchmat.written import digest_of, files_below, write_record, write_table

_VERSION = 1


def export(
    material: Material, path: str | Path, to: str | None = None, *, provenance: Mapping[str, Any] | None = None,
    force: bool = False, btf: Btf | None = None, samples: Tensor | None = None, **options: Any,
) -> Losses:
    """Write a material in another form, with its losses beside it; return them.

    A folder gets a ``loss.json`` inside, a file ``NAME.loss.json`` beside it: exporter, options, files, and which parts are
    exact, approximated and lost. What appears at `path` appears whole or not at all, and replaces an earlier export of the
    same kind; anything else that stands there, or was changed since, is refused.

    Args:
        material: what to write.
        path: the folder or file to write.
        to: name of an exporter (a key of EXPORTERS: "folder", "packed", "relight" ..., or a registered one); None takes the one that
            the suffix of `path` names.
        provenance: where the material comes from, as JSON has it, which is kept there; None is nothing.
        force: True replaces what torchmat wrote whatever was done to it, and keeps a backup as ``NAME.backup-1``.
        btf: images in the material's size, on which what the form holds is measured as well; None is none.
        samples: numbers [n] of its samples that count, such as ``result.split.held_out``; None is all.
        options: those of the exporter.

    Where the exporter knows what its form holds, `Losses.errors` has the relative error of that, without relief and after
    quantisation: "native" against the material (`shading_error`), "held_out" against the samples.

    Raises RangeError for unknown names and options and for what the form cannot hold, DataError when `path` cannot be
    written.
    """
    exporter, target = chosen_exporter(path, to), Path(path)
    check_known_keys(f"export to {exporter.name}", options, exporter.options)
    backup = check_export_target(target, exporter, force)
    table = {
        "format": LOSS_FORMAT, "version": _VERSION, "written_by": f"torchmat {package_version()}",
        "exporter": exporter.name, "model": material.name, "options": {name: _plain(value) for name, value in {**exporter.options, **options}.items()},
        "provenance": dict(provenance or {}),
    }

    measured: list[Losses] = []

    def beside(built: Path, losses: Losses) -> None:
        measured.append(_measured(losses, material, btf, samples))
        if not exporter.suffix:
            write_record(built / LOSS, _with_losses(table, measured[0], [*files_below(built), LOSS]))

    exporter.write_whole(material, target, options, provenance, beside, backup)
    if exporter.suffix:
        with atomic.building_file(loss_file(target, exporter)) as built:
            write_table(built, _with_losses(table, measured[0], [target.name]), {target.name: digest_of(target)})
    return measured[0]


def _plain(value: Any) -> Any:
    """Return an option as JSON has it: of an object, such as a mesh, its name."""
    return value if value is None or isinstance(value, str | int | float | bool | list | tuple) else str(getattr(value, "name", type(value).__name__))


def _measured(losses: Losses, material: Material, btf: Btf | None, samples: Tensor | None) -> Losses:
    """Return the losses with the errors of what is held, if that is known."""
    if losses.held is None:
        if btf is not None:
            step = "Leave the BTF out, or choose a form for renderers, such as 'gltf'."
            raise RangeError(message("export", "the form", "be one that is measured on a BTF", "it is not", step))
        return losses
    with phase("measuring what the form holds"):
        errors = {"native": shading_error(material, losses.held)}
        if btf is not None:
            errors["held_out"] = held_out_error(losses.held, btf, samples)
    return replace(losses, errors=errors)


def _with_losses(table: dict[str, Any], losses: Losses, files: list[str]) -> dict[str, Any]:
    found = {"exact": list(losses.exact), "approximated": dict(losses.approximated), "lost": dict(losses.lost)}
    return {**table, "files": files, **found, **({"errors": dict(losses.errors)} if losses.errors else {})}


def check_export_target(target: Path, exporter: Exporter, force: bool = False) -> bool:
    """Raise unless `target` may be written: a new name, or an earlier export of that kind as torchmat wrote it.

    With `force` it may be replaced even so; True is returned when a backup must be kept.
    """
    if not exporter.suffix:
        other = next((one for one in EXPORTERS.values() if one.suffix and target.suffix.lower() == one.suffix), None)
        if other is not None and not os.path.isdir(target):
            fact, step = f"its name ends in {other.suffix}", f"Choose a folder, or export to {other.name!r}."
            raise RangeError(message(str(target), "the target", f"be a folder for {exporter.name!r}", fact, step))
        return exporter.check_folder(target, f"an earlier export to {exporter.name!r}", force)
    if target.suffix.lower() != exporter.suffix:
        fact, step = f"it is {target.name!r}", f"For example {target.name}{exporter.suffix}."
        raise RangeError(message(str(target), "the name", f"end in {exporter.suffix} for {exporter.name!r}", fact, step))
    return exporter.check_file(target, force)
