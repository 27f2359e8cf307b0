"""Radiance against what is known: analytic ground, the exact integrator, brute-force marching, and its own scatter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from shots import identity, radiance, seen

from forestgen.atmosphere.grid import CloudGrid
from forestgen.core.parts import Part
from forestgen.render import sky
from forestgen.render.build import load, origin_of, scene_dict
from forestgen.render.farfield import cloud_window, sky_alone
from forestgen.render.light import envmap, lights, sky_light, sun_disc
from forestgen.render.sensors import sensor_of
from forestgen.render.sky_radiance import sun_irradiance
from forestgen.render.slices import SliceSum, slice_sizes
from forestgen.render.surfaces import Paints
from forestgen.render.variant import SCALAR, mitsuba, using
from forestgen.render.views import pixels_of
from forestgen.scene.channels import RGB, Channels
from forestgen.scene.spec import Instances, SceneSpec, Sky
from forestgen.testing.scenes import camera_at, plain_ground, scattered_scene


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
        scene = load({**scene_dict(spec, origin, Paints()), "light": sun_disc(spec.sky, RGB)})
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


def test_the_equirectangular_map_keeps_directions():
    """Faces whose colour is the direction, taken from the renderer's own cube cameras; then all six axes of the map."""
    mi = mitsuba()
    size = 64
    with mi.variant_context(SCALAR):
        faces = {}
        for name, (forward, up) in sky._FACES.items():
            film = {"type": "hdrfilm", "width": size, "height": size}
            to_world = mi.ScalarTransform4f().look_at([0, 0, 0], forward, up)
            sensor = mi.load_dict({"type": "perspective", "fov": 90, "to_world": to_world, "film": film})
            centre = (np.arange(size) + 0.5) / size
            rays = [[sensor.sample_ray(0, 0, [x, y], [0.5, 0.5])[0].d for x in centre] for y in centre]
            faces[name] = (0.5 + 0.5 * np.array(rays)).astype(np.float32)
        light = environment(envmap(sky._equirectangular(faces, 4 * size, 2 * size)))
        rng = np.random.default_rng(0)
        upper = rng.normal(size=(200, 3)) * [1, 1, 0] + [0, 0, 1] * np.abs(rng.normal(size=(200, 1)) + 0.2)
        axes = np.array([[1, 0, 0.06], [-1, 0, 0.06], [0, 1, 0.06], [0, -1, 0.06], [0, 0, 1]])
        for direction in np.concatenate([axes, upper[upper[:, 2] > 0.05 * np.linalg.norm(upper, axis=1)]]):
            unit = direction / np.linalg.norm(direction)
            np.testing.assert_allclose(emitted(light, unit) * 2 - 1, unit, atol=0.05)
        np.testing.assert_allclose(emitted(light, [0, 0, -1]), 0.0, atol=1e-6)


def test_the_baked_clear_sky_is_the_sky():
    """End to end: bright toward the sun, in the right direction. A mirrored or turned map is 37 to 55% off, not 4."""
    spec = stand()
    mi = mitsuba()
    with mi.variant_context(SCALAR):
        baked = environment(sky.bake_sky(spec, origin_of(spec.cameras[0]), RGB, seed=3))
        true = environment(sky_light(spec.sky, RGB))
        rng = np.random.default_rng(0)
        directions = rng.normal(size=(200, 3))
        directions[:, 2] = np.abs(directions[:, 2]) + 0.1
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        error = np.array([emitted(baked, d) / emitted(true, d) - 1 for d in directions])
        assert np.abs(error).mean() < 0.03
        assert np.abs(error.mean()) < 0.01
        toward = spec.sky.to_sun
        assert np.all(emitted(baked, toward) > 2 * emitted(baked, toward * [-1, -1, 1]))


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
    seen, _, above = pixels_of(camera)
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


@pytest.mark.slow
@pytest.mark.parametrize("wavelengths", [(420.0, 550.0, 680.0), (460.0, 860.0, 1610.0)])
def test_the_sky_under_clouds_is_baked_for_all_wavelengths_at_once(wavelengths):
    """Between the wavelengths that it is baked at, it is what a bake at these wavelengths alone gives."""
    spec, channels = replace(stand(), clouds=patchy_clouds()), Channels(wavelengths)
    with using(SCALAR):
        origin = origin_of(spec.cameras[0])
        once = environment(sky.bake_spectral_sky(spec, origin, seed=3, samples=64).light(channels))
        alone = environment(sky.bake_sky(spec, origin, channels, seed=4, samples=64))
        rng = np.random.default_rng(0)
        directions = rng.normal(size=(150, 3))
        directions[:, 2] = np.abs(directions[:, 2]) + 0.1
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        ratio = np.array([emitted(once, d) / emitted(alone, d) for d in directions])
    assert np.abs(ratio.mean(axis=0) - 1).max() < 0.02
    assert np.abs(np.median(ratio, axis=0) - 1).max() < 0.02


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
                **scene_dict(spec, origin, Paints()),
                **lights(spec.sky, RGB),
                "clouds": sky.cloud_volume(spec.clouds, origin),
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
    """The split's approximations: one environment for all points, depth 64 in clouds, sun without forward scatter.

    Measured at 4096 samples: sky 0.0%, edge +0.4 +- 0.1%, plants +0.5 to +1.0 +- 0.2%, ground +7 +- 0.6%: that patch
    of ground lies at a shadow's rim, under clouds of 83 m cells whose map is one cell fine.
    """
    spec = replace(stand(size_px=(32, 18), plants=150), clouds=patchy_clouds())
    assert_regions_agree(spec, exact(spec, samples, 100), radiance(spec, samples, 5), bias)


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
    from scipy.ndimage import gaussian_filter

    rng = np.random.default_rng(1)
    field = gaussian_filter(rng.normal(size=(16, 24, 20)), 2.0)
    field = np.clip(field / field.std(), 0, None) * 0.01
    field[:, [0, 1, -2, -1]] = field[:, :, [0, 1, -2, -1]] = 0.0  # the map tapers off half a cell within the rim
    clouds = CloudGrid(field.astype(np.float32), (-100.0, 50.0, 300.0), (300.0, 530.0, 460.0))
    spec = replace(stand(), sky=Sky(elevation, azimuth, 3.0))
    direction = spec.sky.to_sun
    result = sky.sun_transmittance(clouds, direction)
    assert result.shape == (24, 20)
    errors = []
    for row in range(0, 24, 3):
        for column in range(0, 20, 3):
            point = np.array([-100 + 20 * (column + 0.5), 50 + 20 * (row + 0.5), 300.0])
            errors.append(result[row, column] - march(clouds, point, direction))
    assert result.min() < 0.6
    assert np.abs(errors).max() < 0.06
    assert np.abs(np.mean(errors)) < 0.005


def test_a_clouds_shadow_falls_where_the_sun_says():
    """One dark cell in the north-east, a sun in the south-east: the shadow moves to the north-west."""
    extinction = np.zeros((2, 40, 40), np.float32)
    extinction[:, 24:28, 28:32] = 5.0  # x 80..120 m, y 40..80 m above the ground's origin at the grid's middle
    clouds = CloudGrid(extinction, (-200, -200, 60), (200, 200, 70))
    spec = replace(bare(stand()), clouds=clouds, sky=Sky(60.0, 135.0, 3.0))
    camera = camera_at((60, 100, 55), (60, 100.001, 0), (64, 64), hfov_deg=120)
    mi = mitsuba()
    with mi.variant_context(SCALAR):
        origin = origin_of(camera)
        light = sun_disc(spec.sky, RGB)
        scene = load({**scene_dict(spec, origin, Paints()), "light": light, "sheet": sky.sun_sheet(spec, origin)})
        integrator = mi.load_dict({"type": "volpath", "max_depth": 4})
        image = np.array(integrator.render(scene, sensor=sensor_of(camera, 16), spp=16, seed=1))[..., 1]
    ground = seen(replace(spec, cameras=(camera,)), 1)[1].position_m
    dark = image < 0.3 * np.median(image)
    assert dark.sum() > 20
    # The sun stands toward (+x, -y), so light travels to (-x, +y): by 60 m / tan 60 = 34.6 m, plus 0 to 5.8 m for the
    # cloud's own height, along each axis times 1 / sqrt 2.
    centre = ground[dark][:, :2].mean(axis=0)
    shift = 62.5 / np.tan(np.radians(60)) / np.sqrt(2)
    np.testing.assert_allclose(centre, [100 - shift, 60 + shift], atol=5.0)


def test_pixels_above_the_horizon():
    def first_row_below(target, position=(0, 0, 2)):
        above = pixels_of(camera_at(position, target, (40, 30))).above
        assert (above == above[:, :1]).all()  # cameras are level
        return int(above[:, 0].sum())

    level = camera_at((0, 0, 2), (0, 9, 2), (40, 30))
    assert first_row_below((0, 9, 2)) == 15
    assert first_row_below((0, 9, 4)) == int(15 + 2 / 9 * level.focal_px)
    assert first_row_below((0, 9, 1)) == int(15 - 1 / 9 * level.focal_px)
    assert first_row_below((0, 0, 9)) == 30
    assert first_row_below((0, 0, 2), (0, 0, 9)) == 0


def test_the_sky_alone_shows_nothing_of_what_lies_below():
    """Any shape of horizon; a window holds all that its own pixels are replaced by."""
    rng = np.random.default_rng(2)
    camera = replace(camera_at((0, 0, 2), (0, 9, 4), (40, 30)), projection="panorama")
    for above in (pixels_of(camera).above, rng.random((30, 40)) < 0.3):
        image = np.where(above[..., None], rng.random((30, 40, 3)), -1.0)
        alone = sky_alone(image, above, ~above)
        assert (alone >= 0).all()
        np.testing.assert_array_equal(alone[above], image[above])
        share = np.zeros((30, 40), dtype=bool)
        share[20:23, 5:9] = True
        window = cloud_window(share, above)
        inside = slice(window.y, window.y + window.height), slice(window.x, window.x + window.width)
        assert share[inside].sum() == share.sum()
        assert (sky_alone(image[inside], above[inside], ~above[inside])[share[inside]] >= 0).all()


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
