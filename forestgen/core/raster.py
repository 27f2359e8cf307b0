"""One number a pixel, from a picture or an array on disk: PNG, TIFF, OpenEXR, NumPy's .npy.

Files come from strangers: a file's size is known and bounded before its pixels are read, and whatever is wrong with it
is an `AssetError` without a place, which the caller adds.
"""

from __future__ import annotations

import re
import struct
import tokenize
import warnings
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.errors import AssetError, ResourceError
from forestgen.core.spectrum import LUMINANCE

if TYPE_CHECKING:
    from PIL.Image import Image

_MOST_SIDE_PX, _MOST_PIXELS = 16_384, 100_000_000
_MOST = f"at most {_MOST_SIDE_PX:,} pixels a side and {_MOST_PIXELS // 10**6} million in all"
_KNOWN = "a PNG, TIFF, OpenEXR or .npy file"
_ROWS_AT_ONCE = 256
_TIFF_SAMPLE_FORMAT, _TIFF_BITS, _TIFF_PHOTOMETRIC = 339, 258, 262
_SHARE_OF_MEMORY = 0.8
_BROKEN: tuple[type[Exception], ...] = (
    OSError, ValueError, SyntaxError, TypeError, KeyError, IndexError, EOFError, OverflowError, RuntimeError,
    MemoryError, struct.error, zlib.error, tokenize.TokenError,  # TokenError: of an .npy file's header
)  # fmt: skip
_KINDS = {
    b"\x89PNG\r\n\x1a\n": "png",
    b"II*\0": "tif",
    b"MM\0*": "tif",
    b"II+\0": "tif",
    b"MM\0+": "tif",
    b"\x76\x2f\x31\x01": "exr",
    b"\x93NUMPY": "npy",
}
_OTHERS = {
    b"\xff\xd8\xff": "a JPEG picture",
    b"GIF8": "a GIF picture",
    b"BM": "a BMP picture",
    b"RIFF": "a WebP picture, or another RIFF file",
    b"PK\x03\x04": "a ZIP archive, such as .npz",
    b"#?RADIANCE": "a Radiance HDR picture",
    b"%PDF": "a PDF document",
}


@dataclass(frozen=True, eq=False)
class SingleChannelRaster:
    """A picture's values as they are stored."""

    values: NDArray[Any]  # (rows, cols) real, row 0 at the top; read-only
    white: float  # what a stored value is divided by: an integer picture's largest possible, else 1

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, SingleChannelRaster):
            return NotImplemented
        return self is other or (self.white == other.white and np.array_equal(self.values, other.values))

    __hash__ = None  # type: ignore[assignment]

    @cached_property
    def lowest(self) -> float:
        """Smallest value, over `white`; NaN if there is one."""
        return float(self.values.min()) / self.white

    @cached_property
    def highest(self) -> float:
        """Largest value, over `white`; NaN if there is one."""
        return float(self.values.max()) / self.white


def kind_of(path: Path) -> str:
    """The format by the file's first bytes: "png", "tif", "exr" or "npy"; any other one raises `AssetError`."""
    try:
        with path.open("rb") as stream:
            head = stream.read(16)
    except OSError as cause:
        raise AssetError("the file cannot be read", expected=_KNOWN, got=cause.strerror) from cause
    for magic, kind in _KINDS.items():
        if head.startswith(magic):
            return kind
    got = next((name for magic, name in _OTHERS.items() if head.startswith(magic)), "a file of another kind")
    hint = "save it as PNG, which changes no value" if "picture" in got else None
    got = got if head else "an empty file"
    raise AssetError("this is no picture that can be read", expected=_KNOWN, got=got, hint=hint)


def read_raster(path: Path) -> SingleChannelRaster:
    """One number a pixel.

    Grey is read as it is, at its full depth; colour as the luminance of the stored values, without any gamma. What is
    transparent counts as black, by its degree. White is 1 in an integer picture; floating point values and the numbers
    of an .npy file are kept. Pictures of 16 bits a channel in colour are read at 8.

    Raises
    ------
    AssetError : no such picture; several pages or frames; broken; too large.
    ResourceError : the free memory does not hold it.
    """
    kind = kind_of(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # on odd metadata, and on sizes that are checked here
            picture = _READERS[kind](path)
    except _BROKEN as cause:
        problem = "the picture cannot be read: it is damaged, cut off, or of a rare kind"
        got = (str(cause).replace(repr(str(path)), "this").splitlines() or [type(cause).__name__])[0][:120]
        hint = None if kind == "npy" else "save it again, as a PNG of grey values"
        raise AssetError(problem, expected=f"a whole {_NAMES[kind]} file", got=got, hint=hint) from cause
    picture.values.setflags(write=False)
    return picture


def _check_size(width: int, height: int, bytes_per_pixel: int) -> None:
    if max(width, height) > _MOST_SIDE_PX or width * height > _MOST_PIXELS:
        raise AssetError("the picture is too large", expected=_MOST, got=f"{width:,} x {height:,} pixels")
    if min(width, height) < 1:
        raise AssetError("the picture has no pixels", expected="one at least", got=f"{width} x {height} pixels")
    from forestgen.core.processes import free_bytes

    need, free = width * height * bytes_per_pixel, int(free_bytes() * _SHARE_OF_MEMORY)
    if need > free:
        problem, hint = "too little free memory for this picture", "make the picture smaller, or close other programs"
        raise ResourceError(problem, expected=f"{need / 1e6:,.0f} MB", got=f"{free / 1e6:,.0f} MB", hint=hint)


def _read_picture(path: Path) -> SingleChannelRaster:
    """A PNG or TIFF."""
    from PIL import Image

    try:
        image = Image.open(path, formats=("PNG", "TIFF"))
    except Image.DecompressionBombError as cause:
        count = re.search(r"\d+", str(cause))
        got = f"{int(count[0]):,} pixels" if count else str(cause)
        raise AssetError("the picture is too large", expected=_MOST, got=got) from cause
    with image:
        _check_size(*image.size, 12)
        try:
            image.seek(1)
        except EOFError:
            image.seek(0)
        else:
            raise AssetError("the picture has several pages or frames", expected="a single picture")
        image.load()
        return _grey(image)


def _grey(image: Image) -> SingleChannelRaster:
    mode, clear = image.mode, image.info.get("transparency")
    is_signed = _tag(image, _TIFF_SAMPLE_FORMAT, 1) == 2
    if mode == "1" or (mode == "L" and clear is None and not is_signed):
        return SingleChannelRaster(np.array(image.convert("L")), 255.0)
    if mode == "L" and clear is None:
        return SingleChannelRaster(np.array(image).view(np.int8), 127.0)
    if mode.startswith("I;16"):
        values = np.array(image).astype(np.uint16)
        if _tag(image, _TIFF_PHOTOMETRIC, 1) == 0:
            values = 65535 - values  # white is 0 in such a TIFF; what has 8 bits arrives turned round
        if isinstance(clear, int):
            values[values == clear] = 0
        return SingleChannelRaster(values, 65535.0)
    if mode == "I":  # 32-bit numbers, which Pillow takes for signed ones; and 16-bit ones that it widens
        values, bits = np.array(image).astype(np.int32), _tag(image, _TIFF_BITS, 16)
        if is_signed:
            return SingleChannelRaster(values, float(2 ** (bits - 1) - 1))
        return SingleChannelRaster(values.view(np.uint32), float(2**bits - 1))
    if mode == "F":
        return SingleChannelRaster(np.array(image), 1.0)
    if mode in ("L", "LA"):
        return SingleChannelRaster(_mixed(np.asarray(image.convert("LA")), (1.0,)), 1.0)
    if mode in ("P", "PA", "RGB", "RGBA", "RGBX"):
        return SingleChannelRaster(_mixed(np.asarray(image.convert("RGBA")), LUMINANCE), 1.0)
    problem, hint = "pictures of this colour space have no density", "save it as a PNG of grey values"
    raise AssetError(problem, expected="grey values, a palette, or red, green and blue", got=mode, hint=hint)


def _tag(image: Image, number: int, default: int) -> int:
    """A TIFF's first value of a tag."""
    value = getattr(image, "tag_v2", {}).get(number, default)
    return int(value[0] if isinstance(value, tuple) else value)


def _mixed(channels: NDArray[np.uint8], weights: tuple[float, ...]) -> NDArray[np.float32]:
    """(rows, cols) in 0..1: the weighted channels, times the last one, opacity."""
    mixed = np.empty(channels.shape[:2], dtype=np.float32)
    for start in range(0, len(mixed), _ROWS_AT_ONCE):
        rows = slice(start, start + _ROWS_AT_ONCE)
        block = channels[rows].astype(np.float64)
        mixed[rows] = block[..., :-1] @ np.array(weights) * block[..., -1] / 255.0**2
    return np.minimum(mixed, np.float32(1.0))


def _read_npy(path: Path) -> SingleChannelRaster:
    """Real numbers in two dimensions; whatever their type they are kept, as those of rows in a recipe are."""
    with path.open("rb") as stream:
        version = np.lib.format.read_magic(stream)
        read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = read_header(stream)
        begin = stream.tell()
    if len(shape) != 2 or dtype.kind not in "fiub" or dtype.itemsize > 8:
        expected = "real numbers of at most 64 bits in two dimensions, rows from north to south"
        raise AssetError("this array is no map", expected=expected, got=f"{dtype} of shape {shape}")
    _check_size(shape[1], shape[0], 2 * dtype.itemsize)
    if path.stat().st_size < begin + shape[0] * shape[1] * dtype.itemsize:
        raise ValueError("fewer values than its header says")
    values = np.load(path, allow_pickle=False)
    values = values.astype(np.uint8) if dtype.kind == "b" else values.astype(dtype.newbyteorder("="))
    return SingleChannelRaster(values, 1.0)


def _read_exr(path: Path) -> SingleChannelRaster:
    """The only channel, or Y, or the luminance of R, G, B; light that a pixel does not cover is black there already."""
    import OpenEXR

    parts = OpenEXR.File(str(path), separate_channels=True, header_only=True).parts
    header = parts[0].header
    (left, top), (right, bottom) = (tuple(int(one) for one in corner) for corner in header["dataWindow"])
    width, height = right - left + 1, bottom - top + 1
    _check_size(width, height, 24)
    if len(parts) > 1 or header["type"] not in (OpenEXR.scanlineimage, OpenEXR.tiledimage):
        kinds = f"{len(parts)} parts" if len(parts) > 1 else "deep pixels"
        raise AssetError("this OpenEXR file holds more than a plain picture", expected="a single picture", got=kinds)
    if any(np.any(a != b) for a, b in zip(header["dataWindow"], header["displayWindow"], strict=True)):
        raise AssetError("the picture is cropped", expected="a data window equal to the display window")
    # Its File would print what is wrong with pixels and go on; InputFile raises, and reads the wanted channels only.
    stream = OpenEXR.InputFile(str(path))
    try:
        return SingleChannelRaster(_channels(stream, (height, width)), 1.0)
    finally:
        stream.close()


def _channels(stream: Any, shape: tuple[int, int]) -> NDArray[Any]:
    channels = stream.header()["channels"]
    names = list(channels)
    wanted = names if len(names) == 1 else ["Y"] if "Y" in names else ["R", "G", "B"]
    if not set(wanted) <= set(names):
        expected = "a single channel, or Y, or R, G and B"
        raise AssetError("which channel is the map?", expected=expected, got=", ".join(names)[:80])
    found = []
    for name in wanted:
        one = channels[name]
        if str(one.type) not in _EXR_TYPES or (one.xSampling, one.ySampling) != (1, 1):
            expected = "half or float values, one for each pixel"
            raise AssetError(f"the channel {name} is no map", expected=expected, got=str(one))
        found.append(np.frombuffer(stream.channel(name), dtype=_EXR_TYPES[str(one.type)]).reshape(shape))
    if len(found) == 1:
        return found[0].astype(np.float32)
    mixed = np.zeros(shape, dtype=np.float32)
    for weight, one in zip(LUMINANCE, found, strict=True):
        mixed += np.float32(weight) * one
    return mixed


_EXR_TYPES = {"HALF": np.float16, "FLOAT": np.float32}
_NAMES = {"png": "PNG", "tif": "TIFF", "exr": "OpenEXR", "npy": ".npy"}
_READERS: dict[str, Callable[[Path], SingleChannelRaster]] = {
    "png": _read_picture,
    "tif": _read_picture,
    "exr": _read_exr,
    "npy": _read_npy,
}
