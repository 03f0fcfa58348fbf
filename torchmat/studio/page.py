"""The studio's page: the viewer's, with scripts and style that are fetched, for it is served."""

from __future__ import annotations

import html

from torchmat.web.page import ROOT, whole_page


def page_text(name: str, said: str) -> str:
    """Return the page of a material called `name` as HTML."""
    viewer = (
        '<link rel="stylesheet" href="/js/style.css"><link rel="stylesheet" href="/js/studio.css">'
        f'<div class="tmv" id="{ROOT}" data-name="{html.escape(name)}"><p class="tms-wait">The material is being read.</p>'
        "<noscript><p>The studio needs JavaScript.</p></noscript></div>"
        '<script type="module" src="/js/studio.js"></script>'
    )
    return whole_page(name, said, viewer)
