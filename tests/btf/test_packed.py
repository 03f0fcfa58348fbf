"""Files of their own kind that were packed: a `.gz`, or a zip that holds nothing else."""

from __future__ import annotations

import gzip
import tempfile
import zipfile

import pytest
import torch
from tests.btf.dfmf_files import put_small
from tests.btf.files import put_btf, zipped

from torchmat import DataError, load_btf
from torchmat.btf import packed


@pytest.fixture(autouse=True)
def scratch(monkeypatch, tmp_path_factory):
    """A place of its own for scratch files, which must be empty in the end."""
    folder = tmp_path_factory.mktemp("scratch")
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    monkeypatch.setenv("TORCHMAT_CACHE", str(tmp_path_factory.mktemp("cache")))
    yield folder
    assert not list(folder.glob("torchmat-btf-*"))


def archived(path, member="x/silk.btf"):
    target = path.with_suffix(".zip")
    with zipfile.ZipFile(target, "w") as archive:
        archive.writestr("x/", b"")
        archive.writestr("__MACOSX/._silk.btf", b"what a Mac adds")
        archive.writestr(member, path.read_bytes())
    return target


def compressed(path):
    target = path.with_name(path.name + ".gz")
    target.write_bytes(gzip.compress(path.read_bytes()))
    return target


@pytest.mark.parametrize("pack", [compressed, archived])
def test_it_is_the_file_that_was_packed(pack, tmp_path):
    path = put_small(tmp_path / "silk.btf")
    plain, found = load_btf(path, cache=False), load_btf(pack(path), cache=False)
    assert torch.equal(found.images(range(len(found))), plain.images(range(len(plain))))
    assert torch.equal(found.light, plain.light) and found.source.kind == "ubo2014"
    assert found.source.path == str(pack(path))
    assert load_btf(pack(path), kind="ubo2014", cache=False).source.kind == "ubo2014"


def test_the_cache_knows_it_again_without_unpacking(tmp_path, monkeypatch):
    path = compressed(put_small(tmp_path / "silk.btf"))
    first = load_btf(path)
    monkeypatch.setattr(packed, "unpack", None)
    again = load_btf(path)
    assert again.source.from_cache and torch.equal(again.images(range(len(again))), first.images(range(len(first))))


def test_a_name_that_leads_out_of_the_archive_is_refused(tmp_path):
    path = archived(put_small(tmp_path / "silk.btf"), "../../silk.btf")
    with pytest.raises(DataError, match=r"silk\.zip: .*silk\.btf: the name must stay inside the archive"):
        load_btf(path, cache=False)
    assert not any((folder / "silk.btf").exists() for folder in (tmp_path.parent, tmp_path.parent.parent))


def test_damage_names_the_archive(tmp_path):
    path = put_small(tmp_path / "silk.btf")
    whole = path.read_bytes()
    path.write_bytes(whole[:-9])
    with pytest.raises(DataError, match=r"silk\.btf\.gz: ") as caught:
        load_btf(compressed(path), cache=False)
    assert "torchmat-btf-" not in str(caught.value)
    with pytest.raises(DataError, match=r"silk\.zip: x/silk\.btf: "):
        load_btf(archived(path), cache=False)
    cut = gzip.compress(whole)[:-20]
    (tmp_path / "silk.btf.gz").write_bytes(cut)
    with pytest.raises(DataError, match=r"silk\.btf\.gz: the archive must unpack without damage"):
        load_btf(tmp_path / "silk.btf.gz", cache=False)


def test_what_unpacks_to_too_much_is_refused(tmp_path, monkeypatch):
    path = compressed(put_small(tmp_path / "silk.btf"))
    monkeypatch.setattr(packed, "_SHARE_OF_DISK", 0.0)
    with pytest.raises(DataError, match=r"silk\.btf\.gz: what it unpacks to must be at most 0 GiB; it is more"):
        load_btf(path, cache=False)


def test_other_archives_are_what_they_were(tmp_path):
    (tmp_path / "a.txt.gz").write_bytes(gzip.compress(b"text"))
    with pytest.raises(DataError, match=r"a\.txt\.gz: the path must be a folder or a zip"):
        load_btf(tmp_path / "a.txt.gz", cache=False)
    archive = zipped(put_btf(tmp_path / "d"))
    assert load_btf(archive, cache=False).source.kind == "manifest"
