"""Hard case 15 over time: small fits of every model give what is stored; the short form of `digests`."""

from __future__ import annotations

from tests.hard_cases import digests

from torchmat.fitting import RECIPES


def test_15_small_fits_give_what_is_stored():
    found = digests.results()
    assert {digests.fits()[name][0] for name in found} == set(RECIPES)
    # On a relief: closed forms with and without shadow of their own, tables, a lobe and a descent; and one recovered.
    assert sum(name.endswith(("on a relief", "recovered")) for name in found) == 8
    said = digests.changed(found)
    known = digests.platform_key() in digests.stored()["digests"]
    step = f"If this is meant, store them: {digests.STORE}."
    if not known:
        step += f" This platform, {digests.platform_key()!r}, is not among those stored, so only numbers were compared."
    assert not said, "\n".join([*said, step])


def test_digests_are_compared_on_a_known_platform_and_numbers_elsewhere():
    kept = {"numbers": {"ptm": [0.1, 0.2, 0.3]}, "digests": {"here": {"ptm": "a"}}}
    same, other_bits = {"ptm": {"digest": "a", "numbers": [0.1, 0.2, 0.3]}}, {"ptm": {"digest": "b", "numbers": [0.1, 0.2001, 0.3]}}
    far = {"ptm": {"digest": "b", "numbers": [0.1, 0.21, 0.3]}}
    assert digests.changed(same, kept, "here") == [] and "other bits" in digests.changed(other_bits, kept, "here")[0]
    assert digests.changed(other_bits, kept, "elsewhere") == []
    assert "instead of" in digests.changed(far, kept, "elsewhere")[0]
    assert digests.changed({"hsh": same["ptm"]}, kept, "elsewhere") == ["hsh: nothing is stored"]
    # Stored from another platform: no bits of it here, but its numbers count.
    more = {"numbers": {**kept["numbers"], "hsh": [0.1, 0.2, 0.3]}, "digests": kept["digests"]}
    assert digests.changed({**same, "hsh": other_bits["ptm"]}, more, "here") == []
    assert "instead of" in digests.changed({"hsh": far["ptm"]}, more, "here")[0]
    assert digests.changed({"lptm": same["ptm"]}, more, "here") == ["lptm: nothing is stored"]


def test_storing_keeps_other_platforms_only_while_their_numbers_hold(tmp_path, monkeypatch):
    monkeypatch.setattr(digests, "STORED", tmp_path / "digests.json")
    monkeypatch.setattr(digests, "platform_key", lambda: "first")
    digests.store({"ptm": {"digest": "a", "numbers": [0.1, 0.2, 0.3]}})
    monkeypatch.setattr(digests, "platform_key", lambda: "second")
    digests.store({"ptm": {"digest": "b", "numbers": [0.1, 0.2, 0.3]}})
    assert digests.stored()["digests"] == {"first": {"ptm": "a"}, "second": {"ptm": "b"}}
    digests.store({"ptm": {"digest": "c", "numbers": [0.1, 0.3, 0.3]}})
    assert digests.stored()["digests"] == {"second": {"ptm": "c"}}


def test_a_digest_tells_names_shapes_and_bits():
    import torch

    one = {"a": torch.zeros(2, 3)}
    found = {digests.digest(maps) for maps in (one, {"b": one["a"]}, {"a": torch.zeros(3, 2)}, {"a": -one["a"]}, {"a": one["a"].double()})}
    assert len(found) == 5 and digests.digest({"a": torch.zeros(2, 3)}) in found
