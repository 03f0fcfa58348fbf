"""Where a key of a config has its place: what stands elsewhere is a mistake that can be named."""

from __future__ import annotations

from collections.abc import Mapping, Sequence


def right_place(
    key: str, model: str, options: Mapping[str, Sequence[str]], fields: Sequence[str], tables: Mapping[str, Sequence[str]]
) -> str:
    """Return a sentence on where a key belongs that stands elsewhere; "" when it has no place at all.

    Args:
        key: the key, without the names of the tables that it stands in.
        model: the model that the config names.
        options: the options of each model.
        fields: the keys of a config itself.
        tables: the keys of its tables, by name.
    """
    if key in options.get(model, ()):
        return f"It is an option of {model}: options.{key}."
    for name, keys in tables.items():
        if key in keys:
            return f"It has its place in the table {name}: {name}.{key}."
    if key in fields:
        return f"It is a key of the config itself: {key}."
    others = [other for other, names in options.items() if key in names]
    return f"It is an option of {', '.join(others)}, not of {model}: options.{key} there." if others else ""
