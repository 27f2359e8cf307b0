"""Numbers that describe a population: what there is of each species. Modules beside this tell of places and sizes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from forestgen.community.model import Site
from forestgen.community.point_patterns import SAMPLES, Window, hopkins, measure_distances
from forestgen.community.population import Population, Status
from forestgen.core.frames import BREAST_HEIGHT_M


def count_by_species(population: Population) -> dict[str, int]:
    """Number of living plants of each species, dominated ones included."""
    alive = population.species[population.status != Status.DEAD]
    counts = np.bincount(alive, minlength=len(population.species_names))
    return {name: int(n) for name, n in zip(population.species_names, counts, strict=True)}


def stems_by_species(population: Population) -> dict[str, int]:
    """Number of living plants of each species that are higher than `BREAST_HEIGHT_M`: what a forester counts."""
    stems = population.species[(population.status != Status.DEAD) & (population.height_m > BREAST_HEIGHT_M)]
    counts = np.bincount(stems, minlength=len(population.species_names))
    return {name: int(n) for name, n in zip(population.species_names, counts, strict=True)}


def shares(counts: Mapping[str, float]) -> dict[str, float]:
    """Each species' share of a sum, such as that of all plants; zeros where there is nothing to share."""
    total = sum(counts.values())
    return {name: n / total if total else 0.0 for name, n in counts.items()}


def cover_by_species(population: Population, site: Site) -> dict[str, float]:
    """Share of the site's area under the circles of each species' living, undominated plants.

    Under the environment of domination undominated circles never intersect, so these shares are areas of ground and
    their sum stays below 1 on a periodic site. Under others circles overlap, and shared ground counts for each: the sum
    may exceed 1. On a bounded site the part of a circle outside counts too. Dominated plants are left out.
    """
    holds = (population.status != Status.DEAD) & (population.status != Status.DOMINATED)
    area_m2 = np.pi * population.radius_m[holds] ** 2
    sums = np.bincount(population.species[holds], weights=area_m2, minlength=len(population.species_names))
    return {name: float(a) / site.area_m2 for name, a in zip(population.species_names, sums, strict=True)}


def plant_mass(population: Population) -> tuple[NDArray[np.float64], str]:
    """(N,) mass of each plant, and its unit.

    The model's own column ``mass_kg`` where it has one, else r^3 in cubic metres: plants of one shape have masses in
    proportion to the cube of their radius (Lane 2002, section 4.3).
    """
    if "mass_kg" in population.columns:
        return np.asarray(population.columns["mass_kg"], dtype=np.float64), "kg"
    return population.radius_m**3, "m³"


def hopkins_index(
    points_m: NDArray[np.float64],
    size_m: tuple[float, float],
    rng: np.random.Generator,
    *,
    samples: int = SAMPLES,
) -> float:
    """`point_patterns.hopkins` of points in [0, W] x [0, H]; nan for fewer than two points."""
    if len(points_m) < 2:
        return float("nan")
    window = Window(0.0, size_m[0], 0.0, size_m[1])
    return hopkins(measure_distances(points_m, window, rng, samples=samples)).value
