"""Growing with kernels: deformation kernels determine where seedlings come up and how plants compete.

References: B. Lane, Models of Plant Communities for Image Synthesis, University of Calgary, 2002. Chapter 5 has the
deformation kernel and the kernel matrix M, sections 4.3 and 4.4 the life of a plant. Chapter 7 asks for a
local-to-global model with deformation kernels; this is one.

A plant of species j and radius r_j at x_j multiplies the probability of finding one of species i at x by
``κ_ij(|x - x_j| / r_j)``. It acts on two things: where seedlings of i come up, and how those of i that are smaller than
itself fare. A step of Δt years is

1.  life: a plant of quality q in [0, 1] lives on with probability ``q m + (1 - q) shade``, where m is 1, or oldage if
    it is mature; then r becomes ``min(R, r + grow Δt q^γ)``;
2.  seed rain: a Poisson number of seeds of each species, in the mean ``rate Δt ∫ b_i``, where b_i is the ground's
    relative density, 1 on plain ground. Their places are drawn from ``b_i(x) min(L, Π_j max(κ_ij, 1))``: kernels above
    1 gather seeds, but make none;
3.  establishment: a seed comes up with probability ``Π_j min(κ_ij, 1)``: kernels below 1 keep seedlings out. So the
    density of those that come up is in proportion to ``f_i(x) = b_i(x) Π_j κ_ij``, the field of chapter 5 as the
    standing plants deform it, except where they invite more than L times;
4.  competition: q becomes ``min(1, Π κ_ij)`` at the plant's own place, over the plants that are larger than it; of two
    of one radius, the older acts.

With a kernel of 0 within its reach and 1 beyond, q is 0 or 1, and this is domination as Deussen and Lane have it: a
dominated plant survives a step with probability shade and does not grow, a free one lives until it is old (L-system
4.5). Circles meet there where ``d <= r_i + r_j``, here where ``d <= reach r_j``: among plants of one size a reach of 2
is the same. With the neutral kernel plants do not interact: they are an immigration-death process. With
``kernels: {curve: [[0, 0], [1.5, 1]]}`` cohorts thin themselves along a line of -1.4 to -1.6, and Lane's three species
(recipes/reproductions/succession.yaml) succeed each other: 3055, 1568, 1275, 954 plants at steps 20, 150, 300, 1000,
where Table 7.1 has 2688, 1593, 1409, 834.

Parameters: see below; κ_ij are the kernels, γ is growth_exponent, L is most_inviting, b_i is a
species' ground and 0 where keep_out bars, n is initial_plants_per_ha. Of each species' ecology: grow is
growth_m_per_yr, R is max_radius_m, shade and oldage are shade_tolerance and old_age_survival (probabilities a step),
rate is seedlings_per_ha_per_yr; seedling_radius_m is the mean radius; heights are ``A_H r^c_H`` with the scale and
exponent of height_m.

Recipe::

    community:
      model: kernel_growth
      steps: 200
      kernels: {spruce: inhibition, poplar: {poplar: clustering, spruce: inhibition}}  # who acts: {who is affected}
      ground: {poplar: {map: [[1, 0], [1, 1]]}}

Decided here:

- Seedlings are never more than the rain. If a kernel above 1 made seeds, a clump would multiply with every step, and
  no bound of the number of plants could be computed before a simulation.
- A place's invitation ends at L. A product without end sends all seeds to the densest clump, the more so the denser it
  is: they die there, and the community is gone. Among plants that cover the ground all places invite alike, and they
  stand as regularly as without; there are clumps where ground is left between them.
- What keeps seedlings out is evaluated at their very places: a hard core bars, whatever the cells. What invites
  is sampled at the middles of the cells of a field, `cells` along the site's longer side. By default a cell is a sixth
  of the least reach of an inviting kernel, for a plant of half its species' largest radius, within 64 to 1024 cells,
  with maps 512 at least. Smaller plants invite unevenly. Without inviting kernels and without maps there is no field.
- Seedlings of one step do not act on each other's places: the field is deformed between steps. They compete from then
  on. Nor does it matter how large a seedling is for where it comes up: every standing plant acts, also a smaller one.
- Life is that of L-system 4.5 where its c is 0 or 1, and a mixture of the two for any q between. As there,
  shade and oldage are probabilities a step, not a year.
- The larger of two plants is the one of greater radius, whatever the species. A larger plant of a kernel above 1 makes
  up for others below 1; but q is 1 at most, and no plant grows faster than in the open.
- The status is dominated where q < 1/2; q itself is the column ``quality``.
- The initial cohort has round(n area mean(b_i) / S) plants of each of S species, at places drawn from b_i. Radii of
  seedlings are uniform between 0.5 and 1.5 times seedling_radius_m. Planted plants stand at the given positions.
- A kernel cannot be `balanced`, which keeps numbers that the rain keeps already. On a torus the nearest image counts.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator

from forestgen.community import arrivals
from forestgen.community.disturbance import Planting, planted
from forestgen.community.kernel_interactions import (
    Ground,
    GroundSection,
    Interactions,
    Rivals,
    establishment,
    ground_of,
    quality,
    seed_rain,
)
from forestgen.community.model import CommunityParameters
from forestgen.community.placement import kernels as placement_kernels
from forestgen.community.placement.density_map import DensityMap
from forestgen.community.population import Ecologies, Floats, Population, Site, SpeciesEcology
from forestgen.community.snapshot_checks import Limits, arrival_limits, check_columns, check_radii
from forestgen.core.randomness import child_rng
from forestgen.recipe.fields import Name, NonNegative, Number, Whole, violation
from forestgen.recipe.sources import Keys

_BYTES_PER_PLANT = 400  # at the peak: a state, its successor, the tables between them, the grid, and a snapshot
_BYTES_PER_CELL = 32  # and a species, with one more for what is made of them
_BYTES_PER_KERNEL = 2 * 8 * 1025  # of the matrix, once more while it is made
_BYTES_AT_LEAST = 1024 * 1024
_MOST_PAIRS = 2e9


class KernelGrowthParameters(CommunityParameters):
    """What a recipe says about the model besides its species."""

    initial_plants_per_ha: NonNegative = Field(0.0, description="seedlings on the site from the beginning, per hectare")
    kernels: placement_kernels.Kernels = Field(
        placement_kernels.KernelSection(**placement_kernels.NAMED["inhibition"]),
        description="the kernel of all plants; or kernels by the species that acts; or by it and the one affected",
    )
    most_inviting: Number = Field(
        100.0, ge=1, le=1e12, description="the product of a place's kernels above 1 counts as this at most"
    )
    growth_exponent: Number = Field(1.0, ge=0, le=100, description="growth falls with quality to this power")
    ground: dict[Name, GroundSection] = Field(
        default_factory=dict, description="where each species' seeds fall and come up; a species not named: anywhere"
    )
    keep_out: DensityMap | None = Field(
        None, description="where no seedling of any species comes up: any value above 0 of this map bars"
    )
    cells: Whole | None = Field(None, ge=16, le=4096, description="cells of a field along the site's longer side")

    @field_validator("kernels")
    @classmethod
    def _kernels_that_can_grow(cls, kernels: object) -> object:
        if isinstance(kernels, placement_kernels.HopkinsTarget):
            raise violation(
                "kernels", problem="a community that grows has no clustering to be given", hint="see deformation_kernel"
            )
        for keys, kernel in placement_kernels.each_kernel(kernels):
            if kernel.balanced:
                problem = "balanced keeps the number of plants, which the seeds that fall already limit"
                raise violation("a kernel that is not balanced", problem=problem, at=(*keys, "balanced"))
        return kernels

    def matrix(self, species: Ecologies) -> Interactions:
        """What the plants of each species do to each other's."""
        assert not isinstance(self.kernels, placement_kernels.HopkinsTarget)
        return Interactions.of(placement_kernels.kernel_matrix(self.kernels, [one.name for one in species]))

    def ground_of(self, site: Site, species: Ecologies) -> Ground:
        """Where the seeds of each species fall and come up."""
        return ground_of(self.ground, self.keep_out, site, species, self.matrix(species), self.cells)

    def named_species(self) -> Iterator[tuple[Keys, str]]:
        yield from super().named_species()
        yield from ((("ground", name), name) for name in self.ground)
        yield from ((("kernels", *keys), name) for keys, name in placement_kernels.species_named(self.kernels))


@dataclass(frozen=True)
class Plants(arrivals.CirclePlants):
    """One row a plant."""

    quality: Floats  # (N,) q, 0 to 1


@dataclass(frozen=True)
class State:
    """Everything that the future of a simulation depends on."""

    parameters: KernelGrowthParameters
    site: Site
    species: tuple[SpeciesEcology, ...]
    kernels: Interactions
    ground: Ground
    seed: int
    step: int
    next_id: int  # the id of the next plant to arrive
    plants: Plants

    def rivals(self, plants: Plants) -> Rivals:
        return Rivals(plants.x_m, plants.r_m, plants.sp, plants.plant_id, self.site.size_m, self.parameters.periodic)


def survivors(state: State, u: Floats) -> Plants:
    """Life: the plants that live on, with their new radius; `u` is random(1) of each plant."""
    plants, species, parameters = state.plants, state.species, state.parameters
    largest = arrivals.of_species(species, "max_radius_m")[plants.sp]
    free = np.where(plants.r_m >= largest, arrivals.of_species(species, "old_age_survival")[plants.sp], 1.0)
    shade = arrivals.of_species(species, "shade_tolerance")[plants.sp]
    alive = u < plants.quality * free + (1 - plants.quality) * shade
    speed = arrivals.of_species(species, "growth_m_per_yr")[plants.sp] * plants.quality**parameters.growth_exponent
    return replace(plants, r_m=np.minimum(plants.r_m + speed * parameters.step_yr, largest)).where(alive)


def _new(x_m: Floats, r_m: Floats, sp: NDArray[np.uint16], first_id: int, born: int) -> Plants:
    n = len(sp)
    return Plants(x_m, r_m, sp, arrivals.new_ids(first_id, n), np.full(n, born, dtype=np.int32), np.ones(n))


def _arrived(state: State, per_species: NDArray[np.int64], among: Plants, rng: np.random.Generator) -> Plants:
    """Rain and establishment: of so many seeds of each species, those that come up among the plants."""
    arrivals.refuse_overflow(state.next_id, float(per_species.sum()))
    rivals = state.rivals(among)
    places = [
        seed_rain(state.ground, index, int(n), rivals, state.kernels, state.parameters.most_inviting, rng)
        for index, n in enumerate(per_species)
    ]
    sp = np.repeat(np.arange(len(per_species), dtype=np.uint16), per_species)
    x_m = np.concatenate([np.zeros((0, 2)), *places])
    r_m = arrivals.seedlings(sp, state.site, state.species, rng)[1]
    comes_up = rng.random(len(sp)) < establishment(x_m, sp, rivals, state.kernels)
    return _new(x_m[comes_up], r_m[comes_up], sp[comes_up], state.next_id, state.step)


class KernelGrowth:
    Parameters = KernelGrowthParameters

    def init(self, parameters: KernelGrowthParameters, site: Site, species: Ecologies, seed: int) -> State:
        """The initial cohort, by default a bare site."""
        bare = _bare(parameters, site, species, seed)
        cohort = _cohort(parameters, site, bare.ground)
        return _competing(bare, _arrived(bare, cohort, bare.plants, child_rng(seed, "community", 0)))

    def step(self, state: State) -> State:
        """Life, seed rain, establishment, competition."""
        rng = child_rng(state.seed, "community", state.step + 1)
        old = survivors(state, rng.random(len(state.plants)))
        mean = arrivals.seedlings_per_step(state.species, state.site, state.parameters.step_yr) * state.ground.mean
        arrivals.refuse_overflow(state.next_id, float(mean.sum()))
        after = replace(state, step=state.step + 1)
        new = _arrived(after, rng.poisson(mean), old, rng)
        return _competing(after, old.and_then(new))

    def population(self, state: State) -> Population:
        plants, columns = state.plants, {"quality": state.plants.quality}
        dominated = plants.quality < 0.5
        return plants.population(state.species, state.step, state.parameters.step_yr, state.next_id, dominated, columns)

    def resume(
        self, parameters: KernelGrowthParameters, site: Site, species: Ecologies, seed: int, population: Population
    ) -> State:
        circles = Plants.columns_of(population, parameters.step_yr)
        plants = Plants(**circles, quality=population.columns["quality"])
        bare, next_id = _bare(parameters, site, species, seed), int(population.state["next_id"])
        return replace(bare, step=population.step, next_id=next_id, plants=plants)

    def check_snapshot(
        self, parameters: KernelGrowthParameters, site: Site, species: Ecologies, population: Population
    ) -> None:
        """Refuse ages, sizes and qualities that no plant of a snapshot has."""
        check_radii(population, species)
        limits = arrival_limits(population, parameters.step_yr)
        check_columns(population, {**limits, "quality": Limits("f8", 0, 1)})

    def remove(self, state: State, plant_id: NDArray[np.uint32]) -> State:
        """The community without these plants; those that they held down fare better at once."""
        return _competing(state, state.plants.where(~np.isin(state.plants.plant_id, plant_id)))

    def plant(self, state: State, planting: Planting) -> State:
        """The community with new plants."""
        arrivals.refuse_overflow(state.next_id, len(planting))
        new = _new(planting.position_m, planting.radius_m, planting.species, state.next_id, state.step)
        return _competing(state, state.plants.and_then(new))

    def expected_plants(self, parameters: KernelGrowthParameters, site: Site, species: Ecologies) -> float:
        """Upper bound: who is there from the beginning or planted, and the rain of a step times the steps of a life."""
        ground = parameters.ground_of(site, species)
        total = float(_cohort(parameters, site, ground).sum() + planted(parameters.disturbances))
        seeds = arrivals.seedlings_per_step(species, site, parameters.step_yr) * ground.mean
        for one, rain in zip(species, seeds, strict=True):
            total += min(float(rain), 1e30) * min(_longest_life(parameters, one), parameters.steps)
        return total

    def empty_reason(self, parameters: KernelGrowthParameters, site: Site, species: Ecologies) -> str | None:
        if self.expected_plants(parameters, site, species) > 0:
            return None
        if parameters.steps == 0:
            return "no plant can grow: community.steps is 0, and the community begins on bare ground"
        if not np.any(arrivals.of_species(species, "seedlings_per_ha_per_yr")):
            return "no plant can grow: ecology.seedlings_per_ha_per_yr is 0 for every species"
        barred = "community.ground and community.keep_out bar the whole site to every species with seeds"
        return f"no plant can grow: {barred}"

    def estimate_bytes(self, parameters: KernelGrowthParameters, site: Site, species: Ecologies) -> int:
        """Bytes for the bound of the mean number of plants and six standard deviations of a Poisson number more."""
        plants = arrivals.upper_number(self.expected_plants(parameters, site, species))
        _check_work(parameters, site, species)
        cells = math.prod(parameters.ground_of(site, species).shape) * (len(species) + 1)
        kernels = len(species) ** 2 * _BYTES_PER_KERNEL
        return _BYTES_AT_LEAST + math.ceil(plants * _BYTES_PER_PLANT) + cells * _BYTES_PER_CELL + kernels


def _check_work(parameters: KernelGrowthParameters, site: Site, species: Ecologies) -> None:
    """Refuse an initial cohort of which so many plants lie within a kernel's reach that a step takes half a minute."""
    plants = parameters.initial_plants_per_ha * site.area_ha / max(1, len(species))
    acting = {one.name: (plants, one.seedling_radius_m) for one in species}
    if plants:
        words = (
            "pairs of the first plants, about 20 s a step",
            f"initial_plants_per_ha is {parameters.initial_plants_per_ha:g}",
            "or fewer initial_plants_per_ha",
        )
        placement_kernels.refuse_long_work(
            parameters.kernels, site, acting, dict.fromkeys(acting, plants), _MOST_PAIRS, words
        )


def _bare(parameters: KernelGrowthParameters, site: Site, species: Ecologies, seed: int) -> State:
    """A state of step 0 without plants."""
    nothing = _new(np.zeros((0, 2)), np.zeros(0), np.zeros(0, dtype=np.uint16), 1, 0)
    kernels, ground = parameters.matrix(species), parameters.ground_of(site, species)
    return State(parameters, site, tuple(species), kernels, ground, seed, 0, 1, nothing)


def _competing(state: State, plants: Plants) -> State:
    """`state` with these plants and their qualities; those that are new are counted."""
    next_id = max(state.next_id, int(plants.plant_id[-1]) + 1 if len(plants) else 1)
    return replace(state, next_id=next_id, plants=replace(plants, quality=quality(state.rivals(plants), state.kernels)))


def _cohort(parameters: KernelGrowthParameters, site: Site, ground: Ground) -> NDArray[np.int64]:
    """(S,) plants of each species on the site from the beginning."""
    number = min(parameters.initial_plants_per_ha * site.area_ha, 1e18)
    return np.floor(number / max(1, len(ground.mean)) * ground.mean + 0.5).astype(np.int64)


def _longest_life(parameters: KernelGrowthParameters, one: SpeciesEcology) -> float:
    """Upper bound of the mean number of steps of a life, whatever its neighbours.

    For any threshold t: in a step of q >= t a plant grows by grow Δt t^γ at least, so there are few of these before it
    is mature; in any other it dies with probability (1 - shade) (1 - t) at least, so there are few of those too. A
    mature plant dies with probability 1 - max(shade, oldage) at least.
    """
    t = np.linspace(0.0, 0.99, 100)
    with np.errstate(divide="ignore"):
        grows = one.max_radius_m / (one.growth_m_per_yr * parameters.step_yr * t**parameters.growth_exponent) + 1
        suffers = 1 / ((1 - one.shade_tolerance) * (1 - t)) + 1
        mature = 1 / (1 - np.float64(max(one.old_age_survival, one.shade_tolerance)))
    return float(np.min(grows + suffers) + mature)


MODEL = KernelGrowth()
