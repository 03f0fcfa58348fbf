"""Progress bars on a terminal, silence in a pipe."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import TypeVar

Item = TypeVar("Item")
_DELAY = 0.5  # seconds: what is over sooner needs no bar


def _shown(show: bool | None) -> bool:
    # A bar that is only disabled still takes a lock that forked processes share: one that is killed would keep it.
    return sys.stderr is not None and sys.stderr.isatty() if show is None else show


def progress(items: Iterable[Item], what: str, total: int | None = None, show: bool | None = None) -> Iterator[Item]:
    """Iterate over `items` with a bar on standard error; `show` None means only on a terminal."""
    if not _shown(show):
        return iter(items)
    from tqdm import tqdm

    delay = _DELAY if show is None else 0.0
    return iter(tqdm(items, desc=what, total=total, leave=False, dynamic_ncols=True, delay=delay))


@contextmanager
def working(what: str, show: bool | None = None) -> Iterator[None]:
    """Say on standard error what is being done, as long as it takes; `show` None means only on a terminal."""
    if not _shown(show):
        yield
        return
    from tqdm import tqdm

    with tqdm(desc=what, total=1, leave=False, bar_format="{desc} {elapsed}"):
        yield
