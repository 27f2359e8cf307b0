"""dataset.json: what a data set is, of what recipes and with what versions it was made, and what it lacks."""

from __future__ import annotations

import hashlib
import json
import platform
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import PurePosixPath
from typing import Annotated, Any, get_type_hints

from pydantic import Field, create_model

from forestgen.core.errors import DatasetError
from forestgen.dataset.manifest import package_versions
from forestgen.dataset.png import THUMBNAILS
from forestgen.dataset.safe_path import is_frame, load_json, one_line
from forestgen.dataset.settings import DatasetSettings
from forestgen.recipe.dataset import SplitName
from forestgen.runs.contract import Count, Stored
from forestgen.runs.record_index import FileSum, RecordIndex
from forestgen.runs.records import versions_hash

MOST_IMAGES = 10_000_000  # of a recipe; a number in an untrusted file is counted up to
DATASET_NAME = "dataset.json"
SCHEMA = "forestgen-dataset/1"

Range = tuple[int, int]  # first and last image number


@dataclass(frozen=True)
class RecipePart:
    """A recipe that images of a data set were drawn from, and which of its images were asked for."""

    hash: str  # of all that it says, but for `images` and `first_image`: pieces of a data set share it
    root_seed: int
    asked: tuple[Range, ...]
    splits: Mapping[str, float] = field(default_factory=dict)  # name -> share, in the recipe's order
    draws: Mapping[str, Any] = field(default_factory=dict)  # key -> its distribution as written
    yaml: str = field(default="", repr=False)
    maps: Mapping[str, bytes] = field(default_factory=dict, repr=False)  # maps/NAME -> content

    def kept_as(self, number: int) -> Iterator[tuple[str, bytes]]:
        """Path and content of its files in the data set, as the n-th recipe, from 1: it makes the images asked for."""
        first, last = (self.asked[0][0], self.asked[-1][1]) if self.asked else (0, 0)
        text = re.sub(r"(?m)^first_image: \d+$", f"first_image: {first}", self.yaml)
        text = re.sub(r"(?m)^images: \d+$", f"images: {last - first + 1}", text)
        yield recipe_file(number), text.encode()
        yield from self.maps.items()


def ranges_of(numbers: Iterable[int]) -> list[Range]:
    """Rising numbers as ranges of neighbours."""
    found: list[Range] = []
    for number in numbers:
        if found and number == found[-1][1] + 1:
            found[-1] = (found[-1][0], number)
        else:
            found.append((number, number))
    return found


def union_of(one: Iterable[Range], other: Iterable[Range]) -> tuple[Range, ...]:
    """The numbers of both as ranges that do not touch."""
    found: list[Range] = []
    for first, last in sorted([*one, *other]):
        if found and first <= found[-1][1] + 1:
            found[-1] = (found[-1][0], max(found[-1][1], last))
        else:
            found.append((first, last))
    return tuple(found)


def numbers_in(ranges: Iterable[Sequence[int]]) -> Iterator[int]:
    """The numbers of ranges."""
    return (number for first, last in ranges for number in range(first, last + 1))


def this_version() -> dict[str, Any]:
    """What this machine makes images with."""
    return {
        "versions_hash": versions_hash(),
        "packages": package_versions(),
        "python": platform.python_version(),
        "platform": {"system": platform.system(), "machine": platform.machine()},
    }


def describe(
    record_index: RecordIndex,
    parts: Sequence[RecipePart],
    settings: DatasetSettings,
    made_with: Sequence[Mapping[str, Any]],
) -> dict[str, Any]:
    """The content of dataset.json.

    `record_index`: with all records, and the files over all images of each split.
    `made_with`: `this_version` of each machine that made images, without repetition.
    """
    named = list(dict.fromkeys(name for part in parts for name in part.splits))  # in the recipe's order
    splits = sorted(record_index.splits, key=lambda name: (named.index(name) if name in named else len(named), name))
    counts = {split: record_index.counts(split) for split in splits}
    digest = hashlib.sha256()
    for seed in record_index.seeds():
        digest.update(b"%d\n" % seed)
    licence = {"name": settings.licence_name, "url": settings.licence_url}
    return {
        "schema": SCHEMA,
        "description": settings.description,
        "contributor": settings.contributor,
        "licence": licence if settings.licence_name else None,
        "recipes": [_recipe(part, number, record_index) for number, part in enumerate(parts, start=1)],
        "images": sum(one["images"] for one in counts.values()),
        "frames": sum(one["frames"] for one in counts.values()),
        "splits": counts,
        "image_seeds_sha256": digest.hexdigest(),
        "settings": asdict(settings),
        "made_with": [dict(one) for one in made_with],
        "files": file_groups(record_index.files()),
    }


def recipe_file(number: int) -> str:
    """Name of the n-th recipe's file, counted from 1."""
    return "recipe.yaml" if number == 1 else f"recipe-{number}.yaml"


def _recipe(part: RecipePart, number: int, record_index: RecordIndex) -> dict[str, Any]:
    made = set(record_index.images())
    return {
        "file": recipe_file(number),
        "hash": part.hash,
        "root_seed": part.root_seed,
        "first_image": part.asked[0][0] if part.asked else 0,
        "images": sum(last - first + 1 for first, last in part.asked),
        "asked": [list(one) for one in part.asked],
        "missing": [list(one) for one in ranges_of(number for number in numbers_in(part.asked) if number not in made)],
        "splits": dict(part.splits),
        "draws": dict(part.draws),
    }


def file_groups(files: Iterable[FileSum]) -> dict[str, dict[str, int]]:
    """Kind of file -> how many there are, and their size together."""
    groups: dict[str, dict[str, int]] = {}
    for file in files:
        group = groups.setdefault(_group(file.path), {"files": 0, "bytes": 0})
        group["files"] += 1
        group["bytes"] += file.bytes
    return dict(sorted(groups.items()))


def _group(path: str) -> str:
    """A path with SPLIT and FRAME for their names; of what lies deeper the folder alone."""
    parts = PurePosixPath(path).parts
    if len(parts) == 1 or parts[0] == THUMBNAILS:
        return parts[0]
    if len(parts) == 2:
        return f"SPLIT/{parts[1]}"
    return "/".join(("SPLIT", *(("FRAME", parts[2]) if is_frame(parts[1]) else parts[1:2])))


def dataset_bytes(description: Mapping[str, Any]) -> bytes:
    """dataset.json."""
    return (json.dumps(description, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()


def read_description(content: bytes | None, where: str) -> dict[str, Any]:
    """dataset.json's content. Raises `DatasetError`: there is none, or it is damaged."""
    hint = "the command that made the data set writes it at its end; with `resume=True` it goes on"
    if content is None:
        raise DatasetError("this is no finished data set", where=where, expected=DATASET_NAME, got="none", hint=hint)
    try:
        data = load_json(content)
        checked = _Description.model_validate(data)
        if checked.schema_ != SCHEMA:
            raise ValueError(f"schema {checked.schema_!r:.40}")
        for one in checked.recipes:
            if any(not 0 <= first <= last for first, last in one.asked):
                raise ValueError("a range of images ends before it begins")
            if sum(last - first + 1 for first, last in one.asked) > MOST_IMAGES:
                raise ValueError(f"more than {MOST_IMAGES:,} images")
        _check_settings(settings_of(data))
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        got = f"{type(error).__name__}: {one_line(error)}"
        raise DatasetError("dataset.json is damaged", where=where, expected=SCHEMA, got=got, hint=hint) from error
    return dict(data)


class _SplitCounts(Stored):
    images: Count
    frames: Count


class _FileGroup(Stored):
    files: Count
    bytes: Count


class _RecipeEntry(Stored):
    file: Annotated[str, Field(pattern=r"^recipe(-[0-9]+)?\.yaml$")]
    hash: str
    root_seed: int
    asked: list[Annotated[list[Count], Field(min_length=2, max_length=2)]]
    splits: dict[str, float]
    draws: dict[str, Any]


class _Platform(Stored):
    system: str
    machine: str


class _Versions(Stored):
    versions_hash: str
    packages: dict[str, str | None]
    python: str
    platform: _Platform


class _Description(Stored):
    schema_: str = Field(alias="schema")
    recipes: Annotated[list[_RecipeEntry], Field(min_length=1)]
    images: Count
    frames: Count
    splits: dict[SplitName, _SplitCounts]
    image_seeds_sha256: str
    settings: dict[str, Any]
    made_with: Annotated[list[_Versions], Field(min_length=1)]
    files: dict[str, _FileGroup]


_SETTINGS: dict[str, Any] = {name: (kind, ...) for name, kind in get_type_hints(DatasetSettings).items()}
_Settings = create_model("_Settings", __base__=Stored, **_SETTINGS)


def _check_settings(settings: DatasetSettings) -> None:
    """Refuse settings of wrong types, or that contradict each other, with a `ValueError`."""
    _Settings.model_validate(asdict(settings))
    if len(settings.species_category) != len(settings.species_names):
        raise ValueError("settings: not a category a species")
    if not all(0 <= number < len(settings.category_names) for number in settings.species_category):
        raise ValueError("settings: a species is of no category")
    if settings.depth_unit_m <= 0 or settings.point_stride < 1:
        raise ValueError("settings: depth_unit_m or point_stride is not positive")


def settings_of(description: Mapping[str, Any]) -> DatasetSettings:
    """The data set's settings, from dataset.json."""
    stored = {key: tuple(one) if isinstance(one, list) else one for key, one in description["settings"].items()}
    known: dict[str, Any] = {one.name: stored[one.name] for one in fields(DatasetSettings)}
    return DatasetSettings(**known)
