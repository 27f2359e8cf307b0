"""Pictures, terrain, soundings and weather that a recipe names: found beside it, known by content; the recipe's hash.

``map: meadow.png`` becomes ``map: {file: meadow.png, sha256: ...}`` when a recipe is loaded. With a sha256 in the
recipe, as in one that is stored with an image, no other file is taken.

Some shipped keys take a file's name alone; a mapping ``{file: wind.csv}`` is a file wherever it stands, but in species.
So parts of other packages have files of their own: a key of the type `RecipeFile`.
"""

from __future__ import annotations

import difflib
import hashlib
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from forestgen.core.errors import AssetError
from forestgen.recipe.assets import inside
from forestgen.recipe.distributions import is_distribution
from forestgen.recipe.fields import Section, Text
from forestgen.recipe.sources import Keys, SourceMap

_NAMES_BELOW: dict[Keys, frozenset[str]] = {  # section -> keys anywhere below it whose text is a file's name
    ("community",): frozenset({"map", "keep_out"}),
    ("site", "terrain"): frozenset({"map"}),
    ("sky", "clouds"): frozenset({"map", "sounding"}),
}
_SINGLE: tuple[Keys, ...] = (("community", "soil"), ("community", "file"), ("sky", "clouds", "file"))
_WITHOUT_FILES = ("species", "sampling", "dataset")  # sections; a species' own paths are relative to its file
_PLAIN_FILE = frozenset({"file", "sha256"})  # keys of a mapping that can be nothing else
Sha256 = Annotated[Text, Field(pattern="^[0-9a-f]{64}$")]
MOST_BYTES = 2_000_000_000
_SUFFIXES = (".png", ".tif", ".tiff", ".exr", ".npy", ".csv", ".nc", ".vol")
_Slot = tuple[Keys, Any, str | int]  # key path, parent and key of a value that may be a file


def file_sha256(path: Path, named: str, where: str | None = None) -> str:
    """SHA-256, hexadecimal, of a file that a recipe names `named`, at the place `where`.

    Raises `AssetError` where there is none, or it cannot be read.
    """
    expected = "an existing file"
    try:
        if path.is_file():
            size = path.stat().st_size
            if size > MOST_BYTES:
                limit, got = f"at most {MOST_BYTES / 1e9:g} GB", f"{size / 1e9:,.1f} GB"
                raise AssetError("the file is too large for a map", where=where, expected=limit, got=got)
            with path.open("rb") as stream:
                return hashlib.file_digest(stream, "sha256").hexdigest()
        if path.exists():
            problem = "this is a folder" if path.is_dir() else "this is no plain file"
            raise AssetError(problem, where=where, expected=expected, got=str(path))
        raise AssetError("no such file", where=where, expected=expected, got=str(path), hint=_near(path, named))
    except (OSError, ValueError) as cause:  # a name that no file system takes has ValueError
        reason = cause.strerror if isinstance(cause, OSError) else str(cause)
        raise AssetError("the file cannot be read", where=where, expected=expected, got=reason) from cause


def known_file(
    folder: Path, named: str, sha256: str | None, where: str | None = None, known: dict[Path, str] | None = None
) -> Path:
    """The path of a file that a recipe names, still the one that the recipe was loaded with.

    `known` is SHA-256 by path of the files that were read; it grows, and no file is read twice.

    Raises `AssetError` where there is none, or its SHA-256 is another one.
    """
    path, found = inside(folder, named, sha256=sha256, where=where), {} if known is None else known
    if path not in found:
        found[path] = file_sha256(path, named, where)
    if sha256 is not None and sha256 != found[path]:
        problem = "this is not the file that the recipe was made with"
        expected = f"a file whose SHA-256 is {sha256[:16]}..."
        hint = "bring the file back; or remove sha256, and the file is taken as it is now"
        raise AssetError(problem, where=where, expected=expected, got=f"{path}: {found[path][:16]}...", hint=hint)
    return path


class RecipeFile(Section):
    """A file that a part reads: a key of this type is written ``{file: wind.csv}``, relative to the recipe's folder."""

    file: Text = Field(min_length=1, description="Path of the file, relative to the recipe's folder.")
    sha256: Sha256 | None = Field(None, description="SHA-256 of the file; no file of other content is taken.")

    def path(self, folder: Path) -> Path:
        """Where the file is, of a recipe in `folder`; see `known_file`."""
        return known_file(folder, self.file, self.sha256)


def _near(path: Path, named: str) -> str:
    """What else the author may have meant."""
    relative = "its path is relative to the recipe's folder"
    if Path(named).is_file():
        return f"{relative}; {named!r} lies in the folder where you are: {Path(named).resolve()}"
    if not path.parent.is_dir():
        return f"{relative}; there is no folder {path.parent}"
    files = sorted(one for one in path.parent.iterdir() if one.suffix.lower() in _SUFFIXES and one.is_file())
    near = difflib.get_close_matches(path.stem, [one.stem for one in files], n=3)
    names = [one.name for one in files if one.stem in near] or [one.name for one in files[:5]]
    return f"{relative}; files there: {', '.join(names) if names else 'none'}"


def embed_maps(data: dict[str, Any], sources: SourceMap, folder: Path, known: dict[Path, str]) -> None:
    """Give every map of a recipe's community, and every file of its weather, in place the SHA-256 of its file.

    Where a file's name is chosen anew for each image, every choice becomes such a mapping: for the recipe's hash.
    `known`: see `known_file`.

    Raises `AssetError` where there is no such file, or its content is not of the SHA-256 that the recipe gives.
    """

    def identified(value: Any, keys: Keys) -> Any:
        """A file's name, or the mapping that has it, with the file's SHA-256; anything else as it is."""
        named = {"file": value} if isinstance(value, str) else value
        if not isinstance(named, dict) or not isinstance(named.get("file"), str):
            return value
        written = named.get("sha256")
        if not (written is None or isinstance(written, str)):
            return value  # as in `sha256: 12`: the section's own check says what is wrong
        place = (*keys, "file")
        where = sources.where(place if place in sources.places else keys)
        return {**named, "sha256": known[known_file(folder, named["file"], written, where, known)]}

    def chosen(value: Any, keys: Keys) -> Any:
        """A choice of files' names, each with its SHA-256; any other distribution as it is."""
        choices = value.get("choice")
        if not isinstance(choices, list):
            return value
        return {"choice": [identified(one, keys) if isinstance(one, str) else one for one in choices]}

    for keys, parent, key in list(_all_slots(data)):
        value = parent[key]
        if is_distribution(value):
            parent[key] = chosen(value, keys)
        elif isinstance(value, dict) and is_distribution(value.get("file")):
            rest = {name: one for name, one in value.items() if name not in ("file", "sha256")}
            parent[key] = {**rest, "file": chosen(value["file"], keys)}
        else:
            parent[key] = identified(value, keys)


def map_files(data: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Every mapping of a file and its SHA-256 in a recipe's plain data, to be read or changed."""
    for _, parent, key in _all_slots(data):
        if is_map_file(parent[key]):
            yield parent[key]


def is_map_file(value: object) -> bool:
    """Whether `value` is a mapping that names a file and the SHA-256 of its content."""
    return isinstance(value, dict) and isinstance(value.get("file"), str) and isinstance(value.get("sha256"), str)


def _all_slots(data: dict[str, Any]) -> Iterator[_Slot]:
    """Key path, parent and key of every value that may be a file."""
    for section, value in data.items():
        if section not in _WITHOUT_FILES:
            yield from _slots(value, (section,), frozenset())


def _slots(value: Any, keys: Keys, names: frozenset[str]) -> Iterator[_Slot]:
    """Those at and below a key path; `names`: keys whose text is a file's name there."""
    names = _NAMES_BELOW.get(keys, names)
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, item in items:
        inner = (*keys, key)
        is_plain = isinstance(item, dict) and "file" in item and item.keys() <= _PLAIN_FILE
        if is_plain or key in names or inner in _SINGLE:
            yield inner, value, key
        yield from _slots(item, inner, names)  # into a slot too: a species may be named so


def recipe_hash(data: Mapping[str, Any]) -> str:
    """SHA-256, hexadecimal, of a recipe's complete content (`LoadedRecipe.complete` or `DrawnRecipe.data`).

    Comments, layout, the order of keys and 1 against 1.0 do not matter; a species file's content does, and so does the
    order of species, which numbers the classes. A map counts by its content, wherever its file lies.
    """
    content = {"recipe": _canonical(data), "species": list(data.get("species", ()))}
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def _canonical(value: Any) -> Any:
    if isinstance(value, Mapping):
        nameless = is_map_file(value)
        return {str(key): _canonical(item) for key, item in value.items() if not (nameless and key == "file")}
    if isinstance(value, list | tuple):
        return [_canonical(item) for item in value]
    if isinstance(value, float) and value.is_integer():
        return int(value)  # also -0.0; exact, as every float that is whole is an integer
    return value
