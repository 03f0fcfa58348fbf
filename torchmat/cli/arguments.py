"""Arguments that several commands share: how images are read, names in a list, settings, and folders to write."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from torchmat.cli.known import ENCODINGS, FROM_1, POSITIVE
from torchmat.progress import phase

SAMPLE = "sample"
NO_INTENSITIES = "none"
_MASK_WORDS = ("alpha", "background", "none")


@dataclass
class DataArguments:
    """How the images are read."""

    reads: ClassVar = ("lights", "ball", "mask_file")
    words: ClassVar = {"encoding": ENCODINGS, "invalid": ("error", "mask"), "duplicates": ("error", "keep")}
    bounds: ClassVar = {
        "exposure": POSITIVE, "downscale": FROM_1, "near": POSITIVE, "distance": POSITIVE, "clipped_weight": ("lie in [0, 1]", 0, 1),
    }
    cache: Path | None = None
    """Folder for decoded images (default: the user's cache folder, or $TORCHMAT_CACHE)."""
    no_cache: bool = False
    """Decode anew and leave nothing behind."""
    kind: str | None = None
    """manifest, rti, ubo2003, utia, stereo, brdf, ubo2014, neuralbtf, or another reader's name; found from the content when left out."""
    encoding: str | None = None
    """auto, srgb, linear, or xyz: CIE XYZ under D65, even where the channels are called R, G, B."""
    exposure: float | None = None
    """The factor the photographs were exposed with; values are divided by it."""
    crop: tuple[int, int, int, int] | None = None
    """Top, left, height and width in texels."""
    downscale: int | None = None
    """Whole factor to shrink the images by, in linear light."""
    invalid: str | None = None
    """error, or mask: NaN and Inf get no weight."""
    duplicates: str | None = None
    """error, or keep: repeated directions are allowed."""
    normalise: bool = False
    """Bring directions that are not unit vectors to length 1."""
    lights: Path | None = None
    """Table with the lights of photographs under one view: an .lp file, CSV, or x y z of one light a line (or a column) in
    the natural order of the photographs (img2 before img10), or that of a filenames.txt beside them; or a RelightLab .dome."""
    ball: Path | None = None
    """Folder of photographs of a chrome ball under the same lights, called alike or in the same order."""
    circle: tuple[float, float, float] | None = None
    """The ball's centre (column, row) and radius in pixels."""
    intensities: str | None = None
    """File with the intensity of each light, one number or red, green and blue; or estimate; or none, those of the table
    alone (default: as none; geometry estimates them where that explains the photographs far better)."""
    mask: str | None = None
    """Picture in the photographs' size, white on the object: all else counts nowhere; or alpha, background (what is dark in all
    photographs, from the border on: a guess), or none (default: a mask.png beside them, else their alpha)."""
    skip_bad_lights: bool = False
    """Leave out lights below the surface and lines whose photograph is not there, instead of refusing all."""
    near: float | None = None
    """Width of the pictured sample in the unit of the table's vectors: they are then positions of near lights from the sample's
    centre, and each texel has a direction of its own (default: lights are far, unless a manifest has a sample_width, or a dome positions)."""
    distance: float | None = None
    """How far all lights are from the sample's centre, in the unit of --near, where the table holds directions: a dome's radius."""
    no_falloff: bool = False
    """The images do not darken with the distance to near lights: that was taken out already."""
    write_lights: Path | None = None
    """Write the lights of photographs under one view as an .lp file; with --ball also a picture of its highlights."""
    verbose: bool = False
    """Print the light of every photograph, not of the first and the last alone."""
    clipped_weight: float | None = None
    """What a clipped sample counts in the fit, 0 to 1."""

    @property
    def mask_file(self) -> str | None:
        """The picture that is given as a mask, None where a word says which."""
        return None if self.mask in _MASK_WORDS else self.mask

    def keywords(self) -> dict[str, Any]:
        """Return what was given on the command line as keywords of `load_btf`."""
        names = ("kind", "encoding", "exposure", "crop", "downscale", "invalid", "duplicates", "clipped_weight", "circle", "mask", "near", "distance")
        given = {name: getattr(self, name) for name in names if getattr(self, name) is not None}
        given |= {name: True for name in ("normalise", "skip_bad_lights") if getattr(self, name)}
        given |= {"falloff": False} if self.no_falloff else {}
        paths = {"light_table": self.lights, "ball": self.ball}
        given |= {name: str(path) for name, path in paths.items() if path is not None}
        if self.intensities not in (None, NO_INTENSITIES):
            given["intensities"] = self.intensities
        return {**given, "cache": False if self.no_cache else (self.cache or True)}

    def load(self, path: str, settings: dict | None = None):
        """Load the BTF; arguments given on the command line override the config's [data].

        Of one view the light of each photograph is said, and written where that is asked for.
        """
        from torchmat import load_btf, sample_path
        from torchmat.report.lights import lights_text

        where = sample_path() if path == SAMPLE and not Path(path).exists() else path
        with phase(f"reading {Path(path).name}"):
            btf = load_btf(where, **{**(settings or {}), **self.keywords()})
        for line in lights_text(btf, self.verbose):
            print(line)
        if self.write_lights is not None:
            self._write_lights(btf, self.write_lights)
        return btf

    def _write_lights(self, btf, path: Path) -> None:
        from torchmat.report.lights import ball_picture, write_lights

        print(f"lights     {write_lights(btf, path)}")
        if self.ball is not None and self.circle is not None:
            print(f"picture    {ball_picture(self.ball, self.circle, path.with_suffix('.png'))}")


def data_of(command: str, given: str | None, named: str | None) -> str | None:
    """Return the data of a command that takes it in its place and as --data; raises RangeError where these differ."""
    from torchmat.errors import RangeError, message

    if given is not None and named is not None and given != named:
        fact, step = f"{given} stands in its place, and --data is {named}", "Leave one of them out."
        raise RangeError(message(command, "the data", "be named once", fact, step))
    return named if given is None else given


def names_of(texts: list[str]) -> list[str]:
    """Return the names in a list that has commas, spaces, or both between them."""
    return [name.strip() for text in texts for name in text.split(",") if name.strip()]


def options_of(texts: list[str]) -> dict[str, Any]:
    """Return the options that texts such as ``depth=16`` give; raises RangeError for other texts."""
    from torchmat.errors import RangeError, message
    from torchmat.text_file import parse_value

    found: dict[str, Any] = {}
    for text in texts:
        name, separator, value = text.partition("=")
        if not separator or not name.strip():
            fact, step = "it has no name or no '='", "For example --set depth=16."
            raise RangeError(message("--set", repr(text), "be OPTION=VALUE", fact, step))
        found[name.strip()] = parse_value(value)
    return found


def provenance_of(material: str) -> dict[str, Any]:
    """Return what a material folder says of where it comes from; nothing of another path."""
    from torchmat.material_io.folder import MANIFEST
    from torchmat.material_io.read_folder import read_manifest

    found = read_manifest(material).get("provenance") if (Path(material) / MANIFEST).is_file() else None
    return dict(found) if isinstance(found, dict) else {}


def check_apart(command: str, out: Path, *materials: str) -> None:
    """Raise RangeError when the target of a command is one of the materials that it works on."""
    from torchmat.errors import RangeError, message

    for material in materials:
        if out.resolve() == Path(material).resolve():
            step = "Name another folder: what was painted there would be lost."
            raise RangeError(message(command, "--out", "be another than the material", f"both are {material}", step))


def check_out(command: str, out: Path, *materials: str, force: bool = False) -> None:
    """Raise unless `out` may become a material folder, and is none of the `materials` that the command works on."""
    from torchmat.material_io import check_target

    check_apart(command, out, *materials)
    check_target(out, force)


def still_free(out: Path, force: bool) -> Path:
    """Return `out`, or a free name beside it when something was painted there while the result was made."""
    from torchmat import atomic
    from torchmat.errors import DataError, notice
    from torchmat.material_io import check_target

    try:
        check_target(out, force)
        return out
    except DataError as error:
        other = atomic.free_name(out, "new")
        notice(str(error), f"The result is in {other} instead")
        return other
