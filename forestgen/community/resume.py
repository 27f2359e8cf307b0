"""A simulation goes on from a snapshot of its history.

A history has its origin: seed, image, model with its parameters, species and site. A recipe continues it if all of
that is the same, except the number of steps and the disturbances and changes of parameters or climate that are still to
come: a stand may be felled or not.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, NamedTuple

from forestgen.community.history import open_history
from forestgen.community.history_tables import MODULES_NAME, readable
from forestgen.community.model import CommunityParameters
from forestgen.community.population import Population, SpeciesEcology
from forestgen.community.simulation import CommunityPlan, simulation_code
from forestgen.community.snapshot_checks import ImpossibleValueError, check_snapshot
from forestgen.core import __version__
from forestgen.core.errors import AssetError, RecipeError
from forestgen.recipe.map_files import is_map_file, recipe_hash
from forestgen.recipe.messages import show

_MOST_SHOWN = 5


class Difference(NamedTuple):
    """A key whose values differ; None where one side lacks it."""

    key: str
    before: Any
    now: Any


def origin(plan: CommunityPlan) -> dict[str, Any]:
    """What a plan's simulation is started with, plain as in JSON."""
    drawn = plan.drawn
    about = {
        "recipe_hash": recipe_hash(drawn.data),
        "forestgen": __version__,
        "code": simulation_code(),
        "seed": drawn.recipe.seed,
        "image": drawn.image_index,
        "model": drawn.recipe.community.model,
        "parameters": plan.parameters.model_dump(mode="json"),
        "site": _about_site(plan),
        "species": {one.name: _about_species(one) for one in plan.ecologies},
    }
    plain: dict[str, Any] = json.loads(json.dumps(about))
    return plain


def _about_species(ecology: SpeciesEcology) -> dict[str, Any]:
    """What a community may depend on of a species."""
    about = {one.name: getattr(ecology, one.name) for one in fields(ecology)}
    sections = {name: about.pop(name) for name in ("modules", "tree")}
    known = {name: one.model_dump(mode="json") for name, one in sections.items() if one is not None}
    known.get("tree", {}).pop("source", None)  # a text for people
    return about | known


def _about_site(plan: CommunityPlan) -> dict[str, Any]:
    """What a community may depend on: its ground's shape, and where on earth it lies."""
    site, terrain = plan.site, plan.drawn.recipe.site.terrain
    shape = terrain.model_dump(mode="json")
    for key, value in shape.items():
        if is_map_file(value):
            shape[key] = {"sha256": value["sha256"]}  # a map is its content, wherever it lies
    land = plan.drawn.recipe.site.model_dump(mode="json", include={"micro_relief", "paths", "water"})
    return {
        "size_m": site.size_m,
        "terrain": "flat" if site.height is None else shape,
        "altitude_m": site.altitude_m,
        "latitude_deg": site.latitude_deg,
        "wind_from_deg": site.wind_from_deg,
        **land,  # what is left out is not there
        **({"buildings": [one.model_dump(mode="json") for one in site.buildings]} if site.buildings else {}),
    }


def snapshot_to_resume(plan: CommunityPlan, path: Path, step: int | None) -> Population:
    """The snapshot of a history from which a plan's simulation goes on: that of `step`, by default the last.

    Raises
    ------
    AssetError : no such file, not a history, or one with values that no simulation gives.
    RecipeError : the history has no such step, the recipe ends before, or it is not the one that made the history.
    """
    history = open_history(path)
    steps = history.steps
    chosen = steps[-1] if step is None else step
    if chosen not in steps:
        expected = f"a step from {steps[0]} to {steps[-1]}"
        raise RecipeError(f"{path} has no such step", parameter="from_step", expected=expected, got=str(step))
    _check_same_simulation(plan, dict(history.origin), chosen, path)
    if chosen >= plan.steps:
        problem, where = f"nothing is left to simulate after step {chosen}", plan.drawn.where("community", "steps")
        hint = f"`set='community.steps={chosen + 100}'`, or `from_step` with an earlier step"
        raise RecipeError(problem, where=where, expected=f"more than {chosen} steps", got=str(plan.steps), hint=hint)
    if history.grows_by_modules and not history.has_modules:
        problem = f"{path} has no modules, from which alone its plants can go on"
        expected = f"a history with {MODULES_NAME} beside it"
        hint = "simulate it again with `set='community.history_modules=true'`, and resume that"
        raise RecipeError(problem, parameter="resume", expected=expected, got="one row a plant", hint=hint)
    population = history.whole(chosen)
    try:
        check_snapshot(population, plan.site, plan.ecologies)
        plan.model.check_snapshot(plan.parameters, plan.site, plan.ecologies, population)
    except ImpossibleValueError as error:  # somebody has changed the file
        problem = f"{error.where} of step {population.step} cannot be of a simulation"
        hint = "the history as forestgen wrote it, or simulate it again"
        raise AssetError(problem, where=str(path), expected=error.expected, got=error.got, hint=hint) from error
    return population


def note_of_other_code(path: Path) -> str | None:
    """A note if the history was simulated by other code than the present; None: by the same.

    Other versions are refused. Of one version, the code may have been changed, a library, or the kind of machine.
    """
    theirs, ours = open_history(path).origin.get("code"), simulation_code()
    if theirs == ours:
        return None
    what = "does not say which code simulated it" if theirs is None else "was simulated by other code"
    codes = f"now {ours[:8]}" if theirs is None else f"{theirs[:8]}, now {ours[:8]}"
    return (
        f"{path} {what} ({codes}: a hash of forestgen's files, its libraries' versions and the kind of machine); "
        "what follows may differ from one simulation in one go"
    )


def _check_same_simulation(plan: CommunityPlan, theirs: Mapping[str, Any], step: int, path: Path) -> None:
    """Raise `RecipeError` unless both simulations have one future from `step` on, but for what is still to come."""
    if not theirs:
        got = "nothing"
        raise RecipeError(f"{path} does not say what it was started with", parameter="resume", expected="that", got=got)
    parameters = type(plan.parameters)
    now = dict(_until(origin(plan), parameters, step))
    expected = "the origin that forestgen wrote into its metadata"
    with readable(path, "the history does not say rightly what it was started with", expected, "simulate it again"):
        before = dict(_until(theirs, parameters, step))
    differ = list(differences(before, now))
    if not differ:
        return
    first, more = differ[:_MOST_SHOWN], len(differ) - _MOST_SHOWN
    *others, last = parameters.timed_keys
    timed = ", ".join(others) + " and " * bool(others) + last
    raise RecipeError(
        f"{path} is the history of another simulation",
        parameter="resume",
        expected="; ".join(f"{one.key} {shown(one.before)}" for one in first) + ", as in the history",
        got="; ".join(f"{one.key} {shown(one.now)}" for one in first) + (f", and {more} more" if more > 0 else ""),
        hint=f"only community.steps and later {timed} may change; leave `resume` out to start anew",
    )


def _until(about: Mapping[str, Any], model: type[CommunityParameters], step: int) -> Iterator[tuple[str, Any]]:
    """Key and value of all that the future depends on after `step`, disturbances to come left out."""
    yield "forestgen", about.get("forestgen")  # other versions may draw other numbers
    yield "seed", about["seed"]
    yield "image", about["image"]
    yield from ((f"site.{key}", value) for key, value in about["site"].items())
    yield "species", list(about["species"])
    for name, ecology in about["species"].items():
        yield from ((f"species.{name}.{key}", value) for key, value in ecology.items())
    yield "community.model", about["model"]
    parameters = about["parameters"]
    for key, value in parameters.items():
        if key in model.timed_keys:
            for index, one in enumerate(value):
                if model.timed_keys[key].model_validate(one).step(parameters["step_yr"]) <= step:
                    yield f"community.{key}.{index}", one
        elif key not in model.free_keys:
            yield f"community.{key}", value


def differences(before: Mapping[str, Any], now: Mapping[str, Any], prefix: str = "") -> Iterator[Difference]:
    """The keys that differ, as deep as both sides have them: mappings, and lists of one length, are looked into."""
    for key in {**now, **before}:
        yield from _differing(f"{prefix}{key}", before.get(key), now.get(key))


def _differing(key: str, before: Any, now: Any) -> Iterator[Difference]:
    if before == now:
        return
    if isinstance(before, Mapping) and isinstance(now, Mapping):
        yield from differences(before, now, key + ".")
    elif _are_alike(before, now):
        for index, (one, other) in enumerate(zip(before, now, strict=True)):
            yield from _differing(f"{key}.{index}", one, other)
    else:
        yield Difference(key, before, now)


def _are_alike(before: Any, now: Any) -> bool:
    """Whether both are lists of as many mappings: of plain values, the whole list says more than one entry."""
    lists = isinstance(before, list) and isinstance(now, list) and len(before) == len(now)
    return lists and all(isinstance(one, Mapping) for one in (*before, *now))


def shown(value: Any) -> str:
    """A value as YAML would have it, without keys that say nothing."""
    return "(none)" if value is None else show(_without_nothing(value))


def _without_nothing(value: Any) -> Any:
    """A mapping without the keys that say nothing, such as those of a disturbance that it does not use."""
    if isinstance(value, Mapping):
        return {key: _without_nothing(one) for key, one in value.items() if one is not None}
    return value
