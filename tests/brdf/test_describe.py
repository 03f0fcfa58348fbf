"""What `torchmat info` says of a measured BRDF."""

from __future__ import annotations

import numpy as np
import pytest
from tests.brdf.files import merl_bytes, rgl_fields, write_tensor_file

from torchmat.brdf import AnalyticBrdf, is_brdf_file, tabulate, write_merl
from torchmat.errors import DataError
from torchmat.report.describe import describe_brdf


def rows_of(text: str) -> dict[str, str]:
    """Return the table as {first column: second column}."""
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if "|" in line]
    return {row[0]: row[1] for row in cells if len(row) == 2}


def test_a_table_of_the_merl_kind(tmp_path):
    lambert = AnalyticBrdf("lambert", diffuse=(0.2, 0.4, 0.8))
    table = tabulate(lambert, (20, 20, 20))
    path = write_merl(tmp_path / "flat.binary", table)
    found = rows_of(describe_brdf(path))
    assert found["kind"] == "MERL table, isotropic, reciprocal"
    assert found["resolution"] == "20 half x 20 difference x 20 azimuth angles, RGB"
    assert found["missing samples"].startswith(f"{table.missing_count} of 8000 (")
    low, high = (float(part) for part in found["pi f_r cos(light)"].split(" to "))
    assert 0 <= low < 0.01 and high == pytest.approx(0.8, rel=1e-3)
    for angle in (0, 45, 75):
        albedo = [float(part) for part in found[f"albedo at {angle} degrees (r, g, b)"].split(", ")]
        assert albedo == pytest.approx([0.2, 0.4, 0.8], rel=1e-3)


def test_files_of_the_rgl_kind(tmp_path):
    fields = rgl_fields(azimuths=5)
    fields["rgb"][:, :, 2] *= -1
    found = rows_of(describe_brdf(write_tensor_file(tmp_path / "x.bsdf", fields)))
    assert found["kind"] == "RGL measurement, anisotropic, RGB" and found["description"] == "Made up"
    assert found["resolution"] == "5 azimuth x 4 polar angles, 4 x 4 each"
    assert found["negative colours"].startswith("33.33 %")
    assert found["albedo at 0 degrees (r, g, b)"].endswith(", 0")
    fields = {k: v for k, v in rgl_fields().items() if k != "rgb"}
    fields["wavelengths"] = np.linspace(400, 700, 7, dtype=np.float32)
    fields["spectra"] = np.ones((1, 4, 7, 4, 4), np.float32)
    found = rows_of(describe_brdf(write_tensor_file(tmp_path / "y.bsdf", fields)))
    assert found["kind"] == "RGL measurement, isotropic, 7 wavelengths from 400 to 700 nm"


def test_a_damaged_file_is_reported_as_what_its_name_says(tmp_path):
    path = tmp_path / "short.binary"
    path.write_bytes(merl_bytes(np.ones((3, 2, 2, 2)))[:-1])
    assert is_brdf_file(path)
    with pytest.raises(DataError, match="short.binary.*head promises"):
        describe_brdf(path)
    (tmp_path / "table.dat").write_bytes(merl_bytes(np.ones((3, 2, 2, 2))))
    assert is_brdf_file(tmp_path / "table.dat")
    (tmp_path / "lights.lp").write_text("3\n")
    assert not any(is_brdf_file(path) for path in (tmp_path / "lights.lp", tmp_path, tmp_path / "absent.bsdf"))
