"""report.html: one page with all it needs inside, made from a data set's folder."""

from __future__ import annotations

import base64
import hashlib
import os
import secrets
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from forestgen.dataset.files import output_error
from forestgen.dataset.report.charts import BOTTOM, HEIGHT, LEFT, RIGHT, TOP, WIDTH, short
from forestgen.dataset.report.gallery import SHOWN_AT_ONCE, Exhibit, gallery
from forestgen.dataset.report.label_sections import (
    class_section,
    depth_section,
    instance_section,
    species_section,
)
from forestgen.dataset.report.layout import Fact, Section, listed
from forestgen.dataset.report.polar import CENTRE, RADIUS, SIZE
from forestgen.dataset.report.run_sections import failure_section, provenance_section, size_text, timing_section
from forestgen.dataset.report.scene_sections import camera_section, draw_section, sun_section, weather_section
from forestgen.dataset.report.source import Source, open_source
from forestgen.dataset.report.told import gaps_text
from forestgen.dataset.settings import DatasetSettings

REPORT_NAME = "report.html"
_UNNAMED = DatasetSettings.description  # of recipes that say nothing
_SECTIONS = (
    class_section, instance_section, species_section, depth_section, sun_section, weather_section, camera_section,
    draw_section, failure_section, timing_section, provenance_section,
)  # fmt: skip
_PLOT = {"width": WIDTH, "height": HEIGHT, "left": LEFT, "right": RIGHT, "top": TOP, "bottom": BOTTOM}
_POLAR = {"size": SIZE, "centre": CENTRE, "radius": RADIUS}


@dataclass(frozen=True)
class Page:
    """All that the template shows."""

    title: str
    lead: str
    facts: tuple[Fact, ...]
    notes: tuple[str, ...]  # warnings of the whole
    exhibits: tuple[Exhibit, ...]
    legend: tuple[tuple[str, str], ...]  # class and colour of the masks
    sections: tuple[Section, ...]
    shown_at_once: int = SHOWN_AT_ONCE


def write_report(folder: Path, target: Path) -> None:
    """Write the report on a data set; the file appears whole, and replaces what has its name.

    The page is a function of the folder's files: no date, no path and no name of this machine is in it.

    Parameters
    ----------
    folder : that `forestgen render`, `forestgen batch` or `forestgen merge` wrote.
    target : the page's file.

    Raises
    ------
    DatasetError : the folder is no data set of ours, or its index is damaged.
    OutputError : the page cannot be written.
    """
    content = render_page(page_of(open_source(folder))).encode("utf-8", "replace")
    staged = target.with_name(f".{target.name}.{os.getpid()}-{secrets.token_hex(4)}")
    try:
        staged.write_bytes(content)
        staged.replace(target)
    except OSError as error:
        raise output_error(error, target) from error
    finally:
        with suppress(OSError):
            staged.unlink()


def page_of(source: Source) -> Page:
    """Gather what is told of a data set."""
    sections = tuple(section(source) for section in _SECTIONS)
    told = source.told.description
    name = told if told not in ("", _UNNAMED) else source.folder.resolve().name
    return Page(
        title=name[:200],
        lead=_lead(source),
        facts=_headline(source),
        notes=_notes(source),
        exhibits=gallery(source.folder, source.frames, source.splits),
        legend=tuple((one, source.legend.colour(one)) for one in source.legend.classes),
        sections=sections,
    )


def render_page(page: Page) -> str:
    """The page as HTML. Every text is escaped by the template's engine; style and script are ours alone."""
    style, script = _file("page.css"), _file("page.js")
    return (
        _environment()
        .get_template("page.html")
        .render(
            page=page,
            style=Markup(style),
            script=Markup(script),
            style_hash=_hash(style),
            script_hash=_hash(script),
            plot=_PLOT,
            polar=_POLAR,
        )
    )


def _lead(source: Source) -> str:
    counts = {split: source.frames.split.count(split) for split in source.splits}
    if not len(source.frames):
        return "No frames yet."
    words = [f"{split} {count:,}" for split, count in counts.items()]
    return f"Frames by split: {listed(words, 20)}."


def _headline(source: Source) -> tuple[Fact, ...]:
    frames = source.frames
    species = {name for one in frames.counts("species_instances") for name in one or ()}
    plants = frames.numbers("plants_in_view")
    pixels = frames.numbers("width_px") * frames.numbers("height_px")
    facts = [
        _counted(frames.images, "image"),
        _counted(len(frames), "frame"),
        _counted(len(source.splits), "split"),
    ]
    if np.isfinite(plants).any() or not len(frames):
        facts += [
            Fact(f"{len(species):,}", "species in view"),
            Fact(f"{int(np.nansum(plants)):,}", "plants labelled"),
        ]
    if np.isfinite(pixels).any():
        facts.append(Fact(f"{short(np.nansum(pixels))}", "pixels labelled"))
    if source.told.bytes:
        facts.append(Fact(size_text(source.told.bytes), "on disk"))
    return tuple(facts)


def _counted(number: int, one: str) -> Fact:
    return Fact(f"{number:,}", one if number == 1 else f"{one}s")


def _notes(source: Source) -> tuple[str, ...]:
    """Warnings of the whole: what lacks, and what the frames' own notes say."""
    notes = list(source.notes)
    missing = sum(last - first + 1 for first, last in source.told.missing)
    if missing:
        verb = "image is" if missing == 1 else "images are"
        notes.append(f"{missing:,} {verb} missing: {gaps_text(source.told.missing)}.")
    bare = [
        name
        for name, plants in zip(source.frames.texts("frame"), source.frames.numbers("plants_in_view"), strict=True)
        if plants == 0
    ]
    if bare:
        notes.append(f"{len(bare):,} of {len(source.frames):,} frames show no plant: {listed(bare, 6)}.")
    return tuple(notes)


@cache
def _environment() -> Environment:
    return Environment(
        loader=PackageLoader("forestgen.dataset.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def _file(name: str) -> str:
    """A file beside the templates, on which nothing is replaced."""
    text: Any = _environment().loader.get_source(_environment(), name)[0]  # type: ignore[union-attr]
    return str(text)


def _hash(text: str) -> str:
    """Of an inline style or script, as a Content-Security-Policy names it."""
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
