"""The recipe's section ``sampling``: where each image's draws lie in their distributions.

A drawn value is its distribution's quantile at a number u in (0, 1). Of an image, all u follow from the root seed, the
name of its split and its rank there: a batch that grows changes none, nor does the order in which images are made. The
splits need points of their own, for images are dealt to them by a sequence of base 2 too.

Strata come first: a key's range is cut into bins of equal probability, and every block of as many images of a split as
the bins of all keys have combinations has each combination once. Other keys have the method's points. What neither
places is independent. Correlations then act on u, those of strata staying as they are.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BeforeValidator, Field, field_validator, model_validator

from forestgen.core.errors import RecipeError
from forestgen.core.randomness import child_rng
from forestgen.recipe.curves import RESERVED
from forestgen.recipe.dataset import place_in_splits
from forestgen.recipe.distributions import Choice, Distribution, Integers
from forestgen.recipe.distributions import Sequence as InOrder
from forestgen.recipe.fields import Number, Section, Text, Whole, each_once, violation
from forestgen.recipe.points import MOST_KEYS, InfeasibleError, Method, cell_of, cholesky_factor, correlated, point
from forestgen.recipe.sources import Keys, SourceMap, dotted

_EDGE = 2.0**-32  # how near to a bin's edge a value comes: nearer, rounding might put it beyond
MOST_CELLS = 10_000
VARIABLES: Keys = ("sampling", "variables")
_Key = Annotated[Text, Field(min_length=1, max_length=300)]
_Variable = Annotated[Text, Field(pattern=r"^[a-z][a-z0-9_]{0,63}$")]
_Level = bool | int | float | str | None


def _is_strata(value: Any) -> Any:
    number = isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= MOST_CELLS
    levels = isinstance(value, list | tuple) and not any(isinstance(one, dict | list | tuple) for one in value)
    if value == "all" or number or levels:
        return value
    raise violation(f"all, a number of bins from 1 to {MOST_CELLS}, or a list of the choice's values")


_Strata = Annotated[Literal["all"] | Whole | tuple[_Level, ...], BeforeValidator(_is_strata)]


class Correlation(Section):
    """Two correlated drawn values."""

    keys: tuple[_Key, _Key] = Field(description="Two keys or variables that are drawn.")
    rank: Number = Field(
        gt=-1, lt=1, description="Spearman's rank correlation: 0 none, near 1 both are high at the same time."
    )

    @field_validator("keys")
    @classmethod
    def _differ(cls, value: tuple[str, str]) -> tuple[str, str]:
        if value[0] == value[1]:
            raise violation("two different keys", problem="a key correlated with itself", got=value[0])
        return value


class Sampling(Section):
    """How the draws of a recipe's images are spread over their ranges, correlated and shared."""

    method: Method = Field(
        "independent",
        description="independent: each value by itself. latin_hypercube, sobol, halton: the values of all `keys` are "
        "spread evenly over the images of each split.",
    )
    block: Whole = Field(
        128, ge=2, le=65_536, description="Of latin_hypercube: images of a split that make a whole hypercube."
    )
    keys: Annotated[tuple[_Key, ...], Field(min_length=1), AfterValidator(each_once)] | None = Field(
        None,
        description="Keys or variables that the method spreads, such as sky.sun.elevation_deg. Default: all that are "
        "drawn.",
    )
    strata: dict[_Key, _Strata] = Field(
        {},
        description="Key or variable -> number of equally likely bins; or all, each value of a choice; or a list of "
        "these values. Among as many images of a split as there are cells, each cell is met once.",
    )
    correlations: tuple[Correlation, ...] = Field((), description="Pairs of correlated drawn values.", max_length=1000)
    variables: dict[_Variable, Any] = Field(
        {},
        max_length=100,
        description="Name -> a distribution, a value or a formula of other variables. {variable: NAME} or {formula: "
        "'10 + 30 * NAME'} stands for any number of the recipe.",
    )

    @field_validator("variables")
    @classmethod
    def _own_names(cls, value: dict[str, Any]) -> dict[str, Any]:
        for name in value:
            if name in RESERVED:
                taken = ", ".join(sorted(RESERVED))
                raise violation(f"another name than {taken}", problem="formulas use this name", got=name, at=name)
        return value

    @model_validator(mode="after")
    def _keys_have_their_method(self) -> Self:
        needed = {"keys": ("latin_hypercube", "sobol", "halton"), "block": ("latin_hypercube",)}
        for name, methods in needed.items():
            if name in self.model_fields_set and self.method not in methods and getattr(self, name) is not None:
                expected = f"method: {' or '.join(methods)}, where there is {name}"
                at = "method" if "method" in self.model_fields_set else name
                raise violation(expected, problem=f"the method {self.method} has no {name}", got=self.method, at=at)
        return self


@dataclass(frozen=True, eq=False)
class Sampler:
    """The section ``sampling``, checked against what is drawn."""

    seed: int  # the recipe's
    splits: Mapping[str, float]
    method: Method
    block: int  # images of a Latin hypercube
    spread: tuple[Keys, ...]  # what the method places
    strata: tuple[tuple[Keys, int], ...]  # number of bins by key
    correlated: tuple[Keys, ...]  # those of strata first
    factor: NDArray[np.float64]  # (k, k) Cholesky factor of the k correlated keys

    def quantiles(self, image: int) -> dict[Keys, float]:
        """u by key path of all that the section places, of the image of this number."""
        split, rank = place_in_splits(self.splits, image)
        found: dict[Keys, float] = {}
        if self.spread:
            points = point(self.method, len(self.spread), self.block, self.seed, split, rank)
            found.update(zip(self.spread, points.tolist(), strict=True))
        if self.strata:
            found.update(self._stratified(image, split, rank))
        if self.correlated:
            found.update(self._correlated(found, image))
        return found

    def describe(self) -> str:
        """The section in a few words."""
        parts = [f"{self.method}, {len(self.spread)} keys" if self.spread else "independent"]
        if self.strata:
            parts.append(f"{self.cells} cells of strata: {' x '.join(_name(keys) for keys, _ in self.strata)}")
        if self.correlated:
            parts.append(f"correlated: {', '.join(_name(keys) for keys in self.correlated)}")
        return "; ".join(parts)

    def _stratified(self, image: int, split: str, rank: int) -> dict[Keys, float]:
        cell = cell_of(self.cells, self.seed, split, rank)
        found = {}
        for keys, bins in self.strata:
            cell, number = divmod(cell, bins)
            found[keys] = (number + min(max(self._independent(keys, image), _EDGE), 1.0 - _EDGE)) / bins
        return found

    def _correlated(self, found: Mapping[Keys, float], image: int) -> dict[Keys, float]:
        given = [found[keys] if keys in found else self._independent(keys, image) for keys in self.correlated]
        values = correlated(np.array(given), self.factor).tolist()
        in_strata = {keys for keys, _ in self.strata}
        return {keys: u for keys, u in zip(self.correlated, values, strict=True) if keys not in in_strata}

    def _independent(self, keys: Keys, image: int) -> float:
        return min(max(child_rng(self.seed, "sampling", image, dotted(keys)).random(), _EDGE), 1.0 - _EDGE)

    @cached_property
    def cells(self) -> int:
        """Combinations of the strata's bins."""
        return math.prod(bins for _, bins in self.strata)


def make_sampler(
    section: Sampling,
    distributions: Mapping[Keys, Distribution],
    references: Mapping[Keys, Any],
    sources: SourceMap,
    seed: int,
    splits: Mapping[str, float],
) -> Sampler:
    """Check the section against what is drawn; references are what follows from variables.

    Raises `RecipeError` for a key that is not drawn, strata that cannot be cut or are too many, and correlations that
    cannot all hold.
    """
    keys_of = _Keys(distributions, references, sources)
    strata = tuple(
        (keys, _bins(distributions[keys], wanted, sources.where(("sampling", "strata", name))))
        for name, wanted in section.strata.items()
        for keys in [keys_of.find(name, ("sampling", "strata", name))]
    )
    cells = math.prod(bins for _, bins in strata)
    if cells > MOST_CELLS:
        where, expected = sources.where(("sampling", "strata")), f"at most {MOST_CELLS:,} combinations of bins"
        got = f"{' x '.join(str(bins) for _, bins in strata)} = {cells:,}"
        hint = "fewer bins, or leave some of these keys to the method"
        raise RecipeError("too many strata", where=where, expected=expected, got=got, hint=hint)
    correlated, factor = _correlations(section, keys_of, [keys for keys, _ in strata], sources)
    spread = _spread(section, keys_of, {keys for keys, _ in strata})
    return Sampler(seed, splits, section.method, section.block, spread, strata, correlated, factor)


@dataclass(frozen=True)
class _Keys:
    """Finds what a name of the section means."""

    distributions: Mapping[Keys, Distribution]
    references: Mapping[Keys, Any]
    sources: SourceMap

    @cached_property
    def names(self) -> dict[str, Keys]:
        """Of all that is drawn at random: key paths, and variables by their name."""
        return {_name(keys): keys for keys, one in self.distributions.items() if not isinstance(one, InOrder)}

    def find(self, name: str, at: Keys) -> Keys:
        if name in self.names:
            return self.names[name]
        where = self.sources.where(at)
        expected = f"one of {_some(list(self.names))}" if self.names else "a distribution; this recipe has none"
        for keys in self.distributions:
            if _name(keys) == name:
                got, hint = "a sequence, which is not random", "use {choice: [...]}"
                raise RecipeError("this key is not drawn at random", where=where, expected=expected, got=got, hint=hint)
        for keys in self.references:
            if _name(keys) == name:
                raise RecipeError("this key follows from variables", where=where, expected="the variables' names")
        written = [keys for keys in self.sources.places if dotted(keys) == name]
        near = difflib.get_close_matches(name, self.names, n=1, cutoff=0.6)
        problem, advice = "no such key is drawn", f"did you mean {near[0]}?" if near else None
        if written:
            problem, advice = "this key is no distribution", f"make it one: {written[0][-1]}: {{uniform: [a, b]}}"
        raise RecipeError(problem, where=where, expected=expected, got=name, hint=advice)


def is_variable(keys: Keys) -> bool:
    """Whether a key path is that of a variable."""
    return keys[:2] == VARIABLES and len(keys) == 3


def _name(keys: Keys) -> str:
    return str(keys[-1]) if is_variable(keys) else dotted(keys)


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:12]) + (f" and {len(names) - 12} more" if len(names) > 12 else "")


def _bins(distribution: Distribution, wanted: Any, where: str) -> int:
    """Number of bins that a key of the strata has."""
    if isinstance(wanted, int):
        return wanted
    if isinstance(distribution, Integers) and wanted == "all":
        count = distribution.high - distribution.low + 1
        if count <= MOST_CELLS:
            return count
    if not isinstance(distribution, Choice):
        expected = "a number of bins, for what is no choice"
        raise RecipeError("bad strata", where=where, expected=expected, got=f"{wanted!r:.60}", hint="3")
    if distribution.weights is not None and len(set(distribution.weights)) > 1:
        total = sum(distribution.weights)
        bins = total / min(distribution.weights)
        hint = f"{bins:g} bins have each value as often as its weight says" if bins == int(bins) else None
        expected = "a number of bins, for a choice with weights"
        raise RecipeError("strata would undo the weights", where=where, expected=expected, got="all", hint=hint)
    if wanted != "all" and distribution.numbered:
        raise RecipeError("bad strata", where=where, expected="all, where mappings or lists are chosen")
    if wanted != "all" and (
        len(wanted) != len(distribution.values) or any(one not in wanted for one in distribution.values)
    ):
        expected = f"all, or every value of the choice: {_some([str(value) for value in distribution.values])}"
        raise RecipeError("bad strata", where=where, expected=expected, got=_some([str(value) for value in wanted]))
    return len(distribution.values)


def _spread(section: Sampling, keys_of: _Keys, in_strata: set[Keys]) -> tuple[Keys, ...]:
    """What the method places, in the order that it is listed or written."""
    if section.method == "independent":
        return ()
    names = list(section.keys or keys_of.names)
    found = [keys_of.find(name, ("sampling", "keys", n)) for n, name in enumerate(names)]
    spread = tuple(keys for keys in found if keys not in in_strata)
    if len(spread) > MOST_KEYS:
        where, expected = keys_of.sources.where(("sampling", "method")), f"at most {MOST_KEYS}"
        problem, hint = "too many keys for a method", "sampling.keys names those that matter"
        raise RecipeError(problem, where=where, expected=expected, got=f"{len(spread)}", hint=hint)
    return spread


def _correlations(
    section: Sampling, keys_of: _Keys, in_strata: Sequence[Keys], sources: SourceMap
) -> tuple[tuple[Keys, ...], NDArray[np.float64]]:
    """The correlated keys, those of strata first so that these stay as they are, and the factor of their matrix."""
    pairs: list[tuple[Keys, Keys]] = []
    for n, entry in enumerate(section.correlations):
        path = ("sampling", "correlations", n)
        one, other = (keys_of.find(name, (*path, "keys", k)) for k, name in enumerate(entry.keys))
        where, got = sources.where(path), " and ".join(entry.keys)
        if (one, other) in pairs or (other, one) in pairs:
            raise RecipeError("a pair twice", where=where, expected="each pair once", got=got)
        if one in in_strata and other in in_strata:
            expected = "at most one key of a pair among sampling.strata, for all their combinations are equally often"
            raise RecipeError("strata that are correlated", where=where, expected=expected, got=got)
        pairs.append((one, other))
    found = dict.fromkeys(keys for pair in pairs for keys in pair)
    ordered = [keys for keys in found if keys in in_strata] + [keys for keys in found if keys not in in_strata]
    ranks = [entry.rank for entry in section.correlations]
    numbered = [
        (ordered.index(one), ordered.index(other), rank) for (one, other), rank in zip(pairs, ranks, strict=True)
    ]
    try:
        return tuple(ordered), cholesky_factor(len(ordered), numbered)
    except InfeasibleError as cause:
        entry = section.correlations[cause.pair]
        problem, where = "these correlations cannot all hold", sources.where(("sampling", "correlations", cause.pair))
        expected = f"rank: {cause.nearest:g} at the nearest, for {' and '.join(entry.keys)}, beside the other pairs"
        hint = "pairs that are not named have no correlation; name them too if they should have one"
        raise RecipeError(problem, where=where, expected=expected, got=f"{entry.rank:g}", hint=hint) from cause
