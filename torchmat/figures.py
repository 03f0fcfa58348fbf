"""What the figures of a report are called, in which direction each is better, and of which photographs it is."""

from __future__ import annotations

from typing import NamedTuple

LOWER, HIGHER = "lower is better", "higher is better"


class Figure(NamedTuple):
    """What one key is called, in which direction it is better ("" where it is neither), and what it says."""

    name: str
    better: str
    meaning: str


FIGURES = {
    "relative_error": Figure("Relative error", LOWER, "Squared error over squared brightness, in linear light: 0 is perfect, 1 is a black picture."),
    "relative_error_interval": Figure("Relative error, 95 % interval", LOWER, "Between what it would lie had other photographs been "
                                      "measured, drawn anew from these: wide where a few highlights decide it."),
    "psnr_db": Figure("PSNR, dB", HIGHER, "Peak over error as displayed: 20 dB is off by a tenth of white, 40 dB by a hundredth."),
    "psnr_log_db": Figure("PSNR of logarithms, dB", HIGHER, "The same in logarithms, where dark texels count as much as highlights."),
    "ssim": Figure("Structural similarity (SSIM)", HIGHER, "Whether patterns agree: 1 is alike, 0 unrelated."),
    "delta_e": Figure("Colour difference (CIEDE2000)", LOWER, "Mean difference in colour: 1 is just visible, 5 plain."),
    "mse": Figure("Mean squared error", LOWER, "In linear light, where 1 is white."),
}
PARTS = {"train": "photographs the fit saw", "held_out": "unseen photographs", "held_out_after_export": "unseen, as the textures hold it",
         "held_out_after_packing": "unseen, packed", "test": "test photographs, none of the data",
         "test_after_export": "test, as the textures hold it"}
