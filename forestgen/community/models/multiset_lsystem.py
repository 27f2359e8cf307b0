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

The names of a program's #defines and arrays determine which values it receives. The recipe's site, step and species
set these: site_width_m, site_height_m, site_area_ha, step_yr, number_of_species, and arrays with an element for each
species, of the ecology's keys below and of height_scale, height_exponent. All others are set by ``parameters``.

``environment`` is one of domination (the default: of two circles that intersect the smaller gets nothing; a program
that has an environment's name brings that one),
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
- A word that holds a T must be a plant and nothing else. Other words (X above) are the program's own,
  of 50,000 modules at most in all: each step of a history holds them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.community.arrivals import new_ids
from forestgen.community.disturbance import Planting, planted
from forestgen.community.ecology import SpeciesEcology
from forestgen.community.model import Site
from forestgen.community.multiset_parameters import MultisetParameters, program_of
from forestgen.community.multiset_state import State, answered, check_restorable, restored, snapshot, too_many
from forestgen.community.plant_words import OWN, RADIUS, SPECIES, join_words, plant_words, plants_of, take_words
from forestgen.community.population import Population
from forestgen.core.errors import RecipeError
from forestgen.lsystem.compiler import settable
from forestgen.lsystem.derivation import TooManyModulesError, axiom, derive_step
from forestgen.lsystem.folding import fold
from forestgen.lsystem.program import Program

_BYTES_PER_PLANT = 330  # peak: a state, its successor, the environment, a snapshot; tests measure it
_BYTES_PER_SOWN = 400  # while the axiom makes the cohort, in space that doubles
_BYTES_AT_LEAST = 4 * 1024 * 1024
_MODULES_PER_PLANT = 2
_ROOM = 8  # plants that there is room for at any time, for each of the first cohort: a guess
_NOTHING: Any = None


class MultisetLSystem:
    """The model; see the module's page."""

    Parameters = MultisetParameters

    def init(self, parameters: MultisetParameters, site: Site, species: Sequence[SpeciesEcology], seed: int) -> State:
        """The axiom, with its queries answered."""
        program, form = program_of(parameters, site, species)
        empty = State(parameters, site, tuple(species), seed, program, form, _NOTHING)
        try:
            first = axiom(program, seed, most_modules=_most_modules(parameters))
        except TooManyModulesError as error:
            raise too_many(empty, 0) from error
        return answered(replace(empty, derivation=first))

    def step(self, state: State) -> State:
        """One derivation step: productions, fragmentation, environment."""
        most = _most_modules(state.parameters)
        try:
            after = derive_step(state.program, state.derivation, state.seed, most_modules=most)
        except TooManyModulesError as error:
            raise too_many(state, state.step + 1) from error
        return answered(replace(state, derivation=after))

    def population(self, state: State) -> Population:
        """Snapshot: c and r >= R give the status; z is 0."""
        plants = plants_of(state.derivation.multiset, state.form, state.program.name)
        return snapshot(state, plants)

    def resume(
        self,
        parameters: MultisetParameters,
        site: Site,
        species: Sequence[SpeciesEcology],
        seed: int,
        population: Population,
    ) -> State:
        """The state of a snapshot: its words in their order."""
        program, form = program_of(parameters, site, species)
        return restored(State(parameters, site, tuple(species), seed, program, form, _NOTHING), population)

    def check_snapshot(
        self, parameters: MultisetParameters, site: Site, species: Sequence[SpeciesEcology], population: Population
    ) -> None:
        """Refuse plants, words and globals that the program cannot have written."""
        program, form = program_of(parameters, site, species)
        check_restorable(program, form, parameters.step_yr, population)

    def remove(self, state: State, plant_id: NDArray[np.uint32]) -> State:
        """The multiset without these plants; the environment answers anew."""
        words = state.derivation.multiset
        plants = plants_of(words, state.form, state.program.name)
        keep = np.ones(len(words), dtype=np.bool_)
        keep[plants.word] = ~np.isin(words.word_id[plants.word], plant_id)
        return answered(replace(state, derivation=replace(state.derivation, multiset=take_words(words, keep))))

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
        values = np.ones((n, form.values))
        values[:, :2], values[:, RADIUS], values[:, SPECIES] = planting.position_m, planting.radius_m, planting.species
        plant_id = new_ids(old.next_id, n)
        new = plant_words(form, state.program.kinds, values, plant_id, np.full(n, old.step, dtype=np.int32))
        words = join_words(state.program.kinds, [old.multiset, new])
        return answered(replace(state, derivation=replace(old, multiset=words, next_id=old.next_id + n)))

    def expected_plants(self, parameters: MultisetParameters, site: Site, species: Sequence[SpeciesEcology]) -> float:
        """Upper bound of the mean number of plants at any step, those that are planted counted.

        Known for programs that tell by the names of their values how many plants they start with and how many arrive;
        `most_plants` for others.
        """
        program, _ = program_of(parameters, site, species)
        macros, arrays = program.listing.macros, program.listing.arrays
        if not {"initial_plants_per_ha", "seedlings_per_ha_per_yr"} & {*macros, *arrays}:
            return float(parameters.most_plants)
        total = planted(parameters.disturbances) + _cohort(program, site)
        if "seedlings_per_ha_per_yr" in arrays:
            total += _arriving(parameters, site, species)
        if "sowing" in macros:  # L-system 4.6: as many as have room
            total = min(parameters.most_plants, _ROOM * total) if total else 0.0
        return min(total, 1e30)

    def empty_reason(self, parameters: MultisetParameters, site: Site, species: Sequence[SpeciesEcology]) -> str | None:
        """Why no plant can ever grow, or None if one may."""
        if self.expected_plants(parameters, site, species) > 0:
            return None
        program, _ = program_of(parameters, site, species)
        if "initial_plants_per_ha" in settable(program.listing):
            return "no plant can grow: community.parameters.initial_plants_per_ha is 0"
        if parameters.steps == 0:
            return "no plant can grow: community.steps is 0, and succession begins on bare ground"
        return "no plant can grow: ecology.seedlings_per_ha_per_yr is 0 for every species"

    def estimate_bytes(self, parameters: MultisetParameters, site: Site, species: Sequence[SpeciesEcology]) -> int:
        """Bytes for the bound of the mean number of plants and six standard deviations of a Poisson number more."""
        plants = self.expected_plants(parameters, site, species)
        plants = min(plants + 6 * math.sqrt(plants), 1e30)
        program, _ = program_of(parameters, site, species)
        sown = min(_cohort(program, site), 1e30)
        return _BYTES_AT_LEAST + math.ceil(plants * _BYTES_PER_PLANT + sown * _BYTES_PER_SOWN)


def _most_modules(parameters: MultisetParameters) -> int:
    return _MODULES_PER_PLANT * parameters.most_plants + 1000


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


MODEL = MultisetLSystem()
