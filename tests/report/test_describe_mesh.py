"""What `torchmat info` and the commands that use a mesh say of it."""

from __future__ import annotations

import numpy as np
import pytest
from tests.models.examples import make
from tests.rendering.mesh_files import CUBE, CUBE_FACES, SQUARE, SQUARE_UV, TWO, glb_of, put_obj, put_stl
from tests.rendering.test_mesh import FAR

import torchmat as tm
from torchmat.cli import main
from torchmat.rendering.as_mesh import as_mesh
from torchmat.rendering.mesh import load_mesh
from torchmat.report.describe_mesh import describe_mesh, mesh_line


def facts(path) -> dict[str, str]:
    """Return the rows of the table by their names."""
    rows = [line.split("|")[1:3] for line in describe_mesh(path).splitlines()]
    return {name.strip(): fact.strip() for name, fact in rows}


def test_a_closed_mesh(tmp_path):
    found = facts(put_obj(tmp_path / "cube.obj", CUBE * (1, 2, 0.5), [*CUBE_FACES, [0, 0, 1]]))
    assert found["triangles"] == "12" and found["dropped"] == "1 triangles without area"
    assert found["texture coordinates"] == "a box projection" and found["watertight"] == "yes"
    assert found["size"] == "1 x 2 x 0.5 (the file names no unit)"
    assert found["normals"] == "computed, smooth but for edges above 40 degrees"
    assert found["vertices"] == "24, split where normal or texture differ; 8 in the file"
    assert found["materials"] == "none named"


def test_a_closed_stl_is_watertight_though_no_corner_is_shared(tmp_path):
    assert facts(put_stl(tmp_path / "cube.stl", CUBE, CUBE_FACES))["watertight"] == "yes"
    found = facts(put_stl(tmp_path / "open.stl", CUBE, CUBE_FACES[:-1]))
    assert found["watertight"] == "no: 3 sides of triangles are open, or meet more than one other"
    turned = np.vstack((CUBE_FACES[:-1], CUBE_FACES[-1:, ::-1]))
    assert facts(put_stl(tmp_path / "turned.stl", CUBE, turned))["watertight"].startswith("no: 6 sides")


def test_what_a_file_names(tmp_path):
    parts = [{"position": SQUARE + k, "faces": TWO, "uv": SQUARE_UV, "material": k} for k in (0, 1)]
    parts[1] |= {"normal": np.tile([0.0, 0, 1], (4, 1))}
    parts[1].pop("uv")
    path = tmp_path / "two.glb"
    path.write_bytes(glb_of(parts, [{"mesh": 0}, {"mesh": 1}], materials=[{"name": "wool"}, {}]))
    found = facts(path)
    assert found["materials"] == "wool, material 1" and found["size"] == "2 x 2 x 2 m"
    assert found["texture coordinates"] == "the file's, and a box projection where it has none"
    assert found["normals"] == "the file's; of 2 triangles computed, smooth but for edges above 40 degrees"
    assert found["watertight"].startswith("no: 8 sides")
    assert found["mirrored"] == "50 % of the triangles"  # a texture whose v runs up is mirrored in a glTF


def test_a_mesh_far_away_is_told_with_all_its_digits(tmp_path):
    found = facts(put_obj(tmp_path / "far.obj", SQUARE + FAR, TWO, SQUARE_UV))
    assert found["lowest corner"] == "4500000, -320000, 7000000"
    assert found["highest corner"] == "4500001, -319999, 7000001"
    assert found["texture coordinates"] == "the file's" and found["dropped"] == "none"


def test_one_line_of_a_mesh_that_is_used(tmp_path):
    mesh = load_mesh(put_obj(tmp_path / "some.obj", SQUARE, [*TWO, [0, 0, 1]]), uv="planar")
    assert mesh_line(mesh) == (
        "some: 2 triangles, 1 without area left out; texture coordinates: a planar projection; "
        "size 1 x 1 x 1 (the file names no unit)"
    )
    assert "texture coordinates: the shape's" in mesh_line(as_mesh("cube"))


def test_the_commands_say_what_they_read(tmp_path, capsys):
    path = put_obj(tmp_path / "some.obj", SQUARE, TWO, SQUARE_UV)
    assert main(["info", str(path)]) == 0
    assert "texture coordinates" in capsys.readouterr().out
    tm.save_material(make("lambert", {}, 4, 6, storage="png8"), tmp_path / "material")
    assert main(["render", str(tmp_path / "material"), "--mesh", str(path), "cube", "--size", "6", "--rays", "1"]) == 0
    told = [line for line in capsys.readouterr().out.splitlines() if line.startswith("mesh")]
    assert told == ["mesh       some: 2 triangles; texture coordinates: the file's; size 1 x 1 x 1 (the file names no unit)"]
    (tmp_path / "scene.toml").write_text('mesh = "some.obj"\nsize = 6\n[[lights]]\ndirection = [0, 0, 1]\n')
    assert main(["render", str(tmp_path / "material"), "--scene", str(tmp_path / "scene.toml")]) == 0
    assert "mesh       some: 2 triangles" in capsys.readouterr().out


def test_info_of_a_broken_mesh_names_it(tmp_path, capsys):
    (tmp_path / "a.glb").write_bytes(b"glTF")
    assert main(["info", str(tmp_path / "a.glb")]) != 0
    assert "a.glb: the mesh file must start as a GLB does" in capsys.readouterr().err


@pytest.mark.parametrize("suffix", ["obj", "ply", "off"])
def test_a_concave_polygon_in_every_format_that_has_polygons(suffix, tmp_path):
    flat = [[2, 1], [1, 1], [1, 2], [0, 2], [0, 0], [2, 0]]
    rows, path = "".join(f"{x} {y} 0\n" for x, y in flat), tmp_path / f"a.{suffix}"
    path.write_text({
        "obj": "v " + rows.replace("\n", "\nv ")[:-2] + "f 1 2 3 4 5 6\n",
        "off": f"OFF # by hand\n6 1 0\n{rows}6 0 1 2 3 4 5 0.5 0.5 0.5\n",
        "ply": "ply\nformat ascii 1.0\nelement vertex 6\nproperty double x\nproperty double y\nproperty double z\n"
               f"element face 1\nproperty list uchar int vertex_indices\nend_header\n{rows}6 0 1 2 3 4 5\n",
    }[suffix])
    mesh = load_mesh(path)
    a, b, c = mesh.position[mesh.faces].double().unbind(dim=1)
    assert float(((b - a).cross(c - a, dim=1)[:, 2] / 2).sum()) == pytest.approx(3)
    assert mesh.normal.tolist() == [[0, 0, 1]] * 6
