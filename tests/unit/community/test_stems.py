"""Stems as a forester counts them: living plants over breast height."""

from __future__ import annotations

import numpy as np

from forestgen.community.population import Population, Status, stems_by_species


def test_stems_live_and_are_higher_than_a_breast() -> None:
    height_m = np.array([1.3, 1.31, 20.0, 20.0, 0.1])
    n = len(height_m)
    population = Population(
        time_yr=0,
        species_names=("oak", "pine", "rare"),
        plant_id=np.arange(1, n + 1, dtype=np.uint32),
        species=np.array([0, 0, 1, 1, 1], dtype=np.uint16),
        position_m=np.zeros((n, 3)),
        radius_m=np.ones(n),
        height_m=height_m,
        age_yr=np.ones(n),
        status=np.array([0, Status.DOMINATED, Status.DEAD, Status.MATURE, 0], dtype=np.uint8),
    )
    assert stems_by_species(population) == {"oak": 1, "pine": 1, "rare": 0}
