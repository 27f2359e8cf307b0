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
from forestgen.core.randomness import child_root
from forestgen.recipe.assemble import apply_override, embed_program, embed_tables, merge_species, spell_out
from forestgen.recipe.assets import list_assets, recipes_dir
from forestgen.recipe.biome import forget_drawn_biome, settle_biome
from forestgen.recipe.dataset import DEFAULT_SPLITS
from forestgen.recipe.distributions import Distribution, Scalar
from forestgen.recipe.draws import MOST_PROBES, Draws, copied, find_written, mentions, parsed, put
from forestgen.recipe.hashing import recipe_hash
from forestgen.recipe.map_files import embed_maps
from forestgen.recipe.messages import Explainer, show
from forestgen.recipe.sampler import Sampler, make_sampler
from forestgen.recipe.sampling import Sampling
from forestgen.recipe.schema import SCHEMA_VERSION, Recipe
from forestgen.recipe.sources import Keys, Place, SourceMap
from forestgen.recipe.species import Species
from forestgen.recipe.splits import split_of
from forestgen.recipe.variables import is_reference, make_variables
from forestgen.recipe.yaml_source import read_yaml

ModelT = TypeVar("ModelT", bound=BaseModel)
# Words of keys that files are found by, or checked with: see `LoadedRecipe._template`.
_OF_FILES = frozenset({"program", "spectrum", "season", "bands", "biome"})
_MOST_TEMPLATES = 16


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
    draws: Draws = field(repr=False)
    file_sha256: dict[Path, str] = field(default_factory=dict, repr=False, compare=False)  # of the files it names
    # Of this `data`, so that `dataclasses.replace` begins with none.
    _templates: dict[tuple[Scalar, ...], dict[str, Any]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    @property
    def seed(self) -> int:
        """The root seed."""
        return _whole(self.data, "seed", 0)

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
        return _splits(self.data)

    @property
    def images(self) -> int:
        """How many images the recipe makes."""
        return _whole(self.data, "images", 1)

    @cached_property
    def complete(self) -> dict[str, Any]:
        """Everything the recipe says: defaults filled in, species merged, distributions as written."""
        data = _plain(self._validated(self.draws.values(self._first_image)))
        if any(keys[:2] == ("community", "biome") for keys in self.written):
            forget_drawn_biome(data, self.data)
        for keys, written in self.written.items():
            put(data, keys, copied(written))
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
        one distribution leaves the others' draws as they were. What the section ``sampling`` places follows from the
        image's split and its rank there: see `forestgen.recipe.sampler`.

        Raises
        ------
        RecipeError : a drawn value is one that the schema rejects.
        """
        if image_index < 0:
            raise RecipeError("no such image", expected="an index of at least 0", got=str(image_index))
        image = self._first_image + image_index
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
        for values in self._probe_values():
            self._validated(values)

    def _probe_values(self) -> Iterator[Mapping[Keys, Scalar]]:
        values = self.draws.values(self._first_image)
        yield values
        yield from self.draws.probes(values)

    def _validated(self, values: Mapping[Keys, Scalar]) -> Recipe:
        data = copied(self._template(values))
        self.draws.put(data, values, {keys: None for keys in self.written if keys not in self._file_keys})
        spell_out(data)
        embed_maps(data, self.sources, self.path.parent, self.file_sha256)
        try:
            return Recipe.model_validate(data)
        except ValidationError as failure:
            sources, written = self.draws.placed(values, self.sources)
            raise Explainer(Recipe, data, sources, (), written).error(failure) from failure

    def _template(self, values: Mapping[Keys, Scalar]) -> dict[str, Any]:
        """The data with all that files are needed for; it is the same for most images, so the last few are kept."""
        chosen = tuple(values[keys] for keys in self._file_keys if keys in values)
        if chosen not in self._templates:
            data = copied(self.data)
            self.draws.put(data, values, dict.fromkeys(self._file_keys))
            spell_out(data)
            if settle_biome(data, self.sources):
                merge_species(data, self.sources, self.path.parent)
            embed_program(data, self.sources, self.path.parent)
            embed_tables(data, self.sources, self.path.parent)
            while len(self._templates) >= _MOST_TEMPLATES:
                del self._templates[next(iter(self._templates))]
            self._templates[chosen] = data
        return self._templates[chosen]

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
        seed = _image_seed(self.seed, recipe, image)
        return DrawnRecipe(recipe, _plain(recipe), image, seed, self.path.parent, sources, written, drawn)


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


def load_recipe_data(
    data: Mapping[str, Any], name: str, folder: Path = Path(), overrides: Sequence[str] = ()
) -> LoadedRecipe:
    """A recipe that is no file; errors name it `name`, and its paths are relative to `folder`."""
    return _loaded(folder / name, copy.deepcopy(dict(data)), SourceMap({(): Place(name)}), overrides)


def _loaded(path: Path, data: dict[str, Any], sources: SourceMap, overrides: Sequence[str]) -> LoadedRecipe:
    spell_out(data)
    for override in overrides:
        apply_override(data, sources, override)
        spell_out(data)
    _check_version(data, sources)
    merge_species(data, sources, path.parent)
    loaded = LoadedRecipe(path, data, sources, _draws(data, sources))
    if loaded.draws.probe_count > MOST_PROBES:
        raise RecipeError(
            "the recipe draws too much to be checked",
            where=sources.where(()),
            expected=f"at most {MOST_PROBES:,} ends of distributions and choices in all",
            got=f"{loaded.draws.probe_count:,}",
        )
    loaded.check()
    return loaded


def _draws(data: Mapping[str, Any], sources: SourceMap) -> Draws:
    """All that is drawn, checked."""
    section = _sampling(data, sources)
    written, seed = find_written(data), _whole(data, "seed", 0)
    distributions = parsed(written, sources)
    references = {keys: value for keys, value in written.items() if is_reference(value)}
    given = section.variables if section is not None else {}
    variables = make_variables(given, references, distributions, sources)
    sampler: Sampler | None = None
    if section is not None:
        sampler = make_sampler(section, distributions, references, sources, seed, _splits(data))
    return Draws(seed, written, distributions, variables, sampler)


def _sampling(data: Mapping[str, Any], sources: SourceMap) -> Sampling | None:
    """The section of the name, which decides how all the others are drawn."""
    written = data.get("sampling")
    if written is None:
        return None
    try:
        return Sampling.model_validate(written)
    except ValidationError as failure:
        given = written if isinstance(written, dict) else {}
        raise Explainer(Sampling, given, sources, ("sampling",)).error(failure) from failure


class _Representer(SafeRepresenter):
    """Writes texts of several lines, such as programs, line by line."""


def _represent_text(representer: SafeRepresenter, text: str) -> Any:
    return representer.represent_scalar("tag:yaml.org,2002:str", text, style="|" if "\n" in text else None)


_Representer.add_representer(str, _represent_text)


def dump_yaml(drawn: DrawnRecipe) -> str:
    """The drawn recipe as YAML text, the same bytes for the same content; `load_recipe` reads it."""
    return yaml_text(drawn.data)


def yaml_text(data: Mapping[str, Any]) -> str:
    """A recipe's plain data as YAML text."""
    yaml = YAML(typ="safe", pure=True)
    yaml.Representer = _Representer
    yaml.default_flow_style = None  # lists of numbers on one line
    yaml.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
    yaml.allow_unicode = True
    yaml.width = 120
    yaml.representer.ignore_aliases = lambda *_: True
    text = io.StringIO()
    yaml.dump(data, text)
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


def _whole(data: Mapping[str, Any], key: str, default: int) -> int:
    """A whole number needed before validation; a bad one counts as the default until validation rejects it."""
    value = data.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 2**63:
        return default
    return int(value)


def _splits(data: Mapping[str, Any]) -> Mapping[str, float]:
    """Splits are needed before validation, too; bad ones count as the default until validation rejects them."""
    section = data.get("dataset")
    splits = section.get("splits") if isinstance(section, Mapping) else None
    shares = list(splits.values()) if isinstance(splits, Mapping) else []
    good = all(isinstance(one, int | float) and not isinstance(one, bool) and 0 < one < 1e100 for one in shares)
    return {str(name): float(share) for name, share in splits.items()} if splits and shares and good else DEFAULT_SPLITS


def _image_seed(root: int, recipe: Recipe, image: int) -> int:
    if recipe.same_stand == "by_split":
        return child_root(root, "split", split_of(recipe.dataset.splits, image))
    return child_root(root, "image", 0 if recipe.same_stand else image)


def _plain(recipe: Recipe) -> dict[str, Any]:
    data: dict[str, Any] = recipe.model_dump(mode="json")
    for species in data["species"].values():
        for key in ("height_m", "modules", "modules_plant"):
            if species[key] is None:
                del species[key]
    if data["sampling"] is None:
        del data["sampling"]
    return data
