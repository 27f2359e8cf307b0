"""Parts of the weather together: their order, what they do to cameras, and what knows no weather."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from forestgen.core.errors import RecipeError
from forestgen.recipe.load import DrawnRecipe, load_recipe_data
from forestgen.render.cloud_shadow import check_far_clouds
from forestgen.scene.snow_depth import Circles
from forestgen.scene.spec import SceneSpec, WetGround
from forestgen.scene.terrain import HeightField
from forestgen.scene.views import Views
from forestgen.scene.weather.kind import check_weather, in_weather, laid_m, raised_m
from support.error_messages import raises_error
from support.scenes import plain_ground, scattered_scene

FOG, RAIN, SNOW = {"what": "ground_fog", "patch_m": 40}, {"what": "rain"}, {"what": "snow_cover", "depth_m": 2}
RECIPE = {
    "forestgen": 1,
    "species": {"poplar": None},
    "community": {"model": "multiset_lsystem", "program": "succession", "steps": 1},
    "site": {"size_m": [40, 40]},
}


def drawn_in(*weather: object, **sections: object) -> DrawnRecipe:
    return load_recipe_data({**RECIPE, "weather": list(weather), **sections}, "stand").draw(0)


def scene_in(*weather: object) -> SceneSpec:
    spec = scattered_scene(1, exemplars=1, leaves=4, terrain=plain_ground(-40.0, 80.0, albedo=0.3))
    stems = Circles(np.zeros((0, 2)), np.zeros(0))
    return in_weather(spec, drawn_in(*weather), HeightField((40.0, 40.0)), stems)


def test_the_order_of_the_list_is_the_same_scene() -> None:
    """And snow that lies stays dry in rain."""
    one, other = scene_in(FOG, RAIN, SNOW), scene_in(SNOW, RAIN, FOG)
    assert one.fog == other.fog
    assert one.film is not None
    assert not one.film.ground.any()
    assert one.terrain.wet is other.terrain.wet is None
    assert np.array_equal(one.terrain.texture, other.terrain.texture)


def test_fog_in_patches_is_nowhere_less_than_none() -> None:
    (layer,) = scene_in(FOG).fog
    assert 0.9 < sum(amplitude for _, _, amplitude in layer.patches) < 1.0
    length_m = [2.0 * np.pi / np.hypot(*wave[:2]) for wave, _, _ in layer.patches]
    assert 40.0 / 3.0 <= min(length_m) < max(length_m) <= 40.0
    assert scene_in({**FOG, "patch_m": None}).fog == (replace(layer, patches=()),)


def test_light_rain_leaves_wet_soil_wet() -> None:
    terrain = plain_ground(-40.0, 80.0, 2, albedo=0.3)
    share = np.linspace(0.0, 1.0, len(terrain.mesh.vertices_m), dtype=np.float32)
    moist = replace(terrain, wet=WetGround(share, (0.1, 0.1, 0.1), None))
    spec = scattered_scene(1, exemplars=1, leaves=4, terrain=moist)
    stems = Circles(np.zeros((0, 2)), np.zeros(0))
    rainy = in_weather(spec, drawn_in({**RAIN, "wet": 0.3}), HeightField((40.0, 40.0)), stems)
    assert rainy.film is not None
    np.testing.assert_allclose(rainy.film.ground, np.maximum(share, 0.3), rtol=1e-6)


def test_a_kind_twice_is_refused() -> None:
    with raises_error(RecipeError, place="weather.2.what"):
        check_weather(drawn_in(RAIN, FOG, RAIN))


def test_a_camera_in_the_snow_is_told() -> None:
    camera = {"position_m": [10, 10, 0.8], "look_at_m": [20, 30, 2]}
    with raises_error(RecipeError):
        Views.of(drawn_in(SNOW, cameras=[camera])).check_above_ground()
    noted = Views.of(drawn_in(SNOW, cameras=[{**camera, "obstructed": "note", "name": "mole"}]))
    noted.check_above_ground()
    assert noted.below_ground == {"mole": "the snow"}
    Views.of(drawn_in({**SNOW, "depth_m": 0.3}, cameras=[camera])).check_above_ground()


def test_a_camera_in_the_snow_that_crowns_leave_to_the_open_is_told() -> None:
    """Its depth is known with the scene alone."""
    leafy = scattered_scene(200, size_m=40.0, leaves=60_000, exemplars=3)
    stems, ground = Circles(np.zeros((0, 2)), np.zeros(0)), HeightField((40.0, 40.0))
    over_m = 0.5 + float(raised_m(drawn_in(SNOW), np.array([[-15.0, 20.0]]))[0])
    for obstructed in ("error", "note"):
        camera = {"position_m": [-15, 20, over_m], "look_at_m": [20, 30, 2], "name": "mole", "obstructed": obstructed}
        drawn = drawn_in(SNOW, cameras=[camera])
        early = Views.of(drawn)
        assert early.check_above_ground() == []
        late = replace(early, laid_m=partial(laid_m, leafy, drawn, ground, stems))
        if obstructed == "note":
            assert late.check_above_ground() == ["the camera mole stands below the snow"]
        else:
            with raises_error(RecipeError):
                late.check_above_ground()


@pytest.mark.parametrize("weather", [FOG, RAIN, SNOW])
def test_light_that_knows_no_weather_refuses_it(weather: dict[str, object]) -> None:
    with raises_error(RecipeError):  # light meter and colour chart
        check_far_clouds(scene_in(weather), (0.0, 0.0, 1.0))
    clouds = {"sky": {"clouds": {"type": "noise", "cover": 0.3}}, "render": {"clouds": "exact"}}
    with raises_error(RecipeError):
        check_weather(drawn_in(weather, **clouds))
