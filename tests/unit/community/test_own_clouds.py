"""The air over a community as its clouds: what the next month of the simulation would see, or a refusal beforehand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from forestgen.atmosphere.clouds.source import CloudRequest, cloud_source_of
from forestgen.atmosphere.extinction import cloud_grid_of
from forestgen.atmosphere.grid import Weather
from forestgen.community.capabilities import OwnAir, capability
from forestgen.community.ecoclimate import months
from forestgen.community.ecoclimate.air import AreaRegridder
from forestgen.community.population import Population
from forestgen.community.simulation import final_population
from forestgen.core.errors import RecipeError
from forestgen.core.progress import Silent, Timings
from forestgen.recipe.load import load_recipe
from forestgen.scene.build import build_scene
from forestgen.scene.plan import Plan, estimate_bytes, make_plan
from support.error_messages import raises_error

RECIPE = """\
forestgen: 1
site: {size_m: [60, 45]}
species: {shrub: }
community:
  model: ecoclimate
  climate: {place: Juneau}
  steps: 5
  initial_plants: 3
  soil_water: {cell_m: 15}
  weather: {hours: 0.5, extent_m: 800, cell_m: 100, height_m: 1200, cell_height_m: 100, mixed_layer_m: 300,
    inversion_m: 900, relative_humidity: 0.86, relative_humidity_aloft: 0.9, wind_m_per_s: 0}
sky: {clouds: {type: community}}
cameras: [{position_m: [30, -5, 2], size_px: [24, 16]}]
"""


@pytest.fixture(scope="module", autouse=True)
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("own")


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FORESTGEN_CACHE", str(tmp_path / "cache"))


def plan(folder: Path, *overrides: str) -> Plan:
    (folder / "recipe.yaml").write_text(RECIPE)
    return make_plan(load_recipe(folder / "recipe.yaml", overrides).draw(0))


@pytest.fixture(scope="module")
def population(folder: Path) -> Population:
    return final_population(plan(folder).community, Silent())


def own_weather(of: Plan, population: Population) -> Weather:
    air = capability(of.community.model, OwnAir)
    assert air is not None
    return air.air(of.community, population, Silent())


def giving(population: Population, mm_per_day: float) -> Population:
    vapour = np.full_like(population.maps["vapour_mm_per_day"], mm_per_day)
    return replace(population, maps={**population.maps, "vapour_mm_per_day": vapour})


@pytest.mark.parametrize(
    "overrides",
    [
        ["community={model: forest_footprints}"],
        ["community.weather=null"],
        ["community.changes=[{at_yr: 0.2, set: {weather: null}}]"],
        ["sky.clouds.time_s=0"],
        ["sky.clouds.cell_m=400"],
        ["community.weather.extent_m=40000", "sky.clouds.cell_m=10"],
        ["sky.clouds.offset_m=[3, 4]"],
        ["sky.clouds.wind_m_per_s=3"],
        ["sky.clouds={type: cumulus, cell_m: 50}"],
    ],
)
def test_what_cannot_be_is_told_before_anything_is_simulated(folder: Path, overrides: Sequence[str]) -> None:
    with raises_error(RecipeError):
        plan(folder, *overrides)


def test_weather_may_begin_by_a_change(folder: Path) -> None:
    weather = "{hours: 0.5, extent_m: 800, cell_m: 100, height_m: 2400}"
    late = f"community.changes=[{{at_yr: 0.2, set: {{weather: {weather}}}}}]"
    assert estimate_bytes(plan(folder, "community.weather=null", late))["clouds"] > 0


@pytest.mark.slow
def test_it_is_the_air_that_the_next_month_sees(
    folder: Path, population: Population, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The simulation's own month, watched while it goes one step on."""
    one, seen = plan(folder), []
    of, image_seed, whole = one.community, one.drawn.image_seed, months.month_of_air
    monkeypatch.setattr(months, "month_of_air", lambda *given: seen.append((given, whole(*given))) or seen[-1][1])
    state = of.model.resume(of.parameters, of.site, of.ecologies, image_seed, population)
    of.model.step(state)
    ((section, month, number, given), sky) = seen[0]
    assert number == 5
    case = months.air_over(state, section, 0)
    hours = months.hours_of(section, case.grid, case.day, case.surface)
    over_the_site = AreaRegridder(given.ground, case.grid).for_ground(hours.condensed_kg_per_m2)
    assert over_the_site.mean() == pytest.approx(sky.condensed_kg_per_m2, rel=1e-12)
    shown = own_weather(one, population)
    assert shown.cloud.tobytes() == hours.weather.cloud.tobytes()
    assert shown.rain.tobytes() == hours.weather.rain.tobytes()
    assert np.array_equal(given.vapour_mm_per_day, population.maps["vapour_mm_per_day"])
    assert (month.temperature_c, given.wind_from_deg, given.seed) == (
        pytest.approx(13.0, abs=3),
        of.site.wind_from_deg,
        image_seed,
    )


def test_a_forest_has_more_clouds_than_bare_ground(folder: Path, population: Population) -> None:
    of = plan(folder)
    bare, forest = (own_weather(of, giving(population, one)) for one in (0.0, 6.0))
    assert forest.cloud.sum() > 1.1 * bare.cloud.sum() > 0


@pytest.mark.slow
def test_it_is_simulated_once_and_found_again_to_the_bit(
    folder: Path, population: Population, monkeypatch: pytest.MonkeyPatch
) -> None:
    of, calls = plan(folder), []
    hours_of = months.hours_of
    monkeypatch.setattr(months, "hours_of", lambda *given: calls.append(1) or hours_of(*given))
    first, again = (own_weather(of, population) for _ in range(2))
    assert len(calls) == 1
    assert all(np.array_equal(getattr(first, name), getattr(again, name)) for name in ("cloud", "rain", "vapour"))
    monkeypatch.setenv("FORESTGEN_CACHE", "")
    assert own_weather(of, population).cloud.tobytes() == first.cloud.tobytes()
    others = (["sky.clouds.day=1"], ["sky.clouds.cell_m=80"], ["sky.clouds.time_s=1200"])
    for other in others:
        drawn = own_weather(plan(folder, *other), population)
        assert drawn.cloud.tobytes() != first.cloud.tobytes()
    assert drawn.time_s == 1200.0


def test_the_scene_has_the_clouds_of_that_air_and_nothing_else(folder: Path, population: Population) -> None:
    """What is lit and what the label of cloud opacity measures is one grid: the scene's."""
    of = plan(folder, "sky.clouds.droplet_radius_um=8")
    wet = giving(population, 6.0)
    spec = build_scene(of, wet, Silent(), Timings()).spec
    weather = own_weather(of, wet)
    wanted = cloud_grid_of(weather, centre_m=(30.0, 22.5), droplet_radius_um=8.0, tiles=7)
    assert spec.clouds is not None
    assert wanted is not None
    assert np.array_equal(spec.clouds.extinction_per_m, wanted.extinction_per_m)
    assert (spec.clouds.low_m, spec.clouds.high_m) == (wanted.low_m, wanted.high_m)
    single = plan(folder, "sky.clouds.repeat=false")
    alone = cloud_source_of(single.drawn).grid(CloudRequest(single.drawn, 5.0, Silent(), single.community, wet))
    assert alone is not None
    assert alone.low_m[:2] == pytest.approx((30.0 - 400.0, 22.5 - 400.0))
    assert alone.low_m[2] == pytest.approx(wanted.low_m[2] + 5.0)
