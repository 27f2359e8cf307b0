"""The ground of a map of heights."""

from __future__ import annotations

import numpy as np
import pytest

from forestgen.scene.terrain import HORIZON_M, terrain_mesh
from forestgen.scene.terrains.mapped import mapped

SIZE_M = (100.0, 75.0)


def middles(rows: int, cols: int) -> tuple[np.ndarray, np.ndarray]:
    """World x and y of cells, the northern row first."""
    x, y = (np.arange(cols) + 0.5) / cols * SIZE_M[0], (np.arange(rows) + 0.5) / rows * SIZE_M[1]
    return np.meshgrid(x, y[::-1])


@pytest.mark.parametrize(("rows", "cols"), [(2, 2), (3, 2), (30, 40)])
def test_a_plane_stays_a_plane_up_to_the_edges(rows: int, cols: int) -> None:
    x, y = middles(rows, cols)
    field = mapped(SIZE_M, 3 + 0.2 * x - 0.1 * y)
    x, y = np.random.default_rng(1).random((2, 500)) * np.array(SIZE_M)[:, None]
    np.testing.assert_allclose(field(x, y), 3 + 0.2 * x - 0.1 * y, atol=1e-12)


def test_it_goes_through_every_cell_and_has_no_kinks() -> None:
    heights = np.random.default_rng(2).random((30, 40))
    field = mapped(SIZE_M, heights)
    np.testing.assert_allclose(field(*middles(30, 40)), heights, atol=1e-12)
    x, d = np.linspace(1, 99, 4001), 1e-5
    slope = (field(x + d, 0 * x + 33.3) - field(x - d, 0 * x + 33.3)) / (2 * d)
    assert np.abs(np.diff(slope)).max() < 0.02 * np.ptp(slope)


def test_beyond_the_site_it_goes_over_into_a_plain() -> None:
    heights = np.random.default_rng(3).random((30, 40))
    field = mapped(SIZE_M, heights)
    y = np.array([20.0])
    assert field(np.array([-1e-9]), y) == pytest.approx(field(np.array([0.0]), y), abs=1e-6)
    far = field(np.array([-150.0, 1e4, 300.0]), np.array([20.0, -3e3, 75.0]))
    assert np.ptp(far) == 0
    assert 0.2 < far[0] < 0.8
    mesh = terrain_mesh(field)
    assert np.isfinite(mesh.vertices_m).all()
    assert mesh.vertices_m[:, 0].max() >= HORIZON_M
