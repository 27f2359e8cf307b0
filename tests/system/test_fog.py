"""Fog on the ground: its light against closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from forestgen.core.progress import Timings
from forestgen.render.identity import SceneTracer
from forestgen.render.light import sun_irradiance
from forestgen.render.paths.fog import FAR_M, Fog
from forestgen.render.paths.tracer import Image, PathTracer
from forestgen.render.skies.model import MAP_COLUMNS, MAP_ROWS
from forestgen.render.variant import LLVM, mi, using
from forestgen.scene.colour import RGB
from forestgen.scene.spec import Camera, FogLayer, Instances, SceneSpec, Sky, Wave
from support.scenes import camera_at, plain_ground, scattered_scene

LAYERS = (FogLayer(0.02, 12.0, 4.0, 0.85), FogLayer(0.005, 0.0, 30.0, 0.5))


WAVES = (((0.3, 0.2, -0.4), 0.5, 0.5), ((-0.1, 0.25, 0.1), 2.0, 0.4))
PATCHY = (replace(LAYERS[0], patches=WAVES), replace(LAYERS[1], patches=WAVES[:1]))


def depth_to(layers: tuple[FogLayer, ...], z_m: float, climb: float, way_m: float) -> float:
    """By summing up the extinction along the way, from x = y = 0 to the east."""
    way = (np.arange(20000) + 0.5) / 20000 * way_m
    x, z, total = np.sqrt(1.0 - climb**2) * way, z_m + climb * way, 0.0
    for one in layers:
        share = 1.0 + sum(size * np.sin(k[0] * x + k[2] * z + phase) for k, phase, size in one.patches)
        total += np.mean(share * one.extinction_per_m * np.exp(-np.maximum(z - one.top_m, 0.0) / one.fade_m)) * way_m
    return float(total)


@pytest.mark.parametrize("layers", [LAYERS, PATCHY], ids=["even", "patchy"])
@pytest.mark.parametrize("climb", [-0.8, -0.0005, 0.0, 0.02, 0.5])
def test_ways_in_fog_have_the_distribution_of_beers_law(climb: float, layers: tuple[FogLayer, ...]) -> None:
    count, z_m = 200_000, 9.0
    numbers = np.random.default_rng(3).random((2, count)).astype(np.float32)
    with using(LLVM):
        fog = Fog(layers, np.array([0.0, 0.0, 2.0]))
        start, going = mi.Point3f(0.0, 0.0, z_m - 2.0), mi.Vector3f(float(np.sqrt(1 - climb**2)), 0.0, climb)
        flights = np.array(fog.flights(start, going, [mi.Float(one) for one in numbers]).distance_m)
        kept = [float(fog.kept(start, going, mi.Float(way))[0]) for way in (5.0, 25.0, 60.0)]
        through = float(fog.through(start, going)[0])
    for way, share in zip((5.0, 25.0, 60.0), kept, strict=True):
        beer = np.exp(-depth_to(layers, z_m, climb, way))
        assert share == pytest.approx(beer, rel=2e-3)
        assert np.mean(flights > way) == pytest.approx(beer, abs=4 * np.sqrt(beer * (1 - beer) / count) + 1e-4)
    if climb > 0.01:
        assert through == pytest.approx(np.exp(-depth_to(layers, z_m, climb, 400.0 / climb)), rel=5e-3)
        assert np.mean(flights >= FAR_M) == pytest.approx(through, abs=0.006)


def flat(albedo: float, sky: Sky, layer: FogLayer, camera: Camera) -> SceneSpec:
    """Level ground under a layer of fog, without plants."""
    spec = scattered_scene(1, exemplars=1, leaves=4, terrain=plain_ground(-20000, 20000, albedo=albedo))
    none = Instances(np.zeros(0, np.uint32), np.zeros((0, 3, 4)), np.zeros(0, np.uint32))
    return replace(spec, instances=none, sky=sky, cameras=(camera,), fog=(layer,))


def image(spec: SceneSpec, samples: int, sky: float, *, depth: int = 2000) -> Image:
    """Under an even sky and the scene's sun."""
    radiance = np.zeros((MAP_ROWS, MAP_COLUMNS, 3), np.float32)
    radiance[: MAP_ROWS // 2 + 1] = sky
    paths = PathTracer(SceneTracer(spec, Timings()), spec.cameras[0], depth, lambda _: radiance)
    paths.show(RGB)
    return paths.take(samples, 5)


@pytest.mark.parametrize("patches", [(), WAVES], ids=["even", "patchy"])
def test_white_ground_under_fog_and_a_white_sky_is_white(patches: tuple[Wave, ...]) -> None:
    """Nothing is lost: level ground that reflects all, drops that absorb nothing."""
    camera = camera_at((0.0, 0.0, 40.0), (0.0, 10.0, 0.0), (12, 8))
    found = image(flat(1.0, Sky(-30.0, 0.0, 3.0), FogLayer(0.05, 10.0, 3.0, 0.85, patches), camera), 256, 1.0)
    light = found.by_sky + found.beyond
    assert light.mean() == pytest.approx(1.0, abs=0.006)


def test_thin_fog_over_black_ground_shines_by_one_scattering() -> None:
    """L = F p mu0 / (mu0 - mu) (exp(-t / mu0) - exp(-t / mu)), seen from the ground at mu, the sun at mu0."""
    sky = Sky(50.0, 180.0, 2.0)
    layer = FogLayer(0.0002, 20.0, 0.1, 0.85)
    to = np.array([0.0, -1.0, 2.0]) / np.sqrt(5.0)
    x, y, z = 1000.0 * to
    camera = camera_at((0.0, 0.0, 0.01), (x, y, z), (4, 4), 1.0)
    found = image(flat(0.0, sky, layer, camera), 1 << 18, 0.0)
    depth, mu, mu0 = 0.0002 * 20.1, float(to[2]), float(sky.to_sun[2])
    g, cosine = 0.85, float(to @ sky.to_sun)
    phase = (1 - g * g) / (4 * np.pi * (1 + g * g - 2 * g * cosine) ** 1.5)
    once = phase * mu0 / (mu0 - mu) * (np.exp(-depth / mu0) - np.exp(-depth / mu))
    assert found.open.mean() == pytest.approx(np.exp(-depth / mu), abs=2e-3)
    assert found.by_sun.mean(axis=(0, 1)) / sun_irradiance(sky, RGB) == pytest.approx(np.full(3, once), rel=0.02)


def test_dense_fog_loses_no_light_to_the_most_scatterings() -> None:
    """Of a layer of 0.2 a metre, 100 m deep, seen from above: the same with a limit of 64 as with none, and white."""
    camera = camera_at((0.0, 0.0, 140.0), (0.0, 40.0, 0.0), (12, 8))
    spec = flat(0.2, Sky(-30.0, 0.0, 3.0), FogLayer(0.2, 100.0, 0.1, 0.85), camera)
    light = [image(spec, 64, 1.0, depth=depth).by_sky.mean() for depth in (64, 2000)]
    assert light[0] == pytest.approx(light[1], rel=1e-5)
