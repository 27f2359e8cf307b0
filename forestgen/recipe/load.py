"""A recipe from its file: read, overridden, merged, checked; then drawn, image by image.

>>> loaded = load_recipe("recipes/stand.yaml", ["seed=3"])      # doctest: +SKIP
>>> drawn = loaded.draw(0)                                      # doctest: +SKIP
>>> drawn.recipe.site.size_m, drawn.image_seed                  # doctest: +SKIP
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from forestgen.core.arguments import plain_copy
from forestgen.core.errors import AssetError, ErrorList, RecipeError
from forestgen.core.randomness import child_root
from forestgen.recipe.assemble import apply_override, embed_files, merge_species, normalize
from forestgen.recipe.assets import find_asset, list_assets, recipes_dir
from forestgen.recipe.biome import forget_drawn_biome, settle_biome
from forestgen.recipe.dataset import NUMBERS_END, split_of
from forestgen.recipe.distributions import Distribution, Scalar
from forestgen.recipe.draws import Draws, find_written, get, make_draws, mentions, put, splits_of, whole_number
from forestgen.recipe.map_files import embed_maps, recipe_hash
from forestgen.recipe.messages import Explainer, distribution_of, show
from forestgen.recipe.schema import NO_PLANTS, SCHEMA_VERSION, Recipe
from forestgen.recipe.sources import Keys, Place, SourceMap, copied, mapping_of, read_yaml, yaml_text
from forestgen.recipe.species import Species

ModelT = TypeVar("ModelT", bound=BaseModel)
Source = Path | str | Mapping[str, Any]
# Words of keys that files are found by, or checked with: see `LoadedRecipe._template`.
_OF_FILES = frozenset({"program", "spectrum", "season", "bands", "biome"})
_MOST_TEMPLATES = 16
_STAND_IN = "poplar"  # a shipped species, small and complete
_MOST_PROBES_OF_ERRORS = 50  # of a recipe with errors
_MOST_ROUNDS = 4
# Section -> section in which the schema reports what does not fit it; such errors do not count for a stand-in.
_ERRORS_OF_OTHERS = {"site": "site", "species": "labels", "wind": "cameras"}


@dataclass(frozen=True)
class DrawnRecipe:
    """The recipe of one image: every distribution drawn, every default filled in, every species whole."""

    recipe: Recipe
    data: dict[str, Any]  # plain, complete; stored as YAML and loaded again it gives this image again
    image_index: int  # of the image itself: the recipe's first_image plus the index drawn
    image_seed: int  # in [0, 2^63); the root of this image's own randomness; with same_stand, image 0's or its split's
    folder: Path  # of the recipe: paths in it are relative to this
    sources: SourceMap = field(repr=False)
    written: Mapping[Keys, Any] = field(repr=False)  # the drawn values' distributions as written
    # What they gave, by key path in the recipe as written; of a choice among mappings or lists the number of the entry.
    draws: Mapping[Keys, Scalar] = field(default_factory=dict, repr=False)

    @property
    def split(self) -> str:
        """The part of a batch that the image belongs to, such as ``train``."""
        return split_of(self.recipe.dataset.splits, self.image_index)

    @property
    def species(self) -> dict[str, Species]:
        """Species by their name in the recipe, in its order."""
        return self.recipe.species

    def where(self, *keys: str | int) -> str:
        """``file:line: a.b.c`` of a key, for messages; a key not written lies at its nearest ancestor."""
        return self.sources.where(keys)

    def drawn_from(self, got: str, *keys: str | int) -> str:
        """What the value at `keys` is, for messages: `got`, and the distribution that it was drawn from."""
        written = distribution_of(keys, self.written)
        return got if written is None else f"{got}, from {show(written)}"

    def parse(self, model: type[ModelT], data: Mapping[str, Any], keys: Keys) -> ModelT:
        """A model's or generator's own keys, validated by its pydantic class.

        `keys` is the path of `data` in the recipe, such as ``("community",)``. Raises `RecipeError`, worded like the
        errors of the recipe's own keys.
        """
        try:
            return model.model_validate(dict(data), context={"folder": self.folder})  # where its files are
        except ValidationError as failure:
            explainer = Explainer(model, data, self.sources, tuple(keys), self.written)
            raise explainer.error(failure) from None  # its text would come first in a traceback


@dataclass(frozen=True)
class LoadedRecipe:
    """A recipe as written: overrides applied, species merged, distributions not yet drawn."""

    path: Path
    data: dict[str, Any]  # without defaults
    sources: SourceMap = field(repr=False)
    draws: Draws = field(repr=False)
    file_sha256: dict[Path, str] = field(default_factory=dict, repr=False, compare=False)  # of the files it names
    # Of this `data`, so that `dataclasses.replace` begins with none.
    _templates: dict[tuple[Scalar, ...], dict[str, Any]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    @property
    def seed(self) -> int:
        """The root seed."""
        return whole_number(self.data, "seed", 0)

    @property
    def distributions(self) -> Mapping[Keys, Distribution]:
        """What is drawn, by key path."""
        return self.draws.distributions

    @property
    def written(self) -> Mapping[Keys, Any]:
        """Distributions, variables and formulas as written, by key path."""
        return self.draws.written

    @property
    def splits(self) -> Mapping[str, float]:
        """Name -> share of the parts of a batch."""
        return splits_of(self.data)

    @property
    def images(self) -> int:
        """How many images the recipe makes."""
        return whole_number(self.data, "images", 1)

    @cached_property
    def complete(self) -> dict[str, Any]:
        """Everything the recipe says: defaults filled in, species merged, distributions as written."""
        data = _plain(self._validated(self.draws.values(self._first_image)))
        if any(keys[:2] == ("community", "biome") for keys in self.written):
            forget_drawn_biome(data, self.data)
        for keys, written in self.written.items():
            try:
                put(data, keys, copied(written))
            except (KeyError, IndexError, TypeError):  # in a grid, which its class keeps in another form
                kept = next(keys[:end] for end in range(len(keys) - 1, 0, -1) if _is_at(data, keys[:end]))
                put(data, kept, copied(get(self.data, kept)))
        embed_maps(data, self.sources, self.path.parent, self.file_sha256)  # those that are chosen for each image
        return data

    @cached_property
    def hash(self) -> str:
        """SHA-256 of `complete`."""
        return recipe_hash(self.complete)

    @property
    def _first_image(self) -> int:
        return whole_number(self.data, "first_image", 0)

    def draw(self, image_index: int) -> DrawnRecipe:
        """The recipe of one image, 0 being the first; raises `RecipeError` if the schema rejects a drawn value.

        Each value has its own stream of random numbers, named by its key and the image: adding, removing or changing
        one distribution leaves the others' draws as they were. What the section ``sampling`` places follows from the
        image's split and its rank there: see `forestgen.recipe.sampler`.
        """
        image = self._first_image + image_index
        if not self._first_image <= image < NUMBERS_END:
            raise RecipeError("no such image", expected=f"an index from 0 to {NUMBERS_END - 1}", got=str(image_index))
        return self._drawn(self.draws.values(image), image)

    def probes(self) -> Iterator[DrawnRecipe]:
        """The first image, then the recipe at the ends of its distributions, for checks before anything is simulated.

        Each distribution goes through its extreme values while the others stay as drawn; then all stand at their
        first and all at their last extreme together.
        """
        for values in self._probe_values():
            yield self._drawn(values, self._first_image)

    def check(self) -> None:
        """Raise `RecipeError` if the first image, or a distribution's extreme value, breaks the schema."""
        errors = ErrorList(str(self.path))
        for number, values in enumerate(self._probe_values()):
            if errors and number > _MOST_PROBES_OF_ERRORS:
                break
            errors.attempt(self._validated, values)
        errors.raise_all()

    def _probe_values(self) -> Iterator[Mapping[Keys, Scalar]]:
        values = self.draws.values(self._first_image)
        yield values
        yield from self.draws.probes(values)

    def _validated(self, values: Mapping[Keys, Scalar]) -> Recipe:
        errors = ErrorList(str(self.path))
        data = copied(self._template(values, errors))
        self.draws.put(data, values, {keys: None for keys in self.written if keys not in self._file_keys})
        normalize(data)
        errors.attempt(embed_maps, data, self.sources, self.path.parent, self.file_sha256)
        recipe = errors.attempt(self._parsed, data, values)
        errors.raise_all()
        assert recipe is not None
        return recipe

    def _parsed(self, data: dict[str, Any], values: Mapping[Keys, Scalar]) -> Recipe:
        try:
            return Recipe.model_validate(data)
        except ValidationError as failure:
            sources, written = self.draws.placed(values, self.sources)
            raise Explainer(Recipe, data, sources, (), written).error(failure) from None

    def _template(self, values: Mapping[Keys, Scalar], errors: ErrorList) -> dict[str, Any]:
        """The data with all that files are needed for; it is the same for most images, so the last few are kept."""
        chosen = tuple(values[keys] for keys in self._file_keys if keys in values)
        if chosen in self._templates:
            return self._templates[chosen]
        data: dict[str, Any] = copied(self.data)
        self.draws.put(data, values, dict.fromkeys(self._file_keys))
        normalize(data)
        if errors.attempt(settle_biome, data, self.sources):
            merge_species(data, self.sources, self.path.parent, errors)
        embed_files(data, self.sources, self.path.parent, errors)
        if not errors:
            while len(self._templates) >= _MOST_TEMPLATES:
                del self._templates[next(iter(self._templates))]
            self._templates[chosen] = data
        return data

    @cached_property
    def _file_keys(self) -> tuple[Keys, ...]:
        """What is drawn, and decides which files are needed or whether they fit."""
        community = self.data.get("community")
        biome = isinstance(community, dict) and "biome" in community
        found: list[Keys] = []
        for keys, written in self.written.items():
            inside = any(keys[:n] in found for n in range(1, len(keys)))
            of_biome = biome and (keys[0] == "community" or keys[:2] == ("site", "size_m"))
            structured = self.draws.is_numbered(keys) and mentions(written, _OF_FILES)
            if inside or of_biome or structured or not _OF_FILES.isdisjoint(keys):
                found.append(keys)
        return tuple(found)

    def _drawn(self, values: Mapping[Keys, Scalar], image: int) -> DrawnRecipe:
        recipe = self._validated(values)
        settled = {name: species.settled() for name, species in recipe.species.items()}
        alone = {"species": settled, "images": 1, "first_image": image, "sampling": None}
        recipe = recipe.model_copy(update=alone)
        sources, written = self.draws.placed(values, self.sources)
        drawn = self.draws.active(values)
        if recipe.same_stand == "by_split":
            seed = child_root(self.seed, "split", split_of(recipe.dataset.splits, image))
        else:
            seed = child_root(self.seed, "image", 0 if recipe.same_stand else image)
        return DrawnRecipe(recipe, _plain(recipe), image, seed, self.path.parent, sources, written, drawn)


def load_recipe(path: Path | str, overrides: Sequence[str] = ()) -> LoadedRecipe:
    """Read a recipe and check all that can be checked before drawing each image.

    The overrides, ``key.path=value`` each, are applied in order; the value is YAML. Raises `RecipeError`, `AssetError`,
    or `RecipeErrors` for several of them.
    """
    return read_recipe(path, overrides).whole()


def load_recipe_data(data: Mapping[str, Any], name: str, folder: Path = Path()) -> LoadedRecipe:
    """A recipe that is no file; errors name it `name`, and its paths are relative to `folder`."""
    return read_recipe(data, name=name, folder=folder).whole()


@dataclass(frozen=True)
class Loading:
    """A recipe's file as far as it can be understood, and all that is wrong with it."""

    errors: ErrorList
    sound: LoadedRecipe | None  # the recipe with stand-ins for what is wrong, for further checks; None: impossible
    stand_ins: frozenset[str]  # sections that hold some
    sources: SourceMap
    community: object = None  # that section as written, overrides applied

    def whole(self) -> LoadedRecipe:
        """The recipe; raises all errors if it has any."""
        self.errors.raise_all()
        assert self.sound is not None
        return self.sound


@dataclass(frozen=True)
class RecipeSource:
    """What an author wrote, as it was when it was read."""

    path: Path  # of the file; of a mapping or a text a name in the folder that its paths are relative to
    data: dict[str, Any]
    places: Mapping[Keys, Place]


def read_source(source: Source, name: str = "recipe", folder: Path = Path()) -> RecipeSource:
    """Read a recipe's file; see `read_recipe`. Raises the errors of a text that is no YAML mapping."""
    if isinstance(source, Mapping):
        return RecipeSource(folder / name, plain_copy(source, name), {(): Place(name)})
    if isinstance(source, str) and "\n" in source:
        path, (data, sources) = folder / name, mapping_of(source, "recipe text")
    else:
        path = Path(source)
        _suggest_shipped(path)
        data, sources = read_yaml(path)
    return RecipeSource(path, data, sources.places)


def read_recipe(
    source: Source | RecipeSource, overrides: Sequence[str] = (), name: str = "recipe", folder: Path = Path()
) -> Loading:
    """Read a recipe as `load_recipe` does, and keep its errors; those of a text that is no YAML mapping are raised.

    Parameters
    ----------
    source : a file, or the content of one, as a mapping or a text of several lines; or what `read_source` made of it.
    name, folder : of a mapping or a text: what errors call it, and what its paths are relative to.
    """
    read = source if isinstance(source, RecipeSource) else read_source(source, name, folder)
    path, data, sources = read.path, copied(read.data), SourceMap(dict(read.places))
    errors = ErrorList(sources.place(()).origin)
    normalize(data)
    for override in overrides:
        errors.attempt(apply_override, data, sources, override)
        normalize(data)
    if isinstance(version := data.get("forestgen"), int) and version > SCHEMA_VERSION:
        _check_version(data, sources)  # a newer schema's keys are not ours to judge
    errors.attempt(_check_version, data, sources)
    community = copied(data.get("community"))
    failed = errors.attempt(merge_species, data, sources, path.parent, errors) or []
    stand_ins = _replace_sections(data, {("species", name) for name in failed})
    draws = errors.attempt(make_draws, data, sources)
    if draws is None:
        wrong = [keys for keys in find_written(data) if sources.where(keys) in errors.places]
        stand_ins |= _replace_sections(data, {*wrong, ("sampling",)})
        draws = ErrorList("").attempt(make_draws, data, sources)
    if draws is None:
        return Loading(errors, None, stand_ins, sources, community)
    return replace(_checked(LoadedRecipe(path, data, sources, draws), errors, stand_ins), community=community)


def _checked(loaded: LoadedRecipe, errors: ErrorList, stand_ins: frozenset[str]) -> Loading:
    """The sections that the schema rejects are replaced until it takes the recipe."""
    for _ in range(_MOST_ROUNDS):
        found = ErrorList(errors.origin)
        found.attempt(loaded.check)
        if not found:
            return Loading(errors, loaded, stand_ins, loaded.sources)
        sections = {_sections_of(place) for place in found.places}
        doubtful = {(_ERRORS_OF_OTHERS[one],) for one in stand_ins & _ERRORS_OF_OTHERS.keys()}
        if len(found.found) > 1 or not sections <= doubtful:  # such an error comes alone
            errors.add(*found.found)
        data = copied(loaded.data)
        stand_ins |= _replace_sections(data, sections)
        draws = ErrorList("").attempt(make_draws, data, loaded.sources)
        if draws is None:
            break
        loaded = replace(loaded, data=data, draws=draws)
    return Loading(errors, None, stand_ins, loaded.sources)


def _sections_of(where: str) -> Keys:
    """Section and, of species, name that an error's place names, such as ``stand.yaml:7: species.oak.ecology``."""
    keys = where.rpartition(": ")[2].split(".")
    return tuple(keys[:2] if keys[0] == "species" else keys[:1])


def _replace_sections(data: dict[str, Any], wrong: Iterable[Keys]) -> frozenset[str]:
    """Replace in place what key paths name: by defaults, or where there are none by something that the schema takes.

    Returns the sections that hold such a stand-in now, so that the other sections can be checked.
    """
    replaced = set()
    for keys in wrong:
        section = str(keys[0]) if keys else ""
        if section not in data and section not in Recipe.model_fields:
            continue
        replaced.add(section)
        if section == "species":
            species, plant = data.get(section), read_yaml(find_asset("species", _STAND_IN))[0]
            if len(keys) > 1 and isinstance(species, dict) and keys[1] in species:
                species[keys[1]] = plant
            else:
                data[section] = {_STAND_IN: plant}
        elif section == "community":
            data[section] = dict(NO_PLANTS)
        elif section == "forestgen":
            data[section] = SCHEMA_VERSION
        else:
            data.pop(section, None)
    return frozenset(replaced)


def _suggest_shipped(path: Path) -> None:
    """Raise `AssetError` for a missing file, with the path of the shipped recipe that has nearly its name."""
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
    newer = isinstance(version, int) and version > SCHEMA_VERSION
    problem, where = "unknown version of the recipe's schema", sources.where(("forestgen",))
    got = show(version) if "forestgen" in data else "no such key"
    hint = "this recipe is for a newer forestgen" if newer else f"write 'forestgen: {SCHEMA_VERSION}' at the top"
    raise RecipeError(problem, where=where, expected=f"forestgen: {SCHEMA_VERSION}", got=got, hint=hint)


def dump_yaml(drawn: DrawnRecipe) -> str:
    """The drawn recipe as YAML text, the same bytes for the same content; `load_recipe` reads it."""
    return yaml_text(drawn.data)


def _is_at(data: Any, keys: Keys) -> bool:
    """Whether there is something at a key path."""
    try:
        get(data, keys)
    except (KeyError, IndexError, TypeError):
        return False
    return True


def _plain(recipe: Recipe) -> dict[str, Any]:
    data: dict[str, Any] = recipe.model_dump(mode="json")
    for species in data["species"].values():
        for key in ("height_m", "modules", "modules_plant"):
            if species[key] is None:
                del species[key]
    if data["sampling"] is None:
        del data["sampling"]
    return data
