"""Radiance against what is known: analytic ground, the exact integrator, brute-force marching, and its own scatter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from shots import identity, radiance

from forestgen.atmosphere.grid import CloudGrid
from forestgen.core.parts import Part
from forestgen.core.spectrum import Spectrum
from forestgen.render import sky
from forestgen.render.build import load, origin_of, scene_dict
from forestgen.render.capture import sensor_of
from forestgen.render.cloud_paths import gather
from forestgen.render.cloud_shadow import base_of
from forestgen.render.light import sky_light, sky_map, sun_disc, sun_irradiance
from forestgen.render.rendering import SliceSum, slice_sizes
from forestgen.render.surfaces import SpectralBsdfs
from forestgen.render.variant import SCALAR, mitsuba, using
from forestgen.render.views import sky_pixels
from forestgen.scene.colour import RGB, Channels
from forestgen.scene.projection import image_circle, rays, world_rays
from forestgen.scene.spec import Camera, Instances, SceneSpec, Sky, WetGround
from support.cloud_box import cloud_volume
from support.radiometry import lights
from support.scenes import camera_at, plain_ground, scattered_scene


def stand(size_px=(48, 27), plants=60) -> SceneSpec:
    ground = plain_ground(-12000, 12000, albedo=0.2)
    return scattered_scene(plants, size_m=30, exemplars=3, leaves=600, size_px=size_px, terrain=ground, seed=8)


def bare(spec: SceneSpec) -> SceneSpec:
    none = Instances(np.zeros(0, np.uint32), np.zeros((0, 3, 4)), np.zeros(0, np.uint32))
    return replace(spec, instances=none)


def emitted(emitter, direction) -> np.ndarray:
    """Radiance that arrives from a direction."""
    mi = mitsuba()
    si = mi.SurfaceInteraction3f()
    si.wi = mi.Vector3f(*[-float(x) for x in direction])
    return np.array(emitter.eval(si), dtype=np.float64)


def environment(dictionary):
    return mitsuba().load_dict({"type": "scene", "light": dictionary}).environment()


@pytest.mark.parametrize(("elevation", "azimuth"), [(90.0, 0.0), (40.0, 140.0), (12.0, -70.0)])
def test_ground_under_the_sun_alone(elevation, azimuth):
    """L = E sin(elevation) rho / pi, with E integrated over the sun's disc."""
    spec = bare(replace(stand(), sky=Sky(elevation, azimuth, 3.0)))
    camera = camera_at((0, 0, 10), (3, 4, 0), (8, 8))
    mi = mitsuba()
    with mi.variant_context(SCALAR):
        origin = origin_of(camera)
        scene = load({**scene_dict(spec, origin, SpectralBsdfs()), "light": sun_disc(spec.sky, RGB)})
        image = mi.load_dict({"type": "path", "max_depth": 2}).render(
            scene, sensor=sensor_of(camera, 64), spp=64, seed=1
        )
        irradiance = sun_irradiance(spec.sky, RGB)
        expected = irradiance * spec.sky.to_sun[2] * 0.2 / np.pi
        np.testing.assert_allclose(np.array(image)[..., :3].mean(axis=(0, 1)), expected, rtol=0.01)


def test_clear_sky_is_the_emitters_own():
    spec = bare(stand(size_px=(32, 18)))
    camera = camera_at((0, 0, 5), (0, 40, 18), (32, 18))
    image = radiance(replace(spec, cameras=(camera,)), 64, seed=1)
    mi = mitsuba()
    with mi.variant_context(SCALAR):
        light = environment(sky_light(spec.sky, RGB))
        for row, column in ((2, 4), (2, 28), (8, 16)):
            ray = np.array([(column + 0.5 - 16) / camera.focal_px, (row + 0.5 - 9) / camera.focal_px, 1.0])
            direction = camera.world_from_camera @ ray / np.linalg.norm(ray)
            np.testing.assert_allclose(image.mean[row, column], emitted(light, direction), rtol=0.02)


def test_the_baked_clear_sky_is_the_sky():
    """End to end: bright toward the sun, in the right direction. A mirrored or turned map is 37 to 55% off."""
    spec = replace(stand(), clouds=empty_clouds())
    with using(SCALAR):
        baked = environment(sky.baked_sky(sky.traced_clouds_of(spec), np.zeros(3)).light(RGB))
        true = environment(sky_light(spec.sky, RGB))
        rng = np.random.default_rng(0)
        directions = rng.normal(size=(200, 3))
        directions[:, 2] = np.abs(directions[:, 2]) + 0.1
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        error = np.array([emitted(baked, d) / emitted(true, d) - 1 for d in directions])
        assert np.abs(error).mean() < 0.01
        assert np.abs(error.mean()) < 0.003
        toward = spec.sky.to_sun
        assert np.all(emitted(baked, toward) > 2 * emitted(baked, toward * [-1, -1, 1]))
        np.testing.assert_allclose(emitted(baked, [0, 0, -1]), 0.0, atol=1e-6)


def regions(spec: SceneSpec) -> dict[str, np.ndarray]:
    found = identity(spec, 16)
    open_sky = (found.part == Part.NOTHING).mean(axis=2)
    return {
        "sky": open_sky == 1,
        "edge": (open_sky > 0) & (open_sky < 1),
        "ground": (found.part == Part.GROUND).all(axis=2),
        "plants": (found.plant_id > 0).mean(axis=2) > 0.4,
    }


def assert_regions_agree(spec, one, other, bias: float, sigmas: float = 4.0) -> None:
    """Regional means agree within `sigmas` standard errors and a stated bias, relative."""
    for name, where in regions(spec).items():
        assert where.sum() >= 20, name
        mean = one.mean[where].mean(axis=0)
        difference = other.mean[where].mean(axis=0) - mean
        error = np.sqrt((one.variance + other.variance)[where].sum(axis=0)) / where.sum()
        assert np.all(np.abs(difference) < sigmas * error + bias * mean), (name, difference / mean, error / mean)


def above_the_horizon(camera: Camera) -> np.ndarray:
    """(H, W) pixels that see anything, all of it above a flat earth's horizon."""
    width, height = camera.size_px
    corner = rays(camera, *np.meshgrid(np.arange(width + 1.0), np.arange(height + 1.0)))
    up = corner.valid & (corner.direction @ camera.world_from_camera[2] > -1e-9)
    return image_circle(camera) & up[:-1, :-1] & up[:-1, 1:] & up[1:, :-1] & up[1:, 1:]


def empty_clouds() -> CloudGrid:
    return CloudGrid(np.zeros((8, 8, 8), np.float32), (-500, -500, 300), (500, 500, 500))


def test_three_estimators_under_clouds_of_nothing_are_the_clear_sky():
    """Sky light from the map, sun through the sheet, and the sky by coverage add up, gaps and horizon included.

    Measured at 512 samples: sky -0.01 +- 0.04%, edge +0.2 to +0.5 +- 0.13%, ground 0.0 +- 0.1%.
    """
    spec = stand()
    assert_regions_agree(spec, radiance(spec, 128, 1), radiance(replace(spec, clouds=empty_clouds()), 128, 2), 0.01)


@pytest.mark.slow
@pytest.mark.parametrize("projection", ["fisheye", "panorama"])
def test_cameras_all_around_see_the_same_through_clouds_of_nothing(projection):
    """Horizon and plain of the cloud pass included: nothing of the plain leaks into the sky."""
    from scipy.ndimage import binary_dilation

    spec = stand(size_px=(32, 32) if projection == "fisheye" else (48, 24))
    up = camera_at((15, 15, 1.5), (15, 15.001, 9), spec.cameras[0].size_px, hfov_deg=180.0)
    level = camera_at((15, 15, 1.5), (15, 25, 1.5), spec.cameras[0].size_px)
    camera = replace(up if projection == "fisheye" else level, projection=projection)
    spec = replace(spec, cameras=(camera,))
    clear, cloudy = radiance(spec, 16, 1), radiance(replace(spec, clouds=empty_clouds()), 16, 2)
    seen, above = image_circle(camera), above_the_horizon(camera)
    outside = ~binary_dilation(seen)  # a pixel at the circle's rim holds some of both
    assert (clear.mean[outside] == 0).all()
    assert (cloudy.mean[outside] == 0).all()
    open_sky = (identity(spec, 16).part == Part.NOTHING).all(axis=2) & seen
    low = np.zeros_like(seen)
    low[:-1] |= above[:-1] & ~above[1:]
    for where in (open_sky, ~open_sky & seen, open_sky & low):
        if where.sum() < 20:
            continue
        mean = clear.mean[where].mean(axis=0)
        error = np.sqrt((clear.variance + cloudy.variance)[where].sum(axis=0)) / where.sum()
        assert (np.abs(cloudy.mean[where].mean(axis=0) - mean) < 4 * error + 0.01 * mean).all()


def test_an_overcast_sky_has_no_sun():
    spec = replace(stand(), sky=Sky(40.0, 140.0, 3.0, kind="overcast"))
    assert set(lights(spec.sky, RGB)) == {"sky"}
    assert_regions_agree(spec, radiance(spec, 64, 1), radiance(replace(spec, clouds=empty_clouds()), 64, 2), 0.01)


@pytest.mark.parametrize("wavelengths", [None, (420.0, 550.0, 680.0), (460.0, 860.0, 1610.0)])
def test_the_sky_under_clouds_is_baked_for_all_wavelengths_at_once(wavelengths):
    """Between the wavelengths that it is baked at, over ground of any colour, it is the light at these wavelengths."""
    spec, channels = replace(stand(), clouds=patchy_clouds()), Channels(wavelengths)
    green = replace(spec.terrain, far_reflectance=(0.05, 0.4, 0.1), far_share=np.ones_like(spec.terrain.far_share))
    spec = replace(spec, terrain=green)
    with using(SCALAR):
        clouds, place = sky.traced_clouds_of(spec), np.array([15.0, 15.0, 10.0])
        once = sky.level_irradiance(sky.baked_sky(clouds, place).radiance(channels))
        count = 100_000
        up = np.sqrt((np.arange(count) + 0.5) / count)
        way = sky._directions(up, np.arange(count) * 2.399963)
        found = gather(clouds.field, clouds.under(sky_map(spec.sky, channels)), place, way, seed=5, disc=False)
        alone = np.pi * found.radiance(clouds.albedo(channels), sun_irradiance(spec.sky, channels)).mean(axis=0)
    np.testing.assert_allclose(once, alone, rtol=0.03)


def test_clouds_see_the_wet_ground_around_the_site():
    """The plain below them has the share of the ground beyond the site, in colour and at wavelengths."""
    spec = replace(stand(), clouds=patchy_clouds())
    ground, nm = spec.terrain, np.array([400.0, 2500.0])
    away = ground.mesh.vertices_m[:, 0] > 0
    far = (0.5 * away).astype(np.float32)
    wet = WetGround(np.where(away, 0.4, 0.9).astype(np.float32), (0.05, 0.05, 0.05), Spectrum(nm, np.full(2, 0.05)))
    for channels in (RGB, Channels((460.0, 860.0, 1610.0))):
        dry, found = (
            replace(
                sky.traced_clouds_of(replace(spec, terrain=replace(ground, far_share=far, wet=one))), far_share=0.0
            ).albedo(channels)
            for one in (None, wet)
        )
        np.testing.assert_allclose(found, 0.6 * dry + 0.4 * 0.05, rtol=1e-5)


def test_light_on_the_land_around_is_that_of_its_own_clouds():
    """One cloud east of the site: the ratio says what paths find there; far away it is that of a clear sky."""
    extinction = np.zeros((6, 12, 12), np.float32)
    extinction[1:5, 4:8, 7:11] = 0.05
    cloudy = CloudGrid(extinction, (-600, -600, 300), (600, 600, 450))
    spec = replace(stand(), clouds=cloudy)
    with using(SCALAR):
        clouds, place = sky.traced_clouds_of(spec), sky.site_middle(spec)
        here = sky.baked_sky(clouds, place)
        land = sky.overland(here, place, base_of(cloudy))
        places = np.array([[-300.0, 0, 0], [300.0, 0, 0], [100.0, -150, 0], [9000.0, 0, 0], [np.nan] * 3, place])
        ratio = land.ratio(RGB, places)
        count = 30_000
        way = sky._directions(np.sqrt((np.arange(count) + 0.5) / count), np.arange(count) * 2.399963)
        light, sun = clouds.under(sky_map(spec.sky, RGB)), sun_irradiance(spec.sky, RGB)
        found = [
            np.pi
            * gather(clouds.field, light, one, way, seed=3, disc=False).radiance(clouds.albedo(RGB), sun).mean(axis=0)
            for one in places[:3]
        ]
        clear = sky.level_irradiance(sky_map(spec.sky, RGB))
    middle = sky.level_irradiance(here.radiance(RGB))
    np.testing.assert_allclose(ratio[:3] * middle, found, rtol=0.06)
    np.testing.assert_allclose(ratio[3] * middle, clear, rtol=0.03)
    np.testing.assert_array_equal(ratio[4], 1.0)
    np.testing.assert_allclose(ratio[5], 1.0, rtol=1e-12)
    assert np.ptp(ratio[:3], axis=0).min() > 0.1


def test_a_last_digit_leaves_the_baked_sky_as_it_is():
    """Floats end in other digits on other machines: its noise must not hang on them."""
    spec = replace(stand(), clouds=patchy_clouds())
    other = replace(spec, sky=replace(spec.sky, turbidity=float(np.nextafter(spec.sky.turbidity, 9.0))))
    with using(SCALAR):
        place = np.array([15.0, 15.0, 10.0])
        first, second = (sky.baked_sky(sky.traced_clouds_of(one), place).radiance(RGB) for one in (spec, other))
    near = np.isclose(first, second, rtol=1e-4)
    assert near.mean() > 0.999  # a path or two may turn at a surface


def patchy_clouds() -> CloudGrid:
    rng = np.random.default_rng(4)
    extinction = np.zeros((6, 10, 10), np.float32)
    extinction[1:5, 1:9, 1:9] = 0.03 * (rng.random((4, 8, 8)) < 0.45)
    return CloudGrid(extinction, (-400, -400, 250), (430, 430, 400))


def exact(spec: SceneSpec, samples: int, seed: int):
    """Plants, terrain, clouds, sun and sky in one scene by the plain volumetric path tracer."""
    from forestgen.render.frame import Radiance

    mi = mitsuba()
    camera = spec.cameras[0]
    with mi.variant_context(SCALAR):
        origin = origin_of(camera)
        scene = load(
            {
                **scene_dict(spec, origin, SpectralBsdfs()),
                **lights(spec.sky, RGB),
                "clouds": cloud_volume(spec.clouds, origin),
            }
        )
        integrator = mi.load_dict({"type": "volpath", "max_depth": 128, "rr_depth": 128})
        total = SliceSum()
        for number, size in enumerate(slice_sizes(samples)):
            image = integrator.render(scene, sensor=sensor_of(camera, size), seed=seed + number, spp=size)
            total = total.added(np.array(image)[..., :3].astype(np.float64), size)
    estimate = total.estimate()
    return Radiance(estimate.mean, estimate.variance, None, samples)


@pytest.mark.parametrize(
    ("samples", "bias"), [(64, 0.10), pytest.param(1024, 0.05, marks=pytest.mark.slow)], ids=["quick", "tight"]
)
def test_cloudy_composite_against_everything_in_one_path(samples, bias):
    """The split's approximations: light of the sky from the same directions at all points, a flat sheet of shadow."""
    spec = replace(stand(size_px=(32, 18), plants=150), clouds=patchy_clouds())
    assert_regions_agree(spec, exact(spec, samples, 100), radiance(spec, samples, 5), bias)


@pytest.mark.parametrize("projection", ["perspective", "orthographic", "fisheye", "panorama"])
def test_the_sky_behind_a_scene_shows_nothing_of_what_lies_below(projection):
    """In all pixels that see anything, the sky of their own directions; below the horizon that above it."""
    spec = replace(stand(), clouds=empty_clouds())
    view = camera_at((0, 0, 2), (3, 9, 4), (40, 20), hfov_deg=80.0)
    camera = replace(
        view, projection=projection, width_m=20.0, size_px=(20, 20) if projection == "fisheye" else (40, 20)
    )
    with using(SCALAR):
        clouds = sky.traced_clouds_of(spec)
        seen = image_circle(camera)
        image = sky_pixels(clouds, camera, seen, RGB, 32, 1)
        direction = world_rays(camera).direction
        up = direction * [1, 1, 0] + np.abs(direction) * [0, 0, 1]
        true = environment(sky_light(spec.sky, RGB))
        expected = np.array([[emitted(true, one) for one in row] for row in up])
    assert (image[~seen] == 0).all()
    far = seen & (direction @ spec.sky.to_sun < np.cos(np.radians(20.0)))  # from the sun's disc
    assert np.abs(image[far] / expected[far] - 1).mean() < 0.02
    assert (image[seen] > 0).all()


def test_variance_of_unequal_slices_is_unbiased():
    rng = np.random.default_rng(0)
    sizes = slice_sizes(13)
    assert sum(sizes) == 13
    means, variances = [], []
    for _ in range(4000):
        total = SliceSum()
        for size in sizes:
            total = total.added(rng.normal(3.0, 2.0, (size, 1)).mean(axis=0), size)
        estimate = total.estimate()
        means.append(estimate.mean[0])
        variances.append(estimate.variance[0])
    assert np.mean(variances) == pytest.approx(4.0 / 13, rel=0.03)
    assert np.var(means) == pytest.approx(4.0 / 13, rel=0.08)


@pytest.mark.parametrize("cloudy", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_stated_variance_is_the_scatter_over_seeds(cloudy):
    spec = stand(size_px=(16, 9), plants=20)
    if cloudy:
        spec = replace(spec, clouds=empty_clouds())
    runs = [radiance(spec, 16, seed) for seed in range(24)]
    scatter = np.var([run.mean.astype(np.float64) for run in runs], axis=0, ddof=1)
    stated = np.mean([run.variance for run in runs], axis=0)
    assert stated.sum() / scatter.sum() == pytest.approx(1.0, abs=0.35 if cloudy else 0.25)
    assert np.median(stated / np.maximum(scatter, 1e-12)) == pytest.approx(1.05, abs=0.3)
