"""What `forestgen batch` does: choose the workers, estimate, run, tell."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import typer
from rich.text import Text

from forestgen.cli.batch_display import Display, span, tell
from forestgen.cli.console import Bars, count, output, stops_keep
from forestgen.core.errors import DatasetError
from forestgen.core.figures import show_bytes, three_digits
from forestgen.dataset.settings import DatasetSettings
from forestgen.recipe.load import LoadedRecipe
from forestgen.runs.contract import TRANSIENT, Engine, Failed, Notice, Place, Work
from forestgen.runs.discards import Standing, check_discards, standing
from forestgen.runs.engines.local import LocalEngine
from forestgen.runs.estimate import BUDGET_S, LEAST_IMAGES, Estimate, check_fits, estimate
from forestgen.runs.estimate_text import lines
from forestgen.runs.folder import check_ours, check_resume, fingerprint
from forestgen.runs.keys import versions_hash
from forestgen.runs.places import place_of
from forestgen.runs.run import check_recipe, run_batch
from forestgen.runs.summary import BatchSummary
from forestgen.runs.work import make_job
from forestgen.stages.load_checked import load_checked

_UNITS = {"": 1, "k": 10**3, "m": 10**6, "g": 10**9, "t": 10**12, "ki": 2**10, "mi": 2**20, "gi": 2**30, "ti": 2**40}
_MOST_FAILURES = 5  # that are shown
_MOST_NOTES = 5
_LEAST_BYTES = 10**8  # less is a mistake, such as a number without its unit: Python and Mitsuba alone take more


@dataclass(frozen=True)
class Asked:
    """The command's arguments."""

    recipe: Path
    overrides: tuple[str, ...]
    count: int
    target: str
    resume: bool
    discard: bool
    workers: int | None
    threads: int | None
    memory_bytes: int | None
    timeout_s: float | None
    retries: int
    engine: str
    scheduler: str | None
    resources: Mapping[str, float]


def bytes_of(text: str, option: str) -> int:
    """A size such as 4GB, 500 MB or 1.5GiB, in bytes."""
    found = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([kmgt]?i?)b?\s*", text, re.IGNORECASE)
    unit = found[2].lower() if found else None
    if found is None or unit not in _UNITS:
        raise typer.BadParameter(f"{text!r} is no size such as 4GB or 500MB", param_hint=option)
    size = int(float(found[1]) * _UNITS[unit])
    if size < _LEAST_BYTES:
        raise typer.BadParameter(f"{text!r} is too little for a worker; such as 4GB", param_hint=option)
    return size


def seconds_of(text: str, option: str) -> float:
    """A duration such as 90s, 30min or 1.5h, in seconds."""
    found = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*(s|min|h)\s*", text)
    if found is None or not float(found[1]):
        raise typer.BadParameter(f"{text!r} is no duration such as 90s, 30min or 2h", param_hint=option)
    return float(found[1]) * {"s": 1, "min": 60, "h": 3600}[found[2]]


def amounts(texts: Sequence[str]) -> dict[str, float]:
    """Resources such as GPU=1."""
    found = {}
    for text in texts:
        name, _, amount = text.partition("=")
        try:
            found[name] = float(amount)
        except ValueError:
            found[name] = -1.0
        if not name or not 0 < found[name] < float("inf"):
            raise typer.BadParameter(f"{text!r} is no NAME=AMOUNT such as GPU=1", param_hint="--resource")
    return found


def dry_run(asked: Asked) -> None:
    """Check and estimate only."""
    loaded = load_checked(asked.recipe, asked.overrides)
    place = place_of(asked.target)
    check_ours(place)
    settings, _ = check_recipe(loaded)
    before = _before(asked, loaded, place)
    expected = _expect(asked, loaded, settings, before, probe=True)
    for text in lines(expected):
        _say(text)
    if before.discarded:
        _say(f"--resume --discard would throw away {count(before.discarded, 'finished image')}: {before.reasons()}")
    check_fits(expected, place, workers_here=asked.engine == "local")
    _say("nothing was made")


def batch(asked: Asked) -> None:
    """Make the data set."""
    loaded = load_checked(asked.recipe, asked.overrides)
    place = place_of(asked.target)
    check_ours(place)
    check_resume(place, resume=asked.resume)
    settings, _ = check_recipe(loaded)
    before = _before(asked, loaded, place)
    check_discards(before, place.name, agreed=asked.discard)
    expected = _expect(asked, loaded, settings, before, probe=False)
    check_fits(expected, place, workers_here=asked.engine == "local")
    display = Display()
    for text in lines(expected):
        display.say(text)
    with stops_keep(display.kept), display.running():
        summary = run_batch(
            loaded,
            asked.target,
            count=asked.count,
            engine=_engine(asked, expected),
            resume=asked.resume,
            discard=asked.discard,
            retries=asked.retries,
            threads=asked.threads if asked.engine == "dask" else expected.threads,  # a Dask worker says how many it has
            memory_bytes=asked.memory_bytes,
            listener=display,
        )
    _tell(summary)
    if summary.failed:
        raise _incomplete(summary)


def _before(asked: Asked, loaded: LoadedRecipe, place: Place) -> Standing:
    """The finished images that are there."""
    first, versions = int(loaded.complete["first_image"]), versions_hash()
    images = range(first, first + asked.count)
    return standing(place, loaded, images, fingerprint(loaded, versions), versions, _say)


def _expect(
    asked: Asked, loaded: LoadedRecipe, settings: DatasetSettings, before: Standing, *, probe: bool
) -> Estimate:
    """What the images that are not made yet will take, with as many workers as cores and memory allow."""
    left = asked.count - before.kept
    if left and (probe or left >= LEAST_IMAGES) and not sys.stderr.isatty():  # no bar tells it there
        tell(f"making some images to measure them: about {BUDGET_S:.0f} s, and longer for large ones")
    with Bars().running() as bars:
        return estimate(
            loaded, settings, count=left, workers=asked.workers, threads=asked.threads, progress=bars, probe=probe
        )


def _engine(asked: Asked, expected: Estimate) -> Callable[[Work, Notice], Engine]:
    if asked.engine == "local":
        return lambda work, _: LocalEngine(work, expected.workers, make_job, timeout_s=asked.timeout_s)
    from forestgen.runs.engines.dask import DaskEngine  # loads Dask

    return lambda work, notice: DaskEngine(
        work,
        asked.scheduler,
        resources=asked.resources,
        job_memory_bytes=int(expected.memory_bytes.mean),
        notice=notice,
    )


def _tell(summary: BatchSummary) -> None:
    before = f", {summary.already:,} of them before" if summary.already else ""
    _say(f"{summary.already + summary.made:,} of {count(summary.images, 'image')} are done{before}")
    _say(f"{count(summary.frames, 'frame')}, {show_bytes(summary.bytes)}: {summary.target}")
    if summary.report:
        _say(f"to look at: {summary.report}")
    if summary.images_per_hour is not None:
        stages = ", ".join(f"{name} {100 * share:.0f} %" for name, share in list(summary.stage_shares.items())[:5])
        _say(f"{span(summary.seconds)}, {three_digits(summary.images_per_hour)} images an hour; time: {stages}")
    for note in summary.notes[:_MOST_NOTES]:
        _say(f"note: {note}")
    if len(summary.notes) > _MOST_NOTES:
        _say(f"note: {len(summary.notes) - _MOST_NOTES} more notes are in dataset.json")


def _incomplete(summary: BatchSummary) -> DatasetError:
    shown = [_failure(failed) for failed in summary.failed[:_MOST_FAILURES]]
    if len(summary.failed) > _MOST_FAILURES:
        shown.append(f"... and {len(summary.failed) - _MOST_FAILURES} more: run/log.jsonl has all")
    return DatasetError(
        f"{len(summary.failed):,} of {count(summary.images, 'image')} could not be made",
        where=summary.target,
        got="\n".join(shown),
        hint="the same command with --resume tries them again"
        if any(failed.kind in TRANSIENT for failed in summary.failed)
        else "they would fail again in the same way; the data set is finished without them",
    )


def _failure(failed: Failed) -> str:
    tries = count(failed.attempt, "attempt")
    return f"image {failed.job.image} ({failed.job.split}), {tries}, {failed.kind}: {failed.message}"


def _say(text: str) -> None:
    output().print(Text(text))
