"""The command line: torchmat fit, render, compare, info, geometry, create."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from torchmat.errors import TorchmatError

_SAMPLE = "sample"


@dataclass
class DataArguments:
    """How the images are read."""

    cache: Path | None = None
    """Folder for decoded images (default: the user's cache folder, or $TORCHMAT_CACHE)."""
    no_cache: bool = False
    """Decode anew and leave nothing behind."""
    kind: str | None = None
    """manifest, rti, ubo2003 or utia; found from the content when left out."""
    encoding: str | None = None
    """auto, srgb or linear."""
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
    normalise: bool | None = None
    """Bring directions that are not unit vectors to length 1."""
    clipped_weight: float | None = None
    """What a clipped sample counts in the fit, 0 to 1."""

    def load(self, path: str, settings: dict | None = None):
        """Load the BTF; arguments given on the command line override the config's [data]."""
        from torchmat import load_btf, sample_path

        names = ("kind", "encoding", "exposure", "crop", "downscale", "invalid", "duplicates", "normalise", "clipped_weight")
        given = {name: getattr(self, name) for name in names if getattr(self, name) is not None}
        cache = False if self.no_cache else (self.cache or True)
        where = sample_path() if path == _SAMPLE and not Path(path).exists() else path
        return load_btf(where, **{**(settings or {}), **given}, cache=cache)


@dataclass
class Fit:
    """Fit a material to a BTF and write it with its report and pictures."""

    config: Annotated[Path, tyro.conf.Positional]
    """TOML config, for example configs/phong_srf.toml."""
    data: str = _SAMPLE
    """Folder or zip of images; `sample` is the one that ships with the package."""
    out: Path = Path("out")
    """Folder to write; an earlier material there is replaced."""
    set: Annotated[list[str], tyro.conf.UseAppendAction] = field(default_factory=list)
    """Override a key of the config, for example --set options.residual=half_light; may be repeated."""
    no_pictures: bool = False
    """Write the material and report.json only."""
    read: Annotated[DataArguments, tyro.conf.arg(name="")] = field(default_factory=DataArguments)

    def run(self) -> None:
        from torchmat.fit import fit, load_config
        from torchmat.fit.on_relief import GEOMETRIES
        from torchmat.material_io import check_target, load_height
        from torchmat.report import write_fit
        from torchmat.report.tables import error_table, summary_table

        check_target(self.out)  # before the work, not after it
        config = load_config(self.config, self.set)
        height = None if config.geometry in GEOMETRIES else load_height(config.geometry)
        btf = self.read.load(self.data, config.data)
        result = fit(btf, config, geometry=height)
        folder = write_fit(btf, result, self.out, pictures=not self.no_pictures)
        print(summary_table(result.report))
        print()
        print(error_table(result.report))
        print()
        print(f"material   {folder}")
        for path in sorted(folder.glob("report.*")) + sorted((folder / "pictures").glob("*.png")):
            print(f"{'report' if path.stem == 'report' else 'picture':10s} {path}")


@dataclass
class Render:
    """Relight a fitted material: the flat patch and a sphere."""

    material: Annotated[Path, tyro.conf.Positional]
    """Material folder."""
    out: Path | None = None
    """Folder for the pictures (default: pictures/ inside the material folder)."""
    light: Annotated[list[tuple[float, float, float]], tyro.conf.UseAppendAction] = field(default_factory=list)
    """Direction to a light, x y z; may be repeated, lights add up."""
    view: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """Direction to the viewer of the patch."""
    size: int = 512
    """Width of the pictures."""
    repeat: float = 2.0
    """How often the texture fits a quarter of the sphere's equator."""
    exposure: float = 1.0
    """Factor on the 8-bit pictures' brightness."""
    exr: bool = False
    """Write linear EXR beside the 8-bit PNG."""

    def run(self) -> None:
        from torchmat import load_material, render
        from torchmat.render.files import write_picture
        from torchmat.render.render import DEFAULT_LIGHT

        material = load_material(self.material)
        lights = self.light or [DEFAULT_LIGHT]
        folder = self.out or self.material / "pictures"
        for mesh, view, repeat in (("patch", self.view, 1.0), ("sphere", (0.0, 0.0, 1.0), self.repeat)):
            picture = render(material, mesh, lights, view=view, size=self.size, repeat=repeat)
            for path in write_picture(picture, folder / f"render_{mesh}.png", self.exposure, self.exr):
                print(f"picture    {path}")


@dataclass
class Compare:
    """Fit several models to one BTF and print and plot speed against error."""

    data: Annotated[str, tyro.conf.Positional] = _SAMPLE
    """Folder or zip of images; `sample` is the one that ships with the package."""
    models: list[str] = field(default_factory=list)
    """Names, with options after a colon: ptm hsh:terms=16 phong_srf:residual=half_light (default: all families)."""
    out: Path | None = Path("comparison")
    """Folder for JSON, CSV, HTML and plots; None only prints."""
    holdout: float = 0.2
    """Share of samples held out."""
    holdout_by: str = "pair"
    """pair, light or view."""
    seed: int = 0
    """Seed of the split and of the solvers."""
    read: Annotated[DataArguments, tyro.conf.arg(name="")] = field(default_factory=DataArguments)

    def run(self) -> None:
        from torchmat.report.compare import DEFAULT_MODELS, check_target, compare, write_comparison
        from torchmat.report.tables import comparison_table

        if self.out is not None:
            check_target(self.out)
        btf = self.read.load(self.data)
        rows = compare(
            btf, self.models or DEFAULT_MODELS, holdout=self.holdout, holdout_by=self.holdout_by, seed=self.seed
        )
        print(comparison_table(rows))
        for row in rows:
            if row["failed"]:
                print(f"{row['model']}: {row['failed']}")
        if self.out is not None:
            print(f"comparison {write_comparison(rows, self.out, f'Models on {Path(self.data).name}')}")


@dataclass
class Info:
    """Describe any input: a folder or zip of images, or a material folder."""

    path: Annotated[str, tyro.conf.Positional] = _SAMPLE
    """What to describe."""
    plot: Path | None = None
    """Where to write the picture of lights and views (default: directions.png in the current folder; BTFs only)."""
    no_plot: bool = False
    """Print only."""
    read: Annotated[DataArguments, tyro.conf.arg(name="")] = field(default_factory=DataArguments)

    def run(self) -> None:
        from torchmat.report.describe import describe_btf, describe_material, is_material

        if is_material(self.path):
            print(describe_material(self.path))
            return
        btf = self.read.load(self.path)
        print(describe_btf(btf))
        if not self.no_plot:
            from torchmat.report.pictures import directions_picture

            print(f"picture    {directions_picture(btf, self.plot or Path('directions.png'))}")


@dataclass
class Geometry:
    """Recover height and normals: from a BTF, from photographs of one view under known lights, or from one picture."""

    path: Annotated[str, tyro.conf.Positional]
    """BTF or RTI capture, a folder of photographs with --lights or --ball, or one picture."""
    out: Path = Path("relief")
    """Folder to write."""
    lights: Path | None = None
    """Text file with x y z of one light a line (or a column), in the order of the photographs' names."""
    ball: Path | None = None
    """Folder of photographs of a chrome ball under the same lights, in the same order."""
    circle: tuple[float, float, float] | None = None
    """The ball's centre (column, row) and radius in pixels."""
    tiles: bool = False
    """The surface repeats: its left border continues its right one."""
    depth: str = "16"
    """16 (PNG) or float (EXR)."""
    integration: str = "poisson"
    """One view only: poisson (weighted by confidence) or fourier (Frankot-Chellappa)."""
    height_scale: float = 0.05
    """One picture only: height of white, in texture widths."""
    normal_strength: float = 1.0
    """One picture only: 1 to 8."""
    read: Annotated[DataArguments, tyro.conf.arg(name="")] = field(default_factory=DataArguments)

    def run(self) -> None:
        from torchmat.material_io.relief import check_target, save_relief
        from torchmat.report.pictures import relief_picture

        check_target(self.out)  # before the work, not after it
        relief = self._recover()

        def draw(building: Path) -> None:
            relief_picture(relief, building / "relief.png")

        folder = save_relief(relief, self.out, self.depth, {"source": self.path}, draw)
        for path in sorted(folder.iterdir()):
            print(f"relief     {path}")

    def _recover(self):
        from torchmat import colour
        from torchmat.btf.listing import is_image
        from torchmat.btf.photographs import read_linear, read_photographs
        from torchmat.geometry import relief_from_photographs, relief_from_picture

        encoding = self.read.encoding or "auto"
        if Path(self.path).is_file() and is_image(self.path):
            picture = colour.display(read_linear(self.path, encoding))
            return relief_from_picture(picture, self.height_scale, self.normal_strength, self.tiles)
        if self.lights is not None or self.ball is not None:
            images, weight = read_photographs(self.path, encoding), None
            light = self._given_lights(len(images))
        else:
            btf = self.read.load(self.path)
            if len(btf.views) > 1:
                from torchmat.fit import recover_geometry

                found = recover_geometry(btf, tiles=self.tiles)
                print("; ".join(f"{key}: {value}" for key, value in found.figures.items()))
                return found.relief
            rows = ((btf.view_index == 0) & (btf.light[:, 2] > 0)).nonzero()[:, 0]  # views run from the pole outward
            images, light, weight = btf.images(rows), btf.light[rows], btf.weights(rows)
        return relief_from_photographs(images, light, weight, self.tiles, self.integration)

    def _given_lights(self, count: int):
        import torch

        from torchmat.btf.photographs import read_lights, read_photographs
        from torchmat.errors import RangeError, message
        from torchmat.geometry import find_highlight, lights_from_ball

        if self.lights is not None:
            return read_lights(self.lights, count)
        balls = read_photographs(self.ball)
        if self.circle is None or len(balls) != count:
            fact = "--circle is missing" if self.circle is None else f"there are {len(balls)} for {count} photographs"
            step = "Give --circle COLUMN ROW RADIUS and one photograph of the ball for each light."
            raise RangeError(message(str(self.ball), "the ball", "be calibrated", fact, step))
        centre, radius = self.circle[:2], self.circle[2]
        highlights = torch.stack([find_highlight(ball, centre, radius) for ball in balls])
        return lights_from_ball(highlights, centre, radius).float()


@dataclass
class Create:
    """Make a material without a BTF: of one evenly lit picture, or of a folder of PBR textures (ambientCG's names)."""

    path: Annotated[str, tyro.conf.Positional]
    """A picture, or a folder of textures: *_Color, *_Displacement, *_NormalGL, *_Roughness ..."""
    out: Path = Path("out")
    """Folder to write; an earlier material there is replaced."""
    height_scale: float | None = None
    """Height of white in texture widths, 0 for a flat surface (default: 0.05; of textures, as their normals say)."""
    storage: str = "png8"
    """How textures are stored: png8, png16, tiff8, tiff16, half or float."""
    no_pictures: bool = False
    """Write the material only."""
    specular: list[str] = field(default_factory=lambda: ["glossy"])
    """Picture only: glossy, soft, rim, anisotropic or noise, as glossy:width=0.1; several: its colours, dark to light."""
    softness: float = 0.0
    """Picture only: how softly its colours pass into each other, in Lab units."""
    mask: tuple[float, float] = (0.0, 1.0)
    """Picture only: brightness and contrast of the specular mask."""
    fresnel: tuple[float, float] = (-0.43, 0.1)
    """Picture only: brightness and contrast of the reflectance at normal incidence."""
    darken: float = 0.2
    """Picture only: share of its light that is not diffuse."""
    centre: Annotated[list[tuple[float, float]], tyro.conf.UseAppendAction] = field(default_factory=list)
    """Picture only: u and v (0 to 1, v up) about which the specular map turns; may be repeated."""
    tilt: str | None = None
    """Picture only: default, velvet, gentle or flat."""
    tiles: bool = False
    """Picture only: it repeats; textures of a set always do."""
    encoding: str = "auto"
    """Picture only: auto, srgb or linear."""
    seed: int = 0
    """Picture only: seed of the search for its colours."""
    lobes: int = 3
    """Textures only: how many specular maps stand for all roughnesses."""
    occlusion: bool = False
    """Textures only: multiply the diffuse part by the occlusion texture."""

    def run(self) -> None:
        from torchmat.material_io import check_target, save_material
        from torchmat.report.maps import hemisphere_picture, maps_picture

        check_target(self.out)  # before the work, not after it
        material = self._from_textures() if Path(self.path).is_dir() else self._from_picture()

        def draw(building: Path) -> None:
            if not self.no_pictures:
                maps_picture(material, building / "maps.png")
                hemisphere_picture(material, building / "hemisphere.png")

        folder = save_material(material, self.out, {"created_from": Path(self.path).resolve().name}, draw)
        for path in sorted(folder.iterdir()):
            print(f"material   {path}")

    def _from_textures(self):
        from torchmat.create import material_from_textures
        from torchmat.create.textures import find_textures

        for name in find_textures(self.path).ignored:
            print(f"ignored    {name}")
        return material_from_textures(
            self.path, lobes=self.lobes, height_scale=self.height_scale, occlusion=self.occlusion, storage=self.storage
        )

    def _from_picture(self):
        from torchmat.btf.decode import ENCODINGS
        from torchmat.btf.photographs import read_linear
        from torchmat.create import material_from_picture
        from torchmat.errors import check_option

        check_option("create", "encoding", self.encoding, ENCODINGS)
        scale = {} if self.height_scale is None else {"height_scale": self.height_scale}
        return material_from_picture(
            read_linear(self.path, self.encoding), lobes=len(self.specular), specular=self.specular,
            mask_brightness=self.mask[0], mask_contrast=self.mask[1], fresnel_brightness=self.fresnel[0],
            fresnel_contrast=self.fresnel[1], darken=self.darken, softness=self.softness,
            rotation_centres=self.centre, tilt=self.tilt, tiles=self.tiles, storage=self.storage, seed=self.seed,
            **scale,
        )


_STYLE = (tyro.conf.FlagCreatePairsOff,)
COMMANDS = {
    "fit": Fit, "render": Render, "compare": Compare, "info": Info, "geometry": Geometry, "create": Create,
}


def main(arguments: list[str] | None = None, command: str | None = None) -> int:
    """Run the command line; `command` fixes the subcommand, as the scripts of the same names do."""
    if command is None:
        chosen = tyro.extras.subcommand_cli_from_dict(
            COMMANDS, args=arguments, prog="torchmat", description=__doc__, config=_STYLE
        )
    else:
        chosen = tyro.cli(COMMANDS[command], args=arguments, prog=command, config=_STYLE)
    try:
        chosen.run()
    except TorchmatError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
