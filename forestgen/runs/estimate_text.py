"""An estimate, for people: a small table."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from statistics import fmean

from forestgen.core.figures import show_bytes, three_digits
from forestgen.runs.estimate import LEAST_IMAGES, Estimate, Range

_MOST_STAGES = 6
_WIDTH = 16


def lines(expected: Estimate) -> Iterator[str]:
    """What it takes, how that is known, and where the time goes."""
    for name, text in _rows(expected):
        yield f"{name:<{_WIDTH}}{text}"
    for note in expected.probed.notes:
        yield f"note: {note}"


def _rows(expected: Estimate) -> Iterator[tuple[str, str]]:
    counts = expected.counts
    frames = "frame" if round(counts.frames) == 1 else "frames"
    about = "" if not counts.drawn else f" (drawn: the mean of {counts.drawn} images)"
    yield (
        "images",
        f"{counts.images:,}; {counts.frames:,.0f} {frames}, {_large(counts.pixels)} pixels, "
        f"{_large(counts.paths)} light paths{about}",
    )
    probes = expected.probed.probes
    if probes:
        plants, exemplars, triangles = (
            fmean([float(getattr(one, name)) for one in probes]) for name in ("plants", "exemplars", "triangles")
        )
        yield "in each", f"{plants:,.0f} plants, {exemplars:,.0f} models of {_large(triangles)} triangles"
    yield (
        "workers",
        f"{expected.workers}, of {expected.threads} {'thread' if expected.threads == 1 else 'threads'} each",
    )
    yield from _time(expected)
    memory, disk = expected.memory_bytes, expected.disk_bytes
    yield "memory", f"{_between(memory, show_bytes)} a worker, {show_bytes(expected.workers * memory.high)} in all"
    yield "disk", f"{show_bytes(expected.total_disk_bytes)}; {_between(disk, show_bytes)} an image"
    yield "known from", _source(expected)


def _time(expected: Estimate) -> Iterator[tuple[str, str]]:
    total, each = expected.seconds, expected.image_s
    if total is None or each is None or expected.images_per_hour is None:
        yield "time", "not measured"
        return
    yield "time", f"{_between(total, span)}; {_between(each, span)} an image and worker"
    yield "images an hour", three_digits(expected.images_per_hour)
    shares = list(expected.stages.items())[:_MOST_STAGES]
    yield "time goes to", ", ".join(f"{name} {100 * share:.0f} %" for name, share in shares)


def _source(expected: Estimate) -> str:
    probes = expected.probed.probes
    if not probes:
        why = (
            f"no image was made, as for batches below {LEAST_IMAGES} images"
            if not expected.probed.notes
            else "no image"
        )
        return f"{why}; memory and disk are upper bounds"
    names = ", ".join(f"{one.image}" for one in probes)
    first = "" if any(not one.is_first for one in probes) else ", with the start of a worker in its time"
    return f"{'image' if len(probes) == 1 else 'images'} {names}{_less(expected)}{first}"


def _less(expected: Estimate) -> str:
    """How the probes were lighter than their images."""
    lighter = expected.probed.lighter
    samples = f" with 1/{three_digits(lighter.samples)} of the light paths" if lighter.samples > 1 else ""
    pixels = f" of 1/{three_digits(lighter.pixels)} of the pixels" if lighter.pixels > 1 else ""
    return f", made{pixels}{samples}" if samples or pixels else ""


def _between(value: Range, show: Callable[[float], str]) -> str:
    if value.low <= 0:
        return f"at most {show(value.high)}"
    return f"{show(value.mean)} ({show(value.low)} to {show(value.high)})"


def span(seconds: float) -> str:
    """Such as 3.5 h."""
    for unit, size in (("days", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2 * size:
            return f"{three_digits(seconds / size)} {unit}"
    return f"{three_digits(seconds)} s"


def _large(count: float) -> str:
    for unit, size in (("billion", 1e9), ("million", 1e6)):
        if count >= size:
            return f"{three_digits(count / size)} {unit}"
    return f"{count:,.0f}"
