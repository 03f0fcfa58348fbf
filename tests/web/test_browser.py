"""The browser that other tests hold pages in."""

from __future__ import annotations

import asyncio

from tests.web import browser


def test_a_page_computes_and_other_loops_run_beside_it(chromium):
    page = chromium.open()
    assert page.evaluate("[1 + 1, 'two', {a: [3.5]}]") == [2, "two", {"a": [3.5]}]
    assert asyncio.run(asyncio.sleep(0, "done")) == "done"
    page.close()


def test_a_site_of_the_package_has_its_files_and_those_given(chromium):
    page = chromium.open_package("start.html", {"start.html": "<p>here</p>", "one.js": "export const one = 1;"})
    assert page.inner_text("p") == "here"
    assert page.evaluate("async () => (await import('/one.js')).one") == 1
    assert "Material" in page.evaluate("async () => (await fetch('/models/base.py')).text()")
    assert page.evaluate("async () => (await fetch('/none.js')).status") == 404
    page.close()


def test_a_page_tells_its_problems(chromium):
    page = chromium.open()
    page.evaluate("() => { console.error('said'); setTimeout(() => { throw new Error('thrown'); }); }")
    page.wait_for_timeout(50)
    assert [text for text in page.problems if text in ("said", "thrown")] == ["said", "thrown"]
    page.close()


def test_there_are_float_targets(chromium):
    page = chromium.open()
    names = page.evaluate("document.createElement('canvas').getContext('webgl2').getSupportedExtensions()")
    assert {"EXT_color_buffer_float", "OES_texture_float_linear", "WEBGL_lose_context"} <= set(names)
    page.close()


def test_what_is_missing_is_said(monkeypatch):
    monkeypatch.setattr(browser, "_executable", lambda: None)
    assert "chromium" in browser.missing()
