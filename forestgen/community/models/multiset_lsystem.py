"""Plant communities by multiset L-systems: self-thinning, succession, propagation, and any program of your own.

Reference: B. Lane, Models of Plant Communities for Image Synthesis, MSc thesis, University of Calgary, 2002, sections
4.2 to 4.5 (first published as B. Lane and P. Prusinkiewicz, Generating spatial distributions for multilevel models of
plant communities, Graphics Interface 2002).

Each plant is a word ``T(x, y, r, sp) ?E(c)`` of a multiset: a circle of radius r around (x, y), of species sp (0, 1,
... in the recipe's order). After each derivation step the competition model, the ``environment``, sets c of every
plant: 0 where it gets nothing, 1 where it gets all that it can use. In the next step each word is rewritten by the
first production that matches; then successors are cut at every fragmentation symbol % and the pieces become words of
their own.

``program`` is an L-system that comes with forestgen (`forestgen models` lists them, and shows them by name), or the
path of a ``.lsys`` file of yours, relative to the recipe; docs/lsystem.md has the language.

- ``self_thinning``, L-system 4.4: a cohort of `initial_plants_per_ha`; dominated plants die, the others grow to R.
- ``succession``, L-system 4.5, for any number of species: bare ground on which seedlings arrive; the dominated survive
  a step with probability shaded[sp], the mature with probability oldage[sp].
- ``propagation``, L-system 4.6: undominated plants sow near themselves, which makes clusters.
- ``firbank_watkinson``, ``leps_kindlmann``, ``aikman_watkinson``: the models of even-aged stands of section 3.1, each
  with the environment of its name.

The names of a program's #defines and arrays determine which values it receives. The recipe's site, step and species
set these: site_width_m, site_height_m, site_area_ha, step_yr, number_of_species, and arrays with an element for each
species, of the ecology's keys below and of height_scale, height_exponent. All others are set by ``parameters``.

``environment`` is one of domination (the default: of two circles that intersect the smaller gets nothing; a program
that has an environment's name brings that one),
firbank_watkinson, leps_kindlmann, aikman_watkinson; or a mapping with `model` and its own keys.

Parameters: see below. Of each species' ecology: R is max_radius_m, grow / Δt is growth_m_per_yr, shaded
and oldage are shade_tolerance and old_age_survival (probabilities a step); seedlings_per_ha_per_yr is (n, m) over area
and Δt, seedling_radius_m the mean of r_1 ... r_n; heights are ``A_H r^c_H`` with the scale and exponent of height_m.

Recipe::

    community: {model: multiset_lsystem, program: succession, steps: 300, step_yr: 0.5}
    community: {model: multiset_lsystem, program: self_thinning, steps: 80, parameters: {initial_plants_per_ha: 20000}}
    community: {model: multiset_lsystem, program: ./mine.lsys, environment: {model: leps_kindlmann, tolerance: 2}}

Decided where the thesis is silent or contradicts itself:

- Production 4 of 4.5 reads random(1) < oldage, production 3 of 4.6 random(1) > oldage. The text decides: a mature plant
  survives a step with probability oldage.
- shaded and oldage are probabilities a step, as printed. Change step_yr and they stay: a calibration holds for its
  step_yr (the species that come with forestgen: 0.5 yr). crown_light takes them over half a year whatever its step is.
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
- A word that holds a T must be a plant and nothing else. Other words (X above) are the program's own,
  of 50,000 modules at most in all: each step of a history holds them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.community.arrivals import CirclePlants, heights_m, new_ids, upper_number
from forestgen.community.competition.contract import Circles
from forestgen.community.disturbance import Planting, planted
from forestgen.community.multiset_program import (
    ORDER,
    OWN,
    RADIUS,
    SPECIES,
    Form,
    MultisetParameters,
    join_words,
    plant_words,
    plants_of,
    program_of,
    word_of,
    words_at,
)
from forestgen.community.population import Ecologies, Floats, Population, Site, SpeciesEcology
from forestgen.community.registry import COMPETITION_MODELS
from forestgen.community.snapshot_checks import ImpossibleValueError, Limits, arrival_limits, check_columns
from forestgen.core.errors import LsystemError, RecipeError, ResourceError
from forestgen.lsystem.codegen import fold
from forestgen.lsystem.compiler import Program, settable
from forestgen.lsystem.derivation import Derivation, TooManyModulesError, axiom, derive_step
from forestgen.lsystem.multiset import Kind, words_as_lists

_BYTES_PER_PLANT = 330  # peak: a state, its successor, the competition model, a snapshot; tests measure it
_BYTES_PER_SOWN = 400  # while the axiom makes the cohort, in space that doubles
_BYTES_AT_LEAST = 4 * 1024 * 1024
_MODULES_PER_PLANT = 2  # T and ?E
_MOST_OWN_MODULES = 50_000  # of words that are no plants
_ROOM = 8  # plants that there is room for at any time, for each of the first cohort: a guess


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


def _answered(state: State) -> State:
    """The competition model's part: every plant on the site, and c of every ?E(c, ...) set.

    Writes into the state's own parameters, which no other object holds yet.
    """
    parameters, form, size_m = state.parameters, state.form, state.site.size_m
    plants = plants_of(state.derivation.multiset, form, state.program.name)
    values = plants.values
    _check_own_words(state, len(plants))
    _check_plants(state, values)
    if len(plants) > parameters.most_plants:
        raise _too_many(state.program, parameters, state.step)
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
            return _answered(_without(state, plants.word[outside]))
    model, sp = COMPETITION_MODELS.load(parameters.environment.model), values[:, SPECIES].astype(np.uint16)
    circles = Circles(
        position_m=values[:, :2],
        radius_m=values[:, RADIUS],
        height_m=heights_m(state.species, sp, values[:, RADIUS]) if model.needs_heights else values[:, RADIUS],
        plant_id=state.derivation.multiset.word_id[plants.word],
        species=sp,
    )
    written = state.derivation.multiset.parameter
    for axis in (0, 1):
        written[plants.first + axis] = values[:, axis]
    written[plants.first + form.arity] = model.answer(
        parameters.environment.parameters(), circles, size_m, periodic=parameters.periodic
    )
    return state


def _without(state: State, word: NDArray[np.intp]) -> State:
    """The state without some of its words."""
    words = state.derivation.multiset
    stay = np.delete(np.arange(len(words)), word)
    return replace(state, derivation=replace(state.derivation, multiset=words_at(words, stay)))


def _check_own_words(state: State, plants: int) -> None:
    """Few modules in words that are no plants: every step of the history holds them all as a list."""
    modules = len(state.derivation.multiset.code) - _MODULES_PER_PLANT * plants
    if modules > _MOST_OWN_MODULES:
        problem, where = "the program's own words, those without a plant, grow too long", state.program.name
        expected = f"at most {_MOST_OWN_MODULES:,} modules in all of them"
        hint = "a production that makes more of its own module in each step has no end: give it a condition"
        raise ResourceError(problem, where=where, expected=expected, got=f"{modules:,} in step {state.step}", hint=hint)


def _check_plants(state: State, values: Floats) -> None:
    """Radii above 0, and species that exist."""
    sp = values[:, SPECIES]
    wrong = ~((values[:, RADIUS] > 0) & (sp >= 0) & (sp < len(state.species)) & (sp == np.floor(sp)))
    if wrong.any():
        row = values[np.flatnonzero(wrong)[0]]
        where, expected = state.program.name, f"T(x, y, r, sp) with r > 0, and sp from 0 to {len(state.species) - 1}"
        got = f"r = {row[RADIUS]:g}, sp = {row[SPECIES]:g} in step {state.step}"
        raise LsystemError("a plant of impossible size or species", where=where, expected=expected, got=got)


def _is_number(value: object) -> bool:
    return type(value) in (int, float)


def _is_word(word: object, program: Program, population: Population) -> bool:
    """Whether a list is a word of the state that is no plant: [place, id, step of birth, modules], brackets paired."""
    if not (isinstance(word, list) and len(word) == 4 and all(type(one) is int for one in word[:3])):
        return False
    place, word_id, born, modules = word
    next_id, depth = population.state["next_id"], 0
    if not (0 <= place < 2**32 and 0 < word_id < next_id and 0 <= born <= population.step):
        return False
    if not (isinstance(modules, list) and modules):
        return False
    for one in modules:
        if not (isinstance(one, list) and one and isinstance(one[0], str) and all(map(_is_number, one[1:]))):
            return False
        if Kind(one[0], len(one) - 1) not in program.kinds:
            return False
        depth += (one[0] == "[") - (one[0] == "]")
        if depth < 0:
            return False
    return depth == 0


def _too_many(program: Program, parameters: MultisetParameters, step: int) -> ResourceError:
    """The community grows beyond the recipe's limit."""
    expected, got = f"at most community.most_plants = {parameters.most_plants:,} plants", f"more of them in step {step}"
    hint = "fewer seedlings, a smaller site, or a higher most_plants"
    return ResourceError("the community grows too large", where=program.name, expected=expected, got=got, hint=hint)


class MultisetLSystem:
    Parameters = MultisetParameters

    def init(self, parameters: MultisetParameters, site: Site, species: Ecologies, seed: int) -> State:
        """The axiom, with its queries answered."""
        program, form = program_of(parameters, site, species)
        try:
            first = axiom(program, seed, most_modules=_most_modules(parameters))
        except TooManyModulesError as error:
            raise _too_many(program, parameters, 0) from error
        return _answered(State(parameters, site, tuple(species), seed, program, form, first))

    def step(self, state: State) -> State:
        """One derivation step: productions, fragmentation, environment."""
        most = _most_modules(state.parameters)
        try:
            after = derive_step(state.program, state.derivation, state.seed, most_modules=most)
        except TooManyModulesError as error:
            raise _too_many(state.program, state.parameters, state.step + 1) from error
        return _answered(replace(state, derivation=after))

    def population(self, state: State) -> Population:
        """Snapshot: the plants by their id, and all else of the state beside them; c and r >= R give the status."""
        derivation, form = state.derivation, state.form
        words = derivation.multiset
        plants = plants_of(words, form, state.program.name)
        order = np.argsort(words.word_id[plants.word], kind="stable")
        word, values = plants.word[order], plants.values[order]
        columns: dict[str, NDArray[Any]] = {ORDER: word.astype(np.uint32)}
        columns.update({name: values[:, k].copy() for name, k in zip(form.names, form.own, strict=True)})
        others = np.delete(np.arange(len(words)), plants.word)
        rest = words_at(words, others)
        rows = zip(others, rest.word_id, rest.born_step, words_as_lists(rest), strict=True)
        circles = CirclePlants(
            x_m=values[:, :2],
            r_m=values[:, RADIUS].copy(),
            sp=values[:, SPECIES].astype(np.uint16),
            plant_id=words.word_id[word],
            born=words.born_step[word],
        )
        dominated, step_yr = values[:, form.arity] == 0, state.parameters.step_yr
        snapshot = circles.population(state.species, state.step, step_yr, derivation.next_id, dominated, columns)
        about = {
            "next_id": derivation.next_id,
            "globals": derivation.globals.tolist(),
            "words": [[int(index), int(one), int(born), modules] for index, one, born, modules in rows],
        }
        return replace(snapshot, state=about)

    def resume(
        self, parameters: MultisetParameters, site: Site, species: Ecologies, seed: int, population: Population
    ) -> State:
        """The state of a snapshot: its words in their order."""
        program, form = program_of(parameters, site, species)
        circles = CirclePlants(**CirclePlants.columns_of(population, parameters.step_yr))
        values = np.empty((len(population), form.values))
        values[:, :2], values[:, RADIUS], values[:, SPECIES] = circles.x_m, circles.r_m, circles.sp
        for name, k in zip(form.names, form.own, strict=True):
            values[:, k] = population.columns[name]
        rows = population.state["words"]
        parts = [
            plant_words(form, program.kinds, values, circles.plant_id, circles.born),
            *(word_of(program, modules, one, born) for _, one, born, modules in rows),
        ]
        index = np.concatenate([population.columns[ORDER].astype(np.int64), [row[0] for row in rows]])
        words = words_at(join_words(program.kinds, parts), np.argsort(index, kind="stable"))
        next_id, numbers = int(population.state["next_id"]), np.array(population.state["globals"])
        derivation = Derivation(words, population.step, next_id, numbers)
        return State(parameters, site, tuple(species), seed, program, form, derivation)

    def check_snapshot(
        self, parameters: MultisetParameters, site: Site, species: Ecologies, population: Population
    ) -> None:
        """Refuse plants, words and globals that the program cannot have written."""
        program, form = program_of(parameters, site, species)
        own = {name: Limits("f8", finite=False) for name in form.names}
        check_columns(population, {**arrival_limits(population, parameters.step_yr), ORDER: Limits("u4", 0), **own})
        numbers = population.state.get("globals")
        if not (isinstance(numbers, list) and len(numbers) == len(program.globals) and all(map(_is_number, numbers))):
            raise ImpossibleValueError("globals", f"a list of {len(program.globals)} numbers", f"{numbers!s:.80}")
        words = population.state.get("words")
        if not isinstance(words, list):
            raise ImpossibleValueError("words", "a list of words", f"{words!s:.80}")
        for index, word in enumerate(words):
            if not _is_word(word, program, population):
                expected = "[place, id, step of birth, [[symbol, parameter, ...], ...]] in symbols of the program"
                raise ImpossibleValueError(f"words.{index}", expected, f"{word!s:.80}")
        known = [*population.plant_id.tolist(), *(word[1] for word in words)]
        if len(set(known)) != len(known):
            raise ImpossibleValueError("words", "an id of its own for every word and plant", "one that is there twice")

    def remove(self, state: State, plant_id: NDArray[np.uint32]) -> State:
        """The multiset without these plants; the environment answers anew."""
        words = state.derivation.multiset
        plants = plants_of(words, state.form, state.program.name)
        return _answered(_without(state, plants.word[np.isin(words.word_id[plants.word], plant_id)]))

    def plant(self, state: State, planting: Planting) -> State:
        """The multiset with more words T(x, y, r, sp)?E(1); the environment answers anew."""
        form, old, n = state.form, state.derivation, len(planting)
        if form.arity > OWN:
            problem, where = f"plants of {state.program.name} cannot be planted", "community.disturbances"
            got = f"they have {', '.join(form.names[: form.arity - OWN])} too"
            raise RecipeError(problem, where=where, expected="a program whose plants are T(x, y, r, sp)", got=got)
        values = np.ones((n, form.values))
        values[:, :2], values[:, RADIUS], values[:, SPECIES] = planting.position_m, planting.radius_m, planting.species
        plant_id = new_ids(old.next_id, n)
        new = plant_words(form, state.program.kinds, values, plant_id, np.full(n, old.step, dtype=np.int32))
        words = join_words(state.program.kinds, [old.multiset, new])
        return _answered(replace(state, derivation=replace(old, multiset=words, next_id=old.next_id + n)))

    def expected_plants(self, parameters: MultisetParameters, site: Site, species: Ecologies) -> float:
        """Upper bound of the mean number of plants at any step, those that are planted counted.

        Known for programs whose values say by their names how many plants they start with and how many arrive;
        `most_plants` for others.
        """
        program, _ = program_of(parameters, site, species)
        macros, arrays = program.ast.macros, program.ast.arrays
        if not {"initial_plants_per_ha", "seedlings_per_ha_per_yr"} & {*macros, *arrays}:
            return float(parameters.most_plants)
        total = planted(parameters.disturbances) + _cohort(program, site)
        if "seedlings_per_ha_per_yr" in arrays:
            total += _arriving(parameters, site, species)
        if "sowing" in macros:  # L-system 4.6: as many as have room
            total = min(parameters.most_plants, _ROOM * total) if total else 0.0
        return min(total, 1e30)

    def is_cohort(self, parameters: MultisetParameters, site: Site, species: Ecologies) -> bool:
        """Whether the program does not say by its values' names how many seedlings arrive."""
        return "seedlings_per_ha_per_yr" not in program_of(parameters, site, species)[0].ast.arrays

    def empty_reason(self, parameters: MultisetParameters, site: Site, species: Ecologies) -> str | None:
        if self.expected_plants(parameters, site, species) > 0:
            return None
        program, _ = program_of(parameters, site, species)
        if "initial_plants_per_ha" in settable(program.ast):
            return "no plant can grow: community.parameters.initial_plants_per_ha is 0"
        if parameters.steps == 0:
            return "no plant can grow: community.steps is 0, and succession begins on bare ground"
        return "no plant can grow: ecology.seedlings_per_ha_per_yr is 0 for every species"

    def estimate_bytes(self, parameters: MultisetParameters, site: Site, species: Ecologies) -> int:
        """Bytes for the bound of the mean number of plants and six standard deviations of a Poisson number more."""
        plants = upper_number(self.expected_plants(parameters, site, species))
        program, _ = program_of(parameters, site, species)
        sown = min(_cohort(program, site), 1e30)
        return _BYTES_AT_LEAST + math.ceil(plants * _BYTES_PER_PLANT + sown * _BYTES_PER_SOWN)


def _most_modules(parameters: MultisetParameters) -> int:
    return _MODULES_PER_PLANT * parameters.most_plants + 1000


def _cohort(program: Program, site: Site) -> float:
    """Number of plants of the axiom, by the program's initial_plants_per_ha, a number or one a species."""
    name, macros = "initial_plants_per_ha", program.ast.macros
    if name in program.ast.arrays:
        return sum(program.ast.arrays[name]) * site.area_ha
    return (fold(macros[name].body, macros, program.name) or 0.0) * site.area_ha if name in macros else 0.0


def _arriving(parameters: MultisetParameters, site: Site, species: Ecologies) -> float:
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


MODEL = MultisetLSystem()
