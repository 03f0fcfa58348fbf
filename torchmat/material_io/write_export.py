"""export: a material in a form that others read, with a file that says what was lost on the way."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torchmat import atomic
from torchmat.errors import RangeError, check_known_keys, message
from torchmat.machine import package_version
from torchmat.material_io.exporter import (
    EXPORTERS, LOSS, LOSS_FORMAT, Exporter, Losses, chosen_exporter, loss_file,
)
from torchmat.models import Material
from torchmat.written import digest_of, files_below, write_record, write_table

_VERSION = 1


def export(
    material: Material, path: str | Path, to: str | None = None, *, provenance: Mapping[str, Any] | None = None,
    force: bool = False, **options: Any,
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
        options: those of the exporter.

    Raises RangeError for unknown names and options and for what the form cannot hold, DataError when `path` cannot be
    written.
    """
    exporter, target = chosen_exporter(path, to), Path(path)
    check_known_keys(f"export to {exporter.name}", options, exporter.options)
    backup = check_export_target(target, exporter, force)
    table = {
        "format": LOSS_FORMAT, "version": _VERSION, "written_by": f"torchmat {package_version()}",
        "exporter": exporter.name, "model": material.name, "options": {**exporter.options, **options},
        "provenance": dict(provenance or {}),
    }

    def beside(built: Path, losses: Losses) -> None:
        write_record(built / LOSS, _with_losses(table, losses, [*files_below(built), LOSS]))

    losses = exporter.write_whole(material, target, options, provenance, None if exporter.suffix else beside, backup)
    if exporter.suffix:
        with atomic.building_file(loss_file(target, exporter)) as built:
            write_table(built, _with_losses(table, losses, [target.name]), {target.name: digest_of(target)})
    return losses


def _with_losses(table: dict[str, Any], losses: Losses, files: list[str]) -> dict[str, Any]:
    found = {"exact": list(losses.exact), "approximated": dict(losses.approximated), "lost": dict(losses.lost)}
    return {**table, "files": files, **found}


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
