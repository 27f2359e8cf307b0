"""The light meter against closed forms: open sky, ground seen from above, a wall, brighter light."""

from __future__ import annotations

import numpy as np
import pytest

from forestgen.atmosphere.daylight import illuminance
from forestgen.core.parts import Part
from forestgen.core.progress import Silent
from forestgen.core.spectrum import Spectrum
from forestgen.geometry.mesh import Mesh
from forestgen.plants.exemplar import Exemplar, OrganMesh
from forestgen.render.irradiance import LUMINANCE, PointLight, measure
from forestgen.render.skies.model import daylight_of
from forestgen.scene.spec import Instances, Material, SceneSpec, Sky, Terrain
from support.radiometry import under_uniform_sky

ALBEDO = 0.3
FLAT = Spectrum(np.array([300.0, 2500.0]), np.array([0.5, 0.2]))  # W/m²/nm
UP, DOWN = (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)


def square(half_m: float, *, upright_at_m: float | None = None) -> Mesh:
    """Level ground; or a wall on it as high as `half_m`, at x = `upright_at_m`."""
    a = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], dtype=np.float32) * half_m
    corners = np.column_stack([a, np.zeros(4)])
    if upright_at_m is not None:
        corners = np.column_stack([np.full(4, upright_at_m), 100 * a[:, 0], (a[:, 1] > 0) * half_m])
    faces = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32)
    return Mesh(corners.astype(np.float32), faces, uv=a.astype(np.float32))


def site(wall: Mesh | None = None, sky: Sky | None = None) -> SceneSpec:
    """Level grey ground, and perhaps a black wall."""
    texture = np.full((2, 2, 3), ALBEDO, dtype=np.float32)
    terrain = Terrain(square(5000.0), texture, np.zeros(4, dtype=np.float32), (ALBEDO,) * 3, None, None)
    organs = (OrganMesh(Part.ROCK, "wall", wall),) if wall is not None else ()
    exemplars = (Exemplar("wall", organs, 1.0, 1.0, 1.0, 0.0, 0.0),) if organs else ()
    count = len(exemplars)
    instances = Instances(
        np.zeros(count, np.uint32), np.tile(np.eye(4)[:3], (count, 1, 1)), np.arange(1, count + 1, dtype=np.uint32)
    )
    materials = {("wall", "wall"): Material((0.0, 0.0, 0.0))}
    return SceneSpec(exemplars, materials, instances, terrain, sky or Sky(40.0, 150.0, 3.0), None, ())


def meter(spec: SceneSpec, normal=UP, light: Spectrum | None = FLAT, samples: int = 4096) -> PointLight:
    point = np.array([0.0, 0.0, 1.0])
    with under_uniform_sky(light):
        return measure(spec, point, np.array(normal), samples=samples, max_depth=4, seed=5, progress=Silent())


def test_a_uniform_sky_is_measured_without_noise() -> None:
    found = meter(site())
    np.testing.assert_allclose(found.spectral, np.tile(FLAT.at(found.wavelength_nm), (8, 1)), rtol=1e-5)
    np.testing.assert_allclose(found.colour @ LUMINANCE, illuminance(FLAT), rtol=1e-4)


def test_level_ground_sends_back_its_albedo() -> None:
    """Looking down on an endless Lambertian plane one sees albedo x E."""
    found = meter(site(), DOWN)
    share = found.spectral / FLAT.at(found.wavelength_nm)
    np.testing.assert_allclose(share.mean(axis=0), ALBEDO, rtol=0.01)


def test_a_wall_hides_its_share_of_the_sky() -> None:
    """An endless black wall of height h above the meter at distance d hides (1 - d / sqrt(d² + h²)) / 2."""
    distance_m, height_m = 3.0, 5.0
    found = meter(site(square(height_m, upright_at_m=distance_m)), samples=16384)
    share = found.spectral.mean(axis=1) / FLAT.at(found.wavelength_nm).mean()
    hidden = (1 - distance_m / np.hypot(distance_m, height_m - 1.0)) / 2  # the meter stands at 1 m
    error = share.std(ddof=1) / np.sqrt(len(share))
    assert error < 0.005
    assert abs(share.mean() - (1 - hidden)) < 4 * error + 1e-4


def test_light_is_linear() -> None:
    wall = site(square(5.0, upright_at_m=3.0))
    once, twice = meter(wall), meter(wall, light=Spectrum(FLAT.wavelength_nm, 2 * FLAT.value))
    np.testing.assert_allclose(twice.spectral, 2 * once.spectral, rtol=1e-5)
    np.testing.assert_allclose(twice.colour, 2 * once.colour, rtol=1e-5)


def test_the_open_site_has_the_daylight_that_the_atmosphere_says() -> None:
    """Level: sun and sky. Facing the sun, straight from it: its normal irradiance."""
    spec = site()
    light = daylight_of(spec.sky)
    level = meter(spec, light=None)
    known = light.on_level.at(level.wavelength_nm)
    visible = (level.wavelength_nm > 380) & (level.wavelength_nm < 1000)
    ratio = level.spectral[:, visible] / known[visible]
    error = ratio.std(axis=0, ddof=1) / np.sqrt(len(ratio))
    assert np.all(np.abs(ratio.mean(axis=0) - 1) < 5 * error + 0.003)
    assert level.sun_lux.mean() == pytest.approx(illuminance(light.sun_on_level), rel=2e-3)
    assert level.sky_lux.mean() == pytest.approx(illuminance(light.sky), rel=0.02)
    facing = meter(spec, spec.sky.to_sun, light=None, samples=512)
    assert facing.sun_lux.mean() == pytest.approx(illuminance(light.sun), rel=2e-3)


def test_an_overcast_sky_has_no_sun() -> None:
    spec = site(sky=Sky(40.0, 150.0, 3.0, kind="overcast"))
    found = meter(spec, light=None)
    assert not found.sun_lux.any()
    assert (found.colour @ LUMINANCE).mean() == pytest.approx(illuminance(daylight_of(spec.sky).sky), rel=0.02)


def test_the_same_seed_gives_the_same_numbers() -> None:
    first, second = meter(site(), light=None, samples=512), meter(site(), light=None, samples=512)
    assert np.array_equal(first.spectral, second.spectral)
