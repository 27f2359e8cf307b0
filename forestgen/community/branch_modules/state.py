"""The state of a simulation, what one step goes by, and what modules see: spheres, light, room, climate.

The state is its plants, their modules, and everything else that the future depends on. A step goes by the parameters,
and by plant types and prototypes as arrays, with all changes up to then. Random numbers and orientations of modules
follow from their identity: other plants do not change them.

How well a climate suits a species (Makowski 2023, Eq. 13) is a Gaussian of temperature times one of precipitation. The
climate is one for the whole site, colder with elevation; or it differs by place (`LocalClimate`, Eq. 38). Then it
bounds what leaves gain, too.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from forestgen.architecture.geometry import MOST_OPACITY, spheres
from forestgen.architecture.modules import Modules
from forestgen.architecture.prototypes import Tables, load_prototypes, tables_of
from forestgen.community.arrivals import Rows
from forestgen.community.branch_modules.crowding import NO_BOXES, Boxes, SphereGrid, overlap_volumes
from forestgen.community.branch_modules.parameters import BranchModulesParameters, cells_at, parameters_at
from forestgen.community.branch_modules.shade import Shade, ShadowGrid, shade
from forestgen.community.population import Floats, Floats32, Mask, Site, SpeciesEcology, SpeciesIndex
from forestgen.core.errors import RecipeError, ResourceError
from forestgen.core.randomness import SPLIT_MIX_STEP, mixed
from forestgen.recipe.species import PlantType
from forestgen.recipe.suggestions import did_you_mean

MOST_SEEDS = 20_000_000  # of one step: a gigabyte


@dataclass(frozen=True)
class Plants(Rows):
    """One row a plant, in order of plant_id; an obstacle is a row without modules."""

    plant_id: NDArray[np.uint32]  # (P,)
    species: SpeciesIndex  # (P,) index of species
    position_m: Floats  # (P, 2) metres, world x and y
    ground_m: Floats  # (P,) height of the ground at the foot, metres, world
    born: NDArray[np.int32]  # (P,) step of arrival
    flowering: Mask  # (P,)
    next_number: NDArray[np.uint32]  # (P,) of the next module
    adaptation: Floats32  # (P,) o of Eq. 13 as felt in the last step; 1 before the first, and of obstacles
    tallest_m: Floats32  # (P,) greatest height so far, where the recipe has a dieback_share; else 0


@dataclass(frozen=True)
class Snags:
    """Standing dead trees, one row a tree: what they were when they died."""

    plants: Plants
    modules: Modules
    died: NDArray[np.int32]  # (P,) step of death

    def where(self, keep: Mask) -> Snags:
        return Snags(self.plants.where(keep), self.modules.of_plants(keep), self.died[keep])


@dataclass(frozen=True)
class State:
    """Everything that the future of a simulation depends on."""

    parameters: BranchModulesParameters  # as the recipe gives them, before any change
    site: Site
    species: tuple[SpeciesEcology, ...]
    seed: int
    step: int
    next_id: int  # the id of the next plant to arrive
    plants: Plants  # those that live
    modules: Modules
    snags: Snags
    notes: tuple[str, ...] = ()  # for people, as that not all plants found a place

    @property
    def types(self) -> dict[str, PlantType]:
        """The plant types at the start, by the names of the species that grow."""
        return {one.name: one.modules for one in self.species if one.modules is not None}


def uniform(seed: int, plant_id: NDArray[Any], number: NDArray[Any]) -> Floats:
    """(N,) in [0, 1): one random number of each module, by its plant's id and its own number."""
    bits = np.full(len(plant_id), seed % 2**64, dtype=np.uint64)
    for identity in (plant_id, number):
        bits = mixed(bits + SPLIT_MIX_STEP + identity.astype(np.uint64))
    return (bits >> np.uint64(11)).astype(np.float64) * 2.0**-53


def orientation_along(direction: NDArray[Any], roll_rad: Floats) -> Floats32:
    """(N, 4) unit quaternions w, x, y, z that take z to unit vectors (N, 3), rolled about z by these angles before."""
    x, y, z = direction.astype(np.float64).T
    # The least rotation from z, of axis (-y, x, 0); straight down any axis will do.
    down = z < -1 + 1e-9
    w = np.sqrt(np.maximum(0.5 * (1.0 + z), 0.0))
    scale = 0.5 / np.where(down, 1.0, w)
    a, b = np.where(down, 1.0, -y * scale), np.where(down, 0.0, x * scale)
    w = np.where(down, 0.0, w)
    cosine, sine = np.cos(0.5 * roll_rad), np.sin(0.5 * roll_rad)
    turned = np.stack([w * cosine, a * cosine + b * sine, b * cosine - a * sine, w * sine], axis=-1)
    return np.asarray(turned / np.linalg.norm(turned, axis=-1, keepdims=True), dtype=np.float32)


def seedling_modules(prototype: NDArray[np.uint8], rotation: Floats32) -> Modules:
    """The root modules of plants that begin; (P,) and (P, 4)."""
    n = len(prototype)
    zeros = np.zeros(n, dtype=np.float32)
    return Modules(
        first=np.arange(n + 1, dtype=np.int64),
        number=np.zeros(n, dtype=np.uint32),
        parent=np.full(n, -1, dtype=np.int32),
        node=np.full(n, -1, dtype=np.int16),
        prototype=prototype,
        age=zeros,
        age_yr=zeros,
        base_m=np.zeros((n, 3), dtype=np.float32),
        rotation=rotation,
        vigour=zeros,
        light=zeros,
        disused_m2=zeros,
    )


def no_modules(plants: int = 0) -> Modules:
    """Those of so many plants that have none."""
    none = seedling_modules(np.zeros(0, dtype=np.uint8), np.zeros((0, 4), dtype=np.float32))
    return replace(none, first=np.zeros(plants + 1, dtype=np.int64))


def no_snags(plants: Plants) -> Snags:
    """None, with the columns of any plants."""
    return Snags(plants.where(np.zeros(len(plants), dtype=np.bool_)), no_modules(), np.zeros(0, dtype=np.int32))


def refuse_more_modules(modules: int, most: int) -> None:
    """Raise `ResourceError` for more modules than `community.most_modules`."""
    if modules > most:
        problem, expected = "the community has too many branch modules", f"at most {most:,}"
        hint = "make the site smaller, or raise most_modules"
        raise ResourceError(problem, where="community.most_modules", expected=expected, got=f"{modules:,}", hint=hint)


def refuse_more_seeds(seeds: float, where: str = "community.step_yr") -> None:
    """Raise `ResourceError` for more seeds in a step than can be drawn; `where` is the key that asks for them."""
    if seeds > MOST_SEEDS:
        problem, expected = "more seeds would fall in one step than can be drawn", f"at most {MOST_SEEDS:,}"
        fewer = "lower species' modules.seeds_per_yr, or seeds_per_ha of global_seeding"
        hint = f"{fewer}; make steps shorter, or the site smaller"
        raise ResourceError(problem, where=where, expected=expected, got=f"about {seeds:,.0f}", hint=hint)


#: What stands in the arrays for a species that does not grow, such as a building.
STAND_IN = PlantType.model_validate(
    {"life_span_yr": 1, "root_vigour_max": 1, "growth_rate_per_yr": 1, "apical_control": 0.5, "determinacy": 0.5}
)


class Traits:
    """Every number of the plant types by its name in `PlantType`: arrays (T,) in the order of the species.

    What a type leaves open of mature plants is as before. Angles count from the vertical.
    """

    def __init__(self, types: Sequence[PlantType | None]) -> None:
        """None: a species that does not grow, such as a building."""
        self.grows: Mask = np.array([one is not None for one in types], dtype=np.bool_)
        plants = [one or STAND_IN for one in types]
        for name in PlantType.model_fields.keys() - {"prototypes"}:
            values = [getattr(one, name) for one in plants]
            young = [getattr(one, name.removesuffix("_mature")) for one in plants]
            filled = [other if value is None else value for value, other in zip(values, young, strict=True)]
            column = np.array(filled, dtype=np.float64)
            if name == "tropism_angle_rad":  # below 0: below the horizontal
                column = np.where(column < 0.0, 0.5 * np.pi - column, column)
            elif name == "mature_age":  # as ages are kept: a limit that float32 cannot hold would never be reached
                column = column.astype(np.float32).astype(np.float64)
            setattr(self, name, column)

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Floats: ...


def _allowed_prototypes(names: Sequence[str], types: Sequence[PlantType | None]) -> Mask:
    """(T, S) which of the prototypes each type may have; a type that names none may have all."""
    wanted = [(one and one.prototypes) or names for one in types]
    unknown = [name for own in wanted for name in own if name not in names]
    if unknown:
        raise no_prototype(unknown[0], names)
    return np.array([[name in own for name in names] for own in wanted], dtype=np.bool_)


def main_path(tables: Tables) -> Mask:
    """(S, N) whether the way from a prototype's root to a node takes main children only."""
    out = np.zeros(tables.parent.shape, dtype=np.bool_)
    for s, children in enumerate(tables.first_child):
        node = 0
        while node >= 0:
            out[s, node] = True
            node = int(children[node])
    return out


def no_prototype(name: str, known: Collection[str], where: str | None = None) -> RecipeError:
    """The error of a prototype that there is not."""
    expected, hint = "one of " + ", ".join(known), did_you_mean(name, known)
    return RecipeError("no such prototype of a module", where=where, expected=expected, got=name, hint=hint)


@dataclass(frozen=True)
class StepParameters:
    """Parameters, types and prototypes of one step."""

    parameters: BranchModulesParameters
    traits: Traits
    tables: Tables
    main_path: Mask  # (S, N) of `main_path`
    allowed: Mask  # (T, S) which prototypes each type may have


def step_parameters(state: State) -> StepParameters:
    """What the step after a state goes by."""
    parameters, types = parameters_at(state.parameters, state.types, state.step)
    return StepParameters(
        parameters, *_arrays(tuple(types.get(one.name) for one in state.species), parameters.sphere_scale)
    )


@lru_cache(maxsize=16)
def _arrays(types: tuple[PlantType | None, ...], sphere_scale: float) -> tuple[Traits, Tables, Mask, Mask]:
    tables = tables_of(load_prototypes(), [one or STAND_IN for one in types], sphere_scale=sphere_scale)
    return Traits(types), tables, main_path(tables), _allowed_prototypes(tables.names, types)


@dataclass(frozen=True)
class LocalClimate:
    """The climate by place: maps over the site, row 0 at y = 0."""

    size_m: tuple[float, float]
    temperature_c: Floats  # (rows, cols) mean at the ground in the open; elevation is in it
    precipitation_mm_per_yr: Floats  # (rows, cols) rain that would keep the soil as wet as it is
    shade_cooling_k: float = 0.0  # by which complete shade is cooler
    even_shade: bool = False  # whether shade counts by its mean over the site

    def light_at(self, position_m: Floats, around: Surroundings) -> Floats:
        """(N,) the light at (N, 2) world x and y on the site by which shade cools, 0 to 1."""
        if not self.shade_cooling_k:
            return np.ones(len(position_m))
        if not self.even_shade:
            return around.light_at(position_m)
        rows, cols = self.temperature_c.shape
        x, y = ((np.arange(n) + 0.5) / n * side for n, side in zip((cols, rows), self.size_m, strict=True))
        middles = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        return np.full(len(position_m), around.light_at(middles).mean())

    def at(self, position_m: Floats, light: Floats) -> tuple[Floats, Floats]:
        """(N,) temperature and precipitation at (N, 2) world x and y on the site, in so much light, 0 to 1."""
        cell = cells_at(position_m, self.size_m, self.temperature_c.shape)
        return self.temperature_c[cell] - self.shade_cooling_k * (1.0 - light), self.precipitation_mm_per_yr[cell]


def adaptation(
    now: StepParameters, species: NDArray[np.integer], position_m: Floats, elevation_m: Floats, around: Surroundings
) -> tuple[Floats, Floats]:
    """(N,) o of Eq. 13, or of Eq. 38 in a local climate, and (N,) the share of its light that a leaf can use.

    Both are 1 where no climate is given, for plants of these species. The share is 1 without a local climate. In one it
    is o, but for rain above the optimum, which counts as the optimum: water in plenty takes nothing from leaves. What a
    module needs itself does not become less, so that a drought takes the darkest leaves first (docs/adr/0012).
    `position_m` (N, 2) are their feet, `elevation_m` (N,) the ground's height there.
    """
    traits, parameters, climate, unhindered = now.traits, now.parameters, around.climate, np.ones(len(species))
    if climate is not None:
        temperature_c, rain = climate.at(position_m, climate.light_at(position_m, around))
        enough = np.minimum(rain, traits.precipitation_mm_per_yr[species])
        return suited(traits, species, temperature_c, rain), suited(traits, species, temperature_c, enough)
    if parameters.temperature_c is None or parameters.precipitation_mm_per_yr is None:
        return unhindered, unhindered
    warmth = parameters.temperature_c + parameters.lapse_rate_k_per_km * elevation_m / 1000.0
    return suited(traits, species, warmth, parameters.precipitation_mm_per_yr), unhindered


def suited(
    traits: Traits, species: NDArray[np.integer], temperature_c: Floats, precipitation_mm_per_yr: Floats | float
) -> Floats:
    """(N,) o of species where it is so warm and so wet.

    The ratio of the densities at the climate and at the optimum: 1 at the optimum, whatever the widths.
    """
    warm = (temperature_c - traits.temperature_c[species]) / traits.temperature_width_c[species]
    excess = precipitation_mm_per_yr - traits.precipitation_mm_per_yr[species]
    wet = excess / traits.precipitation_width_mm_per_yr[species]
    return np.asarray(np.exp(-0.5 * (warm**2 + wet**2)))


@dataclass(frozen=True)
class Surroundings:
    """The spheres of a state's modules, and the light that is left to each."""

    grid: SphereGrid
    shade: Shade | None  # None: plants do not shade what stands below them
    boxes: Boxes
    light: Floats32  # (M,) Q Q_G, 0 to 1: before the species' shade tolerance
    climate: LocalClimate | None = None  # None: that of the parameters

    def light_at(self, position_m: Floats) -> Floats:
        """(N,) Q_G near the ground at (N, 2) world x and y on the site."""
        return np.ones(len(position_m)) if self.shade is None else self.shade.light_at(position_m)


def boxes_of(site: Site) -> Boxes:
    """The buildings as boxes on the ground."""
    if not site.buildings:
        return NO_BOXES
    position = np.array([one.position_m for one in site.buildings])
    base_m = np.column_stack([position, ground_at(site, position)])
    azimuth = np.array([one.turn_rad for one in site.buildings])
    return Boxes(base_m, np.array([one.size_m for one in site.buildings]), azimuth)


def ground_at(site: Site, position_m: Floats) -> Floats:
    """(N,) height of the ground at (N, 2) world x and y, metres."""
    if site.height is None:
        return np.zeros(len(position_m))
    return np.asarray(site.height(position_m[:, 0], position_m[:, 1]), dtype=np.float64)


def surroundings_of(
    state: State, now: StepParameters, leaves: Floats32, climate: LocalClimate | None = None
) -> Surroundings:
    """Spheres, crowding (Eq. 1) and global shadow of a state's modules; `leaves` (M,) of a whole module's foliage."""
    parameters, modules, plants = now.parameters, state.modules, state.plants
    counts = np.diff(modules.first)
    centre, radius = spheres(now.tables, modules, plants.species)
    position = np.repeat(plants.position_m, counts, axis=0)
    position += centre[:, :2]
    ground = np.repeat(plants.ground_m, counts)
    world = np.column_stack([position, ground + centre[:, 2]])
    periodic = parameters.periodic
    grid = SphereGrid.of(world, radius, state.site.size_m if periodic else None)
    boxes = boxes_of(state.site)
    light = (overlap_volumes(grid, modules.parent_row(), boxes) / grid.volume_m3).astype(np.float32)
    np.exp(np.multiply(light, np.float32(-parameters.crowding), out=light), out=light)
    seen = None
    if parameters.global_shade:
        # The ground below a branch is that at the plant's foot: on a slope a crown keeps its height above its own foot.
        kind = np.repeat(plants.species, counts)
        depth = -np.log1p(-np.minimum(now.traits.opacity[kind], MOST_OPACITY)) * leaves
        shadows = ShadowGrid(state.site.size_m, cell_m=parameters.cell_m, layer_m=parameters.cell_m, periodic=periodic)
        seen = shade(world, centre[:, 2], radius, depth, shadows, boxes)
        light *= seen.light
    return Surroundings(grid, seen, boxes, light, climate)
