"""From what a recipe's author wrote to one plain mapping: shorthands, overrides, species, and the texts of files."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

from forestgen.core.arguments import read_text
from forestgen.core.errors import AssetError, ErrorList, RecipeError
from forestgen.recipe.assets import find_asset, list_assets, scenes_dir
from forestgen.recipe.distributions import is_distribution
from forestgen.recipe.draws import is_reference
from forestgen.recipe.sources import Keys, Place, SourceMap, dotted, parse_yaml, read_yaml
from forestgen.recipe.spectra import (
    KIND,
    SEASONS,
    Columns,
    bands_of,
    of_season,
    seasons_of,
    sensor_file,
    surface_columns,
    table_text,
)  # fmt: skip

_LARGEST_PROGRAM_BYTES = 1_000_000
MOST_SPECIES = 1000
T = TypeVar("T")

_Files = dict[Path, tuple[dict[str, Any], SourceMap]]  # read once: many species may be made from one

SHORTHANDS: dict[Keys, str] = {
    ("site", "terrain"): "kind",
    ("site", "ground"): "kind",
    ("site", "surroundings"): "kind",
    ("sky", "clouds"): "type",
}
OPTIONAL: tuple[Keys, ...] = (
    ("site",), ("plants",), ("sky",), ("cameras",), ("render",), ("labels",), ("wind",), ("dataset",), ("sampling",),
    ("sky", "sun"),
)  # fmt: skip


def normalize(data: dict[str, Any]) -> None:
    """Replace shorthands in place: ``terrain: flat``, ``spruce:``; an optional section left empty is left out."""
    for keys in (*OPTIONAL, *SHORTHANDS):
        parent = data if len(keys) == 1 else data.get(str(keys[0]))
        key = str(keys[-1])
        if not isinstance(parent, dict) or key not in parent:
            continue
        if parent[key] is None:
            del parent[key]
        elif keys in SHORTHANDS and isinstance(parent[key], str):
            parent[key] = {SHORTHANDS[keys]: parent[key]}
    species = data.get("species")
    if isinstance(species, dict) and not is_distribution(species):
        for name, entry in species.items():
            if entry is None or isinstance(entry, str):
                species[name] = {"from": name if entry is None else entry}


def apply_override(data: dict[str, Any], sources: SourceMap, text: str) -> None:
    """Set one ``key.path=value`` of the command line in place; the value is YAML, a list's entry goes by its number."""
    path, equals, written = text.partition("=")
    place = Place(f"`set='{text}'`" if len(text) <= 100 else f"`set='{text[:97]}...'`")
    parts = path.strip().split(".")
    if not equals or not all(parts):
        hint = "`set='site.size_m=[80,80]'`"
        raise RecipeError("not an override", where=str(place), expected="key.path=value", hint=hint)
    value, value_sources = parse_yaml(written, str(place), lines=False)
    container: Any = data
    keys: Keys = ()
    for part, following in pairwise(parts):
        key = _step(container, part, keys, place)
        keys = (*keys, key)
        if container[key] is None:
            container[key] = [] if following == "0" else {}
            sources.places[keys] = place
        container = container[key]
    key = _step(container, parts[-1], keys, place)
    keys = (*keys, key)
    container[key] = value
    sources.drop(keys)
    sources.take(value_sources, (), keys)


def _step(container: Any, part: str, keys: Keys, place: Place) -> str | int:
    """The key or index that `part` means in `container`; a new one is made, holding None."""
    if isinstance(container, dict):
        container.setdefault(part, None)
        return part
    if not isinstance(container, list):
        got = f"{dotted(keys)} is {container!r:.60}"
        raise RecipeError(f"there is no key {part!r} here", where=str(place), expected="a key of a mapping", got=got)
    if not (part.isascii() and part.isdigit() and len(part) < 7 and int(part) <= len(container)):
        expected = f"a number from 0 to {len(container)}, the next free one"
        raise RecipeError(f"no such entry of the list {dotted(keys)}", where=str(place), expected=expected, got=part)
    if int(part) == len(container):
        container.append(None)
    return int(part)


def merge_species(data: dict[str, Any], sources: SourceMap, folder: Path, errors: ErrorList) -> list[str]:
    """Replace each ``{from: NAME, ...}`` of the species in place by the file's content under the recipe's overrides.

    A mapping without ``from`` that is no whole species, such as ``pine: {height_m: 20}``, takes the rest from the
    shipped species of its name, as ``pine:`` alone does. `errors` takes the errors of species' files. Returns the names
    of the species with errors.
    """
    species = data.get("species")
    if not isinstance(species, dict) or is_distribution(species):
        return []
    if len(species) > MOST_SPECIES:
        expected, where = f"at most {MOST_SPECIES} species", sources.where(("species",))
        raise RecipeError("too many species", where=where, expected=expected, got=str(len(species)))
    written: dict[str | int, dict[Keys, Place]] = {}  # where the recipe's own keys of each species were written
    for keys, place in sources.places.items():
        if len(keys) > 1 and keys[0] == "species":
            written.setdefault(keys[1], {})[keys] = place
    files: _Files = {}
    shipped = frozenset(list_assets("species")) if any(map(_is_partial, species.values())) else frozenset()
    failed = []
    for name, entry in species.items():
        if name in shipped and _is_partial(entry):
            entry["from"] = name
        if not isinstance(entry, dict) or "from" not in entry:
            continue
        merged = errors.attempt(_from_file, name, entry, written.get(name, {}), sources, files, folder)
        if merged is None:
            failed.append(name)
        else:
            species[name] = merged
    return failed


def _from_file(
    name: str, entry: dict[str, Any], written: dict[Keys, Place], sources: SourceMap, files: _Files, folder: Path
) -> Any:
    """The content of the file that `entry` names under its other keys; `sources` take the file's places."""
    keys: Keys = ("species", name)
    where = sources.where((*keys, "from"))
    source = entry.pop("from")
    if not isinstance(source, str):
        expected = "the name or path of a species file"
        raise RecipeError("bad value", where=where, expected=expected, got=f"{source!r:.60}")
    path = find_asset("species", source, folder=folder, where=where)
    if path not in files:
        base, base_sources = read_yaml(path, error=AssetError)
        _embed(base.get("plant"), base_sources, ("plant", "program"), path.parent, folder)
        _embed_spectra(base.get("materials"), base_sources, ("materials",), path.parent, root=folder)
        files[path] = base, base_sources
    base, base_sources = copy.deepcopy(files[path][0]), files[path][1]
    _without_other_light(base.get("materials"), entry.get("materials"))
    recipe_sources = SourceMap(written)
    merged = SourceMap(dict(recipe_sources.places))  # of this species alone, for dropping keys looks at all
    merged.take(base_sources, (), keys)
    merged.places[keys] = sources.place(keys)
    result = _merged(_without_other_generator(base, entry, merged, keys), entry, merged, recipe_sources, keys)
    for one in recipe_sources.places:
        del sources.places[one]
    sources.places.update(merged.places)
    return result


def _is_partial(entry: Any) -> bool:
    """Whether a species' mapping names no file and lacks what a species must have."""
    if not isinstance(entry, dict) or "from" in entry or is_distribution(entry) or is_reference(entry):
        return False
    plant = entry.get("plant")
    return not ({"ecology", "allometry"} <= entry.keys() and isinstance(plant, dict) and "generator" in plant)


def _mappings(section: Any) -> list[tuple[str, dict[str, Any]]]:
    """The entries of a section that are mappings."""
    entries = section.items() if isinstance(section, dict) else ()
    return [(name, entry) for name, entry in entries if isinstance(entry, dict)]


def embed_files(data: dict[str, Any], sources: SourceMap, folder: Path, errors: ErrorList) -> None:
    """Replace the names of L-system programs, spectra and sensors by name and text, in place; see `_embed_table`.

    So a recipe's hash covers the files, and a drawn recipe holds all that it needs. A species file's own were taken
    when it was read: their paths are relative to that file. `errors` takes the errors of each.
    """
    plants, cameras = data.get("plants"), data.get("cameras")
    season = (plants.get("season") if isinstance(plants, dict) else None) or "summer"
    for name, entry in _mappings(data.get("species")):
        keys: Keys = ("species", name)
        errors.attempt(_embed, entry.get("plant"), sources, (*keys, "plant", "program"), folder)
        errors.attempt(_embed_spectra, entry.get("materials"), sources, (*keys, "materials"), folder, season)
    errors.attempt(_embed, data.get("community"), sources, ("community", "program"), folder)
    for index, camera in enumerate(cameras) if isinstance(cameras, list) else ():
        where = sources.where(("cameras", index, "bands"))
        find, read = partial(sensor_file, folder=folder, where=where), partial(bands_of, where=where)
        errors.attempt(_embed_table, camera, "bands", find, read)


def _embed_spectra(
    materials: Any, sources: SourceMap, keys: Keys, folder: Path, season: str | None = None, root: Path | None = None
) -> None:
    """Embed the spectra of a species' materials, whose key path is `keys`; `season` is that of materials without one.

    Raises `AssetError` for a table that no surface can have, or that lacks the season.
    """
    for name, material in _mappings(materials):
        where = sources.where((*keys, name, "spectrum"))
        find = partial(find_asset, KIND, folder=folder, root=root, where=where)
        found = _embed_table(material, "spectrum", find, partial(surface_columns, where=where))
        if found is not None:
            _check_season(found[1], material.get("season") or season, found[0], where)


def _embed_table(
    section: Any, key: str, find: Callable[[str], Path], read: Callable[[str, str], T]
) -> tuple[str, T] | None:
    """Replace the table's name at a section's key in place by ``{name: NAME}``; its name, and what `read` makes of it.

    A file that forestgen does not ship is kept as its ``text``: so a recipe's hash covers it, and a drawn recipe holds
    all that it needs. None: what stands there is no table, and the schema says what is wrong.
    """
    written = section.get(key) if isinstance(section, dict) else None
    if isinstance(written, str):
        written = section[key] = {"name": written}
    if not isinstance(written, dict) or not isinstance(written.get("name"), str):
        return None
    name, text = written["name"], written.get("text")
    if isinstance(text, str):
        return name, read(text, name)
    if text is not None:
        return None
    path = find(name)
    text = table_text(path)
    found = read(text, str(path))
    if not path.is_relative_to(scenes_dir()) or ".." in path.parts:
        written["name"], written["text"] = path.name, text
    return name, found


def _check_season(columns: Columns, season: object, name: str, where: str) -> None:
    """The table serves the season, if that is one."""
    if season in SEASONS and of_season(columns, season) is None:
        expected = f"one of {', '.join(seasons_of(columns))}"
        hint = "the material's own `season` takes precedence over plants.season"
        raise AssetError(f"{name} has no {season}", where=where, expected=expected, got=str(season), hint=hint)


def _embed(section: Any, sources: SourceMap, keys: Keys, folder: Path, root: Path | None = None) -> None:
    """Replace the section's ``program``, whose key path is `keys`, if it is a name; see `find_asset`."""
    if not isinstance(section, dict) or not isinstance(section.get("program"), str):
        return
    path = find_asset("lsystems", section["program"], folder=folder, root=root, where=sources.where(keys))
    text = read_text(path, "an L-system program", most_bytes=_LARGEST_PROGRAM_BYTES)
    section["program"] = {"name": path.name, "text": text}


def _without_other_generator(
    base: dict[str, Any], override: Mapping[str, Any], sources: SourceMap, keys: Keys
) -> dict[str, Any]:
    """`base` less its ``plant`` section if the override chooses another generator: the keys would not fit."""
    old, new = base.get("plant"), override.get("plant")
    if not (isinstance(old, dict) and isinstance(new, dict)):
        return base
    if new.get("generator", old.get("generator")) == old.get("generator"):
        return base
    sources.drop((*keys, "plant"))
    return {key: value for key, value in base.items() if key != "plant"}


def _without_other_light(base: Any, override: Any) -> None:
    """Take from materials in place what a recipe replaces: a spectrum by colours, or colours by a spectrum."""
    for name, material in _mappings(base):
        new = override.get(name) if isinstance(override, dict) else None
        if not isinstance(new, dict):
            continue
        if "reflectance" in new and new.get("spectrum") is None:
            material.pop("spectrum", None)
            material.pop("season", None)
        elif new.get("spectrum") is not None:
            for key in ("reflectance", "transmittance", "season", "spectrum"):
                material.pop(key, None)


def _merged(base: Any, override: Any, sources: SourceMap, override_sources: SourceMap, keys: Keys) -> Any:
    """Mappings merge key by key; anything else, a distribution or a formula too, is replaced as a whole."""
    mergeable = isinstance(base, dict) and isinstance(override, dict)
    if not mergeable or any(is_distribution(one) or is_reference(one) for one in (base, override)):
        sources.drop(keys)
        sources.take(override_sources, keys, keys)
        return override
    result = dict(base)
    for key, value in override.items():
        inner = (*keys, key)
        if key in base:
            result[key] = _merged(base[key], value, sources, override_sources, inner)
        else:
            result[key] = value
        if inner in override_sources.places:
            sources.places[inner] = override_sources.places[inner]
        if key not in base:
            sources.take(override_sources, inner, inner)
    return result
