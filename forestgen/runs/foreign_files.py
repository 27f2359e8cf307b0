"""What lies in a data set's folder and is not forestgen's: a user's own files, and those of other tools.

Of a finished data set SHA256SUMS tells; of one that is not, the images' records, the names that forestgen gives in any
data set, and the list of the files over all images that it keeps (`folder.note_written`).
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from itertools import chain, count
from pathlib import Path
from tempfile import TemporaryDirectory

from forestgen.core.errors import DatasetError, OutputError
from forestgen.dataset.check import Finding
from forestgen.dataset.foreign import tool_of
from forestgen.dataset.safe_path import SafePath, is_frame
from forestgen.dataset.thumbnails import FOLDER_NAME as THUMBNAILS
from forestgen.recipe.assets import MAPS
from forestgen.runs.contract import HIDDEN, RUN, Place
from forestgen.runs.folder import splits_before, written_paths
from forestgen.runs.ledger import FileSum, Ledger
from forestgen.runs.places import LocalPlace
from forestgen.runs.records import records_of
from forestgen.runs.verify_files import enter_sums

_MAP = rf"{MAPS}/[0-9a-f]{{16}}\.[^/]+"
_TOP = re.compile(
    rf"{HIDDEN}/.*|README\.md|dataset\.json|index\.parquet|SHA256SUMS|report\.html|recipe(-[0-9]+)?\.yaml"
    rf"|{_MAP}|{RUN}/(log\.jsonl|jobs\.parquet|summary\.json)"
)
_OF_SPLIT = re.compile(rf"(classes|manifest)\.json|{_MAP}")
_FOLDERS = (HIDDEN, RUN, MAPS, THUMBNAILS)
_MOST_NAMED = 10


def foreign_files(root: Path) -> list[str]:
    """Paths of what forestgen has not written, sorted; of a folder in which all is, only the folder.

    Parameters
    ----------
    root : the data set's folder, finished or not.

    Raises
    ------
    OutputError : it cannot be read, or the disk of temporary files is full.
    """
    place = LocalPlace(root)
    with TemporaryDirectory(prefix="forestgen-foreign-") as scratch, Ledger(Path(scratch)) as ledger:
        refused: list[Finding] = []
        is_whole = enter_sums(root, ledger, refused) and not refused
        splits = set(splits_before(place))
        for record in records_of(place):
            splits.add(record.split)
            for path, said in record.files.items():
                with suppress(DatasetError):  # two records, or a record and SHA256SUMS, disagree
                    ledger.add_file(FileSum(path, 0, str(said["sha256"])))
        try:
            return sorted(_foreign_in(root, ledger, splits, is_whole))
        except OSError as error:
            raise OutputError(f"cannot read: {error.strerror or error}", where=str(error.filename or root)) from error


def _foreign_in(root: Path, ledger: Ledger, splits: set[str], is_whole: bool) -> Iterator[str]:
    written = tuple(written_paths(LocalPlace(root)))

    def is_known(path: str) -> bool:
        """Whether the ledger has all that forestgen has written there."""
        return is_whole or (_is_in_frame(path, splits) and ledger.has_below("/".join(path.split("/")[:2])))

    def may_be_ours(path: str) -> bool:
        """Whether forestgen gives such names, or has noted that it writes there."""
        return _is_named(path, splits) or any(path == one or path.startswith(f"{one}/") for one in written)

    waiting = [""]
    while waiting:
        folder = waiting.pop()
        with os.scandir(root / folder) as entries:
            found = [(one.name, one.is_dir(follow_symlinks=False)) for one in entries]
        for name, is_folder in found:
            path = f"{folder}/{name}" if folder else name
            if not _is_text(path):  # forestgen writes no such name
                yield path
            elif path == HIDDEN or ledger.file(path) or _is_of_run(path):
                continue
            elif is_folder and (ledger.has_below(path) or path in _FOLDERS or path in splits):
                waiting.append(path)
            elif is_known(path) or not may_be_ours(f"{path}/" if is_folder else path):
                yield path


def _is_text(path: str) -> bool:
    try:
        return bool(path.encode())
    except UnicodeEncodeError:
        return False


def _is_of_run(path: str) -> bool:
    """Whether it is one of the files that SHA256SUMS does not list."""
    return path in ("SHA256SUMS", "report.html") or (path.startswith(f"{RUN}/") and _TOP.fullmatch(path) is not None)


def _is_named(path: str, splits: Iterable[str]) -> bool:
    """Whether forestgen gives such names, whatever the formats of the data set are."""
    folder, _, inside = path.partition("/")
    if folder == THUMBNAILS:
        return inside.endswith(".jpg") and is_frame(inside.removesuffix(".jpg"))
    of_split = _OF_SPLIT.fullmatch(inside) is not None or _is_in_frame(path, splits)
    return _TOP.fullmatch(path) is not None or (folder in splits and of_split)


def _is_in_frame(path: str, splits: Iterable[str]) -> bool:
    """Whether it is the folder of a frame, or lies in one."""
    split, _, inside = path.partition("/")
    return split in splits and is_frame(inside.partition("/")[0])


def check_replaceable(place: Place, splits: Iterable[str]) -> None:
    """Refuse to replace a data set in an object store, or one with users' files where the new one has its own.

    Files where only some formats have theirs are not refused: they are renamed when the new data set is there.

    Parameters
    ----------
    splits : names of the new one's.

    Raises
    ------
    OutputError
    """
    if not isinstance(place, LocalPlace):
        hint = "remove it there, or choose another"
        raise OutputError("only a folder of this machine can be replaced", where=place.name, hint=hint)
    if not place.names(""):
        return
    root, names = place.root, {*splits, *splits_before(place)}
    own = [path for path in foreign_files(root) if tool_of(path) is None]
    used = [path for path in own if any(_name_is_used(root, one, names) for one in _files(root, path, names))]
    if used:
        raise OutputError(
            "files that forestgen has not written lie where the new data set has its own",
            where=place.name,
            expected="none in frames' folders, and none of a name that forestgen gives",
            got=named(used),
            hint="move them away",
        )


def _files(root: Path, path: str, names: Iterable[str]) -> Iterator[str]:
    """A path and, of a folder that the new data set has as well, what lies in it."""
    yield path
    if path.partition("/")[0] in (*names, *_FOLDERS) and not (root / path).is_symlink():
        for folder, folders, files in os.walk(root / path):
            inside = Path(folder).relative_to(root).as_posix()
            yield from (f"{inside}/{name}" for name in (*folders, *files) if inside != ".")


def _name_is_used(root: Path, path: str, splits: set[str]) -> bool:
    """Whether the new data set may have a file there, or a folder where this is none."""
    is_folder = path in _FOLDERS or path in splits
    return _is_named(path, splits) or (is_folder and not SafePath(root, path).is_folder())


def move_foreign(source: Path, target: Path) -> list[str]:
    """Move what is not forestgen's from one data set's folder into another's; the paths that it has there.

    Files of other tools go only into folders that are there, and not into frames.

    Raises
    ------
    OSError : one cannot be moved; the others after it stay too.
    """
    splits = {*splits_before(LocalPlace(source)), *splits_before(LocalPlace(target))}
    kept: list[str] = []
    for path in foreign_files(source):
        if tool_of(path) is not None and (_is_in_frame(path, splits) or not (target / path).parent.is_dir()):
            continue
        _move(source, target, path, kept.append)
    return kept


def _move(source: Path, target: Path, path: str, note: Callable[[str], None]) -> None:
    old, new = source / path, target / path
    new.parent.mkdir(parents=True, exist_ok=True)
    if os.path.lexists(new):
        is_folder = old.is_dir() and new.is_dir() and not (old.is_symlink() or new.is_symlink())
        if tool_of(path) is not None and not is_folder:
            return  # the tool has made it again
        if is_folder and tool_of(path) is None:
            for inner in sorted(old.iterdir()):
                _move(source, target, f"{path}/{inner.name}", note)
            return
        new = free_name(new)
    old.rename(new)
    note(new.relative_to(target).as_posix())


def free_name(path: Path) -> Path:
    """`path` or, if something lies there, a name beside it."""
    names = (path.with_name(f"{path.name}.previous-{number}") for number in count(1))
    return next(one for one in chain([path], names) if not os.path.lexists(one))


def named(paths: list[str]) -> str:
    """Some of many paths, for people."""
    more = f" and {len(paths) - _MOST_NAMED:,} more" if len(paths) > _MOST_NAMED else ""
    return ", ".join(path.encode("utf-8", "backslashreplace").decode() for path in paths[:_MOST_NAMED]) + more
