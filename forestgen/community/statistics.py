"""Numbers that describe a population."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from forestgen.community.model import Site
from forestgen.community.population import Population, Status


def count_by_species(population: Population) -> dict[str, int]:
    """Number of living plants of each species, dominated ones included."""
    alive = population.species[population.status != Status.DEAD]
    counts = np.bincount(alive, minlength=len(population.species_names))
    return {name: int(n) for name, n in zip(population.species_names, counts, strict=True)}


def cover_by_species(population: Population, site: Site) -> dict[str, float]:
    """Share of the site's area under the circles of each species' living, undominated plants.

    Undominated circles never intersect, so these shares are areas of ground and their sum stays below 1 on a periodic
    site. On a bounded site the part of a circle outside counts too. Dominated plants stand below a larger circle and
    would count its ground twice.
    """
    holds = (population.status != Status.DEAD) & (population.status != Status.DOMINATED)
    area_m2 = np.pi * population.radius_m[holds] ** 2
    sums = np.bincount(population.species[holds], weights=area_m2, minlength=len(population.species_names))
    return {name: float(a) / site.area_m2 for name, a in zip(population.species_names, sums, strict=True)}


def hopkins_index(
    points_m: NDArray[np.float64], size_m: tuple[float, float], rng: np.random.Generator, *, samples: int = 10_000
) -> float:
    """Hopkins index H of points in a bounded window: 1 is random, above 1 clustered, below 1 overdispersed.

    H = <a> / <b>: the mean distance from a point of the window to the nearest point of the pattern, over the mean
    distance from a point of the pattern to the nearest other one. <b> takes every point, <a> `samples` points
    stratified over the window. Nothing corrects for edges: they lengthen both means alike.

    Parameters
    ----------
    points_m : (N, 2) float64, metres, in [0, W] x [0, H].
    size_m : W and H.
    rng : places the points of the window.
    samples : least number of them.

    Returns
    -------
    H; nan for fewer than two points; inf where every point coincides with another.

    References
    ----------
    Lane 2002, section 2.4 and Figure 2.3.
    """
    if len(points_m) < 2:
        return float("nan")
    tree = cKDTree(points_m)
    nx = max(1, int(np.ceil(np.sqrt(samples * size_m[0] / size_m[1]))))
    ny = max(1, int(np.ceil(samples / nx)))
    cell = np.stack(np.meshgrid(np.arange(nx), np.arange(ny)), axis=-1).reshape(-1, 2)
    window = (cell + rng.random(cell.shape)) * (size_m[0] / nx, size_m[1] / ny)
    a = float(np.mean(tree.query(window)[0]))
    b = float(np.mean(np.asarray(tree.query(points_m, k=2)[0])[:, 1]))
    return a / b if b > 0 else float("inf")
