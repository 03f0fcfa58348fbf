"""torchmat render."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar

import tyro

from torchmat.cli.arguments import DataArguments
from torchmat.cli.known import FROM_1, POSITIVE, RAYS
from torchmat.progress import phase
from torchmat.shipped import find_file

_Direction = tuple[float, float, float]
_DEFAULT_MESHES = ("patch", "sphere")
_SPHERE_REPEAT = 2.0
_FRONT = (0.0, 0.0, 1.0)
_SEEN_FROM_THE_FRONT = ("patch", "quad", "sphere")
_THREE_QUARTER = (0.7, 0.5, 1.0)  # a front view shows one side of an object, and lids and rims as lines


@dataclass
class Render:
    """Show a material, a measured BRDF or a BTF as it was measured on objects: pictures, turntables, light sweeps."""

    reads: ClassVar = ("material", "environment")
    words: ClassVar = {"rays": RAYS}
    bounds: ClassVar = {"size": FROM_1, "exposure": POSITIVE, "environment_lights": FROM_1}

    material: Annotated[str, tyro.conf.Positional]
    """Material folder, shading map (.3pm), GLB (.glb), RTI file (.ptm, .rti, info.json), BRDF file (.binary, .bsdf), or a BTF."""
    out: Path | None = None
    """Folder for the pictures (default: pictures/ inside the material folder, else in the current one)."""
    scene: Path | None = None
    """Scene file, or the name of one that ships (teapot.toml): object, lights, camera and size, in place of the options below."""
    mesh: list[str] = field(default_factory=list)
    """patch, quad, cube, sphere, torus, teapot, or mesh files; several (default: patch sphere)."""
    light: Annotated[list[_Direction], tyro.conf.UseAppendAction] = field(default_factory=list)
    """Direction to a distant light, x y z; may be repeated, lights add up."""
    point: Annotated[list[_Direction], tyro.conf.UseAppendAction] = field(default_factory=list)
    """Position of a point light, x y z, in the mesh's units; gives 1 at distance 1. May be repeated. Not for the patch."""
    environment: Path | None = None
    """Latitude-longitude picture that lights the object, alone or beside other lights."""
    environment_lights: int = 64
    """How many distant lights stand for the environment."""
    view: _Direction | None = None
    """Direction to the camera, which frames the object; of the patch in its tangent frame (default: patch, quad and sphere
    from the front, other objects from the side and above)."""
    field_of_view_deg: float | None = None
    """Angle that the picture's width spans (default: the camera is far away)."""
    size: int = 512
    """Width of the pictures."""
    repeat: float | None = None
    """Factor on the texture coordinates (default: 2 on the sphere, else 1)."""
    shadows: bool = False
    """Parts of the object hide others from the lights."""
    rays: int = 4
    """1, 4, 9 or 16 through each pixel."""
    turntable: int = 0
    """Number of pictures of the object turning before the camera: a contact sheet and an animated PNG."""
    sweep: int = 0
    """Number of pictures under one light that goes round the view: a contact sheet and an animated PNG."""
    nine: tuple[float, float] | None = None
    """Polar angles of light and view, degrees: instead of objects, nine views of the patch round the hemisphere, as the studio
    has them, and where their half vectors lie in the specular maps."""
    gif: bool = False
    """Animate as GIF, which has 255 colours a picture."""
    exposure: float = 1.0
    """Factor on the 8-bit pictures' brightness."""
    exr: bool = False
    """Write linear EXR beside the 8-bit PNG."""
    read: DataArguments = field(default_factory=DataArguments)

    def check_names(self) -> None:
        from torchmat.cli.early import check_there
        from torchmat.cli.known import MESHES
        from torchmat.errors import check_option

        if self.scene is None:
            self._check(self._meshes())
        for mesh in self.mesh:
            if Path(mesh).suffix or len(Path(mesh).parts) > 1:
                check_there(mesh)
            elif not Path(mesh).exists():
                check_option("render", "--mesh", mesh, MESHES)
        if self.scene is not None:
            check_there(find_file(self.scene, "scenes"))

    def run(self) -> None:
        from torchmat.material_io.folder import MANIFEST
        from torchmat.rendering.scene_file import load_scene

        scene = None if self.scene is None else load_scene(self.scene)
        shader = self._load()
        inside = (Path(self.material) / MANIFEST).is_file()
        folder = self.out or (Path(self.material) / "pictures" if inside else Path("pictures"))
        if scene is not None or self.nine is not None:
            with phase(f"rendering {self.scene or 'nine views'}"):
                written = self._nine(shader, folder) if scene is None else self._of_scene(shader, scene, folder)
            for path in written:
                print(f"picture    {path}")
            return
        meshes = self._meshes()
        lights = self._lights()
        for mesh in meshes:
            stem = folder / f"render_{Path(mesh).stem}"
            with phase(f"rendering {Path(mesh).name}"):
                written = self._pictures(shader, mesh, lights, stem)
            for path in written:
                print(f"picture    {path}")

    def _meshes(self):
        return self.mesh or (_DEFAULT_MESHES[1:] if self.point or self.turntable or self.sweep else _DEFAULT_MESHES)

    def _of_scene(self, shader, scene, folder: Path) -> list[Path]:
        from torchmat.errors import RangeError, message
        from torchmat.rendering import render
        from torchmat.rendering.files import write_picture
        from torchmat.report.describe_mesh import mesh_line

        if self.mesh or self.light or self.point or self.environment or self.turntable or self.sweep:
            fact, step = "others are given beside it", "Write them into the scene file, or leave --scene out."
            raise RangeError(message("render", "--scene", "bring object and lights", fact, step))
        assert self.scene is not None
        if scene.mesh.mapping != "shape":
            print(f"mesh       {mesh_line(scene.mesh)}")
        target = folder / f"render_{self.scene.stem}.png"
        coverage = scene.visible(shader.dtype).coverage
        return write_picture(render(shader, scene), target, self.exposure, self.exr, coverage)

    def _nine(self, shader, folder: Path) -> list[Path]:
        from torchmat.errors import RangeError, message
        from torchmat.models import Material
        from torchmat.rendering.files import write_picture
        from torchmat.rendering.nine_views import AZIMUTHS_DEG, marks, nine_pairs, nine_views

        if not isinstance(shader, Material):
            fact = f"it is a {type(shader).__name__}"
            raise RangeError(message("render", "--nine", "show a material", fact, "Fit one, or render it on an object."))
        assert self.nine is not None
        for (light, view), place in zip(AZIMUTHS_DEG, marks(*nine_pairs(*self.nine)).tolist(), strict=True):
            print(f"half       light from {light}, view from {view} degrees: u {place[0]:.3f}, v {place[1]:.3f}")
        return write_picture(nine_views(shader, *self.nine), folder / "render_nine.png", self.exposure, self.exr)

    def _view(self, mesh: str) -> _Direction:
        usual = _FRONT if mesh in _SEEN_FROM_THE_FRONT else _THREE_QUARTER
        return usual if self.view is None else self.view

    def _say_below(self) -> None:
        """Say which lights lie below the patch, whose picture they leave black."""
        below = [light for light in self.light if light[2] < 0]
        if below:
            count, first = f"{len(below)} of {len(self.light)} lights", " ".join(f"{number:g}" for number in below[0])
            print(f"warning    {count} below the surface of the patch, first --light {first}")

    def _check(self, meshes) -> None:
        from torchmat.errors import RangeError, message

        stems = [Path(mesh).stem for mesh in meshes]
        twice = next((stem for stem in stems if stems.count(stem) > 1), None)
        if twice is not None:
            step = "Render them one after the other with --out."
            raise RangeError(message("render", "--mesh", "have names of their own", f"two are called {twice}", step))
        if (self.turntable or self.sweep) and "patch" in meshes:
            raise RangeError(message("render", "--mesh", "be an object", "a patch does not turn", "Use --mesh quad."))
        if self.sweep and (self.light or self.point or self.environment):
            step = "Leave --light, --point and --environment out."
            raise RangeError(message("render", "--sweep", "bring its own light", "others are given", step))

    def _load(self):
        from torchmat import load_brdf, load_material
        from torchmat.btf.interpolated import RawBtf
        from torchmat.brdf import is_brdf_file
        from torchmat.material_io.gltf_material import is_glb
        from torchmat.report.describe import is_material

        with phase(f"reading {Path(self.material).name}"):
            if is_material(self.material) or is_glb(self.material):
                return load_material(self.material)
            if is_brdf_file(self.material):
                return load_brdf(self.material)
        return RawBtf(self.read.load(self.material))

    def _lights(self) -> list:
        from torchmat.btf.photographs import read_linear
        from torchmat.rendering import Directional, Point, environment_lights
        from torchmat.rendering.lights import DEFAULT_LIGHT

        lights = [*map(Directional, self.light), *map(Point, self.point)]
        if self.environment is not None:
            with phase(f"reading {self.environment.name}"):
                lights += environment_lights(read_linear(self.environment), self.environment_lights)
        return lights or [Directional(DEFAULT_LIGHT)]

    def _pictures(self, shader, mesh: str, lights: list, stem: Path) -> list[Path]:
        from torchmat.rendering import Camera, render
        from torchmat.rendering.as_mesh import as_mesh
        from torchmat.rendering.files import write_picture
        from torchmat.rendering.render import PATCH
        from torchmat.rendering.scene import Scene
        from torchmat.report.describe_mesh import mesh_line

        usual = _SPHERE_REPEAT if mesh == "sphere" else 1.0
        repeat = usual if self.repeat is None else self.repeat
        view, target = self._view(mesh), stem.with_suffix(".png")
        if mesh == PATCH:
            self._say_below()
            picture = render(shader, PATCH, lights, view, self.size, repeat, shadows=self.shadows, rays=self.rays)
            return write_picture(picture, target, self.exposure, self.exr)
        body, camera = as_mesh(mesh), None
        if body.mapping != "shape":
            print(f"mesh       {mesh_line(body)}")
        if self.turntable or self.sweep:
            return self._animate(shader, body, lights, repeat, stem, view)
        if self.field_of_view_deg is not None:
            camera = Camera.framing(body.centre, body.radius, view, math.radians(self.field_of_view_deg))
        scene = Scene(body, lights, camera, view, self.size, repeat, self.shadows, self.rays)
        return write_picture(scene.picture(shader), target, self.exposure, self.exr, scene.visible(shader.dtype).coverage)

    def _animate(self, shader, body, lights: list, repeat: float, stem: Path, view: _Direction) -> list[Path]:
        from torchmat.rendering.animate import contact_sheet, write_animation
        from torchmat.rendering.files import NEUTRAL, write_picture
        from torchmat.rendering.sequences import light_sweep, turntable

        angle = None if self.field_of_view_deg is None else math.radians(self.field_of_view_deg)
        common: dict[str, Any] = {
            "size": self.size, "repeat": repeat, "field_of_view": angle, "shadows": self.shadows, "rays": self.rays,
            "background": NEUTRAL / self.exposure,
        }
        sequences = {}
        if self.turntable:
            sequences["turntable"] = turntable(shader, body, lights, self.turntable, **common)
        if self.sweep:
            sequences["sweep"] = light_sweep(shader, body, self.sweep, view=view, **common)
        written = []
        for name, pictures in sequences.items():
            frames = list(pictures)
            target = stem.with_name(f"{stem.name}_{name}{'.gif' if self.gif else '.apng'}")
            sheet = stem.with_name(f"{stem.name}_{name}.png")
            written += write_picture(contact_sheet(frames), sheet, self.exposure, self.exr)
            written.append(write_animation(frames, target, exposure=self.exposure))
        return written
