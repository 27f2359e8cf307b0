"""What there is: models, species, the recipe's schema."""

from __future__ import annotations

import importlib
import inspect
import sys
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from forestgen.community.registry import COMMUNITY_MODELS, COMPETITION_MODELS
from forestgen.core.arguments import shown, text_of
from forestgen.core.errors import RecipeError
from forestgen.core.registry import Registry, part_at
from forestgen.geometry.export import MESH_EXPORTERS
from forestgen.plants.parameters import PlantParameters
from forestgen.plants.registry import GENERATORS
from forestgen.recipe import registries as parts
from forestgen.recipe.assets import find_asset, list_assets
from forestgen.recipe.suggestions import did_you_mean

_KINDS: tuple[Registry, ...] = (  # in the order in which `models` lists them
    COMMUNITY_MODELS, COMPETITION_MODELS, GENERATORS, parts.DATASET_FORMATS, parts.PACKS, parts.LABEL_CHANNELS,
    parts.CLOUD_SOURCES, parts.SKIES, parts.TERRAINS, parts.GROUND_COVERS, parts.GROUND_LAYERS, parts.WEATHER,
    parts.PROJECTIONS, parts.RIGS, parts.INSTRUMENTS, parts.BUILDINGS, MESH_EXPORTERS,
)  # fmt: skip
_REGISTRIES = {one.kind.replace(" ", "_"): one for one in _KINDS}
_WITHOUT_COMMENT = {  # files of a format that has none
    "fig_5_2": "A bush of one rule, of Rhodes University's forest: its Fig. 5.2, in the format .sys.",
}
_ASSETS = {"species": "species", "lsystems": "lsystem", "recipes": "recipe"}  # folder of files -> kind


@dataclass(frozen=True)
class Entry:
    """Something that recipes can name."""

    kind: str  # of part, such as community_model; or species, lsystem, recipe
    name: str
    description: str
    path: Path | None = None  # of a file

    @property
    def page(self) -> str:
        """Its manual page, or its file."""
        if self.path is not None:
            return f"{self.path}\n\n{self.path.read_text(encoding='utf-8').rstrip()}"
        part = _REGISTRIES[self.kind].part(self.name)
        module = sys.modules[type(part).__module__]
        page = inspect.cleandoc(module.__doc__ or f"{self.name} has no manual page")
        others = not module.__name__.startswith("forestgen.") and hasattr(part, "Parameters")
        return page + _keys(part.Parameters) if others or "Parameters: see" in page else page

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return {**asdict(self), "path": None if self.path is None else str(self.path)}


def _keys(parameters: type[BaseModel]) -> str:
    """The keys of a part with their meaning and default, below a manual page without them."""
    schema, text = parameters.model_json_schema(), ""
    shared = PlantParameters.model_json_schema()["$defs"] if issubclass(parameters, PlantParameters) else {}
    own = {title: one for title, one in schema.get("$defs", {}).items() if title not in shared}
    for title, section in {"Keys": schema, **own}.items():
        keys = section.get("properties", {})
        text += f"\n\n{title}\n{'-' * len(title)}" if keys else ""
        for key, about in keys.items():
            default = f" [{about['default']}]" if about.get("default") is not None else ""
            text += f"\n{key}: {about.get('description', '')}{_bounds(about)}{default}"
    return text


def _bounds(about: Mapping[str, Any]) -> str:
    """The range of a key's numbers, in parentheses."""
    signs = {"exclusiveMinimum": ">", "minimum": ">=", "exclusiveMaximum": "<", "maximum": "<="}
    kinds = (about, *about.get("anyOf", ()))
    found = [f"{sign} {kind[name]:g}" for kind in kinds for name, sign in signs.items() if name in kind]
    return f" ({', '.join(found)})" if found else ""


def models(name: str | None = None, *, kind: str | None = None) -> list[Entry]:
    """Parts of all kinds, those of installed packages among them; species, L-systems and recipes.

    Parameters
    ----------
    name : those of this name; None: all.
    kind : those of this kind; None: all.

    Raises
    ------
    RecipeError : there is no such name or kind.
    """
    if kind is not None:
        _check_kind(kind, (*_REGISTRIES, *_ASSETS.values()))
    found = [one for one in _entries() if kind in (None, one.kind)]
    named = [one for one in found if name is None or one.name == text_of(name, "name")]
    if name is not None and not named:
        known = [one.name for one in found]
        expected = "a name that `forestgen models` lists: of a part, a species, an L-system or a recipe"
        hint = f"that is a kind: `kind={name!r}` lists its parts" if name in _REGISTRIES else did_you_mean(name, known)
        raise RecipeError("no such name", parameter="name", expected=expected, got=repr(name), hint=hint)
    return named


def _entries() -> Iterator[Entry]:
    for kind, registry in _REGISTRIES.items():
        for name in registry.ids():
            yield Entry(kind, name, registry.describe(name))
    for folder, kind in _ASSETS.items():
        for name in list_assets(folder):
            path = find_asset(folder, name)
            yield Entry(kind, name, _WITHOUT_COMMENT.get(name) or _first_sentences(path), path)


def _first_sentences(path: Path) -> str:
    """What the comment at a file's top says in whole sentences: those of its first line, or a longer one."""
    comment = []
    for line in path.read_text(encoding="utf-8").split("\n"):
        if not line.startswith(("#", "//")) or not line.lstrip("#/").strip():
            break
        comment.append(line.lstrip("#/").strip())
    if not comment or comment[0].endswith((".", ":")):
        return comment[0] if comment else ""
    whole, stop, _ = comment[0].rpartition(". ")
    if stop:
        return f"{whole}."
    first, stop, _ = " ".join(comment).partition(". ")
    return f"{first}." if stop else first


@dataclass(frozen=True)
class SpeciesEntry:
    """A species that comes with forestgen."""

    name: str
    height_m: float  # of a mature plant
    crown_width_m: float
    generator: str
    description: str


def species() -> list[SpeciesEntry]:
    """The species that come with forestgen."""
    from forestgen.api.plant_requests import drawn_of
    from forestgen.plants.build import size_m

    found = []
    for name in list_assets("species"):
        one = drawn_of(name, 0).species[name]
        height_m, width_m = size_m(one, one.ecology.max_radius_m)
        found.append(SpeciesEntry(name, height_m, width_m, one.plant.generator, one.description))
    return found


def schema() -> dict[str, Any]:
    """The JSON Schema of recipes, for editors."""
    from forestgen.recipe.json_schema import recipe_json_schema

    def parameters(registry: Registry, discriminator: str) -> dict[str, dict[str, object]]:
        found = {name: one.Parameters.model_json_schema() for name, one in registry.parts()}
        for one in found.values():
            one.get("properties", {}).pop(discriminator, None)
        return found

    return recipe_json_schema(parameters(COMMUNITY_MODELS, "model"), parameters(GENERATORS, "generator"))


def register(kind: str, name: str, part: object, description: str = "") -> None:
    """Add a part of your own, which recipes then name like a shipped one.

    Worker processes import it from its module, so it must not be defined in a script's ``__main__`` or a notebook.

    Parameters
    ----------
    kind : of part, such as community_model; an unknown one raises an error that lists them.
    name : that recipes use; of a mesh exporter the suffix of its files, without the dot.
    part : the object, defined at the top of a module; or its place, ``"package.module:NAME"``.
    description : one line for `models`; by default the first line of the object's documentation.

    Raises
    ------
    RecipeError : no such kind, the name is taken, the object cannot be found again in its module, or lacks what a
        part of its kind must have.
    """
    _check_kind(kind, tuple(_REGISTRIES))
    text_of(name, "name")
    found, path = (part_at(part), part) if isinstance(part, str) else (part, _path_of(part))
    _REGISTRIES[kind].check_part(name, found)
    text = text_of(description, "description") or (inspect.getdoc(found) or "").partition("\n")[0]
    _REGISTRIES[kind].register(name, path, text)


def _check_kind(kind: str, known: tuple[str, ...]) -> None:
    if text_of(kind, "kind") not in known:
        expected, hint = "one of " + ", ".join(known), did_you_mean(kind, known)
        raise RecipeError("no such kind", parameter="kind", expected=expected, got=shown(kind), hint=hint)


def _path_of(part: object) -> str:
    """``module:attribute`` under which an object can be imported again."""
    owner = part if hasattr(part, "__qualname__") else type(part)
    module = owner.__module__
    if module != "__main__":
        found = [name for name, value in vars(importlib.import_module(module)).items() if value is part]
        if found:
            return f"{module}:{found[0]}"
    problem, expected = "the part cannot be imported again by worker processes", "an object at the top of a module"
    hint = "put it into a module of its own, or pass its place: 'package.module:NAME'"
    raise RecipeError(problem, parameter="part", expected=expected, got=f"{part!r:.80} of {module}", hint=hint)
