"""The projection: no divergence, nothing through walls, nothing changed that had none."""

import numpy as np
import pytest

from forestgen.atmosphere.fluid import momentum
from forestgen.atmosphere.fluid.momentum import Pressure
from forestgen.atmosphere.fluid.parameters import UnstableError
from forestgen.atmosphere.grid import AirGrid

CELLS, CELL_M = (16, 12, 10), (50.0, 40.0, 30.0)


def projected(solid=None, seed=0):
    grid = AirGrid(CELLS, CELL_M)
    pressure = Pressure(grid, solid)
    rng = np.random.default_rng(seed)
    velocity = tuple(rng.normal(0, 3, tuple(n + 4 for n in grid.shape)).astype(np.float32) for _ in range(3))
    pressure.set_sides(velocity)
    before = [field.copy() for field in velocity]
    pressure.project(velocity)
    return velocity, before


def divergence(velocity):
    u, v, w = (field.astype(float) for field in velocity)
    x, y, z = CELL_M
    inner = slice(2, -2)
    return (
        np.diff(u[inner, inner, 2:-1], axis=2) / x
        + np.diff(v[inner, 2:-1, inner], axis=1) / y
        + np.diff(w[2:-1, inner, inner], axis=0) / z
    )


def hill():
    solid = np.zeros(CELLS[::-1], bool)
    solid[:4, 3:7, 5:9] = True
    solid[:2, 6:9, 1:12] = True
    return solid


@pytest.mark.parametrize("solid", [None, hill()])
def test_divergence_falls_to_rounding(solid):
    velocity, before = projected(solid)
    assert abs(divergence(before)).max() > 0.3
    assert abs(divergence(velocity)).max() < (2e-6 if solid is None else 5e-6)


def test_projecting_twice_is_projecting_once():
    velocity, _ = projected()
    again = tuple(field.copy() for field in velocity)
    Pressure(AirGrid(CELLS, CELL_M), None).project(again)
    inner = (slice(2, -2),) * 3
    for one, two in zip(velocity, again, strict=True):
        np.testing.assert_allclose(one[inner], two[inner], atol=1e-5)


def test_walls_and_terrain_are_shut():
    solid = hill()
    (u, v, w), _ = projected(solid)
    assert (w[2] == 0).all()
    assert (w[-2] == 0).all()
    inner = slice(2, -2)
    for low, high in ((u[inner, inner, 2:-2], u[inner, inner, 3:-1]), (v[inner, 2:-2, inner], v[inner, 3:-1, inner])):
        assert not low[solid].any()
        assert not high[solid].any()
    assert not w[3:-1, inner, inner][solid].any()


def test_ghosts_of_ground_and_ceiling():
    (u, _, w), _ = projected()
    np.testing.assert_array_equal(u[1], u[2])
    np.testing.assert_array_equal(u[-2], u[-3])  # free slip
    np.testing.assert_array_equal(w[1], -w[3])


def test_what_does_not_converge_is_told(monkeypatch):
    projected(hill())
    monkeypatch.setattr(momentum, "_MOST_ITERATIONS", 2)
    with pytest.raises(UnstableError, match=r"after 2 iterations a divergence of \S+ 1/s is left"):
        projected(hill())
    projected()  # over flat ground there is nothing to iterate
