"""Shapes made in the page are those of torchmat.rendering, and its cameras look as those do."""

from __future__ import annotations

import base64
import math

import numpy as np
import torch
from tests.web.node import evaluate

from torchmat.rendering import Camera
from torchmat.rendering.shapes import SHAPES, make_mesh

_READ = """
const { makeMesh, SHAPES } = await load("meshes.js");
const told = {};
for (const name of SHAPES) {
  const mesh = makeMesh(name);
  told[name] = { centre: mesh.centre, radius: mesh.radius };
  for (const part of ["position", "normal", "uv", "tangent", "faces"]) {
    told[name][part] = Buffer.from(mesh[part].buffer).toString("base64");
  }
}
return told;
"""


def test_shapes_have_the_same_triangles():
    found = evaluate(_READ)
    assert tuple(found) == SHAPES
    for name, told in found.items():
        mesh = make_mesh(name)
        parts = {
            part: np.frombuffer(base64.b64decode(told[part]), np.float32).reshape(-1, size)
            for part, size in (("position", 3), ("normal", 3), ("uv", 2), ("tangent", 4))
        }
        faces = np.frombuffer(base64.b64decode(told["faces"]), np.uint32).reshape(-1, 3)
        tangent = torch.cat((mesh.tangent, mesh.handedness[:, None]), dim=1)
        assert len(faces) == len(mesh.faces), name
        mine = np.concatenate([parts[part] for part in ("position", "normal", "uv", "tangent")], axis=1)[faces]
        theirs = np.concatenate((mesh.position.numpy(), mesh.normal.numpy(), mesh.uv.numpy(), tangent.numpy()), axis=1)[mesh.faces.numpy()]
        order = [np.lexsort(np.round(one[:, :, [0, 1, 2, 6, 7]].mean(axis=1), 4).T) for one in (mine, theirs)]
        worst = np.abs(mine[order[0]] - theirs[order[1]]).max()
        assert worst < 2e-6, (name, worst)
        assert np.abs(np.array(told["centre"]) - mesh.centre.numpy()).max() < 1e-6 and abs(told["radius"] - mesh.radius) < 1e-6


def test_cameras_look_as_those_of_pictures_do():
    directions = [[0, 0, 1], [0.7, 0.5, 1.0], [0, 1, 0], [-0.3, -0.8, -0.2]]
    found = evaluate(f"""
const {{ Camera, anglesOf, unit }} = await load("camera.js");
return {directions}.map((direction) => [false, true].map((perspective) => {{
  const camera = new Camera({{ ...anglesOf(unit(direction), {{ theta: 0, phi: 0 }}), perspective }});
  const look = camera.look({{ centre: [0.1, 0.2, 0.3], radius: 2 }}, 300, 300);
  return {{ axes: camera.axes(), eye: look.eye, pixel: look.pixel, projection: [...look.projection] }};
}}));
""")
    for direction, both in zip(directions, found, strict=True):
        for angle, one in zip((None, math.radians(30)), both, strict=True):
            camera = Camera.framing((0.1, 0.2, 0.3), 2.0, direction, angle)
            assert np.abs(np.array(one["axes"]) - camera.axes().numpy()).max() < 1e-12
            rays = camera.rays(torch.tensor([0.4]), torch.tensor([-0.3]), 300)
            matrix = np.array(one["projection"]).reshape(4, 4).T
            point = matrix @ np.append((rays.origin + rays.direction * 9.0)[0].numpy(), 1.0)
            assert np.abs(point[:2] / point[3] - (0.4, -0.3)).max() < 1e-6
            assert abs(one["pixel"][0] - rays.width_at_origin) < 1e-12 and abs(one["pixel"][1] - rays.width_per_distance) < 1e-12


def test_angles_name_directions_both_ways_and_stay_near():
    found = evaluate("""
const { anglesOf, directionOf, orbited } = await load("camera.js");
let worst = 0;
for (let theta = -180; theta <= 180; theta += 15) for (let phi = 0; phi <= 360; phi += 15) {
  const back = anglesOf(directionOf({ theta, phi }), { theta, phi });
  worst = Math.max(worst, ...directionOf(back).map((one, k) => Math.abs(one - directionOf({ theta, phi })[k])));
}
let angles = { theta: 20, phi: 0 };
const seen = [];
for (let k = 0; k < 8; k += 1) { angles = orbited(angles, -10, 0); seen.push([Math.round(angles.theta), Math.round(angles.phi) % 360]); }
return { worst, seen };
""")
    assert found["worst"] < 1e-7
    # A horizontal drag through the pole turns theta's sign and leaves phi.
    assert found["seen"] == [[10, 0], [0, 0], [-10, 0], [-20, 0], [-30, 0], [-40, 0], [-50, 0], [-60, 0]]
