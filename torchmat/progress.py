"""What is being done, in one line that lives on a terminal: named phases, bars, time left. Silence in a pipe.

Within `announced`, as all commands are, the line is drawn anew twice a second by a thread, so that it lives while a
library is loaded or one long step is taken. Elsewhere, as in Python, it moves with the work alone. It holds no colours.
"""

from __future__ import annotations

import math
import os
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sized
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, TextIO, TypeVar

Item = TypeVar("Item")
_DELAY = 0.5  # seconds: what is over sooner needs no bar
_TICK, _FIRST = 0.5, 0.3  # seconds between two looks of the thread, and until the first
_BETWEEN = 0.1  # seconds between two drawings of a bar that moves
_BAR = "{desc} {percentage:3.0f}% |{bar}| {elapsed}, {remaining} left"
_LEAST_SHARE = 1e-3  # of a bar: below it nothing can be said of the time left


@dataclass(eq=False)
class Activity:
    """Something that is being done: a phase, or with a `total` a bar, whose steps bars called `of` may take as well."""

    what: str
    total: float | None = None
    of: str | None = None
    seconds: float = math.inf
    shown: bool = True
    later: str = ""
    done: float = 0.0
    begun: float = field(default_factory=time.monotonic)

    def advance(self, steps: float = 1) -> None:
        """Say that so many more steps are done."""
        self.done += steps
        if self.shown:
            _LINE.moved(self)

    @property
    def ripe(self) -> bool:
        """Whether it is worth a line: a phase at once, a bar when it takes long."""
        return self.total is None or time.monotonic() - self.begun >= _DELAY

    def text(self, columns: int, plain: bool) -> str:
        """Return the line, of at most so many columns; `plain` keeps to ASCII."""
        elapsed = time.monotonic() - self.begun
        if not self.total:
            seconds = int(elapsed)
            return f"{self.what}  {seconds // 60:02d}:{seconds % 60:02d}"[:columns]
        from tqdm import tqdm

        share = min(1.0, max(self.done / self.total, elapsed / self.seconds))
        known = share if share > _LEAST_SHARE else 0
        return tqdm.format_meter(known, 1, elapsed, ncols=columns, prefix=self.what, ascii=plain, bar_format=_BAR)[:columns]


class _Line:
    """The line, and what is being done, innermost last."""

    def __init__(self) -> None:
        self.lock = threading.RLock()
        self.doing: list[Activity] = []
        self.session: TextIO | None = None  # the terminal of a command
        self.always = False  # whether bars are shown where there is no terminal
        self.silent = False
        self.drawn, self.length, self.open = 0.0, 0, False

    @property
    def stream(self) -> TextIO:
        return sys.stderr if self.session is None else self.session

    def begin(self, one: Activity) -> None:
        with self.lock:
            if self.doing and self.doing[0].later:
                self.doing[0].what = self.doing[0].later
            self.doing.append(one)
            if one.total is None:
                self.draw()

    def end(self, one: Activity) -> None:
        """Take it off, with all that was left open within it; the next look shows what goes on around it."""
        with self.lock:
            if one in self.doing:
                del self.doing[self.doing.index(one):]
            if self.session is None:
                self.clear()

    def moved(self, one: Activity) -> None:
        if self.doing and self.doing[-1] is one and one.ripe and time.monotonic() - self.drawn >= _BETWEEN:
            self.draw()

    def draw(self) -> None:
        with self.lock:
            shown = next((one for one in reversed(self.doing) if one.ripe), None)
            if shown is None or self.open or self.silent:
                return
            if os.environ.get("TERM") == "dumb":  # has no line to draw over: each phase has one of its own
                self._once(shown)
                return
            plain = not (getattr(self.stream, "encoding", None) or "").lower().startswith("utf")
            text = shown.text(_columns(self.stream) - 1, plain)
            self._write(f"\r{text}{' ' * (self.length - len(text))}")
            self.length, self.drawn = len(text), time.monotonic()

    def _once(self, shown: Activity) -> None:
        if getattr(self, "said", None) is not shown:
            self.said = shown
            self._write(f"{shown.what}\n")

    def clear(self) -> None:
        with self.lock:
            if self.length:
                self._write(f"\r{' ' * self.length}\r")
            self.length = 0

    def _write(self, text: str) -> None:
        try:
            self.stream.write(text)
            self.stream.flush()
        except (OSError, ValueError):  # a terminal that is gone is no reason to stop
            self.silent = True


class _Told(_Line):
    """What is being done, told to a function instead of a terminal."""

    def __init__(self, tell: Callable[[str, float | None], None]) -> None:
        super().__init__()
        self._tell, self.always = tell, True

    def draw(self) -> None:
        shown = next((one for one in reversed(self.doing) if one.ripe), None)
        if shown is not None:
            self.drawn = time.monotonic()
            self._tell(shown.what, min(1.0, shown.done / shown.total) if shown.total else None)


_LINE = _Line()


def _forget() -> None:
    global _LINE
    _LINE = _Line()
    _LINE.silent = True


if hasattr(os, "register_at_fork"):  # a forked process has no thread, and may have a lock that no one opens
    os.register_at_fork(after_in_child=_forget)


class _Above:
    """A stream whose text stands above the line."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        with _LINE.lock:
            if text:
                _LINE.clear()
                _LINE.open = not text.endswith("\n")
            return self._stream.write(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def _columns(stream: TextIO) -> int:
    try:
        return max(20, os.get_terminal_size(stream.fileno()).columns)
    except (OSError, ValueError, AttributeError):
        return 80


def _is_terminal(stream: Any) -> bool:
    return stream is not None and stream.isatty()


def _shown(show: bool | None) -> bool:
    return not _LINE.silent and ((_LINE.always or _is_terminal(_LINE.stream)) if show is None else show)


@contextmanager
def announced(what: str, later: str = "") -> Iterator[None]:
    """Show on a terminal all that is done until the end, from `what` on, and that it goes on; in a pipe nothing.

    `later` is what it is called between what is named, once anything was.
    """
    if _LINE.session is not None or not _is_terminal(sys.stderr):
        yield
        return
    usual, over = (sys.stdout, sys.stderr), threading.Event()
    root = Activity(what, later=later)

    def look() -> None:
        wait = _FIRST
        while not over.wait(wait):
            _LINE.draw()
            wait = _TICK

    _LINE.session = sys.stderr
    _LINE.doing.append(root)  # without a word: many commands are over before the first look
    thread = threading.Thread(target=look, daemon=True)
    sys.stdout, sys.stderr = (_Above(one) if _is_terminal(one) else one for one in usual)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join(timeout=1)
        sys.stdout, sys.stderr = usual
        _LINE.end(root)
        _LINE.clear()
        _LINE.session, _LINE.open = None, False


@contextmanager
def told(tell: Callable[[str, float | None], None]) -> Iterator[None]:
    """Call `tell` with what is being done until the end, and which share of it is done, None where nobody knows."""
    global _LINE
    before, _LINE = _LINE, _Told(tell)
    try:
        yield
    finally:
        _LINE = before


def progress(
    items: Iterable[Item], what: str, total: int | None = None, show: bool | None = None, each: float = 1
) -> Iterator[Item]:
    """Iterate over `items` with a bar on standard error, on which each counts as `each` steps; `show` None means only on a
    terminal. Within a `whole` of such bars they go on with that."""
    return _counted(items, what, total, each) if _shown(show) else iter(items)


def _counted(items: Iterable[Item], what: str, total: int | None, each: float) -> Iterator[Item]:
    around = next((one for one in _LINE.doing if one.of == what), None)
    count = total if total is not None else len(items) if isinstance(items, Sized) else None
    bar = around or Activity(what, None if count is None else count * each)
    if around is None:
        _LINE.begin(bar)
    try:
        for item in items:
            yield item
            bar.advance(each)
    finally:
        if around is None:
            _LINE.end(bar)


@contextmanager
def whole(
    what: str, total: float, of: str | None = None, seconds: float = math.inf, show: bool | None = None
) -> Iterator[Activity]:
    """Give one bar for `total` steps: those of all bars called `of` within, and those that it is advanced by.

    It is at its end after `seconds`, where the work stops then.
    """
    bar = Activity(what, total, of, max(seconds, 1e-9), _shown(show))
    if bar.shown:
        _LINE.begin(bar)
    try:
        yield bar
    finally:
        if bar.shown:
            _LINE.end(bar)


@contextmanager
def working(what: str, show: bool | None = None) -> Iterator[None]:
    """Say on standard error what is being done, as long as it takes; `show` None means only on a terminal."""
    if not _shown(show):
        yield
        return
    one = Activity(what)
    _LINE.begin(one)
    try:
        yield
    finally:
        _LINE.end(one)


def in_command() -> bool | None:
    """Return what `show` is where only a command shows progress: None within one, else False."""
    return None if _LINE.session is not None or _LINE.always else False


@contextmanager
def phase(what: str) -> Iterator[None]:
    """Say what a command is doing; nothing where no command runs, as in Python."""
    with working(what, in_command()):
        yield
