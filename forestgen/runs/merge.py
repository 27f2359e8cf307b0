"""Several data sets made one: pieces that machines have made apart, or data sets of different recipes.

Pieces of one recipe become what one run of all their images would have made, to the last byte. Data sets of different
recipes go together if they agree on species, classes and all else that one file says of all images, and if no image of
two has the same number.
"""

from __future__ import annotations

import heapq
import json
import os
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

from forestgen.core.arguments import flag_of
from forestgen.core.errors import DatasetError, OutputError, RecipeError, writing
from forestgen.core.progress import Progress, Silent
from forestgen.dataset.files import make_folder
from forestgen.dataset.folder import OutputFolder
from forestgen.dataset.manifest import file_sum, is_run_folder
from forestgen.dataset.safe_path import SafePath, unreadable
from forestgen.dataset.settings import DatasetSettings, first_difference
from forestgen.recipe.assets import MAPS
from forestgen.recipe.registries import DATASET_FORMATS
from forestgen.runs.contract import HIDDEN, JobRecord
from forestgen.runs.description import DATASET_NAME, MOST_IMAGES, RecipePart, settings_of, union_of
from forestgen.runs.finish import Finished, write_data_set
from forestgen.runs.folder import settle_batch
from forestgen.runs.record_index import RecordIndex
from forestgen.runs.records import JOBS, record_bytes, record_path, records_of
from forestgen.runs.replace import foreign_files, named
from forestgen.runs.storage import LocalStorage
from forestgen.runs.verify import open_data_set, refuse_address


@dataclass(frozen=True)
class Piece:
    """A data set to merge."""

    root: Path
    description: dict[str, Any]  # its dataset.json

    @property
    def storage(self) -> LocalStorage:
        return LocalStorage(self.root)

    @property
    def settings(self) -> DatasetSettings:
        return settings_of(self.description)


def merge(
    sources: Sequence[Path],
    target: Path,
    *,
    link: bool = False,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> Finished:
    """Merge finished data sets into a new one, which appears whole or not at all.

    `sources`: folders of data sets; their order does not matter to the result.
    `target`: absent, an empty folder, or with `overwrite` a data set without files of others, which is replaced.
    `link`: make hard links instead of copies, which are not read: files are shared with the sources. Copies are
    compared with the images' records on their way.

    Raises `RecipeError`: a folder is no finished data set, or two cannot be one.
    Raises `DatasetError`: a piece is damaged, or two pieces have different images of one number.
    Raises `OutputError`: the target cannot be written.
    """
    _check_target(target, sources, overwrite=overwrite)
    pieces = [_piece(root) for root in sources]
    _check_settings(pieces)
    parts = _parts(pieces)
    by_text = {json.dumps(one, sort_keys=True): one for piece in pieces for one in piece.description["made_with"]}
    made_with = [by_text[text] for text in sorted(by_text)]
    groups = [group for piece in pieces for group in piece.description["files"].values()]
    needed = 0 if link else sum(int(group["bytes"]) for group in groups)
    total = sum(int(piece.description["images"]) for piece in pieces)
    with OutputFolder(target, overwrite=overwrite, required_bytes=needed, is_ours=_is_data_set) as folder:
        storage = LocalStorage(folder, str(target))
        with RecordIndex() as record_index:
            with (progress or Silent()).stage("images", total) as advance:
                for piece, record in _records(pieces):
                    advance(1)
                    if piece is not None:
                        _take(piece, record, storage, link)
                        record_index.add(record)
            _check_seeds(record_index)
            done = write_data_set(storage, record_index, parts, pieces[0].settings, made_with, record_index.splits)
            settle_batch(storage, record_index.splits, "")
        storage.clear_staging()
    if len(made_with) > 1:
        done = replace(done, notes=(*done.notes, f"{len(made_with)} versions have made its images: see dataset.json"))
    return done


def _is_data_set(folder: Path) -> bool:
    return (folder / HIDDEN).is_dir() or (folder / DATASET_NAME).exists() or is_run_folder(folder)


def _check_target(target: Path, sources: Sequence[Path], *, overwrite: bool) -> None:
    if not sources:
        raise RecipeError("no data set is named", expected="at least one to merge")
    refuse_address(target)
    if flag_of(overwrite, "overwrite") and _is_data_set(target):  # what else may lie there, `OutputFolder` refuses
        with LocalStorage(target).lock(lambda _: None):  # `OutputError` while a run writes there
            if strange := foreign_files(target):
                problem, got = "files that forestgen has not written lie in the data set", named(strange)
                raise OutputError(problem, where=str(target), got=got, hint="move them away, or choose another folder")
    inside = [source for source in sources if target.resolve().is_relative_to(source.resolve())]
    if inside:
        raise OutputError("the output lies in a data set that is merged", where=str(target), got=str(inside[0]))
    if len({source.resolve() for source in sources}) < len(sources):
        raise RecipeError("a data set is named twice", got=", ".join(map(str, sources)))


def _piece(root: Path) -> Piece:
    description = open_data_set(root)
    if description["images"] and not SafePath(root, JOBS).is_folder():
        problem = "this copy of a data set has no records, by which images are merged"
        hint = "copy the whole folder, with what is hidden in it"
        raise RecipeError(problem, where=str(root), expected=f"a folder {JOBS}", hint=hint)
    return Piece(root, description)


def _check_settings(pieces: Sequence[Piece]) -> None:
    """One file describes all images: species, classes and the dataset section must be the same."""
    first = pieces[0]
    unknown = [name for name in first.settings.formats if name not in DATASET_FORMATS]
    if unknown:
        raise RecipeError(
            "these data sets have a format that is not registered here",
            where=str(first.root),
            expected="formats among " + ", ".join(DATASET_FORMATS.ids()),
            got=", ".join(unknown),
            hint="install the package that has the format, or register it with `fg.register`",
        )
    for other in pieces[1:]:
        if (difference := first_difference(first.settings, other.settings)) is not None:
            keys, expected, got = difference
            raise RecipeError(
                f"these data sets differ in {'.'.join(keys)}: they cannot be one",
                where=str(other.root),
                expected=f"{expected}, as in {first.root}",
                got=got,
                hint="make one of them with the other's value; or train on both, each by its own",
            )


def _parts(pieces: Sequence[Piece]) -> list[RecipePart]:
    """The recipes, each once, by their first image."""
    by_hash: dict[str, RecipePart] = {}
    for piece in pieces:
        for recipe in piece.description["recipes"]:
            part = _part(piece, recipe)
            known = by_hash.get(part.hash)
            if known is not None:
                part = replace(known, asked=union_of(known.asked, part.asked), maps={**known.maps, **part.maps})
            by_hash[part.hash] = part
    parts = sorted(by_hash.values(), key=lambda part: (part.asked, part.hash))
    if len(parts) == 1:  # a hole between two pieces is what one run would have left out
        first, last = parts[0].asked[0][0], parts[0].asked[-1][1]
        if last - first >= MOST_IMAGES:
            problem = "the pieces lie too far apart: all images between them would be missing"
            expected = f"numbers that differ by less than {MOST_IMAGES:,}"
            raise RecipeError(problem, expected=expected, got=f"images {first} to {last}")
        return [replace(parts[0], asked=((first, last),))]
    _check_numbers(parts, pieces)
    return parts


def _part(piece: Piece, recipe: dict[str, Any]) -> RecipePart:
    yaml = piece.storage.read(recipe["file"])
    if yaml is None:
        raise DatasetError("the data set has lost its recipe", where=str(piece.root / recipe["file"]))
    maps = {f"{MAPS}/{name}": piece.storage.read(f"{MAPS}/{name}") or b"" for name in piece.storage.names(MAPS)}
    asked = tuple((int(first), int(last)) for first, last in recipe["asked"])
    try:
        text = yaml.decode()
    except UnicodeDecodeError as error:
        raise unreadable(SafePath(piece.root, recipe["file"]), error) from error
    return RecipePart(recipe["hash"], int(recipe["root_seed"]), asked, recipe["splits"], recipe["draws"], text, maps)


def _check_numbers(parts: Sequence[RecipePart], pieces: Sequence[Piece]) -> None:
    """Images of different recipes need different numbers: frames are named by them."""
    ranges = sorted(one for part in parts for one in part.asked)
    for (_, last), (first, _) in pairwise(ranges):
        if first <= last:
            problem = "two recipes have images of the same numbers"
            where = ", ".join(str(piece.root) for piece in pieces)
            expected = "numbers that differ: frames are named by them"
            hint = f"make one of the data sets with `set='first_image={max(last for _, last in ranges) + 1}'`"
            raise RecipeError(problem, where=where, expected=expected, got=f"image {first} in both", hint=hint)


def _records(pieces: Sequence[Piece]) -> Iterator[tuple[Piece | None, JobRecord]]:
    """Records by image with the piece to take them from; None for one that an earlier piece has as well.

    Raises `DatasetError`: two pieces have different images of one number, or a record is damaged.
    """
    notes: list[str] = []

    def numbered(number: int) -> Iterator[tuple[int, int, JobRecord]]:
        for record in records_of(pieces[number].storage, notes.append):
            yield record.image, number, record

    streams = map(numbered, range(len(pieces)))
    before: tuple[Piece, JobRecord] | None = None
    counts = [0] * len(pieces)
    for _, number, record in heapq.merge(*streams, key=lambda one: one[:2]):
        counts[number] += 1
        if before is not None and before[1].image == record.image:
            _check_same(before, (pieces[number], record))
            yield None, record
            continue
        before = pieces[number], record
        yield before
    for piece, count in zip(pieces, counts, strict=True):
        if count != piece.description["images"]:
            problem, expected = "the data set has not a record for each image", f"{piece.description['images']} records"
            got = f"{count}" + (f"; {notes[0]}" if notes else "")
            hint = f"forestgen verify {piece.root}; the command that made it, with `resume=True`, makes images again"
            raise DatasetError(problem, where=str(piece.root / JOBS), expected=expected, got=got, hint=hint)


def _check_same(one: tuple[Piece, JobRecord], other: tuple[Piece, JobRecord]) -> None:
    (first, expected), (second, got) = one, other
    if record_bytes(expected) == record_bytes(got):
        return
    paths = sorted(set(expected.files) | set(got.files))
    differing = [path for path in paths if expected.files.get(path) != got.files.get(path)]
    raise DatasetError(
        f"two data sets have different images of the number {got.image}",
        where=str(second.root / (differing[0] if differing else record_path(got.key))),
        expected=f"the same as in {first.root}",
        got="made by other versions, or from another recipe" if expected.key != got.key else "other files",
        hint="leave one of them out, or make the image again in one",
    )


def _check_seeds(record_index: RecordIndex) -> None:
    """No stand may be in two splits: pieces of ``same_stand`` recipes may each be sound, and not together."""
    shared = record_index.shared_seed()
    if shared:
        seed, first, first_split = shared[0]
        other, other_split = next((image, split) for _, image, split in shared if split != first_split)
        problem = "two splits would show one stand: train and test would share it (data leakage)"
        got = f"image {first} ({first_split}) and image {other} ({other_split}) of the seed {seed}"
        raise RecipeError(problem, expected="another seed of the recipe in each, or one split", got=got)


def _take(piece: Piece, record: JobRecord, storage: LocalStorage, link: bool) -> None:
    """Copy or link an image's files, then write its record."""
    for path, entry in record.files.items():
        source, target = SafePath(piece.root, path), storage.root / path
        if target.exists():  # a map that images share; the record index compares its sums
            continue
        make_folder(target.parent)
        try:
            size, digest = source.size_bytes(), entry["sha256"]  # a link is not read
            if size == entry["bytes"] and not (link and _linked(source, target)):
                digest = _copied(source, target)
        except OSError as error:
            raise unreadable(source, error, "forestgen verify names all such files") from error
        if size != entry["bytes"] or digest != entry["sha256"]:
            problem = "the file has changed since it was made"
            expected = f"{entry['bytes']} bytes, sha256 {entry['sha256']}"
            got = f"{size} bytes, sha256 {digest}" if size == entry["bytes"] else f"{size} bytes"
            hint = f"forestgen verify {piece.root} names all such files"
            raise DatasetError(problem, where=str(source), expected=expected, got=got, hint=hint)
    storage.write(record_path(record.key), record_bytes(record))


def _linked(source: SafePath, target: Path) -> bool:
    """Whether a file has a second name now: another file system has none, nor has one without links."""
    try:
        os.link(source.located(), target)
    except OSError:
        return False
    return True


def _copied(source: SafePath, target: Path) -> str:
    """SHA-256 of the copy."""
    with source.open() as stream, writing(target):
        with target.open("wb") as copy:
            shutil.copyfileobj(stream, copy)
        shutil.copystat(source.located(), target)
    return file_sum(target)
