"""Which transport takes a scene through its clouds, and what people are told of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from forestgen.atmosphere.grid import CloudGrid
from forestgen.core.errors import RecipeError
from forestgen.render.cloud_shadow import (
    base_of,
    check_far_clouds,
    cloud_transport_of,
    highest,
    least_gap_m,
    shadow_height_m,
    shadow_of,
)
from forestgen.scene.spec import SceneSpec
from support.error_messages import raises_error
from support.scenes import camera_at, plain_ground, scattered_scene


def layer(base_m: float, thickness_m: float = 100.0) -> CloudGrid:
    """A cloud in the upper half of a grid that begins on the ground."""
    cells = round(2 * (base_m + thickness_m) / 10.0)
    extinction = np.zeros((cells, 4, 4), np.float32)
    extinction[round(base_m / 10.0) : round((base_m + thickness_m) / 10.0)] = 0.02
    return CloudGrid(extinction, (-500, -500, 0), (500, 500, 10.0 * cells))


def stand(base_m: float, size_m: float = 30.0) -> SceneSpec:
    ground = plain_ground(-2000, 2000)
    return scattered_scene(20, size_m=size_m, exemplars=2, leaves=20, clouds=layer(base_m), terrain=ground)


def test_clouds_far_above_all_are_far() -> None:
    spec = stand(800.0)
    for asked in ("auto", "farfield"):
        assert cloud_transport_of(asked, spec, spec.cameras) == "farfield"
    assert cloud_transport_of("exact", spec, spec.cameras) == "exact"
    assert cloud_transport_of("farfield", replace(spec, clouds=None), spec.cameras) == "farfield"


@pytest.mark.parametrize("base_m", [0.0, 40.0, 90.0])
def test_fog_and_low_clouds_are_not(base_m) -> None:
    spec = stand(base_m)
    assert cloud_transport_of("auto", spec, spec.cameras) == "exact"
    with pytest.raises(RecipeError) as caught:
        cloud_transport_of("farfield", spec, spec.cameras)
    said = str(caught.value)
    for part in ("render.clouds", "the highest plant", "auto or exact", f"{max(base_m - 5, 0):.0f} m on"):
        assert part in said


@pytest.mark.parametrize("height_m", [750.0, 850.0, 2000.0])
def test_cameras_next_to_in_or_above_clouds_are_refused(height_m) -> None:
    spec = stand(800.0)
    camera = camera_at((0.0, 0.0, height_m), (10.0, 10.0, 0.0), (8, 8))
    assert cloud_transport_of("auto", spec, (camera,)) == "exact"
    assert cloud_transport_of("auto", spec, (*spec.cameras, camera)) == "exact"
    with raises_error(RecipeError, place="render.clouds"):
        cloud_transport_of("farfield", spec, (camera,))


def test_a_mountain_under_the_clouds_counts_and_one_beside_them_does_not() -> None:
    spec = stand(800.0)
    for place_m, expected in ((300.0, "exact"), (1500.0, "farfield")):
        mesh = spec.terrain.mesh
        vertices = np.concatenate([mesh.vertices_m, [[place_m, 0.0, 780.0]]]).astype(np.float32)
        top = replace(mesh, vertices_m=vertices, uv=vertices[:, :2].copy())
        raised = replace(spec.terrain, mesh=top, far_share=np.zeros(len(vertices), np.float32))
        assert cloud_transport_of("auto", replace(spec, terrain=raised), spec.cameras) == expected


def test_a_wide_site_asks_for_higher_clouds() -> None:
    wide = stand(150.0, size_m=600.0)
    assert least_gap_m(wide) > 300.0
    assert cloud_transport_of("auto", wide, wide.cameras) == "exact"
    assert cloud_transport_of("auto", stand(150.0), wide.cameras) == "farfield"
    assert highest(wide, [])[0] == "the highest plant"


def test_an_orthographic_camera_counts_as_high_as_its_rays_start() -> None:
    """Seen from the side, a picture 400 m high: its upper rays start 200 m above its middle."""
    spec = stand(300.0)
    level = camera_at((0.0, -100.0, 150.0), (0.0, 100.0, 150.0), (8, 8))
    flat = replace(level, projection="orthographic", width_m=400.0)
    assert cloud_transport_of("auto", spec, (level,)) == "farfield"
    assert cloud_transport_of("auto", spec, (flat,)) == "exact"
    assert cloud_transport_of("auto", spec, (replace(flat, size_px=(8, 1)),)) == "farfield"
    with raises_error(RecipeError, place="render.clouds"):
        cloud_transport_of("farfield", spec, (flat,))


def test_light_at_a_point_is_refused_in_fog_and_close_below_clouds() -> None:
    """The shadow of the clouds' shadow would lie below the meter: the sun would be counted twice."""
    check_far_clouds(stand(800.0), (0.0, 0.0, 2.0))
    check_far_clouds(replace(stand(0.0), clouds=None), (0.0, 0.0, 2.0))
    for base_m, height_m in ((0.0, 2.0), (800.0, 750.0), (800.0, 900.0)):
        with raises_error(RecipeError, place="sky.clouds") as caught:
            check_far_clouds(stand(base_m), (0.0, 0.0, height_m))
        assert "render.clouds" not in str(caught.value)


RAIN_PER_M = 0.002


def shower(west_m: float, east_m: float, extinction_per_m: float = RAIN_PER_M) -> CloudGrid:
    """Clouds from 800 m to 1000 m, and what falls from them to the ground between two places."""
    extinction = np.zeros((50, 40, 200), np.float32)
    extinction[40:] = 0.02
    columns = slice(round((west_m + 2000.0) / 20.0), round((east_m + 2000.0) / 20.0))
    extinction[:40, :, columns] = extinction_per_m
    return CloudGrid(extinction, (-2000, -400, 0), (2000, 400, 1000.0))


@pytest.mark.parametrize(
    ("place", "expected"),
    [((400, 800), "farfield"), ((-900, -160), "farfield"), ((60, 400), "exact"), ((-200, 200), "exact")],
)
def test_rain_beside_the_site_is_far_and_rain_on_it_is_not(place, expected) -> None:
    spec = replace(stand(800.0), clouds=shower(*place))
    assert cloud_transport_of("auto", spec, spec.cameras) == expected
    camera = camera_at((sum(place) / 2, 0.0, 2.0), (0.0, 10.0, 2.0), (8, 8))  # in the rain
    assert cloud_transport_of("auto", spec, (camera,)) == "exact"
    with raises_error(RecipeError, place="sky.clouds"):
        check_far_clouds(spec, (sum(place) / 2, 0.0, 2.0))


def test_fog_beside_the_site_is_too_near() -> None:
    spec = replace(stand(800.0), clouds=shower(400, 800, 0.03))
    assert cloud_transport_of("auto", spec, spec.cameras) == "exact"


def test_a_shower_between_the_sun_and_the_site_casts_its_shadow() -> None:
    """Of 400 m of rain across the way of a sun at 45 degrees in the east."""
    to_sun = np.array([1.0, 0.0, 1.0]) / 2**0.5
    spec = replace(stand(800.0), clouds=shower(200, 600))
    clouds = spec.clouds
    assert clouds is not None
    thin = clouds.extinction_per_m.copy()
    thin[40:] = 0.0  # the shower alone
    clouds = replace(clouds, extinction_per_m=thin)
    spec = replace(spec, clouds=clouds)
    height = shadow_height_m(spec, 2.0)
    assert base_of(clouds) == 0.0
    assert height is not None
    assert highest(spec, [])[1] < height < 40.0
    transmittance, low, high = shadow_of(clouds, to_sun, height)
    rows, columns = transmittance.shape
    at = round((0.0 - low[0]) / (high[0] - low[0]) * columns), rows // 2
    assert transmittance[at[1], at[0]] == pytest.approx(np.exp(-RAIN_PER_M * 400 * 2**0.5), rel=0.02)
    far = round((-1500.0 - low[0]) / (high[0] - low[0]) * columns)
    assert transmittance[at[1], far] == pytest.approx(1.0, abs=1e-6)
