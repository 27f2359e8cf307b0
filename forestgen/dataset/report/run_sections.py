"""Sections of the page on how it was made: failures, time and memory, where it comes from. Texts of sizes and times."""

from __future__ import annotations

import numpy as np

from forestgen.core.figures import seconds, show_bytes
from forestgen.dataset.report import charts
from forestgen.dataset.report.source import Failure, RecipeMetadata, RunLog, Source

_MOST_STAGES, _MOST_WINDOWS = 16, 48
_MOST_IMAGES = 12  # named beside a message
_NO_RUN = "There is no log of a run: merged data sets have none."


def failure_section(source: Source) -> charts.Section:
    """What went wrong, by message, and what became of it."""
    run = source.run
    if run is None or not run.lines:
        return charts.Section("failures", "Failures", _NO_RUN)
    given_up = set(run.given_up)
    facts = (
        charts.Fact(f"{run.failed_attempts:,}", "failed attempts"),
        charts.Fact(f"{len(given_up):,}", "images given up"),
        charts.Fact(f"{run.workers_lost:,}", "workers lost"),
    )
    rows = [_failure_row(one, given_up) for one in run.failures]
    unlisted = run.unlisted_attempts
    note = f"{unlisted:,} attempts with other messages are in run/log.jsonl." if unlisted else ""
    tables = (
        [charts.Table("By message", ("kind", "message", "attempts", "images"), rows, note, words=True)] if rows else []
    )
    lead = "An attempt that failed leaves nothing in the data set; what may pass is tried again."
    if not rows:
        lead = "No attempt failed."
    if run.damaged_lines:
        lead += f" {run.damaged_lines:,} of the log's lines cannot be read; a kill may cut one short."
    return charts.Section("failures", "Failures", "", lead, facts, tables)


def _failure_row(failure: Failure, given_up: set[int]) -> charts.Row:
    images = sorted(failure.images)
    named = ", ".join(
        f"{image} (attempt {failure.images[image]}{', given up' if image in given_up else ''})"
        for image in images[:_MOST_IMAGES]
    )
    more = f" and {len(images) - _MOST_IMAGES:,} more" if len(images) > _MOST_IMAGES else ""
    is_lost = not given_up.isdisjoint(images)
    listed = charts.Cell(named + more, soft="" if is_lost else "all made in the end", warn=is_lost)
    return charts.Row(failure.kind, [charts.Cell(failure.message), charts.Cell(f"{failure.attempts:,}"), listed])


def timing_section(source: Source) -> charts.Section:
    """Where the time went."""
    run = source.run
    if run is None:
        return charts.Section("timings", "Time and memory", _NO_RUN)
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
    return charts.Section("timings", "Time and memory", "The log has no times.", parts=parts)


def _timing_facts(run: RunLog) -> list[charts.Fact]:
    facts = []
    if run.images_per_hour is not None:
        rate = run.images_per_hour
        facts.append(charts.Fact(f"{rate:,.0f}" if rate >= 100 else f"{rate:.3g}", "images per hour"))
    if run.job_s:
        facts.append(charts.Fact(seconds(float(np.median(run.job_s))), "an image, by the median"))
    if run.running_s > 0:
        facts.append(charts.Fact(seconds(run.running_s), "in all" if run.runs < 2 else f"in all, over {run.runs} runs"))
    if run.workers:
        facts.append(charts.Fact(f"{len(run.workers):,}", "worker processes, over all runs"))
    if any(run.peak_memory_bytes):
        facts.append(charts.Fact(f"{max(run.peak_memory_bytes) / 2**20:,.0f} MiB", "peak memory of a worker"))
    return facts


def _stages(run: RunLog) -> charts.ShareList | None:
    """Time by stage, those of less than a hundredth together."""
    whole = sum(run.stage_s.values())
    stages = sorted(run.stage_s.items(), key=lambda one: (-one[1], one[0]))
    large = [one for one in stages if one[1] >= 0.01 * whole][:_MOST_STAGES]
    if len(rest := stages[len(large) :]) > 1:
        stages = [*large, (f"{len(rest)} others", sum(seconds for _, seconds in rest))]
    rows = charts.shares([name for name, _ in stages], [seconds for _, seconds in stages], of=whole)
    note = "share of the workers' time · seconds"
    return charts.ShareList("Where the time goes, by stage", rows, note) if rows else None


def _pace(run: RunLog) -> charts.Chart | None:
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


def provenance_section(source: Source) -> charts.Section:
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
    rows = [charts.Row(name, [charts.Cell(text)]) for name, text in values if text]
    table = charts.Table("Where it comes from", ("what", "value"), rows, words=True)
    return charts.Section("provenance", "Provenance", "", tables=[table])


def gaps_text(gaps: list[tuple[int, int]], most: int = 12) -> str:
    """Gaps for people: 3, 17 to 19, ..."""
    named = [str(first) if first == last else f"{first} to {last}" for first, last in gaps[:most]]
    return ", ".join([*named, *(["..."] if len(gaps) > most else [])])
