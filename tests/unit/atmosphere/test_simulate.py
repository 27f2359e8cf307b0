"""Scenarios: kept and resumed to the last bit, phases that change the air, and the clouds that each type makes."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from dataclasses import astuple, replace
from pathlib import Path

import numpy as np
import pytest

from forestgen.atmosphere import simulate as module
from forestgen.atmosphere.clouds.source import CloudStatistics, cloud_statistics
from forestgen.atmosphere.conditions import Conditions, Domain, Emission
from forestgen.atmosphere.grid import AirGrid, Weather
from forestgen.atmosphere.simulate import Scenario, WeatherPhase, emission_pattern, regridded, simulate
from forestgen.core.cache import DiskCache
from forestgen.core.progress import Silent
from forestgen.recipe.registries import CLOUD_SOURCES
from support.soundings import check_sounding

SMALL = Domain(extent_m=2400.0, height_m=3000.0, cell_m=300.0, cell_height_m=250.0)


def small(kind: str = "cumulus", domain: Domain = SMALL) -> Conditions:
    return replace(CLOUD_SOURCES.load(kind).conditions, domain=domain)


def scenario(*phases: WeatherPhase) -> Scenario:
    return Scenario(phases or (WeatherPhase(0.0, small()),))


def run(one: Scenario, until_s: float, kept: DiskCache | None = None, seed: int = 1) -> Weather:
    return simulate(one, seed=seed, until_s=until_s, progress=Silent(), kept=kept)


def same(one: Weather, other: Weather) -> bool:
    pairs = zip(astuple(one), astuple(other), strict=True)
    return all(np.array_equal(a, b) if isinstance(a, np.ndarray) else a == b for a, b in pairs)


@pytest.fixture
def store(tmp_path: Path) -> DiskCache:
    return DiskCache(tmp_path / "weather", 10**9)


@pytest.fixture
def steps(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The time at which each run of the solver begins."""
    begun: list[float] = []
    own = module.Air.run

    def counted(air: module.Air, weather: Weather, until_s: float) -> Weather:
        begun.append(weather.time_s)
        return own(air, weather, until_s)

    monkeypatch.setattr(module.Air, "run", counted)
    return begun


def test_the_same_weather_is_found_and_not_simulated_again(store: DiskCache, steps: list[float]) -> None:
    first = run(scenario(), 150.0, store)
    assert steps == [0.0, 60.0, 120.0]
    again = run(scenario(), 150.0, store)
    assert len(steps) == 3
    assert same(first, again)


@pytest.mark.parametrize(
    "other",
    [
        {"seed": 2},
        {"until_s": 151.0},
        {"scenario": scenario(WeatherPhase(0.0, replace(small(), cooling_k_per_h=0.1)))},
        {"scenario": scenario(WeatherPhase(0.0, replace(small(), emission=Emission(1.0, 2.0, 300.0, 0.1))))},
    ],
)
def test_other_weather_is_not_mistaken_for_it(store: DiskCache, steps: list[float], other: dict) -> None:
    run(scenario(), 150.0, store)
    made = len(steps)
    run(other.get("scenario", scenario()), other.get("until_s", 150.0), store, other.get("seed", 1))
    assert len(steps) > made


def test_a_later_time_goes_on_from_an_earlier_one_with_the_same_bytes(store: DiskCache, steps: list[float]) -> None:
    straight = run(scenario(), 260.0)
    del steps[:]
    run(scenario(), 140.0, store)
    assert steps == [0.0, 60.0, 120.0]
    resumed = run(scenario(), 260.0, store)
    assert steps[3:] == [120.0, 180.0, 240.0]  # from the last mark, not from 140 s
    assert same(straight, resumed)


def test_an_interrupted_simulation_goes_on_with_the_same_bytes(
    store: DiskCache, monkeypatch: pytest.MonkeyPatch
) -> None:
    straight = run(scenario(), 200.0)
    own = module.Air.run

    def interrupted(air: module.Air, weather: Weather, until_s: float) -> Weather:
        if weather.time_s >= 120.0:
            raise KeyboardInterrupt
        return own(air, weather, until_s)

    monkeypatch.setattr(module.Air, "run", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run(scenario(), 200.0, store)
    begun: list[float] = []
    monkeypatch.setattr(
        module.Air, "run", lambda air, weather, until_s: begun.append(weather.time_s) or own(air, weather, until_s)
    )
    assert same(straight, run(scenario(), 200.0, store))
    assert begun == [120.0, 180.0]


@pytest.mark.parametrize("until_s", [180.0, 200.0])
@pytest.mark.parametrize("every_s", [0.0, 1e9])
def test_the_last_mark_and_the_last_state_stay_however_often_it_was_kept_on_the_way(
    until_s: float, every_s: float, store: DiskCache, steps: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "EVERY_S", every_s)
    first = run(scenario(), until_s, store)
    assert store.size_bytes()[0] == (1 if until_s == 180.0 else 2)  # and no marks before
    del steps[:]
    assert same(first, run(scenario(), until_s, store))
    assert steps == []
    run(scenario(), 240.0, store)
    assert steps == [180.0]


@pytest.mark.parametrize("every_s", [0.0, 1e9])
def test_what_was_reached_before_an_interruption_stays(
    every_s: float, store: DiskCache, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "EVERY_S", every_s)
    own = module.Air.run
    begun: list[float] = []

    def interrupted(air: module.Air, weather: Weather, until_s: float) -> Weather:
        begun.append(weather.time_s)
        if weather.time_s >= 120.0 and len(begun) == 3:
            raise KeyboardInterrupt
        return own(air, weather, until_s)

    monkeypatch.setattr(module.Air, "run", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run(scenario(), 180.0, store)
    run(scenario(), 180.0, store)
    assert begun == [0.0, 60.0, 120.0, 120.0]


def test_a_mark_is_removed_only_after_a_later_one_is_written(store: DiskCache, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "EVERY_S", 0.0)
    happened: list[str] = []
    write, drop = DiskCache.write, DiskCache.drop

    def full(self: DiskCache, key: str, data: bytes) -> bool:
        happened.append("write")
        return happened.count("write") < 3 and write(self, key, data)  # then the disk is full

    def seen(self: DiskCache, key: str) -> None:
        happened.append("drop")
        drop(self, key)

    monkeypatch.setattr(DiskCache, "write", full)
    monkeypatch.setattr(DiskCache, "drop", seen)
    run(scenario(), 180.0, store)  # marks at 0, 60, 120 and 180 s
    assert happened[:4] == ["write", "write", "drop", "write"]
    assert happened.count("drop") == 1
    assert store.size_bytes()[0] == 1  # that at 60 s


def test_weather_is_known_by_all_code_that_it_is_made_with() -> None:
    program = (
        "import sys\nfrom forestgen.core.cache import source_files\n"
        "from forestgen.atmosphere.simulate import SOURCES\nknown = set(map(str, source_files(SOURCES)))\n"
        "own = {one.__file__ for name, one in sys.modules.items() if name.startswith('forestgen.')}\n"
        "print(*sorted(one for one in own - known if not one.endswith('__init__.py')))"
    )
    found = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert found.stdout.split() == []


def test_a_damaged_entry_is_made_again(store: DiskCache, steps: list[float]) -> None:
    first = run(scenario(), 60.0, store)
    (entry,) = store.folder.iterdir()
    entry.write_bytes(entry.read_bytes()[:-100])
    assert same(first, run(scenario(), 60.0, store))
    assert steps == [0.0, 0.0]


def test_a_story_is_the_same_in_one_go_and_phase_by_phase(store: DiskCache) -> None:
    larger = Domain(4800.0, 4000.0, 600.0, 400.0)
    story = scenario(WeatherPhase(0.0, small("stratus")), WeatherPhase(130.0, small("cumulus", larger), 300.0))
    straight = run(story, 200.0)
    assert straight.grid == larger.grid()
    for until_s in (60.0, 130.0, 200.0):
        last = run(story, until_s, store)
    assert same(straight, last)
    assert run(story, 129.0).grid == SMALL.grid()


def test_later_phases_do_not_change_earlier_weather(store: DiskCache, steps: list[float]) -> None:
    one, two = (scenario(WeatherPhase(0.0, small()), WeatherPhase(120.0, small(kind))) for kind in ("stratus", "fog"))
    first = run(one, 100.0, store)
    del steps[:]
    assert same(first, run(two, 100.0, store))
    assert steps == []


def test_the_mean_air_becomes_that_of_the_new_sounding() -> None:
    quiet = Emission(0.0, 0.0, 1000.0, 0.0)
    first = replace(small("stratus"), emission=quiet, cooling_k_per_h=0.0)
    second = replace(small("cumulus"), emission=quiet)
    story = scenario(WeatherPhase(0.0, first), WeatherPhase(60.0, second, change_s=100.0))
    height = SMALL.grid().layer_heights_m
    target = second.sounding().potential_temperature_at(height)

    def apart_k(weather: Weather) -> float:
        return float(np.abs(weather.potential_temperature_k.mean(axis=(1, 2)) - target).max())

    before, after = apart_k(run(story, 60.0)), apart_k(run(story, 360.0))
    assert before > 5.0
    assert after == pytest.approx(before * np.exp(-3.0), rel=0.25)


def test_the_air_cools_below_the_inversion_by_what_is_said() -> None:
    quiet = replace(small(), emission=Emission(0.0, 0.0, 500.0, 0.0), cooling_k_per_h=3.6)
    still, cooled = (
        run(scenario(WeatherPhase(0.0, one)), 120.0) for one in (replace(quiet, cooling_k_per_h=0.0), quiet)
    )
    change = (cooled.potential_temperature_k - still.potential_temperature_k).mean(axis=(1, 2))
    change *= cooled.temperature_ratio  # of the temperature itself
    low = cooled.grid.layer_heights_m < 1200.0
    np.testing.assert_allclose(change[low], -0.12, atol=0.01)
    np.testing.assert_allclose(change[cooled.grid.layer_heights_m > 2600.0], 0.0, atol=0.01)


def test_patches_have_their_size_mean_and_contrast() -> None:
    grid = AirGrid((128, 128, 8), (50.0, 50.0, 100.0))
    pattern = emission_pattern(Emission(1, 1, 400.0, 0.2), grid, np.random.default_rng(3))
    assert pattern.mean() == pytest.approx(1.0, abs=1e-5)
    assert pattern.std() == pytest.approx(0.2, rel=0.02)
    power = np.abs(np.fft.fft2(pattern - 1.0)) ** 2
    k = np.hypot(*np.meshgrid(np.fft.fftfreq(128, 50.0), np.fft.fftfreq(128, 50.0)))
    assert (power * k).sum() / power.sum() == pytest.approx(1 / 800.0, rel=0.2)  # a warm and a cool patch a wave
    assert emission_pattern(Emission(1, 1, 400.0, 5.0), grid, np.random.default_rng(3)).min() == 0.0


def test_one_large_patch_lies_in_the_middle() -> None:
    grid = AirGrid((32, 32, 8), (100.0, 100.0, 100.0))
    for seed in range(5):
        pattern = emission_pattern(Emission(1, 1, 2000.0, 1.0), grid, np.random.default_rng(seed))
        assert np.unravel_index(int(pattern.argmax()), pattern.shape) == (16, 16)


def test_a_map_of_emission_keeps_its_place() -> None:
    values = np.zeros((4, 4), np.float32)
    values[0, 3] = 8.0  # south-east
    grid = AirGrid((16, 16, 8), (100.0, 100.0, 100.0))
    pattern = emission_pattern(Emission(1, 1, 100.0, 0.0, values), grid, np.random.default_rng(0))
    assert pattern.mean() == pytest.approx(1.0, abs=1e-6)
    assert pattern[:4, 12:].mean() > 8.0
    assert pattern[8:].max() == 0.0


def fields(grid: AirGrid, **given: np.ndarray) -> Weather:
    z, y, x = grid.shape
    zeros = {
        "east_m_per_s": np.zeros((z, y, x + 1), np.float32),
        "north_m_per_s": np.zeros((z, y + 1, x), np.float32),
        "up_m_per_s": np.zeros((z + 1, y, x), np.float32),
        **{name: np.zeros((z, y, x), np.float32) for name in ("potential_temperature_k", "vapour", "cloud", "rain")},
        "fallen_kg_per_m2": np.zeros((y, x)),
        "density_kg_per_m3": np.full(z, 1.0),
        "temperature_ratio": np.full(z, 1.0),
    }
    return Weather(grid, 0.0, **{**zeros, **given})


def test_regridding_keeps_what_is_linear_upwards_and_periodic_sideways() -> None:
    old = AirGrid((24, 24, 20), (100.0, 100.0, 50.0), (-1200.0, -1200.0, 0.0))
    new = AirGrid((32, 16, 24), (150.0, 300.0, 100.0), (-2400.0, -2400.0, 0.0))

    def made(grid: AirGrid) -> Weather:
        x = grid.low_m[0] + (np.arange(grid.cells[0]) + 0.5) * grid.cell_m[0]
        faces = grid.low_m[0] + np.arange(grid.cells[0] + 1) * grid.cell_m[0]
        theta = 300.0 + 0.01 * grid.layer_heights_m[:, None, None] + np.zeros(grid.shape)
        wave = np.cos(2 * np.pi * x / 2400.0) + np.zeros(grid.shape)
        wind = np.sin(2 * np.pi * faces / 2400.0) + np.zeros((*grid.shape[:2], grid.cells[0] + 1))
        return fields(
            grid,
            potential_temperature_k=theta.astype(np.float32),
            vapour=wave.astype(np.float32),
            east_m_per_s=wind.astype(np.float32),
        )

    got, wanted = regridded(made(old), made(new)), made(new)
    below = (new.layer_heights_m > 100.0) & (new.layer_heights_m < 900.0)  # the smoothing sees no end of the box
    for name, tolerance in (("potential_temperature_k", 3e-3), ("vapour", 0.05), ("east_m_per_s", 0.06)):
        np.testing.assert_allclose(getattr(got, name)[below], getattr(wanted, name)[below], atol=tolerance)
    np.testing.assert_array_equal(got.east_m_per_s[below, :, 0], got.east_m_per_s[below, :, -1])
    above = new.layer_heights_m > 1000.0
    np.testing.assert_array_equal(got.potential_temperature_k[above], wanted.potential_temperature_k[above])


def test_statistics_of_a_box_of_cloud() -> None:
    grid = AirGrid((10, 10, 20), (100.0, 100.0, 50.0), (0.0, 0.0, 200.0))
    cloud, rain, up = np.zeros(grid.shape, np.float32), np.zeros(grid.shape, np.float32), np.zeros((21, 10, 10))
    cloud[4:10, :4, :5] = 1e-3  # 400 to 700 m, a fifth of the columns
    cloud[15:, 9, 9] = 9e-6  # too thin to count
    rain[:4, 0, 0] = 1e-3
    up[7, 3, 3] = 2.5
    found = cloud_statistics(
        fields(grid, cloud=cloud, rain=rain, up_m_per_s=up.astype(np.float32), fallen_kg_per_m2=np.full((10, 10), 3.0)),
        droplet_radius_um=15.0,
    )
    path = 1e-3 * 300.0
    assert (found.cover, found.base_m, found.top_m) == pytest.approx((0.2, 400.0, 700.0))
    assert (found.mean_base_m, found.mean_top_m) == pytest.approx((400.0, 700.0))
    assert found.cloud_kg_per_m2 == pytest.approx(0.2 * path + 9e-6 * 250.0 / 100, rel=1e-5)
    assert found.rain_kg_per_m2 == pytest.approx(1e-3 * 200.0 / 100)
    assert found.optical_depth == pytest.approx(1.5 * path / (1000 * 15e-6), rel=1e-5)
    assert (found.fallen_kg_per_m2, found.updraught_m_per_s) == pytest.approx((3.0, 2.5))
    none = cloud_statistics(fields(grid))
    assert (none.cover, none.base_m, none.top_m, none.optical_depth) == (0.0, None, None, 0.0)


@pytest.mark.parametrize("kind", ["fog", "stratus", "stratocumulus", "cumulus", "cumulonimbus"])
def test_each_type_begins_with_air_that_can_be(kind: str) -> None:
    conditions = CLOUD_SOURCES.load(kind).conditions
    check_sounding(conditions.sounding())
    assert conditions.domain.height_m > 1.2 * conditions.inversion_m  # room for what overshoots


def made(kind: str, coarser: float, time_s: float, cell_height_m: float | None = None) -> CloudStatistics:
    conditions = CLOUD_SOURCES.load(kind).conditions
    own = conditions.domain
    domain = replace(own, cell_m=own.cell_m * coarser, cell_height_m=cell_height_m or own.cell_height_m)
    return cloud_statistics(run(scenario(WeatherPhase(0.0, replace(conditions, domain=domain))), time_s))


def within(value: float | None, wanted: float, share: float = 0.1) -> bool:
    return value is not None and abs(value - wanted) <= share * wanted


@pytest.mark.slow
def test_fog_lies_on_the_ground_some_tens_of_metres_thick() -> None:
    found = made("fog", 3.0, CLOUD_SOURCES.load("fog").time_s)
    assert found.base_m == 0.0
    assert found.top_m is not None
    assert 20.0 <= found.top_m <= 90.0
    assert found.cover > 0.9


@pytest.mark.slow
def test_stratus_is_a_low_layer() -> None:
    found = made("stratus", 3.0, CLOUD_SOURCES.load("stratus").time_s)
    assert found.base_m is not None
    assert found.top_m is not None
    assert 250.0 <= found.base_m <= 450.0
    assert 550.0 <= found.top_m <= 700.0
    assert found.cover > 0.8


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "coarser", "cell_height_m", "base_m", "top_m", "cover"),
    [
        ("stratocumulus", 2.5, 50.0, 1800.0, 2000.0, (0.5, 1.0)),
        ("cumulus", 2.5, 75.0, 1500.0, 2500.0, (0.1, 0.5)),
        ("cumulonimbus", 2.0, 250.0, 1500.0, 8000.0, (0.2, 0.8)),
    ],
)
def test_base_and_top_are_those_of_figure_24(
    kind: str, coarser: float, cell_height_m: float, base_m: float, top_m: float, cover: Sequence[float]
) -> None:
    found = made(kind, coarser, CLOUD_SOURCES.load(kind).time_s, cell_height_m)
    assert within(found.base_m, base_m)
    assert within(found.top_m, top_m)
    assert cover[0] <= found.cover <= cover[1]
