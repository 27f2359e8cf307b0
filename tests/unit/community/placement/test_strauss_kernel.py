"""The chain of the Strauss process on many plants: lists that the kernel itself makes outlive its calls."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from forestgen.community.models.strauss import _sweep


def test_a_sweep_of_a_hard_core_brings_no_two_plants_nearer() -> None:
    rng, n, radius = np.random.default_rng(0), 100_000, 0.1
    at, cells = rng.random((n, 2)) * 100, (632, 632)
    before = cKDTree(at).count_neighbors(cKDTree(at), radius) - n
    for _ in range(3):
        old = at.copy()
        to = rng.random((n, 2)) * 100
        _sweep(at, to, rng.random(n), False, np.ones((10, 10)), cells, (100.0, 100.0), 0.0, radius, False)
        moved = np.any(at != old, axis=1)
        assert moved.any()
        assert not moved.all()
        np.testing.assert_array_equal(at[moved], to[moved])
    after = cKDTree(at).count_neighbors(cKDTree(at), radius) - n
    assert after < before
