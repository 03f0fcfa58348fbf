"""What a studio remembers over a restart: which textures it follows, and how they are looked at."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from torchmat.errors import DataError, RangeError, check_known_keys, check_option, message
from torchmat.studio.place import write_own

_NAME = "settings.json"
_MOST_LOOK = 20_000  # letters of what the page remembers of itself


@dataclass
class Settings:
    """`still` are the textures of which saves are not followed, `look` what the page remembers of itself: camera, lights, panels."""

    still: list[str] = field(default_factory=list)
    look: dict[str, Any] = field(default_factory=dict)

    def follow(self, texture: str, on: bool, textures: dict[str, str]) -> None:
        """Say whether saves of a texture's file are shown at once."""
        check_option("studio", "the texture", texture, textures)
        self.still = [name for name in self.still if name != texture] + ([] if on else [texture])

    def remember(self, look: object) -> None:
        """Keep what the page remembers of itself."""
        if not isinstance(look, dict) or len(json.dumps(look)) > _MOST_LOOK:
            raise RangeError(message("studio", "what is remembered", "be a small table", f"it is a {type(look).__name__}"))
        self.look = look

    def save(self, own: Path) -> None:
        """Write the settings, whole or not at all."""
        write_own(own / _NAME, asdict(self))


def load_settings(own: Path) -> tuple[Settings, str]:
    """Return the settings of a studio, and what is wrong with their file: damaged ones are the usual ones again."""
    path = own / _NAME
    if not path.exists():
        return Settings(), ""
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
        check_known_keys(str(path), table, ("still", "look"))
        found = Settings(**table)
        if not isinstance(found.look, dict) or not all(isinstance(one, str) for one in list(found.still)):
            raise DataError(message(str(path), "the settings", "be names and a table", "they are not"))
        return found, ""
    except (OSError, ValueError, TypeError, RecursionError) as error:
        return Settings(), f"{path} is damaged ({error}): the usual settings hold"
