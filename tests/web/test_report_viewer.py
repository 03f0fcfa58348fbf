"""The viewer on the page of a fit."""

from __future__ import annotations

import pytest
from tests.web.pages import asked, opened, smooth

from torchmat.report.page import page as whole
from torchmat.report.page import paragraph
from torchmat.report.viewer import viewer_of


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    path = tmp_path_factory.mktemp("reports") / "report.html"
    parts = [paragraph("A verdict.", "verdict fair"), viewer_of(smooth("lambert", side=600)), *(paragraph("Much text.") for _ in range(60))]
    path.write_text(whole("A fit", parts), encoding="utf-8")
    return path


def test_the_wheel_scrolls_the_page_until_the_picture_was_chosen(chromium, path):
    page = opened(chromium, path, 900, 600)
    page.locator("canvas").first.hover()
    page.mouse.wheel(0, 100)
    page.wait_for_function("scrollY > 0")
    assert asked(page, "viewer.state.view.zoom") == 1
    page.locator("canvas").first.click()
    page.mouse.wheel(0, -100)
    assert asked(page, "viewer.state.view.zoom") == pytest.approx(1.1)
    assert "512 x 512 texels; the material has 600 x 600" in page.text_content(".tmv-side")
    assert page.problems == []
    page.close()


@pytest.mark.parametrize("scheme, paper", [("light", "rgb(227, 231, 235)"), ("dark", "rgb(32, 38, 44)")])
def test_it_is_light_or_dark_as_the_page_and_fits_a_phone(chromium, path, scheme, paper):
    page = opened(chromium, path, 390, 844, color_scheme=scheme)
    assert page.evaluate("getComputedStyle(document.querySelector('.tmv-stage')).backgroundColor") == paper
    corner = "(() => { const p = viewer.scene.picture(viewer.picture(), 8, 8); return [...p.slice(0, 3)]; })()"
    assert asked(page, corner) == [int(one) for one in paper[4:-1].split(", ")]
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    assert page.evaluate("[...document.querySelectorAll('.tmv details')].every((one) => !one.open)")
    page.close()


def test_what_cannot_be_held_is_said_and_a_model_without_a_shader_has_none(monkeypatch):
    from torchmat.errors import RangeError
    from torchmat.web import shown

    def refuse(*given, **more):
        raise RangeError("describe: a texture must have at most 4 channels; albedo has 5.")

    assert viewer_of(smooth("pca", side=8)) == ""
    monkeypatch.setattr(shown, "describe", refuse)
    assert viewer_of(smooth("texture", side=8)) == \
        '<p class="soft">It is not shown here: describe: a texture must have at most 4 channels; albedo has 5.</p>'
