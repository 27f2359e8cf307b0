"""Maps between ground and air: means stay, places stay."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from forestgen.atmosphere.grid import AirGrid
from forestgen.community.ecoclimate.air import AreaRegridder
from forestgen.community.soil_water import Ground

sides = st.floats(20.0, 900.0)
counts = st.integers(1, 13)


def air_of(cells: tuple[int, int], box_m: tuple[float, float]) -> AirGrid:
    return AirGrid((*cells, 4), (box_m[0] / cells[0], box_m[1] / cells[1], 50.0))


@given(width=sides, depth=sides, rows=counts, cols=counts, cells=st.tuples(counts, counts), seed=st.integers(0, 99))
def test_a_ground_that_fills_the_box_keeps_its_mean_both_ways(width, depth, rows, cols, cells, seed) -> None:
    ground = Ground((width, depth), (rows, cols))
    maps = AreaRegridder(ground, air_of(cells, (width, depth)))
    rng = np.random.default_rng(seed)
    values, others = rng.random((rows, cols)), rng.random(cells[::-1])
    assert maps.for_air(values).mean() == pytest.approx(values.mean(), rel=1e-5)
    assert maps.for_ground(others).mean() == pytest.approx(others.mean(), rel=1e-9)


@given(width=sides, depth=sides, rows=counts, cols=counts, box=st.floats(900.0, 5000.0), seed=st.integers(0, 99))
def test_around_a_smaller_ground_it_is_as_in_its_mean(width, depth, rows, cols, box, seed) -> None:
    ground = Ground((width, depth), (rows, cols))
    maps = AreaRegridder(ground, air_of((12, 10), (box, box)))
    values = np.random.default_rng(seed).random((rows, cols))
    there = maps.for_air(values)
    assert there.mean() == pytest.approx(values.mean(), rel=1e-5)
    far = maps.to_air[0].sum(axis=1) == 0
    assert np.allclose(there[far], values.mean(), rtol=1e-6)
    assert np.allclose(maps.for_ground(np.full((10, 12), 3.5)), 3.5, rtol=1e-12)


def test_cells_that_fit_are_handed_over_as_they_are() -> None:
    ground = Ground((60.0, 40.0), (4, 6))
    values = np.arange(24.0).reshape(4, 6)
    maps = AreaRegridder(ground, air_of((3, 2), (60.0, 40.0)))
    np.testing.assert_allclose(maps.for_air(values), values.reshape(2, 2, 3, 2).mean(axis=(1, 3)), rtol=1e-6)
    np.testing.assert_allclose(
        maps.for_ground(np.arange(6.0).reshape(2, 3)), np.kron(np.arange(6.0).reshape(2, 3), np.ones((2, 2)))
    )


def test_a_small_ground_in_the_middle_of_a_cell_sees_that_cell() -> None:
    ground = Ground((10.0, 10.0), (2, 2))
    other = np.zeros((3, 3))
    other[1, 1] = 7.0
    maps = AreaRegridder(ground, air_of((3, 3), (300.0, 300.0)))
    np.testing.assert_allclose(maps.for_ground(other), 7.0)


@given(width=sides, depth=sides, rows=counts, cols=counts, box=st.floats(900.0, 5000.0), seed=st.integers(0, 99))
def test_around_a_smaller_ground_heights_are_those_of_its_edge(width, depth, rows, cols, box, seed) -> None:
    ground = Ground((width, depth), (rows, cols))
    maps = AreaRegridder(ground, air_of((12, 10), (box, box)))
    height = np.random.default_rng(seed).random((rows, cols)) * 300.0
    there = maps.heights_for_air(height)
    assert there.min() >= height.min() - 1e-9
    assert there.max() <= height.max() + 1e-9
    west, south = maps.to_air[1].sum(axis=1) == 0, maps.to_air[0].sum(axis=1) == 0
    if west[0] and south[0]:
        assert there[0, 0] == pytest.approx(height[0, 0])
        assert np.allclose(there[south][: (south[:5]).sum()], there[0])
    np.testing.assert_allclose(maps.heights_for_air(np.full((rows, cols), 7.0)), 7.0, rtol=1e-12)


def test_a_ridge_that_leaves_the_ground_goes_on_in_the_air() -> None:
    ground = Ground((60.0, 20.0), (2, 6))
    ridge = np.tile([0.0, 5.0, 9.0, 8.0, 4.0, 1.0], (2, 1))
    there = AreaRegridder(ground, air_of((10, 10), (100.0, 100.0))).heights_for_air(ridge)
    np.testing.assert_allclose(there, np.tile([0, 0, 0, 5, 9, 8, 4, 1, 1, 1], (10, 1)), atol=1e-12)
