"""report.html: one page with all it needs inside, made from a data set's folder.

Its gallery is a sample of the frames, spread over splits, seasons, skies, suns and cameras, as small pictures.
"""

from __future__ import annotations

import base64
import hashlib
import io
import math
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined, Template
from markupsafe import Markup

from forestgen.core.figures import show_bytes
from forestgen.dataset.formats.format import whole_file
from forestgen.dataset.png import thumbnail_name
from forestgen.dataset.report import charts, sections
from forestgen.dataset.report.charts import Fact, listed, percent
from forestgen.dataset.report.frames import Frames
from forestgen.dataset.report.source import Source, open_source
from forestgen.dataset.safe_path import SafePath
from forestgen.dataset.settings import DatasetSettings

if TYPE_CHECKING:
    from PIL.Image import Image

T = TypeVar("T")
REPORT_NAME = "report.html"
_TEMPLATES = Path(__file__).with_name("templates")
MOST_FRAMES = 60  # of the gallery
SHOWN_AT_ONCE = 24  # the others behind "more"
BUDGET_BYTES = 3_200_000  # of all pictures; base64 makes a third more of it
LONG_SIDE_PX, _LEAST_SIDE_PX = 640, 32
_NEAREST, _LANCZOS = 0, 1  # Pillow's numbers
_ELEVATION_STEP_DEG = 20.0
_MOST_CLASSES = 6  # in a frame's caption
_UNNAMED = DatasetSettings.description  # of recipes that say nothing
_SECTIONS = (
    sections.class_section, sections.instance_section, sections.species_section, sections.depth_section,
    sections.sun_section, sections.weather_section, sections.camera_section, sections.draw_section,
    sections.failure_section, sections.timing_section, sections.provenance_section,
)  # fmt: skip
_PLOT = {name: getattr(charts, name.upper()) for name in ("width", "height", "left", "right", "top", "bottom")}
_POLAR = {name: getattr(charts, f"SUN_{name.upper()}") for name in ("size", "centre", "radius")}


def write_report(folder: Path, target: Path) -> None:
    """Write the report on the data set of `folder`; the file `target` appears whole, and replaces what has its name.

    The page is a function of the folder's files: no date, no path and no name of this machine is in it.

    Raises
    ------
    DatasetError : the folder is no data set of ours, or its index is damaged.
    OutputError : the page cannot be written.
    """
    content = _rendered(open_source(folder)).encode("utf-8", "replace").decode()
    with whole_file(target) as stream:
        stream.write(content)


def _rendered(source: Source) -> str:
    """The page as HTML. Every text is escaped by the template's engine; style and script are ours alone."""
    description = source.metadata.description
    name = description if description not in ("", _UNNAMED) else source.folder.resolve().name
    words = [f"{split} {source.frames.split.count(split):,}" for split in source.splits]
    page = {
        "title": name[:200],
        "lead": f"Frames by split: {listed(words, 20)}." if len(source.frames) else "No frames yet.",
        "facts": _headline(source),
        "notes": _notes(source),
        "gallery": gallery(source.folder, source.frames, source.splits),
        "shown_at_once": SHOWN_AT_ONCE,
        "legend": [(one, source.legend.colour(one)) for one in source.legend.classes],
        "sections": [section(source) for section in _SECTIONS],
    }
    style, script = ((_TEMPLATES / name).read_text(encoding="utf-8") for name in ("page.css", "page.js"))
    inline = {"style": Markup(style), "script": Markup(script)}
    hashes = {"style_hash": _hash(style), "script_hash": _hash(script)}
    return _template().render(page=page, plot=_PLOT, polar=_POLAR, **inline, **hashes)


def _headline(source: Source) -> list[Fact]:
    frames = source.frames
    species = {name for one in frames.counts("species_instances") for name in one or ()}
    plants = frames.numbers("plants_in_view")
    pixels = frames.numbers("width_px") * frames.numbers("height_px")
    counts = {"image": frames.images, "frame": len(frames), "split": len(source.splits)}
    facts = [Fact(f"{number:,}", one if number == 1 else f"{one}s") for one, number in counts.items()]
    if np.isfinite(plants).any() or not len(frames):
        facts.append(Fact(f"{len(species):,}", "species in view"))
        facts.append(Fact(f"{int(np.nansum(plants)):,}", "plants labelled"))
    if np.isfinite(pixels).any():
        facts.append(Fact(charts.short(np.nansum(pixels)), "pixels labelled"))
    if source.metadata.bytes:
        facts.append(Fact(show_bytes(source.metadata.bytes), "on disk"))
    return facts


def _notes(source: Source) -> list[str]:
    """Warnings of the whole: images that are missing, and frames without plants."""
    notes, frames = list(source.notes), source.frames
    missing = sum(last - first + 1 for first, last in source.metadata.missing)
    if missing:
        verb = "image is" if missing == 1 else "images are"
        notes.append(f"{missing:,} {verb} missing: {sections.gaps_text(source.metadata.missing)}.")
    plants = frames.numbers("plants_in_view")
    bare = [name for name, count in zip(frames.texts("frame"), plants, strict=True) if count == 0]
    if bare:
        notes.append(f"{len(bare):,} of {len(frames):,} frames show no plant: {listed(bare, 6)}.")
    return notes


@cache
def _template() -> Template:
    loader = FileSystemLoader(_TEMPLATES)
    environment = Environment(
        loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.get_template("page.html")


def _hash(text: str) -> str:
    """Of an inline style or script, as a Content-Security-Policy names it."""
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


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
