"""Vegetation as a density: uniform states, thresholds, growth of waves, patterns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from forestgen.community.soil_water import Ground, SoilWaterParameters, Water
from support.field_measures import FieldMeasures, measure_field
from support.vegetation_water import PlantParameters, Vegetation, VegetationWater, bare_state, grown_state

SOIL, PLANTS = SoilWaterParameters(), PlantParameters()
SMALL = Ground((6.0, 6.0), (2, 2), periodic=True)
SIZE_M = (150.0, 150.0)
FIELD = Ground(SIZE_M, (50, 50), periodic=True)


def test_the_published_uniform_state() -> None:
    """W* = k1 / (c g / d - 1) = 5 mm; bare below R = r W* = 1 mm a day."""
    state = grown_state(SOIL, PLANTS, 1.4)
    assert state is not None
    assert state.soil_mm == pytest.approx(5.0)
    assert state.plants_g_per_m2 == pytest.approx(16.0)
    assert state.surface_mm == pytest.approx(1.4 / (0.2 * 17 / 21))
    assert grown_state(SOIL, PLANTS, 1.0) is None
    assert grown_state(SOIL, PLANTS, 1.0001) is not None
    assert grown_state(SOIL, replace(PLANTS, mortality_per_day=0.5), 9.0) is None
    bare = bare_state(SOIL, 1.4)
    assert (bare.plants_g_per_m2, bare.soil_mm, bare.surface_mm) == pytest.approx((0.0, 7.0, 35.0))


@pytest.mark.parametrize("step_days", [0.1, 1.0, 3.0])
def test_a_uniform_state_stays_whatever_the_step(step_days: float) -> None:
    model = VegetationWater(SMALL)
    for state in (grown_state(SOIL, PLANTS, 1.4), bare_state(SOIL, 1.4)):
        assert state is not None
        after = model.advance(model.of(state), 300.0, rain_mm_per_day=1.4, step_days=step_days)
        for got, want in zip(_maps(after), _maps(model.of(state)), strict=True):
            assert got == pytest.approx(want, rel=1e-10)


@pytest.mark.parametrize(("rain", "left"), [(0.9, 0.0), (0.98, 0.0), (1.05, 2.0), (2.0, 40.0), (3.0, 80.0)])
def test_the_same_everywhere_plants_live_where_rain_passes_the_threshold(rain: float, left: float) -> None:
    model = VegetationWater(SMALL)
    start = Vegetation(np.full((2, 2), 5.0), Water(np.full((2, 2), 4.0), np.full((2, 2), 4.0)))
    after = model.advance(start, 6000.0, rain_mm_per_day=rain, step_days=2.0)
    assert after.plants_g_per_m2 == pytest.approx(np.full((2, 2), left), abs=1e-3)


@pytest.mark.parametrize(("wavelength_m", "rain"), [(20.0, 1.2), (48.0, 1.2), (48.0, 1.6), (150.0, 1.2)])
def test_a_faint_wave_grows_as_the_linearised_equations_have_it(wavelength_m: float, rain: float) -> None:
    state = grown_state(SOIL, PLANTS, rain)
    assert state is not None
    p, w = state.plants_g_per_m2, state.soil_mm
    drink, more = 0.05 * w / (w + 5), 0.05 * 5 / (w + 5) ** 2
    sinks = 0.2 * (p + 1) / (p + 5)
    richer = 0.2 * 4 / (p + 5) ** 2 * state.surface_mm
    jacobian = np.array(
        [
            [10 * drink - 0.25, 10 * more * p, 0.0],
            [richer - drink, -more * p - 0.2, sinks],
            [-richer, 0.0, -sinks],
        ]
    )
    cells = 64
    number = 2 * np.sin(np.pi / cells) * cells / wavelength_m  # as the grid sees it
    jacobian -= number**2 * np.diag([0.1, 0.1, 100.0])
    rates, shapes = np.linalg.eig(jacobian)
    fastest = int(np.argmax(rates.real))
    wave = 1e-5 * np.cos(2 * np.pi * (np.arange(cells) + 0.5) / cells)[None, :]
    shape = shapes[:, fastest].real / shapes[0, fastest].real
    model = VegetationWater(Ground((wavelength_m, 1.0), (1, cells), periodic=True))
    start = Vegetation(p + shape[0] * wave, Water(w + shape[1] * wave, state.surface_mm + shape[2] * wave))
    after = model.advance(start, 40.0, rain_mm_per_day=rain, step_days=0.05)
    grown = np.log(np.ptp(after.plants_g_per_m2) / np.ptp(wave)) / 40.0
    assert grown == pytest.approx(rates.real[fastest], rel=0.03, abs=2e-5)


def test_a_step_is_of_first_order() -> None:
    model = VegetationWater(Ground((48.0, 48.0), (12, 12), periodic=True))
    start = model.sown(np.random.default_rng(0), 1.2, share=0.3, g_per_m2=20.0)

    def after(step: float) -> np.ndarray:
        return model.advance(start, 8.0, rain_mm_per_day=1.2, step_days=step).plants_g_per_m2

    best = after(1 / 128)
    errors = [abs(after(step) - best).max() for step in (0.5, 0.25, 0.125)]
    assert np.log2(np.divide(errors[:-1], errors[1:])) == pytest.approx(1.0, abs=0.25)


def pattern(rain: float, seed: int, *, ground: Ground = FIELD, years: float = 7.0) -> FieldMeasures:
    model = VegetationWater(ground)
    start = model.sown(np.random.default_rng(seed), rain, share=0.2, g_per_m2=20.0)
    after = model.advance(start, 365.0 * years, rain_mm_per_day=rain, step_days=2.0)
    return measure_field(after.plants_g_per_m2, SIZE_M, threshold=1.0, periodic=ground.periodic)


def test_more_rain_makes_spots_of_bare_ground_then_gaps_then_cover() -> None:
    bare, spots, gaps, full = (pattern(rain, 0) for rain in (0.5, 0.75, 1.2, 1.5))
    assert bare.cover == 0
    assert 0.2 < spots.cover < 0.6
    assert spots.skewness > 0.5
    assert spots.islands > 4
    assert spots.lakes == 0
    assert 0.7 < gaps.cover < 0.98
    assert gaps.skewness < -0.5
    assert gaps.lakes > 4
    assert gaps.islands <= 2
    assert full.cover == 1
    assert full.contrast < 0.01
    assert bare.mean < spots.mean < gaps.mean < full.mean


def test_closed_edges_have_patterns_too() -> None:
    spots = pattern(0.75, 1, ground=Ground(SIZE_M, (50, 50)))
    assert spots.islands > 4
    assert spots.lakes == 0


def test_without_the_spreading_of_water_there_is_no_pattern() -> None:
    ground = Ground(SIZE_M, (30, 30), periodic=True)
    model = VegetationWater(ground, replace(SOIL, surface_diffusion_m2_per_day=0.1))
    state = grown_state(SOIL, PLANTS, 1.2)
    assert state is not None
    start = model.of(state)
    stirred = start.plants_g_per_m2 * (1 + 0.1 * np.random.default_rng(0).standard_normal(ground.shape))
    after = model.advance(replace(start, plants_g_per_m2=stirred), 2000.0, rain_mm_per_day=1.2, step_days=2.0)
    assert np.ptp(after.plants_g_per_m2) < 0.01 * state.plants_g_per_m2


@pytest.mark.slow
@pytest.mark.parametrize("rain", [0.75, 1.0, 1.2])
def test_a_pattern_stays_for_500_years(rain: float) -> None:
    young, old = (pattern(rain, 0, years=years) for years in (25.0, 500.0))
    assert old.cover == pytest.approx(young.cover, abs=0.05)
    assert old.skewness == pytest.approx(young.skewness, abs=0.3)
    assert old.waves.wavelength_m == pytest.approx(young.waves.wavelength_m, rel=0.2)


def _maps(state: Vegetation) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return state.plants_g_per_m2, state.water.soil_mm, state.water.surface_mm
