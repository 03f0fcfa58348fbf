"""Path-trace the sample BTF that ships inside ``torchmat``.

The sample is a small synthetic material: glazed leaves and beads in relief on
a matte woven ground.  It is a displaced, tileable height field, so its images
hold the parallax, masking, shadows and interreflection of a real measured
BTF, and its true height, normals and albedo are known.

Two files are written to the folder given by ``--out``:

``sample.zip``
    ``manifest.csv`` with the columns ``file, view_polar_deg,
    view_azimuth_deg, light_polar_deg, light_azimuth_deg`` and the images
    ``images/00001.exr`` and so on (linear RGB, half float, DWA compression).
``sample_truth.npz``
    ``height`` [H, W] in texture widths with zero mean, ``normal`` [3, H, W],
    ``albedo`` [3, H, W] (linear, diffuse) and ``gloss_mask`` [H, W], each the
    mean over the texel's footprint.

Conventions: x points right, y points up the texture, z is the mean normal and
row 0 is the top row.  Directions point away from the surface; azimuth turns
from +x towards +y, polar is measured from z.  A value is pi * f_r *
cos(light), so ideal white lit along its normal reads 1.  Every texel looks, at
any view, at its own square of the plane z = 0.

With ``--random N`` another file is written in their place:

``sample_random.zip``
    The same, of N pairs whose light and view are both drawn at random between
    the directions of the sample's grid, at least 4 degrees from each and no
    flatter than they are: what a fit makes of directions that no grid holds.
    Some of the sample's own pairs are rendered again first and must agree with
    the ``sample.zip`` beside it, so that both are of one material.

To run it::

    pip install mitsuba tqdm OpenImageIO    # or: pip install 'torchmat[mitsuba]'
    python scripts/make_sample.py
    python scripts/make_sample.py --random 36

Mitsuba's LLVM variant is used where it works (about ten minutes on two cores),
else the scalar one.
"""

from __future__ import annotations

import argparse
import csv
import io
import math
import os
import tempfile
import zipfile
from pathlib import Path

import mitsuba as mi
import numpy as np
import OpenImageIO as oiio
from tqdm import tqdm

# (polar, number of azimuths, first azimuth), in degrees.  The first azimuths
# differ so that no two rings line up, and none lies on the x or y axis.
RINGS = ((0, 1, 0), (25, 6, 11), (50, 8, 29), (72, 10, 7))
COLUMNS = (
    "file",
    "view_polar_deg",
    "view_azimuth_deg",
    "light_polar_deg",
    "light_azimuth_deg",
)
VERTICES_PER_TEXEL = 4
# Tiles on each side of the central one.  At 72 degrees a relief of 0.06 throws
# a shadow of 0.19, so one whole tile is ample.
MARGIN = 1
MAX_DEPTH = 6
GLAZE_ALPHA = 0.17
# The sample ships inside the package, so its images share a fixed budget.
BYTES_PER_TEXEL = 1.45
MAX_DWA_LEVEL = 500
# Random directions keep so many degrees from those of the grid.
OFF_GRID_DEG = 4.0
# Paths of the random pairs are none of the sample's, whatever its seed.
RANDOM_SEED = 1_000_000
# Images of the sample that are rendered again, and by how much they may differ:
# the error of its compression and the noise of its paths, of which this is twice.
CHECKED, MOST_DIFFERENCE = 4, 2e-3

# Linear diffuse albedos.
LINEN = (0.64, 0.53, 0.40)
FLAX = (0.56, 0.44, 0.31)
TEAL = (0.10, 0.28, 0.28)
IVORY = (0.74, 0.65, 0.50)


def smoothstep(low: float, high: float, x: np.ndarray) -> np.ndarray:
    """Cubic step from 0 at ``low`` to 1 at ``high``."""
    t = np.clip((x - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def wrap(x: np.ndarray) -> np.ndarray:
    """Bring coordinates into the period [-0.5, 0.5)."""
    return x - np.floor(x + 0.5)


def leaf(x: np.ndarray, y: np.ndarray, angle: float) -> tuple[np.ndarray, np.ndarray]:
    """One curved leaf along ``angle``: distance inside its edge, offset from its vein."""
    centre, half_length, half_width, bend = 0.345, 0.245, 0.125, 1.0
    u = math.cos(angle) * x + math.sin(angle) * y - centre
    v = -math.sin(angle) * x + math.cos(angle) * y
    # The bend makes the pattern a pinwheel, which no mirror maps to itself:
    # a flipped axis anywhere downstream then shows at once.
    v = v - bend * (u * u - 0.4 * half_length**2)
    width = half_width * (1.0 - (u / half_length) ** 2)
    return width - np.abs(v), v


def leaves(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The nearest of the four leaves: distance inside the edge, offset from the vein."""
    inside = np.full(x.shape, -1.0)
    vein = np.zeros(x.shape)
    for k in range(4):
        # Neighbouring tiles matter because the bent tips cross the border.
        for dx in (-1, 0, 1):
            for dy in (-1, 0, 1):
                d, v = leaf(x + dx, y + dy, math.radians(45 + 90 * k))
                vein = np.where(d > inside, v, vein)
                inside = np.maximum(d, inside)
    return inside, vein


def beads(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Distance inside the nearest round bead."""
    places = ((0.0, 0.0, 0.085), (0.5, 0.5, 0.105))
    return np.max([r - np.hypot(wrap(x - a), wrap(y - b)) for a, b, r in places], axis=0)


def weave(x: np.ndarray, y: np.ndarray, threads: int = 10) -> tuple[np.ndarray, np.ndarray]:
    """Plain weave: height in 0..1, and 1 where the warp (along y) is on top."""

    def thread(across: np.ndarray, along: np.ndarray, phase: float) -> np.ndarray:
        a, b = across * threads, along * threads
        profile = np.abs(np.sin(np.pi * a)) ** 0.7
        return profile * (0.55 + 0.45 * np.sin(np.pi * (b + np.floor(a) + phase)))

    # Each thread crests half way across the threads that it passes over.
    warp, weft = thread(x, y, 0.0), thread(y, x, 1.0)
    return np.maximum(warp, weft), smoothstep(-0.4, 0.4, warp - weft)


def tileable_noise(n: int, wavelength: float, seed: int) -> np.ndarray:
    """Gaussian noise of unit variance on an ``n`` x ``n`` period, blurred to a wavelength."""
    white = np.random.default_rng(seed).standard_normal((n, n))
    f = np.fft.fftfreq(n, 1.0 / n)
    low_pass = np.exp(-0.5 * (f[:, None] ** 2 + f[None] ** 2) * wavelength**2)
    noise = np.fft.ifft2(np.fft.fft2(white) * low_pass).real
    return noise / noise.std()


def mix(a: np.ndarray, b: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Blend the last-axis colours ``a`` and ``b`` by ``t``."""
    return np.asarray(a) + (np.asarray(b) - np.asarray(a)) * t[..., None]


def design(n: int, seed: int) -> dict[str, np.ndarray]:
    """Height, albedo and gloss at ``n`` x ``n`` vertices of a tile, row 0 at the bottom."""
    line = np.arange(n) / n - 0.5
    x, y = np.meshgrid(line, line)
    ground, warp = weave(x, y)
    inside, vein = leaves(x, y)
    bead = beads(x, y)

    leaf_height = 0.033 * smoothstep(-0.012, 0.042, inside)
    leaf_height += 0.030 * smoothstep(0.0, 0.13, inside)
    leaf_height -= 0.016 * np.exp(-((vein / 0.013) ** 2)) * smoothstep(0.01, 0.05, inside)
    bead_height = 0.024 * smoothstep(-0.012, 0.034, bead) + 0.026 * smoothstep(0.0, 0.1, bead)
    raised = np.maximum(smoothstep(-0.012, 0.004, inside), smoothstep(-0.012, 0.004, bead))
    height = 0.009 * ground * (1.0 - raised) + np.maximum(leaf_height, bead_height)
    height = height + 0.0006 * tileable_noise(n, 0.015, seed) * (1.0 - 0.85 * raised)

    # The colours change over two texels or so: sharper edges would look no
    # better at this size and would double the cost of compressing them.
    on_leaf, on_bead = smoothstep(-0.022, 0.018, inside), smoothstep(-0.022, 0.018, bead)
    # A glaze runs thin, and so pale, over crests, and pools dark in grooves.
    glaze = mix(np.array(TEAL) * 0.75, np.array(TEAL) * 1.6, smoothstep(0.0, 0.05, leaf_height))
    albedo = mix(mix(LINEN, FLAX, warp), glaze, on_leaf)
    albedo = mix(albedo, np.broadcast_to(IVORY, albedo.shape), on_bead)
    albedo *= (1.0 + 0.05 * tileable_noise(n, 0.05, seed + 1))[..., None]
    return {
        "height": height - height.mean(),
        "albedo": np.clip(albedo, 0.01, 0.9),
        "gloss": np.maximum(on_leaf, on_bead),
    }


def texel_mean(samples: np.ndarray, axes: tuple[int, ...] = (0, 1)) -> np.ndarray:
    """Mean over each texel along ``axes`` of what is linear between the vertices."""
    for axis in axes:
        middles = 0.5 * (samples + np.roll(samples, -1, axis))
        shape = list(middles.shape)
        shape[axis : axis + 1] = [shape[axis] // VERTICES_PER_TEXEL, VERTICES_PER_TEXEL]
        samples = middles.reshape(shape).mean(axis + 1)
    return samples


def truth(tile: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The maps that a perfect fit would find, row 0 at the top."""
    height = tile["height"]
    n = height.shape[0]
    slope_x = texel_mean((np.roll(height, -1, 1) - height) * n, (0,))
    slope_y = texel_mean((np.roll(height, -1, 0) - height) * n, (1,))
    # A difference belongs to the gap between two vertices, so along its own
    # axis the gaps of a texel are averaged as they are.
    k = VERTICES_PER_TEXEL
    slope_x = slope_x.reshape(slope_x.shape[0], -1, k).mean(2)
    slope_y = slope_y.reshape(-1, k, slope_y.shape[1]).mean(1)
    normal = np.stack([-slope_x, -slope_y, np.ones_like(slope_x)])
    normal /= np.linalg.norm(normal, axis=0)
    maps = {
        "height": texel_mean(height)[::-1],
        "normal": normal[:, ::-1],
        "albedo": np.moveaxis(texel_mean(tile["albedo"]), 2, 0)[:, ::-1],
        "gloss_mask": texel_mean(tile["gloss"])[::-1],
    }
    return {name: np.ascontiguousarray(m, dtype=np.float32) for name, m in maps.items()}


def choose_variant(scalar: bool = False) -> str:
    """Set ``llvm_ad_rgb`` if LLVM can be loaded and nothing else is asked for, else ``scalar_rgb``."""
    if scalar:
        mi.set_variant("scalar_rgb")
        return "scalar_rgb"
    try:
        mi.set_variant("llvm_ad_rgb")
        if float((mi.Float([1.0, 2.0]) + 1.0)[1]) == 3.0:
            return "llvm_ad_rgb"
    except Exception:  # noqa: BLE001 - Dr.Jit raises several kinds when LLVM is missing
        pass
    mi.set_variant("scalar_rgb")
    return "scalar_rgb"


def directions() -> list[tuple[float, float]]:
    """(polar, azimuth) in degrees, the same list for views and for lights."""
    return [
        (float(polar), (first + 360.0 * k / count) % 360.0)
        for polar, count, first in RINGS
        for k in range(count)
    ]


def unit(direction: tuple[float, float]) -> np.ndarray:
    """Unit vector of a (polar, azimuth) direction in degrees."""
    polar, azimuth = np.radians(direction)
    return np.array(
        [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)]
    )


def random_directions(count: int, random: np.random.Generator) -> list[tuple[float, float]]:
    """Directions even over the solid angle that the grid spans, none of them near one of its own."""
    grid = np.array([unit(direction) for direction in directions()])
    flattest = math.cos(math.radians(RINGS[-1][0]))
    found: list[tuple[float, float]] = []
    while len(found) < count:
        polar = math.degrees(math.acos(random.uniform(flattest, 1.0)))
        # As the manifest has them, so that what is rendered is what is said.
        direction = (round(polar, 2), round(random.uniform(0.0, 360.0), 2))
        if (grid @ unit(direction)).max() < math.cos(math.radians(OFF_GRID_DEG)):
            found.append(direction)
    return found


def sensor_matrix(view: np.ndarray) -> np.ndarray:
    """Camera to world: rays run along ``-view`` and film axes stay those of the plane.

    The shear is what rectifies the image: whatever the view, the film covers
    the unit square of the plane z = 0.  Mitsuba's camera x points left.
    """
    matrix = np.eye(4)
    matrix[:3, 0] = (-0.5, 0.0, 0.0)
    matrix[:3, 1] = (0.0, 0.5, 0.0)
    matrix[:3, 2] = -view
    matrix[:3, 3] = view
    return matrix


def emitter_matrix(light: np.ndarray) -> np.ndarray:
    """Rotation whose z axis, along which a directional emitter shines, is ``-light``."""
    z = -light
    helper = np.array([0.0, 1.0, 0.0]) if abs(z[1]) < 0.9 else np.array([1.0, 0.0, 0.0])
    x = np.cross(helper, z)
    x /= np.linalg.norm(x)
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    return matrix


def texture(values: np.ndarray) -> dict:
    """A repeating texture whose texel centres fall on the vertices of the mesh."""
    pixels = np.ascontiguousarray(np.atleast_3d(values), dtype=np.float32)
    # "raw" keeps the numbers as they are: they are linear already.
    return {"type": "bitmap", "bitmap": mi.Bitmap(pixels), "raw": True, "wrap_mode": "repeat"}


def bsdf(tile: dict[str, np.ndarray]) -> dict:
    """Matte ground blended with a glossy glaze over the same diffuse colour."""
    return {
        "type": "blendbsdf",
        "weight": texture(tile["gloss"]),
        "matte": {"type": "diffuse", "reflectance": texture(tile["albedo"])},
        "glazed": {
            "type": "roughplastic",
            "distribution": "ggx",
            "alpha": GLAZE_ALPHA,
            "diffuse_reflectance": texture(tile["albedo"]),
        },
    }


def make_mesh(tile: dict[str, np.ndarray], margin: int = MARGIN) -> mi.Mesh:
    """The tile repeated ``2 * margin + 1`` times each way, centred on the origin."""
    n = tile["height"].shape[0]
    index = np.arange(-margin * n, (margin + 1) * n + 1)
    side = len(index)
    rows, cols = np.meshgrid(index, index, indexing="ij")
    height = tile["height"][rows % n, cols % n]
    position = np.stack([cols / n - 0.5, rows / n - 0.5, height], axis=-1)
    texcoord = np.stack([(cols + 0.5) / n, (rows + 0.5) / n], axis=-1)

    corner = np.arange(side * side).reshape(side, side)
    a, b, c, d = corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]
    faces = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)

    properties = mi.Properties()
    properties["material"] = mi.load_dict(bsdf(tile))
    # The facets are far smaller than a texel.  Their own normals keep shading
    # and geometry consistent, where interpolated ones would leak and darken.
    properties["face_normals"] = True
    mesh = mi.Mesh("relief", side * side, len(faces), props=properties, has_vertex_texcoords=True)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = position.ravel().astype(np.float32)
    parameters["vertex_texcoords"] = texcoord.ravel().astype(np.float32)
    parameters["faces"] = faces.ravel().astype(np.uint32)
    parameters.update()
    return mesh


class Renderer:
    """One scene, of which only the sensor and the emitter move."""

    def __init__(self, tile: dict[str, np.ndarray], size: int, spp: int, margin: int = MARGIN):
        self.spp = spp
        self.scene = mi.load_dict(
            {
                "type": "scene",
                "integrator": {"type": "path", "max_depth": MAX_DEPTH, "rr_depth": MAX_DEPTH + 1},
                "relief": make_mesh(tile, margin),
                "light": {
                    "type": "directional",
                    "to_world": mi.ScalarTransform4f(emitter_matrix(unit((0, 0)))),
                    # Times the albedo over pi, this reads 1 for white.
                    "irradiance": {"type": "rgb", "value": math.pi},
                },
                "sensor": {
                    "type": "orthographic",
                    "near_clip": 1e-3,
                    "far_clip": 10.0,
                    "to_world": mi.ScalarTransform4f(sensor_matrix(unit((0, 0)))),
                    "sampler": {"type": "multijitter", "sample_count": spp},
                    "film": {
                        "type": "hdrfilm",
                        "width": size,
                        "height": size,
                        "rfilter": {"type": "box"},
                        "component_format": "float32",
                    },
                },
            }
        )
        self.parameters = mi.traverse(self.scene)

    def __call__(self, view: np.ndarray, light: np.ndarray, seed: int) -> np.ndarray:
        """The rectified image [H, W, 3], row 0 at the top."""
        self.parameters["sensor.to_world"] = mi.Transform4f(sensor_matrix(view))
        self.parameters["light.to_world"] = mi.Transform4f(emitter_matrix(light))
        self.parameters.update()
        return np.array(mi.render(self.scene, spp=self.spp, seed=seed))[..., :3]


def flat_tile(n: int, height: float) -> dict[str, np.ndarray]:
    """A matte white plane at ``height`` with a dark spot off its centre."""
    line = np.arange(n) / n - 0.5
    x, y = np.meshgrid(line, line)
    spot = np.exp(-((x - 0.1) ** 2 + (y + 0.15) ** 2) / (2 * 0.05**2))
    albedo = np.repeat((1.0 - 0.8 * spot)[..., None], 3, axis=2)
    return {"height": np.full((n, n), height), "albedo": albedo, "gloss": np.zeros((n, n))}


def check_conventions(size: int = 64) -> None:
    """Raise if a plane does not come out as bright, or where, the docstring says.

    Mitsuba does not promise that an orthographic camera may be sheared, so
    each run looks first at a case with a known answer.
    """
    height = 0.04
    render = Renderer(flat_tile(size * VERTICES_PER_TEXEL, height), size, spp=64)
    x, y = np.meshgrid((np.arange(size) + 0.5) / size - 0.5, 0.5 - (np.arange(size) + 0.5) / size)
    for view, light in (((0, 0), (0, 0)), ((50, 29), (72, 115)), ((72, 223), (25, 311))):
        image = render(unit(view), unit(light), seed=1)[..., 1]
        cosine = unit(light)[2]
        if abs(image.max() - cosine) > 2e-3:
            raise RuntimeError(f"white reads {image.max():.4f}, not {cosine:.4f}")
        # A point at height h appears on the plane z = 0 at its foot less
        # h * tan(polar) towards the viewer.
        dark = np.clip(cosine - image, 0.0, None)
        found = np.array([(dark * x).sum(), (dark * y).sum()]) / dark.sum()
        v = unit(view)
        expected = np.array([0.1, -0.15]) - height * v[:2] / v[2]
        if np.abs(found - expected).max() > 0.1 / size:
            raise RuntimeError(f"the spot is seen at {found}, not {expected}")


def encode(image: np.ndarray, level: int, folder: str) -> bytes:
    """The bytes of an RGB half-float EXR with few attributes."""
    path = os.path.join(folder, "image.exr")
    spec = oiio.ImageSpec(image.shape[1], image.shape[0], 3, oiio.HALF)
    spec.channelnames = ("R", "G", "B")  # DWA goes by these names
    # Of the two DWA kinds, dwab codes up to 256 rows together and so pays for
    # its tables once an image.
    spec.attribute("compression", f"dwab:{level}")
    # Else the time of writing goes in, and no two runs give the same bytes.
    spec.attribute("DateTime", "1980:01:01 00:00:00")
    output = oiio.ImageOutput.create(path)
    if output is None or not output.open(path, spec):
        raise RuntimeError(f"OpenImageIO cannot write EXR: {oiio.geterror()}")
    written = output.write_image(np.ascontiguousarray(image, dtype=np.float32))
    if not output.close() or not written:
        raise RuntimeError(f"OpenImageIO could not write an image: {output.geterror()}")
    return Path(path).read_bytes()


def decode(data: bytes, folder: str) -> np.ndarray:
    """The pixels of an EXR held in memory, float32 [H, W, 3]."""
    path = os.path.join(folder, "image.exr")
    Path(path).write_bytes(data)
    source = oiio.ImageInput.open(path)
    pixels = source.read_image(oiio.FLOAT)
    source.close()
    return pixels


def relative_error(truth_images: list[np.ndarray], coded: list[bytes], folder: str) -> float:
    """sum((p - t)^2) / sum(t^2) of the compressed images over the whole sample."""
    error = sum(
        float(((decode(data, folder).astype(np.float64) - image) ** 2).sum())
        for image, data in zip(truth_images, coded)
    )
    return error / sum(float((image.astype(np.float64) ** 2).sum()) for image in truth_images)


def compress(images: list[np.ndarray], limit: int, folder: str) -> tuple[list[bytes], int]:
    """The images as EXR at the lowest DWA level that keeps them under ``limit`` bytes."""
    best, low, high = None, 0, MAX_DWA_LEVEL
    while low < high:
        level = (low + high) // 2
        coded = [encode(image, level, folder) for image in images]
        if sum(map(len, coded)) <= limit:
            best, high = (coded, level), level
        else:
            low = level + 1
    if best is None:
        raise RuntimeError(f"no DWA level brings the images under {limit} bytes")
    return best


def replace_file(path: Path, data: bytes) -> None:
    """Write ``data`` so that ``path`` is always either the old file or the new one."""
    temporary = path.with_name(path.name + ".part")
    temporary.write_bytes(data)
    os.replace(temporary, path)


def zip_bytes(entries: list[tuple[str, bytes]]) -> bytes:
    """An uncompressed zip that depends on nothing but its entries."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as archive:
        for name, data in entries:
            info = zipfile.ZipInfo(name, date_time=(1980, 1, 1, 0, 0, 0))
            info.create_system = 3  # the same bytes on every platform
            info.external_attr = 0o644 << 16
            archive.writestr(info, data)
    return buffer.getvalue()


def manifest(pairs: list[tuple[tuple[float, float], tuple[float, float]]]) -> bytes:
    """The text of ``manifest.csv`` for (view, light) pairs, one image each."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for number, (view, light) in enumerate(pairs, start=1):
        angles = (f"{angle:g}" for angle in (*view, *light))
        writer.writerow([f"images/{number:05d}.exr", *angles])
    return text.getvalue().encode()


def truth_bytes(tile: dict[str, np.ndarray]) -> bytes:
    """The true maps as a compressed ``.npz``."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **truth(tile))
    return buffer.getvalue()


def archive_bytes(
    pairs: list[tuple[tuple[float, float], tuple[float, float]]], images: list[np.ndarray], size: int
) -> bytes:
    """The zip of a manifest and its images, compressed alike whatever their number; says how much that costs."""
    with tempfile.TemporaryDirectory() as folder:
        coded, level = compress(images, int(BYTES_PER_TEXEL * size**2 * len(pairs)), folder)
        error = relative_error(images, coded, folder)
    print(f"{len(pairs)} images, dwab:{level}, relative squared error {error:.2e}")
    entries = [(f"images/{i:05d}.exr", data) for i, data in enumerate(coded, start=1)]
    return zip_bytes([("manifest.csv", manifest(pairs)), *entries])


def make_sample(render: Renderer, tile: dict[str, np.ndarray], args: argparse.Namespace) -> None:
    """Render the grid and write ``sample.zip`` and ``sample_truth.npz``."""
    pairs = [(view, light) for view in directions() for light in directions()]
    images = [
        render(unit(view), unit(light), seed=args.seed * len(pairs) + index)
        for index, (view, light) in enumerate(tqdm(pairs, desc="rendering", unit="image"))
    ]
    archive, maps = archive_bytes(pairs, images, args.size), truth_bytes(tile)
    replace_file(args.out / "sample.zip", archive)
    replace_file(args.out / "sample_truth.npz", maps)
    print(f"sample.zip {len(archive) / 1e6:.2f} MB, sample_truth.npz {len(maps) / 1e6:.2f} MB")


def check_same_material(render: Renderer, path: Path, seed: int) -> None:
    """Raise unless some pairs of the sample at ``path``, rendered again by other paths, look as they do there."""
    with zipfile.ZipFile(path) as archive, tempfile.TemporaryDirectory() as folder:
        rows = list(csv.DictReader(io.StringIO(archive.read("manifest.csv").decode())))
        chosen = np.random.default_rng(seed).choice(len(rows), CHECKED, replace=False)
        for number in chosen:
            row = rows[number]
            view, light = (
                (float(row[f"{what}_polar_deg"]), float(row[f"{what}_azimuth_deg"])) for what in ("view", "light")
            )
            image = render(unit(view), unit(light), seed=2 * RANDOM_SEED + int(number))
            error = relative_error([image], [archive.read(row["file"])], folder)
            print(f"{row['file']} again: relative squared difference {error:.2e}")
            if error > MOST_DIFFERENCE:
                raise RuntimeError(f"{path} is not of this material: {row['file']} differs by {error:.2e}")


def make_random(render: Renderer, args: argparse.Namespace) -> None:
    """Render random pairs of the sample's material and write ``sample_random.zip``."""
    check_same_material(render, args.out / "sample.zip", args.seed)
    random = np.random.default_rng(args.seed)
    views, lights = random_directions(args.random, random), random_directions(args.random, random)
    pairs = list(zip(views, lights))
    images = [
        render(unit(view), unit(light), seed=RANDOM_SEED + index)
        for index, (view, light) in enumerate(tqdm(pairs, desc="rendering", unit="image"))
    ]
    archive = archive_bytes(pairs, images, args.size)
    replace_file(args.out / "sample_random.zip", archive)
    print(f"sample_random.zip {len(archive) / 1e6:.2f} MB")


def main() -> None:
    """Render the sample and write its two files, or a set of random directions beside it."""
    parser = argparse.ArgumentParser(description="Path-trace torchmat's sample BTF.")
    data_folder = Path(__file__).resolve().parents[1] / "torchmat" / "data"
    parser.add_argument("--out", type=Path, default=data_folder, help="folder to write to")
    parser.add_argument("--size", type=int, default=64, help="texels on a side")
    parser.add_argument("--spp", type=int, default=576, help="paths per texel and image")
    parser.add_argument("--seed", type=int, default=0, help="seed of the grain and the paths")
    parser.add_argument("--random", type=int, default=0, metavar="N", help="N pairs of random directions instead")
    parser.add_argument("--scalar", action="store_true", help="without LLVM, where an old one ends the process")
    args = parser.parse_args()

    print(f"Mitsuba variant: {choose_variant(args.scalar)}")
    check_conventions()
    tile = design(args.size * VERTICES_PER_TEXEL, args.seed)
    render = Renderer(tile, args.size, args.spp)
    args.out.mkdir(parents=True, exist_ok=True)
    if args.random:
        make_random(render, args)
    else:
        make_sample(render, tile, args)


if __name__ == "__main__":
    main()
