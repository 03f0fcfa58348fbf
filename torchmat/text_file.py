"""Small text files: read whole, within a bound, or refused with an error that names the file."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

from torchmat.errors import DataError, message

MOST_BYTES = 32_000_000  # of a table or description; 25,000 images take three million


def check_size(where: str, size: int, what: str = "the text") -> None:
    """Raise DataError when a text of `size` bytes is longer than any that is meant for this package."""
    if size > MOST_BYTES:
        step = "Check that it is the right file."
        fact = f"it holds more than {MOST_BYTES // 1_000_000} MB"
        raise DataError(message(where, what, "be a small file", fact, step))


def decode_text(where: str, data: bytes, what: str = "the text") -> str:
    """Return text in UTF-8 (with or without a byte-order mark) or UTF-16 (with one)."""
    encoding = "utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
    try:
        return data.decode(encoding)
    except UnicodeDecodeError as error:
        raise DataError(message(where, what, "be UTF-8", str(error), "Save it as UTF-8.")) from error


def read_text(path: str | Path, what: str = "the text") -> str:
    """Return the text of a file; no more than MOST_BYTES are ever read, of a device without an end neither.

    Raises DataError, which names the file and says `what` it is, when it cannot be read, is longer, or is no text.
    """
    try:
        with open(path, "rb") as stream:
            data = stream.read(MOST_BYTES + 1)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        raise DataError(message(str(path), what, "be readable", str(error), "Check the path.")) from error
    check_size(str(path), len(data), what)
    return decode_text(str(path), data, what)


def parse_value(text: str) -> Any:
    """Return the TOML value that `text` stands for; what is not TOML counts as a plain string."""
    try:
        return tomllib.loads(f"v = {text.strip()}")["v"]
    except (ValueError, RecursionError):
        return text.strip()


def read_toml(path: str | Path, what: str) -> dict[str, Any]:
    """Return the table of a TOML file; raises DataError, which names the file and says `what` it is."""
    text = read_text(path, what)
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # not TOML's own error alone: a number of 5,000 digits is another
        raise DataError(message(str(path), what, "be TOML", str(error), "Correct that line.")) from error


def read_json(path: str | Path, what: str, requirement: str) -> dict[str, Any]:
    """Return the table that a JSON file holds; raises DataError ("`what` must `requirement`"), which names the file."""
    return parse_json(str(path), read_text(path, what), what, requirement)


def parse_json(where: str, text: str, what: str, requirement: str) -> dict[str, Any]:
    """Return the table that a JSON `text` holds; raises DataError ("`what` must `requirement`"), which begins with `where`."""
    try:
        found = json.loads(text)
    except (ValueError, RecursionError) as error:  # RecursionError: thousands of brackets, one in the other
        fact = f"{type(error).__name__}: {error}"
    else:
        if isinstance(found, dict):
            return found
        fact = f"it holds a {type(found).__name__}"
    raise DataError(message(where, what, requirement, fact, "Restore the file from the original."))
