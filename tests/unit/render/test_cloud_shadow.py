"""The clouds' shadow on the ground against marching through the field, and where it falls."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from forestgen.atmosphere.grid import CloudGrid
from forestgen.render.build import load, origin_of, scene_dict
from forestgen.render.capture import sensor_of
from forestgen.render.cloud_shadow import base_of, plane_edges, shadow_of, shadow_rectangle, sun_transmittance
from forestgen.render.light import sun_disc
from forestgen.render.surfaces import SpectralBsdfs
from forestgen.render.variant import SCALAR, mitsuba
from forestgen.scene.colour import RGB
from forestgen.scene.projection import world_rays
from forestgen.scene.spec import Instances, Sky
from support.scenes import camera_at, plain_ground, scattered_scene


def march(clouds: CloudGrid, point: np.ndarray, direction: np.ndarray, steps: int = 4000) -> float:
    """exp(-optical thickness) from a point on the base along a direction, trilinear between cell centres, 0 outside."""
    from scipy.ndimage import map_coordinates

    low, high = np.array(clouds.low_m), np.array(clouds.high_m)
    shape = np.array(clouds.extinction_per_m.shape)[::-1]
    length = (high[2] - low[2]) / direction[2]
    s = (np.arange(steps) + 0.5) / steps * length
    place = (point + s[:, None] * direction - low) / (high - low) * shape - 0.5
    inside = np.all((place > -0.5) & (place < shape - 0.5), axis=1)
    place[:, 2] = np.clip(place[:, 2], 0, shape[2] - 1)
    sigma = map_coordinates(clouds.extinction_per_m.astype(np.float64), place[:, ::-1].T, order=1, mode="nearest")
    return float(np.exp(-np.sum(sigma * inside) * length / steps))


@pytest.mark.parametrize(("elevation", "azimuth"), [(90, 0), (50, 140), (30, 250)])
def test_sun_transmittance_against_marching(elevation, azimuth):
    """Also beside the field, where the sun shines through its side; and nowhere beyond the shadow."""
    from scipy.ndimage import gaussian_filter

    rng = np.random.default_rng(1)
    field = gaussian_filter(rng.normal(size=(16, 24, 20)), 2.0)
    field = np.clip(field / field.std(), 0, None) * 0.01
    clouds = CloudGrid(field.astype(np.float32), (-100.0, 50.0, 300.0), (300.0, 530.0, 460.0))
    to_sun = Sky(elevation, azimuth, 3.0).to_sun
    low, high = plane_edges(clouds, to_sun, 300.0)
    cells = tuple(int(n) for n in np.ceil((high - low) / 10.0))
    result = sun_transmittance(clouds, to_sun, 300.0, low, high, cells)
    assert result.shape == cells[::-1]
    size, errors, beside = (high - low) / cells, [], 0
    for row in range(0, cells[1], 5):
        for column in range(0, cells[0], 5):
            point = np.array([*(low + size * [column + 0.5, row + 0.5]), 300.0])
            true = march(clouds, point, to_sun)
            beside += true < 0.9 and not (
                np.all(point[:2] > clouds.low_m[:2]) and np.all(point[:2] < clouds.high_m[:2])
            )
            errors.append(result[row, column] - true)
    assert result.min() < 0.6
    assert np.abs(errors).max() < 0.12  # the field is cut off at its sides
    assert np.abs(np.mean(errors)) < 0.005
    assert beside > 5 or elevation == 90
    outside = np.array([*(np.where(to_sun[:2] > 0, low, high) - np.sign(to_sun[:2]) * 1.0), 300.0])
    assert elevation == 90 or march(clouds, outside, to_sun) == 1.0


def test_the_base_of_clouds_is_where_they_begin_to_be_seen():
    extinction = np.zeros((20, 4, 4), np.float32)
    extinction[:8] = 1e-6
    extinction[8:12, 1:3, 1:3] = 0.02
    clouds = CloudGrid(extinction, (0, 0, 0), (400, 400, 400))
    assert base_of(clouds) == pytest.approx(150.0)  # layers are 20 m, and the field rises between their middles
    assert base_of(replace(clouds, extinction_per_m=np.zeros((8, 8, 8), np.float32))) is None


def test_a_shadow_is_computed_once():
    extinction = np.full((4, 8, 8), 0.01, np.float32)
    clouds = CloudGrid(extinction, (-400, -400, 250), (430, 430, 400))
    once, again = (shadow_of(clouds, Sky(40.0, 140.0, 3.0).to_sun, 250.0)[0] for _ in range(2))
    assert once is again
    assert shadow_of(clouds, Sky(41.0, 140.0, 3.0).to_sun, 250.0)[0] is not once


def test_a_clouds_shadow_falls_where_the_sun_says():
    """One dark cell in the north-east, a sun in the south-east: the shadow moves to the north-west."""
    extinction = np.zeros((2, 40, 40), np.float32)
    extinction[:, 24:28, 28:32] = 5.0  # x 80..120 m, y 40..80 m above the ground's origin at the grid's middle
    clouds = CloudGrid(extinction, (-200, -200, 60), (200, 200, 70))
    none = Instances(np.zeros(0, np.uint32), np.zeros((0, 3, 4)), np.zeros(0, np.uint32))
    ground = plain_ground(-12000, 12000)
    spec = replace(scattered_scene(1, exemplars=1, leaves=8, terrain=ground), instances=none)
    spec = replace(spec, clouds=clouds, sky=Sky(60.0, 135.0, 3.0))
    camera = camera_at((60, 100, 55), (60, 100.001, 0), (64, 64), hfov_deg=120)
    mi = mitsuba()
    with mi.variant_context(SCALAR):
        origin = origin_of(camera)
        light = sun_disc(spec.sky, RGB)
        scene = load(
            {**scene_dict(spec, origin, SpectralBsdfs()), "light": light, "shadow": shadow_rectangle(spec, origin)}
        )
        integrator = mi.load_dict({"type": "volpath", "max_depth": 4})
        image = np.array(integrator.render(scene, sensor=sensor_of(camera, 16), spp=16, seed=1))[..., 1]
    rays = world_rays(camera)
    ground = rays.origin_m - rays.direction * (rays.origin_m[2] / rays.direction[..., 2:])
    dark = image < 0.3 * np.median(image)
    assert dark.sum() > 20
    # The sun stands toward (+x, -y), so light travels to (-x, +y): by 60 m / tan 60 = 34.6 m, plus 0 to 5.8 m for the
    # cloud's own height, along each axis times 1 / sqrt 2.
    centre = ground[dark][:, :2].mean(axis=0)
    shift = 62.5 / np.tan(np.radians(60)) / np.sqrt(2)
    np.testing.assert_allclose(centre, [100 - shift, 60 + shift], atol=5.0)
