"""The data set's folder as a run finds it: ours or not, which images are done, what does not belong any more.

Files that other tools leave in it (`tool_of`) are no part of the data set, and no damage.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Collection, Iterable
from fnmatch import fnmatchcase

from forestgen.core.errors import DatasetError, OutputError
from forestgen.dataset.png import THUMBNAILS
from forestgen.dataset.safe_path import SafePath, is_frame, is_inside, is_split, load_json
from forestgen.recipe.assets import MAPS
from forestgen.recipe.load import LoadedRecipe
from forestgen.recipe.map_files import recipe_hash
from forestgen.runs.contract import HIDDEN, RUN, JobRecord, StorageBackend
from forestgen.runs.records import JOBS, read_record, record_path, records_of
from forestgen.runs.storage import STAGING, LocalStorage

BATCH = f"{HIDDEN}/batch.json"
PREVIOUS, MOVING, BEGUN = (f"{HIDDEN}/{name}" for name in ("previous", "moving", "begun"))  # see runs/replace.py
_WRITTEN = f"{HIDDEN}/written.json"
TAKEN = ("maps", "run", "thumbnails")  # names in the data set's folder that no split can have
_SCHEMA = "forestgen-batch/1"
# Without these folders a run would take finished images for unfinished ones.
_FOLDERS = (HIDDEN, JOBS, STAGING, RUN, PREVIOUS, MOVING, BEGUN)
_WHOLE = ("dataset.json", "SHA256SUMS")  # they say that the data set is complete: while a run works, it is not


def fingerprint(loaded: LoadedRecipe, versions: str) -> str:
    """Hash of all that any image of the recipe depends on.

    Where it is the same as before, so are all jobs' keys, and a batch of 50,000 images is resumed without drawing each.
    The recipe at the ends of its distributions brings in every file that some image may name.
    """
    whole = recipe_hash({name: value for name, value in loaded.complete.items() if name != "images"})
    ends = [recipe_hash(drawn.data) for drawn in loaded.probes()]
    return hashlib.sha256(repr((versions, whole, ends)).encode()).hexdigest()


def check_ours(storage: StorageBackend) -> None:
    """Refuse storage that holds something else: nothing in it is touched. Raises `OutputError`."""
    names = storage.names("")
    if isinstance(storage, LocalStorage) and storage.root.is_file():
        raise OutputError("the output is a file", where=storage.name, expected="a folder", hint="choose another name")
    begun = HIDDEN in names and set(names) <= {HIDDEN, RUN}  # a run that ended before it said what it makes
    if names and not begun and not _is_batch(storage):
        problem = "the folder is not empty and holds no forestgen data set"
        expected = "a new or empty folder, or a previous data set"
        got = ", ".join(names[:4]) + (", ..." if len(names) > 4 else "")
        raise OutputError(problem, where=storage.name, expected=expected, got=got, hint="choose another folder")
    if not isinstance(storage, LocalStorage):
        return
    linked = [name for name in names if (storage.root / name).is_symlink()]
    if linked:
        problem = "a part of the data set is a link to elsewhere: what a run removes and replaces must lie here"
        where = f"{storage.name}/{linked[0]}"
        raise OutputError(problem, where=where, hint="move it here; the whole folder may be a link")
    for name in _FOLDERS:
        if os.path.lexists(storage.root / name) and not SafePath(storage.root, name).is_folder():
            problem, where = "a part of the data set is no folder", f"{storage.name}/{name}"
            raise OutputError(problem, where=where, expected="a folder of its own, and no link", hint="move it away")


def check_resume(storage: StorageBackend, *, resume: bool) -> None:
    """Refuse to go on in a data set without `resume`. Raises `OutputError`."""
    if not resume and _is_batch(storage):
        raise OutputError(
            "the folder already holds a forestgen data set",
            where=storage.name,
            hint="`resume=True` goes on with it: images that are done stay, if the recipe still makes them; "
            "`overwrite=True` replaces it; or choose another folder",
        )


def is_made_from(storage: StorageBackend, mark: str) -> bool:
    """Whether all finished images were made from the recipe and by the versions of this `fingerprint`."""
    return (_state(storage) or {}).get("fingerprint") == mark


def images_in_frames(storage: StorageBackend, splits: Iterable[str]) -> set[int]:
    """Numbers of the images that have a frame's folder in these splits, or in those that the batch was begun with."""
    folders = {*splits, *splits_before(storage)}
    return {int(name.partition("-")[0]) for folder in folders for name in storage.names(folder) if is_frame(name)}


def open_batch(
    storage: StorageBackend,
    images: range,
    splits: Iterable[str],
    mark: str,
    note: Callable[[str], None],
    stale: frozenset[int] = frozenset(),
    damaged: Collection[int] = (),
) -> dict[int, str]:
    """Key of each image that is done; removes what does not belong, and what killed runs have left.

    Parameters
    ----------
    images : numbers of the images that are wanted.
    splits : that some of these images are in.
    mark : the `fingerprint`.
    note : called with damaged records.
    stale : finished images that would be made otherwise now; they stay until their turn comes.
    damaged : finished images that have lost a file or its content: what is left of them is removed.
    """
    splits, before = tuple(splits), splits_before(storage)
    listed = {split: set(storage.names(split)) for split in {*splits, *before}}
    for name in _WHOLE:  # before the first frame goes
        storage.remove(name)
    keys: dict[int, str] = {}
    recorded: set[str] = set()
    for record in records_of(storage, note):
        frames = _frames(record)
        is_wanted = record.image in images and record.split in splits
        is_wanted = is_wanted and record.image not in keys and record.image not in damaged
        if is_wanted and listed[record.split].issuperset(frames):
            keys[record.image] = record.key
            recorded.update(f"{record.split}/{frame}" for frame in frames)
            recorded.update(f"{THUMBNAILS}/{frame}.jpg" for frame in frames)
        else:
            forget(storage, record)
            if record.image in keys:  # two records of one image: the frames were those of either, and are gone
                storage.remove(record_path(keys.pop(record.image)))
    for folder, names in {**listed, THUMBNAILS: set(storage.names(THUMBNAILS))}.items():
        for name in sorted(names):  # frames and thumbnails of jobs that never came to their records
            if is_frame(name.removesuffix(".jpg")) and f"{folder}/{name}" not in recorded:
                storage.remove(f"{folder}/{name}")
    for split in set(before) - set(splits):
        storage.remove(split)
    settle_batch(storage, splits, "" if stale & keys.keys() else mark)
    return keys


def settle_batch(storage: StorageBackend, splits: Iterable[str], mark: str) -> None:
    """Write down what all records were made from; "" while some may be of another recipe."""
    content = {"schema": _SCHEMA, "fingerprint": mark, "splits": list(splits)}
    storage.write(BATCH, (json.dumps(content) + "\n").encode())


def forget_key(storage: StorageBackend, key: str) -> None:
    """Remove a record and its frames."""
    path = record_path(key)
    try:
        forget(storage, read_record(storage.read(path) or b"", path))
    except DatasetError:
        storage.remove(path)  # its frames are removed at the end: no record lists them


def forget(storage: StorageBackend, record: JobRecord) -> None:
    """Remove a record, then its files, so that no record is left without files."""
    storage.remove(record_path(record.key))
    for frame in _frames(record):
        storage.remove(f"{record.split}/{frame}")
        storage.remove(f"{THUMBNAILS}/{frame}.jpg")


def _frames(record: JobRecord) -> list[str]:
    """Names of a record's frames."""
    inside = (path.split("/") for path in record.files if path.startswith(f"{record.split}/"))
    return sorted({parts[1] for parts in inside if len(parts) > 2 and parts[1] != MAPS})


def _is_batch(storage: StorageBackend) -> bool:
    """Whether a batch's file is there or, if a disk has damaged it, images' records; or a data set to be put back."""
    if _state(storage) is not None or storage.names(JOBS):
        return True
    return any(f"{HIDDEN}/{name}" in (PREVIOUS, MOVING, BEGUN) for name in storage.names(HIDDEN))


def note_written(storage: StorageBackend, paths: Iterable[str]) -> None:
    """Write down that forestgen makes these files or folders over all images, before they get their names."""
    storage.write(_WRITTEN, json.dumps(sorted({*paths, *written_paths(storage)})).encode())


def written_paths(storage: StorageBackend) -> list[str]:
    """What `note_written` noted."""
    try:
        listing = load_json(storage.read(_WRITTEN) or b"")
    except ValueError:
        return []
    return [path for path in listing if is_inside(path)] if isinstance(listing, list) else []


def splits_before(storage: StorageBackend) -> list[str]:
    """The splits that the batch was begun with."""
    listing = (_state(storage) or {}).get("splits")
    names = listing if isinstance(listing, list) else []
    return [name for name in names if is_split(name) and name not in TAKEN]


def _state(storage: StorageBackend) -> dict[str, object] | None:
    """What batch.json says; None if there is none of ours."""
    content = storage.read(BATCH)
    try:
        state = load_json(content or b"")
    except ValueError:
        return None
    return state if isinstance(state, dict) and state.get("schema") == _SCHEMA else None


# Patterns match the name of a file, or of a folder with all that is in it.
_TOOLS: dict[str, tuple[str, ...]] = {
    "Ultralytics": ("*.cache",),  # what it has read of the labels
    "Hugging Face": (".cache", ".huggingface"),
    "FiftyOne": (".fiftyone*", "fiftyone.yml"),
    "macOS": (".DS_Store", "._*"),
    "Windows": ("Thumbs.db", "desktop.ini"),
    "a Linux desktop": (".directory", ".Trash-*"),
    "Jupyter": (".ipynb_checkpoints",),
    "Python": ("__pycache__",),
    "Git": (".git*",),
    "DVC": (".dvc*", "*.dvc"),
    "a network file system": (".nfs*",),  # files that were removed while in use
    "an editor": ("*~", ".*.swp", ".*.swo", ".#*", "#*#", ".idea", ".vscode"),
}
# Names before patterns: ".cache" is a folder of Hugging Face's.
_PATTERNS = sorted(
    ((one, tool) for tool, several in _TOOLS.items() for one in several), key=lambda pair: "*" in pair[0]
)


def tool_of(path: str) -> str | None:
    """The tool that makes files of this path below the data set's folder; None if forestgen knows none.

    A file that `SHA256SUMS` lists belongs to the data set, whatever its name.
    """
    return next((tool for name in path.split("/") for pattern, tool in _PATTERNS if fnmatchcase(name, pattern)), None)
