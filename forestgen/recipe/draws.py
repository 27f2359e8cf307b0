"""All that a recipe draws: distributions and what follows from variables, found in its data, checked and drawn.

A choice may be among mappings or lists that hold distributions again; the key path of one of these goes through the
choice, such as ``sky.clouds.choice.1.cover``. Values are put in place from the inside out, the choice's own last.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import ValidationError

from forestgen.core.errors import ErrorList, RecipeError
from forestgen.core.randomness import child_rng
from forestgen.recipe.dataset import DEFAULT_SPLITS
from forestgen.recipe.distributions import (
    BadDistributionError,
    Choice,
    Distribution,
    Scalar,
    is_distribution,
    parse_distribution,
)
from forestgen.recipe.distributions import Sequence as InOrder
from forestgen.recipe.messages import UNDRAWN, Explainer, show
from forestgen.recipe.sampler import Sampler, Sampling, make_sampler
from forestgen.recipe.sources import Keys, SourceMap, dotted
from forestgen.recipe.variables import SECTION as VARIABLES
from forestgen.recipe.variables import Variables, is_reference, make_variables, needs_variables

Values = Mapping[Keys, Scalar]
MOST_PROBES = 1000  # a recipe is checked so many times at most
_MOST_TRIED = 50  # of one distribution's numbers


def _tried(one: Distribution) -> list[Scalar]:
    """A distribution's extreme values, each once; of more than `_MOST_TRIED` numbers the ends and some between.

    Mappings and lists, which are chosen by their numbers, are all tried, and texts are.
    """
    values = list({(type(value), value): value for value in one.extremes()}.values())  # 1 is not true
    numbers = all(isinstance(value, int | float) for value in values) and not (isinstance(one, Choice) and one.numbered)
    if len(values) <= _MOST_TRIED or not numbers:
        return values
    ranked = sorted(values, key=float)  # type: ignore[arg-type]
    return [ranked[k * (len(ranked) - 1) // (_MOST_TRIED - 1)] for k in range(_MOST_TRIED)]


@dataclass(frozen=True)
class Draws:
    """What is drawn, by key path in the recipe's order: a choice before what lies in it."""

    seed: int  # the recipe's
    written: Mapping[Keys, Any]  # distributions and references
    distributions: Mapping[Keys, Distribution]
    variables: Variables
    sampler: Sampler | None  # None: all draws are independent

    def values(self, image: int) -> dict[Keys, Scalar]:
        """Of one image, by its number.

        Each value has its own stream of random numbers, named by its key and the image, or its place by `sampler`.
        """
        placed = self.sampler.quantiles(image) if self.sampler is not None else {}
        drawn = {keys: self._drawn(keys, one, image, placed) for keys, one in self.distributions.items()}
        return {**drawn, **self.variables.values(drawn)}

    def _drawn(self, keys: Keys, one: Distribution, image: int, placed: Mapping[Keys, float]) -> Scalar:
        if keys in placed:
            return one.quantile(placed[keys])
        if isinstance(one, InOrder):
            return one.of_image(image)
        return one.draw(child_rng(self.seed, "recipe", image, dotted(keys)))

    @property
    def probe_count(self) -> int:
        """How many `probes` there are, at most."""
        return 2 + sum(len(_tried(one)) for one in self.distributions.values())

    def probes(self, first: Values) -> Iterator[dict[Keys, Scalar]]:
        """Values at the ends of the distributions; `first` are those of an image.

        Each distribution goes through its extreme values while the others stay; then all stand at their first and all
        at their last extreme together.
        """
        for keys, one in self.distributions.items():
            within = dict(self._choices_around(keys))
            for extreme in _tried(one):
                yield self._followed({**first, **within, keys: extreme})
        if len(self.distributions) > 1:
            for end in (0, -1):
                yield self._followed({keys: one.extremes()[end] for keys, one in self.distributions.items()})

    def _followed(self, values: Values) -> dict[Keys, Scalar]:
        return {**values, **self.variables.values({keys: values[keys] for keys in self.distributions})}

    def put(self, data: dict[str, Any], values: Values, only: Mapping[Keys, Any] | None = None) -> None:
        """Put values in place, all or those of `only`, whose order is that of `written`."""
        for keys in reversed(list(self.written if only is None else only)):
            if keys in values:
                value: Any = values[keys]
                if self.is_numbered(keys):
                    value = _entries(get(data, keys))[int(value)]
                put(data, keys, value)

    def active(self, values: Values) -> dict[Keys, Scalar]:
        """The values that are in the image: not those of mappings or lists that were not chosen."""
        if not self._numbered:
            return dict(values)
        return {
            keys: value
            for keys, value in values.items()
            if all(values[choice] == number for choice, number in self._choices_around(keys))
        }

    def placed(self, values: Values, sources: SourceMap) -> tuple[SourceMap, Mapping[Keys, Any]]:
        """Where the keys of an image were written and what was, after the choices among mappings and lists."""
        if not self._numbered:
            return sources, self.written
        active = self.active(values)
        moved = SourceMap(dict(sources.places))
        for choice in self._numbered:
            if choice in active:
                moved.take(moved, self._inside(choice, int(active[choice] or 0)), self._final(choice))
        return moved, {self._final(keys): self.written[keys] for keys in active}

    def is_numbered(self, keys: Keys) -> bool:
        """Whether a choice among mappings or lists is at `keys`."""
        one = self.distributions.get(keys)
        return isinstance(one, Choice) and one.numbered

    @property
    def _numbered(self) -> list[Keys]:
        return [keys for keys in self.distributions if self.is_numbered(keys)]

    def _choices_around(self, keys: Keys) -> Iterator[tuple[Keys, int]]:
        """The choices that a key path goes through, and which of their entries it is in."""
        for n in range(1, len(keys) - 1):
            if self.is_numbered(keys[:n]):
                yield keys[:n], int(keys[n + 1] if keys[n + 1] != "values" else keys[n + 2])

    def _inside(self, choice: Keys, number: int) -> Keys:
        weighted = isinstance(self.written[choice]["choice"], Mapping)
        return (*choice, "choice", "values", number) if weighted else (*choice, "choice", number)

    def _final(self, keys: Keys) -> Keys:
        """The key path after all choices were made."""
        found: list[str | int] = []
        n = 0
        while n < len(keys):
            found.append(keys[n])
            n += 1
            if n < len(keys) and self.is_numbered(keys[:n]):
                n += 3 if keys[n + 1] == "values" else 2
        return tuple(found)


def find_written(data: Mapping[str, Any]) -> dict[Keys, Any]:
    """All distributions and references of a recipe's data, as written."""
    section = data.get("sampling")
    variables = section.get("variables") if isinstance(section, Mapping) else None
    variables = variables if isinstance(variables, Mapping) else {}
    found = {
        (*VARIABLES, str(name)): value
        for name, value in variables.items()
        if is_distribution(value) or is_reference(value)
    }
    return {**found, **dict(_find(data, (), variables))}


def _find(value: Any, keys: Keys, variables: Mapping[str, Any]) -> Iterator[tuple[Keys, Mapping[str, Any]]]:
    if keys in UNDRAWN:
        return
    if keys and (is_distribution(value) or (is_reference(value) and needs_variables(value, variables))):
        yield keys, value
        if "choice" not in value:
            return
    if isinstance(value, dict):
        for key, item in value.items():
            yield from _find(item, (*keys, key), variables)
    elif isinstance(value, list):
        for i, item in enumerate(value):
            yield from _find(item, (*keys, i), variables)


def _parsed(written: Mapping[Keys, Any], sources: SourceMap) -> dict[Keys, Distribution]:
    """The distributions among what is written; raises `RecipeError` with the places of bad ones."""
    errors = ErrorList(sources.place(()).origin)
    chosen = {keys: value for keys, value in written.items() if is_distribution(value)}
    tried = {keys: errors.attempt(_distribution, keys, value, sources) for keys, value in chosen.items()}
    errors.raise_all()
    return {keys: one for keys, one in tried.items() if one is not None}


def _distribution(keys: Keys, value: Any, sources: SourceMap) -> Distribution:
    where = sources.where(keys)
    try:
        one = parse_distribution(value)
    except BadDistributionError as cause:
        expected, hint = str(cause), cause.hint
        raise RecipeError("bad distribution", where=where, expected=expected, got=show(value), hint=hint) from cause
    of_species = keys[0] == "species"
    if isinstance(one, Choice) and one.numbered and (of_species or keys[: len(VARIABLES)] == VARIABLES):
        expected = "numbers, texts, true or false" + (": all images have the same species" if of_species else "")
        hint = "choose how many there are of each: community: {plants: {choice: [...]}}" if of_species else None
        problem = "no mappings or lists are chosen here"
        raise RecipeError(problem, where=where, expected=expected, got=show(value), hint=hint)
    return one


def make_draws(data: Mapping[str, Any], sources: SourceMap) -> Draws:
    """All that is drawn, checked."""
    section = _sampling(data, sources)
    written, seed = find_written(data), whole_number(data, "seed", 0)
    distributions = _parsed(written, sources)
    references = {keys: value for keys, value in written.items() if is_reference(value)}
    given = section.variables if section is not None else {}
    variables = make_variables(given, references, distributions, sources)
    sampler: Sampler | None = None
    if section is not None:
        sampler = make_sampler(section, distributions, references, sources, seed, splits_of(data))
    draws = Draws(seed, written, distributions, variables, sampler)
    if draws.probe_count > MOST_PROBES:
        problem, got = "the recipe draws too much to be checked", f"{draws.probe_count:,}"
        expected = f"at most {MOST_PROBES:,} ends of distributions and choices in all"
        raise RecipeError(problem, where=sources.where(()), expected=expected, got=got)
    return draws


def _sampling(data: Mapping[str, Any], sources: SourceMap) -> Sampling | None:
    """The section of the name, which decides how all the others are drawn."""
    written = data.get("sampling")
    if written is None:
        return None
    try:
        return Sampling.model_validate(written)
    except ValidationError as failure:
        given = written if isinstance(written, dict) else {}
        raise Explainer(Sampling, given, sources, ("sampling",)).error(failure) from None


def whole_number(data: Mapping[str, Any], key: str, default: int) -> int:
    """A whole number needed before validation; a bad one counts as the default until validation rejects it."""
    value = data.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 2**63:
        return default
    return int(value)


def splits_of(data: Mapping[str, Any]) -> Mapping[str, float]:
    """Splits are needed before validation, too; bad ones count as the default until validation rejects them."""
    section = data.get("dataset")
    splits = section.get("splits") if isinstance(section, Mapping) else None
    shares = list(splits.values()) if isinstance(splits, Mapping) else []
    good = all(isinstance(one, int | float) and not isinstance(one, bool) and 0 < one < 1e100 for one in shares)
    return {str(name): float(share) for name, share in splits.items()} if splits and shares and good else DEFAULT_SPLITS


def mentions(value: Any, words: frozenset[str]) -> bool:
    """Whether a mapping in `value`, at any depth, has one of these keys."""
    if isinstance(value, dict):
        return not words.isdisjoint(value) or any(mentions(item, words) for item in value.values())
    return isinstance(value, list) and any(mentions(item, words) for item in value)


def get(data: Any, keys: Keys) -> Any:
    """What is at a key path."""
    for key in keys:
        data = data[key]
    return data


def put(data: Any, keys: Keys, value: Any) -> None:
    """Put a value at a key path whose parent is there."""
    get(data, keys[:-1])[keys[-1]] = value


def _entries(written: Mapping[str, Any]) -> Any:
    choice = written["choice"]
    return choice["values"] if isinstance(choice, Mapping) else choice
