"""How a fit was run, as its report keeps it: enough to run it again, and to know whether the data is the same."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

REPORT = "report.json"


@dataclass(frozen=True)
class Run:
    """What a run began from: `config` as a table, `data` and `scenes` as paths, and the digests of the data and of files."""

    folder: Path
    config: dict[str, Any]
    data: str
    digest: str
    scenes: tuple[str, ...]
    files: dict[str, str]

    def check_files(self) -> None:
        """Raise DataError when a scene or a height map is not what it was."""
        from torchmat.errors import DataError, message
        from torchmat.written import digest_of_tree

        for name, digest in self.files.items():
            found = digest_of_tree(Path(name)) if os.path.exists(name) else None
            if found != digest:
                fact = "it is gone" if found is None else "it was changed since"
                step = "Restore it, or fit anew without --again."
                raise DataError(message(str(self.folder), name, "be what the material was fitted with", fact, step))

    def check_data(self, btf) -> None:
        """Raise DataError when a loaded BTF is not the one that the material was fitted to."""
        from torchmat.errors import DataError, message

        found = btf.digest()
        if found != self.digest:
            fact = f"its digest is {found[:12]}..., and the report's is {self.digest[:12]}..."
            step = "Name the data that it was with --data, or fit anew without --again."
            raise DataError(message(btf.source.path, "the data", f"be what {self.folder} was fitted to", fact, step))


def run_of(config, data: str, scenes: Sequence[Path], btf, command: Sequence[str]) -> dict[str, Any]:
    """Return what a report keeps of a run of the command line: the `command`, and what `read_run` reads back."""
    from torchmat.fitting.geometry import is_path
    from torchmat.shipped import find_file
    from torchmat.written import digest_of_tree

    table = {name: value for name, value in dataclasses.asdict(config).items() if value is not None}
    used = [os.path.abspath(find_file(path, "scenes")) for path in scenes]
    scene_files = list(used)
    if config.geometry is not None and is_path(config.geometry):
        table["geometry"] = os.path.abspath(config.geometry)
        used.append(table["geometry"])
    if config.test is not None and os.path.exists(config.test):
        table["test"] = os.path.abspath(config.test)
        used.append(table["test"])
    return {
        "command": list(command), "config": table, "digest": btf.digest(), "scenes": scene_files,
        "data": os.path.abspath(data) if os.path.exists(data) else data,
        "files": {path: digest_of_tree(Path(path)) for path in used},
    }


def read_run(path: Path) -> Run:
    """Return how the material in a folder was fitted, by its report; raises DataError when the report does not say so."""
    from torchmat.errors import DataError, message
    from torchmat.text_file import read_json

    file = path / REPORT if path.is_dir() else path
    report = read_json(file, "the report", "be that of a fit")
    try:
        run = report["run"]
        return Run(
            file.parent, dict(run["config"]), str(run["data"]), str(run["digest"]), tuple(map(str, run["scenes"])),
            {str(name): str(digest) for name, digest in run["files"].items()},
        )
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        step = "Only fits of the command line can be run again, and none of earlier versions."
        fact = f"{type(error).__name__}: {error}"
        raise DataError(message(str(file), "the report", "say how it was run", fact, step)) from error
