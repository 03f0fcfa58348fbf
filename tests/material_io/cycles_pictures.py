"""Pictures of flat materials by Blender's Cycles, one sun each: run by a Python that has `bpy`, or by Blender itself.

    python cycles_pictures.py JOB.json        blender -b --factory-startup --python cycles_pictures.py -- JOB.json

The job names `scenes`, each a GLB or a script `material.py`, `pairs` of unit vectors to light and view in the frame of
the texture (x right, y up, z out of it), how many pixels a picture is `wide`, and `out`, a NumPy file
[scene, pair, wide, wide, 3] that it writes. The sun gives an irradiance of pi, so that pixels read pi f_r cos(light).
The frame is 1.25 of the unit square, y of the texture up.
"""

import json
import os
import sys

import bpy
import numpy as np
from mathutils import Matrix, Vector

FRAME = 1.25
_AXES_OF_GLTF = Matrix(((1, 0, 0), (0, 0, -1), (0, 1, 0)))  # Blender's z is up, glTF's y


def load(path):
    """Show the unit square with a material; return the turn from the texture's frame to the world's."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    if path.endswith(".glb"):
        bpy.ops.import_scene.gltf(filepath=path)
        return _AXES_OF_GLTF
    mesh = bpy.data.meshes.new("quad")
    mesh.from_pydata([(-0.5, -0.5, 0), (0.5, -0.5, 0), (0.5, 0.5, 0), (-0.5, 0.5, 0)], [], [(0, 1, 2, 3)])
    mesh.uv_layers.new(name="UVMap").data.foreach_set("uv", [0, 0, 1, 0, 1, 1, 0, 1])
    quad = bpy.data.objects.new("quad", mesh)
    bpy.context.collection.objects.link(quad)
    bpy.context.view_layer.objects.active = quad
    with open(path, encoding="utf-8") as file:
        exec(compile(file.read(), path, "exec"), {"__name__": "__main__", "__file__": path})
    return Matrix.Identity(3)


def prepare(wide, out):
    """Set the renderer up for one ray through each pixel's centre and direct light alone; return camera and sun."""
    scene = bpy.context.scene
    scene.render.engine, scene.cycles.device, scene.cycles.samples = "CYCLES", "CPU", 1
    scene.cycles.use_denoising = scene.cycles.use_adaptive_sampling = False
    scene.cycles.max_bounces = 0
    scene.cycles.sample_clamp_direct = scene.cycles.sample_clamp_indirect = 0
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BOX", 0.01
    scene.render.threads_mode, scene.render.threads = "FIXED", 1
    scene.render.resolution_x = scene.render.resolution_y = wide
    scene.render.resolution_percentage, scene.render.dither_intensity = 100, 0
    scene.view_settings.view_transform = "Raw"
    scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "OPEN_EXR", "32"
    scene.render.filepath = out
    world = scene.world = bpy.data.worlds.new("black")
    if bpy.app.version < (5, 0, 0):
        world.use_nodes = True
    world.node_tree.nodes.clear()
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.data.type, camera.data.ortho_scale = "ORTHO", FRAME
    sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    sun.data.energy, sun.data.angle = np.pi, 0
    for one in (camera, sun):
        one.rotation_mode = "QUATERNION"
        bpy.context.collection.objects.link(one)
    scene.camera = camera
    return camera, sun


def aim(shown, away, up):
    """Turn a camera or a sun, which look along their -z, so that `away` points back to it."""
    z = away.normalized()
    x = up.cross(z).normalized()
    shown.matrix_world = Matrix.Translation(10 * z) @ Matrix((x, z.cross(x), z)).transposed().to_4x4()


def picture(path, wide):
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(path)
    values = np.empty(wide * wide * 4, np.float32)
    image.pixels.foreach_get(values)
    bpy.data.images.remove(image)
    return values.reshape(wide, wide, 4)[::-1, :, :3]


def main(path):
    with open(path, encoding="utf-8") as file:
        job = json.load(file)
    found, held = [], os.path.splitext(job["out"])[0] + ".exr"
    for scene in job["scenes"]:
        turn = load(scene)
        camera, sun = prepare(job["wide"], held)
        up = turn @ Vector((0, 1, 0))
        for light, view in job["pairs"]:
            aim(camera, turn @ Vector(view), up)
            aim(sun, turn @ Vector(light), up)
            found.append(picture(held, job["wide"]))
    shape = (len(job["scenes"]), len(job["pairs"]), job["wide"], job["wide"], 3)
    np.save(job["out"], np.array(found).reshape(shape))


main(sys.argv[-1])
