"""The chain of the Strauss process on many plants: lists that the kernel itself makes outlive its calls."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from forestgen.community.models.strauss import StraussParameters, relax
from forestgen.community.population import Site


def test_sweeps_of_a_hard_core_bring_no_two_plants_nearer() -> None:
    rng, n, radius = np.random.default_rng(0), 100_000, 0.1
    at = rng.random((n, 2)) * 100
    old, before = at.copy(), cKDTree(at).count_neighbors(cKDTree(at), radius) - n
    parameters = StraussParameters(gamma=0.0, sweeps=3, periodic=False)
    relax(at, np.ones((10, 10)), Site((100.0, 100.0)), parameters, radius, rng)
    moved = np.any(at != old, axis=1)
    assert moved.any()
    assert not moved.all()
    assert np.all((at >= 0) & (at < 100))
    after = cKDTree(at).count_neighbors(cKDTree(at), radius) - n
    assert after < before
