"""From the recipe's weather to the scene's clouds: the types' own values, what cannot be, where clouds are put."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from forestgen.atmosphere.clouds.cirrus import below_cirrus, check_cirrus_above
from forestgen.atmosphere.clouds.source import CloudRequest, cloud_source_of
from forestgen.atmosphere.conditions import Layers
from forestgen.atmosphere.extinction import droplet_phase
from forestgen.atmosphere.grid import CloudGrid, Weather
from forestgen.atmosphere.simulate import Scenario
from forestgen.core.errors import AssetError, ForestgenError, RecipeError
from forestgen.core.progress import Silent
from forestgen.recipe.load import DrawnRecipe, load_recipe
from forestgen.recipe.registries import CLOUD_SOURCES
from support.error_messages import raises_error

QUICKSTART = Path(__file__).parents[3] / "recipes" / "quickstart.yaml"
TINY = "domain: {extent_m: 1000, cell_m: 125, height_m: 160, cell_height_m: 20}"


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FORESTGEN_CACHE", str(tmp_path / "cache"))


def clouds_of(one: DrawnRecipe, ground_m: float, progress: Silent) -> CloudGrid | None:
    return cloud_source_of(one).grid(CloudRequest(one, ground_m, progress))


def weather_of(one: DrawnRecipe, progress: Silent) -> Weather:
    return cloud_source_of(one).air(one, progress).weather


def check_clouds(one: DrawnRecipe) -> None:
    cloud_source_of(one).check(one)


def cloud_bytes(one: DrawnRecipe) -> int:
    return cloud_source_of(one).estimate_bytes(one, None, None)


def scenario_of(one: DrawnRecipe) -> Scenario:
    scenario: Scenario = CLOUD_SOURCES.load(one.recipe.sky.clouds.type).scenario(one)
    return scenario


def time_of(one: DrawnRecipe) -> float:
    time_s: float = CLOUD_SOURCES.load(one.recipe.sky.clouds.type).time_of(one)
    return time_s


def drawn(clouds: str, *overrides: str, recipe: Path = QUICKSTART) -> DrawnRecipe:
    return load_recipe(recipe, [f"sky.clouds={clouds}", *overrides]).draw(0)


def test_what_is_left_out_is_the_types_own() -> None:
    own = CLOUD_SOURCES.load("cumulus").conditions
    (phase,) = scenario_of(drawn("cumulus", "site.wind_from_deg=180")).phases
    assert phase.conditions.layers == own.layers
    assert phase.conditions.emission == own.emission
    assert phase.conditions.domain == own.domain
    np.testing.assert_allclose(
        phase.conditions.wind_m_per_s, (0.0, CLOUD_SOURCES.load("cumulus").wind_m_per_s), atol=1e-12
    )
    given = (
        "{type: cumulus, sounding: {inversion_m: 2000}, emission: {vapour_g_per_m2_s: 0.1}, domain: {cell_m: 90}, "
        "cooling_k_per_h: 0.5, wind_m_per_s: 8, wind_from_deg: 270}"
    )
    (phase,) = scenario_of(drawn(given)).phases
    assert isinstance(phase.conditions.layers, Layers)
    assert phase.conditions.layers.inversion_m == 2000.0
    assert phase.conditions.layers.relative_humidity == own.layers.relative_humidity  # type: ignore[union-attr]
    assert phase.conditions.emission.latent_w_per_m2 == pytest.approx(250.0)
    assert phase.conditions.emission.heat_w_per_m2 == own.emission.heat_w_per_m2
    assert (phase.conditions.domain.cell_m, phase.conditions.cooling_k_per_h) == (90.0, 0.5)
    np.testing.assert_allclose(phase.conditions.wind_m_per_s, (8.0, 0.0), atol=1e-12)


def test_the_picture_is_taken_when_the_type_is_ripe_or_when_it_is_said() -> None:
    assert time_of(drawn("fog")) == CLOUD_SOURCES.load("fog").time_s
    assert time_of(drawn("{type: fog, time_s: 7}")) == 7
    story = "{story: [{at_s: 0, type: fog}, {at_s: 900, type: stratus}]}"
    assert time_of(drawn(story)) == 900 + CLOUD_SOURCES.load("stratus").time_s


@pytest.mark.parametrize(
    ("clouds", "overrides"),
    [
        ("{type: fog, domain: {extent_m: 110}}", ()),
        ("{type: fog, domain: {height_m: 50}}", ()),
        ("{type: fog, domain: {cell_m: 0.5}}", ()),
        ("{type: cumulus, sounding: {lapse_rate_k_per_km: -290}}", ()),
        ("{story: [{at_s: 0, type: fog}, {at_s: 9, type: cumulus, domain: {height_m: 900}}]}", ()),
        ("{type: noise, extinction_per_m: 1, thickness_m: 2000}", ()),
    ],
)
def test_weather_that_cannot_be_is_refused_before_it_is_simulated(clouds: str, overrides: Sequence[str]) -> None:
    with raises_error(ForestgenError):
        check_clouds(drawn(clouds, *overrides))


def stand(tmp_path: Path) -> Path:
    path = tmp_path / "stand.yaml"
    path.write_text(QUICKSTART.read_text())
    return path


def test_a_sounding_from_a_file_and_one_that_is_supersaturated(tmp_path: Path) -> None:
    recipe, table = stand(tmp_path), tmp_path / "air.csv"
    table.write_text(
        "height_m,temperature_c,relative_humidity,wind_m_per_s,wind_from_deg\n0,20,0.5,5,270\n9000,-40,0.2,9,270\n"
    )
    (phase,) = scenario_of(drawn("{type: cumulus, sounding: air.csv}", recipe=recipe)).phases
    sounding = phase.conditions.sounding()
    assert sounding.temperature_k[0] == pytest.approx(293.15)
    np.testing.assert_allclose(sounding.wind_at(np.array([0.0, 4500.0, 9000.0]))[:, 0], [5.0, 7.0, 9.0])
    table.write_text("height_m,temperature_c,relative_humidity\n0,20,0.5\n3000,2,1.2\n9000,-40,0.2\n")
    with raises_error(AssetError, place="sky.clouds.sounding"):
        check_clouds(drawn("{type: cumulus, sounding: air.csv}", recipe=recipe))


def test_humid_air_between_far_levels_is_simulated_and_not_a_traceback(tmp_path: Path) -> None:
    recipe, table = stand(tmp_path), tmp_path / "air.csv"
    table.write_text("height_m,temperature_c,relative_humidity\n0,15,0.99\n1500,3,0.99\n9000,-40,0.2\n")
    one = drawn(
        "{type: stratus, sounding: air.csv, time_s: 0, domain: {extent_m: 1000, cell_m: 125, cell_height_m: 125}}",
        recipe=recipe,
    )
    check_clouds(one)
    weather = weather_of(one, Silent())
    sounding = scenario_of(one).phases[0].conditions.sounding()
    height = weather.grid.layer_heights_m
    assert sounding.relative_humidity_at(height).max() == pytest.approx(0.9995, abs=1e-6)
    np.testing.assert_allclose(sounding.relative_humidity_at(np.array([0.0, 1500.0])), 0.99, rtol=1e-9)
    np.testing.assert_allclose(sounding.temperature_at(750.0), 282.15, atol=0.01)


def test_what_no_check_has_seen_is_told_and_not_a_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object, **__: object) -> None:
        raise ValueError("supersaturated at 825 m")

    monkeypatch.setattr("forestgen.atmosphere.clouds.simulated.simulate", refused)
    with raises_error(RecipeError, place="sky.clouds"):
        weather_of(drawn("fog"), Silent())


def test_a_measured_sounding_begins_with_the_pressure_that_is_said(tmp_path: Path) -> None:
    recipe = stand(tmp_path)
    (tmp_path / "air.csv").write_text("height_m,temperature_c,relative_humidity\n0,20,0.5\n9000,-40,0.2\n")
    at_sea, high = (
        scenario_of(drawn(f"{{type: cumulus, sounding: {{file: air.csv{more}}}}}", recipe=recipe)).phases[0]
        for more in ("", ", ground_pressure_hpa: 900")
    )
    assert at_sea.conditions.sounding().ground_pressure_pa == 101_325.0
    sounding = high.conditions.sounding()
    assert sounding.pressure_at(0.0) == pytest.approx(90_000.0)
    assert sounding.relative_humidity_at(0.0) == pytest.approx(0.5)


def test_a_map_of_emission_from_a_picture(tmp_path: Path) -> None:
    recipe = stand(tmp_path)
    np.save(tmp_path / "warm.npy", np.array([[0.0, 0.0], [0.0, 5.0]]))  # the last row is in the south
    (phase,) = scenario_of(drawn("{type: cumulus, emission: {map: warm.npy}}", recipe=recipe)).phases
    assert phase.conditions.emission.map is not None
    np.testing.assert_array_equal(phase.conditions.emission.map, [[0.0, 5.0], [0.0, 0.0]])
    np.save(tmp_path / "warm.npy", np.array([[-1.0, 2.0]]))
    with raises_error(ForestgenError, place="sky.clouds.emission.map"):
        check_clouds(drawn("{type: cumulus, emission: {map: warm.npy}}", recipe=recipe))


@pytest.mark.slow
def test_fog_stands_on_the_ground_around_the_site_and_goes_on_beyond_it() -> None:
    fog = f"{{type: fog, time_s: 600, {TINY}}}"
    grid = clouds_of(drawn(fog), -3.0, Silent())
    assert grid is not None
    assert grid.low_m[2] == -3.0
    assert (grid.low_m[0] + grid.high_m[0]) / 2 == pytest.approx(60.0)
    assert grid.high_m[0] - grid.low_m[0] == 5000.0  # the box five times
    np.testing.assert_array_equal(grid.extinction_per_m[..., :8], grid.extinction_per_m[..., 8:16])
    alone = clouds_of(drawn(fog.replace("{type", "{repeat: false, offset_m: [100, -50], type")), 0.0, Silent())
    assert alone is not None
    assert alone.high_m[0] - alone.low_m[0] == 1000.0
    assert (alone.low_m[0] + alone.high_m[0]) / 2 == pytest.approx(160.0)
    assert (alone.low_m[1] + alone.high_m[1]) / 2 == pytest.approx(10.0)
    np.testing.assert_array_equal(alone.extinction_per_m, grid.extinction_per_m[:, :8, :8])


def test_all_images_have_one_sky_unless_its_seed_is_drawn() -> None:
    loaded = load_recipe(QUICKSTART, [f"sky.clouds={{type: fog, time_s: 120, {TINY}}}"])
    one, other = (weather_of(loaded.draw(index), Silent()) for index in (0, 1))
    np.testing.assert_array_equal(one.vapour, other.vapour)
    seeded = weather_of(drawn(f"{{type: fog, time_s: 120, seed: 99, {TINY}}}"), Silent())
    assert not np.array_equal(one.vapour, seeded.vapour)


def test_saved_weather_is_what_was_simulated(tmp_path: Path) -> None:
    from forestgen.atmosphere.weather_files import write_weather

    recipe = stand(tmp_path)
    fog = drawn(f"{{type: fog, time_s: 600, droplet_radius_um: 10, {TINY}}}")
    write_weather(tmp_path / "fog.nc", weather_of(fog, Silent()))
    simulated = clouds_of(fog, 0.0, Silent())
    read = clouds_of(drawn("{type: file, file: fog.nc, droplet_radius_um: 10}", recipe=recipe), 0.0, Silent())
    assert simulated is not None
    assert read is not None
    np.testing.assert_array_equal(simulated.extinction_per_m, read.extinction_per_m)
    assert (simulated.low_m, simulated.high_m, simulated.phase) == (read.low_m, read.high_m, read.phase)


def saved_thunder(tmp_path: Path, name: str, **more: float) -> DrawnRecipe:
    """A saved state of the air with some water in it, and the recipe that names it."""
    from forestgen.atmosphere.weather_files import write_weather

    weather = weather_of(drawn(f"{{type: fog, time_s: 600, {TINY}}}"), Silent())
    write_weather(tmp_path / name, weather, **more)
    return drawn(f"{{type: file, file: {name}}}", recipe=stand(tmp_path))


def test_saved_weather_keeps_the_radius_of_its_droplets(tmp_path: Path) -> None:
    small, large = (
        clouds_of(saved_thunder(tmp_path, f"{radius}.nc", droplet_radius_um=radius), 0.0, Silent())
        for radius in (8.0, 16.0)
    )
    assert small is not None
    assert large is not None
    top = small.extinction_per_m.max()
    assert large.extinction_per_m.max() == pytest.approx(top / 2, rel=1e-4)
    assert small.phase == droplet_phase(8.0)
    with raises_error(RecipeError, place="sky.clouds.file"):
        clouds_of(saved_thunder(tmp_path, "unknown.nc"), 0.0, Silent())


def test_the_radius_goes_from_one_chapters_to_the_nexts_within_its_change() -> None:
    story = (
        "{story: [{at_s: 0, type: fog}, {at_s: 1000, type: cumulus, change_s: 400}, "
        "{at_s: 1200, type: cumulonimbus, change_s: 100}]}"
    )
    one = drawn(story)
    source = CLOUD_SOURCES.load(one.recipe.sky.clouds.type)
    found = [source.droplet_radius_um_at(one, at_s) for at_s in (0, 999, 1000, 1100, 1199.9999, 1200, 1250, 1300, 9e9)]
    np.testing.assert_allclose(found, [8.0, 8.0, 8.0, 8.5, 9.0, 9.0, 12.0, 15.0, 15.0], atol=1e-5)
    fixed = drawn(story.replace("{story", "{droplet_radius_um: 11, story"))
    assert source.droplet_radius_um_at(fixed, 1100.0) == 11.0


def volume(tmp_path: Path, size_m: float = 400.0, top_m: float = 500.0, times: float = 1.0) -> CloudGrid:
    from forestgen.atmosphere.weather_files import write_clouds

    values = np.random.default_rng(1).random((4, 5, 6), dtype=np.float32) * np.float32(times)
    half = size_m / 2
    grid = CloudGrid(values, (-half, -half, top_m - 200.0), (half, half, top_m))
    write_clouds(tmp_path / "sky.vol", grid)
    return grid


def test_a_volume_of_extinction_lies_where_the_weather_did(tmp_path: Path) -> None:
    recipe, saved = stand(tmp_path), volume(tmp_path)
    grid = clouds_of(drawn("{type: file, file: sky.vol, offset_m: [10, -20]}", recipe=recipe), -3.0, Silent())
    assert grid is not None
    np.testing.assert_array_equal(grid.extinction_per_m, saved.extinction_per_m)
    assert grid.low_m == (60.0 + 10.0 - 200.0, 60.0 - 20.0 - 200.0, 297.0)
    assert grid.high_m == (270.0, 240.0, 497.0)


@pytest.mark.parametrize(
    "made",
    [{"times": 1e30}, {"size_m": 2e7}, {"top_m": 2e5}, {"top_m": -5.0}],
)
def test_a_volume_that_is_no_cloud_is_refused(made: dict[str, float], tmp_path: Path) -> None:
    recipe = stand(tmp_path)
    volume(tmp_path, **made)
    with raises_error(ForestgenError):
        clouds_of(drawn("{type: file, file: sky.vol}", recipe=recipe), 0.0, Silent())


@pytest.mark.parametrize(("key", "value"), [("droplet_radius_um", "9"), ("repeat", "true")])
def test_a_key_that_cannot_act_on_a_volume_is_refused(key: str, value: str, tmp_path: Path) -> None:
    recipe = stand(tmp_path)
    volume(tmp_path)
    with raises_error(RecipeError, place=key):
        clouds_of(drawn(f"{{type: file, file: sky.vol, {key}: {value}}}", recipe=recipe), 0.0, Silent())


def test_a_site_larger_than_its_clouds_is_refused(tmp_path: Path) -> None:
    recipe = stand(tmp_path)
    volume(tmp_path, size_m=110.0)  # the site has 120
    with raises_error(RecipeError, place="sky.clouds"):
        clouds_of(drawn("{type: file, file: sky.vol}", recipe=recipe), 0.0, Silent())
    saved_thunder(tmp_path, "sky.nc", droplet_radius_um=8.0)  # 1000 m wide
    for clouds, wide in (("{type: file, file: sky.nc, repeat: false}", 1200), ("{type: file, file: sky.nc}", 5000)):
        one = drawn(clouds, f"site.size_m=[100, {wide}]", recipe=recipe)
        if wide == 5000:  # what is repeated reaches as far
            assert clouds_of(one, 0.0, Silent()) is not None
            continue
        with raises_error(RecipeError, place="sky.clouds"):
            clouds_of(one, 0.0, Silent())


def test_more_cells_need_more_memory() -> None:
    few, many = (
        cloud_bytes(drawn(f"{{type: cumulus, domain: {{cell_m: {cell}, cell_height_m: {cell}}}}}"))
        for cell in (100, 50)
    )
    assert few == pytest.approx(many / 8, rel=0.1)
    assert cloud_bytes(drawn("none")) == 0


def test_memory_for_a_saved_field_follows_its_cells_and_not_its_compressed_size(tmp_path: Path) -> None:
    saved_thunder(tmp_path, "sky.nc", droplet_radius_um=8.0)  # 8 x 8 x 8 cells over 1000 m
    recipe = stand(tmp_path)
    alone, tiled = (
        cloud_bytes(drawn(f"{{type: file, file: sky.nc, repeat: {repeat}}}", recipe=recipe))
        for repeat in ("false", "true")
    )
    assert alone >= 8**3 * 4 * 10  # the fields of a state
    assert tiled >= 8**3 * 7**2 * 4 * 4  # 7 x 7 copies, several times
    volume(tmp_path)
    assert cloud_bytes(drawn("{type: file, file: sky.vol}", recipe=recipe)) >= 4 * 5 * 6 * 16
    (tmp_path / "sky.nc").write_bytes(b"no")
    assert cloud_bytes(drawn("{type: file, file: sky.nc}", recipe=recipe)) == 0


def test_cirrus_lie_above_other_clouds_and_reach_far_down() -> None:
    noise = "{type: noise, cirrus: {cover: 0.5, optical_depth: 0.3}"
    one = drawn(noise + "}")
    request = CloudRequest(one, 100.0, Silent())
    low = cloud_source_of(one).grid(request)
    both = below_cirrus(request, low)
    assert low is not None
    assert both is not None
    assert both.above is not None
    assert both.above.low_m[2] == 9100.0
    np.testing.assert_array_equal(both.extinction_per_m, low.extinction_per_m)
    assert below_cirrus(request, None) is not None  # where there are no others
    # In the middle they have what was asked for; at the edge there is no step.
    depth = both.above.extinction_per_m.sum(axis=0) * both.above.cell_m[2]
    middle, row = slice(448, 896), depth[672]
    assert depth[middle, middle].mean() == pytest.approx(0.15, rel=0.05)
    assert np.maximum(row[0], row[-1]) < 0.01
    with raises_error(RecipeError):
        below_cirrus(request, replace(low, high_m=(*low.high_m[:2], 9200.0)))
    with raises_error(RecipeError):
        check_cirrus_above(drawn(noise + "}", "render.clouds=exact"))
    with raises_error(RecipeError):
        drawn("{type: cirrus, cirrus: {cover: 0.5}}")
