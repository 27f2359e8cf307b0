"""Records of finished jobs: what they say, and where they lie."""

from __future__ import annotations

import hashlib
import json
import re
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from typing import Any, TypeVar

from forestgen.core.cache import code_hash
from forestgen.core.errors import DatasetError
from forestgen.dataset.safe_path import is_frame, is_inside, is_split, load_json
from forestgen.recipe.assets import scenes_dir
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.map_files import recipe_hash
from forestgen.runs.contract import HIDDEN, JobRecord, StorageBackend

# Everything that shapes a frame's files; the layers above only call it.
_SOURCES = (
    "architecture", "atmosphere", "community", "core", "dataset", "geometry", "labels", "lsystem", "plants", "recipe",
    "render", "scene", "__init__.py", "pipeline.py",
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
_SHA256 = re.compile(r"[0-9a-f]{64}")
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


def read_record(content: bytes, where: str) -> JobRecord:
    """A record from its bytes; `where` names it in the `DatasetError` of one that is damaged or of another version."""
    try:
        data = load_json(content)
        if hashlib.sha256(content.rpartition(_SUM)[0]).hexdigest() != data["sha256"]:
            raise ValueError("its content has not its own SHA-256")
        if data["schema"] != _SCHEMA:
            raise DatasetError(
                "this record of a finished image is of another version of forestgen",
                where=where,
                expected=_SCHEMA,
                got=f"{data['schema']!r:.40}",
                hint=_AGAIN + "; or take the version that made it",
            )
        record = JobRecord(
            key=_text(data["key"]),
            image=_number(data["image"]),
            split=str(_kept_if(is_split(data["split"]), data["split"], "split's name")),
            image_seed=_number(data["image_seed"]),
            recipe_hash=_text(data["recipe_hash"]),
            rows=tuple(_row(row) for row in data["rows"]),
            files={_path(path): _file(said) for path, said in data["files"].items()},
            report=dict(data["report"]),
            notes=tuple(_text(note) for note in data["notes"]),
        )
        if record.image != image_of_key(record.key):
            raise ValueError(f"image {record.image} under the key {record.key:.60}")
        return record
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        raise DatasetError(
            "this record of a finished image is damaged",
            where=where,
            expected=f"JSON, {_SCHEMA}",
            got=f"{type(error).__name__}: {error}",
            hint=_AGAIN,
        ) from error


def _kept_if(holds: bool, value: Any, what: str) -> Any:
    """A value that a record may have; `ValueError` for another."""
    if not holds:
        raise ValueError(f"{value!r:.80} is no {what}")
    return value


def _text(value: Any) -> str:
    return str(_kept_if(isinstance(value, str), value, "text"))


def _number(value: Any) -> int:
    return int(_kept_if(type(value) is int and 0 <= value < 2**63, value, "number of 63 bits"))


def _row(value: Any) -> dict[str, Any]:
    """A frame's row of the index; its name becomes a path too."""
    row = dict(value)
    _kept_if(is_frame(row["frame"]), row["frame"], "frame's name")
    return row


def _path(value: Any) -> str:
    """A file's path below the data set's folder."""
    is_file = is_inside(value) and value.partition("/")[0] != HIDDEN
    return str(_kept_if(is_file, value, "path of an image's file"))


def _file(value: Any) -> dict[str, Any]:
    digest = _text(value["sha256"])
    return {
        "bytes": _number(value["bytes"]),
        "sha256": _kept_if(_SHA256.fullmatch(digest) is not None, digest, "SHA-256"),
    }


def done_keys(storage: StorageBackend) -> set[str]:
    """Keys of the jobs whose records are there."""
    return set(_keys(storage))


def records_of(storage: StorageBackend, note: Callable[[str], None] | None = None) -> Iterator[JobRecord]:
    """All records, by image; one at a time in memory, or nearly.

    `note`: called with a message for each damaged record, which is left out.
    """
    keys = sorted(_keys(storage), key=lambda key: (image_of_key(key), key))

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


def _keys(storage: StorageBackend) -> Iterator[str]:
    """Keys by the records' names; other files that lie there are no records."""
    for name in storage.names(JOBS):
        key = name.removesuffix(_ENDING)
        if key != name and image_of_key(key) >= 0:
            yield key
