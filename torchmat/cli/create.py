"""torchmat create."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import tyro

from torchmat.cli.known import ENCODINGS, FROM_1, POSITIVE, STORAGES
from torchmat.progress import phase


@dataclass
class Create:
    """Make a material without a BTF: of one evenly lit picture, of a folder of PBR textures, of a
    measured BRDF, or of photographs of a sphere."""

    reads: ClassVar = ("path",)
    words: ClassVar = {"storage": STORAGES, "encoding": ENCODINGS}
    bounds: ClassVar = {"exposure": POSITIVE, "picture_size": FROM_1, "lobes": FROM_1}

    path: Annotated[str, tyro.conf.Positional]
    """A picture; a folder of textures, named as ambientCG, Poly Haven, FreePBR, Quixel, Substance, Poliigon and others name
    them; a .binary or .bsdf file; or, with --circle, a folder of photographs of a sphere."""
    out: Path = Path("out")
    """Folder to write; an earlier material there is replaced, unless something in it was painted or edited."""
    force: bool = False
    """Replace it even so, and keep it as NAME.backup-1."""
    height_scale: float | None = None
    """Height of white in texture widths, 0 for a flat surface (default: 0.05; of textures, as their normals say)."""
    storage: str | None = None
    """How textures are stored: paint8 or paint16 (codes span what a map can be, rotation is a hue), png8, png16, tiff8,
    tiff16, half or float (default: paint8; half of a BRDF or sphere, whose highlights outshine the rest by far)."""
    model: Literal["distribution", "microfacet"] = "distribution"
    """Picture and textures only: the model of the material; microfacet has the maps of renderers."""
    roughness: float = 0.5
    """Picture as microfacet only: the roughness, 0 to 1."""
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
    """Picture only: default, velvet, gentle or flat; or points DEGREES:TILT,... as 0:0,30:0.1,90:1."""
    tiles: bool | None = None
    """Picture or textures only: whether the surface repeats at its borders (default: as they say)."""
    encoding: str = "auto"
    """Picture only: auto, srgb, linear or xyz."""
    seed: int = 0
    """Picture only: seed of the search for its colours."""
    lobes: int = 3
    """Textures only: how many specular maps stand for all roughnesses."""
    occlusion: bool = False
    """Textures only: multiply the diffuse part by the occlusion texture."""
    angles_deg: tuple[float, ...] = (0.0, 45.0, 90.0, 135.0)
    """BRDF and sphere only: angles between light and view of the sphere pictures."""
    picture_size: int = 256
    """BRDF and sphere only: texels across a sphere picture."""
    paper: bool = False
    """BRDF only: render the pictures at those angles and keep the paper's k, instead of fitting all of them."""
    circle: tuple[float, float, float] | None = None
    """Sphere only: its centre (column, row) and radius in pixels."""
    azimuths_deg: tuple[float, ...] | None = None
    """Sphere only: the side each light came from, 0 the right, 90 above (default: all from the right)."""
    exposure: float = 1.0
    """Sphere only: what a white diffuse patch facing the camera read under the light at 0."""

    def run(self) -> None:
        from torchmat.material_io import check_target, save_material
        from torchmat.report.maps import hemisphere_picture, maps_picture

        check_target(self.out, self.force)  # before the work, not after it
        material = self._make()

        def draw(building: Path) -> None:
            if self.no_pictures:
                return
            with phase("drawing the maps"):
                maps_picture(material, building / "maps.png")
                hemisphere_picture(material, building / "hemisphere.png")

        folder = save_material(material, self.out, {"created_from": Path(self.path).resolve().name}, draw, self.force)
        for path in sorted(folder.iterdir()):
            print(f"material   {path}")

    def _make(self):
        from torchmat.brdf import is_brdf_file

        if is_brdf_file(self.path):
            return self._from_brdf()
        if not Path(self.path).is_dir():
            return self._from_picture()
        return self._from_textures() if self.circle is None else self._from_sphere()

    def _from_brdf(self):
        from torchmat import load_brdf
        from torchmat.fitting.models.spheres.to_brdf import fit_sphere_images
        from torchmat.models import SphereImages

        with phase(f"reading {Path(self.path).name}"):
            brdf = load_brdf(self.path)
        if self.paper:
            with phase("rendering the pictures"):
                return SphereImages.from_brdf(brdf, self.angles_deg, self.picture_size, storage=self.storage or "half")
        with phase("fitting sphere pictures"):
            fitted = fit_sphere_images(brdf, self.angles_deg, self.picture_size, storage=self.storage or "half")
        print("; ".join(f"{key}: {value}" for key, value in fitted.figures.items()))
        return fitted.material

    def _from_sphere(self):
        from torchmat.btf.photographs import read_photographs
        from torchmat.create.from_sphere import sphere_images_from_photographs

        assert self.circle is not None
        with phase(f"reading {Path(self.path).name}"):
            photographs = read_photographs(self.path, self.encoding)
        return sphere_images_from_photographs(
            photographs, self.angles_deg, self.circle[:2], self.circle[2], size=self.picture_size,
            azimuths_deg=self.azimuths_deg, exposure=self.exposure, storage=self.storage or "half",
        )

    def _from_textures(self):
        from torchmat.create import material_from_textures, microfacet_from_textures
        from torchmat.create.textures import find_textures

        found = find_textures(self.path)
        print("\n".join([f"{kind:16s} {file}" for kind, file in found.rows()] + found.notes()))
        with phase("making the maps"):
            tiles = "auto" if self.tiles is None else self.tiles
            if self.model == "microfacet":
                return microfacet_from_textures(
                    self.path, height_scale=self.height_scale, occlusion=self.occlusion, storage=self.storage or "paint8",
                    say=print, tiles=tiles,
                )
            return material_from_textures(
                self.path, lobes=self.lobes, height_scale=self.height_scale, occlusion=self.occlusion,
                storage=self.storage or "paint8", say=print, tiles=tiles,
            )

    def _from_picture(self):
        from torchmat.btf.decode import ENCODINGS
        from torchmat.btf.photographs import read_linear
        from torchmat.create import material_from_picture, microfacet_from_picture
        from torchmat.errors import check_option
        from torchmat.geometry.tiling import tiling_of

        check_option("create", "encoding", self.encoding, ENCODINGS)
        scale = {} if self.height_scale is None else {"height_scale": self.height_scale}
        with phase(f"reading {Path(self.path).name}"):
            picture = read_linear(self.path, self.encoding)
        tiles = self.tiles
        if tiles is None:
            found = tiling_of(picture[None])
            print(f"tiles      {found.sentence()}")
            tiles = found.repeats
        with phase("making the maps"):
            if self.model == "microfacet":
                return microfacet_from_picture(
                    picture, roughness=self.roughness, darken=self.darken, tiles=tiles, storage=self.storage or "paint8", **scale,
                )
            return material_from_picture(
                picture, lobes=len(self.specular), specular=self.specular,
                mask_brightness=self.mask[0], mask_contrast=self.mask[1], fresnel_brightness=self.fresnel[0],
                fresnel_contrast=self.fresnel[1], darken=self.darken, softness=self.softness,
                rotation_centres=self.centre, tilt=self.tilt, tiles=tiles, storage=self.storage or "paint8",
                seed=self.seed, **scale,
            )
