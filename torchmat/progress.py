"""Progress bars on a terminal, silence in a pipe."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import TypeVar

Item = TypeVar("Item")
_DELAY = 0.5  # seconds: what is over sooner needs no bar


def progress(items: Iterable[Item], what: str, total: int | None = None, show: bool | None = None) -> Iterator[Item]:
    """Iterate over `items` with a bar on standard error; `show` None means only on a terminal."""
    from tqdm import tqdm

    disable, delay = (None, _DELAY) if show is None else (not show, 0.0)
    return iter(tqdm(items, desc=what, total=total, disable=disable, leave=False, dynamic_ncols=True, delay=delay))


@contextmanager
def working(what: str, show: bool | None = None) -> Iterator[None]:
    """Say on standard error what is being done, as long as it takes; `show` None means only on a terminal."""
    from tqdm import tqdm

    with tqdm(desc=what, total=1, disable=None if show is None else not show, leave=False, bar_format="{desc} {elapsed}"):
        yield
