"""Jobs, records, outcomes, options of runs, and the protocols of storage backends and engines.

A *job* is one scene with its cameras: an image of the recipe. Its key is the hash of all that its files depend on, so
that done work is recognised and changed work is done again. A worker makes a job's files in a staging folder, puts them
into the data set's storage, and writes the job's *record* last: a job is done if, and only if, its record is there.

The data set's folder::

    DIR/
      README.md  recipe.yaml  dataset.json  index.parquet  SHA256SUMS      of the whole, written last
      train/  val/  test/          a split each: frames, coco.json, ...
      thumbnails/                  FRAME.jpg
      maps/                        those that recipe.yaml names
      yolo_boxes.yaml  yolo_segmentation.yaml       of the format yolo, where there are train and val
      .forestgen/
        lock                       held by the run that writes here
        jobs/KEY.json              the records
        staging/                   work in progress; what lies here when a run starts is left from a dead one
        previous/                  while a run replaces it: the data set that was there
        written.json               files over all images, in the splits and beside them
      run/                         how it went: log.jsonl, jobs.parquet. With report.html all that two runs differ in

Everything outside `run/`, `report.html` and `.forestgen/` is the same to the last byte for the same recipe, count and
versions: whatever the number of workers, the engine, and the interruptions.
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal, Protocol

from pydantic import BaseModel, ConfigDict, Field

from forestgen.core.arguments import flag_of, shown, whole_of
from forestgen.core.errors import RecipeError
from forestgen.core.figures import parse_bytes
from forestgen.dataset.settings import DatasetSettings
from forestgen.recipe.load import LoadedRecipe

HIDDEN = ".forestgen"  # folder of records, lock and staging
RUN = "run"  # folder of what belongs to a run, not to the data set
RUN_DEPENDENT = (RUN, HIDDEN, "report.html")  # names in the data set's folder whose bytes may differ between runs

ENGINES = ("local", "dask")
DEVICES = ("llvm", "cuda")
_LEAST_BYTES = 10**8  # less is a mistake, such as a number without its unit: Python and Mitsuba alone take more


Count = Annotated[int, Field(ge=0, lt=2**63)]  # of a `Stored`


class Stored(BaseModel):
    """A part of a file that anybody may have written: each value is of its type, other keys do not count."""

    model_config = ConfigDict(strict=True)


@dataclass(frozen=True)
class Job:
    """One image to make."""

    index: int  # argument of LoadedRecipe.draw
    image: int  # number in the frames' names: the recipe's first_image + index
    split: str
    key: str  # the image's number and the hash of all that its files depend on; see `records.job_key`


@dataclass(frozen=True)
class JobRecord:
    """What a finished job left in the data set: the same for every run that makes it."""

    key: str
    image: int
    split: str
    image_seed: int
    recipe_hash: str  # of the drawn recipe
    rows: tuple[dict[str, Any], ...]  # of its frames, dataset/index.py
    files: Mapping[str, Mapping[str, Any]]  # path below the data set's folder -> {"bytes": , "sha256": }
    report: Mapping[str, Any] = field(default_factory=dict)  # its row in the split's manifest.json
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class JobRun:
    """How a job went: differs between runs."""

    image: int
    attempt: int  # from 1
    worker: str  # who did it, such as host:pid
    seconds: float
    timings_s: Mapping[str, float] = field(default_factory=dict)  # by stage
    peak_memory_bytes: int = 0


@dataclass(frozen=True)
class Done:
    """A job that was finished; its record is written."""

    job: Job
    record: JobRecord
    run: JobRun


FailureKind = Literal["recipe", "memory", "output", "renderer", "worker", "time", "bug"]
# A failure of these kinds may pass: the job is tried again. The others would fail again.
TRANSIENT: tuple[FailureKind, ...] = ("memory", "output", "worker", "time")

Notice = Callable[[str, Mapping[str, str]], None]  # called with an event of the log and its fields: worker, message


@dataclass(frozen=True)
class Failed:
    """A job that was not finished; nothing of it is left in the data set."""

    job: Job
    attempt: int
    kind: FailureKind
    message: str  # for people: where, expected, got, hint; of a bug its type and text
    seconds: float = 0.0
    worker: str = ""
    error: Exception | None = field(default=None, repr=False, compare=False)  # where this process had it


Outcome = Done | Failed


class Lock(Protocol):
    """Keeps other runs out of a storage backend."""

    def check(self) -> None:
        """Raise `OutputError` if it was lost to another run; cheap."""


class StorageBackend(Protocol):
    """Where a data set lies: a folder, or an object store. Picklable; paths are relative, with forward slashes."""

    @property
    def name(self) -> str:
        """As the user wrote it, for messages."""

    def lock(self, say: Callable[[str], None]) -> AbstractContextManager[Lock]:
        """For the run that writes there; raises `OutputError` if another one does.

        `say` takes a sentence when there is something to wait for.
        """

    def staging(self) -> Path:
        """A new empty folder of this machine for one job's files; `put_folder` and `put_file` take from it."""

    def discard(self, staging: Path) -> None:
        """Remove a staging folder, if it is there."""

    def put_folder(self, source: Path, target: str) -> None:
        """Give a staged folder its final name, replacing what has it. A failure raises `OutputError`.

        It appears whole. In an object store each file does; the record, written last, says that all are there.
        """

    def put_file(self, source: Path, target: str) -> None:
        """The same for one file."""

    def write(self, target: str, content: bytes) -> None:
        """Write a small file: it appears whole, and replaces what has the name."""

    def read(self, path: str) -> bytes | None:
        """A file's bytes; None if there is none."""

    def exists(self, path: str) -> bool:
        """Whether there is a file, or a folder with a file in it."""

    def size_bytes(self, path: str) -> int | None:
        """Of a file; None if there is none."""

    def names(self, folder: str) -> list[str]:
        """Names of what lies in a folder, sorted; empty if there is no such folder."""

    def found(self, folder: str) -> Iterator[tuple[str, int, int]]:
        """Path, size in bytes and inode, or 0, of each file below a folder."""

    def clear_staging(self) -> None:
        """Remove what abandoned jobs have left."""

    def remove(self, path: str) -> None:
        """Remove a file, or a folder with all in it, if it is there."""


@dataclass(frozen=True)
class RunOptions:
    """What `render` and `batch` may be asked for besides the recipe and the folder; they take checked ones."""

    count: int | None = None  # images of the data set, in all; None: as many as the recipe says
    resume: bool = False  # go on in a data set that is there
    discard: bool = False  # with resume: remove finished images that do not belong to the data set any more
    overwrite: bool = False  # replace a previous data set
    threads: int | None = None  # of the renderer, in each worker; None: all cores are shared out
    workers: int | None = None  # processes; None: as many as cores and memory allow
    worker_memory: int | str | None = None  # bytes, or a text such as 4GB; a worker that takes more is stopped
    timeout: float | str | None = None  # seconds, or a text such as 30min, that an image may take
    retries: int = 2  # further attempts at an image whose failure may pass
    engine: str = "local"  # or dask
    scheduler: str | None = None  # address of a Dask scheduler
    resources: Mapping[str, float] | None = None  # that each image takes of a Dask worker
    device: str | None = None  # what traces rays, llvm or cuda; None: what FORESTGEN_TRACING says

    @classmethod
    def of(cls, arguments: Mapping[str, Any]) -> RunOptions:
        """The options among the arguments of a call, checked."""
        return cls(**{one.name: arguments[one.name] for one in fields(cls) if one.name in arguments}).check()

    def check(self) -> RunOptions:
        """The same with Python's own numbers.

        Raises `RecipeError`: values that are none, or options that exclude one another.
        """
        numbers: dict[str, Any] = {"retries": whole_of(self.retries, "retries", 0, 100)}
        for name, most in (("count", 10**8), ("threads", 4096), ("workers", 1024)):
            if getattr(self, name) is not None:
                numbers[name] = whole_of(getattr(self, name), name, 1, most)
        for name in ("resume", "discard", "overwrite"):
            flag_of(getattr(self, name), name)
        for name, value, known in (("device", self.device, (None, *DEVICES)), ("engine", self.engine, ENGINES)):
            if value not in known:
                expected = " or ".join(one for one in known if one)
                raise RecipeError(f"no such {name}", parameter=name, expected=expected, got=shown(value))
        self._check_together()
        resources: Any = self.resources or {}
        for key, amount in resources.items() if isinstance(resources, Mapping) else [(None, resources)]:
            if not (isinstance(key, str) and isinstance(amount, int | float) and 0 < amount < math.inf):
                expected, got = "a mapping such as {'GPU': 1}", shown(self.resources)
                raise RecipeError("these are no resources", parameter="resources", expected=expected, got=got)
        _ = self.memory_bytes, self.timeout_s  # which refuse texts that are no size and no duration
        return replace(self, **numbers)

    def _check_together(self) -> None:
        """Refuse options that exclude one another."""
        is_dask = self.engine == "dask"
        of_dask = self.scheduler is not None or bool(self.resources)
        for wrong, option, why in (
            (self.discard and not self.resume, "discard", "it belongs to `resume`"),
            (self.resume and self.overwrite, "overwrite", "it replaces the data set, which `resume` goes on with"),
            (of_dask and not is_dask, "engine", "`scheduler` and `resources` belong to `engine='dask'`"),
            (is_dask and self.workers is not None, "workers", "the cluster has its own workers"),
            (is_dask and self.timeout is not None, "timeout", "only workers of this machine can be stopped"),
            (
                is_dask and self.worker_memory is not None,
                "worker_memory",
                "`dask worker` takes its own, `--memory-limit`",
            ),
            (is_dask and self.device is not None, "device", "set FORESTGEN_TRACING where the workers start"),
        ):
            if wrong:
                raise RecipeError(f"this option cannot be used here: {why}", parameter=option)

    @property
    def memory_bytes(self) -> int | None:
        if self.worker_memory is None:
            return None
        size = parse_bytes(self.worker_memory, "worker_memory")
        if size < _LEAST_BYTES:
            problem = "this is too little for a worker"
            raise RecipeError(problem, parameter="worker_memory", expected="such as 4GB", got=shown(self.worker_memory))
        return size

    @property
    def timeout_s(self) -> float | None:
        """Seconds, of a number or of a text such as 90s, 30min or 1.5h. Raises `RecipeError`."""
        given = self.timeout
        if given is None:
            return None
        if isinstance(given, int | float) and not isinstance(given, bool) and 0 < given < sys.maxsize:
            return float(given)
        found = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*(s|min|h)\s*", given if isinstance(given, str) else "")
        if found is None or not float(found[1]):
            expected = "such as 90s, 30min or 2h"
            raise RecipeError("no such duration", parameter="timeout", expected=expected, got=shown(given))
        return float(found[1]) * {"s": 1, "min": 60, "h": 3600}[found[2]]


@dataclass(frozen=True)
class Work:
    """What a worker needs for any job of a batch; sent to it once."""

    loaded: LoadedRecipe
    settings: DatasetSettings
    storage: StorageBackend
    versions: str  # hash of code and packages, as it is where the batch was started: `records.versions_hash`
    threads: int | None = None  # of the renderer in each worker; None: all cores
    memory_bytes: int | None = None  # that a worker may take; None: no bound


class Engine(Protocol):
    """A context manager that does jobs. It never tries a job twice: runs/run.py decides that."""

    def __enter__(self) -> Engine: ...

    def __exit__(self, *_: object) -> None:
        """Stop all workers at once; jobs in flight are given up."""

    @property
    def workers(self) -> int:
        """How many there are now."""

    def submit(self, job: Job, attempt: int) -> None:
        """Queue a job."""

    def wait(self, timeout_s: float) -> list[Outcome]:
        """Outcomes since the last call, in any order; waits for the first one, at most so long."""
