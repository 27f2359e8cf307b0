"""A sample of the frames, spread over splits, seasons, skies, suns and cameras, as small pictures inside the page."""

from __future__ import annotations

import base64
import io
import math
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from forestgen.dataset.png import thumbnail_name
from forestgen.dataset.report.charts import percent
from forestgen.dataset.report.frames import Frames
from forestgen.dataset.safe_path import SafePath

if TYPE_CHECKING:
    from PIL.Image import Image

T = TypeVar("T")
MOST_FRAMES = 60
SHOWN_AT_ONCE = 24  # the others behind "more"
BUDGET_BYTES = 3_200_000  # of all pictures; base64 makes a third more of it
LONG_SIDE_PX, _LEAST_SIDE_PX = 640, 32
_NEAREST, _LANCZOS = 0, 1  # Pillow's numbers
_ELEVATION_STEP_DEG = 20.0
_MOST_CLASSES = 6  # in a frame's caption


@dataclass(frozen=True)
class Picture:
    """A view of a frame."""

    kind: str  # picture, plants or classes
    alt: str
    uri: str


@dataclass(frozen=True)
class GalleryItem:
    """A frame in the gallery."""

    frame: str
    split: str
    caption: str  # sun, sky, camera
    content: str  # largest classes, with their shares
    pictures: tuple[Picture, ...]


def choose(frames: Frames, splits: Sequence[str], most: int = MOST_FRAMES) -> list[int]:
    """Rows to show: turn by turn one of each split, and within a split one of each stratum."""
    elevation = frames.numbers("sun_elevation_deg") // _ELEVATION_STEP_DEG
    strata = zip(*(frames.texts(name) for name in ("season", "clouds", "camera")), elevation, strict=True)
    by_split: dict[str, dict[str, list[int]]] = {}  # split -> stratum -> rows
    for row, (split, stratum) in enumerate(zip(frames.split, strata, strict=True)):
        by_split.setdefault(split, {}).setdefault(repr(stratum), []).append(row)
    queues = [
        _in_turns(_spread(by_split[split][name]) for name in _spread(sorted(by_split[split])))
        for split in splits
        if split in by_split
    ]
    return _in_turns(queues)[:most]


def _in_turns(queues: Iterable[list[int]]) -> list[int]:
    """The queues' first ones, their second ones, and so on."""
    turns = zip_longest(*queues)
    return [row for turn in turns for row in turn if row is not None]


def _spread(things: Sequence[T]) -> list[T]:
    """At most `MOST_FRAMES` of them, at equal distances, so ordered that each lies far from those before it."""
    at = np.unique(np.linspace(0, len(things) - 1, MOST_FRAMES).round().astype(int))
    order = sorted(range(len(at)), key=lambda k: f"{k:b}"[::-1])
    return [things[at[k]] for k in order]


def gallery(folder: Path, frames: Frames, splits: Sequence[str]) -> list[GalleryItem]:
    """The chosen frames with their pictures; a frame none of whose pictures can be read is shown without."""
    rows = choose(frames, splits)
    quota = BUDGET_BYTES // max(1, 3 * len(rows))
    names = ("frame", "folder", "season", "clouds", "camera")
    columns = list(zip(*(frames.texts(name) for name in names), strict=True))
    sun, plants = frames.numbers("sun_elevation_deg"), frames.numbers("plants_in_view")
    pixels = frames.counts("class_pixels")
    items = []
    for row in rows:
        (name, path, season, clouds, camera), split = columns[row], frames.split[row]
        caption = _caption(season, clouds, camera, float(sun[row]), float(plants[row]))
        pictures = _pictures(folder, path or f"{split}/{name}", name, quota)
        counts = pixels[row] or {}
        largest = sorted(counts.items(), key=lambda one: (-one[1], one[0]))[:_MOST_CLASSES]
        content = ", ".join(f"{one} {percent(count / sum(counts.values()))}" for one, count in largest if count)
        items.append(GalleryItem(name, split, caption, content, pictures))
    return items


def _caption(season: str, clouds: str, camera: str, sun_elevation_deg: float, plants: float) -> str:
    words = [
        f"camera {camera}" if camera else "",
        season,
        f"sun at {sun_elevation_deg:.0f}°" if np.isfinite(sun_elevation_deg) else "",
        {"": "", "none": "no clouds"}.get(clouds, f"clouds: {clouds}"),
        ("1 plant" if plants == 1 else f"{plants:,.0f} plants") if np.isfinite(plants) else "",
    ]
    return ", ".join(filter(None, words))


def _pictures(root: Path, folder: str, frame: str, quota: int) -> tuple[Picture, ...]:
    """Picture, overlay and semantic mask of a frame: those that can be read."""
    wanted: tuple[tuple[str, str, tuple[str, ...], Callable[[Image, int], bytes]], ...] = (
        ("picture", f"Rendered picture of {frame}", (f"{folder}/preview.png", thumbnail_name(frame)), _photo),
        ("plants", f"{frame} with each plant tinted in its own colour", (f"{folder}/overlay.png",), _photo),
        ("classes", f"Semantic mask of {frame}", (f"{folder}/semantic.png",), _mask),
    )
    found = []
    for kind, alt, paths, encode in wanted:
        content = next(filter(None, (_encoded(root, path, encode, quota) for path in paths)), None)
        if content is not None:
            found.append(Picture(kind, alt, f"data:image/webp;base64,{base64.b64encode(content).decode()}"))
    return tuple(found)


def _encoded(root: Path, path: str, encode: Callable[[Image, int], bytes], quota: int) -> bytes | None:
    """A picture file made small; None if it is not there, lies outside the data set, or is no picture."""
    from PIL import Image

    try:
        with (
            warnings.catch_warnings(action="error"),
            SafePath(root, path).open() as stream,
            Image.open(stream, formats=("PNG", "JPEG")) as image,
        ):
            return encode(image.convert("RGB"), quota)
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError, Warning):
        return None


def _photo(image: Image, quota: int) -> bytes:
    """WebP of at most `quota` bytes: less quality first, then fewer pixels."""
    content = _webp(image, LONG_SIDE_PX, _LANCZOS, quality=80, method=4)
    if len(content) <= quota:
        return content
    return _fitting(image, quota, lambda side_px: _webp(image, side_px, _LANCZOS, quality=60, method=4))


def _mask(image: Image, quota: int) -> bytes:
    """Lossless WebP of at most `quota` bytes, pixels picked and never mixed: every colour is a class's."""
    settings = {"lossless": True, "quality": 40, "method": 3}
    return _fitting(image, quota, lambda side_px: _webp(image, side_px, _NEAREST, **settings))


def _fitting(image: Image, quota: int, encode: Callable[[int], bytes]) -> bytes:
    """The picture at the largest side that keeps within `quota` bytes, about."""
    side_px = min(LONG_SIDE_PX, max(image.size))
    content = encode(side_px)
    while len(content) > quota and side_px > _LEAST_SIDE_PX:
        side_px = int(side_px * min(0.9, max(0.5, 0.95 * math.sqrt(quota / len(content)))))
        content = encode(side_px)
    return content


def _webp(image: Image, long_side_px: int, resample: int, **settings: int | bool) -> bytes:
    """WebP, at most so long and never enlarged."""
    factor = min(1.0, long_side_px / max(image.size))
    size = max(1, round(image.width * factor)), max(1, round(image.height * factor))
    buffer = io.BytesIO()
    (image if size == image.size else image.resize(size, resample)).save(buffer, "WEBP", **settings)
    return buffer.getvalue()
