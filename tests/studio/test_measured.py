"""The material beside its images: the report's own figures; and maps fitted anew, as refit does it."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch
from tests.studio.serving import served
from tests.support import all_pairs, hemisphere, plausible_images

import torchmat as tm
from torchmat import colour
from torchmat.cli import main
from torchmat.images import write_image
from torchmat.report.samples import nearest_sample, shown
from torchmat.studio import refitting

LIGHT, VIEW = all_pairs(hemisphere(((0, 1), (30, 3), (60, 5))), hemisphere(((0, 1), (45, 4))))


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    """Images, and a material that the command fitted to them, with its report."""
    place = tmp_path_factory.mktemp("fitted")
    data = place / "data"
    data.mkdir()
    lines = ["file,light_x,light_y,light_z,view_x,view_y,view_z"]
    for number, image in enumerate(plausible_images(LIGHT, VIEW, 12, 12)):
        write_image(data / f"{number:03d}.exr", image.transpose(1, 2, 0).astype(np.float32))
        lines.append(f"{number:03d}.exr," + ",".join(f"{value:.9f}" for value in (*LIGHT[number], *VIEW[number])))
    (data / "manifest.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    folder = place / "wool"
    arguments = ["fit", "phong_srf", str(data), "--out", str(folder), "--no-pictures", "--set", "geometry=flat"]
    assert main([*arguments, "--set", "options.storage=half"]) == 0
    return data, folder


def test_the_pair_beside_is_the_nearest_and_its_figures_are_those_of_the_report(fitted):
    data, folder = fitted
    btf, material = tm.load_btf(data, cache=False), tm.load_material(folder)
    light, view = [0.3, 0.1, 0.9], [-0.5, 0.4, 0.7]
    with served(folder, btf=str(data)) as studio, studio.page() as page:
        found = page.wish("compare", light=light, view=view)
        vectors = [torch.nn.functional.normalize(torch.tensor(one, dtype=torch.float64), dim=0) for one in (light, view)]
        far = (btf.light.double() - vectors[0]).square().sum(1) + (btf.view.double() - vectors[1]).square().sum(1)
        sample = nearest_sample(btf, *vectors)
        assert found["sample"] == sample == int(far.argmin())
        wanted = shown(btf, material, sample, "")
        assert (found["relative_error"], found["psnr_db"]) == (wanted.relative_error, wanted.psnr_db)
        for name, picture in (("target", wanted.target), ("fit", wanted.fit)):
            codes = np.frombuffer(studio.get(f"/picture/{name}")[1], np.uint8).reshape(12, 12, 3)
            assert np.array_equal(codes, (colour.display(picture) * 255).round().permute(1, 2, 0).numpy().astype(np.uint8))
        red, blue = np.frombuffer(studio.get("/picture/difference")[1], np.uint8).reshape(12, 12, 3)[:, :, [0, 2]].transpose(2, 0, 1)
        assert ((red > blue) == (wanted.difference.numpy() > 0))[np.abs(wanted.difference.numpy()) > 0.02 * found["most"]].all()
        report = json.loads((folder / "report.json").read_text())["held_out_after_export"]
        measured = page.wish("measure")
        for name in ("relative_error", "psnr_db", "ssim", "delta_e", "samples"):
            assert measured[name] == found["report"][name] == report[name], name
        for wrong in ([0, 0, -1], [1, 2], "x", [0, 0, float("1e999")], None):
            with pytest.raises(ValueError, match="three numbers"):
                page.wish("compare", light=wrong, view=view)
    with served(folder) as studio, studio.page() as page:
        for wish in ({"kind": "measure"}, {"kind": "refit", "maps": ["base"]}):
            with pytest.raises(ValueError, match="Start the studio with --btf PATH"):
                page.wish(**wish)


def test_a_refit_is_that_of_python_with_progress_and_can_be_cancelled(fitted, tmp_path, monkeypatch):
    data, original = fitted
    folder = tmp_path / "wool"
    material = tm.load_material(original)
    name = next(spec.name for spec in material.specs() if spec.per_texel)
    worse = material.with_maps(**{name: material.maps[name].detach() * 0.5})
    tm.save_material(worse, folder)
    (folder / "report.json").write_bytes((original / "report.json").read_bytes())
    lines = []
    monkeypatch.setattr("builtins.print", lambda text, flush: lines.append(json.loads(text)))
    assert refitting.main([str(folder), str(data), str(tmp_path / "out"), "0.05", name]) == 0
    monkeypatch.undo()
    assert lines[-1]["report"]["figures"]["train_after"] > lines[-1]["report"]["figures"]["train_before"]
    report = json.loads((original / "report.json").read_text())
    keep = [spec.name for spec in worse.specs() if spec.name != name]
    wanted = tm.refit(
        tm.load_btf(data, cache=False), tm.load_material(folder), keep, effort=0.05, holdout=report["holdout"],
        holdout_by=report["holdout_by"], seed=report["seed"], progress=False,
    )
    assert torch.equal(tm.load_material(tmp_path / "out").maps[name], wanted.material.as_exported().maps[name])
    with served(folder, btf=str(data)) as studio, studio.page() as page:
        page.wish("refit", maps=[name], effort=0.05)
        with pytest.raises(ValueError, match="have ended; it is running"):
            page.wish("refit", maps=[name])
        page.wish("cancel")
        assert page.wait("job", state="cancelled")
        assert torch.equal(tm.load_material(folder).maps[name], worse.as_exported().maps[name])
        for wrong in ([], "x", [3], ["--help"]):
            with pytest.raises(ValueError, match="the maps must be"):
                page.wish("refit", maps=wrong)
        page.wish("refit", maps=[name], effort=0.05)
        assert page.wait("job", timeout=60, state="running")["what"]
        done = page.wait("job", timeout=60, state="done")
        assert done["figures"]["train_after"] > done["figures"]["train_before"]
        assert torch.equal(tm.load_material(folder).maps[name], wanted.material.as_exported().maps[name])
        assert studio.live.history.states[-1].what == f"refit {name}"
