"""Fixtures of tests that need a browser."""

from __future__ import annotations

import pytest
from tests.web.browser import Chromium, missing
from tests.web.drawing import Drawing


@pytest.fixture(scope="session")
def chromium():
    """One browser for all tests of a process; they skip, saying why, where there is none."""
    why = missing()
    if why:
        pytest.skip(why)
    browser = Chromium()
    yield browser
    browser.close()


@pytest.fixture(scope="session")
def shared_drawing(chromium):
    """One page that shades, for all tests of a process."""
    drawing = Drawing(chromium)
    yield drawing
    assert drawing.close() == []


@pytest.fixture
def drawing(shared_drawing):
    """A page that shades, in which nothing has gone wrong."""
    del shared_drawing.page.problems[:]
    return shared_drawing
