"""Thousands of small mistakes, made by chance: each load ends in a Btf or in an error of the package."""

from __future__ import annotations

import random

import pytest
import torch
from tests.btf.files import members_of, put_btf, put_image, random_codes, zip_of

from torchmat import Btf, TorchmatError, load_btf

TOKENS = [
    b",", b";", b"\t", b"\n", b"\r\n", b'"', b" ", b"\0", b"#", b"..", b"/", b"\\", b"0", b"-1", b"1e400", b"nan",
    b"inf", b"90", b"361", b"\xff\xfe", b"\xef\xbb\xbf", b"\xc3", b"file", b"0.png", b"light_x", b"\xc2\xb2", b"1_0",
]


def mutated(data: bytes, chance: random.Random) -> bytes:
    """Change `data` in one to four places: a bit, a token put in, a stretch dropped, doubled or exchanged."""
    data = bytearray(data)
    for _ in range(chance.randint(1, 4)):
        start = chance.randrange(len(data) + 1)
        end = min(len(data), start + chance.choice((1, 2, 5, 30)))
        way = chance.randrange(5)
        if way == 0 and start < len(data):
            data[start] ^= 1 << chance.randrange(8)
        elif way == 1:
            data[start:start] = chance.choice(TOKENS)
        elif way == 2:
            del data[start:end]
        elif way == 3:
            data[start:start] = data[start:end]
        else:
            data[start:end] = chance.choice(TOKENS)
    return bytes(data)


def loads_or_refuses(path, **options) -> bool:
    """Return whether `path` loads, soundly; any error but the package's own passes through."""
    try:
        btf = load_btf(path, cache=False, **options)
    except TorchmatError as error:
        assert str(path) in str(error)
        return False
    assert isinstance(btf, Btf)
    assert 1 <= len(btf) <= 4
    assert bool(torch.isfinite(btf.images(range(len(btf)))).all())
    assert float((btf.light.norm(dim=1) - 1).abs().max()) < 1e-5
    assert float(btf.light[:, 2].min()) > -1e-6
    return True


@pytest.mark.parametrize("seed", range(4))
def test_manifest(tmp_path, seed):
    folder = put_btf(tmp_path / "d", shape=(1, 1, 3))
    text = (folder / "manifest.csv").read_bytes()
    chance = random.Random(seed)
    loaded = 0
    for _ in range(100):
        (folder / "manifest.csv").write_bytes(mutated(text, chance))
        loaded += loads_or_refuses(folder, kind="manifest")
    assert 0 < loaded < 100, "mutations that all load, or never do, test nothing"


@pytest.mark.parametrize("seed", range(4))
def test_lp(tmp_path, seed):
    for number in range(3):
        put_image(tmp_path / "d" / f"{number}.png", random_codes(number, (1, 1, 3)))
    text = b"3\n0.png 0 0 1\n1.png 0.6 0 0.8\n2 2.png 0 -0.6 0.8\n"
    chance = random.Random(seed)
    loaded = 0
    for _ in range(100):
        (tmp_path / "d" / "dirs.lp").write_bytes(mutated(text, chance))
        loaded += loads_or_refuses(tmp_path / "d", normalise=bool(chance.randrange(2)))
    assert 0 < loaded < 100


@pytest.mark.parametrize("seed", range(4))
def test_zip(tmp_path, seed):
    archive = zip_of(tmp_path / "d.zip", members_of(put_btf(tmp_path / "d", shape=(2, 2, 3))))
    data = archive.read_bytes()
    directory = data.index(b"PK\x01\x02")
    chance = random.Random(seed)
    loaded = 0
    for _ in range(100):
        # The directory at the end is where the parser can be led astray, so half of the changes go there.
        cut = chance.choice((0, directory))
        archive.write_bytes(data[:cut] + mutated(data[cut:], chance))
        loaded += loads_or_refuses(archive)
    assert 0 < loaded < 100


@pytest.mark.parametrize("suffix, dtype", [("png", "uint8"), ("jpg", "uint8"), ("exr", "float16"), ("tif", "uint16")])
def test_images(tmp_path, suffix, dtype):
    folder = put_btf(tmp_path / "d", dtype, (8, 8, 3), suffix)
    data = (folder / f"1.{suffix}").read_bytes()
    chance = random.Random(0)
    loaded = 0
    for _ in range(60):
        (folder / f"1.{suffix}").write_bytes(mutated(data, chance))
        loaded += loads_or_refuses(folder, invalid="mask")
    assert loaded < 60
