"""Folders and archives: what is listed, what is refused, and that nothing is unpacked where it should not be."""

from __future__ import annotations

import os
import stat
import zipfile
from contextlib import closing

import pytest
from tests.btf.files import members_of, put_btf, random_codes, zip_of, zipped

from torchmat import DataError, load_btf
from torchmat.btf.readers import open_source


def test_names_and_content_of_a_folder(tmp_path):
    (tmp_path / "d" / "sub dir").mkdir(parents=True)
    for name in ("b.txt", "sub dir/ä.txt", ".hidden", "sub dir/._b.txt"):
        (tmp_path / "d" / name).write_text(name)
    for folder in ("__MACOSX", ".git"):
        (tmp_path / "d" / folder).mkdir()
        (tmp_path / "d" / folder / "x.txt").write_text("x")
    with closing(open_source(tmp_path / "d")) as source:
        assert source.names == ["b.txt", "sub dir/ä.txt"]
        assert source.read("sub dir/ä.txt").decode() == "sub dir/ä.txt"
        with source.file("b.txt") as path:
            assert path == tmp_path / "d" / "b.txt"
        with pytest.raises(DataError, match="d: none.txt: the file must be readable"):
            source.read("none.txt")


def test_names_and_content_of_a_zip(tmp_path):
    members = {"b.txt": b"b", "sub dir/ä.txt": b"aa", ".hidden": b"", "__MACOSX/x.txt": b"x", "sub dir/._b.txt": b""}
    with closing(open_source(zip_of(tmp_path / "d.zip", members))) as source:
        assert source.names == ["b.txt", "sub dir/ä.txt"]
        assert source.read("sub dir/ä.txt") == b"aa"
        with source.file("b.txt") as path:
            assert path.read_bytes() == b"b"
            assert path.suffix == ".txt"
        assert not path.exists()


def test_a_zip_by_any_suffix(tmp_path):
    archive = zipped(put_btf(tmp_path / "d"))
    archive.rename(tmp_path / "d.btf")
    assert len(load_btf(tmp_path / "d.btf")) == 4


def test_scratch_names_take_only_a_suffix_from_the_archive(tmp_path):
    names = ["a.png", "a.p/../ng", "a." + "x" * 300, "a.b c", "a"]
    members = dict.fromkeys((name for name in names if ".." not in name), b"")
    with closing(open_source(zip_of(tmp_path / "d.zip", members))) as source:
        for name, suffix in (("a.png", ".png"), ("a." + "x" * 300, ""), ("a.b c", ""), ("a", "")):
            with source.file(name) as path:
                assert path.suffix == suffix


def test_links_lead_out_of_a_folder_and_not_round_in_a_circle(tmp_path):
    put_btf(tmp_path / "store" / "images")
    folder = tmp_path / "d"
    folder.mkdir()
    (folder / "manifest.csv").write_bytes((tmp_path / "store" / "images" / "manifest.csv").read_bytes())
    (folder / "images").symlink_to(tmp_path / "store" / "images")
    (folder / "round").symlink_to(folder)
    (folder / "up").symlink_to(tmp_path)
    (tmp_path / "store" / "images" / "manifest.csv").unlink()
    (tmp_path / "store" / "images" / "back").symlink_to(tmp_path / "store")
    with closing(open_source(folder)) as source:
        assert source.names == [*(f"images/{n}.png" for n in range(4)), "manifest.csv"]
    assert len(load_btf(folder)) == 4


def test_a_link_to_nothing_is_a_missing_image(tmp_path):
    folder = put_btf(tmp_path / "d")
    (folder / "2.png").unlink()
    (folder / "2.png").symlink_to(tmp_path / "never fetched")
    with pytest.raises(DataError, match="d: 2.png: the image must be readable"):
        load_btf(folder)


def test_a_pipe_is_no_file(tmp_path):
    folder = put_btf(tmp_path / "d")
    os.mkfifo(folder / "4.png")
    with closing(open_source(folder)) as source:
        assert "4.png" not in source.names
    assert len(load_btf(folder)) == 4


def test_a_file_name_that_is_not_utf_8(tmp_path):
    folder = put_btf(tmp_path / "d")
    os.rename(folder / "1.png", os.fsencode(folder) + b"/1\xff.png")
    with pytest.raises(DataError, match="line 3: the file '1.png' must exist"):
        load_btf(folder)
    (folder / "manifest.csv").unlink()
    with pytest.raises(DataError, match="4 of them images"):
        load_btf(folder)


@pytest.mark.parametrize(
    "name", ["../x.png", "a/../../x.png", "/etc/x.png", "\\\\server\\x.png", "..\\x.png", "C:\\x.png", "c:x.png"]
)
def test_names_that_lead_outside(tmp_path, name):
    archive = zip_of(tmp_path / "evil.zip", members_of(put_btf(tmp_path / "d")) | {name: b"x"})
    before = sorted(tmp_path.rglob("x.png"))
    with pytest.raises(DataError, match="evil.zip: .*x.png: the name must stay inside the archive; .*Repack"):
        load_btf(archive)
    assert sorted(tmp_path.rglob("x.png")) == before == []


@pytest.mark.parametrize("name", ["", ".", "./", "a//b.txt", "a/./b.txt", " ", "...", "ab:c.txt"])
def test_odd_names_are_harmless(tmp_path, name):
    archive = zipped(put_btf(tmp_path / "d"))
    with zipfile.ZipFile(archive, "a") as odd:
        odd.writestr(zipfile.ZipInfo(name), b"x")
    assert len(load_btf(archive)) == 4


def test_a_link_in_a_zip_is_not_followed(tmp_path):
    (tmp_path / "secret.png").write_bytes(b"secret")
    members = members_of(put_btf(tmp_path / "d"))
    del members["1.png"]
    archive = zip_of(tmp_path / "link.zip", members)
    with zipfile.ZipFile(archive, "a") as linked:
        info = zipfile.ZipInfo("1.png")
        info.external_attr = (stat.S_IFLNK | 0o777) << 16
        linked.writestr(info, str(tmp_path / "secret.png"))
    with pytest.raises(DataError, match="link.zip: 1.png: the image must be readable"):
        load_btf(archive)


def patched(archive, member: str, offsets: tuple[int, int], data: bytes):
    """Overwrite bytes of a member's two headers: the local one (at `offsets[0]`) and that of the directory."""
    content = bytearray(archive.read_bytes())
    with zipfile.ZipFile(archive) as intact:
        local = intact.getinfo(member).header_offset
    central = content.rindex(b"PK\x01\x02", 0, content.rindex(member.encode()))
    for start, offset in ((local, offsets[0]), (central, offsets[1])):
        content[start + offset : start + offset + len(data)] = data
    archive.write_bytes(bytes(content))
    return archive


@pytest.mark.parametrize("stated", [0, 40, 10**6, 2**31 - 1])
def test_a_zip_that_lies_about_a_size(tmp_path, stated):
    archive = zip_of(tmp_path / "lies.zip", members_of(put_btf(tmp_path / "d")))
    patched(archive, "2.png", (22, 24), stated.to_bytes(4, "little"))
    with pytest.raises(DataError, match="lies.zip: 2.png: the file must (unpack without|have the stated).*Repack"):
        load_btf(archive)


def test_a_zip_that_unpacks_to_far_more_than_it_says(tmp_path):
    members = members_of(put_btf(tmp_path / "d")) | {"2.png": bytes(50_000_000)}
    archive = patched(zip_of(tmp_path / "bomb.zip", members), "2.png", (22, 24), (100).to_bytes(4, "little"))
    with pytest.raises(DataError, match="bomb.zip: 2.png: the file must unpack without damage"):
        load_btf(archive)


def test_a_file_too_large_for_a_photograph(tmp_path):
    archive = zip_of(tmp_path / "big.zip", members_of(put_btf(tmp_path / "d")))
    patched(archive, "2.png", (22, 24), (2**32 - 2).to_bytes(4, "little"))
    with pytest.raises(DataError, match="big.zip: 2.png: the file must be smaller than 2 GiB; .* to 4294967294"):
        load_btf(archive)


def test_encrypted(tmp_path):
    archive = zip_of(tmp_path / "locked.zip", members_of(put_btf(tmp_path / "d")))
    patched(archive, "1.png", (6, 8), b"\x01\x00")
    with pytest.raises(DataError, match="locked.zip: 1.png: the file must not be encrypted; it is. Repack without"):
        load_btf(archive)


def test_a_way_of_packing_that_is_not_known(tmp_path):
    archive = zip_of(tmp_path / "odd.zip", members_of(put_btf(tmp_path / "d")))
    patched(archive, "1.png", (8, 10), (77).to_bytes(2, "little"))
    with pytest.raises(DataError, match="odd.zip: 1.png: the file must unpack without damage"):
        load_btf(archive)


def test_a_damaged_member(tmp_path):
    pixels = {"1.png": random_codes(5, (40, 40, 3)).tobytes()}
    archive = zip_of(tmp_path / "bad.zip", members_of(put_btf(tmp_path / "d")) | pixels)
    content = bytearray(archive.read_bytes())
    start = content.index(b"1.png") + 100
    content[start : start + 40] = bytes(40)
    archive.write_bytes(bytes(content))
    with pytest.raises(DataError, match="bad.zip: 1.png: the file must unpack without damage; .*Repack"):
        load_btf(archive)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.95])
def test_a_truncated_zip(tmp_path, share):
    archive = zipped(put_btf(tmp_path / "d"))
    data = archive.read_bytes()
    archive.write_bytes(data[: int(share * len(data))])
    with pytest.raises(DataError, match="d.zip: the archive must be a readable zip; .*download or copy is complete"):
        load_btf(archive)


@pytest.mark.parametrize(
    "name, text",
    [
        ("none", "none: the path must exist; there is nothing. Check the spelling"),
        ("none/manifest.csv", "manifest.csv: the path must exist"),
        ("plain.png", "plain.png: the path must be a folder or a zip, or a file of kind brdf, ubo2014, neuralbtf; it is neither. Give"),
    ],
)
def test_no_source(tmp_path, name, text):
    (tmp_path / "plain.png").write_bytes(b"\x89PNG")
    with pytest.raises(DataError, match=text):
        load_btf(tmp_path / name)


def test_files_are_closed_after_a_load(tmp_path):
    def open_files() -> list[str]:
        links = [f"/proc/self/fd/{number}" for number in os.listdir("/proc/self/fd")]
        return [os.readlink(link) for link in links if os.path.exists(link)]

    if not os.path.isdir("/proc/self/fd"):
        pytest.skip("this system does not show open files")
    archive = zipped(put_btf(tmp_path / "d"))
    load_btf(archive)
    patched(archive, "d/1.png", (8, 10), (77).to_bytes(2, "little"))
    with pytest.raises(DataError):
        load_btf(archive)
    assert not [name for name in open_files() if name.startswith(str(tmp_path / "d"))]
