"""What a reader sees instead of the keys of a report: figures with the better direction, stop reasons, splits, maps with units."""

from __future__ import annotations

import math

from torchmat.figures import FIGURES, HIGHER, LOWER, PARTS, Figure

__all__ = [
    "COMPARED", "FIGURES", "GEOMETRIES", "HIGHER", "LOWER", "PARTS", "SOLVERS", "SPLITS", "STOPPED", "Figure", "figure_of", "parameter", "spaced",
    "stopped", "texture_name", "unit_of",
]
_BY_TERM = ("polynomial", "residual", "luminance", "harmonic")
COMPARED = {
    "model": Figure("Model", "", "The model and its options, as the command line takes them."),
    "solver": Figure("Solver", "", "How its numbers are found."),
    "geometry": Figure("Geometry", "", "Flat, or the relief that was recovered; \"flat (recover)\" where none was found worth it."),
    "bytes_per_texel": Figure("Bytes a texel", LOWER, "Bytes of the textures' codes per texel."),
    "shared_bytes": Figure("Shared bytes", LOWER, "Bytes of what all texels share: tables and numbers."),
    "total_bytes_per_texel": Figure("Bytes a texel, all", LOWER, "Textures and what all texels share, per texel of this data."),
    "fit_seconds": Figure("Fit, seconds", LOWER, "Seconds of the fit, the images already decoded: the median of all repeats."),
    "fit_seconds_spread": Figure("Spread, seconds", LOWER, "The longest less the shortest of the repeats."),
    "fit_memory_mb": Figure("Memory, MB", LOWER, "The most memory that the fit took beyond what was held before it. Where a curve is "
                            "drawn and nothing repeated, measuring it is included."),
    "shade_mtexels_per_s": Figure("Shading, million texels a second", HIGHER, "Million texels shaded a second under one light and view."),
    "train_relative_error": Figure("Relative error, seen", LOWER, "On photographs that the fit saw."),
    "relative_error": Figure("Relative error, unseen", LOWER, "On photographs that were held out, the same for all models."),
    "relative_error_low": Figure("Relative error, unseen, at least", LOWER, "Where its 95 % interval begins, over photographs drawn anew."),
    "relative_error_high": Figure("Relative error, unseen, at most", LOWER, "Where its 95 % interval ends."),
    "psnr_db": Figure("PSNR, dB, unseen", HIGHER, "Peak over error as displayed, on the same photographs."),
    "relative_error_after_export": Figure("Relative error, unseen, exported", LOWER, "The same of what the textures hold."),
    "psnr_db_after_export": Figure("PSNR, dB, unseen, exported", HIGHER, "The same of what the textures hold."),
    "stop_reason": Figure("Stopped because", "", "Why the solver stopped; \"budget spent\": it would have gone on."),
    "front": Figure("Best in its class", "", "In what no other row is both better and cheaper: bytes, seconds, shading (the Pareto front)."),
    "same_bits": Figure("Repeats alike", "", "Whether all repeats gave the same bits; a fit that a budget stopped need not."),
    "failed": Figure("Failed because", "", "Why there is no result."),
}
STOPPED = {
    "converged": "nothing was left to gain", "directions left open": "what was left to gain is not determined by the data",
    "step limit": "it had made its steps, and would have gone on", "budget spent": "its seconds were spent, and it would have gone on",
    "not finite": "its numbers left the range that can be computed with", "diverged": "the error grew instead of falling",
}
SOLVERS = {"lm": "Levenberg-Marquardt", "varpro": "variable projection", "lbfgs": "L-BFGS", "adam": "Adam"}
SPLITS = {"pair": "pairs of light and view", "light": "whole lights", "view": "whole views",
          "both": "new light and new view", "arc": "arcs of directions"}
GEOMETRIES = {"flat": "flat", "recover": "recovered from the photographs", "given": "a given height map"}
# The unit of what a map holds; what has none here is a plain number.
_UNITS = {
    "height": "texture widths", "opacity": "share covered, 0 to 1", "ambient": "light, of 1 that falls in",
    "fresnel": "share reflected head-on, 0 to 1",
    "rotation": "direction; hue on the sheet", "tilt": "share lost, over 0 to 90 degrees", "normal": "unit vector", "index": "share, 0 to 1",
    "albedo": "share of light, linear", "diffuse": "share of light, linear", "specular_mask": "factor, linear",
    "specular": "factor, linear; logarithms are shown", "slices": "value, linear",
    "cluster": "number of a cluster", "turn": "k over sine of the angle", "directions": "projected, -1 to 1", "brightest": "value, linear",
    "reflectance": "value, linear", "images": "value, linear", "tint": "factor, linear",
}
_COLOURS = {"r": "red", "g": "green", "b": "blue"}
_DULLER = "slope, no unit; larger is duller"
_SHAPES = {"exponent": "no unit; larger is sharper", "roughness": _DULLER, "alpha": _DULLER}
_TERMS = {"hx": "half vector x", "hy": "half vector y", "hz": "half vector z", "cos": "cosine of the light", "1": "constant",
          **{f"{letter}{axis}": f"{what} {axis}" for letter, what in (("l", "light"), ("v", "view")) for axis in "xyz"}}


def figure_of(key: str) -> Figure:
    """Return what a key of a report's figures, or of a comparison's or a summary's rows, is called."""
    return COMPARED.get(key) or FIGURES.get(key) or Figure(spaced(key).capitalize(), "", "")


def spaced(name: str) -> str:
    """Return a key as words."""
    return name.replace("_", " ").strip()


def stopped(reason: str) -> str:
    """Return why a fit stopped, as a person says it; a reason without words of its own as it is."""
    return f"{reason}: {STOPPED[reason]}" if reason in STOPPED else spaced(reason)


def unit_of(name: str) -> str:
    """Return the unit of a map's values, "" for plain numbers."""
    return _UNITS.get(name, "")


def texture_name(texture: str, map_name: str) -> str:
    """Return what one texture of a map is called: the terms of a basis in words, everything else without its underscores."""
    layer = texture[len(map_name) + 1 :]
    terms = layer.split("_")
    if not layer or not all(term in _TERMS for term in terms) or (terms == ["1"] and map_name not in _BY_TERM):
        return spaced(texture)
    return f"{spaced(map_name)}, {' times '.join(_TERMS[term] for term in terms)}"


def parameter(name: str, value: float) -> tuple[str, float, str]:
    """Return name, value and unit of one parameter of a lobe: what is fitted as a logarithm as itself, angles in degrees."""
    if name == "axis":
        return "direction of the brushing", math.degrees(value), "degrees from +x"
    if name.startswith("log_"):
        shape = name.removeprefix("log_")
        return spaced(shape), math.exp(value), _SHAPES.get(shape.split("_")[0], "no unit")
    part, _, channel = name.rpartition("_")
    if channel in _COLOURS:
        return f"{spaced(part)}, {_COLOURS[channel]}", value, "share of light, linear"
    return spaced(name), value, "no unit"
