"""Stands of the model `stand`, and a plain measure of their cover."""

from __future__ import annotations

import numpy as np

from forestgen.community.model import simulate
from forestgen.community.models.stand import MODEL, StandParameters
from forestgen.community.population import Site

SIZE = (60.0, 50.0)  # metres


def grown(species, given, seed=1, size_m=SIZE):
    (population,) = simulate(MODEL, StandParameters(**given), Site(size_m), species, seed, steps=0)
    return population


def brute_cover(population, size_m, cell_m=0.25, radius="crown_radius_m"):
    """Share of the ground under discs, on a torus, by all distances."""
    x, y = (np.arange(cell_m / 2, side, cell_m) for side in size_m)
    covered = np.zeros((len(y), len(x)), dtype=bool)
    radii_m = population.radius_m if radius == "radius_m" else population.columns[radius]
    for (px, py, _), r in zip(population.position_m, radii_m, strict=True):
        dx, dy = np.abs(x - px), np.abs(y - py)
        dx, dy = np.minimum(dx, size_m[0] - dx), np.minimum(dy, size_m[1] - dy)
        covered |= dx[None] ** 2 + dy[:, None] ** 2 <= r**2
    return covered.mean()
