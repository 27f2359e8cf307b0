"""Stands of the model `stand`, and a plain measure of their cover."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from forestgen.community.model import simulate
from forestgen.community.models.stand import MODEL, StandParameters
from forestgen.community.population import Population, Site

SIZE = (60.0, 50.0)  # metres


def grown(species: Any, given: Mapping[str, Any], seed: int = 1, size_m: tuple[float, float] = SIZE) -> Population:
    (population,) = simulate(MODEL, StandParameters(**given), Site(size_m), species, seed, steps=0)
    return population


def brute_cover(
    population: Population,
    size_m: tuple[float, float],
    cell_m: float = 0.25,
    radius: str = "crown_radius_m",
) -> float:
    """Share of the ground under discs, on a torus, by all distances."""
    x, y = (np.arange(cell_m / 2, side, cell_m) for side in size_m)
    covered = np.zeros((len(y), len(x)), dtype=bool)
    radii_m = population.radius_m if radius == "radius_m" else population.columns[radius]
    for (px, py, _), r in zip(population.position_m, radii_m, strict=True):
        dx, dy = np.abs(x - px), np.abs(y - py)
        dx, dy = np.minimum(dx, size_m[0] - dx), np.minimum(dy, size_m[1] - dy)
        covered |= dx[None] ** 2 + dy[:, None] ** 2 <= r**2
    return float(covered.mean())
