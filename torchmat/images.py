"""Pixel files, through OpenImageIO; nothing else in the package opens an image."""

from __future__ import annotations

import shutil
import struct
import zlib
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, NamedTuple

import numpy as np

from torchmat import atomic, icc
from torchmat.channels import channel_order, numbered_order
from torchmat.errors import DataError, RangeError, ShapeError, message

if TYPE_CHECKING:
    from types import ModuleType

    from OpenImageIO import ImageInput, ImageOutput, ImageSpec

IMAGE_SUFFIXES = frozenset({".jpg", ".jpeg", ".png", ".exr", ".tif", ".tiff", ".hdr", ".bmp", ".tga", ".ppm"})
MOVING_SUFFIXES = frozenset({".png", ".apng", ".gif"})
_WRITABLE = {"uint8": "uint8", "uint16": "uint16", "float16": "half", "float32": "float"}

# They would hold the time of writing: the same maps give the same bytes.
_DATED, _NO_DATE = (".exr", ".tif", ".tiff"), "0000:00:00 00:00:00"
_JPEG_SHARE, _JPEG_HEAD = 2, 4096  # of the pixels' bytes, and beside them: what a JPEG never exceeds

# How pixels [H, W, C] become upright, by their EXIF orientation (CIPA DC-008, tag 274).
_TURNS: dict[int, Callable[[np.ndarray], np.ndarray]] = {
    1: lambda stored: stored, 2: lambda stored: stored[:, ::-1], 3: lambda stored: stored[::-1, ::-1], 4: lambda stored: stored[::-1],
    5: lambda stored: stored.swapaxes(0, 1), 6: lambda stored: stored[::-1].swapaxes(0, 1),
    7: lambda stored: stored[::-1, ::-1].swapaxes(0, 1), 8: lambda stored: stored[:, ::-1].swapaxes(0, 1),
}

_UNCALIBRATED = 65535  # EXIF's colour space of what is not sRGB
_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
# Asks for endless repetition, and a comment of the same length to stand in its place.
_GIF_LOOP = b"\x21\xff\x0bNETSCAPE2.0\x03\x01\x00\x00\x00"
_GIF_COMMENT = b"\x21\xfe\x0fplays only once\x00"
_GIF_END = b";"


def _unreadable(path: str | Path, reason: str) -> DataError:
    reason = " ".join(reason.split()) or "the format is not recognised"
    step = "Check that the file is complete and that its suffix tells its format."
    return DataError(message(str(path), "the image", "be readable", reason.rstrip(".?"), step))


def _reason(source: ModuleType | ImageInput) -> str:
    try:
        return source.geterror()
    except UnicodeDecodeError:  # it quotes names out of the file, and those may be any bytes
        return "its head is damaged"


def _file_name(path: str | Path) -> str:
    """Return a path as OpenImageIO takes it: UTF-8, and whole (it would stop at a NUL and open another file)."""
    name = str(path)
    if "\0" in name or not name.isascii() and any("\ud800" <= letter <= "\udfff" for letter in name):
        raise DataError(message(ascii(name), "the file name", "be valid UTF-8", "it is not", "Rename the file."))
    return name


def _as_stored() -> ImageSpec:
    import OpenImageIO as oiio

    wish = oiio.ImageSpec()
    wish.attribute("oiio:UnassociatedAlpha", 1)  # or colours of PNG and TIFF would come multiplied by their alpha
    return wish


def _check_channels(path: str | Path, names: tuple[str, ...]) -> None:
    """Raise DataError when an EXR has some of R, G and B but not all: the others would move into their places."""
    if len(names) >= 3 and 0 < len({"R", "G", "B"} & set(names)) < 3:
        fact = f"they are {', '.join(map(repr, names))}"
        raise DataError(message(str(path), "channels", "include R, G and B, or none of them", fact, "Save it as RGB."))


def read_image(path: str | Path, by_profile: bool = False) -> np.ndarray:
    """Return the pixels of an image file as [H, W, C] in the type they are stored in, turned as its EXIF orientation says.

    What its channels mean is not asked (`read_picture` does); those that have numbers alone come in their order. uint8, uint16, float16 and float32 come through unchanged,
    anything else as float32. `by_profile` converts colours that have an ICC profile to sRGB (`torchmat.icc.converted`).
    Raises DataError, which names the file, when it cannot be read to its end.
    """
    pixels, spec, profile = _read(path)
    if spec is not None:
        _check_channels(path, spec.channelnames)
        order = numbered_order(spec.channelnames)
        pixels = pixels if order is None else np.ascontiguousarray(pixels[:, :, order])
    return icc.converted(str(path), pixels, profile) if by_profile and profile else pixels


def read_picture(path: str | Path, by_profile: bool = False) -> tuple[np.ndarray, bool]:
    """Return a picture as [H, W, C], grey or three colours and perhaps alpha, and whether the colours are CIE XYZ.

    As `read_image` otherwise. Raises DataError, which names the file, too when it is an EXR of other channels, or of
    several pictures: only one of them would be seen.
    """
    pixels, spec, profile = _read(path)
    if spec is None:
        return icc.converted(str(path), pixels, profile) if by_profile and profile else pixels, False
    parts = spec.getattribute("oiio:subimages") or 1
    if parts > 1:
        step = "Save the one that is meant by itself."
        raise DataError(message(str(path), "the image", "hold one picture", f"it holds {parts} parts", step))
    order, xyz = channel_order(path, spec.channelnames)
    pixels = pixels[:, :, order] if order != list(range(len(order))) else pixels
    return icc.converted(str(path), pixels, profile) if by_profile and profile and not xyz else pixels, xyz


def _read(path: str | Path) -> tuple[np.ndarray, ImageSpec | None, bytes]:
    """Return the pixels of a file, the head of an EXR, whose channels have names of their own, and the ICC profile."""
    import OpenImageIO as oiio

    source = oiio.ImageInput.open(_file_name(path), _as_stored())
    if source is None:
        raise _unreadable(path, _reason(oiio))
    try:
        spec, tags = source.spec() if source.format_name() == "openexr" else None, _tags(source)
        pixels = source.read_image(oiio.UNKNOWN)
        if source.has_error or pixels is None:
            raise _unreadable(path, _reason(source))
    except MemoryError as error:
        spec = source.spec()
        fact = f"{spec.width} x {spec.height} with {spec.nchannels} channels do not fit into memory"
        raise _unreadable(path, fact) from error
    finally:
        source.close()
    if pixels.ndim == 2:
        pixels = pixels[:, :, None]
    pixels = pixels if pixels.dtype.name in _WRITABLE else pixels.astype(np.float32)
    pixels = pixels if tags.orientation == 1 else np.ascontiguousarray(_TURNS[tags.orientation](pixels))
    return pixels, spec, tags.profile


class Tags(NamedTuple):
    """What a picture says of itself: its EXIF `orientation`, 1 (upright) to 8, and its ICC colour `profile`, b"" for none."""

    orientation: int
    profile: bytes


def read_tags(path: str | Path) -> Tags:
    """Return what a picture says of itself; raises DataError, which names the file, when it cannot be opened."""
    import OpenImageIO as oiio

    source = oiio.ImageInput.open(_file_name(path))
    if source is None:
        raise _unreadable(path, _reason(oiio))
    try:
        return _tags(source)
    finally:
        source.close()


class Exif(NamedTuple):
    """What a photograph says of how it was taken: None, or "", for what it does not say.

    `size` is the stored width and height in pixels, `orientation` 1 to 8, `camera` its maker and model, `focal` in mm and `focal_35` in mm of
    a film of 36 x 24, `exposure` in seconds, `aperture` the f-number, `iso` the sensitivity.
    """

    size: tuple[int, int]
    orientation: int
    camera: str
    focal: float | None
    focal_35: float | None
    exposure: float | None
    aperture: float | None
    iso: float | None


def read_exif(path: str | Path) -> Exif:
    """Return what a photograph says of how it was taken; raises DataError, which names the file, when it cannot be opened."""
    import OpenImageIO as oiio

    source = oiio.ImageInput.open(_file_name(path))
    if source is None:
        raise _unreadable(path, _reason(oiio))
    try:
        spec, tags = source.spec(), _tags(source)
        words = [str(spec.get_string_attribute(name)).strip(" \0") for name in ("Make", "Model")]
        names = (("Exif:FocalLength",), ("Exif:FocalLengthIn35mmFilm",), ("ExposureTime",), ("FNumber",), ("Exif:PhotographicSensitivity", "Exif:ISOSpeedRatings"))
        numbers = [max(spec.get_float_attribute(name, 0.0) for name in some) for some in names]
        known = [number if 0 < number < float("inf") else None for number in numbers]
        return Exif((spec.width, spec.height), tags.orientation, " ".join(word for word in words if word), *known)
    finally:
        source.close()


def says_other_colours(path: str | Path) -> bool:
    """Tell whether a photograph's EXIF says that its colours are not sRGB; raises DataError when it cannot be opened."""
    import OpenImageIO as oiio

    source = oiio.ImageInput.open(_file_name(path))
    if source is None:
        raise _unreadable(path, _reason(oiio))
    try:
        return source.spec().get_int_attribute("Exif:ColorSpace", 1) == _UNCALIBRATED
    finally:
        source.close()


def _tags(source: ImageInput) -> Tags:
    spec = source.spec()
    orientation, profile = spec.get_int_attribute("Orientation", 1), spec.getattribute("ICCProfile")
    known = isinstance(profile, np.ndarray) and profile.dtype == np.uint8  # an EXR may call anything so
    return Tags(orientation if orientation in _TURNS else 1, profile.tobytes() if known else b"")


def write_image(
    path: str | Path, pixels: np.ndarray, channel_names: tuple[str, ...] | None = None, quality: int | None = None
) -> None:
    """Write [H, W, C] or [H, W] pixels; the suffix names the format, the array's type the bit depth.

    `quality` is a JPEG's, 1 to 100, which then keeps its colours in full size; None is the format's usual one.

    Written to disk before the function returns; raises DataError, which names the file, when that fails or when the
    format has no such bit depth or number of channels.
    """
    import OpenImageIO as oiio

    if pixels.ndim == 2:
        pixels = pixels[:, :, None]
    if pixels.ndim != 3 or pixels.dtype.name not in _WRITABLE:
        fact = f"it is {pixels.shape} of {pixels.dtype}"
        raise ShapeError(message(str(path), "pixels", f"be [H, W, C] of {', '.join(_WRITABLE)}", fact))
    height, width, channels = pixels.shape
    spec = oiio.ImageSpec(width, height, channels, _WRITABLE[pixels.dtype.name])
    if channel_names:
        spec.channelnames = channel_names
    if Path(path).suffix.lower() in _DATED:
        spec.attribute("DateTime", _NO_DATE)
    if Path(path).suffix.lower() == ".exr":
        spec.attribute("compression", "zip")
    elif quality is not None:
        spec.attribute("compression", f"jpeg:{quality}")
        spec.attribute("jpeg:subsampling", "4:4:4")
    else:
        # Fast deflate: textures are written far more often than they are shipped over slow lines.
        spec.attribute("png:compressionLevel", 3)
        spec.attribute("oiio:UnassociatedAlpha", 1)
    target = oiio.ImageOutput.create(_file_name(path))
    if target is None:
        step = "Use .exr for float, .png for 8 or 16 bits."
        fact = oiio.geterror().rstrip(".")
        raise DataError(message(str(path), "the suffix", "name a writable image format", fact, step))
    _check_space(path, pixels)
    opened = target.open(str(path), spec)
    if opened:
        _refuse_conversion(path, spec, target)
    written = opened and target.write_image(np.ascontiguousarray(pixels))
    closed = target.close()
    if not (written and closed):
        raise _unwritable(path, target.geterror() or oiio.geterror())
    _check_whole(path)


def write_tiled(path: str | Path, pixels: np.ndarray, tile: int) -> None:
    """Write [H, W, C] pixels as an EXR or TIFF in tiles of `tile` x `tile`, with its halves, means of 2 x 2 pixels, down to one.

    Raises DataError, which names the file, when that fails.
    """
    import OpenImageIO as oiio

    height, width, channels = pixels.shape
    spec = oiio.ImageSpec(width, height, channels, _WRITABLE[pixels.dtype.name])
    spec.attribute("DateTime", _NO_DATE)
    picture = oiio.ImageBuf(spec)
    how = oiio.ImageSpec()
    how.tile_width = how.tile_height = tile
    how.attribute("compression", "zip")
    how.attribute("DateTime", _NO_DATE)
    how.attribute("Software", "torchmat")
    how.attribute("maketx:filtername", "box")
    how.attribute("maketx:fixnan", "none")
    how.set_format(_WRITABLE[pixels.dtype.name])
    made = picture.set_pixels(oiio.ROI(0, width, 0, height, 0, 1, 0, channels), pixels)
    made = made and oiio.ImageBufAlgo.make_texture(oiio.MakeTxTexture, picture, _file_name(path), how)
    if not made:
        raise _unwritable(path, picture.geterror() or oiio.geterror())
    _check_whole(path)


def _check_space(path: str | Path, pixels: np.ndarray) -> None:
    """Raise DataError before a JPEG when the disk may not hold it: libjpeg ends the whole process where it is full."""
    folder = Path(path).parent
    if Path(path).suffix.lower() in (".jpg", ".jpeg") and folder.is_dir():
        free, most = shutil.disk_usage(folder).free, _JPEG_SHARE * pixels.nbytes + _JPEG_HEAD
        if free < most:
            raise _unwritable(path, f"{free} bytes are free, and it may take {most}")


def _check_whole(path: str | Path) -> None:
    """Raise DataError, and leave no file, unless the image can be read to its end.

    OpenImageIO says nothing when the disk is full: of a PNG, or of the last bytes of other formats.
    """
    import OpenImageIO as oiio

    source = oiio.ImageInput.open(str(path), _as_stored())
    reason = "" if source is not None else _reason(oiio)
    if source is not None:
        pixels = source.read_image(oiio.UNKNOWN)
        reason = _reason(source) if source.has_error or pixels is None else ""
        source.close()
    if reason:
        Path(path).unlink(missing_ok=True)
        raise _unwritable(path, f"it cannot be read back, as on a full disk: {reason}")


def _refuse_conversion(path: str | Path, wanted: ImageSpec, target: ImageOutput) -> None:
    """Raise DataError, and leave no file, when the format would store other types or channels than it was given."""
    stored = target.spec().format
    channels_kept = wanted.nchannels in (1, 3) or target.supports("alpha")  # JPEG drops the others without a word
    if stored == wanted.format and channels_kept:
        return
    target.close()
    Path(path).unlink(missing_ok=True)
    requirement = f"name a format for {wanted.nchannels} channels of {wanted.format}"
    fact = f"it has {stored}" if channels_kept else "it has no alpha"
    step = "Use .exr for float, .png for 8 or 16 bits."
    raise DataError(message(str(path), "the suffix", requirement, fact, step))


def write_frames(path: str | Path, frames: Iterable[np.ndarray], seconds: float = 0.1, loop: bool = True) -> int:
    """Write frames [H, W, 3], uint8, as one animated file, each as it comes; return how many there were.

    The suffix decides: .png or .apng keeps every colour (APNG: the frames as OpenImageIO writes them, chained as the
    PNG standard's third edition says), .gif has 255 colours a frame, dithered. Each frame stands for `seconds`, 0.02 to
    600, rounded to hundredths; `loop` False plays once. Raises ShapeError when a frame has another size than the first,
    RangeError when there is none, DataError when the file cannot be written. The file appears when its last frame is
    written; one that was there before stays until then.
    """
    where, suffix = str(path), Path(path).suffix.lower()
    if suffix not in MOVING_SUFFIXES:
        requirement = f"be one of {', '.join(sorted(MOVING_SUFFIXES))}"
        step = "Write .png, which keeps every colour; other programs turn it into a film."
        raise DataError(message(where, "the suffix of moving pictures", requirement, f"it is {suffix!r}", step))
    if not 0.02 <= seconds <= 600:
        step = "Viewers show shorter frames more slowly than they say."
        raise RangeError(message(where, "the seconds per frame", "lie in [0.02, 600]", f"they are {seconds}", step))
    write = _write_gif if suffix == ".gif" else _write_apng
    with atomic.building_file(_file_name(path)) as built:
        count = write(where, built, _alike(where, frames), round(seconds * 100), loop)
        if not count:
            step = "Give the pictures to show."
            raise RangeError(message(where, "frames", "be at least one", "there is none", step))
    return count


def _unwritable(path: str | Path, reason: str) -> DataError:
    reason = " ".join(reason.split()) or "writing failed"
    step = "Check that the folder exists, can be written to, and that the disk is not full."
    return DataError(message(str(path), "the image", "be writable", reason.rstrip("."), step))


def _alike(where: str, frames: Iterable[np.ndarray]) -> Iterator[np.ndarray]:
    """Pass frames on, each checked as it comes: [H, W, 3] of uint8, all of the first one's size."""
    shape = None
    for number, frame in enumerate(frames):
        if frame.ndim != 3 or frame.shape[2] != 3 or 0 in frame.shape or frame.dtype != np.uint8:
            fact = f"frame {number} is {frame.shape} of {frame.dtype}"
            raise ShapeError(message(where, "frames", "be [H, W, 3] of uint8", fact))
        shape = shape or frame.shape
        if frame.shape != shape:
            fact = f"frame {number} is {frame.shape[:2]} and frame 0 is {shape[:2]}"
            raise ShapeError(message(where, "frames", "have one size", fact, "Render all with the same camera size."))
        yield np.ascontiguousarray(frame)


def _write_gif(where: str, path: Path, frames: Iterator[np.ndarray], hundredths: int, loop: bool) -> int:
    import OpenImageIO as oiio

    count, target = 0, oiio.ImageOutput.create(str(path))
    if target is None:
        raise _unwritable(where, oiio.geterror())
    for frame in frames:
        spec = oiio.ImageSpec(frame.shape[1], frame.shape[0], 3, "uint8")
        # The writer truncates 100 / rate to whole hundredths; half a hundredth more keeps it on the right side.
        spec.attribute("FramesPerSecond", 100 / (hundredths + 0.5))
        opened = target.open(str(path), spec, "AppendSubimage" if count else "Create")
        if not (opened and target.write_image(frame)):
            reason = target.geterror() or oiio.geterror()
            target.close()
            raise _unwritable(where, reason)
        count += 1
    target.close()
    if count:
        _check_gif(where, path, count, loop)
    return count


def _check_gif(where: str, path: Path, count: int, loop: bool) -> None:
    """Raise DataError unless all frames are on the disk: the writer goes on in silence when the disk is full."""
    import OpenImageIO as oiio

    source = oiio.ImageInput.open(str(path))
    whole = source is not None and source.seek_subimage(count - 1, 0) and source.read_image(oiio.UINT8) is not None
    reason = "" if whole or source is None else source.geterror()
    if source is not None:
        source.close()
    with open(path, "rb+") as stream:
        head = stream.read(64)
        stream.seek(-1, 2)
        if not whole or stream.read() != _GIF_END:
            raise _unwritable(where, reason or "the file ends early")
        if not loop and _GIF_LOOP in head:
            stream.seek(head.index(_GIF_LOOP))
            stream.write(_GIF_COMMENT)


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def _chunks(png: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Yield (kind, data) of each chunk of a PNG file."""
    place = len(_PNG_SIGNATURE)
    while place < len(png):
        (length,) = struct.unpack_from(">I", png, place)
        yield png[place + 4 : place + 8], png[place + 8 : place + 8 + length]
        place += length + 12


def _write_apng(where: str, path: Path, frames: Iterator[np.ndarray], hundredths: int, loop: bool) -> int:
    """Write an animated PNG: the first frame is one that any program reads, the others follow in other chunks."""
    count, sequence, still = 0, 0, path.with_name("still.png")
    with open(path, "wb") as stream:
        for frame in frames:
            try:
                write_image(still, frame)
            except DataError as error:
                raise _unwritable(where, str(error)) from error
            chunks = list(_chunks(still.read_bytes()))
            if not count:
                head = stream.write(_PNG_SIGNATURE + _chunk(*chunks[0]))
                stream.write(_chunk(b"acTL", bytes(8)))  # how many frames there are is known at the end
                described = [chunk for chunk in chunks[1:] if chunk[0] in (b"sRGB", b"gAMA", b"cHRM")]
                stream.write(b"".join(_chunk(*chunk) for chunk in described))
            sequence = _write_apng_frame(stream, frame, chunks, sequence, hundredths)
            count += 1
        if count:
            stream.write(_chunk(b"IEND", b""))
            stream.seek(head)
            stream.write(_chunk(b"acTL", struct.pack(">II", count, 0 if loop else 1)))
    return count


def _write_apng_frame(
    stream: BinaryIO, frame: np.ndarray, chunks: list[tuple[bytes, bytes]], sequence: int, hundredths: int
) -> int:
    """Write one frame's control chunk and pixels; return the number of the next chunk in the sequence."""
    height, width = frame.shape[:2]
    # Placed at the corner, left there for the next frame, and put over whatever was there before.
    control = struct.pack(">IIIIIHHBB", sequence, width, height, 0, 0, hundredths, 100, 0, 0)
    first = sequence == 0
    stream.write(_chunk(b"fcTL", control))
    sequence += 1
    pixels = b"".join(data for kind, data in chunks if kind == b"IDAT")
    if first:
        stream.write(_chunk(b"IDAT", pixels))
        return sequence
    stream.write(_chunk(b"fdAT", struct.pack(">I", sequence) + pixels))
    return sequence + 1
