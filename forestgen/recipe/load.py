"""A recipe from its file: read, overridden, merged, checked; then drawn, image by image.

>>> loaded = load_recipe("recipes/stand.yaml", ["seed=3"])      # doctest: +SKIP
>>> drawn = loaded.draw(0)                                      # doctest: +SKIP
>>> drawn.recipe.site.size_m, drawn.image_seed                  # doctest: +SKIP
"""

from __future__ import annotations

import copy
import difflib
import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError
from ruamel.yaml import YAML
from ruamel.yaml.representer import SafeRepresenter

from forestgen.core.errors import AssetError, RecipeError
from forestgen.core.randomness import child_rng, child_root
from forestgen.recipe.assemble import apply_override, embed_program, embed_tables, merge_species, spell_out
from forestgen.recipe.assets import list_assets, recipes_dir
from forestgen.recipe.biome import forget_drawn_biome, settle_biome
from forestgen.recipe.distributions import (
    BadDistributionError,
    Distribution,
    Scalar,
    is_distribution,
    parse_distribution,
)
from forestgen.recipe.distributions import Sequence as InOrder
from forestgen.recipe.hashing import recipe_hash
from forestgen.recipe.map_files import embed_maps
from forestgen.recipe.messages import UNDRAWN, Explainer, show
from forestgen.recipe.schema import SCHEMA_VERSION, Recipe
from forestgen.recipe.sources import Keys, Place, SourceMap, dotted
from forestgen.recipe.species import Species
from forestgen.recipe.yaml_source import read_yaml

ModelT = TypeVar("ModelT", bound=BaseModel)


@dataclass(frozen=True)
class DrawnRecipe:
    """The recipe of one image: every distribution drawn, every default filled in, every species whole."""

    recipe: Recipe
    data: dict[str, Any]  # plain, complete; stored as YAML and loaded again it gives this image again
    image_index: int  # of the image itself: the recipe's first_image plus the index drawn
    image_seed: int  # in [0, 2^63); the root of this image's own randomness; with same_stand, image 0's
    folder: Path  # of the recipe: paths in it are relative to this
    sources: SourceMap = field(repr=False)
    written: Mapping[Keys, Any] = field(repr=False)  # the drawn values' distributions as written

    @property
    def species(self) -> dict[str, Species]:
        """Species by their name in the recipe, in its order."""
        return self.recipe.species

    def where(self, *keys: str | int) -> str:
        """``file:line: a.b.c`` of a key, for messages; a key not written lies at its nearest ancestor."""
        return self.sources.where(keys)

    def parse(self, model: type[ModelT], data: Mapping[str, Any], keys: Keys) -> ModelT:
        """A model's or generator's own keys, validated.

        Parameters
        ----------
        model : the pydantic class of the parameters.
        data : the values, such as ``drawn.recipe.community.parameters``.
        keys : key path of `data` in the recipe, such as ``("community",)`` or ``("species", "poplar", "plant")``.

        Raises
        ------
        RecipeError : worded like the errors of the recipe's own keys.
        """
        try:
            return model.model_validate(dict(data), context={"folder": self.folder})  # where its files are
        except ValidationError as failure:
            explainer = Explainer(model, data, self.sources, tuple(keys), self.written)
            raise explainer.error(failure) from failure


@dataclass(frozen=True)
class LoadedRecipe:
    """A recipe as written: overrides applied, species merged, distributions not yet drawn."""

    path: Path
    data: dict[str, Any]  # without defaults
    sources: SourceMap = field(repr=False)
    distributions: Mapping[Keys, Distribution]  # by key path
    written: Mapping[Keys, Any] = field(repr=False)  # the same, as written
    file_sha256: dict[Path, str] = field(default_factory=dict, repr=False, compare=False)  # of the files it names

    @property
    def seed(self) -> int:
        """The root seed."""
        return _whole(self.data, "seed", 0)

    @property
    def images(self) -> int:
        """How many images the recipe makes."""
        return _whole(self.data, "images", 1)

    @cached_property
    def complete(self) -> dict[str, Any]:
        """Everything the recipe says: defaults filled in, species merged, distributions as written."""
        data = _plain(self._validated(self._values(self._first_image)))
        if any(keys[:2] == ("community", "biome") for keys in self.written):
            forget_drawn_biome(data, self.data)
        for keys, written in self.written.items():
            _put(data, keys, copy.deepcopy(written))
        embed_maps(data, self.sources, self.path.parent, self.file_sha256)  # those that are chosen for each image
        return data

    @cached_property
    def hash(self) -> str:
        """SHA-256 of `complete`."""
        return recipe_hash(self.complete)

    @property
    def _first_image(self) -> int:
        return _whole(self.data, "first_image", 0)

    def draw(self, image_index: int) -> DrawnRecipe:
        """The recipe of one image, 0 being the recipe's first.

        Each value has its own stream of random numbers, named by its key and the image: adding, removing or changing
        one distribution leaves the others' draws as they were.

        Raises
        ------
        RecipeError : a drawn value is one that the schema rejects.
        """
        if image_index < 0:
            raise RecipeError("no such image", expected="an index of at least 0", got=str(image_index))
        image = self._first_image + image_index
        return self._drawn(self._values(image), image)

    def probes(self) -> Iterator[DrawnRecipe]:
        """The first image, then the recipe at the ends of its distributions, for checks before anything is simulated.

        Each distribution goes through its extreme values while the others stay as drawn; then all stand at their
        first and all at their last extreme together.
        """
        for values in self._probe_values():
            yield self._drawn(values, self._first_image)

    def check(self) -> None:
        """Raise `RecipeError` if the first image, or a distribution's extreme value, breaks the schema."""
        for values in self._probe_values():
            self._validated(values)

    def _probe_values(self) -> Iterator[dict[Keys, Scalar]]:
        values = self._values(self._first_image)
        yield values
        for keys, distribution in self.distributions.items():
            for extreme in distribution.extremes():
                yield {**values, keys: extreme}
        if len(self.distributions) > 1:
            for end in (0, -1):
                yield {keys: distribution.extremes()[end] for keys, distribution in self.distributions.items()}

    def _values(self, image: int) -> dict[Keys, Scalar]:
        return {
            keys: distribution.of_image(image)
            if isinstance(distribution, InOrder)
            else distribution.draw(child_rng(self.seed, "recipe", image, dotted(keys)))
            for keys, distribution in self.distributions.items()
        }

    def _validated(self, values: Mapping[Keys, Scalar]) -> Recipe:
        data = copy.deepcopy(self.data)
        for keys, value in values.items():
            _put(data, keys, value)
        spell_out(data)
        if settle_biome(data, self.sources):
            merge_species(data, self.sources, self.path.parent)
        embed_program(data, self.sources, self.path.parent)
        embed_tables(data, self.sources, self.path.parent)
        embed_maps(data, self.sources, self.path.parent, self.file_sha256)
        try:
            return Recipe.model_validate(data)
        except ValidationError as failure:
            raise Explainer(Recipe, data, self.sources, (), self.written).error(failure) from failure

    def _drawn(self, values: Mapping[Keys, Scalar], image: int) -> DrawnRecipe:
        recipe = self._validated(values)
        settled = {name: species.settled() for name, species in recipe.species.items()}
        recipe = recipe.model_copy(update={"species": settled, "images": 1, "first_image": image})
        seed = child_root(self.seed, "image", 0 if recipe.same_stand else image)
        return DrawnRecipe(recipe, _plain(recipe), image, seed, self.path.parent, self.sources, self.written)


def load_recipe(path: Path | str, overrides: Sequence[str] = ()) -> LoadedRecipe:
    """Read a recipe and check all that can be checked before drawing each image.

    Parameters
    ----------
    path : the recipe's file.
    overrides : ``key.path=value`` each, applied in order; the value is YAML.

    Raises
    ------
    RecipeError, AssetError : with the place, what was expected, what was found, what to do.
    """
    path = Path(path)
    _suggest_shipped(path)
    data, sources = read_yaml(path)
    return _loaded(path, data, sources, overrides)


def load_recipe_data(data: Mapping[str, Any], name: str) -> LoadedRecipe:
    """A recipe that a command makes itself; errors name it `name`, and its paths are relative to the current folder."""
    return _loaded(Path(name), copy.deepcopy(dict(data)), SourceMap({(): Place(name)}), ())


def _loaded(path: Path, data: dict[str, Any], sources: SourceMap, overrides: Sequence[str]) -> LoadedRecipe:
    spell_out(data)
    for override in overrides:
        apply_override(data, sources, override)
        spell_out(data)
    _check_version(data, sources)
    merge_species(data, sources, path.parent)
    written = dict(_find_distributions(data, ()))
    distributions = {keys: _parsed(value, sources.where(keys)) for keys, value in written.items()}
    loaded = LoadedRecipe(path, data, sources, distributions, written)
    loaded.check()
    return loaded


class _Representer(SafeRepresenter):
    """Writes texts of several lines, such as programs, line by line."""


def _represent_text(representer: SafeRepresenter, text: str) -> Any:
    return representer.represent_scalar("tag:yaml.org,2002:str", text, style="|" if "\n" in text else None)


_Representer.add_representer(str, _represent_text)


def dump_yaml(drawn: DrawnRecipe) -> str:
    """The drawn recipe as YAML text, the same bytes for the same content; `load_recipe` reads it."""
    yaml = YAML(typ="safe", pure=True)
    yaml.Representer = _Representer
    yaml.default_flow_style = None  # lists of numbers on one line
    yaml.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
    yaml.allow_unicode = True
    yaml.width = 120
    yaml.representer.ignore_aliases = lambda *_: True
    text = io.StringIO()
    yaml.dump(drawn.data, text)
    return text.getvalue()


def _suggest_shipped(path: Path) -> None:
    """A missing file that looks like a shipped recipe's name is met with that recipe's path."""
    name = path.name.removesuffix(".yaml")
    try:
        if path.exists():
            return
    except (OSError, ValueError) as cause:
        raise AssetError("not a file's name", where=f"{str(path)!r:.80}", expected="a recipe's path") from cause
    names = list_assets("recipes")
    near = difflib.get_close_matches(name, names, n=1)
    hint = f"a recipe comes with forestgen: {recipes_dir() / near[0]}.yaml" if near else None
    raise AssetError("no such recipe", where=str(path), expected="the path of a YAML file", got="no file", hint=hint)


def _check_version(data: Mapping[str, Any], sources: SourceMap) -> None:
    version = data.get("forestgen")
    if version == SCHEMA_VERSION and not isinstance(version, bool):
        return
    got = show(version) if "forestgen" in data else "no such key"
    newer = isinstance(version, int) and version > SCHEMA_VERSION
    raise RecipeError(
        "unknown version of the recipe's schema",
        where=sources.where(("forestgen",)),
        expected=f"forestgen: {SCHEMA_VERSION}",
        got=got,
        hint="this recipe is for a newer forestgen" if newer else f"write 'forestgen: {SCHEMA_VERSION}' at the top",
    )


def _find_distributions(value: Any, keys: Keys) -> Iterator[tuple[Keys, Mapping[str, Any]]]:
    if keys in UNDRAWN:
        return
    if keys and is_distribution(value):
        yield keys, value
    elif isinstance(value, dict):
        for key, item in value.items():
            yield from _find_distributions(item, (*keys, key))
    elif isinstance(value, list):
        for i, item in enumerate(value):
            yield from _find_distributions(item, (*keys, i))


def _parsed(value: Mapping[str, Any], where: str) -> Distribution:
    try:
        return parse_distribution(value)
    except BadDistributionError as cause:
        raise RecipeError("bad distribution", where=where, expected=str(cause), got=show(value)) from cause


def _whole(data: Mapping[str, Any], key: str, default: int) -> int:
    """A whole number needed before validation; a bad one counts as the default until validation rejects it."""
    value = data.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 2**63:
        return default
    return int(value)


def _put(data: Any, keys: Keys, value: Any) -> None:
    for key in keys[:-1]:
        data = data[key]
    data[keys[-1]] = value


def _plain(recipe: Recipe) -> dict[str, Any]:
    data: dict[str, Any] = recipe.model_dump(mode="json")
    for species in data["species"].values():
        for key in ("height_m", "modules", "modules_plant"):
            if species[key] is None:
                del species[key]
    return data
