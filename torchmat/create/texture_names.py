"""What a texture's file name says it is, in the words of ambientCG, Poly Haven, Quixel, Substance, Poliigon and others."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence

KINDS = (
    "color", "opacity", "displacement", "normalgl", "normaldx", "normal", "roughness", "gloss", "metalness", "specular",
    "specularlevel", "ambientocclusion",
)
_WORDS = {
    "color": "color colour col coll basecolor basecolour albedo alb diffuse diff dif diffusecolor bc albedotransparency "
             "alphamasked",
    "opacity": "opacity alpha alphamask cutout",
    "displacement": "displacement displace disp displ height heightmap hgt",
    "bump": "bump bumpmap",
    "normalgl": "normalgl norgl normgl nrmgl normalogl normalopengl",
    "normaldx": "normaldx nordx normdx nrmdx normaldirectx",
    "normal": "normal normals normalmap nor norm nrm nml",
    "roughness": "roughness rough rgh",
    "gloss": "gloss glossiness glossy smoothness",
    "metalness": "metalness metallic metal metallness met",
    "specular": "specular spec specularcolor reflection refl f0",
    "specularlevel": "specularlevel speclevel",
    "ambientocclusion": "ambientocclusion ambientocc ao occlusion occ mixedao",
}
# Channels of one file, in their order; a fourth is alpha.
PACKED = {
    **dict.fromkeys(("arm", "orm", "aorm", "occlusionroughnessmetallic", "aoroughnessmetallic"),
                    ("ambientocclusion", "roughness", "metalness")),
    **dict.fromkeys(("rma", "rmao"), ("roughness", "metalness", "ambientocclusion")),
    **dict.fromkeys(("mra", "mrao"), ("metalness", "roughness", "ambientocclusion")),
    **dict.fromkeys(("metallicroughness", "metalroughness", "metalrough"), ("", "roughness", "metalness")),
    **dict.fromkeys(("metallicsmoothness", "metallicgloss", "metallicglossiness"), ("metalness", "", "", "gloss")),
    "ord": ("ambientocclusion", "roughness", "displacement"),
    "maskmap": ("metalness", "ambientocclusion", "", "gloss"),
}
# Of the first letters that Unreal's names end in only these have one meaning.
_LETTERS = {"b": "color", "d": "color", "n": "normal", "h": "displacement", "r": "roughness"}
# Maps that are understood, and that torchmat has no place for.
_NO_PLACE = frozenset(
    "emission emissive emit glow translucency translucent transmission transmissive transparency subsurface sss scattering "
    "thickness cavity curvature fuzz sheen mask id idmap brush anisotropy anisotropic anisotropylevel anisotropyangle "
    "worldnormal position clearcoat coat ior specior detail edge".split()
)
_PREVIEWS = frozenset("preview render thumb thumbnail sphere cover header icon screenshot ball".split())
_KIND_OF = {word: kind for kind, words in _WORDS.items() for word in words.split()}
_RESOLUTION = re.compile(r"\d{1,2}k|\d{3,5}(px)?|\d+x\d+", re.IGNORECASE)
_VARIANT = re.compile(
    r"\d{1,2}(bit|b)?|lod\d*|var\d*|v\d+|udim|jpe?g|png|exr|tiff?|tga|hi|lo|hires|highres|lowres|seamless|tiled?|tileable",
    re.IGNORECASE,
)
_CAMEL = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")
_LONGEST = 4  # words of a kind: Occlusion Roughness Metallic and one to spare


def kind_of(stem: str) -> str | None:
    """Return what a file name without its suffix says the texture is; None where it says nothing.

    A kind of KINDS or "bump", a name of PACKED, "preview", or ``"no place: NAME"`` for a map that torchmat does not use.
    Words for resolution, format, bit depth and variant are left out, and the kind is what the name then ends in.
    """
    words = re.findall(r"[A-Za-z0-9]+", stem)
    # Poliigon ends names in the workflow: _COL_2K_METALNESS.
    workflow = len(words) > 2 and words[-1].lower() in ("metalness", "specular") and _RESOLUTION.fullmatch(words[-2])
    if workflow and (found := _ending(words[:-2])):
        return found
    return _ending(words)


def without_name(stems: Sequence[str]) -> list[str]:
    """Return file names, without suffixes, without the words that all begin with, the name of the set: Metal_Roughness is roughness
    where there is Metal_Color. A name that has no other words stays as it is."""
    words = [re.findall(r"[A-Za-z0-9]+", stem) for stem in stems]
    shared = len(os.path.commonprefix(words)) if len(words) > 1 else 0
    return ["_".join(one[shared:]) if len(one) > shared else stem for one, stem in zip(words, stems, strict=True)]


def _ending(words: list[str]) -> str | None:
    words, numbered = list(words), False
    while words and (_RESOLUTION.fullmatch(words[-1]) or _VARIANT.fullmatch(words[-1])):
        numbered |= not _RESOLUTION.fullmatch(words.pop())
    if not words:
        return None
    with_number = re.fullmatch(r"([A-Za-z]+)\d+", words[-1])
    if with_number:
        words[-1], numbered = with_number[1], True  # NRM16, col1
    if len(words) > 1 and words[0] == "T" and words[-1].lower() in _LETTERS:
        return _LETTERS[words[-1].lower()]
    parts = [part.lower() for word in words for part in _CAMEL.findall(word)]
    for count in range(min(_LONGEST, len(parts)), 0, -1):
        word = "".join(parts[-count:])
        if count == len(parts) and numbered:
            continue  # Metal032 is the name of a material
        if word in _KIND_OF or word in PACKED:
            return _KIND_OF.get(word, word)
        if word in _PREVIEWS:
            return "preview"
        if word in _NO_PLACE:
            return f"no place: {word}"
    return None
