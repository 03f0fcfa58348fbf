"""What is being done is said in order on a terminal, and that it goes on; nothing of it in a pipe."""

from __future__ import annotations

import io
import math
import re
import subprocess
import sys
import time
from types import SimpleNamespace

import pytest

from torchmat import progress as line
from torchmat.cli import main
from torchmat.progress import Activity, announced, in_command, phase, progress, whole, working


class Terminal(io.StringIO):
    """A terminal that keeps all that was written to it."""

    encoding = "utf-8"

    def isatty(self) -> bool:
        return True

    def said(self) -> list[str]:
        """Return the phases and bars in the order in which they were first drawn."""
        texts = re.split(r"[\r\n]", self.getvalue())
        found = [re.split(r"\s{2,}\d\d:\d\d|\s+\d+%", text)[0].strip() for text in texts]
        return list(dict.fromkeys(text for text in found if text))


@pytest.fixture
def terminal(monkeypatch):
    """A terminal; a test puts it in the place of standard error itself, as pytest sets that after its fixtures."""
    monkeypatch.delenv("TERM", raising=False)
    return Terminal()


def in_order(wanted: list[str], said: list[str]) -> bool:
    rest = iter(said)
    return all(any(one == text for text in rest) for one in wanted)


def test_what_stands_in_order_is_told_from_what_does_not():
    assert in_order(["a", "c"], ["a", "b", "c"]) and not in_order(["c", "a"], ["a", "b", "c"])


_FIT = ["reading sample", "fitting ptm", "measuring", "measuring after export", "measuring the speed", "writing textures",
        "drawing pictures", "drawing the maps", "writing the report"]
_RELIEF = ["reading sample", "fitting lambert", "recovering the relief", "comparing the relief with a flat surface", "measuring"]
_CROP = ("--crop", "0", "0", "8", "8", "--no-cache")


@pytest.mark.parametrize(("arguments", "phases"), [
    (("fit", "ptm", "sample", *_CROP), _FIT),
    (("fit", "lambert", "sample", "--geometry", "recover", "--no-pictures", *_CROP), [*_RELIEF, "writing textures"]),
    (("fit", "distribution", "sample", "--set", "effort=0.01", "--geometry", "flat", "--no-pictures", "--measure", "none", *_CROP),
     ["reading sample", "fitting distribution", "finding where to start", "taking the first steps", "writing textures"]),
    (("compare", "sample", "--models", "ptm", *_CROP), ["reading sample", "writing the report"]),
    (("geometry", "sample", *_CROP), ["reading sample", "recovering the relief", "drawing pictures"]),
])
def test_a_command_names_what_it_does_in_order_and_without_colours(arguments, phases, terminal, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("NO_COLOR", "1")
    assert main([*arguments, "--out", str(tmp_path / "out")]) == 0
    assert in_order(phases, terminal.said()), terminal.said()
    assert "\x1b" not in terminal.getvalue()
    assert terminal.getvalue().endswith("\r")  # the last thing is to clear the line


def test_create_and_render_name_what_they_do(terminal, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "stderr", terminal)
    import numpy as np
    from PIL import Image

    rows = np.arange(16 * 16 * 3, dtype=np.uint8).reshape(16, 16, 3)
    Image.fromarray(rows).save(tmp_path / "cloth.png")
    assert main(["create", str(tmp_path / "cloth.png"), "--out", str(tmp_path / "made")]) == 0
    assert in_order(["reading cloth.png", "making the maps", "writing textures", "drawing the maps"], terminal.said())
    assert main(["render", str(tmp_path / "made"), "--size", "16"]) == 0
    assert in_order(["reading made", "rendering patch", "rendering sphere"], terminal.said())


def test_a_pipe_gets_nothing_of_it(capfd, tmp_path):
    assert main(["fit", "ptm", "sample", *_CROP, "--out", str(tmp_path / "out"), "--no-pictures"]) == 0
    assert capfd.readouterr().err == ""


def test_outside_a_command_only_what_shows_by_itself_is_shown(terminal, monkeypatch):
    monkeypatch.setattr(sys, "stderr", terminal)
    assert in_command() is False
    with phase("drawing"):
        assert terminal.getvalue() == ""
    with working("fitting"):
        assert terminal.said() == ["fitting"]
    with working("measuring", False):
        pass
    assert terminal.said() == ["fitting"] and line._LINE.doing == []


def test_a_line_says_share_time_and_what_is_left(monkeypatch):
    monkeypatch.setattr(line, "time", SimpleNamespace(monotonic=lambda: 100.0))
    bar = Activity("fitting", total=4, done=1, begun=90.0)
    text = bar.text(79, True)
    assert text.startswith("fitting  25% |") and text.endswith("00:10, 00:30 left") and len(text) <= 79
    timed = Activity("fitting", total=1000, seconds=20, begun=90.0).text(79, True)
    assert timed.endswith("00:10, 00:10 left") and " 50% " in timed
    assert Activity("fitting", total=4, begun=99.0).text(79, True).endswith("? left")
    assert Activity("reading a.zip", begun=38.8).text(79, True) == "reading a.zip  01:01"
    assert Activity("reading a.zip", begun=99.0).text(9, True) == "reading a"


def test_bars_within_a_whole_go_on_with_it(terminal, monkeypatch):
    monkeypatch.setattr(sys, "stderr", terminal)
    with whole("choosing parts", 30, "fitting", show=True) as bar:
        for round_ in range(2):
            for _ in progress(range(10), "fitting", show=True):
                assert line._LINE.doing == [bar]
            assert bar.done == 10 * (round_ + 1)
        for _ in progress(range(5), "fitting", show=True, each=2):
            pass
        assert bar.done == 30
        assert list(progress(range(3), "reading", show=True)) == [0, 1, 2]
    assert bar.done == 30 and line._LINE.doing == [] and bar.seconds == math.inf
    with whole("quiet", 3, show=False) as bar:
        bar.advance()
        assert line._LINE.doing == []
    assert terminal.getvalue() == ""  # over before they were worth a line


def test_a_bar_that_takes_long_is_drawn(terminal, monkeypatch):
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setattr(line, "_DELAY", 0.0)
    monkeypatch.setattr(line, "_BETWEEN", 0.0)
    assert list(progress("abc", "reading images")) == ["a", "b", "c"]
    assert [f"{share}%" in terminal.getvalue() for share in (33, 67, 100)] == [True] * 3
    assert terminal.getvalue().endswith("\r") and line._LINE.doing == []


def test_what_is_printed_stands_on_lines_of_its_own(monkeypatch, terminal):
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setattr(sys, "stdout", terminal)
    with announced("fit: starting"):
        with phase("reading a.zip"):
            print("lights     25")
        print("unfinished", end="")
        with phase("measuring"):
            assert not terminal.getvalue().endswith("00:00")  # would write over it
        print()
    assert "\rlights     25\n" in terminal.getvalue() and "unfinished\n" in terminal.getvalue()
    assert sys.stdout is terminal and sys.stderr is terminal


def test_the_line_lives_while_nothing_moves_and_ends_with_the_command(terminal, monkeypatch):
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setattr(line, "_TICK", 0.005)
    monkeypatch.setattr(line, "_FIRST", 0.005)
    with pytest.raises(KeyboardInterrupt), announced("fit: starting"):
        for what in ("fit: starting", "reading a.zip"):
            with working(what):
                before, until = terminal.getvalue().count(what), time.monotonic() + 20
                while terminal.getvalue().count(what) < before + 3 and time.monotonic() < until:
                    time.sleep(0.005)
                assert terminal.getvalue().count(what) >= before + 3
        with phase("fitting"):
            raise KeyboardInterrupt
    ended = terminal.getvalue()
    assert ended.endswith("\r") and line._LINE.doing == [] and line._LINE.session is None
    time.sleep(0.03)
    assert terminal.getvalue() == ended


def test_between_what_is_named_a_command_no_longer_starts(terminal, monkeypatch):
    monkeypatch.setattr(sys, "stderr", terminal)
    with announced("fit: starting", "fit"):
        line._LINE.draw()
        with phase("reading a.zip"):
            pass
        line._LINE.draw()
    assert [text.split("  ")[0].strip() for text in terminal.getvalue().split("\r")[1:4]] == ["fit: starting", "reading a.zip", "fit"]


def test_a_command_that_is_over_at_once_says_nothing(terminal, monkeypatch):
    monkeypatch.setattr(sys, "stderr", terminal)
    with announced("models: starting"):
        pass
    assert terminal.getvalue() == ""


def test_a_terminal_without_lines_to_draw_over_gets_each_phase_once(terminal, monkeypatch):
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("TERM", "dumb")
    with announced("fit: starting"), phase("reading a.zip"):
        line._LINE.draw()
        with phase("measuring"):
            line._LINE.draw()
    assert terminal.getvalue() == "reading a.zip\nmeasuring\n"


def test_a_terminal_that_is_gone_stops_no_work(terminal, monkeypatch):
    monkeypatch.setattr(sys, "stderr", terminal)
    def gone(text: str) -> int:
        raise OSError("gone")

    silent = line._LINE.silent
    monkeypatch.setattr(terminal, "write", gone)
    with announced("fit: starting"), phase("reading"):
        done = list(progress(range(3), "decoding"))
    assert done == [0, 1, 2]
    line._LINE.silent = silent


@pytest.mark.skipif(not hasattr(line.os, "fork"), reason="nothing forks here")
def test_a_forked_process_is_silent_and_needs_no_lock():
    code = """
import io, os, sys
from torchmat import progress as line
class Terminal(io.StringIO):
    isatty = lambda self: True
sys.stderr = made = Terminal()
with line.announced("fit"), line.working("tiles"):
    line._LINE.lock.acquire()
    before, child = made.getvalue(), os.fork()
    if child == 0:
        list(line.progress(range(9), "tile"))
        with line.working("tile"):
            os._exit(0 if made.getvalue() == before else 1)
    line._LINE.lock.release()
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.stdout.strip() == "0", done.stderr
