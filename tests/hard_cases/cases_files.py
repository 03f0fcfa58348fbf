"""Hard cases of readers and writers: sizes, values and directions at their ends, kills and full disks, names, hostile files."""

from __future__ import annotations

import math
import shutil
import time
from collections.abc import Iterable
from pathlib import Path

import pytest
import torch
from tests.hard_cases.cases_shading import FULL
from tests.hard_cases.components import Component, Room
from tests.hard_cases.fuzz_readers import Reader, digest
from tests.hard_cases.fuzz_worker import put_tree, tree_of
from tests.hard_cases.writers import Writer, leave_free, read_only, small_disk, snapshot

from torchmat import DataError, TorchmatError

NAMES = ("two words", "Wolle grün-мох-苔", "[a]*?")


def has_maps(component: Component) -> bool:
    """Return whether a writer takes any material, with rotations and normals."""
    return component.given.kind == "material"


def has_height(component: Component) -> bool:
    """Return whether a writer stores heights."""
    return component.given.kind in ("material", "relief")


def takes_values(component: Component) -> bool:
    """Return whether what a writer gets can hold any value."""
    return component.given.replaced is not None


def _comes_back(writer: Writer, given: object, target: Path) -> dict[str, torch.Tensor]:
    """Write, read, assert that exactly what was promised is there, and return it."""
    writer.write(given, target)
    found, wanted = writer.read(target), writer.wanted(given)
    for name, value in wanted.items():
        error = float((found[name].double() - value.double()).abs().max())
        # Ends of a range pass through decimal text; what they span keeps its last place of float32.
        assert error <= 1e-6 * float(value.abs().max()), f"{name} differs by {error:.3g} from what was promised"
    return found


def _angle_deg(one: torch.Tensor, other: torch.Tensor) -> float:
    """Return the largest angle between vectors [C, H, W], in degrees."""
    one, other = (torch.nn.functional.normalize(x.double(), dim=0) for x in (one, other))
    return float(torch.rad2deg(2 * torch.atan2((one - other).norm(dim=0), (one + other).norm(dim=0))).max())


def _target(writer: Writer, room: Room, name: str = "target") -> Path:
    return room.folder / f"{name}{writer.suffix}"


def rim_normals(writer: Writer, room: Room) -> float:
    """Case 3: normals tilted by 89.9 degrees; returns by how many degrees they come back turned."""
    azimuth = torch.arange(12.0).reshape(1, 3, 4)
    tilt = math.radians(89.9)
    normal = torch.cat((math.sin(tilt) * azimuth.cos(), math.sin(tilt) * azimuth.sin(), torch.full_like(azimuth, math.cos(tilt))))
    # Without a relief, beside whose slopes packed normals stop at 84 degrees.
    given = writer.replaced(writer.make((3, 4), 0).surface(), normal=normal)
    figure = _angle_deg(_comes_back(writer, given, _target(writer, room))["normal"], normal)
    assert figure < 1.5  # codes of 8 bits stand 0.45 degrees apart, and two of them are combined
    return figure


def wrapped_angles(writer: Writer, room: Room) -> float:
    """Case 5: rotations of 0, 360 and next to them; returns by how many degrees they come back turned."""
    angle = torch.deg2rad(torch.tensor([[[0.0, 360.0, 359.999, 0.001, 180.0, -180.0, 359.0, 1.0]]]))
    rotation = torch.cat((angle.cos(), angle.sin()))
    given = writer.replaced(writer.make((1, 8), 0), rotation=rotation)
    figure = _angle_deg(_comes_back(writer, given, _target(writer, room))["rotation"], rotation)
    assert figure < 1.5
    return figure


def small_beside_large(writer: Writer, room: Room) -> float:
    """Case 8: 1e-8 beside 1e4 in one map; returns the digits that the small value keeps (0: it is lost to the step)."""
    given = writer.make((3, 4), 0)
    name = writer.poison
    value = torch.full_like(writer.wanted(given)[name], 1e-8)
    value[..., 1, 2] = 1e4 if writer.kind == "material" else 1.0
    found = _comes_back(writer, writer.replaced(given, **{name: value}), _target(writer, room))[name]
    assert bool(torch.isfinite(found).all())
    if writer.kind == "picture":
        return 0.0
    error = abs(float(found[0, 0, 0]) - 1e-8) / 1e-8
    return FULL if error == 0 else min(FULL, max(0.0, -math.log10(error)))


def sizes(writer: Writer, room: Room) -> None:
    """Case 10: maps of all shapes come back as promised."""
    for number, size in enumerate(((1, 1), (1, 7), (7, 1), (3, 5), (1, 4096))):
        if writer.kind == "report" and size[1] == 4096:
            continue
        found = _comes_back(writer, writer.make(size, number), _target(writer, room, str(number)))
        assert any(value.shape[-2:] == size for value in found.values())


def refused(writer: Writer, room: Room) -> None:
    """Case 11: a value that is not finite is refused by name, and what stands there stays."""
    target, given = _target(writer, room), writer.make((3, 4), 0)
    writer.write(given, target)
    before = snapshot(target)
    for poison in (math.nan, math.inf):
        broken = writer.make((3, 4), 1)
        if hasattr(broken, "maps"):
            broken.maps[writer.poison].data[..., 0, 0] = poison  # behind the back of the checks
        else:
            value = writer.wanted(broken)[writer.poison].clone()
            value[..., 0, 0] = poison
            broken = writer.replaced(broken, **{writer.poison: value})
        with pytest.raises(TorchmatError, match=f"{writer.poison}.*finite"):
            writer.write(broken, target)
        assert snapshot(target) == before and len(list(room.folder.iterdir())) == 1


def full_step(writer: Writer, room: Room) -> float:
    """Case 12: a height step of the full range; returns the error of what comes back, as a share of it."""
    height = torch.zeros(1, 4, 6)
    height[..., 3:] = 9.0
    given = writer.replaced(writer.make((4, 6), 0), height=height)
    error = float((_comes_back(writer, given, _target(writer, room))["height"] - height).abs().max()) / 9
    assert error < 1e-3
    return error


def same_bytes(writer: Writer, room: Room) -> None:
    """Case 15: written twice, the files are the same."""
    targets = [_target(writer, room, name) for name in ("one", "two")]
    for target in targets:
        writer.write(writer.make((5, 6), 3), target)
        time.sleep(1.1 if room.thorough else 0)  # some formats hold the second of writing
    one, two = (list(snapshot(target).values()) for target in targets)
    assert one == two


def full_disk(writer: Writer, room: Room) -> float:
    """Case 16: a disk that fills up at any moment leaves the old whole or the new; returns how many writes it stopped."""
    return float(fill_up(writer, room, range(0, 400, 40) if room.thorough else (0, 12, 40)))


def fill_up(writer: Writer, room: Room, kilobytes: Iterable[int]) -> int:
    """Write where only so much is free, each time anew; return how many writes that stopped."""
    stopped = 0
    with small_disk(room.folder / "disk") as disk:
        target = disk / f"target{writer.suffix}"
        old, new = writer.make((6, 6), 0), writer.make((150, 150), 1)
        for free in kilobytes:
            (disk / "filler").unlink(missing_ok=True)
            writer.write(old, target)
            before = snapshot(target)
            leave_free(disk, free)
            try:
                writer.write(new, target)
            except DataError as error:
                stopped += 1
                assert str(disk) in str(error), f"{error} does not name the disk"
                assert snapshot(target) == before, "the old is not as it was"
            assert {path.name for path in disk.iterdir()} == {"filler", target.name}, "rests are left behind"
            writer.read(target)
        (disk / "filler").unlink()
        _comes_back(writer, old, target)
    assert stopped, "the disk was never full"
    return stopped


def after_export(writer: Writer, room: Room) -> float:
    """Case 17: what comes back is what was promised; returns its largest error, as a share of each map's largest value."""
    given = writer.make((9, 7), 2)
    found = _comes_back(writer, given, _target(writer, room))
    if writer.kind == "picture":
        return 0.5 / 255
    if writer.kind == "report":
        return max(_share(found[name], value) for name, value in given[1].material.maps.items())
    exact = given._asdict() if writer.kind == "relief" else given.maps
    return max(_share(value, exact[name]) for name, value in found.items())


def _share(found: torch.Tensor, wanted: torch.Tensor) -> float:
    wanted = wanted.detach().float()
    return float((found - wanted).abs().max() / wanted.abs().max().clamp(min=1e-30))


def targets(writer: Writer, room: Room) -> None:
    """Case 18: names of all letters, a target that exists, one that is somebody else's, a path below a file, a read-only disk."""
    given = writer.make((4, 5), 0)
    for name in NAMES:
        _comes_back(writer, given, room.folder / name / f"{name}{writer.suffix}")
        _comes_back(writer, writer.make((4, 5), 1), room.folder / name / f"{name}{writer.suffix}")
    (room.folder / "file").write_text("mine", encoding="utf-8")
    with pytest.raises(DataError, match="must be"):
        writer.write(given, room.folder / "file" / f"target{writer.suffix}")
    assert (room.folder / "file").read_text() == "mine"
    if not writer.suffix:
        (room.folder / "foreign").mkdir()
        (room.folder / "foreign" / "thesis.txt").write_text("mine", encoding="utf-8")
        with pytest.raises(DataError, match="foreign: the target must be"):
            writer.write(given, room.folder / "foreign")
        assert snapshot(room.folder / "foreign") == {"thesis.txt": b"mine"}


def read_only_target(writer: Writer, room: Room) -> None:
    """Case 18 on a disk that nobody may write to; where none can be mounted, the rest of the case still stands."""
    targets(writer, room)
    with small_disk(room.folder / "disk") as disk:
        target = disk / f"target{writer.suffix}"
        writer.write(writer.make((4, 5), 0), target)
        before = snapshot(target)
        read_only(disk)
        with pytest.raises(DataError, match=r"must be writable; .*Read-only"):
            writer.write(writer.make((4, 5), 1), target)
        assert snapshot(target) == before


def _good(reader: Reader, folder: Path) -> Path:
    folder.mkdir(parents=True)
    return reader.put(folder)


def hostile(reader: Reader, room: Room) -> float:
    """Case 11: nothing there, empty and truncated files are refused by name or read soundly; returns how many were refused."""
    good = _good(reader, room.folder / "good")
    tree, place = tree_of(room.folder / "good"), good.relative_to(room.folder / "good")
    wrecks = [{}]
    names = [name for name, content in tree.items() if isinstance(content, bytes) and name.endswith(reader.mutable)]
    for name in names[:2]:
        size = len(tree[name])
        cuts = range(0, size, max(1, size // 60)) if room.thorough else (0, size // 3, size - 1)
        wrecks += [{**tree, name: tree[name][:cut]} for cut in cuts]
        wrecks += [{**tree, name: b"This is a text.\r\n"}, {**tree, name: b"\xef\xbb\xbf"}]
    refusals = 0
    for number, wreck in enumerate(wrecks):
        folder = room.folder / "wreck"  # one name, so that a store in the cache is of the same source
        folder.mkdir()
        put_tree(folder, wreck)
        try:
            reader.read(folder / place)
        except TorchmatError as error:
            refusals += 1
            assert str(folder) in str(error) or reader.names_key, f"wreck {number}: {error} does not name the file"
        shutil.rmtree(folder)
    assert refusals or reader.heals, "nothing was refused"
    return float(refusals)


def read_twice(reader: Reader, room: Room) -> None:
    """Case 15: the same files, the same bits."""
    good = _good(reader, room.folder / "good")
    assert digest(reader.read(good)) == digest(reader.read(good))


def leaves_files(reader: Reader, room: Room) -> None:
    """Case 16: reading changes none of the files and adds none."""
    good = _good(reader, room.folder / "good")
    before = tree_of(room.folder / "good")
    reader.read(good)
    assert tree_of(room.folder / "good") == before


def named_folders(reader: Reader, room: Room) -> None:
    """Case 18: the same content under names with spaces and foreign letters, and on a disk that is read-only."""
    good = _good(reader, room.folder / "good")
    wanted = digest(reader.read(good))
    for name in NAMES:
        place = _good(reader, room.folder / name / name)
        assert digest(reader.read(place)) == wanted
    with small_disk(room.folder / "disk", 2048) as disk:
        place = _good(reader, disk / "good")
        read_only(disk)
        assert digest(reader.read(place)) == wanted
