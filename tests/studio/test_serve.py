"""The command from its start to its end: ports, a second studio, a picture to begin with, what is missing, Ctrl-C."""

from __future__ import annotations

import importlib.util
import os
import signal
import socket
import subprocess
import sys
import urllib.request

import numpy as np
import pytest
import torch
import uvicorn
from tests.studio.serving import wool

import torchmat as tm
from torchmat.cli import main
from torchmat.errors import DataError, RangeError
from torchmat.images import write_image
from torchmat.studio import serve


def test_a_port_in_use_is_an_error_or_the_next_one_is_taken():
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(DataError, match=f"port {port} must be free; another program has it. Give another one"):
            serve._bound(port)
    with serve._bound(None) as first, serve._bound(None) as second:
        assert first.getsockname()[0] == second.getsockname()[0] == "127.0.0.1"
        assert first.getsockname()[1] != second.getsockname()[1]
    for wrong in (0, 65536, -1):
        with pytest.raises(RangeError, match="lie in"):
            serve._bound(wrong)


def test_what_is_not_installed_is_named_with_how_to_install_it(monkeypatch, tmp_path):
    usual = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name in ("uvicorn", "watchfiles") else usual(name))
    with pytest.raises(DataError, match=r"uvicorn, watchfiles are not. Run: pip install 'torchmat\[studio\]'"):
        tm.open_studio(tmp_path, browser=False)


def test_what_is_no_material_or_does_not_exist_is_the_usual_error(tmp_path, capsys):
    assert main(["studio", str(tmp_path), "--no-browser"]) == 2
    assert "manifest must exist" in capsys.readouterr().err
    assert main(["studio", str(tmp_path / "none"), "--no-browser"]) == 2
    assert main(["studio", str(tmp_path), "--port", "0"]) == 2
    (tmp_path / "text.png").write_text("no picture")
    assert main(["studio", str(tmp_path / "text.png"), "--no-browser"]) == 2
    damaged = wool(tmp_path / "damaged", 8)
    (damaged / "diffuse.png").write_bytes(b"half")
    done = subprocess.run(_command(damaged), capture_output=True, text=True, timeout=120)
    assert done.returncode == 2 and "error: " in done.stderr and "diffuse.png: the image must be readable" in done.stderr
    assert "Traceback" not in done.stderr


def _command(path, *more):
    return [sys.executable, "-m", "torchmat.cli", "studio", str(path), "--no-browser", *more]


def test_from_one_picture_to_a_page_that_a_second_studio_joins_until_ctrl_c(tmp_path):
    picture = tmp_path / "photo.png"
    write_image(picture, np.random.default_rng(0).integers(40, 200, (16, 16, 3)).astype(np.uint8))
    with subprocess.Popen(_command(picture), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        lines = [process.stdout.readline(), process.stdout.readline()]
        folder = tmp_path / "photo_material"
        assert lines[0] == f"material   {folder} made of photo.png\n"
        address = lines[1].split()[1]
        assert address.startswith("http://127.0.0.1:")
        with urllib.request.urlopen(address, timeout=60) as answer:
            assert answer.status == 200 and b"photo_material" in answer.read()
        again = subprocess.run(_command(folder), capture_output=True, text=True, timeout=120)
        assert again.returncode == 0 and f"joined     another studio has {folder} open" in again.stdout and address in again.stdout
        port = address.split(":")[2].split("/")[0]
        other = wool(tmp_path / "other", 8)
        busy = subprocess.run(_command(other, "--port", port), capture_output=True, text=True, timeout=120)
        assert busy.returncode == 2 and f"port {port} must be free; another program has it" in busy.stderr
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 130
        assert process.stderr.read() == "stopped; kept, whole: " + str(folder) + "\n"
    assert main(["create", str(picture), "--out", str(tmp_path / "created"), "--no-pictures"]) == 0
    made, created = tm.load_material(folder), tm.load_material(tmp_path / "created")
    assert all(torch.equal(made.maps[name], created.maps[name]) for name in created.maps) and made.maps.keys() == created.maps.keys()
    assert oct(os.stat(tmp_path / ".photo_material.studio").st_mode & 0o777) == "0o700"


def test_ctrl_c_is_told_even_where_the_server_ends_as_if_by_itself(tmp_path, monkeypatch):
    def run(server, sockets):
        server.handle_exit(signal.SIGINT, None)
        assert server.should_exit

    monkeypatch.setattr(uvicorn.Server, "run", run)
    with pytest.raises(KeyboardInterrupt):
        serve.open_studio(wool(tmp_path / "wool", 8), browser=False)
