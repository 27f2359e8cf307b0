"""All that a report is made from: the data set's own files, and how its runs went.

Strange values are left out. Of run/log.jsonl a line is read at a time; lines that are damaged are counted.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, Field

from forestgen.core.errors import DatasetError, RecipeError
from forestgen.dataset.index import INDEX_NAME
from forestgen.dataset.png import LEGEND_NAME, class_palette, read_legend
from forestgen.dataset.report.frames import Frames, no_frames, read_frames
from forestgen.dataset.safe_path import SafePath, check_folder, load_json, reading

_LOG = "run/log.jsonl"
_LONGEST_LINE = 1_000_000  # bytes
MOST_MESSAGES = 40  # different ones that are kept
_MOST_CHARACTERS = 600  # of a message
_MOST_ATTEMPTS = 10_000  # of which the images are remembered


@dataclass
class Failure:
    """Attempts that ended with one message."""

    kind: str
    message: str
    attempts: int = 0
    images: dict[int, int] = field(default_factory=dict)  # image -> its last attempt that ended so


@dataclass
class RunLog:
    """What the logs of all runs on a data set say together."""

    lines: int = 0  # of the log that could be read
    runs: int = 0
    failures: list[Failure] = field(default_factory=list)
    failed_attempts: int = 0
    unlisted_attempts: int = 0  # with messages beyond `MOST_MESSAGES`
    workers_lost: int = 0
    damaged_lines: int = 0
    running_s: float = 0.0  # from the start of each run to its last line
    finished_s: list[float] = field(default_factory=list)  # running time at the end of each job, in order
    job_s: list[float] = field(default_factory=list)  # what each job took
    stage_s: dict[str, float] = field(default_factory=dict)  # over all jobs
    peak_memory_bytes: list[float] = field(default_factory=list)  # of each job's worker
    workers: set[str] = field(default_factory=set)
    done: set[int] = field(default_factory=set)  # images

    @property
    def images_per_hour(self) -> float | None:
        """Over all runs; None if the log does not say."""
        return 3600.0 * len(self.finished_s) / self.running_s if self.running_s > 0 and self.finished_s else None

    @property
    def given_up(self) -> list[int]:
        """Images with failed attempts and none that succeeded."""
        return sorted({image for one in self.failures for image in one.images} - self.done)


def read_run(folder: Path) -> RunLog | None:
    """All that is known of the runs on a data set; None where it has no log."""
    path = SafePath(folder, _LOG)
    if not path.is_file():
        return None
    log = RunLog()
    jobs: dict[int, Mapping[str, Any]] = {}  # image -> the event of its finished job
    failures: dict[tuple[str, str], Failure] = {}
    before_s, start_s = 0.0, None  # running time of the earlier runs; start of this one, of the clock
    for event in _events(path):
        if event is None:
            log.damaged_lines += 1
            continue
        log.lines += 1
        at_s, kind, image = _seconds_of(event.get("time")), event["event"], _whole(event.get("image"))
        if kind == "start":
            before_s, start_s = log.running_s, at_s
            log.runs += 1
        if at_s is not None:
            start_s = at_s if start_s is None else start_s
            log.running_s = max(log.running_s, before_s + at_s - start_s)
        if kind == "job_done" and image is None:
            log.damaged_lines += 1
        elif kind == "job_done" and image is not None:
            log.finished_s.append(log.running_s)
            jobs[image] = event
        elif kind == "worker_lost":
            log.workers_lost += 1
        elif kind == "job_failed":
            _add_failure(log, failures, event, image)
    log.failures = sorted(failures.values(), key=lambda one: (-one.attempts, one.kind, one.message))
    for image in sorted(jobs):
        _add_job(log, jobs[image])
    log.done.update(jobs)
    return log


def _events(path: SafePath) -> Iterator[dict[str, Any] | None]:
    """Lines of the log; None for one that is damaged."""
    with reading(path), path.open() as stream:
        for line in filter(bytes.strip, iter(lambda: stream.readline(_LONGEST_LINE), b"")):
            try:
                event = load_json(line)
            except ValueError:
                event = None
            yield event if isinstance(event, dict) and isinstance(event.get("event"), str) else None


def _add_failure(
    log: RunLog, failures: dict[tuple[str, str], Failure], event: Mapping[str, Any], image: int | None
) -> None:
    log.failed_attempts += 1
    key = str(event.get("kind", "?"))[:40], str(event.get("message", ""))[:_MOST_CHARACTERS]
    if key not in failures and len(failures) >= MOST_MESSAGES:
        log.unlisted_attempts += 1
        return
    failure = failures.setdefault(key, Failure(*key))
    failure.attempts += 1
    if image is not None and (image in failure.images or log.failed_attempts <= _MOST_ATTEMPTS):
        failure.images[image] = _whole(event.get("attempt")) or 1


def _add_job(log: RunLog, job: Mapping[str, Any]) -> None:
    seconds, memory = _number(job.get("seconds")), _number(job.get("peak_memory_bytes"))
    if seconds is not None:
        log.job_s.append(seconds)
    if memory:
        log.peak_memory_bytes.append(memory)
    if job.get("worker"):
        log.workers.add(str(job["worker"]))
    for stage, took in _of(job, "timings_s", dict).items():
        if (took_s := _number(took)) is not None:
            log.stage_s[stage] = log.stage_s.get(stage, 0.0) + took_s


def _number(value: Any) -> float | None:
    """A finite number of at least 0, or None."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value) or value < 0:
        return None
    return float(value)


def _whole(value: Any) -> int | None:
    return None if _number(value) is None else int(value)


def _seconds_of(text: Any) -> float | None:
    """An ISO 8601 time as seconds of the clock."""
    try:
        return datetime.fromisoformat(str(text)).timestamp()
    except (ValueError, OverflowError, OSError):
        return None


_CARD_NAME, _RUN_NAME = "dataset.json", "run"


@dataclass(frozen=True)
class Legend:
    """Names and colours of the masks' classes."""

    classes: tuple[str, ...] = ()  # by number
    colours: dict[str, str] = field(default_factory=dict)  # class -> #rrggbb
    categories: tuple[str, ...] = ()  # of instances

    def colour(self, name: str) -> str:
        """Of a class, or of a species that is one; "" for others: the page's own."""
        return self.colours.get(name, "")


class RecipeMetadata(BaseModel):
    """A recipe that images were drawn from."""

    file: str = ""
    hash: str = ""
    root_seed: int | str = ""
    images: int = 0  # that were asked for
    missing: list[tuple[int, int]] = []  # first and last image of each gap
    draws: dict[str, Any] = {}  # key -> its distribution as written


class _Versions(BaseModel):
    """What a kind of machine made images with."""

    platform: dict[str, str] = {}  # system and machine
    python: str = ""
    packages: dict[str, str | None] = {}

    def __str__(self) -> str:
        where = " ".join(self.platform[key] for key in ("system", "machine") if key in self.platform)
        versions = [f"{name} {version}" for name, version in sorted(self.packages.items()) if version]
        return ", ".join(filter(None, [where, self.python and f"Python {self.python}", *versions]))


class _FileGroup(BaseModel):
    bytes: Annotated[int, Field(ge=0)] = 0


class Metadata(BaseModel):
    """The data set as dataset.json describes it."""

    description: str = ""
    contributor: str = ""
    licence: dict[str, str] | None = None  # its name and url
    splits: dict[str, Any] = {}  # in the recipe's order
    recipes: list[RecipeMetadata] = []
    made_with: list[_Versions] = []
    files: dict[str, _FileGroup] = {}  # by kind

    @property
    def bytes(self) -> int:
        """Of all files; 0: not known."""
        return sum(one.bytes for one in self.files.values())

    @property
    def missing(self) -> list[tuple[int, int]]:
        """First and last image of each gap, over all recipes."""
        return [gap for recipe in self.recipes for gap in recipe.missing]

    @property
    def draws(self) -> dict[str, Any]:
        """Key -> distribution as written; of a key of several recipes the first one's."""
        return {key: value for recipe in reversed(self.recipes) for key, value in recipe.draws.items()}


@dataclass(frozen=True)
class Source:
    """A data set's folder, read."""

    folder: Path
    frames: Frames
    legend: Legend
    splits: tuple[str, ...]  # in the data set's order
    metadata: Metadata
    run: RunLog | None
    notes: tuple[str, ...] = ()  # of what could not be read


def open_source(folder: Path) -> Source:
    """Read a data set, finished or not; a folder of none raises `RecipeError`, a damaged index `DatasetError`."""
    check_folder(folder, "a folder that forestgen render, batch or merge wrote")
    notes: list[str] = []
    metadata = _read_metadata(folder, notes)
    if os.path.lexists(folder / INDEX_NAME):
        frames = read_frames(folder / INDEX_NAME)
    elif metadata is not None or (folder / _RUN_NAME).is_dir():
        frames = no_frames()
        notes.append("index.parquet is missing: the run has not ended, and can be resumed.")
    else:
        hint = "name a folder that forestgen render, batch or merge wrote"
        raise RecipeError("this is no data set of forestgen", where=str(folder), hint=hint)
    metadata = metadata or Metadata()
    splits = tuple(dict.fromkeys([*metadata.splits, *sorted(set(frames.split))]))
    return Source(folder, frames, _read_legend(folder, splits, notes), splits, metadata, read_run(folder), tuple(notes))


def _read_legend(folder: Path, splits: tuple[str, ...], notes: list[str]) -> Legend:
    """classes.json of the first split that has one: all splits have the same."""
    split = next((one for name in splits if ((one := SafePath(folder, name)) / LEGEND_NAME).is_file()), None)
    if split is None:
        return Legend()
    try:
        content = read_legend(split)
    except DatasetError:
        notes.append(f"{LEGEND_NAME} cannot be read.")
        return Legend()
    names = [content["semantic"][str(number)] for number in range(len(content["semantic"]))]
    colours = dict(zip(names, class_palette(len(names)).tolist(), strict=True))
    for number, name in enumerate(names):
        rgb = _of(_of(content, "semantic_colours", dict), str(number), list)
        if len(rgb) == 3 and all(isinstance(one, int) and 0 <= one < 256 for one in rgb):
            colours[name] = rgb
    hexadecimal = {name: "#{:02x}{:02x}{:02x}".format(*rgb) for name, rgb in colours.items()}
    return Legend(
        tuple(names),
        hexadecimal,
        tuple(content["categories"][str(number + 1)] for number in range(len(content["categories"]))),
    )


def _read_metadata(folder: Path, notes: list[str]) -> Metadata | None:
    """dataset.json; None where there is none that can be read."""
    try:
        return Metadata.model_validate(SafePath(folder, _CARD_NAME).read_json())
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError):
        notes.append(f"{_CARD_NAME} cannot be read.")
        return None


def _of(mapping: Any, key: str, kind: type) -> Any:
    """A mapping's value of a kind; an empty one where there is none, or it is of another kind."""
    value = mapping.get(key) if isinstance(mapping, dict) else None
    return value if isinstance(value, kind) else kind()
