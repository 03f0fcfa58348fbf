"""Fixtures of tests that need a browser."""

from __future__ import annotations

import pytest
from tests.web.browser import Chromium, missing


@pytest.fixture(scope="session")
def chromium():
    """One browser for all tests of a process; they skip, saying why, where there is none."""
    why = missing()
    if why:
        pytest.skip(why)
    browser = Chromium()
    yield browser
    browser.close()
