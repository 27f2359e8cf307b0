"""Sections of the page on what the labels hold: classes, instances, species, depth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from forestgen.dataset.balance import RARE, Balance, balance
from forestgen.dataset.report.charts import Chart, bars, percent, shares
from forestgen.dataset.report.columns import numbers
from forestgen.dataset.report.layout import Cell, Fact, Row, Section, ShareList, Table, facts_in, figures_in, listed
from forestgen.dataset.report.ranges import ranges
from forestgen.dataset.report.source import Legend, Source

NOTHING, SKY = "nothing", "nothing (sky)"
_MOST_ROWS = 60  # of a table


def class_section(source: Source) -> Section:
    """Pixels by semantic class and instances by category, split by split."""
    pixels = _balance(source, "class_pixels", source.legend.classes)
    instances = _balance(source, "category_instances", source.legend.categories)
    notes = _missing_and_rare(pixels, "pixels") + _missing_and_rare(instances, "instances")
    tables = [
        _balance_table(one, source.legend, title, head)
        for one, title, head in (
            (pixels, "Pixels by class", "class"),
            (instances, "Instances by category", "category"),
        )
        if one.counts.any()
    ]
    return Section(
        "classes",
        "Class balance",
        "Shares of each split's pixels, and of its plants in view. Bars are to the scale of the largest share.",
        tables=tuple(tables),
        notes=tuple(notes),
        absent="No classes are counted here.",
    )


def _balance(source: Source, column: str, names: Sequence[str]) -> Balance:
    return balance(source.frames.counts(column), source.frames.split, names, source.splits)


def _missing_and_rare(counted: Balance, what: str) -> list[str]:
    """Warnings; of what no split has, one for all splits. Sky need not be in view."""
    if not counted.counts.any():
        return []
    shown = {name: bool(row.any()) for name, row in zip(counted.names, counted.counts, strict=True)}
    nowhere = [name for name in counted.names if not shown[name] and name != NOTHING]
    notes = [f"No frame has {what} of {listed(nowhere)}."] if nowhere else []
    for split, total in zip(counted.splits, counted.counts.sum(axis=0), strict=True):
        if not total:
            notes.append(f"{split} has no {what} at all.")
            continue
        lacking = [name for name, part in counted.lacking() if part == split and shown[name] and name != NOTHING]
        rare = [name for name, part in counted.rare() if part == split and name != NOTHING]
        if lacking:
            notes.append(f"{split} has no {what} of {listed(lacking)}.")
        if rare:
            notes.append(f"In {split}, less than {percent(RARE)} of the {what} are {listed(rare)}.")
    return notes


def _balance_table(counted: Balance, legend: Legend, title: str, head: str) -> Table:
    share, most = counted.shares, max(float(counted.shares.max(initial=0.0)), 1e-12)
    rows = []
    for i, name in enumerate(counted.names[:_MOST_ROWS]):
        cells = tuple(
            Cell(
                percent(share[i, j]) if counted.counts[i, j] else "none",
                float(share[i, j] / most),
                warn=bool(share[i, j] < RARE),
                soft=f"{counted.counts[i, j]:,}",
            )
            for j in range(len(counted.splits))
        )
        rows.append(Row(SKY if name == NOTHING else name, cells, legend.colour(name)))
    unlisted = len(counted.names) - len(rows)
    note = f"{unlisted:,} more are not listed." if unlisted else ""
    return Table(title, (head, *counted.splits), tuple(rows), note)


def instance_section(source: Source) -> Section:
    """Sizes of the plants in view."""
    frames = source.frames
    counts = log_counts(frames.values("instance_pixels_histogram"))
    total, small = int(counts.sum()), int(counts[:4].sum())
    parts = (
        Fact(f"{total:,}", "plants in view") if total else None,
        Fact(percent(small / total), "smaller than 16 pixels") if total else None,
        _sizes(counts) if total else None,
        numbers(frames, "plants_in_view", "Plants in view of a frame", "plants"),
        numbers(
            frames, "visible_fraction_median", "How much of a plant is visible", "median of a frame, %", factor=100
        ),
    )
    lead = "A plant is in view if it wins at least one pixel of the instance mask."
    absent = "No instances are counted here."
    return Section("instances", "Instances", lead, facts_in(parts), figures_in(parts), absent=absent)


def _sizes(counts: NDArray[np.int64]) -> Chart:
    edges = 2.0 ** np.arange(len(counts) + 1)
    summary = f"Instances by size: {counts.sum():,} plants in view, the largest below {edges[-1]:,.0f} pixels"
    return bars(counts, edges, "Size of instances", "visible pixels", log=True, y_title="plants", summary=summary)


def log_counts(rows: Sequence[Sequence[int] | None]) -> NDArray[np.int64]:
    """Sum of histograms of different lengths: how many have 1, 2-3, 4-7, 8-15, ... pixels."""
    counts = np.zeros(max((len(row) for row in rows if row), default=0), dtype=np.int64)
    for row in rows:
        if row:
            counts[: len(row)] += np.asarray(row, dtype=np.int64)
    return counts


def species_section(source: Source) -> Section:
    """Who is seen, how often, and how large."""
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
    figures = [ShareList(title, shares(names, counts, colours), note) for title, counts, note in lists if counts.any()]
    if len(source.frames) and frames.any():
        rows = shares(names, frames[order], colours, of=len(source.frames))
        figures.append(ShareList("Frames that show a species", rows, "share of all frames · frames"))
    return Section("species", "Species", figures=tuple(figures), absent="No species are counted here.")


def depth_section(source: Source) -> Section:
    """How near and how far."""
    columns = {"nearest pixel": "depth_min_m", "median pixel": "depth_median_m", "farthest pixel": "depth_max_m"}
    frames = source.frames
    parts = (
        ranges({name: frames.numbers(column) for name, column in columns.items()}, "Depth of pixels", "depth, m", "m"),
        numbers(frames, "depth_median_m", "Median depth of a frame", "depth, m", unit="m", log=True),
        numbers(frames, "sky_share", "Sky in a frame", "share of pixels, %", unit="%", factor=100),
    )
    lead = "Along each pixel's ray to what it shows, sky left out."
    absent = "No depths are recorded here."
    return Section("depth", "Depth", lead, facts_in(parts), figures_in(parts), absent=absent)
