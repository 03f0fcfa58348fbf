"""The material on the page of its fit, moving: the viewer of `torchmat.web` in small."""

from __future__ import annotations

from collections.abc import Sequence

from torchmat.errors import TorchmatError
from torchmat.models import Material
from torchmat.report.map_cards import MapCard
from torchmat.report.page import Markup, paragraph

_SAID = "Drag to turn it, with shift to move the light; keys and fingers do the same. It is drawn from the textures as they are stored."


def viewer_of(material: Material, errors: Sequence[MapCard] = ()) -> Markup:
    """Return the viewer of a material as part of a page; of a model that no page can draw, nothing: its pictures stand there too.

    No pictures are made for browsers that cannot draw it. A material that cannot be held in a page costs no report: the page
    then says why. `errors` are cards of standard errors that stand behind the maps.
    """
    from torchmat.web.page import QUICK
    from torchmat.web.payload import has_shader
    from torchmat.web.shown import show

    if not has_shader(material):
        return Markup("")
    try:
        shown = show(material, stills=False, options={"embedded": True}, level=QUICK, thumbnails=[
            {"name": card.name, "said": card.meaning, "extent": card.extent, "uri": card.picture} for card in errors
        ])
    except TorchmatError as error:
        return paragraph(f"It is not shown here: {error}", "soft")
    return Markup(shown.element + paragraph(_SAID, "soft"))
