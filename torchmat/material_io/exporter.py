"""Exporter: how a material becomes files for others, and what they cannot hold; and the table of them, open to others."""

from __future__ import annotations

import inspect
import json
import os
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from torch import Tensor, nn

from torchmat import atomic, safe
from torchmat.errors import DataError, RangeError, TorchmatError, check_option, message
from torchmat.models import Material
from torchmat.models.resample import VECTORS
from torchmat.written import changed_files

_MISSING: Any = None  # of what must be given, which is checked with an error that says so
LOSS = "loss.json"
LOSS_FORMAT = "torchmat-loss"
_AGAINST = {"native": "against the material", "held_out": "against samples"}


@dataclass(frozen=True)
class Losses:
    """What became of a material's parts (maps, options, relief ...) in an export.

    Args:
        exact: names of the parts that come back as they were.
        approximated: of each part that does not, how far it is off.
        lost: of each part that has no place there, why.
        errors: measured relative errors of what is held: "native" against the material without its relief, "held_out" against
            samples of a BTF.
        held: the material as the export holds it, after quantisation, which `export` measures; None is not known.
    """

    exact: tuple[str, ...] = ()
    approximated: Mapping[str, str] = field(default_factory=dict)
    lost: Mapping[str, str] = field(default_factory=dict)
    errors: Mapping[str, float] = field(default_factory=dict)
    held: Material | None = field(default=None, compare=False, repr=False)

    @classmethod
    def of_maps(
        cls, material: Material, found: Mapping[str, Tensor] | nn.ParameterDict, lost: Mapping[str, str] | None = None
    ) -> Losses:
        """Return what became of each map, measured: `found` are the maps as a reader of the export would have them.

        A map that is neither there nor in `lost` is lost.
        """
        exact: list[str] = []
        approximated: dict[str, str] = {}
        lost = dict(lost or {})
        for spec in material.specs():
            if spec.name in lost:
                continue
            if spec.name not in found:
                lost[spec.name] = "it has no place there"
                continue
            before, after = (value.detach().double() for value in (material.maps[spec.name], found[spec.name]))
            if before.shape != after.shape:
                approximated[spec.name] = f"{tuple(before.shape)} becomes {tuple(after.shape)}"
                continue
            if spec.name in VECTORS:  # they are directions, whatever their length
                before, after = safe.normalise(before), safe.normalise(after)
            off = float((before - after).abs().max())
            if off == 0:
                exact.append(spec.name)
            else:
                approximated[spec.name] = f"off by at most {off:.3g}, values up to {float(before.abs().max()):.3g}"
        return cls(tuple(exact), approximated, lost)

    def __str__(self) -> str:
        told = ", ".join(f"{error:.3g} {_AGAINST[name]}" for name, error in self.errors.items())
        approximated = f"approximated (error {told})" if told else "approximated"
        parts = (("exact", self.exact), (approximated, self.approximated), ("lost", self.lost))
        return "; ".join(f"{name}: {', '.join(found) or 'nothing'}" for name, found in parts)


def listed_files(target: Path) -> Callable[[str], bool]:
    """Return which files in `target` are those of an earlier export, as its ``loss.json`` lists them."""
    return _read_files(target / LOSS).__contains__


def _read_files(path: Path) -> set[str]:
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
        return {str(name) for name in table["files"]} if table["format"] == LOSS_FORMAT else set()
    except (OSError, ValueError, LookupError, TypeError):
        return set()


@dataclass(frozen=True)
class Exporter:
    """One way to write a material.

    Args:
        name: what `export` calls it.
        description: one line on what it writes.
        write: ``write(material, path, *, ...) -> Losses`` fills the empty folder `path`, or with a `suffix` writes the file
            `path`; its keywords are the options of the export, and one called `provenance` takes where the material comes
            from. What it writes appears whole or not at all, and its errors name the user's path. `material.textures()` and
            `material.numbers()` give all that a material holds, `material.maps` the maps in full size.
        suffix: of the file that it writes, such as ".glb"; None writes a folder.
        known: ``known(folder)`` returns which files there are an earlier export's, and may be replaced: by default those
            that its ``loss.json`` lists.
        record: the file in such a folder that keeps the digests of the others (`torchmat.written`).

    Raises RangeError when a part is missing or is not what it must be.
    """

    name: str
    description: str
    write: Callable[..., Losses] = _MISSING
    suffix: str | None = None
    known: Callable[[Path], Callable[[str], bool]] = listed_files
    record: str = LOSS

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not re.fullmatch(r"[a-z0-9][a-z0-9_-]*", self.name):
            step = "Small letters, digits, _ and - do."
            raise RangeError(message("Exporter", "name", "be a word", f"it is {self.name!r}", step))
        where = f"Exporter {self.name}"
        if not callable(self.write):
            step = "Give write(material, path, *, ...) -> Losses."
            raise RangeError(message(where, "write", "be a function", f"it is {self.write!r}", step))
        if self.suffix is not None and not re.fullmatch(r"\.[a-z0-9]+", self.suffix):
            step = 'Give it as ".glb", or leave it out for a folder.'
            raise RangeError(message(where, "suffix", "be a point and small letters", f"it is {self.suffix!r}", step))

    @property
    def options(self) -> dict[str, Any]:
        """The options of the export and their defaults."""
        return {name: one.default for name, one in self._keywords().items() if name != "provenance"}

    def _keywords(self) -> dict[str, inspect.Parameter]:
        parameters = inspect.signature(self.write).parameters.values()
        return {one.name: one for one in parameters if one.kind is one.KEYWORD_ONLY}

    def write_whole(
        self, material: Material, target: Path, options: Mapping[str, Any], provenance: Mapping[str, Any] | None = None,
        more: Callable[[Path, Losses], None] | None = None, backup: bool = False,
    ) -> Losses:
        """Write a material to `target`, which appears whole or not at all; `more` may add to a folder before it does.

        With `backup` what stood there stays under another name (`atomic.backup_name`).
        """
        keywords = dict(options)
        if provenance is not None and "provenance" in self._keywords():
            keywords["provenance"] = dict(provenance)
        with (atomic.building_file if self.suffix else atomic.building)(target, backup=backup) as built:
            try:
                losses = self.write(material, built, **keywords)
            except TorchmatError as error:
                # What is being built has a hidden name, which would mean nothing to the reader.
                raise type(error)(str(error).replace(str(built), str(target))) from error
            if not isinstance(losses, Losses):
                fact = f"it is {type(losses).__name__}"
                raise RangeError(message(f"Exporter {self.name}", "what `write` returns", "be Losses", fact))
            if not os.path.exists(built):
                raise RangeError(message(f"Exporter {self.name}", "`write`", "write the file", "there is none"))
            if more is not None:
                more(built, losses)
        return losses

    def check_folder(self, target: Path, what: str, force: bool = False) -> bool:
        """Raise DataError unless the folder `target` may be replaced: see `atomic.refuse_foreign`, which says of `what`."""
        found = [changed_files(target / name) for name in {self.record, LOSS} if os.path.isfile(target / name)]
        told = [names for names in found if names is not None]
        changed = sorted({name for names in told for name in names}) if told or not found else None
        return atomic.refuse_foreign(target, self.known(target), what, changed, force)

    def check_file(self, target: Path, force: bool = False, unknown: bool = False) -> bool:
        """Raise DataError unless the file `target` may be written: a new name, or an earlier export as it was written.

        `unknown` takes a file of which nothing is known for one. With `force` any file may be replaced; True is returned
        when a backup must be kept.
        """
        if not os.path.lexists(target):
            return False
        folder, step = os.path.isdir(target), "Choose another name, or move what is there."
        fact = "it is a folder" if folder else self._doubt(target, loss_file(target, self), unknown)
        if not folder and (fact is None or force):
            return fact is not None
        if not folder:
            step += " With --force (force=True) a backup of it is kept."
        raise DataError(message(str(target), "the target", "be new or an earlier export", str(fact), step))

    @staticmethod
    def _doubt(target: Path, losses: Path, unknown: bool) -> str | None:
        """Return why a file may be somebody else's, None when it is an earlier export."""
        if target.name not in files_of_losses(losses):
            return None if unknown else f"no {losses.name} says that it is one"
        changed = changed_files(losses)
        if changed is None:
            return f"{losses.name} is of an earlier torchmat, which kept no digests to tell"
        return "it was changed since torchmat wrote it" if target.name in changed else None


EXPORTERS: dict[str, Exporter] = {}


def register_exporter(exporter: Exporter) -> Exporter:
    """Add a way to write materials to those that `export` and `save_material` know; return the exporter.

    Args:
        exporter: the way. The built-in ones come the same way.

    Raises RangeError when the name or the suffix is taken, or it is no Exporter.
    """
    where = "register_exporter"
    if not isinstance(exporter, Exporter):
        step = "Give Exporter(name, description, write)."
        raise RangeError(message(where, "exporter", "be an Exporter", f"it is {type(exporter).__name__}", step))
    if exporter.name in EXPORTERS:
        step = "Give it another name."
        raise RangeError(message(where, "the exporter's name", "be new", f"{exporter.name!r} is taken", step))
    other = None if exporter.suffix is None else _of_suffix(exporter.suffix)
    if other is not None:
        step = "Give it another one, or none for a folder."
        raise RangeError(message(where, "the suffix", "be new", f"{exporter.suffix} is that of {other.name!r}", step))
    EXPORTERS[exporter.name] = exporter
    return exporter


def unregister_exporter(name: str) -> None:
    """Take a way to write materials out again, the counterpart of `register_exporter`."""
    check_option("unregister_exporter", "name", name, EXPORTERS)
    del EXPORTERS[name]


def _of_suffix(suffix: str) -> Exporter | None:
    return next((one for one in EXPORTERS.values() if one.suffix == suffix.lower()), None)


def exporter_of_file(path: str | Path) -> Exporter | None:
    """Return the exporter that writes files called like `path`; None for other names, and for a folder that is there."""
    return None if not Path(path).suffix or os.path.isdir(path) else _of_suffix(Path(path).suffix)


def chosen_exporter(path: str | Path, to: str | None) -> Exporter:
    """Return the exporter called `to`, or with None the one that the suffix of `path` names; raises RangeError."""
    if to is not None:
        check_option("export", "to", to, EXPORTERS)
        return EXPORTERS[to]
    found = exporter_of_file(path)
    if found is None:
        fact = f"{str(path)!r} ends in no suffix of one"
        step = f"Name one of: {', '.join(EXPORTERS)}."
        raise RangeError(message("export", "to", "name an exporter", fact, step))
    return found


def loss_file(target: Path, exporter: Exporter) -> Path:
    """Return where the losses stand: in a folder, or beside a file under its name."""
    return target.with_name(f"{target.name}.{LOSS}") if exporter.suffix else target / LOSS


def files_of_losses(path: Path) -> Iterable[str]:
    """Return the files that a ``loss.json`` lists; none where it is absent or something else."""
    return _read_files(path)
