"""Records of finished jobs: what they say, and where they lie."""

from __future__ import annotations

import hashlib
import json
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from typing import Annotated, Any, TypeVar

from pydantic import AfterValidator, Field

from forestgen.core.cache import code_hash
from forestgen.core.errors import DatasetError
from forestgen.dataset.safe_path import is_frame, is_inside, load_json, one_line
from forestgen.recipe.assets import scenes_dir
from forestgen.recipe.dataset import SplitName
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.map_files import recipe_hash
from forestgen.runs.contract import HIDDEN, Count, JobRecord, StorageBackend, Stored

# Everything that shapes a frame's files; the layers above only call it.
_SOURCES = (
    "architecture", "atmosphere", "community", "core", "dataset", "geometry", "labels", "lsystem", "plants", "recipe",
    "render", "scene", "instruments/instrument.py", "instruments/stand_table.py", "__init__.py", "pipeline.py",
)  # fmt: skip
# Of these, what only reads frames, writes the files over all of them, or checks and shows what people give and see.
_WITHOUT = (
    "community/fitting", "community/point_statistics.py", "community/summary.py",
    "dataset/card.py", "dataset/check", "dataset/exr_chunks.py",
    "dataset/frame.py", "dataset/index.py", "dataset/pack", "dataset/report",
)  # fmt: skip
_COMPUTE_WITH = (
    "numpy", "scipy", "numba", "pvlib", "mitsuba", "drjit", "mitsuba-oidn", "colour-science", "trimesh",
    "OpenEXR", "pillow", "pyarrow", "pycocotools", "laspy", "mmh3",
)  # fmt: skip


def job_key(drawn: DrawnRecipe, versions: str) -> str:
    """The image's number, then a hash, hexadecimal, of all that its files depend on.

    That is the drawn recipe, its seed, its split, and the versions that matter (`versions_hash`). The number is there
    for order: names of records sort by image, and tell which images are done before any is opened.
    """
    text = repr((versions, recipe_hash(drawn.data), drawn.image_seed, drawn.split))
    return f"{drawn.image_index:06d}-{hashlib.sha256(text.encode()).hexdigest()[:40]}"


def image_of_key(key: str) -> int:
    """Number of a key's image; -1 if it is no key."""
    number, _, rest = key.partition("-")
    return int(number) if number.isascii() and number.isdecimal() and len(rest) == 40 else -1


def versions_hash() -> str:
    """Hash of forestgen's code and tables, of the packages that it computes with, and of the kind of machine."""
    # Species and programs are not among the tables: a drawn recipe holds them.
    tables = tuple(scenes_dir() / kind for kind in ("climate", "modules", "spectra"))
    return code_hash(_SOURCES, _COMPUTE_WITH, tables, _WITHOUT)


TaskT = TypeVar("TaskT")
ResultT = TypeVar("ResultT")
JOBS = f"{HIDDEN}/jobs"
_TASKS_AHEAD = 64
_SCHEMA = "forestgen-job/1"
_ENDING = ".json"
_SUM = b',"sha256":"'
_READERS = 8
_AGAIN = "the command that made the data set, with `resume=True`, makes the image again"


def record_path(key: str) -> str:
    """Path of a job's record in the data set's folder."""
    return f"{JOBS}/{key}{_ENDING}"


def record_bytes(record: JobRecord) -> bytes:
    """A record as JSON: the same bytes for the same content; last comes the SHA-256 of what is before it."""
    content = {"schema": _SCHEMA, **vars(record), "files": {path: record.files[path] for path in sorted(record.files)}}
    body = json.dumps(content, separators=(",", ":"), ensure_ascii=False)[:-1].encode()
    return body + _SUM + hashlib.sha256(body).hexdigest().encode() + b'"}\n'


def _check_row(row: dict[str, Any]) -> dict[str, Any]:
    """Refuse a frame's row of the index that names none: the name becomes a path too."""
    if not is_frame(row.get("frame")):
        raise ValueError(f"{row.get('frame')!r:.80} is no frame's name")
    return row


def _check_path(path: str) -> str:
    """Refuse what is no path below the data set's folder, or is not an image's."""
    if not is_inside(path) or path.partition("/")[0] == HIDDEN:
        raise ValueError(f"{path!r:.80} is no path of an image's file")
    return path


class _StoredFile(Stored):
    bytes: Count
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


class _StoredRecord(Stored):
    """What may be a `JobRecord`: anybody may have written it."""

    key: str
    image: Count
    split: SplitName
    image_seed: Count
    recipe_hash: str
    rows: list[Annotated[dict[str, Any], AfterValidator(_check_row)]]
    files: dict[Annotated[str, AfterValidator(_check_path)], _StoredFile]
    report: dict[str, Any]
    notes: list[str]


def read_record(content: bytes, where: str) -> JobRecord:
    """A record from its bytes; `where` names it in the `DatasetError` of one that is damaged or of another version."""
    try:
        data = load_json(content)
        if hashlib.sha256(content.rpartition(_SUM)[0]).hexdigest() != data["sha256"]:
            raise ValueError("its content has not its own SHA-256")
        if data["schema"] != _SCHEMA:
            problem = "this record of a finished image is of another version of forestgen"
            hint = _AGAIN + "; or take the version that made it"
            raise DatasetError(problem, where=where, expected=_SCHEMA, got=f"{data['schema']!r:.40}", hint=hint)
        stored = _StoredRecord.model_validate(data).model_dump()
        record = JobRecord(**stored | {"rows": tuple(stored["rows"]), "notes": tuple(stored["notes"])})
        if record.image != image_of_key(record.key):
            raise ValueError(f"image {record.image} under the key {record.key:.60}")
        return record
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        problem, got = "this record of a finished image is damaged", f"{type(error).__name__}: {one_line(error)}"
        raise DatasetError(problem, where=where, expected=f"JSON, {_SCHEMA}", got=got, hint=_AGAIN) from error


def done_keys(storage: StorageBackend) -> set[str]:
    """Keys of the jobs whose records are there, by the records' names; other files that lie there are no records."""
    keys = {name.removesuffix(_ENDING) for name in storage.names(JOBS) if name.endswith(_ENDING)}
    return {key for key in keys if image_of_key(key) >= 0}


def records_of(storage: StorageBackend, note: Callable[[str], None] | None = None) -> Iterator[JobRecord]:
    """All records, by image; one at a time in memory, or nearly.

    `note`: called with a message for each damaged record, which is left out.
    """
    keys = sorted(done_keys(storage), key=lambda key: (image_of_key(key), key))

    def read(path: str) -> tuple[str, bytes]:
        return path, storage.read(path) or b""

    with ThreadPoolExecutor(_READERS, "records") as readers:  # an object store answers slowly, but many at a time
        for path, content in in_order(readers, read, map(record_path, keys)):
            try:
                record = read_record(content, path)
            except DatasetError as error:
                if note is not None:
                    note(f"{path}: {error.problem}; it does not count")
                continue
            if record_path(record.key) == path:  # a copy under another name is no record
                yield record


def in_order(pool: Executor, work: Callable[[TaskT], ResultT], tasks: Iterable[TaskT]) -> Iterator[ResultT]:
    """Results of `work` for each task, in the tasks' order; no more than a few are waiting."""
    waiting: deque[Future[ResultT]] = deque()
    for task in tasks:
        waiting.append(pool.submit(work, task))
        if len(waiting) >= _TASKS_AHEAD:
            yield waiting.popleft().result()
    while waiting:
        yield waiting.popleft().result()
