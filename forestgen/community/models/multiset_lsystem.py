"""Plant communities by multiset L-systems: self-thinning, succession, propagation, and any program of your own.

Reference: B. Lane, Models of Plant Communities for Image Synthesis, MSc thesis, University of Calgary, 2002, sections
4.2 to 4.5 (first published as B. Lane and P. Prusinkiewicz, Generating spatial distributions for multilevel models of
plant communities, Graphics Interface 2002).

Each plant is a word ``T(x, y, r, sp) ?E(c)`` of a multiset: a circle of radius r around (x, y), of species sp (0, 1,
... in the recipe's order). After each derivation step the environment sets c of every plant: 0 where it gets nothing, 1
where it gets all that it can use. In the next step each word is rewritten by the first production that matches; then
successors are cut at every fragmentation symbol % and the pieces become words of their own.

``program`` is an L-system that comes with forestgen (`forestgen models` lists them, and shows them by name), or the
path of a ``.lsys`` file of yours, relative to the recipe; docs/lsystem.md has the language.

- ``self_thinning``, L-system 4.4: a cohort of `initial_plants_per_ha`; dominated plants die, the others grow to R.
- ``succession``, L-system 4.5, for any number of species: bare ground on which seedlings arrive; the dominated survive
  a step with probability shaded[sp], the mature with probability oldage[sp].
- ``propagation``, L-system 4.6: undominated plants sow near themselves, which makes clusters.
- ``firbank_watkinson``, ``leps_kindlmann``, ``aikman_watkinson``: the models of even-aged stands of section 3.1, each
  with the environment of its name.

A program tells by the names of its #defines and arrays what it wants to know. These are set by the recipe's site, step
and species: site_width_m, site_height_m, site_area_ha, step_yr, number_of_species, and arrays with an element for each
species, of the ecology's keys below and of height_scale, height_exponent. All others are set by ``parameters``.

``environment`` is one of domination (the default: of two circles that intersect the smaller gets nothing),
firbank_watkinson, leps_kindlmann, aikman_watkinson; or a mapping with `model` and its own keys.

========================  ======================  ==========  ============  ==========
parameter                 symbol                  unit        range         default
========================  ======================  ==========  ============  ==========
program                                                                     succession
steps                                                         0 to 100000   300
step_yr                   Δt                      yr          0 < Δt        0.5
periodic                                                                    true
parameters                                                                  of program
environment                                                                 domination
most_plants                                                   1 <=          5000000
disturbances                                                                none
growth_m_per_yr           grow / Δt               m/yr        0 <=          of species
max_radius_m              R                       m           0 <           of species
shade_tolerance           shaded                  1 (a step)  0 to 1        of species
old_age_survival          oldage                  1 (a step)  0 to 1        of species
seedlings_per_ha_per_yr   (n, m) / (area Δt)      1/(ha yr)   0 <=          of species
seedling_radius_m         mean of r_1 ... r_n     m           0 < r <= R    of species
height_m scale, exponent  A_H, c_H: H = A_H r^c_H m, 1                      of species
========================  ======================  ==========  ============  ==========

Recipe::

    community: {model: multiset_lsystem, program: succession, steps: 300, step_yr: 0.5}
    community: {model: multiset_lsystem, program: self_thinning, steps: 80, parameters: {initial_plants_per_ha: 20000}}
    community: {model: multiset_lsystem, program: ./mine.lsys, environment: {model: leps_kindlmann, tolerance: 2}}

Decided where the thesis is silent or contradicts itself:

- Production 4 of 4.5 reads random(1) < oldage, production 3 of 4.6 random(1) > oldage. The text decides: a mature plant
  survives a step with probability oldage.
- shaded and oldage are probabilities a step, as printed. Change step_yr and they stay: a calibration holds for its
  step_yr (the species that come with forestgen: 0.5 yr).
- A plant that is both dominated and mature is subject to the productions for dominated ones, which stand first.
- grow() is linear in time, with a random share of r where the program has a relative_growth_per_step, and ends exactly
  at R. A seedling is never larger than its R.
- n and m of production 1 are Poisson numbers of mean rate x area x step_yr; places are uniform on the site; radii are
  uniform between 0.5 and 1.5 times seedling_radius_m. A seedling takes part in the environment of the step in which it
  arrives: one that falls into a larger circle is dominated at once, and lives on only by its shade tolerance.
- The cohort of 4.4 and 4.6 has round(n x area) plants; each is of any species with equal probability.
- The site is by default a torus: a plant at the left edge competes with those at the right. Otherwise plants at an edge
  have fewer rivals and a small site is a biased sample. ``periodic: false`` gives the bounded site, with that edge;
  seeds that fall beyond it are lost.
- The thesis prints neither the parameters of its species nor the size of its site. recipes/reproductions/ has values
  that give its numbers.
- A word that holds a T must be a plant and nothing else. Other words (X above) are the program's own.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator, Field, ValidationError, WithJsonSchema

from forestgen.community.disturbance import Planting, planted
from forestgen.community.environments.contract import Circles
from forestgen.community.model import CommunityParameters, Site, SpeciesEcology
from forestgen.community.plant_words import (
    OWN,
    RADIUS,
    SPECIES,
    Form,
    Plants,
    form_of,
    join_words,
    plant_words,
    plants_of,
    read_word,
    reorder_words,
    take_words,
)
from forestgen.community.population import Population, Status
from forestgen.community.registry import ENVIRONMENTS
from forestgen.core.errors import LsystemError, RecipeError, ResourceError
from forestgen.lsystem.compiler import Value, compile_listing, settable, with_values
from forestgen.lsystem.derivation import Derivation, TooManyModulesError, axiom, derive_step
from forestgen.lsystem.folding import fold
from forestgen.lsystem.multiset import words_as_text
from forestgen.lsystem.parsing import parse_text
from forestgen.lsystem.program import Program
from forestgen.recipe.assets import find_asset
from forestgen.recipe.fields import Section, Text

_LARGEST_ID = 2**32 - 1
_BYTES_PER_PLANT = 330  # peak: a state, its successor, the environment, a snapshot; tests measure it
_BYTES_PER_SOWN = 400  # while the axiom makes the cohort, in space that doubles
_BYTES_AT_LEAST = 4 * 1024 * 1024
_MODULES_PER_PLANT = 2
_ROOM = 8  # plants that there is room for at any time, for each of the first cohort: a guess
_OF_SPECIES = (
    "growth_m_per_yr", "max_radius_m", "shade_tolerance", "old_age_survival", "seedlings_per_ha_per_yr",
    "seedling_radius_m", "height_scale", "height_exponent",
)  # fmt: skip


class ProgramText(Section):
    """An L-system program."""

    name: Text = Field(description="name in messages")
    text: Text = Field(description="the program itself")


def _shipped(value: Any) -> Any:
    """A name as the program of that name that comes with forestgen."""
    if isinstance(value, str):
        path = find_asset("lsystems", value)
        return {"name": path.name, "text": path.read_text(encoding="utf-8")}
    return value


def _environment(value: Any) -> Any:
    return {"model": value} if isinstance(value, str) else value


class EnvironmentChoice(BaseModel):
    """An environment, and its own keys."""

    model_config = {"extra": "allow", "frozen": True}

    model: Text = Field("domination", description="id of the environment")


_PROGRAM_SCHEMA: dict[str, Any] = {
    "anyOf": [{"type": "string"}, {"type": "object", "properties": {"name": {}, "text": {}}}],
    "default": "succession",
}


class MultisetParameters(CommunityParameters):
    """What a recipe says about the model besides its species."""

    program: Annotated[ProgramText, BeforeValidator(_shipped), WithJsonSchema(_PROGRAM_SCHEMA)] = Field(
        "succession",
        validate_default=True,
        description="the L-system: a shipped program's name, or the path of a .lsys file",
    )
    parameters: dict[str, float | tuple[float, ...] | tuple[tuple[float, float], ...]] = Field(
        {}, description="values of the program's #defines (numbers), arrays (lists) and functions (control points)"
    )
    environment: Annotated[
        EnvironmentChoice,
        BeforeValidator(_environment),
        WithJsonSchema({"anyOf": [{"type": "string"}, {"type": "object"}], "default": "domination"}),
    ] = Field(
        EnvironmentChoice(model="domination"),
        description="who takes what from whom: an environment's id, or {model: id, ...}",
    )
    most_plants: int = Field(
        5_000_000, ge=1, le=500_000_000, description="stop with a message where the community grows beyond this"
    )


@dataclass(frozen=True)
class State:
    """Everything that the future of a simulation depends on."""

    parameters: MultisetParameters
    site: Site
    species: tuple[SpeciesEcology, ...]
    seed: int
    program: Program
    form: Form
    derivation: Derivation

    @property
    def step(self) -> int:
        return self.derivation.step


def _values(parameters: MultisetParameters, site: Site, species: Sequence[SpeciesEcology]) -> dict[str, Value]:
    """What the recipe tells the program: site, time and species, as far as it asks; then its own parameters."""
    known: dict[str, Value] = {
        "site_width_m": site.size_m[0],
        "site_height_m": site.size_m[1],
        "site_area_ha": site.area_ha,
        "step_yr": parameters.step_yr,
        "number_of_species": float(len(species)),
    }
    for name in _OF_SPECIES:
        known[name] = tuple(float(getattr(one, name)) for one in species)
    return known


def _program(parameters: MultisetParameters, site: Site, species: Sequence[SpeciesEcology]) -> tuple[Program, Form]:
    """The recipe's program, compiled with its values."""
    own = tuple(sorted(parameters.parameters.items()))
    known = tuple(sorted(_values(parameters, site, species).items()))
    return _compiled(parameters.program.name, parameters.program.text, known, own)


@lru_cache(maxsize=16)
def _compiled(name: str, text: str, known: tuple[Any, ...], own: tuple[Any, ...]) -> tuple[Program, Form]:
    listing = parse_text(text, name)
    asked = set(settable(listing))
    values: Mapping[str, Value] = {key: value for key, value in known if key in asked}
    unknown = [key for key, _ in own if key not in asked]
    if unknown:
        raise RecipeError(
            f"the program {name} has no parameter {unknown[0]}",
            where="community.parameters",
            expected=", ".join(sorted(asked - dict(known).keys())) or "none: it has no parameters",
            got=unknown[0],
        )
    program = compile_listing(with_values(listing, {**values, **dict(own)}))
    if not listing.is_multiset:
        raise LsystemError(
            "a community needs a multiset", where=name, expected="axiom: { ... }, a set of words", got="a single word"
        )
    return program, form_of(program)


class MultisetLSystem:
    """The model; see the module's page."""

    Parameters = MultisetParameters

    def init(self, parameters: MultisetParameters, site: Site, species: Sequence[SpeciesEcology], seed: int) -> State:
        """The axiom, with its queries answered."""
        program, form = _program(parameters, site, species)
        first = axiom(program, seed, most_modules=_most_modules(parameters))
        return _answered(State(parameters, site, tuple(species), seed, program, form, first))

    def step(self, state: State) -> State:
        """One derivation step: productions, fragmentation, environment."""
        most = _most_modules(state.parameters)
        try:
            after = derive_step(state.program, state.derivation, state.seed, most_modules=most)
        except TooManyModulesError as error:
            raise ResourceError(
                "the community grows too large",
                where=state.program.name,
                expected=f"at most community.most_plants = {state.parameters.most_plants:,} plants",
                got=f"more of them in step {state.step + 1}",
                hint="fewer seedlings, a smaller site, or a higher most_plants",
            ) from error
        return _answered(replace(state, derivation=after))

    def population(self, state: State) -> Population:
        """Snapshot: c and r >= R give the status; z is 0."""
        plants = plants_of(state.derivation.multiset, state.form, state.program.name)
        return _snapshot(state, plants)

    def resume(
        self,
        parameters: MultisetParameters,
        site: Site,
        species: Sequence[SpeciesEcology],
        seed: int,
        population: Population,
    ) -> State:
        """The state of a snapshot: its words in their order."""
        program, form = _program(parameters, site, species)
        return _restored(State(parameters, site, tuple(species), seed, program, form, _NOTHING), population)

    def remove(self, state: State, plant_id: NDArray[np.uint32]) -> State:
        """The multiset without these plants; the environment answers anew."""
        words = state.derivation.multiset
        plants = plants_of(words, state.form, state.program.name)
        keep = np.ones(len(words), dtype=np.bool_)
        keep[plants.word] = ~np.isin(words.word_id[plants.word], plant_id)
        return _answered(replace(state, derivation=replace(state.derivation, multiset=take_words(words, keep))))

    def plant(self, state: State, planting: Planting) -> State:
        """The multiset with more words T(x, y, r, sp)?E(1); the environment answers anew."""
        form, old, n = state.form, state.derivation, len(planting)
        if form.arity > OWN:
            raise RecipeError(
                f"plants of {state.program.name} cannot be planted",
                where="community.disturbances",
                expected="a program whose plants are T(x, y, r, sp)",
                got=f"they have {', '.join(form.names[: form.arity - OWN])} too",
            )
        _refuse_overflow(old.next_id, n)
        values = np.ones((n, form.values))
        values[:, :2], values[:, RADIUS], values[:, SPECIES] = planting.position_m, planting.radius_m, planting.species
        plant_id = np.arange(old.next_id, old.next_id + n, dtype=np.uint32)
        new = plant_words(form, state.program.kinds, values, plant_id, np.full(n, old.step, dtype=np.int32))
        words = join_words(state.program.kinds, [old.multiset, new])
        return _answered(replace(state, derivation=replace(old, multiset=words, next_id=old.next_id + n)))

    def expected_plants(self, parameters: MultisetParameters, site: Site, species: Sequence[SpeciesEcology]) -> float:
        """Upper bound of the mean number of plants at any step, those that are planted counted.

        Known for programs that tell by the names of their values how many plants they start with and how many arrive;
        `most_plants` for others.
        """
        program, _ = _program(parameters, site, species)
        macros, arrays = program.listing.macros, program.listing.arrays
        if not {"initial_plants_per_ha", "seedlings_per_ha_per_yr"} & {*macros, *arrays}:
            return float(parameters.most_plants)
        total = planted(parameters.disturbances) + _cohort(program, site)
        if "seedlings_per_ha_per_yr" in arrays:
            total += _arriving(parameters, site, species)
        if "sowing" in macros:  # L-system 4.6: as many as have room
            total = min(parameters.most_plants, _ROOM * total) if total else 0.0
        return min(total, 1e30)

    def why_barren(self, parameters: MultisetParameters, site: Site, species: Sequence[SpeciesEcology]) -> str | None:
        """Why no plant can ever grow, or None if one may."""
        if self.expected_plants(parameters, site, species) > 0:
            return None
        program, _ = _program(parameters, site, species)
        if "initial_plants_per_ha" in settable(program.listing):
            return "no plant can grow: community.parameters.initial_plants_per_ha is 0"
        if parameters.steps == 0:
            return "no plant can grow: community.steps is 0, and succession begins on bare ground"
        return "no plant can grow: ecology.seedlings_per_ha_per_yr is 0 for every species"

    def estimate_bytes(self, parameters: MultisetParameters, site: Site, species: Sequence[SpeciesEcology]) -> int:
        """Bytes for the bound of the mean number of plants and six standard deviations of a Poisson number more."""
        plants = self.expected_plants(parameters, site, species)
        plants = min(plants + 6 * math.sqrt(plants), 1e30)
        program, _ = _program(parameters, site, species)
        sown = min(_cohort(program, site), 1e30)
        return _BYTES_AT_LEAST + math.ceil(plants * _BYTES_PER_PLANT + sown * _BYTES_PER_SOWN)


def _most_modules(parameters: MultisetParameters) -> int:
    return _MODULES_PER_PLANT * parameters.most_plants + 1000


def _refuse_overflow(first_id: int, expected: float) -> None:
    if first_id - 1 + expected > _LARGEST_ID:
        raise ResourceError(
            "plant ids are used up",
            expected=f"at most {_LARGEST_ID} plants in the history of a community",
            got=f"{first_id - 1} plants so far and {expected:.3g} more",
            hint="fewer seedlings, fewer steps or a smaller site",
        )


def _answered(state: State) -> State:
    """The environment's part: every plant on the site, and c of every ?E(c, ...) set."""
    parameters, form, size_m = state.parameters, state.form, state.site.size_m
    plants = plants_of(state.derivation.multiset, form, state.program.name)
    values = plants.values
    _check_plants(state, values)
    xy = values[:, :2]
    if parameters.periodic:
        outside = (xy < 0) | (xy >= size_m)
        if outside.any():
            rows = np.flatnonzero(outside.any(axis=1))
            values[rows, :2] = np.mod(xy[rows], size_m)
            values[rows, :2] *= values[rows, :2] < size_m  # the sum of -1e-20 and W is W
    else:
        outside = ~np.all((xy >= 0) & (xy <= size_m), axis=1)
        if outside.any():  # seeds that fall beyond a bounded site are lost
            keep = np.ones(len(state.derivation.multiset), dtype=np.bool_)
            keep[plants.word[outside]] = False
            words = take_words(state.derivation.multiset, keep)
            return _answered(replace(state, derivation=replace(state.derivation, multiset=words)))
    environment, chosen = _chosen_environment(parameters)
    circles = Circles(
        position_m=values[:, :2],
        radius_m=values[:, RADIUS],
        height_m=_heights(state, values) if parameters.environment.model != "domination" else values[:, RADIUS],
        plant_id=state.derivation.multiset.word_id[plants.word],
        species=values[:, SPECIES].astype(np.uint16),
    )
    answer = environment.answer(chosen, circles, size_m, periodic=parameters.periodic)
    if isinstance(plants.first, slice):
        values[:, form.arity] = answer  # a view of the multiset's own parameters, which this step has made
    else:
        state.derivation.multiset.parameter[plants.first + form.arity] = answer
        for axis in (0, 1):
            state.derivation.multiset.parameter[plants.first + axis] = values[:, axis]
    return state


def _check_plants(state: State, values: NDArray[np.float64]) -> None:
    """Radii above 0, and species that exist."""
    sp = values[:, SPECIES]
    wrong = ~((values[:, RADIUS] > 0) & (sp >= 0) & (sp < len(state.species)) & (sp == np.floor(sp)))
    if wrong.any():
        row = values[np.flatnonzero(wrong)[0]]
        raise LsystemError(
            "a plant of impossible size or species",
            where=state.program.name,
            expected=f"T(x, y, r, sp) with r > 0, and sp from 0 to {len(state.species) - 1}",
            got=f"r = {row[RADIUS]:g}, sp = {row[SPECIES]:g} in step {state.step}",
        )


def _chosen_environment(parameters: MultisetParameters) -> tuple[Any, Any]:
    """The environment that a recipe names, and its parameters."""
    choice = parameters.environment
    environment = ENVIRONMENTS.load(choice.model, where="community.environment.model")
    try:
        return environment, environment.Parameters.model_validate(choice.model_extra or {})
    except ValidationError as failure:
        first = failure.errors()[0]
        key = ".".join(map(str, first["loc"]))
        raise RecipeError(
            f"bad value: {first['msg']}", where=f"community.environment.{key}", got=repr(first["input"])
        ) from failure


def _heights(state: State, values: NDArray[np.float64]) -> NDArray[np.float64]:
    sp = values[:, SPECIES].astype(np.int64)
    scale, exponent = (np.array([getattr(one, name) for one in state.species]) for name in _OF_SPECIES[-2:])
    heights: NDArray[np.float64] = scale[sp] * values[:, RADIUS] ** exponent[sp]
    return heights


def _snapshot(state: State, plants: Plants) -> Population:
    """The plants by their id, and all else of the state beside them."""
    derivation, form = state.derivation, state.form
    words = derivation.multiset
    order = np.argsort(words.word_id[plants.word], kind="stable")
    word, values = plants.word[order], plants.values[order]
    sp = values[:, SPECIES].astype(np.uint16)
    largest = np.array([one.max_radius_m for one in state.species])[sp] if len(order) else np.zeros(0)
    status = np.where(values[:, RADIUS] >= largest, np.uint8(Status.MATURE), np.uint8(Status.GROWING))
    status[values[:, form.arity] == 0] = Status.DOMINATED
    position_m = np.zeros((len(order), 3))
    position_m[:, :2] = values[:, :2]
    own = np.delete(np.arange(form.values), [0, 1, RADIUS, SPECIES])
    columns: dict[str, NDArray[Any]] = {"word": word.astype(np.uint32)}
    columns.update({name: values[:, k].copy() for name, k in zip(form.names, own, strict=True)})
    others = np.ones(len(words), dtype=np.bool_)
    others[plants.word] = False
    rest = take_words(words, others)
    return Population(
        time_yr=state.step * state.parameters.step_yr,
        species_names=tuple(one.name for one in state.species),
        plant_id=words.word_id[word],
        species=sp,
        position_m=position_m,
        radius_m=values[:, RADIUS].copy(),
        height_m=_heights(state, values),
        age_yr=(state.step - words.born_step[word]).astype(np.float64) * state.parameters.step_yr,
        status=status,
        columns=columns,
        step=state.step,
        state={
            "next_id": derivation.next_id,
            "globals": derivation.globals.tolist(),
            "words": [
                [int(index), int(one), int(born), text]
                for index, one, born, text in zip(
                    np.flatnonzero(others), rest.word_id, rest.born_step, words_as_text(rest), strict=True
                )
            ],
        },
    )


def _restored(state: State, population: Population) -> State:
    """The state whose snapshot this is."""
    form, kinds, n = state.form, state.program.kinds, len(population)
    values = np.empty((n, form.values))
    values[:, :2], values[:, RADIUS] = population.position_m[:, :2], population.radius_m
    values[:, SPECIES] = population.species
    own = np.delete(np.arange(form.values), [0, 1, RADIUS, SPECIES])
    for name, k in zip(form.names, own, strict=True):
        values[:, k] = population.columns[name]
    age = np.rint(population.age_yr / state.parameters.step_yr).astype(np.int32)
    plants = plant_words(form, kinds, values, population.plant_id, np.int32(population.step) - age)
    rows = population.state["words"]
    parts = [plants]
    for _, one, born, text in rows:
        lone = read_word(state.program, text)
        parts.append(replace(lone, word_id=np.array([one], np.uint32), born_step=np.array([born], np.int32)))
    index = np.concatenate([population.columns["word"].astype(np.int64), [row[0] for row in rows]])
    joined = reorder_words(join_words(kinds, parts), np.argsort(index, kind="stable"))
    derivation = Derivation(
        joined, population.step, int(population.state["next_id"]), np.array(population.state["globals"])
    )
    return replace(state, derivation=derivation)


def _cohort(program: Program, site: Site) -> float:
    """Number of plants of the axiom, as far as the program's initial_plants_per_ha tells, a number or one a species."""
    name, macros = "initial_plants_per_ha", program.listing.macros
    if name in program.listing.arrays:
        return sum(program.listing.arrays[name]) * site.area_ha
    return (fold(macros[name].body, macros, program.name) or 0.0) * site.area_ha if name in macros else 0.0


def _arriving(parameters: MultisetParameters, site: Site, species: Sequence[SpeciesEcology]) -> float:
    """Upper bound of the mean number of plants that have arrived as seedlings.

    Arrivals a step times the mean number of steps that a plant lives. A step of life is spent growing (R / growth of
    them at most), dominated or mature, and those two end a life with probabilities 1 - shaded and 1 - oldage; nobody
    lives longer than the simulation.
    """
    total = 0.0
    for one in species:
        arrivals = min(one.seedlings_per_ha_per_yr * site.area_ha * parameters.step_yr, 1e30)
        growth = one.growth_m_per_yr * parameters.step_yr
        growing = one.max_radius_m / growth if growth > 0 else math.inf
        shaded = 1 / (1 - one.shade_tolerance) if one.shade_tolerance < 1 else math.inf
        old = 1 / (1 - one.old_age_survival) if one.old_age_survival < 1 else math.inf
        total += arrivals * min(growing + shaded + old + 2, parameters.steps)
    return total


_NOTHING: Any = None
MODEL = MultisetLSystem()
