"""The soil model: water balances, nothing negative, exact cases, order, bad input."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from forestgen.community import soil_water
from forestgen.community.population import Site
from forestgen.community.soil_water import Ground, Passed, SoilWater, SoilWaterParameters, Water
from forestgen.core import threads

PUBLISHED = SoilWaterParameters()
FLAT = Ground((30.0, 20.0), (20, 30))


def dry(soil: SoilWater) -> Water:
    """No water anywhere."""
    return Water(np.zeros(soil.ground.shape), np.zeros(soil.ground.shape))


def valley(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return 0.02 * (x - 50.0) ** 2 / 5 + 0.01 * y


def some(ground: Ground, seed: int) -> tuple[Water, np.ndarray, np.ndarray]:
    """Water, plants and rain that differ from cell to cell, with many zeros."""
    rng = np.random.default_rng(seed)
    maps = [np.where(rng.random(ground.shape) < 0.5, 0.0, 10 ** rng.uniform(-6, 2.5, ground.shape)) for _ in range(4)]
    return Water(maps[0], maps[1]), maps[2], maps[3]


@pytest.mark.parametrize(
    "ground",
    [
        FLAT,
        Ground((30.0, 20.0), (20, 30), periodic=True, gradient=(0.01, 0.2)),
        Ground.of_site(Site((100.0, 60.0), valley), 3.0, periodic=False),
    ],
    ids=["flat", "hillside", "valley"],
)
@pytest.mark.parametrize(("days", "substep_days"), [(30.4, 0.5), (1e-4, 0.5), (1e4, 1e4)])
def test_rain_is_stored_drunk_or_lost(ground: Ground, days: float, substep_days: float) -> None:
    for seed in range(3):
        water, plants, rain = some(ground, seed)
        soil = SoilWater(ground)
        passed = soil.advance(water, days, plants_g_per_m2=plants, rain_mm_per_day=rain, substep_days=substep_days)
        budget = passed.budget
        stored_mm = passed.water.soil_mm.mean() + passed.water.surface_mm.mean()
        left_mm = budget.uptake_mm + budget.loss_mm
        assert abs(stored_mm + left_mm - budget.rain_mm - budget.start_mm) < 1e-12 * (budget.start_mm + budget.rain_mm)
        assert budget.uptake_mm == pytest.approx(passed.uptake_mm.mean())
        assert budget.loss_mm == pytest.approx(passed.loss_mm.mean())
        for field in (passed.water.soil_mm, passed.water.surface_mm, passed.uptake_mm, passed.loss_mm):
            assert np.isfinite(field).all()
            assert field.min() >= 0
        assert (passed.uptake_mm[plants == 0] == 0).all()


def of_one_cell(parameters: SoilWaterParameters, days: float, plants: float, rain: float, **more: float) -> Passed:
    soil = SoilWater(Ground((1.0, 1.0), (1, 1)), parameters)
    start = Water(np.array([[7.0]]), np.array([[3.0]]))
    return soil.advance(start, days, plants_g_per_m2=plants, rain_mm_per_day=rain, **more)


def test_without_plants_it_is_two_leaking_buckets() -> None:
    """dO/dt = R - f O, dW/dt = f O - r W, solved on paper."""
    rain, days = 1.5, 8.0
    f, r = PUBLISHED.infiltration_per_day * PUBLISHED.bare_infiltration, PUBLISHED.loss_per_day
    high, a = rain / f, 3.0 - rain / f
    surface = high + a * np.exp(-f * days)
    soil = rain / r + a * f / (r - f) * np.exp(-f * days)
    soil += (7.0 - rain / r - a * f / (r - f)) * np.exp(-r * days)
    errors = []
    for substep in (1.0, 0.5, 0.25):
        water = of_one_cell(PUBLISHED, days, 0.0, rain, substep_days=substep).water
        assert water.surface_mm[0, 0] == pytest.approx(surface, rel=1e-13)
        errors.append(abs(water.soil_mm[0, 0] - soil))
    assert errors[-1] < 1e-3
    assert np.log2(np.divide(errors[:-1], errors[1:])) == pytest.approx(2.0, abs=0.1)


def test_a_dry_spell_is_exact() -> None:
    sealed = replace(PUBLISHED, infiltration_per_day=0.0)
    passed = of_one_cell(sealed, 12.0, 0.0, 0.0)
    assert passed.water.surface_mm[0, 0] == 3.0
    assert passed.water.soil_mm[0, 0] == pytest.approx(7.0 * np.exp(-0.2 * 12.0), rel=1e-13)
    assert passed.loss_mm[0, 0] == pytest.approx(7.0 * -np.expm1(-0.2 * 12.0), rel=1e-13)
    tight = replace(sealed, loss_per_day=0.0)
    assert of_one_cell(tight, 12.0, 0.0, 0.0).water.soil_mm[0, 0] == 7.0


def test_sub_steps_are_of_second_order() -> None:
    ground = Ground((40.0, 40.0), (20, 20), periodic=True)
    x, y = np.meshgrid(np.arange(20), np.arange(20))
    plants = 10 + 9 * np.sin(2 * np.pi * x / 20) * np.cos(2 * np.pi * y / 20)
    start = Water(5 + 0.4 * plants, 9 - 0.4 * plants)
    soil = SoilWater(ground)

    def after(substep: float) -> np.ndarray:
        passed = soil.advance(start, 6.0, plants_g_per_m2=plants, rain_mm_per_day=1.0, substep_days=substep)
        return np.stack([passed.water.soil_mm, passed.water.surface_mm])

    best = after(1 / 256)
    errors = [abs(after(substep) - best).max() for substep in (0.5, 1 / 8, 1 / 16, 1 / 32)]
    assert np.log2(np.divide(errors[1:-1], errors[2:])).min() > 1.8
    assert errors[0] < 0.012 * best.max()  # the default, where a wave of 40 m spreads twice over in a sub-step


def test_plants_improve_infiltration_and_slopes_lessen_it() -> None:
    def left(plants: float, slope: float) -> float:
        ground = Ground((9.0, 9.0), (3, 3), periodic=True, gradient=(slope, 0.0))
        start = Water(np.zeros((3, 3)), np.full((3, 3), 10.0))
        passed = SoilWater(ground).advance(start, 1.0, plants_g_per_m2=plants, rain_mm_per_day=0.0)
        return float(passed.water.surface_mm.mean())

    assert left(0.0, 0.0) == pytest.approx(10 * np.exp(-0.2 * 0.2))
    assert left(5.0, 0.0) == pytest.approx(10 * np.exp(-0.2 * 0.6))
    assert left(1e9, 0.0) == pytest.approx(10 * np.exp(-0.2))
    assert left(1e9, 1.0) == pytest.approx(10 * np.exp(-0.1))
    assert left(0.0, 0.0) > left(3.0, 0.0) > left(30.0, 0.0)
    assert left(3.0, 0.0) < left(3.0, 0.2) < left(3.0, 2.0)


def test_dense_plants_leave_no_water_and_a_long_sub_step_agrees() -> None:
    """A forest's ten kilograms: 500 mm a day could be drunk, the rain is."""
    results = [of_one_cell(PUBLISHED, 60.0, 1e4, 2.0, substep_days=one) for one in (0.5, 0.01)]
    for passed in results:
        assert passed.water.soil_mm[0, 0] < 0.1
        assert passed.loss_mm[0, 0] < 0.01 * passed.uptake_mm[0, 0]
    assert results[0].uptake_mm == pytest.approx(results[1].uptake_mm, rel=1e-3)


def test_valleys_are_wet() -> None:
    ground = Ground.of_site(Site((100.0, 60.0), valley), 2.0, periodic=False)
    soil = SoilWater(ground)
    wet = soil.advance(dry(soil), 120.0, plants_g_per_m2=5.0, rain_mm_per_day=1.0).water
    level = SoilWater(Ground((100.0, 60.0), ground.shape))
    even = level.advance(dry(level), 120.0, plants_g_per_m2=5.0, rain_mm_per_day=1.0).water
    across = wet.soil_mm.mean(axis=0)
    assert across[25] > 2 * across[2]
    assert across == pytest.approx(across[::-1], rel=1e-6)  # the valley is symmetric
    assert np.ptp(even.soil_mm) < 1e-9


def test_rain_may_be_a_map() -> None:
    ground = Ground((40.0, 40.0), (10, 10))
    still = SoilWaterParameters(surface_diffusion_m2_per_day=0.0, soil_diffusion_m2_per_day=0.0)
    rain = np.zeros((10, 10))
    rain[2, 3] = 4.0
    soil = SoilWater(ground, still)
    passed = soil.advance(dry(soil), 10.0, plants_g_per_m2=0.0, rain_mm_per_day=rain)
    assert passed.water.surface_mm[2, 3] > 0
    assert passed.water.surface_mm.sum() == passed.water.surface_mm[2, 3]
    assert passed.budget.rain_mm == pytest.approx(0.4)


def test_threads_change_no_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    ground = Ground.of_site(Site((500.0, 500.0), valley), 1.5, periodic=False)
    water, plants, rain = some(ground, 0)
    results = []
    for count in (1, 3):
        monkeypatch.setattr(threads, "cores", lambda count=count: count)
        monkeypatch.setattr(soil_water, "cores", lambda count=count: count)
        passed = SoilWater(ground).advance(water, 1.0, plants_g_per_m2=plants, rain_mm_per_day=rain)
        maps = (passed.water.soil_mm, passed.water.surface_mm, passed.uptake_mm, passed.loss_mm)
        results.append([one.tobytes() for one in maps])
    assert results[0] == results[1]


def test_a_site_becomes_a_ground() -> None:
    ground = Ground.of_site(Site((100.0, 60.0), valley), 1.5, periodic=False)
    assert ground.shape == (40, 67)
    assert ground.height_m is not None
    x, y = 100.0 * 10.5 / 67, 60.0 * 3.5 / 40
    assert ground.height_m[3, 10] == pytest.approx(valley(np.array(x), np.array(y)))
