"""Reading one photograph: linear light, colours by the profile, what is clipped, and what the file says."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tests.capturing.dng import write_dng
from tests.btf.files import put_image
from tests.test_icc import profile, put_tagged

from torchmat.capturing import raw as raw_module
from torchmat.capturing.develop import develop, exposure_of, said_of
from torchmat.errors import DataError

EXIF = {"ExposureTime": 0.02, "FNumber": 2.0, "Exif:PhotographicSensitivity": 400, "Orientation": 6}


def codes(red, green, blue, shape=(4, 6)):
    return np.broadcast_to(np.array([red, green, blue], np.uint8), (*shape, 3)).copy()


def test_codes_are_srgb_and_turned_upright_and_the_file_tells_the_exposure(tmp_path):
    stored = codes(188, 99, 0)
    stored[0, 0] = (255, 10, 10)
    path = put_image(tmp_path / "a.png", stored, **EXIF)
    photograph = develop(path)
    # Turned clockwise: the stored corner comes to the right of the top row. 188 and 99 of sRGB are 0.5029 and 0.1248.
    assert photograph.linear.shape == (3, 6, 4) and photograph.linear.dtype == torch.float32
    assert photograph.linear[:, 3, 1].tolist() == pytest.approx([0.50289, 0.12477, 0], abs=1e-5)
    assert photograph.clipped.nonzero().tolist() == [[0, 3]]
    assert exposure_of(said_of(path)) == pytest.approx(0.02 * 4 / 4, rel=1e-4)
    assert photograph.notes == ("no colour profile: taken as sRGB",)


def test_a_file_that_says_nothing_has_no_exposure(tmp_path):
    assert exposure_of(said_of(put_image(tmp_path / "a.png", codes(1, 2, 3), ExposureTime=0.0))) is None


def test_adobe_rgb_is_not_srgb_and_a_missing_profile_is_said(tmp_path):
    tagged = develop(put_tagged(tmp_path / "a.png", codes(128, 64, 32), profile()))
    # By hand: 0.2195, 0.0478, 0.0104 linear Adobe RGB; the red of sRGB is 1.3983 r - 0.3983 g.
    assert float(tagged.linear[0, 0, 0]) == pytest.approx(0.2879, abs=2e-3)
    assert tagged.notes == ("colour profile 'Adobe RGB (1998)': converted to Rec. 709",)
    bare = develop(put_image(tmp_path / "b.png", codes(128, 64, 32), **{"Exif:ColorSpace": 65535}))
    assert float(bare.linear[0, 0, 0]) == pytest.approx(0.21586, abs=1e-4)
    assert "says that it is not sRGB (often Adobe RGB): taken as sRGB" in bare.notes[0]


def test_what_compression_does_to_white_still_counts_as_clipped_and_16_bits_only_at_the_end(tmp_path):
    stored = codes(250, 250, 250)
    stored[1, 1], stored[2, 2] = 253, 252
    assert develop(put_image(tmp_path / "a.png", stored)).clipped.nonzero().tolist() == [[1, 1]]
    deep = stored.astype(np.uint16) * 257
    deep[3, 3] = 65535
    linear = develop(put_image(tmp_path / "b.png", deep), "linear")
    assert linear.clipped.nonzero().tolist() == [[3, 3]] and float(linear.linear[0, 0, 0]) == pytest.approx(250 / 255)


def test_floating_point_must_be_finite(tmp_path):
    pixels = np.full((4, 4, 3), 2.5, np.float32)
    assert develop(put_image(tmp_path / "a.exr", pixels)).linear.max() == 2.5
    pixels[0, 0, 0] = np.nan
    with pytest.raises(DataError, match=r"b\.exr: the photograph must be finite; 1 values"):
        develop(put_image(tmp_path / "b.exr", pixels))


@pytest.mark.parametrize(("orientation", "place"), [(1, (10, 75)), (6, (75, 53)), (8, (20, 10)), (3, (53, 20))])
def test_raw_files_are_linear_light_upright_and_clipped_by_their_photosites(tmp_path, orientation, place):
    pytest.importorskip("rawpy")
    linear = np.empty((64, 96, 3))
    linear[:, :48], linear[:, 48:] = (0.2, 0.4, 0.1), (0.5, 0.25, 0.7)
    linear[:20, 60:90, 1] = 1.0  # green alone is clipped
    photograph = develop(write_dng(tmp_path / "a.dng", linear, orientation))
    assert photograph.linear[:, *place].tolist() == pytest.approx([0.5, 1, 0.7], abs=1e-3) and photograph.clipped[place]
    assert float(photograph.clipped.float().mean()) == pytest.approx(20 * 30 / (64 * 96), abs=0.02)
    middles = torch.tensor([[0.2, 0.4, 0.1], [0.5, 0.25, 0.7]])
    away = (photograph.linear - middles[:, :, None, None]).abs().amax(1).amin(0)
    assert float(away.median()) < 3e-4
    said = said_of(tmp_path / "a.dng")
    assert said.size == (96, 64) and said.orientation == orientation and said.focal == 35
    assert exposure_of(said) == pytest.approx(0.02 / 2.8**2, rel=1e-3)


def test_a_damaged_raw_file_and_a_missing_library_are_named(tmp_path, monkeypatch):
    pytest.importorskip("rawpy")
    path = tmp_path / "b.dng"
    path.write_bytes(b"II*\0" + b"\0" * 40)
    with pytest.raises(DataError, match=r"b\.dng: the raw file must be readable"):
        develop(path)

    def missing():
        raise DataError("capture: rawpy must be installed; no module. Install it with: pip install torchmat[capture]")

    monkeypatch.setattr(raw_module, "rawpy", missing)
    with pytest.raises(DataError, match=r"pip install torchmat\[capture\]"):
        develop(path)
