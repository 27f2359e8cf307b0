"""Densities as they were asked for, beside the plants that were placed: what pictures and statistics are made of."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from forestgen.community.ecology import SpeciesEcology
from forestgen.community.model import Site
from forestgen.community.placement.densities import COUNTING_CELLS, grid_shape, plant_counts, species_density
from forestgen.community.placement.field import DensityField
from forestgen.community.placement.kernels import KernelTable
from forestgen.community.placement.stands import PlacementParameters
from forestgen.community.population import Population

_FEWEST_EXPECTED = 5.0  # of a bin: below, chi-square's distribution is not that of the table
_MOST_BLOCKS = 256


@dataclass(frozen=True)
class Densities:
    """Densities of the species that a recipe places; every grid is (rows, cols), row 0 at y = 0, column 0 at x = 0."""

    asked: Mapping[str, int]  # how many plants
    asked_per_ha: Mapping[str, NDArray[np.float64]]  # map times conditions, scaled to that number; plants per hectare
    barred: NDArray[np.bool_] | None = None  # where the recipe keeps plants out, at any resolution
    left_per_ha: Mapping[str, NDArray[np.float64]] | None = None  # the same times the kernels of all plants


def asked_densities(
    parameters: PlacementParameters, site: Site, species: Sequence[SpeciesEcology], shape: tuple[int, int] | None = None
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
    species: Sequence[SpeciesEcology],
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
        for first, last in _runs(placed.species):
            kernel = kernels[affected][int(placed.species[first])]
            if not kernel.is_neutral:
                field.deform(placed.position_m[first:last, :2], placed.radius_m[first:last], kernel)
        left[one.name] = np.asarray(field.cells)
    return Densities(asked.asked, asked.asked_per_ha, asked.barred, left)


def _runs(species: NDArray[np.integer]) -> list[tuple[int, int]]:
    """First and one behind the last of each run of plants of one species."""
    edges = np.flatnonzero(np.diff(species)) + 1
    ends = [0, *edges.tolist(), len(species)]
    return [(a, b) for a, b in itertools.pairwise(ends) if b > a]


@dataclass(frozen=True)
class ChiSquare:
    """Pearson's test of counts in bins against what was to be expected there."""

    statistic: float
    degrees_of_freedom: int
    p_value: float  # of independent plants; clusters make it small where no kernel is balanced


def counts_against(
    asked: NDArray[np.float64], position_m: NDArray[np.float64], size_m: tuple[float, float]
) -> ChiSquare | None:
    """Whether (N, 2) plants follow a density in coarse bins; None for too few plants to fill two bins.

    The site is divided into nearly square blocks, about one for each ten plants and about 256 at most. Blocks in which
    fewer than five plants are expected are put together with the next, row by row, back and forth. The density is
    scaled to the number of plants that there are, so a bin's worth of freedom is lost.

    Parameters
    ----------
    asked : (rows, cols) density in any unit, row 0 at y = 0.
    """
    n, total = len(position_m), float(asked.sum())
    if n < 2 * _FEWEST_EXPECTED or total <= 0:
        return None
    rows, cols = asked.shape
    width, height = size_m
    across = max(1, round(math.sqrt(min(_MOST_BLOCKS, max(4, n / 10)) * width / height)))
    up = max(1, round(math.sqrt(min(_MOST_BLOCKS, max(4, n / 10)) * height / width)))
    row_block, col_block = (np.arange(rows) * up) // rows, (np.arange(cols) * across) // cols
    block = row_block[:, None] * across + np.where(row_block[:, None] % 2, across - 1 - col_block, col_block)
    col = np.clip((position_m[:, 0] / width * cols).astype(np.intp), 0, cols - 1)
    row = np.clip((position_m[:, 1] / height * rows).astype(np.intp), 0, rows - 1)
    found = np.bincount(block[row, col], minlength=up * across).astype(np.float64)
    expected = np.bincount(block.ravel(), weights=asked.ravel(), minlength=up * across) * (n / total)
    return _pearson(*_joined(found, expected))


def _joined(
    found: NDArray[np.floating], expected: NDArray[np.floating]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
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


def _pearson(found: NDArray[np.float64], expected: NDArray[np.float64]) -> ChiSquare | None:
    freedom = len(found) - 1
    if freedom < 1:
        return None
    statistic = float(np.sum((found - expected) ** 2 / expected))
    return ChiSquare(statistic, freedom, float(chdtrc(freedom, statistic)))


def describe_densities(densities: Densities, placed: Population, site: Site) -> dict[str, dict[str, Any]]:
    """By species, plain as in JSON: how many were asked for and stand, and whether they follow the density."""
    described: dict[str, dict[str, Any]] = {}
    for name, asked in densities.asked.items():
        points_m = placed.position_m[placed.species == placed.species_names.index(name), :2]
        test = counts_against(densities.asked_per_ha[name], points_m, site.size_m)
        described[name] = {
            "asked": asked,
            "placed": len(points_m),
            "chi_square": asdict(test) if test is not None else None,
        }
    return described
