"""The PNG files of a frame (preview, overlay, masks, grey pictures; no dates in them), its thumbnail, and classes.json.

thumbnails/FRAME.jpg are small pictures of the frames, for pages and for people. classes.json says what the numbers in
masks and annotations mean:

| key | what it is |
|---|---|
| `semantic` | class number -> name, of semantic.png and of the channels `semantic` |
| `semantic_colours` | class number -> red, green, blue of semantic.png's palette |
| `part` | number -> name, of the channels `part` |
| `categories` | category_id -> name, as in coco.json; panoptic.json adds ground and sky; YOLO counts from 0 |

semantic.png holds `semantic` as JSON in its text `classes`; frame.exr holds `semantic` and `part` in its attributes
``forestgen/classes`` and ``forestgen/parts``.
"""

from __future__ import annotations

import io
import json
import struct
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.errors import DatasetError, OutputError
from forestgen.core.parts import Part
from forestgen.dataset.files import make_folder, write_bytes
from forestgen.dataset.safe_path import SafePath, read_object
from forestgen.dataset.settings import DatasetSettings

if TYPE_CHECKING:
    from PIL.Image import Image

LEGEND_NAME, THUMBNAILS = "classes.json", "thumbnails"
LONG_SIDE_PX, _QUALITY = 256, 85  # of thumbnails
_COMPRESS_LEVEL = 4
MAX_PNG_ID = (1 << 24) - 1
_PALETTE_COLOURS = 256  # those without a class are black
_TINT = 0.42  # share of a plant's own colour inside its mask
_SKY_RGB, _GROUND_RGB = (110, 160, 220), (122, 96, 70)


def write_instance(path: Path, instance: NDArray[np.uint32]) -> None:
    """Write plant ids as colours, id = R + 256 G + 65536 B, as COCO panoptic does; others raise `OutputError`."""
    largest = int(instance.max(initial=0))
    if largest > MAX_PNG_ID:
        problem = "a plant_id does not fit the 24 bits of an instance PNG"
        hint = "ids count all plants that ever lived: make the site smaller, or stop after fewer steps"
        raise OutputError(problem, where=str(path), expected=f"ids up to {MAX_PNG_ID}", got=str(largest), hint=hint)
    write_png(path, np.stack([(instance >> shift) & 0xFF for shift in (0, 8, 16)], axis=-1).astype(np.uint8))


def semantic_of(content: bytes, size_px: tuple[int, int]) -> NDArray[np.uint8]:
    """(H, W) uint8 classes of a semantic PNG's bytes; see `rgb_of`."""
    with _opened(content, size_px) as image:
        if image.mode not in ("P", "L"):
            raise ValueError(f"the picture has no classes, but pixels of the kind {image.mode}")
        return np.array(image, dtype=np.uint8)


def instance_of(content: bytes, size_px: tuple[int, int]) -> NDArray[np.uint32]:
    """(H, W) uint32 plant ids of an instance PNG's bytes; see `rgb_of`."""
    rgb = rgb_of(content, size_px).astype(np.uint32)
    return np.asarray(rgb[..., 0] | (rgb[..., 1] << 8) | (rgb[..., 2] << 16), dtype=np.uint32)


def rgb_of(content: bytes, size_px: tuple[int, int]) -> NDArray[np.uint8]:
    """(H, W, 3) uint8 of a PNG's bytes; one of another size than `size_px` is refused before a pixel is unpacked.

    What is no PNG, of another size or damaged raises ValueError, OSError or SyntaxError.
    """
    with _opened(content, size_px) as image:
        return np.asarray(image.convert("RGB"))


def _opened(content: bytes, size_px: tuple[int, int]) -> Image:
    from PIL.PngImagePlugin import PngImageFile

    if content[:8] != b"\x89PNG\r\n\x1a\n" or content[12:16] != b"IHDR" or len(content) < 24:
        raise ValueError("this is no PNG")
    width, height = struct.unpack(">II", content[16:24])
    if (width, height) != size_px:
        raise ValueError(f"the picture has {width} x {height} pixels, and its frame {size_px[0]} x {size_px[1]}")
    try:
        # `PIL.Image.open` would refuse large pictures whose size is known to be right.
        image = PngImageFile(io.BytesIO(content))
        image.load()
    except (struct.error, zlib.error, IndexError, KeyError, TypeError, EOFError, OverflowError) as error:
        raise ValueError(f"the picture is damaged: {error}") from error
    return image


def write_semantic(path: Path, semantic: NDArray[np.uint8], class_names: Sequence[str]) -> None:
    """Write (H, W) uint8 classes as a palette PNG of 8 bits a pixel: values are class numbers, in `class_palette`.

    The text chunk `classes` holds the names as JSON, number -> name.
    """
    # Pillow packs a short palette's pixels into 1, 2 or 4 bits, which some readers do not unpack (torchvision 0.29).
    palette = np.zeros((_PALETTE_COLOURS, 3), dtype=np.uint8)
    palette[: len(class_names)] = class_palette(len(class_names))
    write_png(path, semantic, {"classes": classes_text(class_names)}, palette=palette)


def class_palette(classes: int) -> NDArray[np.uint8]:
    """(classes, 3) uint8 sRGB: sky blue, ground brown, then a colour a species, far apart in hue."""
    species = np.arange(max(0, classes - 2))
    hue = (0.28 + species * 0.61803398875) % 1.0
    colours = _rgb_from_hsv(hue, 0.75 - 0.15 * (species % 3), 0.95 - 0.2 * (species % 2))
    return np.concatenate([np.array([_SKY_RGB, _GROUND_RGB], dtype=np.uint8), colours])[:classes]


def plant_colours(plant_id: NDArray[np.uint32]) -> NDArray[np.uint8]:
    """(..., 3) uint8 colour of each id: the same in every image, distinct for neighbouring ids."""
    mixed = plant_id.astype(np.uint32) * np.uint32(2654435769)  # 2^32 / golden ratio: equidistributed hues
    hue = mixed.astype(np.float64) / 2.0**32
    return _rgb_from_hsv(hue, 0.6 + 0.1 * (plant_id % 4), 1.0 - 0.12 * ((plant_id >> 2) % 3))


def overlay(preview: NDArray[np.uint8], instance: NDArray[np.uint32]) -> NDArray[np.uint8]:
    """(H, W, 3) uint8: the preview with each plant tinted in its colour and thinly outlined."""
    ids, index = np.unique(instance, return_inverse=True)
    colour = plant_colours(ids)[index.reshape(instance.shape)].astype(np.float32)
    tinted = preview * np.float32(1.0 - _TINT) + colour * np.float32(_TINT)
    edge = _outline(instance)
    tinted[edge] = colour[edge]
    return np.where((instance != 0)[..., None], np.rint(tinted), preview).astype(np.uint8)


def _outline(instance: NDArray[np.uint32]) -> NDArray[np.bool_]:
    """Pixels whose right or lower neighbour, or for plants against no plant any neighbour, is another's."""
    edge = np.zeros(instance.shape, dtype=bool)
    for ids, found in ((instance, edge), (instance.T, edge.T)):
        differs = ids[:-1] != ids[1:]
        found[:-1] |= differs & (ids[:-1] != 0)
        found[1:] |= differs & (ids[:-1] == 0)
    return edge


def _rgb_from_hsv(
    hue: NDArray[np.floating], saturation: NDArray[np.floating], value: NDArray[np.floating]
) -> NDArray[np.uint8]:
    phase = (hue[..., None] * 6.0 + np.array([5.0, 3.0, 1.0])) % 6.0
    drop = np.minimum(phase, 4.0 - phase).clip(0.0, 1.0)
    rgb = value[..., None] * (1.0 - saturation[..., None] * drop)
    return np.asarray(np.rint(rgb * 255.0), dtype=np.uint8)


def write_png(
    path: Path,
    pixels: NDArray[np.unsignedinteger[Any]],
    text: Mapping[str, str] | None = None,
    *,
    palette: NDArray[np.uint8] | None = None,
    compress_level: int = _COMPRESS_LEVEL,
) -> None:
    """Write (H, W, 3) uint8, or (H, W) grey of 8 or 16 bits or indices of a palette; `text` goes into text chunks."""
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    image = Image.fromarray(np.ascontiguousarray(pixels))
    if palette is not None:
        image.putpalette(palette.tobytes())
    chunks = PngInfo()
    for key, value in (text or {}).items():
        chunks.add_text(key, value)
    buffer = io.BytesIO()
    image.save(buffer, format="PNG", compress_level=compress_level, pnginfo=chunks)
    write_bytes(path, buffer.getvalue())


def write_legend(root: Path, settings: DatasetSettings) -> None:
    """Write classes.json into the data set's folder."""
    palette = class_palette(len(settings.class_names))
    legend = {
        "semantic": _numbered(settings.class_names),
        "semantic_colours": {str(i): colour for i, colour in enumerate(palette.tolist())},
        "part": _numbered(_part_names()),
        "categories": {str(i): name for i, name in enumerate(settings.category_names, start=1)},
    }
    lines = ",\n".join(f" {json.dumps(key)}: {json.dumps(names)}" for key, names in legend.items())
    write_bytes(root / LEGEND_NAME, f"{{\n{lines}\n}}\n".encode())


def read_legend(split: SafePath) -> dict[str, Any]:
    """classes.json of a split's folder; `semantic` counts from 0 and `categories` from 1, and both have names.

    A file that is missing, damaged, or of another form raises `DatasetError`.
    """
    path = split / LEGEND_NAME
    content = read_object(path)
    for key, first in (("semantic", 0), ("categories", 1)):
        named = content.get(key)
        numbers = [str(number) for number in range(first, first + len(named))] if isinstance(named, dict) else []
        if not isinstance(named, dict) or not all(isinstance(named.get(one), str) for one in numbers):
            expected = f"{key}: a name for each number, from {first} on"
            raise DatasetError("a file is not what its name says", where=str(path), expected=expected)
    return content


def classes_text(class_names: Sequence[str]) -> str:
    """Class number -> name, as JSON on one line."""
    return json.dumps(_numbered(class_names))


def parts_text() -> str:
    """Part number -> name, as JSON on one line."""
    return json.dumps(_numbered(_part_names()))


def _part_names() -> list[str]:
    return [part.name.lower() for part in Part]


def _numbered(names: Sequence[str]) -> dict[str, str]:
    return {str(number): name for number, name in enumerate(names)}


def thumbnail_name(frame: str) -> str:
    """Path of a frame's thumbnail below the data set's folder."""
    return f"{THUMBNAILS}/{frame}.jpg"


def write_thumbnail(frame_folder: Path, target: Path) -> None:
    """Write a frame's preview.png, at most `LONG_SIDE_PX` long and never enlarged, as JPEG without a date.

    The target's folder is made if it is missing. Without a preview to read it raises `OutputError`.
    """
    from PIL import Image

    source = frame_folder / "preview.png"
    buffer = io.BytesIO()
    try:
        with Image.open(source) as image:
            picture = image.convert("RGB")
            picture.thumbnail((LONG_SIDE_PX, LONG_SIDE_PX), Image.Resampling.LANCZOS, reducing_gap=None)
            picture.save(buffer, "JPEG", quality=_QUALITY, optimize=True)
    except (OSError, ValueError, SyntaxError) as error:  # Pillow's for files that are cut short
        raise OutputError("the preview cannot be read", where=str(source), got=str(error)) from error
    make_folder(target.parent)
    write_bytes(target, buffer.getvalue())
