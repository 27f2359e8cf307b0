"""Records of finished jobs: what they say, and where they lie."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from forestgen.core.errors import DatasetError
from forestgen.dataset.safe_path import is_frame, is_inside, is_split, load_json
from forestgen.runs.contract import HIDDEN, JobRecord, Place
from forestgen.runs.keys import image_of_key
from forestgen.runs.parallel import in_order

JOBS = f"{HIDDEN}/jobs"
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
    content = {
        "schema": _SCHEMA,
        "key": record.key,
        "image": record.image,
        "split": record.split,
        "image_seed": record.image_seed,
        "recipe_hash": record.recipe_hash,
        "rows": list(record.rows),
        "files": {path: dict(record.files[path]) for path in sorted(record.files)},
        "report": dict(record.report),
        "notes": list(record.notes),
    }
    body = json.dumps(content, separators=(",", ":"), ensure_ascii=False)[:-1].encode()
    return body + _SUM + hashlib.sha256(body).hexdigest().encode() + b'"}\n'


def read_record(content: bytes, where: str) -> JobRecord:
    """A record from its bytes; `where` names it in the `DatasetError` of one that is damaged or of another version."""
    try:
        data = load_json(content)
        if hashlib.sha256(content.rpartition(_SUM)[0]).hexdigest() != data["sha256"]:
            raise ValueError("its content has not its own SHA-256")
        if data["schema"] != _SCHEMA:
            raise _of_another_version(data["schema"], where)
        record = JobRecord(
            key=_text(data["key"]),
            image=_number(data["image"]),
            split=_split(data["split"]),
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


def _of_another_version(schema: Any, where: str) -> DatasetError:
    """What is told of a record that is whole, and not of this format."""
    return DatasetError(
        "this record of a finished image is of another version of forestgen",
        where=where,
        expected=_SCHEMA,
        got=f"{schema!r:.40}",
        hint=_AGAIN + "; or take the version that made it",
    )


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError(f"{value!r:.40} is no text")
    return value


def _number(value: Any) -> int:
    if type(value) is not int or not 0 <= value < 2**63:
        raise ValueError(f"{value!r:.40} is no number of 63 bits")
    return value


def _row(value: Any) -> dict[str, Any]:
    """A frame's row of the index; its name becomes a path too."""
    row = dict(value)
    if not is_frame(row["frame"]):
        raise ValueError(f"{row['frame']!r:.60} is no frame's name")
    return row


def _path(value: Any) -> str:
    """A file's path below the data set's folder."""
    if not is_inside(value) or value.partition("/")[0] == HIDDEN:
        raise ValueError(f"{value!r:.80} is no path of an image's file")
    return str(value)


def _file(value: Any) -> dict[str, Any]:
    said = dict(value)
    if not _SHA256.fullmatch(_text(said["sha256"])):
        raise ValueError(f"{value!r:.80} is no SHA-256")
    return {"bytes": _number(said["bytes"]), "sha256": said["sha256"]}


def _split(value: Any) -> str:
    if not is_split(value):
        raise ValueError(f"{value!r:.40} is no split's name")
    return str(value)


def done_keys(place: Place) -> set[str]:
    """Keys of the jobs whose records are there."""
    return set(_keys(place))


def records_of(place: Place, note: Callable[[str], None] | None = None) -> Iterator[JobRecord]:
    """All records, by image; one at a time in memory, or nearly.

    Parameters
    ----------
    note : told of each damaged record, which is left out.
    """
    keys = sorted(_keys(place), key=lambda key: (image_of_key(key), key))

    def read(path: str) -> tuple[str, bytes | None]:
        return path, place.read(path)

    with ThreadPoolExecutor(_READERS, "records") as readers:  # an object store answers slowly, but many at a time
        for path, content in in_order(readers, read, map(record_path, keys)):
            record = _read_or_note(path, content, note)
            if record is not None:
                yield record


def _read_or_note(path: str, content: bytes | None, note: Callable[[str], None] | None) -> JobRecord | None:
    try:
        record = read_record(content if content is not None else b"", path)
    except DatasetError as error:
        if note is not None:
            note(f"{path}: {error.problem}; it does not count")
        return None
    return record if record_path(record.key) == path else None  # a copy under another name vouches for nothing


def _keys(place: Place) -> Iterator[str]:
    """Keys by the records' names; other files that lie there are no records."""
    for name in place.names(JOBS):
        key = name.removesuffix(_ENDING)
        if key != name and image_of_key(key) >= 0:
            yield key
