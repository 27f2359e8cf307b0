"""Cloud water as the renderer gets it: extinction, thin air, place, phase."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from forestgen.atmosphere.extinction import (
    MOST_CUT,
    THINNEST_PER_M,
    cloud_grid_of,
    down_to_the_ground,
    droplet_extinction,
    droplet_phase,
    rain_extinction,
    without_thin_air,
)
from forestgen.atmosphere.grid import ROUNDING, AirGrid, Weather
from forestgen.core.errors import RecipeError
from support.error_messages import raises_error

GRID = AirGrid(cells=(6, 5, 8), cell_m=(50.0, 40.0, 25.0), low_m=(0.0, 0.0, 100.0))


def weather_of(cloud: NDArray[np.float32], rain: NDArray[np.float32] | None = None, grid: AirGrid = GRID) -> Weather:
    layers, rows, columns = grid.shape
    zeros = np.zeros(grid.shape, dtype=np.float32)
    return Weather(
        grid=grid,
        time_s=60.0,
        east_m_per_s=np.zeros((layers, rows, columns + 1), dtype=np.float32),
        north_m_per_s=np.zeros((layers, rows + 1, columns), dtype=np.float32),
        up_m_per_s=np.zeros((layers + 1, rows, columns), dtype=np.float32),
        potential_temperature_k=zeros + 290,
        vapour=zeros,
        cloud=cloud,
        rain=zeros if rain is None else rain,
        fallen_kg_per_m2=np.zeros((rows, columns)),
        density_kg_per_m3=np.linspace(1.2, 0.8, layers),
        temperature_ratio=np.ones(layers),
    )


@pytest.fixture
def cloud() -> NDArray[np.float32]:
    """1 g/kg in layers 3 and 4, in a corner of the field."""
    water = np.zeros(GRID.shape, dtype=np.float32)
    water[3:5, 1:3, 2:4] = 1e-3
    return water


def grid_of(weather: Weather, **settings: object):  # type: ignore[no-untyped-def]
    options = {"droplet_radius_um": 10.0, "centre_m": None, **settings}
    return cloud_grid_of(weather, **options)  # type: ignore[arg-type]


def test_droplets_have_twice_their_cross_section() -> None:
    """Of one size: n pi r² times 2."""
    radius, number = 10e-6, 1e8
    water = number * 4 / 3 * np.pi * radius**3 * 1000
    assert droplet_extinction(np.array([water]), 10.0)[0] == pytest.approx(2 * number * np.pi * radius**2, rel=1e-6)


@pytest.mark.parametrize("water", [1e-5, 1e-4, 1e-3])
def test_rain_has_twice_the_cross_section_of_marshall_and_palmers_drops(water: float) -> None:
    """Both moments of the distribution integrated, the slope found from the mass."""
    from scipy.integrate import quad
    from scipy.optimize import brentq

    def moment(slope: float, power: int) -> float:
        return float(quad(lambda s: 8e6 * s**power * np.exp(-s), 0, 60)[0]) / slope ** (power + 1)

    slope = brentq(lambda one: 1000 * np.pi / 6 * moment(one, 3) - water, 100, 50_000)
    assert rain_extinction(np.array([water]))[0] == pytest.approx(2 * np.pi / 4 * moment(slope, 2), rel=1e-4)


def test_the_field_has_the_waters_column(cloud: NDArray[np.float32]) -> None:
    weather = weather_of(cloud)
    grid = grid_of(weather)
    path = weather.cloud_water_kg_per_m3.sum(axis=0) * 25.0
    np.testing.assert_allclose(
        grid.extinction_per_m.sum(axis=0) * grid.cell_m[2], 1.5 * path / (1000 * 10e-6), rtol=1e-5
    )
    assert grid.cell_m == pytest.approx(GRID.cell_m)


def test_rain_is_added_and_is_far_thinner(cloud: NDArray[np.float32]) -> None:
    dry, wet = grid_of(weather_of(cloud)), grid_of(weather_of(cloud, cloud))
    added = wet.extinction_per_m.max() - dry.extinction_per_m.max()
    assert dry.extinction_per_m.max() / 100 < added < dry.extinction_per_m.max() / 40


def test_only_layers_with_clouds_and_one_around_them_are_kept(cloud: NDArray[np.float32]) -> None:
    grid = grid_of(weather_of(cloud))
    assert grid.extinction_per_m.any(axis=(1, 2)).tolist() == [False, True, True, False]
    assert (grid.low_m[2], grid.high_m[2]) == (100 + 2 * 25, 100 + 6 * 25)


def test_fog_reaches_the_ground(cloud: NDArray[np.float32]) -> None:
    fog = np.roll(cloud, -3, axis=0)
    grid = grid_of(weather_of(fog), droplet_radius_um=8.0)
    assert grid.low_m[2] == 100
    assert grid.extinction_per_m[0].any()


def test_clear_air_is_no_grid(cloud: NDArray[np.float32]) -> None:
    assert grid_of(weather_of(np.zeros_like(cloud))) is None


@pytest.mark.parametrize("tiles", [1, 2, 3])
def test_the_middle_is_where_it_was_asked_for(cloud: NDArray[np.float32], tiles: int) -> None:
    grid = grid_of(weather_of(cloud), centre_m=(1000.0, -300.0), tiles=tiles)
    middle = (np.array(grid.low_m) + grid.high_m)[:2] / 2
    np.testing.assert_allclose(middle, [1000, -300])
    assert grid.extinction_per_m.shape[1:] == (5 * tiles, 6 * tiles)
    assert grid.cell_m == pytest.approx(GRID.cell_m)
    one = grid_of(weather_of(cloud)).extinction_per_m
    np.testing.assert_array_equal(grid.extinction_per_m[:, -5:, -6:], one)


def test_thin_air_is_cut_to_zero_and_little_is_lost(cloud: NDArray[np.float32]) -> None:
    thick = droplet_extinction(cloud, 10.0)
    haze = np.where(thick > 0, thick, np.float32(0.3 * THINNEST_PER_M))
    cut, lost = without_thin_air(haze)
    np.testing.assert_array_equal(cut, thick)
    assert 0 < lost <= MOST_CUT
    assert lost == pytest.approx(1 - cut.sum(dtype=float) / haze.sum(dtype=float), rel=1e-4)


def test_a_field_of_thin_air_alone_is_kept() -> None:
    haze = np.random.default_rng(0).uniform(0, THINNEST_PER_M, (9, 9, 9)).astype(np.float32)
    cut, lost = without_thin_air(haze)
    assert 0 < lost <= MOST_CUT
    assert cut.sum(dtype=float) >= (1 - MOST_CUT) * haze.sum(dtype=float)


def test_the_cut_does_not_stop_at_equal_values() -> None:
    even = np.full((4, 4, 4), THINNEST_PER_M / 2, dtype=np.float32)
    cut, lost = without_thin_air(even)
    np.testing.assert_array_equal(cut, even)
    assert lost == 0.0


def test_fog_goes_on_into_the_ground_below_it() -> None:
    extinction = np.zeros((5, 1, 2), dtype=np.float32)
    extinction[3, 0] = [0.02, 0.03]
    solid = np.zeros((5, 1, 2), dtype=bool)
    solid[:3] = True
    filled = down_to_the_ground(extinction, solid)[:, 0]
    np.testing.assert_array_equal(filled[:, 0], np.array([0, 0.02, 0.02, 0.02, 0], dtype=np.float32))
    np.testing.assert_array_equal(filled[:, 1], np.array([0, 0.03, 0.03, 0.03, 0], dtype=np.float32))


def test_the_lobes_have_mies_asymmetry() -> None:
    """At 8 and 15 µm as docs/spectra/make_droplets.py prints it, rising between them; 0.85 to 0.87 is usual."""
    assert droplet_phase(8.0).asymmetry == pytest.approx(0.8598, abs=2e-4)
    assert droplet_phase(15.0).asymmetry == pytest.approx(0.8698, abs=2e-4)
    rising = [droplet_phase(radius).asymmetry for radius in (4, 6, 9, 12, 16, 30)]
    assert rising == sorted(rising)
    assert all(0 < droplet_phase(radius).forward_share < 1 for radius in (4.0, 8.0, 10.0, 15.0, 30.0))


def test_what_cannot_be_shown_is_said(cloud: NDArray[np.float32]) -> None:
    with raises_error(RecipeError, place="sky.clouds"):
        grid_of(weather_of(cloud), tiles=10_000)
    with raises_error(RecipeError, place="sky.clouds"):
        grid_of(weather_of(cloud), droplet_radius_um=0.01)


def test_rounding_below_zero_that_a_file_may_hold_counts_as_nothing(cloud: NDArray[np.float32]) -> None:
    low = np.where(cloud == 0, np.float32(-0.9 * ROUNDING), cloud)
    np.testing.assert_array_equal(
        grid_of(weather_of(low)).extinction_per_m, grid_of(weather_of(cloud)).extinction_per_m
    )
