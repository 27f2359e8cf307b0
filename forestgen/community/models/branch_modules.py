"""Forests of branch modules: plants that grow, compete and die by their branches.

Reference: M. Makowski et al., Synthetic Silviculture: multi-scale modeling of plant ecosystems, SIGGRAPH 2019; in the
form of M. Makowski's book of 2023, chapter 2. Equations and tables are numbered as there.

A plant is a tree of modules, each a branching pattern (a prototype, scenes/modules/) that grows, is turned, bears
others at its terminals, and is shed. A step of Δt years is

1.  light: Q = exp(-crowding f), f the volume that a module's sphere shares with others, over its own (Eq. 1); shade of
    what stands above, Q_G, by Beer's law (2.6.2); ``Q_eff = s_tol + (1 - s_tol) Q Q_G``;
2.  vigour: each module gains ``g = (Q_eff - c) / (1 - c)`` times its share of leaves; gains add up towards the root, at
    most v_rootmax o s go up again, and every fork shares by Eq. 2 (growth.py). o is the climate's adaptation (Eq. 13),
    s falls from 1 to 0 in senescence_yr after the life span;
3.  growth: a module's physiological age rises by Eqs. 7 and 8, of its vigour over its size, up to a_mature;
4.  shedding: a module of less than v_min over its size, or stunted, falls with all that it bears; a plant that loses
    its root is dead;
5.  new modules at free terminals of grown modules whose vigour, times the module's number of terminals, exceeds
    ``sprouting v_min``. The prototype is that of the Voronoi region of λ and ``D' = min(1, v(parent) / v_max) D``,
    among those that the type may have; λ and D are the mature ones once the plant flowers;
6.  turning: new modules and those that still grow turn to free space and to their tropism's angle (Eqs. 3 to 6);
7.  seeds: a Poisson number of mean ``seeds_per_yr o Δt`` of each flowering plant, at Gaussian distances. One
    germinates where soil and climate allow it, where its light would give it a gain above ``sprouting v_min``, outside
    of buildings, and seedling_spacing_m away from every stem.

A plant flowers at the age ``F_age min(v_rootmax / v_root, flowering_delay_max)``, with a grown root module, and from
then on. Lengths, diameters and tropism of segments (Eqs. 9 to 12) follow from the ages: architecture/geometry.py.

Parameters are `BranchModulesParameters`, this section's keys, and `PlantType`, a species' section ``modules``. Recipe::

    community: {model: branch_modules, steps: 200, initial_plants: {pine: 600, shrub: 400}, temperature_c: 5.6,
                precipitation_mm_per_yr: 940}

A plant's radius is that of its crown, its height that of its highest node; both at least 1 cm. Columns: modules,
trunk_diameter_m, foot_diameter_m, wood_volume_m3, leaf_area_m2, vigour (of the root), light (mean Q_eff), flowering,
next_module, adaptation (o in the last step, of the dead in their last; 1 before the first and of buildings). With
standing_dead_yr also dead_yr, years since death; with dieback_share tallest_m, the greatest height so far. Status:
MATURE flowers, DOMINATED has a mean light below a half, DEAD is a standing dead tree.

Decided where the print is silent or wrong:

- Eq. 1 has the unit m3 in an exponent: f is taken over the module's own volume. `crowding` and ω1 (`collision_weight`)
  are 4: a sphere of 1 m has 4.2 m3, so that such modules count as printed. Pairs that share a joint are left out.
- Light is gained by leaves, and these sit on the last shoots. A module that is grown by the share a and whose K
  terminals bear modules grown by a_k gains ``a Σ_k (1 - a_k) / K`` of its g: a bare stem gains nothing, and a bud no
  more than the terminal that it takes the place of. A module's size is ``a + (1 - a) / K``, K of its bearer: its own
  leaves and those left on that terminal. What vigour means to it (Eq. 7, v_min) is its vigour over its size. Were buds
  counted as whole modules, a plant at its root's cap would sprout everywhere and starve its crown. v_rootmax of Table 1
  is so about the number of leafy modules in full light that feed a plant at its greatest.
- A module is stunted that in twice the time in which full vigour makes it grow up has not come to a thirtieth of that.
  Without this, buds just above v_min, which Eq. 7 lets grow by nothing, would wait for ever; so would seedlings.
- c, `compensation` (0.4), is ours. Without it a plant in the deepest shade still sums up s_tol of every module, and
  the larger it is the less it can die: no stand thins itself. With it a module in deep shade has a negative gain:
  types with s_tol below about 0.5 die where it is dark, those above wait, and grow slowly the more they tolerate. At
  forks a branch of gain below zero counts as zero, gets nothing, and falls: crowns clean their stems.
- `reach_m` (25 m) and `upkeep` (0.01 / m) are ours. At λ = 1 and wherever the leader has more than v_max, Eqs. 2 and 7
  give a stem that grows at one speed as long as the plant lives. The way of water bounds the height of trees: the
  tension rises with it, and what wood still conducts falls as a Weibull function of the tension (Neufeld et al. 1992,
  its exponent about 3). So of the vigour at the foot ``exp(-(w / reach)^3)`` is left after w metres of the way, each
  module taking its part; `upkeep` is taken from every metre alike. A sole stem ends at about 1.2 reaches, a lone tree
  with a leader at 1.2 to 1.8, in a stand lower. At every fork the children's vigour still sums to what reached the
  fork. As the toll is a share, a plant in want loses first what is darkest, its lowest branches.
- `slowing_per_m` and `growth_spread` (0) are ours. By Eqs. 7 and 8 a leader grows at one speed as long as its vigour
  is above v_max, and all leaders of a type alike: heights rise along a line, and no tree of a stand of one age falls
  behind. So a module at d metres from the foot grows at ``1 - slowing_per_m d`` of its rate, as the way of water slows
  it (Ryan, Yoder 1997): a stem's height then follows Mitscherlich's law, ``H = L (1 - exp(-k t))`` with
  ``L = 1 / slowing_per_m``, as site curves do. And each plant's rate has a factor of its own, uniform about 1 with the
  standard deviation growth_spread, drawn once from its identity: the slow are overtopped and die. Shipped trees have
  growth rates, slowing and tolerance after site curves and yield tables; the rates of Table 1 give 0.2 to 0.4 m a year.
- v_min (0.08) is not given, and stands for two scales: a module's vigour, and that of one of its K terminals, which
  share it. Terminals are compared with v_min / K. `sprouting` (2) times that is wanted of a terminal that sprouts: a
  new module must grow, and what grew must not fall at once.
- φ of Table 1 has no unit: it is read as Eq. 10 has it, the diameter of a grown terminal segment, in cm. But modules
  with a handful of terminals have far fewer than a tree has shoots, and by Eq. 10 alone crowded beeches and birches are
  250 to 400 times as high as thick. So a terminal stands for `shoots_per_terminal` (1) shoots of φ: wood is the
  root of that thicker, which feeds back on nothing but where seeds find room beside a foot. The shipped trees have
  2 to 7, so that the tallest of a crowded stand are some 60 to 150 times as high as thick.
- v_max is 1, the vigour of one module in full light.
- l_max is not given: 0.8 m, a whole module of Table 1's trees is then 1.5 to 2 m long. a_mature is 1.
- F_eff is limited to flowering_delay_max (1.2) times F_age: seen from v_rootmax = 600, a young stem of λ = 1 never
  flowers.
- α of Table 1 is below 0 for hemlock, sequoia, willow and spruce, and Eq. 3 takes its cosine, which does not depend on
  the sign. Above 0 it is read as an angle from the vertical (cypress and eucalyptus rise steeply), below 0 as one
  below the horizontal: so conifers have the level and drooping branches that they are known by, and brooms otherwise.
- The tropism's angle is that of branches: modules that continue a leading (λ > 0.5) plant's main axis turn upright,
  whatever stands beside them: if they fled their neighbours, stems of forest trees would wander by a metre.
  Root modules are upright and never turn; the root's prototype is that of λ and D. A new module begins along the
  segment that bears it, rolled by a random angle of its identity; along the parent's own axis, as in the print,
  laterals would stand upright.
- Pipes of shed modules stay in the wood below them until new ones take their place, all but `disused_share` (0.15):
  stems never shrink; see growth.py.
- `standing_dead_yr` and `dieback_share` are ours: what dies over 1.3 m stands as a snag, which does not affect living
  plants; a plant that has died back to less than a share of its greatest height is dead. See growth.py. Felled and
  burned plants leave no snag, and felling and fire leave snags as they are.
- `seedling_spacing_m` (0.8), with the light that a seedling needs, bounds how many plants a square metre has.
- All of a state's modules look at the spheres at the step's beginning.
- A planting sets seeds, whatever its radius. Felling and fire spare buildings.
- Buildings of the site are the first rows of a population, have no modules, and never change.
- Randomness of step k: ``child_rng(seed, "community", k)``; of a module: seed, plant_id and its number.
- Snapshots without their modules (a history without history_modules) cannot be resumed.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from forestgen.architecture.geometry import plant_sizes
from forestgen.architecture.modules import Modules
from forestgen.community.arrivals import on_the_ground, refuse_overflow
from forestgen.community.branch_modules.capabilities import ModuleCapabilities, without_modules
from forestgen.community.branch_modules.parameters import BranchModulesParameters, numbers_in_time
from forestgen.community.branch_modules.state import (
    Plants,
    Snags,
    State,
    ground_at,
    refuse_more_modules,
    step_parameters,
)
from forestgen.community.branch_modules.step import initial_state, new_seedlings, step_forest
from forestgen.community.disturbance import Planting, planted
from forestgen.community.population import Ecologies, Floats, Floats32, Population, Site, SpeciesEcology, Status
from forestgen.community.snapshot_checks import ImpossibleValueError, Limits, arrival_limits, check_columns, place_of
from forestgen.core.errors import RecipeError

# Peak bytes: of a module in a step with the state before and after, and a snapshot; of a plant with its arrays.
_BYTES_PER_MODULE, _BYTES_PER_PLANT = 700, 400
_BYTES_AT_LEAST = 64 * 1024 * 1024
_MODULES_PER_M2 = 12.0  # more than the light on the ground feeds
_LEAST_SIZE_M = 0.01  # of a seed, which has no length yet
_ALIVE = np.iinfo(np.int32).max  # step of death of living plants
_DOMINATED_BELOW = 0.5  # mean light of a plant's modules


def _with_snags(state: State) -> tuple[Plants, Modules, NDArray[np.int32]]:
    """All plants in order of plant_id with their modules, and (N,) the step in which each died."""
    snags, died = state.snags, np.full(len(state.plants), _ALIVE, dtype=np.int32)
    if not len(snags.died):
        return state.plants, state.modules, died
    plants, died = state.plants.and_then(snags.plants), np.concatenate([died, snags.died])
    order = np.argsort(plants.plant_id).astype(np.int64)
    return plants.where(order), state.modules.and_then(snags.modules).of_plants(order), died[order]


def _mean(modules: Modules, values: Floats32) -> Floats:
    """(P,) mean of a number of each module; 0 for plants that have none."""
    sums = np.concatenate([[0.0], np.cumsum(values, dtype=np.float64)])
    count = np.diff(modules.first)
    return np.asarray((sums[modules.first[1:]] - sums[modules.first[:-1]]) / np.maximum(count, 1))


def _steps(years: NDArray[np.floating], parameters: BranchModulesParameters) -> NDArray[np.int32]:
    return np.asarray(np.rint(years / parameters.step_yr), dtype=np.int32)


def _check_obstacles(site: Site, species: Ecologies, population: Population) -> None:
    """The recipe's buildings are the first rows, stand, and no other row is of a species that does not grow."""
    names = [one.name for one in species]
    wanted, row = [names.index(one.kind) for one in site.buildings], 0
    expected = f"the {len(wanted)} buildings of the recipe first"
    for row, sp in enumerate(wanted):
        if row >= len(population) or population.plant_id[row] != row + 1:
            raise ImpossibleValueError("column plant_id", expected, f"no plant {row + 1}")
        if population.species[row] != sp:
            raise ImpossibleValueError(place_of("species", population, row), expected, names[population.species[row]])
        if population.status[row] == Status.DEAD:
            raise ImpossibleValueError(place_of("status", population, row), "a building, which cannot die", "dead")
    grows = np.array([one.modules is not None for one in species], dtype=np.bool_)
    wrong = np.flatnonzero(~grows[population.species[len(wanted) :]]) + len(wanted)
    if len(wrong):
        row = int(wrong[0])
        got = names[population.species[row]]
        raise ImpossibleValueError(place_of("species", population, row), "a species that grows by branch modules", got)


def _check_module_numbers(modules: Modules, population: Population) -> None:
    """The next module of each plant has a number above all that it has."""
    plant = modules.plant()
    wrong = np.flatnonzero(population.columns["next_module"][plant] <= modules.number)
    if len(wrong):
        row = int(plant[wrong[0]])
        expected = f"more than {modules.number[wrong[0]]}, the number of one of its modules"
        got = str(population.columns["next_module"][row])
        raise ImpossibleValueError(place_of("model.next_module", population, row), expected, got)


class BranchModules(ModuleCapabilities):
    Parameters = BranchModulesParameters

    def init(self, parameters: BranchModulesParameters, site: Site, species: Ecologies, seed: int) -> State:
        """The obstacles, and the plants of the start as seeds at random places."""
        _refuse_without_modules(site, species)
        refuse_overflow(1, float(parameters.counts([one.name for one in _growing(species)]).sum()))
        return initial_state(parameters, site, species, seed)

    def step(self, state: State) -> State:
        """Light, vigour, growth, shedding, new modules, turning, seeds, death."""
        refuse_overflow(state.next_id, 0.0)
        return step_forest(state)

    def population(self, state: State) -> Population:
        """Snapshot, the standing dead among the living; z is 0."""
        plants, modules, died = _with_snags(state)
        tables, step_yr = step_parameters(state).tables, state.parameters.step_yr
        dead = died <= state.step
        sizes = plant_sizes(tables, modules, plants.species)
        light, vigour = np.where(dead, 0.0, _mean(modules, modules.light)), np.zeros(len(plants))
        rooted = (np.diff(modules.first) > 0) & ~dead
        vigour[rooted] = modules.vigour[modules.first[:-1][rooted]]
        age_yr = (np.minimum(state.step, died) - plants.born) * step_yr
        status = np.where(plants.flowering, np.uint8(Status.MATURE), np.uint8(Status.GROWING))
        status[rooted & (light < _DOMINATED_BELOW) & (age_yr > 0)] = Status.DOMINATED
        status[dead] = Status.DEAD
        radius_m, height_m = (one.astype(np.float64) for one in (sizes.crown_radius_m, sizes.height_m))
        for row, obstacle in enumerate(state.site.buildings):  # they are the first plants of all
            radius_m[row], height_m[row] = 0.5 * float(np.hypot(*obstacle.size_m[:2])), obstacle.size_m[2]
        on_request = {}
        if state.parameters.standing_dead_yr > 0:
            on_request["dead_yr"] = (np.maximum(state.step - died.astype(np.int64), 0) * step_yr).astype(np.float32)
        if state.parameters.dieback_share > 0:
            on_request["tallest_m"] = plants.tallest_m
        return Population(
            time_yr=state.step * step_yr,
            species_names=tuple(one.name for one in state.species),
            plant_id=plants.plant_id,
            species=plants.species,
            position_m=on_the_ground(plants.position_m),
            radius_m=np.maximum(radius_m, _LEAST_SIZE_M),
            height_m=np.maximum(height_m, _LEAST_SIZE_M),
            age_yr=age_yr.astype(np.float64),
            status=status,
            columns={
                "modules": sizes.modules.astype(np.int32),
                "trunk_diameter_m": sizes.trunk_diameter_m.astype(np.float32),
                "foot_diameter_m": sizes.foot_diameter_m.astype(np.float32),
                "wood_volume_m3": sizes.wood_volume_m3.astype(np.float32),
                "leaf_area_m2": np.where(dead, 0.0, sizes.leaf_area_m2).astype(np.float32),
                "vigour": vigour.astype(np.float32),
                "light": light.astype(np.float32),
                "flowering": plants.flowering.astype(np.uint8),
                "next_module": plants.next_number,
                "adaptation": plants.adaptation,
                **on_request,
            },
            step=state.step,
            state={"next_id": state.next_id, **({"notes": list(state.notes)} if state.notes else {})},
            modules=modules,
        )

    def resume(
        self, parameters: BranchModulesParameters, site: Site, species: Ecologies, seed: int, population: Population
    ) -> State:
        """The state of a snapshot; it needs the snapshot's modules."""
        _refuse_without_modules(site, species)
        if population.modules is None:
            problem = "a snapshot without its modules cannot go on"
            expected, hint = "a history that keeps each plant's modules", "set history_modules: true and simulate again"
            raise RecipeError(problem, where="community.history_modules", expected=expected, hint=hint)
        n, columns = len(population), population.columns
        zeros = np.zeros(n, dtype=np.float32)
        position_m = np.ascontiguousarray(population.position_m[:, :2])
        dead = population.status == Status.DEAD
        died = np.int32(population.step) - _steps(columns.get("dead_yr", zeros), parameters)
        plants = Plants(
            plant_id=population.plant_id,
            species=population.species,
            position_m=position_m,
            ground_m=ground_at(site, position_m),
            born=died - _steps(population.age_yr, parameters),
            flowering=columns["flowering"] != 0,
            next_number=columns["next_module"],
            adaptation=columns.get("adaptation", np.ones(len(population), dtype=np.float32)),
            tallest_m=columns.get("tallest_m", zeros),
        )
        modules, notes, next_id = population.modules, tuple(population.notes), int(population.state["next_id"])
        snags = Snags(plants.where(dead), modules.of_plants(dead), died[dead])
        living = plants.where(~dead), modules.of_plants(~dead)
        return State(parameters, site, tuple(species), seed, population.step, next_id, *living, snags, notes)

    def check_snapshot(
        self, parameters: BranchModulesParameters, site: Site, species: Ecologies, population: Population
    ) -> None:
        """Refuse plants, obstacles and snags that no snapshot has; modules have their own checksum."""
        _refuse_without_modules(site, species)
        keeps_dead = parameters.standing_dead_yr > 0
        limits = {
            **arrival_limits(population, parameters.step_yr, dead=keeps_dead),
            "flowering": Limits("u1", 0, 1),
            "next_module": Limits("u4", 0),
            "adaptation": Limits("f4", 0, 1),
        }
        if keeps_dead:
            limits["dead_yr"] = Limits("f4", 0, limits["age_yr"].most)
        if parameters.dieback_share > 0:
            limits["tallest_m"] = Limits("f4", 0)
        check_columns(population, limits)
        _check_obstacles(site, species, population)
        if population.modules is not None:
            _check_module_numbers(population.modules, population)

    def remove(self, state: State, plant_id: NDArray[np.uint32]) -> State:
        """The forest without these plants; obstacles stay."""
        grows = np.array([one.modules is not None for one in state.species], dtype=np.bool_)
        keep = ~(np.isin(state.plants.plant_id, plant_id) & grows[state.plants.species])
        return replace(state, plants=state.plants.where(keep), modules=state.modules.of_plants(keep))

    def plant(self, state: State, planting: Planting) -> State:
        """The forest with new plants, seeds all: a planting's radius says nothing here."""
        for sp in np.unique(planting.species):
            one = state.species[int(sp)]
            if one.modules is None:
                raise without_modules(one.name, f"species.{one.name}.modules")
        modules_after = len(state.modules) + len(state.snags.modules) + len(planting)
        refuse_more_modules(modules_after, state.parameters.most_modules)
        now, at = step_parameters(state), planting.position_m
        plants, modules = new_seedlings(at, planting.species, state, now, state.step)
        return replace(
            state,
            next_id=state.next_id + len(plants),
            plants=state.plants.and_then(plants),
            modules=state.modules.and_then(modules),
        )

    def expected_plants(self, parameters: BranchModulesParameters, site: Site, species: Ecologies) -> float:
        """Upper bound: those of the start, planted or built, and as many seedlings as find room and light.

        With the dead that stand: see `with_dead`.
        """
        total = _founders(parameters, species)
        seeding = any(one.modules is not None and one.modules.seeds_per_yr > 0 for one in species)
        if total > 0 and seeding and parameters.steps > 0:
            total += most_seedlings(parameters, site)
        return total * with_dead(parameters) + len(site.buildings)

    def empty_reason(self, parameters: BranchModulesParameters, site: Site, species: Ecologies) -> str | None:
        _refuse_without_modules(site, species)
        if _founders(parameters, species) > 0:
            return None
        return "no plant can grow: community.initial_plants is 0, and none is planted"

    def estimate_bytes(self, parameters: BranchModulesParameters, site: Site, species: Ecologies) -> int:
        """Bytes for so many modules as the light feeds, at most most_modules, and for the finest shadow grid."""
        plants = self.expected_plants(parameters, site, species)
        alive = site.area_m2 * _MODULES_PER_M2 + 10 * _founders(parameters, species)
        modules = min(alive * with_dead(parameters), parameters.most_modules)
        cells = site.area_m2 / min(numbers_in_time(parameters, "cell_m")) ** 2
        return _BYTES_AT_LEAST + math.ceil(
            modules * _BYTES_PER_MODULE + min(plants, modules) * _BYTES_PER_PLANT + 80 * cells
        )


def most_seedlings(parameters: BranchModulesParameters, site: Site) -> float:
    """How many points lie at least a spacing apart on the site, discs of half of it, packed; at most most_modules."""
    spacing = max(min(numbers_in_time(parameters, "seedling_spacing_m")), 0.01)
    return min(site.area_m2 * 2 / (math.sqrt(3) * spacing**2), float(parameters.most_modules))


def with_dead(parameters: BranchModulesParameters) -> float:
    """Plants, living and standing dead, over those that live, supposing that one in twenty dies each year.

    `most_modules` bounds them all whatever dies.
    """
    standing_yr = min(2.0 * parameters.standing_dead_yr, parameters.steps * parameters.step_yr)
    return 1.0 + standing_yr / 20.0


def _growing(species: Ecologies) -> list[SpeciesEcology]:
    return [one for one in species if one.modules is not None]


def _founders(parameters: BranchModulesParameters, species: Ecologies) -> float:
    """Plants of the start, and those that disturbances plant."""
    counts = parameters.counts([one.name for one in _growing(species)])
    return float(counts.sum() if len(counts) else 0) + planted(parameters.disturbances)


def _refuse_without_modules(site: Site, species: Ecologies) -> None:
    """Every species must grow by modules but those that stand for buildings."""
    built = {one.kind for one in site.buildings}
    for one in species:
        if one.modules is None and one.name not in built:
            raise without_modules(one.name, f"species.{one.name}.modules")


MODEL = BranchModules()
