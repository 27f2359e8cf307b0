"""Plants for the scene's tests."""

from __future__ import annotations

import numpy as np

from forestgen.community.population import Population


def population(count: int, rng: np.random.Generator) -> Population:
    return Population(
        time_yr=0.0,
        species_names=("a",),
        plant_id=(np.arange(count) * 3 + 5).astype(np.uint32),
        species=np.zeros(count, np.uint16),
        position_m=rng.random((count, 3)) * [50, 50, 2],
        radius_m=rng.random(count) + 0.1,
        height_m=rng.random(count) * 20 + 0.1,
        age_yr=np.zeros(count),
        status=np.zeros(count, np.uint8),
    )
