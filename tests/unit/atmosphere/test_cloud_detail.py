"""Clouds within the cells of their grid: the water, the edge, the spectrum, and what must not show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from forestgen.atmosphere import billows
from forestgen.atmosphere.billows import detail_of
from forestgen.atmosphere.cloud_detail import EMPTY, FULL, NO_DETAIL, SUB
from forestgen.atmosphere.grid import CloudGrid
from forestgen.atmosphere.optical_depth import distance_to_depth, optical_depth

CELL_M = (75.0, 75.0, 62.5)
UP = np.array([0.0, 0.0, 1.0])


def cumulus() -> np.ndarray:
    """(Z, Y, X) extinction of three clouds with flat bases, one across the border, whose water grows upwards."""
    z, y, x = np.meshgrid(np.arange(48), np.arange(96), np.arange(96), indexing="ij")  # quarters of a cell
    inside = np.zeros(z.shape, bool)
    for at_x, at_y, size in ((30, 40, 20.0), (66, 20, 14.0), (94, 70, 22.0)):
        off_x = (x - at_x + 48) % 96 - 48
        inside |= (off_x**2 + (y - at_y) ** 2 + (1.3 * (z - 14)) ** 2 < size**2) & (z >= 10)
    fine = np.where(inside, 0.012 * (z - 9) / 4 + 0.02, 0.0)
    return fine.reshape(12, 4, 24, 4, 24, 4).mean(axis=(1, 3, 5)).astype(np.float32)


@pytest.fixture(scope="module")
def clouds() -> CloudGrid:
    """The same, with detail, twice beside one another along x."""
    mean = cumulus()
    inside, detail = made(mean)
    twice = (1, 1, 2)
    detail = detail._replace(brick=np.tile(detail.brick, twice))
    high = (48 * CELL_M[0], 24 * CELL_M[1], 12 * CELL_M[2])
    grid = CloudGrid(np.tile(mean, twice), (0.0, 0.0, 0.0), high)
    return replace(grid, full_per_m=np.tile(inside, twice), detail=detail)


def made(mean: np.ndarray):
    return detail_of(mean, np.zeros(mean.shape, bool), CELL_M, periodic=True)


@pytest.fixture(scope="module", autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FORESTGEN_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


def depth_upwards(clouds: CloudGrid, x_m: np.ndarray, y_m: np.ndarray) -> np.ndarray:
    origin = np.stack([x_m, y_m, np.full(x_m.shape, -10.0)], axis=-1)
    return optical_depth(clouds, origin, np.broadcast_to(UP, origin.shape), np.inf)


def test_columns_keep_their_water(clouds: CloudGrid) -> None:
    """By rays at other places than those at which the water was counted."""
    each, rng = 24, np.random.default_rng(5)
    x, y = np.meshgrid(np.arange(24 * each), np.arange(24 * each))
    x, y = (one + rng.random(one.shape) / each for one in (x / each, y / each))
    depth = depth_upwards(clouds, x * CELL_M[0], y * CELL_M[1])
    found = depth.reshape(24, each, 24, each).mean(axis=(1, 3))
    wanted = clouds.extinction_per_m[:, :, :24].sum(axis=0) * CELL_M[2]
    assert found.mean() == pytest.approx(wanted.mean(), rel=2e-3)
    cloudy = wanted > 1.0
    assert cloudy.sum() > 100
    error = np.abs(found / np.maximum(wanted, 1e-9) - 1.0)[cloudy]
    assert np.quantile(error, 0.95) < 0.02


def test_the_spectrum_of_optical_depth_goes_on_below_the_cells(clouds: CloudGrid) -> None:
    step_m = 75.0 / 32
    x, y = np.meshgrid((np.arange(768) + 0.5) * step_m, (np.arange(96) + 0.5) * 8 * step_m)
    depth = depth_upwards(clouds, x, y)
    power = (np.abs(np.fft.rfft(depth, axis=1)) ** 2).mean(axis=0)
    wavelength = 1800.0 / np.maximum(np.arange(len(power)), 1)
    below = (wavelength < 75.0) & (wavelength > 10.0)
    slope = np.polyfit(np.log(1.0 / wavelength[below]), np.log(power[below]), 1)[0]
    assert -3.0 < slope < -5.0 / 3.0
    coarse = depth_upwards(replace(clouds, full_per_m=None, detail=NO_DETAIL), x, y)
    lost = (np.abs(np.fft.rfft(coarse, axis=1)) ** 2).mean(axis=0)
    assert lost[below].sum() < 0.1 * power[below].sum()


def test_the_edge_is_some_metres_wide(clouds: CloudGrid) -> None:
    """From clear air to the inside's extinction along a level line; a cell of the grid is 75 m."""
    step_m, z_m = 1.0, 5.5 * CELL_M[2]
    x = np.arange(0.0, 1800.0, step_m)
    origin = np.stack([x, np.full(x.shape, 10 * CELL_M[1]), np.full(x.shape, z_m)], axis=-1)
    east = np.broadcast_to([1.0, 0.0, 0.0], origin.shape)
    here = optical_depth(clouds, origin, east, step_m)
    rising = np.flatnonzero((here[:-8] < 0.1 * here.max()) & (here[8:] > 0.6 * here.max()))
    assert len(rising) > 0


def test_the_same_clouds_have_the_same_detail_and_keep_it(monkeypatch: pytest.MonkeyPatch, clouds: CloudGrid) -> None:
    mean = cumulus()
    billows._kept.clear()
    inside, kept = made(mean)  # from the disk
    billows._kept.clear()
    monkeypatch.setenv("FORESTGEN_CACHE", "")
    again, fresh = made(mean)
    np.testing.assert_array_equal(inside, again)
    for one, other in zip(kept, fresh, strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_periodic_field_has_no_seam(clouds: CloudGrid) -> None:
    detail = clouds.detail
    first, last = detail.brick[:, :, 24], detail.brick[:, :, 23]
    both = (first >= 0) & (last >= 0)
    assert both.sum() > 5
    near, far = detail.depth[first[both]][..., 0], detail.depth[last[both]][..., SUB]
    assert np.abs(near.astype(int) - far).max() <= 1
    x, y = np.meshgrid(np.linspace(100.0, 1700.0, 60), np.linspace(100.0, 1700.0, 50))
    here, beyond = depth_upwards(clouds, x, y), depth_upwards(clouds, x + 1800.0, y)
    np.testing.assert_allclose(here, beyond, rtol=1e-6, atol=1e-9)


def test_bases_are_flatter_than_tops(clouds: CloudGrid) -> None:
    """The lowest and the highest place of the cloud over each place of the middle of the first one."""
    x, y = np.meshgrid(np.linspace(500.0, 640.0, 40), np.linspace(690.0, 820.0, 40))
    z = np.arange(0.0, 750.0, 4.0)
    inside = np.stack([depth_upwards_to(clouds, x, y, at) for at in z])
    grown = np.diff(inside, axis=0) > 1e-4
    base, top = np.argmax(grown, axis=0) * 4.0, (len(grown) - np.argmax(grown[::-1], axis=0)) * 4.0
    assert grown.any(axis=0).all()
    assert base.std() < 0.5 * top.std()


def depth_upwards_to(clouds: CloudGrid, x_m: np.ndarray, y_m: np.ndarray, z_m: float) -> np.ndarray:
    origin = np.stack([x_m, y_m, np.full(x_m.shape, -10.0)], axis=-1)
    return optical_depth(clouds, origin, np.broadcast_to(UP, origin.shape), z_m + 10.0)


def test_the_place_at_an_optical_depth_is_where_the_integral_has_it(clouds: CloudGrid) -> None:
    x, y = np.meshgrid(np.linspace(400.0, 1400.0, 40), np.linspace(400.0, 1400.0, 40))
    origin = np.stack([x, y, np.full(x.shape, -10.0)], axis=-1)
    up = np.broadcast_to(UP, origin.shape)
    distance = distance_to_depth(clouds, origin, up, 0.7)
    met = np.isfinite(distance)
    whole = optical_depth(clouds, origin, up, np.inf)
    assert ((whole > 0.72)[~met]).sum() == 0
    assert met.sum() > 100
    step_m = CELL_M[2] / 16
    at = optical_depth(clouds, origin[met], up[met], distance[met] + 0.5 * step_m)
    before = optical_depth(clouds, origin[met], up[met], distance[met] - 2.0 * step_m)
    assert np.quantile(at, 0.02) > 0.65
    assert np.quantile(before, 0.98) < 0.75


def test_rain_gets_no_edge() -> None:
    mean = np.zeros((6, 8, 8), np.float32)
    mean[1:4, 2:6, 2:6] = 1e-3
    _, detail = detail_of(mean, mean > 0, CELL_M, periodic=True)
    assert not len(detail.depth)
    assert (detail.brick[mean > 0] == FULL).all()
    assert (detail.brick[:, 0, 0] == EMPTY).all()
