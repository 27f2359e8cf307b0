"""Light paths through clouds against closed forms, published values, the renderer, and themselves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from forestgen.atmosphere.billows import detail_of
from forestgen.atmosphere.grid import CloudGrid, PhaseFunction
from forestgen.atmosphere.optical_depth import optical_depth
from forestgen.render import cloud_paths
from forestgen.render.cloud_paths import CloudLight, field_of, gather
from forestgen.render.cloud_shadow import content_key

WHITE = np.ones((2, 129, 256), dtype=np.float32)


def light(**changes) -> CloudLight:
    """A white sky over a plain a metre down, the sun in the south-east."""
    elevation = np.radians(50.0)
    to_sun = np.array([np.cos(elevation) * 0.6, np.cos(elevation) * -0.8, np.sin(elevation)])
    return replace(CloudLight(to_sun, 0.2665, WHITE, 0.2, -1.0), **changes)


def patchy(seed: int = 4, shape=(11, 17, 21), **changes) -> CloudGrid:
    """Rough clouds on a grid that no brick divides, with clear air and a border that is not empty."""
    from scipy.ndimage import gaussian_filter

    field = gaussian_filter(np.random.default_rng(seed).normal(size=shape), 1.5)
    extinction = np.clip(field / field.std(), 0, None).astype(np.float32) * 0.03
    return CloudGrid(extinction, (-400.0, -330.0, 300.0), (440.0, 350.0, 520.0), **changes)


def slab(depth: float, **changes) -> CloudGrid:
    """A level cloud, so wide that its sides are out of sight."""
    return CloudGrid(np.full((8, 3, 3), depth / 100.0, np.float32), (-1e6, -1e6, 0.0), (1e6, 1e6, 100.0), **changes)


def upward(count: int, seed: int = 0) -> np.ndarray:
    way = np.random.default_rng(seed).normal(size=(count, 3))
    way[:, 2] = np.abs(way[:, 2])
    return way / np.linalg.norm(way, axis=1, keepdims=True)


@pytest.mark.parametrize("phase", [PhaseFunction(), PhaseFunction(0.9, -0.4, 0.8), PhaseFunction(0.0)])
def test_white_clouds_over_a_white_plain_in_a_white_sky_are_not_seen(phase) -> None:
    clouds = field_of(patchy(albedo=1.0, phase=phase))
    found = gather(clouds, light(ground_albedo=1.0), np.zeros(3), upward(3000), seed=1, samples=4)
    np.testing.assert_allclose(found.radiance(np.ones(2), np.zeros(2)), 1.0, rtol=1e-12)


def test_the_share_that_no_drop_meets_is_the_transmittance() -> None:
    """Black drops and a black plain: what comes through is exp(-optical depth), of the very same field."""
    grid = patchy(albedo=0.0)
    way = upward(200, seed=3)
    way = way[way[:, 2] > 0.6]
    found = gather(field_of(grid), light(ground_albedo=0.0), np.zeros(3), way, seed=2, samples=20_000)
    expected = np.exp(-optical_depth(grid, np.zeros(3), way, np.array(np.inf)))
    met = (expected > 0.01) & (expected < 0.99)
    assert met.sum() > 40
    difference, chance = (found.of_sky[:, 0, 0] - expected)[met], expected[met]
    z = difference / np.sqrt(chance * (1 - chance) / 20_000)
    assert np.abs(z).max() < 4.5
    assert np.sqrt((z**2).mean()) == pytest.approx(1.0, abs=0.35)


def test_clouds_in_two_layers_give_the_light_of_one_field_of_both() -> None:
    """Collisions with two layers are independent; and the optical depth is the sum."""
    whole, seen = patchy(albedo=0.98), []
    part = np.random.default_rng(2).random(whole.extinction_per_m.shape).astype(np.float32)
    own, other = (replace(whole, extinction_per_m=whole.extinction_per_m * one) for one in (part, 1.0 - part))
    both, way = replace(own, above=other), upward(400)
    depth = [optical_depth(one, np.zeros(3), way, np.array(np.inf)) for one in (whole, both)]
    np.testing.assert_allclose(depth[0], depth[1], rtol=1e-4, atol=1e-6)
    for seed, grid in enumerate((whole, both)):
        found = gather(field_of(grid), light(), np.zeros(3), way, seed=seed, samples=400)
        assert found.of_aloft.shape == (400, 3, 1 + (grid is both))
        aloft = found.of_aloft.sum(axis=(1, 2))
        seen.append([found.of_sky[:, 0, 0].mean(), found.of_sun[:, 1:].sum(axis=1).mean(), aloft.mean()])
    np.testing.assert_allclose(seen[0], seen[1], rtol=0.02)
    assert content_key(both) != content_key(own)


def test_the_key_of_clouds_is_of_all_their_detail() -> None:
    mean = np.ones((2, 2, 2), np.float32)
    grid = CloudGrid(mean, (-1.0, -1.0, 0.0), (1.0, 1.0, 1.0))
    tables = {"depth": np.ones((1, 9, 9, 9), np.int16), "octave": np.ones((1, 7)), "unit": 2.0 * np.ones(3)}
    other = [replace(grid, detail=grid.detail._replace(**{name: table})) for name, table in tables.items()]
    assert len({content_key(one) for one in (grid, *other)}) == 4


def test_paths_and_optical_depth_see_the_same_detail() -> None:
    """As above, in clouds with edges within the cells."""
    z, y, x = np.meshgrid(np.arange(8), np.arange(12), np.arange(12), indexing="ij")
    mean = (0.004 * np.clip(3.5 - np.hypot(np.hypot(x - 5.5, y - 6.0), z - 3.5), 0, 1)).astype(np.float32)
    inside, detail = detail_of(mean, np.zeros(mean.shape, bool), (75.0, 75.0, 62.5), periodic=False)
    assert len(detail.depth) > 100
    grid = CloudGrid(mean, (-450.0, -450.0, 800.0), (450.0, 450.0, 1300.0), albedo=0.0)
    grid = replace(grid, full_per_m=inside, detail=detail)
    way = upward(300, seed=3) * [0.3, 0.3, 1.0]
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    found = gather(field_of(grid), light(ground_albedo=0.0), np.zeros(3), way, seed=2, samples=5000)
    expected = np.exp(-optical_depth(grid, np.zeros(3), way, np.array(np.inf)))
    met = (expected > 0.01) & (expected < 0.99)
    assert met.sum() > 40
    error = (found.of_sky[:, 0, 0] - expected)[met] / np.sqrt((expected * (1 - expected))[met] / 5000)
    assert abs(error.mean()) < 4.0 / np.sqrt(met.sum())
    assert np.sqrt((error**2).mean()) < 1.7  # a ray's optical depth is summed in steps


def test_once_scattered_sunlight_is_the_integral_along_the_ray() -> None:
    """A cloud that absorbs what it scatters twice: p(angle) times an integral of two exponentials."""
    depth, albedo = 0.4, 1e-3
    phase = PhaseFunction(0.6, -0.3, 0.7)
    grid = slab(depth, albedo=albedo, phase=phase)
    way = np.array([[0.0, np.sin(0.5), np.cos(0.5)]])
    lit = light(sky=WHITE * 0, ground_albedo=0.0, sun_radius_deg=1e-3)
    found = gather(field_of(grid), lit, np.array([0.0, 0.0, -0.5]), way, seed=3, samples=400_000)
    mu, mu0 = way[0, 2], lit.to_sun[2]
    cosine = float(way[0] @ lit.to_sun)

    def lobe(g):
        return (1 - g * g) / (4 * np.pi * (1 + g * g - 2 * g * cosine) ** 1.5)

    p = 0.7 * lobe(0.6) + 0.3 * lobe(-0.3)
    slope = 1 / mu - 1 / mu0  # along the ray the way to the sun gets shorter
    through = np.exp(-depth / mu0) * (np.exp(-depth * slope) - 1) / (-slope) / mu
    assert found.of_sun[0, 0] == pytest.approx(albedo * p * through, rel=0.01)


@pytest.mark.parametrize(
    ("depth", "albedo", "g", "mu0"), [(1.0, 1.0, 0.75, 0.5), (16.0, 1.0, 0.75, 1.0), (1.0, 0.9, 0.0, 1.0)]
)
def test_a_layer_divides_light_into_what_it_reflects_and_what_it_lets_through(depth, albedo, g, mu0) -> None:
    """Plane albedo and transmission of a layer, by reciprocity from what a ray gathers; and conservation of energy."""
    grid = slab(depth, albedo=albedo, phase=PhaseFunction(g))
    way = np.array([[np.sqrt(1 - mu0 * mu0), 0.0, mu0]])
    # A sky that is white above: a ray from below collects the share that passes upwards through the layer.
    black = light(ground_albedo=0.0, ground_m=-2.0)
    samples = 30_000
    through = gather(field_of(grid), black, np.array([0.0, 0.0, -1.0]), way, seed=5, samples=samples).of_sky[0, 0, 0]
    # A ray from above that points down collects what the layer turns back up.
    back = gather(field_of(grid), black, np.array([0.0, 0.0, 101.0]), -way, seed=6, samples=samples).of_sky[0, 0, 0]
    assert 0 < back < 1
    if albedo == 1.0:
        assert through + back == pytest.approx(1.0, abs=0.01)
    else:
        assert through + back < 0.9
    expected_back, expected_through = doubled(depth, albedo, g, mu0)
    assert back == pytest.approx(expected_back, abs=0.01)
    assert through == pytest.approx(expected_through, abs=0.01)


def doubled(depth: float, albedo: float, g: float, mu0: float) -> tuple[float, float]:
    """Albedo and transmission (direct light included) of a layer by the method of adding and doubling, azimuthal mean.

    Hansen, J. E. (1971): Multiple scattering of polarized light in planetary atmospheres. J. Atmos. Sci. 28, 120.
    """
    mu, weight = np.polynomial.legendre.leggauss(40)
    mu, weight = (mu + 1) / 2, weight / 2
    mu, weight = np.append(mu, mu0), np.append(weight, 0.0)  # one more direction, without weight: that of the ray
    order = np.arange(200)
    moments = (2 * order + 1) * g**order
    up, down = (np.polynomial.legendre.legvander(sign * mu, 199) for sign in (1, -1))
    forward, backward = (one * moments @ up.T for one in (up, down))  # azimuthal means of the phase function, 4 pi p
    thin = depth / 2**24
    scale = albedo * thin / (4 * mu[:, None] * mu) * (2 * mu * weight)  # rows: out, columns: in, weighted with flux
    reflect = backward * scale
    passing = forward * scale
    direct = np.exp(-thin / mu)
    one = np.eye(len(mu))
    for _ in range(24):
        back_and_forth = np.linalg.inv(one - reflect @ reflect)
        total = passing + np.diag(direct)
        reflect, total = reflect + total @ reflect @ back_and_forth @ total, total @ back_and_forth @ total
        direct = direct**2
        passing = total - np.diag(direct)
    # By reciprocity the light that a ray gathers from a white sky is what it would give to all directions.
    return float(reflect[-1].sum()), float(passing[-1].sum() + direct[-1])


def test_the_plain_reflects_as_its_albedo_says() -> None:
    """No clouds: a ray down sees the plain under sun and sky; a coloured plain only after the first reflection."""
    empty = field_of(CloudGrid(np.zeros((4, 4, 4), np.float32), (-100, -100, 50), (100, 100, 90)))
    lit = light()
    found = gather(empty, lit, np.zeros(3), np.array([[0.6, 0.0, -0.8]]), seed=1, samples=20_000)
    albedo, sun = np.array([0.1, 0.5]), np.array([3.0, 0.0])
    expected = albedo * (1.0 + sun * lit.to_sun[2] / np.pi)
    np.testing.assert_allclose(found.radiance(albedo, sun)[0], expected, rtol=0.04)
    up = gather(empty, lit, np.zeros(3), np.array([[0.6, 0.0, 0.8]]), seed=1)
    np.testing.assert_allclose(up.radiance(albedo, sun)[0], 1.0)


def test_the_suns_disc_has_its_irradiance() -> None:
    empty = field_of(CloudGrid(np.zeros((4, 4, 4), np.float32), (-100, -100, 50), (100, 100, 90)))
    lit = light(sun_radius_deg=2.0)
    aside = np.cross(lit.to_sun, [0.0, 0.0, 1.0])
    for angle_deg, seen in ((0.0, True), (1.9, True), (2.1, False)):
        way = (
            np.cos(np.radians(angle_deg)) * lit.to_sun + np.sin(np.radians(angle_deg)) * aside / np.linalg.norm(aside)
        )[None]
        found = gather(empty, lit, np.zeros(3), way, seed=1).of_sun[0].sum()
        assert found == pytest.approx(seen / (np.pi * np.sin(np.radians(2.0)) ** 2))
        assert gather(empty, lit, np.zeros(3), way, seed=1, disc=False).of_sun.sum() == 0


def test_directions_of_the_sky_are_those_of_its_map() -> None:
    from forestgen.render.skies.model import map_directions

    sky = (0.5 + 0.5 * np.moveaxis(map_directions(), -1, 0)).astype(np.float32)
    empty = field_of(CloudGrid(np.zeros((4, 4, 4), np.float32), (-100, -100, 50), (100, 100, 90)))
    way = upward(500)
    found = gather(empty, light(sky=sky), np.zeros(3), way, seed=1).of_sky[:, 0]
    np.testing.assert_allclose(2 * found - 1, way, atol=1e-3)


def test_the_largest_value_of_a_brick_is_one() -> None:
    """Nowhere between the cells' centres is the field larger; and no brick is needlessly large."""
    grid = patchy(shape=(9, 16, 23))
    field = field_of(grid)
    assert field.most.shape == (2, 2, 3)
    rng = np.random.default_rng(0)
    place = rng.random((20_000, 3)) * [23, 16, 9] - 0.5
    value = np.array([cloud_paths._value(field.value, *one) for one in place])
    brick = np.floor((place + 0.5) / cloud_paths.BRICK).astype(int)
    most = field.most[brick[:, 2], brick[:, 1], brick[:, 0]]
    assert (value <= most * (1 + 1e-6)).all()
    assert field.most.max() == grid.extinction_per_m.max()


def test_the_same_light_at_any_number_of_threads(monkeypatch) -> None:
    field, way = field_of(patchy()), upward(3000)
    results = []
    for cores in (1, 2, 5):
        monkeypatch.setattr("forestgen.core.threads.cores", lambda cores=cores: cores)
        results.append(gather(field, light(), np.zeros(3), way, seed=9, samples=16))
    for other in results[1:]:
        np.testing.assert_array_equal(other.of_sky, results[0].of_sky)
        np.testing.assert_array_equal(other.of_sun, results[0].of_sun)
    again = gather(field, light(), np.zeros(3), way, seed=10, samples=16)
    assert (again.of_sun != results[0].of_sun).any()


@pytest.mark.slow
def test_the_renderers_volume_path_tracer_finds_the_same() -> None:
    """By blocks of the image, and in the mean, over a plain that reflects much."""
    from forestgen.core.frames import look_at
    from forestgen.render.capture import sensor_of
    from forestgen.render.light import SUN_RADIUS_DEG, sky_light, sky_map, sun_disc, sun_irradiance
    from forestgen.render.variant import SCALAR, mitsuba
    from forestgen.render.views import lens_rays
    from forestgen.scene.colour import RGB
    from forestgen.scene.spec import Camera, Sky
    from support.cloud_box import cloud_volume

    sky, grid, albedo = Sky(50.0, 140.0, 3.0), patchy(albedo=0.99, phase=PhaseFunction(0.8, -0.3, 0.85)), 0.5
    size, runs, block = (32, 16), 10, 8
    camera = Camera("up", (0.0, 0.0, 2.0), look_at((0, 0, 2), (30, 50, 60)), size, 80.0)
    mi = mitsuba()
    with mi.variant_context(SCALAR):
        radiance, sun = sky_map(sky, RGB), sun_irradiance(sky, RGB)
        plain = mi.ScalarTransform4f().translate([0, 0, -2]).scale([1e6, 1e6, 1.0])
        scene = mi.load_dict(
            {
                "type": "scene",
                "sky": sky_light(sky, RGB),
                "sun": sun_disc(sky, RGB),
                "clouds": cloud_volume(grid, np.array(camera.position_m)),
                "plain": {
                    "type": "rectangle",
                    "to_world": plain,
                    "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": albedo}},
                },
            }
        )
        integrator = mi.load_dict({"type": "volpath", "max_depth": 256, "rr_depth": 256})
        theirs = [
            np.array(integrator.render(scene, sensor=sensor_of(camera, 64), seed=k, spp=64))[..., :3]
            for k in range(runs)
        ]
    lit = CloudLight(sky.to_sun, SUN_RADIUS_DEG, np.moveaxis(radiance, -1, 0), albedo, 0.0)
    field, rng = field_of(grid), np.random.default_rng(1)
    row, column = np.divmod(np.arange(size[0] * size[1]), size[0])
    own = []
    for run in range(runs):
        total = np.zeros((len(row), 3))
        for number in range(64):
            origin, way, _ = lens_rays(camera, row, column, rng.random((4, len(row))))
            found = gather(field, lit, origin, way, seed=1000 * run + number)
            total += found.radiance(np.full(3, albedo), sun)
        own.append(total.reshape(size[1], size[0], 3) / 64)
    one, other = (
        np.array(images).reshape(runs, size[1] // block, block, size[0] // block, block, 3).mean(axis=(2, 4))
        for images in (own, theirs)
    )
    error = np.sqrt((one.var(axis=0, ddof=1) + other.var(axis=0, ddof=1)) / runs)
    z = (one.mean(axis=0) - other.mean(axis=0)) / error
    assert np.abs(z).max() < 5.0
    assert np.sqrt((z**2).mean()) < 1.6
    total = np.sqrt((one.mean(axis=(1, 2, 3)).var(ddof=1) + other.mean(axis=(1, 2, 3)).var(ddof=1)) / runs)
    assert abs(one.mean() - other.mean()) < 4 * total + 0.003 * other.mean()
    assert total < 0.01 * other.mean()
