"""What the placement models have in common: the plants to be placed, densities on a grid, and checks of a recipe.

Pictures and statistics show densities as they were asked for, beside the plants that were placed.
"""

from __future__ import annotations

import hashlib
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.special import chdtrc

from forestgen.community.disturbance import planted
from forestgen.community.ground.living_conditions import why_barred
from forestgen.community.placement.densities import (
    COUNTING_CELLS,
    PlacementParameters,
    check_sizes,
    draw_heights,
    draw_radii,
    grid_shape,
    heights_asked_m,
    plant_counts,
    species_density,
)
from forestgen.community.placement.field import DensityField
from forestgen.community.placement.kernels import KernelTable
from forestgen.community.population import Ecologies, Floats, Population, Site
from forestgen.community.static_model import Placement, StaticModel
from forestgen.recipe.fields import Whole

_GRIDS_AT_ONCE = 6  # beside one a species: masks, sums, a field's own
_Kind = TypeVar("_Kind", np.float64, np.bool_)
_FEWEST_EXPECTED = 5.0  # of a bin: below, chi-square's distribution is not that of the table
_MOST_BLOCKS = 256


@dataclass(frozen=True)
class Densities:
    """Densities of the species that a recipe places; every grid is (rows, cols), row 0 at y = 0, column 0 at x = 0."""

    asked: Mapping[str, int]  # how many plants
    asked_per_ha: Mapping[str, Floats]  # map times conditions, scaled to that number; plants per hectare
    barred: NDArray[np.bool_] | None = None  # where the recipe keeps plants out, at any resolution
    left_per_ha: Mapping[str, Floats] | None = None  # the same times the kernels of all plants


def asked_densities(
    parameters: PlacementParameters, site: Site, species: Ecologies, shape: tuple[int, int] | None = None
) -> Densities:
    """What a recipe asks for, on a grid of `shape`; by default that on which plants are counted."""
    shape = shape or grid_shape(site, COUNTING_CELLS)
    counts = plant_counts(parameters, site, species)
    asked = {one.name: int(n) for one, n in zip(species, counts, strict=True) if one.name in parameters.plants}
    fields = {}
    for name, n in asked.items():
        density = species_density(parameters, site, name, shape)
        mean = float(density.mean())
        fields[name] = density * (n / site.area_ha / mean) if mean > 0 else density
    barred = parameters.keep_out.any_above_zero(shape) if parameters.keep_out is not None else None
    return Densities(asked, fields, barred)


def deformed(
    asked: Densities,
    site: Site,
    periodic: bool,
    species: Ecologies,
    placed: Population,
    kernels: Sequence[Sequence[KernelTable]],
) -> Densities:
    """The same with the field that is left when all plants of a population, in their order, have deformed it.

    `kernels` is that of `field.place`: kernels[i][j] is the effect of a plant of species j on the field of species i.
    """
    left = {}
    for affected, one in enumerate(species):
        if one.name not in asked.asked_per_ha:
            continue
        field = DensityField(asked.asked_per_ha[one.name], site.size_m, periodic=periodic)
        edges = [0, *(np.flatnonzero(np.diff(placed.species)) + 1).tolist(), len(placed)]
        for first, last in itertools.pairwise(edges):  # runs of plants of one species
            if last > first and not (kernel := kernels[affected][int(placed.species[first])]).is_neutral:
                field.deform(placed.position_m[first:last, :2], placed.radius_m[first:last], kernel)
        left[one.name] = np.asarray(field.cells)
    return Densities(asked.asked, asked.asked_per_ha, asked.barred, left)


@dataclass(frozen=True)
class ChiSquare:
    """Pearson's test of counts in bins against what was to be expected there."""

    statistic: float
    degrees_of_freedom: int
    p_value: float  # of independent plants; clusters make it small where no kernel is balanced


def counts_against(asked: Floats, position_m: Floats, size_m: tuple[float, float]) -> ChiSquare | None:
    """Whether (N, 2) plants follow a density in coarse bins; None for too few plants to fill two bins.

    The site is divided into nearly square blocks, about one for each ten plants and about 256 at most. Blocks in which
    fewer than five plants are expected are put together with the next, row by row, back and forth. The density is
    scaled to the number of plants that there are, so a bin's worth of freedom is lost.

    `asked` is a density (rows, cols) in any unit, row 0 at y = 0.
    """
    n, total = len(position_m), float(asked.sum())
    if n < 2 * _FEWEST_EXPECTED or total <= 0:
        return None
    (rows, cols), (width, height), blocks = asked.shape, size_m, min(_MOST_BLOCKS, max(4, n / 10))
    across, up = (max(1, round(math.sqrt(one))) for one in (blocks * width / height, blocks * height / width))
    row_block, col_block = (np.arange(rows) * up) // rows, (np.arange(cols) * across) // cols
    block = row_block[:, None] * across + np.where(row_block[:, None] % 2, across - 1 - col_block, col_block)
    col = np.clip((position_m[:, 0] / width * cols).astype(np.intp), 0, cols - 1)
    row = np.clip((position_m[:, 1] / height * rows).astype(np.intp), 0, rows - 1)
    found = np.bincount(block[row, col], minlength=up * across).astype(np.float64)
    expected = np.bincount(block.ravel(), weights=asked.ravel(), minlength=up * across) * (n / total)
    found, expected = _joined(found, expected)
    freedom = len(found) - 1
    if freedom < 1:
        return None
    statistic = float(np.sum((found - expected) ** 2 / expected))
    return ChiSquare(statistic, freedom, float(chdtrc(freedom, statistic)))


def _joined(found: NDArray[np.floating], expected: NDArray[np.floating]) -> tuple[Floats, Floats]:
    """Neighbouring bins put together until at least five plants are expected in each."""
    joined: list[list[float]] = []
    sums = [0.0, 0.0]
    for here, wanted in zip(found.tolist(), expected.tolist(), strict=True):
        sums = [sums[0] + here, sums[1] + wanted]
        if sums[1] >= _FEWEST_EXPECTED:
            joined.append(sums)
            sums = [0.0, 0.0]
    if joined:
        joined[-1] = [joined[-1][0] + sums[0], joined[-1][1] + sums[1]]
    both = np.array(joined).reshape(-1, 2)
    return both[:, 0], both[:, 1]


def describe_densities(densities: Densities, placed: Population, site: Site) -> dict[str, dict[str, Any]]:
    """By species, plain as in JSON: how many were asked for and stand, and whether they follow the density."""
    described: dict[str, dict[str, Any]] = {}
    for name, asked in densities.asked.items():
        points_m = placed.position_m[placed.species == placed.species_names.index(name), :2]
        test = counts_against(densities.asked_per_ha[name], points_m, site.size_m)
        chi_square = asdict(test) if test is not None else None
        described[name] = {"asked": asked, "placed": len(points_m), "chi_square": chi_square}
    return described


@dataclass(frozen=True)
class PlantingTargets:
    """The plants to be placed, largest first; of one size, in the order of species."""

    sp: NDArray[np.uint16]  # (N,) index of species
    r_m: Floats  # (N,) metres
    height_m: Floats  # (N,) metres


def wanted_plants(
    parameters: PlacementParameters, site: Site, species: Ecologies, rng: np.random.Generator
) -> PlantingTargets:
    """Species, radii and heights of the plants that a recipe asks for.

    Each species has a stream of numbers of its own, by its name: another species beside it leaves its sizes alone.
    """
    check_sizes(parameters, species)
    counts = plant_counts(parameters, site, species)
    r_m, height_m = [np.zeros(0)], [np.zeros(0)]
    for one, count in zip(species, counts, strict=True):
        stream = stream_of(rng, "sizes", one.name)
        stand = parameters.plants.get(one.name)
        r_m.append(draw_radii(stand.radius_m if stand else None, one, int(count), stream))
        height_m.append(draw_heights(stand, one, r_m[-1], stream))
    sp, radius = np.repeat(np.arange(len(species), dtype=np.uint16), counts), np.concatenate(r_m)
    order = np.argsort(-radius, kind="stable")
    return PlantingTargets(sp[order], radius[order], np.concatenate(height_m)[order])


def uniform_samples(wanted: PlantingTargets, species: Ecologies, rng: np.random.Generator) -> Floats:
    """(N, 2) numbers in [0, 1) that place the plants: a species' k-th largest has the k-th pair of its own stream.

    So a species that affects no other one leaves the others where they were.
    """
    uniform = np.empty((len(wanted.sp), 2))
    for index, one in enumerate(species):
        mine = wanted.sp == index
        uniform[mine] = stream_of(rng, "places", one.name).random((int(mine.sum()), 2))
    return uniform


def stream_of(rng: np.random.Generator, *identity: str) -> np.random.Generator:
    """The generator of a part of what `rng` is for, whatever has been drawn from it."""
    root = rng.bit_generator.seed_seq
    assert isinstance(root, np.random.SeedSequence)
    key = int.from_bytes(hashlib.blake2b(repr(identity).encode(), digest_size=8).digest(), "little")
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(root.entropy, spawn_key=(*root.spawn_key, key))))


def placement_of(
    parameters: PlacementParameters,
    site: Site,
    species: Ecologies,
    wanted: PlantingTargets,
    position_m: Floats,
    why: str | Mapping[str, str],
) -> Placement:
    """The plants that found a place; those whose (N, 2) position is nan found none, and a note says how many and `why`.

    `why` is the reason, or one by species; conditions that bar a species on the whole site replace it.
    """
    placed = ~np.isnan(position_m[:, 0])
    asked = np.bincount(wanted.sp, minlength=len(species))
    standing = np.bincount(wanted.sp[placed], minlength=len(species))
    missing = []
    for i, one in enumerate(species):
        if standing[i] < asked[i]:
            reason = None if standing[i] else _bars(parameters, site, one.name)
            reason = reason or (why if isinstance(why, str) else why[one.name])
            missing.append(f"{standing[i]:,} of {asked[i]:,} plants of {one.name} were placed: {reason}")
    return Placement(wanted.sp[placed], position_m[placed], wanted.r_m[placed], wanted.height_m[placed], tuple(missing))


def _bars(parameters: PlacementParameters, site: Site, name: str) -> str | None:
    """What bars a species on the whole site; None: nothing does."""
    shape, keep_out = grid_shape(site, COUNTING_CELLS), parameters.keep_out
    if species_density(parameters, site, name, shape).any():
        return None
    if keep_out is not None and np.all(keep_out.values() > 0):
        return "keep_out bars the whole site"
    conditions = why_barred(parameters.plants[name].conditions, site, shape)
    return conditions or "the map, the conditions and keep_out bar the whole site"


P = TypeVar("P", bound=PlacementParameters)


class PlacementModel(StaticModel[P]):
    """A `CommunityModel` but for its Parameters and either `positions`, or `grid` and `place_species`."""

    missing_reason = "the map and the conditions bar the whole site"  # why plants found no place

    def place(self, parameters: P, site: Site, species: Ecologies, rng: np.random.Generator) -> Placement:
        """The plants that find a place."""
        wanted = wanted_plants(parameters, site, species, rng)
        position_m, why = self.positions(parameters, site, species, wanted, rng)
        return placement_of(parameters, site, species, wanted, position_m, why)

    def positions(
        self, parameters: P, site: Site, species: Ecologies, wanted: PlantingTargets, rng: np.random.Generator
    ) -> tuple[Floats, str | Mapping[str, str]]:
        """(N, 2) places of the plants, metres, nan where there is none; and why, for all or by species.

        Here species do not see each other.
        """
        position_m = np.full((len(wanted.sp), 2), np.nan)
        for index, (one, stream) in enumerate(zip(species, rng.spawn(len(species)), strict=True)):
            mine = np.flatnonzero(wanted.sp == index)
            if len(mine):
                density = species_density(parameters, site, one.name, self.grid(parameters, site, one.name, len(mine)))
                if density.any():
                    position_m[mine] = self.place_species(parameters, site, density, len(mine), stream)
        return position_m, self.missing_reason

    def grid(self, parameters: P, site: Site, name: str, n: int) -> tuple[int, int]:
        """Rows and columns in which the density of a species with n plants is read."""
        raise NotImplementedError

    def place_species(self, parameters: P, site: Site, density: Floats, n: int, rng: np.random.Generator) -> Floats:
        """(n, 2) places of a species, metres, by its (rows, cols) density; nan where there is none."""
        raise NotImplementedError

    def most_plants(self, parameters: P, site: Site, species: Ecologies) -> float:
        """The plants to be placed."""
        return float(plant_counts(parameters, site, species).sum())

    def empty_reason(self, parameters: P, site: Site, species: Ecologies) -> str | None:
        """Why no plant will ever stand there, or None if some may."""
        if planted(parameters.disturbances) > 0:
            return None
        if not parameters.plants:
            return "no plant is placed: community.plants is empty"
        reasons = []
        for name, stand in parameters.plants.items():
            if stand.count or stand.plants_per_ha:
                bars = _bars(parameters, site, name)
                if bars is None and self.expected_plants(parameters, site, species) > 0:
                    return None
                reasons += [f"no plant is placed: of {name}, {bars}"] if bars else []
        return reasons[0] if reasons else "no plant is placed: every number in community.plants is 0, or rounded to 0"

    def estimate_bytes(self, parameters: P, site: Site, species: Ecologies) -> int:
        """Bytes for all plants at once; a plan asks this first, so that wrong sizes are refused here."""
        check_sizes(parameters, species)
        return super().estimate_bytes(parameters, site, species)

    def asked_heights_m(self, parameters: P, site: Site, species: Ecologies) -> Mapping[str, tuple[float, float]]:
        """By the radii that the recipe asks for."""
        return heights_asked_m(parameters, species)

    def densities(self, parameters: P, site: Site, species: Ecologies, placed: Population) -> Densities:
        """What the recipe asks for, for pictures and statistics of the plants `placed` in step 0."""
        return asked_densities(parameters, site, species)


class GriddedParameters(PlacementParameters):
    """The parameters of a model that reads densities on a grid."""

    memory_hint: ClassVar[str] = f"{PlacementParameters.memory_hint}, or fewer community.cells"

    cells: Whole = Field(
        512,
        ge=16,
        le=8192,
        description="cells along the site's longer side in which map and conditions are read; a cell has one density",
    )


G = TypeVar("G", bound=GriddedParameters)


class GriddedModel(PlacementModel[G]):
    """A `PlacementModel` whose densities are constant in the cells of one grid."""

    def grid(self, parameters: G, site: Site, name: str, n: int) -> tuple[int, int]:
        """By the recipe's `cells`."""
        return grid_shape(site, parameters.cells)

    def estimate_bytes(self, parameters: G, site: Site, species: Ecologies) -> int:
        """Bytes for all plants and all grids at once."""
        rows, cols = grid_shape(site, parameters.cells)
        grids = 8 * rows * cols * (_GRIDS_AT_ONCE + len(parameters.plants))
        return super().estimate_bytes(parameters, site, species) + grids


def read_densities(parameters: GriddedParameters, site: Site, species: Ecologies) -> list[Floats]:
    """(rows, cols) relative density of each species, row 0 at y = 0."""
    shape = grid_shape(site, parameters.cells)
    return [species_density(parameters, site, one.name, shape) for one in species]


def density_at(grid: NDArray[_Kind], position_m: Floats, size_m: tuple[float, float]) -> NDArray[_Kind]:
    """(N,) density of the cells in which (N, 2) places of the site lie."""
    rows, cols = grid.shape
    col = np.minimum((position_m[:, 0] * (cols / size_m[0])).astype(np.intp), cols - 1)
    row = np.minimum((position_m[:, 1] * (rows / size_m[1])).astype(np.intp), rows - 1)
    return np.asarray(grid[row, col])


def stays_apart(
    points_m: Floats, distance_m: float, size_m: tuple[float, float], *, periodic: bool
) -> NDArray[np.bool_]:
    """(N,) whether a point stays: it does unless it is nearer than the distance to one before it that stays.

    `points_m` (N, 2) are in [0, W) x [0, H) if `periodic`.
    """
    from scipy.spatial import cKDTree  # slow to import

    keep = np.ones(len(points_m), dtype=np.bool_)
    if len(points_m) < 2:
        return keep
    tree = cKDTree(points_m, boxsize=np.array(size_m) if periodic else None)
    near = tree.query_pairs(np.nextafter(distance_m, 0.0), output_type="ndarray")
    for a, b in near[np.lexsort((near[:, 1], near[:, 0]))].tolist():
        keep[b] = keep[b] and not keep[a]
    return keep
