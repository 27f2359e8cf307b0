"""Other values of a simulation's parameters from some year on: interactive design, written down.

In a recipe::

    community:
      changes:
        - {at_yr: 50, set: {temperature_c: 9, species.pine.shade_tolerance: 0.2}}

A change is made at the end of the step that reaches its time, as a disturbance is: what happens from then on goes by
the new values. So the step from k to k + 1 goes by `parameters_at(parameters, types, k)`, which depends on k alone: a
simulation that resumes there goes by the same. Changes of one step are made in the order of the list.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol, TypeVar

from pydantic import BaseModel

from forestgen.architecture.plant_type import PlantType
from forestgen.community.branch_modules.change import Change, species_key
from forestgen.community.branch_modules.parameters import BranchModulesParameters
from forestgen.community.branch_modules.unknown_names import no_prototype, not_growing
from forestgen.core.errors import RecipeError
from forestgen.recipe.sources import Keys

M = TypeVar("M", bound=BaseModel)


class Parse(Protocol):
    """Validates a class's values, with the recipe's messages."""

    def __call__(self, model: type[M], data: Mapping[str, Any], keys: Keys) -> M: ...


def parameters_at(
    parameters: BranchModulesParameters, types: Mapping[str, PlantType], step: int
) -> tuple[BranchModulesParameters, dict[str, PlantType]]:
    """What holds from the end of `step` on: the parameters and plant types with all changes up to then.

    Parameters
    ----------
    parameters, types : as the recipe gives them; types by the names of the species that grow.

    Raises
    ------
    ValueError : a value that its key does not take, or no such key or species; `check_changes` tells so before.
    """
    changed, kinds = parameters, dict(types)
    for one in in_order(parameters):
        if one.step(parameters.step_yr) > step:
            break
        own, of_species = split(one)
        if own:
            changed = type(parameters).model_validate({**_values(changed), **own})
        for name, values in of_species.items():
            if name not in kinds:
                raise ValueError(f"no species {name!r} grows by branch modules")
            kinds[name] = PlantType.model_validate({**_values(kinds[name]), **values})
    return changed, kinds


def in_order(parameters: BranchModulesParameters) -> list[Change]:
    """The changes in the order in which they are made."""
    return sorted(parameters.changes, key=lambda one: one.step(parameters.step_yr))


def values_in_time(parameters: BranchModulesParameters, key: str) -> list[tuple[str, Any]]:
    """Place and value of a key at the start and in every change, for estimates; `check_changes` has seen the values."""
    changed = [
        (f"changes.{index}.set.{key}", one.set[key]) for index, one in enumerate(parameters.changes) if key in one.set
    ]
    return [(key, getattr(parameters, key)), *changed]


def numbers_in_time(parameters: BranchModulesParameters, key: str) -> list[float]:
    """The values alone of a key whose values are numbers."""
    return [float(value) for _, value in values_in_time(parameters, key)]


def split(change: Change) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
    """A change's new values: those of the section, and those of each species' modules."""
    own: dict[str, Any] = {}
    of_species: dict[str, dict[str, Any]] = {}
    for key, value in change.set.items():
        parts = species_key(key)
        if parts is None:
            own[key] = value
        else:
            of_species.setdefault(parts[0], {})[parts[1]] = value
    return own, of_species


def _values(model: BaseModel) -> dict[str, Any]:
    """A model's values as they are: maps stay read."""
    return {name: getattr(model, name) for name in type(model).model_fields}


def check_changes(
    parameters: BranchModulesParameters,
    types: Mapping[str, PlantType],
    prototypes: Sequence[str],
    parse: Parse,
    where: Callable[..., str],
) -> None:
    """Refuse, before anything is simulated, changes that could not be made.

    Parameters
    ----------
    prototypes : names of those that there are.
    parse : checks values of a class as the recipe checks its own (`DrawnRecipe.parse`).
    where : place of a key path of the parameters, for messages.

    Raises
    ------
    RecipeError : worded as if the value stood in the recipe itself, at the change's place.
    """
    changed: BranchModulesParameters = parameters
    kinds = dict(types)
    numbers = {id(one): index for index, one in enumerate(parameters.changes)}
    for one in in_order(parameters):
        place = ("changes", numbers[id(one)], "set")
        own, of_species = split(one)
        if own:
            places = {key: where(*place, key) for key in own}
            changed = _told(type(parameters), {**_values(changed), **own}, places, parse)
            _refuse_strangers(changed, own, kinds, places)
        for name, values in of_species.items():
            places = {key: where(*place, f"species.{name}.{key}") for key in values}
            if name not in kinds:
                raise not_growing(name, kinds, next(iter(places.values())))
            kinds[name] = _told(PlantType, {**_values(kinds[name]), **values}, places, parse)
            unknown = [one for one in kinds[name].prototypes if one not in prototypes]
            if "prototypes" in values and unknown:
                raise no_prototype(unknown[0], prototypes, places["prototypes"])


def _refuse_strangers(
    changed: BranchModulesParameters,
    own: Mapping[str, Any],
    kinds: Mapping[str, PlantType],
    places: Mapping[str, str],
) -> None:
    """Refuse species of new values that do not grow by branch modules."""
    for keys, name in changed.named_species():
        if keys[0] in own and name not in kinds:
            raise not_growing(name, kinds, places[str(keys[0])])


def _told(model: type[M], data: dict[str, Any], places: Mapping[str, str], parse: Parse) -> M:
    """The model of the values; a mistake is told at the place of the new value that made it."""
    try:
        return parse(model, data, ())
    except RecipeError as cause:
        # The parser names the key in the recipe's own section, whose value may be right.
        own = [place for key, place in places.items() if (cause.where or "").endswith(key)]
        raise RecipeError(
            cause.problem,
            where=(own or list(places.values()))[0],
            expected=cause.expected,
            got=cause.got,
            hint=cause.hint,
        ) from cause
