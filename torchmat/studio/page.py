"""The studio's page: the viewer's, with the studio's own panels in the place of an embedded material."""

from __future__ import annotations


def page_text() -> str:
    """Return the page as HTML."""
    return (
        '<!doctype html><meta charset="utf-8"><title>torchmat studio</title>'
        '<script type="module" src="/js/studio.js"></script><body></body>'
    )
