"""Haze over an image: limits, pixels of surface and sky, colour."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from forestgen.atmosphere.grid import CloudGrid
from forestgen.atmosphere.optical_depth import distance_into, optical_depth
from forestgen.core.spectrum import Band, Spectrum
from forestgen.render.frame import Radiance
from forestgen.render.haze import Airlight, Haze, Seen, airlight_of, cloud_veil, extinction_of, hazed
from forestgen.render.skies.model import MAP_ROWS, map_directions
from forestgen.render.variant import SCALAR, using
from forestgen.render.wavelengths import BandsBySpectrum, ColourAtOnce, ColourBySpectrum
from forestgen.scene.projection import world_rays
from forestgen.scene.spec import Sky
from support.scenes import camera_at

SKY = Sky(35.0, 200.0, 3.0)
LEVEL = camera_at((0.0, 0.0, 2.0), (0.0, 100.0, 2.0), (12, 8))


@pytest.fixture(scope="module")
def light() -> Airlight:
    with using(SCALAR):
        return airlight_of(Haze(10_000.0), ColourAtOnce(), SKY)


def image(mean, variance=None) -> Radiance:
    mean = np.asarray(mean, dtype=np.float32)
    spread = np.full_like(mean, 0.25) if variance is None else np.asarray(variance, dtype=np.float32)
    return Radiance(mean, spread, None, 4)


def some_image(seed: int = 0) -> Radiance:
    return image(np.random.default_rng(seed).uniform(1, 9000, (8, 12, 3)))


def all_seen(surface: float, through) -> Seen:
    return Seen(np.ones((8, 12)), np.full((8, 12), surface), np.broadcast_to(through, (8, 12, 3)).astype(float))


def test_endless_visibility_changes_no_bit(light: Airlight) -> None:
    clear = some_image()
    seen = all_seen(1.0, np.exp(-0.0 * np.full(3, 500.0)))
    for veil in (None, np.zeros((8, 12, 3))):
        same = hazed(clear, seen, light, LEVEL, veil)
        assert same.mean.tobytes() == clear.mean.tobytes()
        assert same.variance.tobytes() == clear.variance.tobytes()


def test_sky_keeps_every_bit(light: Airlight) -> None:
    clear = some_image()
    same = hazed(clear, all_seen(0.0, 1.0), light, LEVEL, None)
    assert same.mean.tobytes() == clear.mean.tobytes()


def test_what_is_endlessly_far_takes_the_horizons_colour(light: Airlight) -> None:
    """By azimuth, and without noise."""
    camera = replace(LEVEL, projection="panorama", size_px=(64, 33))
    shape = (33, 64)
    nothing = Seen(np.ones(shape), np.ones(shape), np.zeros((*shape, 3)))
    hazy = hazed(image(np.full((*shape, 3), 7.0)), nothing, light, camera, None)
    direction = world_rays(camera).direction[16]
    assert abs(direction[:, 2]).max() < 1e-6
    azimuth = np.arctan2(direction[:, 1], direction[:, 0])
    level = map_directions()[MAP_ROWS // 2]
    own = np.arctan2(level[:, 1], level[:, 0])
    for channel in range(3):
        horizon = np.interp(
            azimuth, np.sort(own), light.open_sky[MAP_ROWS // 2, np.argsort(own), channel], period=2 * np.pi
        )
        np.testing.assert_allclose(hazy.mean[16, :, channel], horizon, rtol=0.01)
    assert not hazy.variance.any()


def test_black_at_the_visibility_has_a_contrast_of_two_percent() -> None:
    """In a narrow band at 550 nm, against the sky at the horizon behind it."""
    band = Band("green", Spectrum(np.array([548.0, 550.0, 552.0]), np.array([0.0, 1.0, 0.0])))
    quadrature, haze = BandsBySpectrum((band,)), Haze(8000.0)
    with using(SCALAR):
        light = airlight_of(haze, quadrature, SKY)
    through = np.exp(-extinction_of(haze, quadrature, SKY) * 8000.0)
    towards = np.array([[0.0, 1.0, 0.0]])
    horizon = light.open_sky[MAP_ROWS // 2, [63, 64]].mean(axis=0)
    black = light.towards(towards)[0] * (1 - through)
    np.testing.assert_allclose((horizon - black) / horizon, 0.02, atol=2e-4)


def test_a_pixel_is_the_mean_of_its_samples(light: Airlight) -> None:
    """Surfaces of one brightness at many distances, and sky between them; each sample hazed on its own."""
    rng = np.random.default_rng(3)
    count, extinction = 64, np.array([2e-4, 3e-4, 5e-4])
    direction = world_rays(LEVEL).direction
    up = direction[2]  # a row that looks above the horizon
    behind = np.stack([sky_behind(light, one) for one in up])
    is_sky = rng.random((12, count)) < rng.random((12, 1))
    distance = rng.uniform(10, 9000, (12, count))
    own = rng.uniform(10, 500, (12, 1, 3))
    clear = np.where(is_sky[..., None], behind[:, None], own)
    through = np.exp(-distance[..., None] * extinction)
    each = np.where(is_sky[..., None], behind[:, None], own * through + light.towards(up)[:, None] * (1 - through))
    surface = (~is_sky).mean(axis=1)
    mean = np.where(is_sky[..., None], 0, through).sum(axis=1) / np.maximum((~is_sky).sum(axis=1), 1)[:, None]
    seen = all_seen(1.0, 1.0)
    seen.surface[2], seen.transmittance[2] = surface, mean
    pixels = some_image().mean
    pixels[2] = clear.mean(axis=1)
    hazy = hazed(image(pixels), seen, light, LEVEL, None)
    np.testing.assert_allclose(hazy.mean[2], each.mean(axis=1), rtol=1e-4)


def sky_behind(light: Airlight, direction) -> np.ndarray:
    """The map by inverse distances' limit: the bilinear mean of its four directions around one."""
    rows, columns = light.open_sky.shape[:2]
    row = np.arccos(direction[2]) / np.pi * (rows - 1)
    column = np.arctan2(direction[1], direction[0]) / (2 * np.pi) * columns - 0.5
    i, j = int(row), int(np.floor(column))
    a, b = row - i, column - j
    total = np.zeros(3)
    for di, wi in ((0, 1 - a), (1, a)):
        for dj, wj in ((0, 1 - b), (1, b)):
            total += wi * wj * light.open_sky[i + di, (j + dj) % columns]
    return total


def test_variance_follows_the_light(light: Airlight) -> None:
    """Scatter of many hazed images is what their variance is scaled to."""
    rng = np.random.default_rng(5)
    seen = all_seen(0.7, [0.9, 0.6, 0.3])
    takes = rng.normal(1000, 30, (400, 8, 12, 3))
    many = np.stack([hazed(image(one), seen, light, LEVEL, None).mean for one in takes])
    said = hazed(image(takes[0], np.full((8, 12, 3), 900.0)), seen, light, LEVEL, None).variance
    np.testing.assert_allclose(many.var(axis=0).mean(axis=(0, 1)), said.mean(axis=(0, 1)), rtol=0.03)


def test_sky_behind_leaves_is_the_neighbours_under_clouds(light: Airlight) -> None:
    """A cloud brighter than the sky model: half-covered pixels keep its half."""
    pixels = np.full((8, 12, 3), 20_000.0)
    surface = np.zeros((8, 12))
    surface[:, 6], pixels[:, 6] = 0.5, 10_000.0  # black leaves
    through = np.where(surface[..., None] > 0, 0.5, 1.0) * np.ones(3)
    hazy = hazed(image(pixels), Seen(np.ones((8, 12)), surface, through), light, LEVEL, np.zeros((8, 12, 3)))
    air = light.towards(world_rays(LEVEL).direction[:, 6])
    np.testing.assert_allclose(hazy.mean[:, 6], 10_000 + 0.5 * 0.5 * air, rtol=1e-3)


def test_wavelengths_and_colour_agree() -> None:
    """Airlight in colour is that of the spectrum, within what the sky model's cut to Rec. 709 and the nodes leave."""
    with using(SCALAR):
        at_once, spectral = (airlight_of(Haze(20_000.0), one, SKY) for one in (ColourAtOnce(), ColourBySpectrum()))
    directions = map_directions(9, 16)
    np.testing.assert_allclose(at_once.towards(directions), spectral.towards(directions), rtol=0.04)
    assert np.allclose(extinction_of(Haze(9e3), ColourAtOnce(), SKY), extinction_of(Haze(9e3), ColourBySpectrum(), SKY))


def test_far_things_turn_blue_in_clear_air_and_grey_in_murk() -> None:
    clear, murky = (extinction_of(Haze(one), ColourAtOnce(), SKY) for one in (100_000.0, 2000.0))
    assert clear[2] / clear[0] > 1.5 * murky[2] / murky[0] > 1.5


def test_far_clouds_fade_into_the_clear_sky(light: Airlight) -> None:
    """A bright layer all over the sky: each pixel lies between the cloud's own light and the sky's."""
    layer = CloudGrid(np.full((4, 8, 8), 0.1, dtype=np.float32), (-5e4, -5e4, 1000.0), (5e4, 5e4, 1400.0))
    camera = camera_at((0.0, 0.0, 2.0), (0.0, 100.0, 30.0), (12, 8))
    veil = cloud_veil(layer, camera, np.full(3, 2e-4))
    up = world_rays(camera).direction[..., 2]
    assert (up > 0).any()
    sky = up > 0.05
    # Half of it is taken 7 m into the cloud; the haze between thins out with height.
    path = 1500 / up[sky] * (1 - np.exp(-(1000 + 7 * up[sky]) / 1500))
    np.testing.assert_allclose(veil[sky], np.repeat(1 - np.exp(-2e-4 * path)[:, None], 3, axis=1), rtol=0.02)
    clear = np.array([sky_behind(light, one) for one in world_rays(camera).direction[sky]])
    hazy = hazed(image(np.full((8, 12, 3), 3e4)), all_seen(0.0, 1.0), light, camera, veil)
    np.testing.assert_allclose(hazy.mean[sky], 3e4 * (1 - veil[sky]) + clear * veil[sky], rtol=1e-4)


def test_half_of_what_a_cloud_takes_is_taken_at_its_distance() -> None:
    rng = np.random.default_rng(0)
    cloud = CloudGrid(rng.uniform(0, 0.05, (6, 7, 8)).astype(np.float32), (-40.0, -35.0, 100.0), (40.0, 35.0, 160.0))
    direction = rng.normal(size=(50, 3)) * [0.2, 0.2, 1]
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    origin = np.array([0.0, 0.0, 5.0])
    found = distance_into(cloud, origin, direction)
    whole = 1 - np.exp(-optical_depth(cloud, origin, direction, np.inf))
    hit = whole > 0
    assert (found[~hit] == np.inf).all()
    assert hit.any()
    half = 1 - np.exp(-optical_depth(cloud, origin, direction[hit], found[hit]))
    np.testing.assert_allclose(half, whole[hit] / 2, atol=2e-3)


def test_a_dark_pixel_before_clouds_has_no_negative_light(light: Airlight) -> None:
    """Its paths saw less of the sky than the rays that measure the haze."""
    hazy = hazed(image(np.ones((8, 12, 3))), all_seen(0.5, 0.9), light, LEVEL, np.ones((8, 12, 3)))
    assert (hazy.mean >= 0.0).all()
