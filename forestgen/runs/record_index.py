"""What all records of a data set say, in order, outside of memory: a SQLite file that is gone when it is closed.

Records come one at a time, in any order; the files over all images need their frames by name and their files by path,
more of them than memory should hold.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from forestgen.core.errors import DatasetError, OutputError
from forestgen.dataset.index import check_row
from forestgen.runs.contract import JobRecord

_TABLES = """
CREATE TABLE images (image INTEGER PRIMARY KEY, key TEXT, split TEXT, seed INTEGER, report TEXT, notes TEXT);
CREATE TABLE frames (name TEXT PRIMARY KEY, split TEXT, image INTEGER, row TEXT) WITHOUT ROWID;
CREATE TABLE files (path TEXT PRIMARY KEY, bytes INTEGER, sha256 TEXT) WITHOUT ROWID;
CREATE TABLE claims (path TEXT, image INTEGER, PRIMARY KEY (path, image)) WITHOUT ROWID;
CREATE TABLE found (path TEXT PRIMARY KEY, bytes INTEGER, inode INTEGER) WITHOUT ROWID;
"""


@dataclass(frozen=True)
class FileSum:
    """A file of the data set."""

    path: str  # below its folder
    bytes: int
    sha256: str


class RecordIndex:
    """A context manager; a failure of the disk that the file lies on leaves its block as an `OutputError`."""

    def __init__(self) -> None:
        self._scratch = TemporaryDirectory(prefix="forestgen-records-")
        try:
            self._base = sqlite3.connect(Path(self._scratch.name) / "records.sqlite", isolation_level=None)
            for pragma in ("journal_mode=OFF", "synchronous=OFF", "cache_size=-8000"):  # kB; no crash leaves it
                self._base.execute(f"PRAGMA {pragma}")
            self._base.executescript(_TABLES)
            self._base.execute("BEGIN")
        except sqlite3.OperationalError as error:
            self._scratch.cleanup()
            raise self._failed(error) from error

    def __enter__(self) -> RecordIndex:
        return self

    def __exit__(self, _: object, error: BaseException | None, __: object) -> None:
        self._base.close()
        self._scratch.cleanup()
        if isinstance(error, sqlite3.OperationalError):
            raise self._failed(error) from error

    def _failed(self, error: sqlite3.OperationalError) -> OutputError:
        hint = "free some space there, or name a folder on another disk in TMPDIR"
        return OutputError(f"cannot write the table of all files: {error}", where=self._scratch.name, hint=hint)

    # -- writing

    def add(self, record: JobRecord) -> None:
        """Enter a record.

        Raises `DatasetError`: an image, a frame's name or a file that another record has as something else; or a row
        that the index cannot hold.
        """
        where, names = f"image {record.image}", [str(row["frame"]) for row in record.rows]
        try:
            for row in record.rows:
                check_row(row)
        except ValueError as error:
            raise DatasetError("a row of this record is none of the index", where=where, got=str(error)) from error
        known = self._column("SELECT image FROM images WHERE image = ?", record.image)
        if known or any(self._column("SELECT image FROM frames WHERE name = ?", name) for name in names):
            raise DatasetError("two records are of one image or frame", where=where, got=", ".join(names))
        report, notes = json.dumps(record.report, sort_keys=True), json.dumps(record.notes)
        self._base.execute(
            "INSERT INTO images VALUES (?, ?, ?, ?, ?, ?)",
            (record.image, record.key, record.split, record.image_seed, report, notes),
        )
        self._base.executemany(
            "INSERT INTO frames VALUES (?, ?, ?, ?)",
            [(name, record.split, record.image, json.dumps(row)) for name, row in zip(names, record.rows, strict=True)],
        )
        for path, entry in record.files.items():
            self.add_file(FileSum(path, int(entry["bytes"]), str(entry["sha256"])), record.image)

    def add_file(self, file: FileSum, image: int | None = None) -> None:
        """Enter a file; of an image, or over several. Images may share one, as maps are, if it is the same."""
        known = self.file(file.path)
        if known is None:
            self._base.execute("INSERT INTO files VALUES (?, ?, ?)", (file.path, file.bytes, file.sha256))
        elif known != file:
            raise DatasetError(
                "two images have different files of one name", where=file.path, expected=known.sha256, got=file.sha256
            )
        if image is not None:
            self._base.execute("INSERT OR IGNORE INTO claims VALUES (?, ?)", (file.path, image))

    def drop_absent(self) -> Iterator[tuple[int, str, str]]:
        """Drop each image whose files are not all there in their sizes: the image, its key, and the first such file.

        The files that no other image claims are dropped with it.
        """
        query = """SELECT image, key, min(path) FROM claims JOIN files USING (path) JOIN images USING (image)
                   LEFT JOIN found USING (path)
                   WHERE found.bytes IS NULL OR found.bytes != files.bytes GROUP BY image ORDER BY image"""
        for image, key, path in self._base.execute(query).fetchall():
            self._base.execute("CREATE INDEX IF NOT EXISTS claims_by_image ON claims (image)")
            self._base.execute("CREATE INDEX IF NOT EXISTS frames_by_image ON frames (image)")
            own = self._column("SELECT path FROM claims WHERE image = ?", image)
            for table in ("claims", "frames", "images"):
                self._base.execute(f"DELETE FROM {table} WHERE image = ?", (image,))
            for each in own:
                if not self._column("SELECT image FROM claims WHERE path = ? LIMIT 1", each):
                    self._base.execute("DELETE FROM files WHERE path = ?", (each,))
            yield image, key, path

    def note_found(self, files: Iterable[tuple[str, int, int]]) -> None:
        """Enter what lies in the data set: path, size in bytes, inode or 0."""
        # A name that is no UTF-8 has half characters in Python, which no text here may have.
        rows = ((path.encode("utf-8", "backslashreplace").decode(), size, inode) for path, size, inode in files)
        self._base.executemany("INSERT OR REPLACE INTO found VALUES (?, ?, ?)", rows)

    # -- reading

    @property
    def splits(self) -> list[str]:
        """Names of the splits that have images."""
        return self._column("SELECT DISTINCT split FROM images ORDER BY split")

    def has_key(self, key: str) -> bool:
        """Whether a job of this key is in the data set."""
        number, _, _ = key.partition("-")
        return number.isdecimal() and self._column("SELECT key FROM images WHERE image = ?", int(number)) == [key]

    def images(self) -> Iterator[int]:
        """Numbers of the images, rising."""
        yield from self._each("SELECT image FROM images ORDER BY image")

    def seeds(self, split: str | None = None) -> Iterator[int]:
        """Seeds of the images, by image."""
        yield from self._each("SELECT seed FROM images WHERE ?1 IS NULL OR split = ?1 ORDER BY image", split)

    def shared_seed(self) -> list[tuple[int, int, str]]:
        """Seed, number and split of the images of a seed that several splits have: these show one stand."""
        shared = "SELECT seed FROM images GROUP BY seed HAVING COUNT(DISTINCT split) > 1 ORDER BY seed LIMIT 1"
        query = f"SELECT seed, image, split FROM images WHERE seed = ({shared}) ORDER BY image"
        return self._base.execute(query).fetchall()

    def reports(self, split: str) -> Iterator[dict[str, Any]]:
        """The manifest's report of each image."""
        yield from map(json.loads, self._each("SELECT report FROM images WHERE split = ? ORDER BY image", split))

    def notes(self, split: str) -> Iterator[str]:
        """Notes of the images."""
        for text in self._each("SELECT notes FROM images WHERE split = ? ORDER BY image", split):
            yield from json.loads(text)

    def frames(self, split: str) -> Iterator[str]:
        """Names of a split's frames, sorted."""
        yield from self._each("SELECT name FROM frames WHERE split = ? ORDER BY name", split)

    def rows(self) -> Iterator[dict[str, Any]]:
        """Rows of the index, by frame."""
        yield from map(json.loads, self._each("SELECT row FROM frames ORDER BY image, name"))

    def counts(self, split: str) -> dict[str, int]:
        """How many images and frames a split has."""
        query = "SELECT count(*) FROM {} WHERE split = ?"
        return {table: int(self._column(query.format(table), split)[0]) for table in ("images", "frames")}

    def files(self, folder: str = "") -> Iterator[FileSum]:
        """Files by path: all, or those below a folder."""
        low, high = _below(folder)
        query = "SELECT path, bytes, sha256 FROM files WHERE path >= ? AND path < ? ORDER BY path"
        yield from (FileSum(*row) for row in self._base.execute(query, (low, high)))

    def file(self, path: str) -> FileSum | None:
        """A file by its path."""
        found = self._base.execute("SELECT path, bytes, sha256 FROM files WHERE path = ?", (path,)).fetchone()
        return None if found is None else FileSum(*found)

    def file_of_inode(self, inode: int, folder: str) -> FileSum | None:
        """The image's file below a folder that was found with this inode; None if there is none."""
        self._base.execute("CREATE INDEX IF NOT EXISTS by_inode ON found (inode)")
        query = """SELECT path FROM found JOIN claims USING (path)
                   WHERE inode = ? AND path >= ? AND path < ? ORDER BY path LIMIT 1"""
        found = self._column(query, inode, *_below(folder))
        return self.file(found[0]) if found else None

    def lost(self) -> Iterator[str]:
        """Paths of files that were not found."""
        yield from self._each("SELECT path FROM files WHERE path NOT IN (SELECT path FROM found) ORDER BY path")

    def present(self) -> Iterator[FileSum]:
        """Files of the data set that were found, in the sizes that they have now; by path."""
        query = "SELECT path, found.bytes, sha256 FROM files JOIN found USING (path) ORDER BY path"
        yield from (FileSum(*row) for row in self._base.execute(query))

    def unlisted(self) -> Iterator[str]:
        """Paths of what was found and is no file of the data set."""
        yield from self._each("SELECT path FROM found WHERE path NOT IN (SELECT path FROM files) ORDER BY path")

    def has_below(self, folder: str) -> bool:
        """Whether the data set has a file below a folder."""
        return bool(self._column("SELECT path FROM files WHERE path >= ? AND path < ? LIMIT 1", *_below(folder)))

    def _each(self, query: str, *values: Any) -> Iterator[Any]:
        return (row[0] for row in self._base.execute(query, values))

    def _column(self, query: str, *values: Any) -> list[Any]:
        return list(self._each(query, *values))


def _below(folder: str) -> tuple[str, str]:
    """Bounds of the paths below a folder; those of the whole data set for ""."""
    return (f"{folder}/", f"{folder}0") if folder else ("", "\U0010ffff")
