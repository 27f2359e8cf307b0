"""Sections of the page: what the labels hold, what was drawn (sun, weather, cameras, distributions), and its runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.figures import seconds, show_bytes
from forestgen.dataset.report import charts
from forestgen.dataset.report.charts import Cell, Chart, Fact, Part, Row, Section, ShareList, Table
from forestgen.dataset.report.frames import correlations, named, names, numbers, unit_of
from forestgen.dataset.report.source import Failure, Legend, RecipeMetadata, RunLog, Source
from forestgen.dataset.settings import DRAW

RARE = 0.001  # share of a split's pixels, or of its instances, below which a class is hard to learn
_NOTHING, _SKY = "nothing", "nothing (sky)"
_MOST_ROWS = 60  # of a table
_MOST_DRAWS = 24
_MOST_CHARACTERS = 110  # of a distribution as the recipe has it
_MOST_STAGES, _MOST_WINDOWS = 16, 48
_MOST_IMAGES = 12  # named beside a message
_NO_RUN = "There is no log of a run: merged data sets have none."


@dataclass(frozen=True)
class Balance:
    """Counts of what has a name (pixels of classes, instances of categories), by split."""

    names: tuple[str, ...]  # in the legend's order; what the legend lacks comes last
    splits: tuple[str, ...]
    counts: NDArray[np.int64]  # (names, splits)
    frames: NDArray[np.int64]  # (names, splits) that show any

    @property
    def shares(self) -> NDArray[np.float64]:
        """(names, splits) of 1; 0 in a split that counts nothing."""
        total = self.counts.sum(axis=0, keepdims=True)
        return np.asarray(self.counts / np.maximum(total, 1), dtype=np.float64)

    def lacking(self) -> list[tuple[str, str]]:
        """(name, split) of all that a split lacks."""
        return self._where(self.counts == 0)

    def rare(self) -> list[tuple[str, str]]:
        """(name, split) of all that a split shows, but less than `RARE` of."""
        return self._where((self.counts > 0) & (self.shares < RARE))

    def _where(self, chosen: NDArray[np.bool_]) -> list[tuple[str, str]]:
        return [(self.names[i], self.splits[j]) for i, j in np.argwhere(chosen)]


def balance(
    counted: Sequence[Mapping[str, int] | None], split: Sequence[str], names: Sequence[str], splits: Sequence[str]
) -> Balance:
    """Sum counts of frames, name -> count or None if nothing is known, by name and by the frame's split.

    `names` are all that can occur, such as the legend's classes; others that do are added.
    """
    occurring = {name for one in counted if one for name in one}
    known = tuple(dict.fromkeys([*names, *sorted(occurring)]))
    row_of = {name: row for row, name in enumerate(known)}
    column_of = {name: column for column, name in enumerate(splits)}
    counts = np.zeros((len(known), len(splits)), dtype=np.int64)
    frames = np.zeros_like(counts)
    for one, part in zip(counted, split, strict=True):
        for name, count in (one or {}).items():
            counts[row_of[name], column_of[part]] += count
            frames[row_of[name], column_of[part]] += count > 0
    return Balance(known, tuple(splits), counts, frames)


def class_section(source: Source) -> Section:
    """Pixels by semantic class and instances by category, split by split."""
    tables, notes = [], []
    for column, all_names, what, title, head in (
        ("class_pixels", source.legend.classes, "pixels", "Pixels by class", "class"),
        ("category_instances", source.legend.categories, "instances", "Instances by category", "category"),
    ):
        counted = _balance(source, column, all_names)
        if counted.counts.any():
            notes += _missing_and_rare(counted, what)
            tables.append(_balance_table(counted, source.legend, title, head))
    lead = "Shares of each split's pixels, and of its plants in view. Bars are to the scale of the largest share."
    return Section("classes", "Class balance", "No classes are counted here.", lead, tables=tables, notes=notes)


def _balance(source: Source, column: str, names: Sequence[str]) -> Balance:
    return balance(source.frames.counts(column), source.frames.split, names, source.splits)


def _missing_and_rare(counted: Balance, what: str) -> list[str]:
    """Warnings; of what no split has, one for all splits. Sky need not be in view."""
    shown = {name: bool(row.any()) for name, row in zip(counted.names, counted.counts, strict=True)}
    nowhere = [name for name in counted.names if not shown[name] and name != _NOTHING]
    notes = [f"No frame has {what} of {charts.listed(nowhere)}."] if nowhere else []
    for split, total in zip(counted.splits, counted.counts.sum(axis=0), strict=True):
        if not total:
            notes.append(f"{split} has no {what} at all.")
            continue
        lacking = [name for name, part in counted.lacking() if part == split and shown[name] and name != _NOTHING]
        rare = [name for name, part in counted.rare() if part == split and name != _NOTHING]
        if lacking:
            notes.append(f"{split} has no {what} of {charts.listed(lacking)}.")
        if rare:
            notes.append(f"In {split}, less than {charts.percent(RARE)} of the {what} are {charts.listed(rare)}.")
    return notes


def _balance_table(counted: Balance, legend: Legend, title: str, head: str) -> Table:
    share, most = counted.shares, max(float(counted.shares.max(initial=0.0)), 1e-12)
    rows = []
    for name, counts, parts in zip(counted.names[:_MOST_ROWS], counted.counts, share, strict=False):
        cells = [
            Cell(
                charts.percent(part) if count else "none", float(part / most), warn=bool(part < RARE), soft=f"{count:,}"
            )
            for count, part in zip(counts, parts, strict=True)
        ]
        rows.append(Row(_SKY if name == _NOTHING else name, cells, legend.colour(name)))
    unlisted = len(counted.names) - len(rows)
    note = f"{unlisted:,} more are not listed." if unlisted else ""
    return Table(title, (head, *counted.splits), rows, note)


def instance_section(source: Source) -> Section:
    """Sizes of the plants in view."""
    frames = source.frames
    rows = frames.values("instance_pixels_histogram")  # how many have 1, 2-3, 4-7, 8-15, ... pixels
    counts = np.array([sum(one) for one in zip_longest(*filter(None, rows), fillvalue=0)], dtype=np.int64)
    total, small, edges = int(counts.sum()), int(counts[:4].sum()), 2.0 ** np.arange(len(counts) + 1)
    sizes = f"Instances by size: {total:,} plants in view, the largest below {edges[-1]:,.0f} pixels"
    parts = (
        Fact(f"{total:,}", "plants in view") if total else None,
        Fact(charts.percent(small / total), "smaller than 16 pixels") if total else None,
        charts.bars(counts, edges, "Size of instances", "visible pixels", summary=sizes, log=True, y_title="plants")
        if total
        else None,
        numbers(frames, "plants_in_view", "Plants in view of a frame", "plants"),
        numbers(frames, "visible_fraction_median", "Visible share of a plant", "median of a frame, %", factor=100),
    )
    lead = "A plant is in view if it wins at least one pixel of the instance mask."
    return Section("instances", "Instances", "No instances are counted here.", lead, parts)


def species_section(source: Source) -> Section:
    """Which species are seen, how often, and how large."""
    species = _balance(source, "species_instances", ())
    pixels = _balance(source, "species_pixels", species.names)
    frames = species.frames.sum(axis=1)
    order = np.argsort(-species.counts.sum(axis=1), kind="stable")[:_MOST_ROWS]
    names = [species.names[i] for i in order]
    colours = [source.legend.colour(name) for name in names]
    at = [pixels.names.index(name) for name in names]
    lists = (
        ("Plants in view, by species", species.counts.sum(axis=1)[order], "share of all plants in view · plants"),
        ("Pixels, by species", pixels.counts.sum(axis=1)[at], "share of all plants' pixels · pixels"),
    )
    figures = [
        ShareList(title, charts.shares(names, counts, colours), note) for title, counts, note in lists if counts.any()
    ]
    if len(source.frames) and frames.any():
        rows = charts.shares(names, frames[order], colours, of=len(source.frames))
        figures.append(ShareList("Frames that show a species", rows, "share of all frames · frames"))
    return Section("species", "Species", "No species are counted here.", parts=figures)


def depth_section(source: Source) -> Section:
    """How near and how far."""
    columns = {"nearest pixel": "depth_min_m", "median pixel": "depth_median_m", "farthest pixel": "depth_max_m"}
    frames = source.frames
    parts = (
        charts.ranges(
            {name: frames.numbers(column) for name, column in columns.items()}, "Depth of pixels", "depth, m", "m"
        ),
        numbers(frames, "depth_median_m", "Median depth of a frame", "depth, m", unit="m", log=True),
        numbers(frames, "sky_share", "Sky in a frame", "share of pixels, %", unit="%", factor=100),
    )
    lead = "Along each pixel's ray to what it shows, sky left out."
    return Section("depth", "Depth", "No depths are recorded here.", lead, parts)


def sun_section(source: Source) -> Section:
    """Where the sun stood."""
    frames = source.frames
    parts = (
        charts.sun_plot(frames.numbers("sun_azimuth_deg"), frames.numbers("sun_elevation_deg")),
        numbers(frames, "sun_elevation_deg", "Elevation of the sun", "degrees above the horizon", unit="°"),
        numbers(frames, "sun_azimuth_deg", "Azimuth of the sun", "degrees clockwise from north", unit="°"),
        numbers(frames, "sunlit_share", "Sunlit pixels", "share of what is not sky, %", unit="%", factor=100),
    )
    return Section("sun", "Sun", "No sun is recorded here.", parts=parts)


def weather_section(source: Source) -> Section:
    """Clouds, haze, season, wind."""
    frames = source.frames
    parts = (
        names(frames, "clouds", "Clouds"),
        names(frames, "season", "Season"),
        names(frames, "sky_kind", "Sky"),
        numbers(frames, "cloud_cover", "Cloud cover", "as the recipe asks for, %", unit="%", factor=100),
        numbers(frames, "cloud_share", "Clouds in view", "mean opacity over the sky's pixels, %", unit="%", factor=100),
        numbers(frames, "turbidity", "Turbidity", "turbidity"),
        numbers(frames, "visibility_m", "Visibility in haze", "m", unit="m", log=True),
        numbers(frames, "wind_m_per_s", "Wind", "m/s", unit="m/s"),
    )
    return Section("weather", "Weather and season", "No weather is recorded here.", parts=parts)


def camera_section(source: Source) -> Section:
    """How the cameras look."""
    frames = source.frames
    sides = zip(frames.numbers("width_px"), frames.numbers("height_px"), strict=True)
    parts = (
        names(frames, "camera_kind", "Kind"),
        names(frames, "camera", "Camera"),
        named([f"{width:.0f} x {height:.0f} px" for width, height in sides if width > 0 and height > 0], "Size"),
        numbers(frames, "camera_height_m", "Height above the ground", "m", unit="m"),
        numbers(frames, "camera_pitch_deg", "Pitch", "degrees above the horizon", unit="°"),
        numbers(frames, "camera_azimuth_deg", "Direction of view", "degrees clockwise from north", unit="°"),
        numbers(frames, "hfov_deg", "Horizontal field of view", "degrees", unit="°"),
    )
    return Section("cameras", "Cameras", "No cameras are recorded here.", parts=parts)


def draw_section(source: Source) -> Section:
    """What the recipe's distributions gave, and what goes together."""
    drawn = [name for name in source.frames.names if name.startswith(DRAW)]
    lead = "What the recipe's distributions gave; below each, what the recipe asks for." if drawn else ""
    if len(drawn) > _MOST_DRAWS:
        lead += f" The first {_MOST_DRAWS} of {len(drawn):,}; the index has all."
    absent = "No draws are recorded here: the recipe has no distributions, or the folder has no index."
    parts = [_draw(source, name, source.metadata.draws) for name in drawn[:_MOST_DRAWS]]
    return Section("draws", "Drawn values", absent, lead, parts, _correlations(source, drawn))


def _draw(source: Source, name: str, distributions: Mapping[str, Any]) -> Part | None:
    key, frames = name.removeprefix(DRAW), source.frames
    text = _flow(distributions[key]) if key in distributions else ""
    note = text if len(text) <= _MOST_CHARACTERS else f"{text[: _MOST_CHARACTERS - 4]} ..."
    if frames.is_number(name):
        unit = unit_of(key)
        return numbers(frames, name, key, unit or "value", unit=unit, note=note)
    return names(frames, name, key, note)


def _flow(value: Any) -> str:
    """A distribution as one would write it on one line."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {_flow(one)}" for key, one in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_flow, value)) + "]"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _correlations(source: Source, drawn: Sequence[str]) -> list[Table]:
    rows = [
        Row(
            f"{one.first.removeprefix(DRAW)} and {one.second.removeprefix(DRAW)}",
            [Cell(f"{one.rank:+.2f}", abs(one.rank))],
        )
        for one in correlations(source.frames, drawn)
    ]
    note = (
        "Spearman's rank correlation over the images. Of two things that always come together, a model may learn one "
        "for the other. What the recipe correlates on purpose is here too."
    )
    return [Table("What goes together", ("pair", "correlation"), rows, note)] if rows else []


def failure_section(source: Source) -> Section:
    """What went wrong, by message, and what became of it."""
    run = source.run
    if run is None or not run.lines:
        return Section("failures", "Failures", _NO_RUN)
    given_up = set(run.given_up)
    facts = (
        Fact(f"{run.failed_attempts:,}", "failed attempts"),
        Fact(f"{len(given_up):,}", "images given up"),
        Fact(f"{run.workers_lost:,}", "workers lost"),
    )
    rows = [_failure_row(one, given_up) for one in run.failures]
    unlisted = run.unlisted_attempts
    note = f"{unlisted:,} attempts with other messages are in run/log.jsonl." if unlisted else ""
    tables = [Table("By message", ("kind", "message", "attempts", "images"), rows, note, words=True)] if rows else []
    lead = "An attempt that failed leaves nothing in the data set; what may pass is tried again."
    if not rows:
        lead = "No attempt failed."
    if run.damaged_lines:
        lead += f" {run.damaged_lines:,} of the log's lines cannot be read; a kill may cut one short."
    return Section("failures", "Failures", "", lead, facts, tables)


def _failure_row(failure: Failure, given_up: set[int]) -> Row:
    images = sorted(failure.images)
    named = ", ".join(
        f"{image} (attempt {failure.images[image]}{', given up' if image in given_up else ''})"
        for image in images[:_MOST_IMAGES]
    )
    more = f" and {len(images) - _MOST_IMAGES:,} more" if len(images) > _MOST_IMAGES else ""
    is_lost = not given_up.isdisjoint(images)
    listed = Cell(named + more, soft="" if is_lost else "all made in the end", warn=is_lost)
    return Row(failure.kind, [Cell(failure.message), Cell(f"{failure.attempts:,}"), listed])


def timing_section(source: Source) -> Section:
    """Where the time went."""
    run = source.run
    if run is None:
        return Section("timings", "Time and memory", _NO_RUN)
    memory_mib = [one / 2**20 for one in run.peak_memory_bytes]
    parts = (
        *_timing_facts(run),
        _stages(run),
        charts.histogram(run.job_s, "Time of an image", "seconds", log=True, y_title="images"),
        _pace(run),
        charts.histogram(memory_mib, "Peak memory of a worker", "MiB", y_title="images")
        if len(memory_mib) > 1
        else None,
    )
    return Section("timings", "Time and memory", "The log has no times.", parts=parts)


def _timing_facts(run: RunLog) -> list[Fact]:
    facts = []
    if run.images_per_hour is not None:
        rate = run.images_per_hour
        facts.append(Fact(f"{rate:,.0f}" if rate >= 100 else f"{rate:.3g}", "images per hour"))
    if run.job_s:
        facts.append(Fact(seconds(float(np.median(run.job_s))), "an image, by the median"))
    if run.running_s > 0:
        facts.append(Fact(seconds(run.running_s), "in all" if run.runs < 2 else f"in all, over {run.runs} runs"))
    if run.workers:
        facts.append(Fact(f"{len(run.workers):,}", "worker processes, over all runs"))
    if any(run.peak_memory_bytes):
        facts.append(Fact(f"{max(run.peak_memory_bytes) / 2**20:,.0f} MiB", "peak memory of a worker"))
    return facts


def _stages(run: RunLog) -> ShareList | None:
    """Time by stage, those of less than a hundredth together."""
    whole = sum(run.stage_s.values())
    stages = sorted(run.stage_s.items(), key=lambda one: (-one[1], one[0]))
    large = [one for one in stages if one[1] >= 0.01 * whole][:_MOST_STAGES]
    if len(rest := stages[len(large) :]) > 1:
        stages = [*large, (f"{len(rest)} others", sum(seconds for _, seconds in rest))]
    rows = charts.shares([name for name, _ in stages], [seconds for _, seconds in stages], of=whole)
    note = "share of the workers' time · seconds"
    return ShareList("Where the time goes, by stage", rows, note) if rows else None


def _pace(run: RunLog) -> Chart | None:
    """Images per hour over the run, in windows of equal length."""
    if len(run.finished_s) < 2 or run.running_s <= 0 or max(run.finished_s) <= min(run.finished_s):
        return None
    scale, unit = (
        (3600.0, "hours") if run.running_s > 7200 else (60.0, "minutes") if run.running_s > 180 else (1.0, "seconds")
    )
    span = run.running_s / scale
    step = charts.nice_step(span, min(_MOST_WINDOWS, max(2, len(run.finished_s) // 4)))
    edges = np.arange(int(np.ceil(span / step - 1e-9)) + 1) * step
    counts, _ = np.histogram(np.asarray(run.finished_s) / scale, edges)
    width_h = np.minimum(np.diff(edges), span - edges[:-1]) * scale / 3600.0  # the last window ends with the run
    rate = counts / np.maximum(width_h, 1e-9)
    title = "Images per hour over the run"
    summary = f"{title}: least {rate.min():.3g}, most {rate.max():.3g}"
    return charts.bars(rate, edges, title, f"running time, {unit}", y_title="images/h", summary=summary)


def provenance_section(source: Source) -> Section:
    """What the data set was made from, and with."""
    metadata = source.metadata
    licence = " ".join(filter(None, ((metadata.licence or {}).get(key) for key in ("name", "url"))))

    def text_of(recipe: RecipeMetadata) -> str:
        parts = [
            ("recipe hash", recipe.hash),
            ("seed", str(recipe.root_seed)),
            ("images asked for", f"{recipe.images:,}"),
        ]
        return ", ".join(f"{name} {value}" for name, value in parts if value)

    values = [
        ("description", metadata.description),
        ("contributor", metadata.contributor),
        ("licence", licence or "none stated"),
        ("size on disk", show_bytes(metadata.bytes) if metadata.bytes else ""),
        *((one.file or "recipe", text_of(one)) for one in metadata.recipes),
        *(("made with", str(versions)) for versions in metadata.made_with),
        ("missing images", gaps_text(metadata.missing, 100) or "none"),
    ]
    rows = [Row(name, [Cell(text)]) for name, text in values if text]
    table = Table("Where it comes from", ("what", "value"), rows, words=True)
    return Section("provenance", "Provenance", "", tables=[table])


def gaps_text(gaps: list[tuple[int, int]], most: int = 12) -> str:
    """Gaps for people: 3, 17 to 19, ..."""
    named = [str(first) if first == last else f"{first} to {last}" for first, last in gaps[:most]]
    return ", ".join([*named, *(["..."] if len(gaps) > most else [])])
