"""The printed board: where its parts are, that what is drawn is what is measured by, and its scale."""

from __future__ import annotations

import re
import subprocess
import sys

import numpy as np
import pytest
import torchmat.cli
from tests.capturing.simulated import BLACK, WHITE

from torchmat.capturing.board import GREY, PAPERS, SERIES, Board
from torchmat.capturing.draw_board import write_board
from torchmat.errors import RangeError
from torchmat.images import read_image

cv2 = pytest.importorskip("cv2")


def test_places_of_an_a4_board():
    board = Board()
    assert board.square == 16 and board.bar_length == 150
    assert board.window.tolist() == [-56, -56, 56, 56]
    assert board.sphere_centres.tolist() == [[64, 112, 12.5], [-64, -112, 12.5]]
    assert [-72, 72] in board.corners.tolist() and [72, -72] in board.corners.tolist()
    # No corner touches the window: a sample there would hide half of it.
    assert (np.abs(board.corners) >= 72 - 1e-9).any(1).all()
    assert board.marker_corners[0].tolist() == [[-38, 134], [-26, 134], [-26, 122], [-38, 122]]
    assert [board.reflectance(*np.array([[x], [y]], float)).item() for x, y in ((-80, 130), (-64, 128), (0, 120), (0, 0), (200, 0))] == [
        np.float32(one) for one in (BLACK, WHITE, GREY, WHITE, WHITE)
    ]


@pytest.mark.parametrize("paper", PAPERS)
def test_all_parts_lie_on_the_paper(paper):
    board, (width, height) = Board(paper, diameter=20), PAPERS[paper]
    for places in (board.corners, board.marker_corners.reshape(-1, 2), board.bar.reshape(2, 2), board.sphere_centres[:, :2]):
        assert (np.abs(places) < np.array([width, height]) / 2 - 3).all()
    assert len(board.corners) == 54 and len(board.marker_ids) == 52


def test_signs_of_corners_are_what_the_squares_are():
    board = Board()
    x, y = board.corners.T
    above_left = board.reflectance(x - 0.5, y + 0.5)
    assert (np.where(above_left == np.float32(BLACK), 1, -1) == board.corner_signs).all()
    assert (board.reflectance(x + 0.5, y + 0.5) != above_left).all()


def test_series_share_no_marker():
    ids = [one for series in range(SERIES) for one in Board(series=series).marker_ids]
    assert len(set(ids)) == len(ids) and max(ids) < 1000


def test_a_print_at_another_scale_moves_all_but_the_spheres_themselves():
    board = Board().measured(147.0)
    assert board.scale == pytest.approx(0.98) and board.bar_length == pytest.approx(147) and board.measured(147.0).scale == pytest.approx(0.98)
    assert board.corners == pytest.approx(Board().corners * 0.98)
    assert board.sphere_centres[0] == pytest.approx([64 * 0.98, 112 * 0.98, 12.5])


def test_a_png_shows_what_the_board_says_it_reflects(tmp_path):
    board = Board("A5", diameter=20)
    pixels = read_image(write_board(board, tmp_path / "board.png", dpi=254))[..., 0] / 255  # 10 pixels a millimetre
    assert pixels.shape == (2100, 1480)
    x, y = np.meshgrid((np.arange(1480) + 0.5) / 10 - 74, 105 - (np.arange(2100) + 0.5) / 10)
    wanted = (board.reflectance(x, y) - BLACK) / (WHITE - BLACK)
    known = (np.abs(y) < 8.5 * board.square) & (np.abs(wanted - 0.5) > 0.4)  # words lie outside, greys and edges are between
    for distance in (1, 2):  # pixels from an edge
        for axis in (0, 1):
            known &= (np.roll(wanted, distance, axis) == wanted) & (np.roll(wanted, -distance, axis) == wanted)
    assert known.mean() > 0.6 and ((pixels > 0.5) == (wanted > 0.5))[known].all()


def test_pdf_and_svg_have_the_papers_size_and_the_same_bytes_each_time(tmp_path):
    board = Board("A4")
    for name in ("a.pdf", "b.pdf", "a.svg", "b.svg"):
        write_board(board, tmp_path / name)
    assert (tmp_path / "a.pdf").read_bytes() == (tmp_path / "b.pdf").read_bytes()
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()
    box = re.search(rb"/MediaBox \[ ?0 0 ([\d.]+) ([\d.]+)", (tmp_path / "a.pdf").read_bytes())
    assert [float(one) * 25.4 / 72 for one in box.groups()] == pytest.approx([210, 297], abs=1e-3)
    # The bar's corners are in the SVG, in points from the top left.
    text = (tmp_path / "a.svg").read_text()
    left, bottom = (board.bar[0] + 105) * 72 / 25.4, (148.5 - board.bar[1]) * 72 / 25.4
    found = np.array([[float(a), float(b)] for a, b in re.findall(r"[ML] ([\d.]+) ([\d.]+)", text)])
    assert np.abs(found - [left, bottom]).max(1).min() < 1e-3


@pytest.mark.parametrize(("wrong", "said"), [
    ({"paper": "A7"}, "be one of"), ({"diameter": 45.0}, "at most 40 mm on A4"), ({"spheres": 3}, "be one of"), ({"series": 16}, "be one of"),
    ({"scale": 0.0}, "positive"),
])
def test_boards_that_cannot_be(wrong, said):
    with pytest.raises(RangeError, match=said):
        Board(**wrong)


def test_the_command_draws_and_says_what_to_measure(tmp_path, capsys):
    assert torchmat.cli.main(["board", "--size", "A5", "--diameter", "20", "--out", str(tmp_path / "b.svg")]) == 0
    assert "window     77 x 77 mm" in capsys.readouterr().out and (tmp_path / "b.svg").is_file()
    assert torchmat.cli.main(["board", "--out", str(tmp_path / "b.doc")]) == 2
    assert "'.doc'" in capsys.readouterr().err and not (tmp_path / "b.doc").exists()


def test_without_opencv_the_extra_is_named_and_everything_can_be_imported(tmp_path):
    code = f"""
import sys, pkgutil, importlib
sys.modules["cv2"] = sys.modules["rawpy"] = None
import torchmat.capturing
for part in pkgutil.iter_modules(torchmat.capturing.__path__):
    importlib.import_module(f"torchmat.capturing.{{part.name}}")
sys.exit(__import__("torchmat.cli").cli.main(["board", "--out", {str(tmp_path / "b.pdf")!r}]))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 2 and "pip install torchmat[capture]" in done.stderr and not (tmp_path / "b.pdf").exists()
