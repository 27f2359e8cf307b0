"""report.html: one page with all it needs inside, made from a data set's folder."""

from __future__ import annotations

import base64
import hashlib
from functools import cache
from pathlib import Path

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined, Template
from markupsafe import Markup

from forestgen.core.figures import show_bytes
from forestgen.dataset.formats.shards import whole_file
from forestgen.dataset.report import charts, content_sections, run_sections
from forestgen.dataset.report.charts import Fact, listed
from forestgen.dataset.report.gallery import SHOWN_AT_ONCE, gallery
from forestgen.dataset.report.source import Source, open_source
from forestgen.dataset.settings import DatasetSettings

REPORT_NAME = "report.html"
_TEMPLATES = Path(__file__).with_name("templates")
_UNNAMED = DatasetSettings.description  # of recipes that say nothing
_SECTIONS = (
    content_sections.class_section, content_sections.instance_section, content_sections.species_section,
    content_sections.depth_section, content_sections.sun_section, content_sections.weather_section,
    content_sections.camera_section, content_sections.draw_section, run_sections.failure_section,
    run_sections.timing_section, run_sections.provenance_section,
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
        notes.append(f"{missing:,} {verb} missing: {run_sections.gaps_text(source.metadata.missing)}.")
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
