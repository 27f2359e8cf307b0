"""Light in scenes whose answer is known exactly: level ground, white furnaces, exchanged source and eye, energy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from shots import radiance

from forestgen.core.parts import Part
from forestgen.core.progress import Timings
from forestgen.plants.bark.texture import SurfaceTexture
from forestgen.render.build import load, origin_of, scene_dict
from forestgen.render.capture import capture
from forestgen.render.identity import SceneTracer, trace_identity
from forestgen.render.light import sky_light, sun_disc
from forestgen.render.skies.model import daylight_of
from forestgen.render.surfaces import SpectralBsdfs, repaint
from forestgen.render.variant import BLOCK_PX, ROULETTE_DEPTH, SCALAR, using
from forestgen.scene.colour import RGB, Channels
from forestgen.scene.spec import Instances, Material, SceneSpec, Sky
from support.radiometry import (
    Mean,
    Square,
    facets_of,
    flux_through,
    light_on,
    outgoing,
    path_integrator,
    upper_sky,
)
from support.scenes import camera_at, plain_ground, scattered_scene, shifted, simple_tree
from support.turbid import SPHERICAL, strew, tiled

ALBEDO = 0.3
PASSES = {"colour": RGB, "wavelengths": Channels((450.0, 550.0, 865.0))}


def path(max_depth: int = 64, rr_depth: int = ROULETTE_DEPTH) -> dict:
    return {"type": "path", "max_depth": max_depth, "rr_depth": rr_depth, "block_size": BLOCK_PX}


def loaded(spec: SceneSpec, lights: dict, channels: Channels = RGB, origin_m=None):
    origin = origin_of(spec.cameras[0]) if origin_m is None else origin_m
    return load({**scene_dict(spec, origin, SpectralBsdfs(channels)), **lights})


def bare_ground(sky: Sky) -> SceneSpec:
    none = Instances(np.zeros(0, np.uint32), np.zeros((0, 3, 4)), np.zeros(0, np.uint32))
    spec = scattered_scene(1, exemplars=1, leaves=4, terrain=plain_ground(-20000, 20000, albedo=ALBEDO))
    return replace(spec, instances=none, sky=sky, cameras=(camera_at((0, 0, 10), (3, 4, 0), (16, 16)),))


def two_lights(sky: Sky, channels: Channels) -> dict:
    return {"sky": sky_light(sky, channels), "sun": sun_disc(sky, channels)}


@pytest.mark.parametrize("zenith_deg", [0, 30, 60])
@pytest.mark.parametrize("channels", PASSES.values(), ids=PASSES)
def test_a_lambertian_plane_under_sun_and_sky(channels, zenith_deg):
    """L = rho E / pi, where E = E_sun cos(zenith) + E_sky are the spectra of the daylight model."""
    spec = bare_ground(Sky(90.0 - zenith_deg, 140.0, 3.0))
    light = daylight_of(spec.sky)
    reflected = channels.of_surface((ALBEDO,) * 3, None) / np.pi
    expected = {
        "sun": reflected * channels.of_light(light.sun) * np.cos(np.radians(zenith_deg)),
        "sky": reflected * channels.of_light(light.sky),
    }
    with using(SCALAR) as mi:
        lights = two_lights(spec.sky, channels)
        for names, limit in ((("sun",), 1e-4), (("sky",), 0.004), (("sun", "sky"), 0.003)):
            scene = loaded(spec, {name: lights[name] for name in names}, channels)
            image = capture(mi.load_dict(path()), scene, spec.cameras[0], samples=256, seed=2)
            seen = image[..., :3].mean(axis=(0, 1))
            np.testing.assert_allclose(seen, sum(expected[name] for name in names), rtol=limit)


def stand(plants: int = 50, size_px=(48, 27)) -> SceneSpec:
    ground = plain_ground(-3000, 3000, albedo=0.2)
    return scattered_scene(plants, size_m=25, exemplars=3, leaves=500, size_px=size_px, terrain=ground, seed=8)


def test_radiance_scales_with_irradiance():
    """Lights twice, and a thousandth, as bright: the image follows, path by path."""
    spec = stand()
    with using(SCALAR) as mi:
        sky = mi.load_dict(sky_light(spec.sky, RGB))
        sun = mi.load_dict(sun_disc(spec.sky, RGB))
        scene, camera, integrator = loaded(spec, {"sky": sky, "sun": sun}), spec.cameras[0], mi.load_dict(path())
        once = capture(integrator, scene, camera, samples=4, seed=5)[..., :3]
        for factor in (2.0, 0.001):
            for emitter, dictionary in ((sky, sky_light(spec.sky, RGB)), (sun, sun_disc(spec.sky, RGB))):
                repaint(emitter, mi.load_dict(brighter(dictionary, factor)))
            seen = capture(integrator, scene, camera, samples=4, seed=5)[..., :3]
            np.testing.assert_allclose(seen.mean(axis=(0, 1)), factor * once.mean(axis=(0, 1)), rtol=1e-4)
            np.testing.assert_allclose(seen, factor * once, rtol=1e-3, atol=factor * 1e-3 * once.mean())


def brighter(dictionary: dict, factor: float) -> dict:
    """An emitter `factor` times as bright."""
    from forestgen.render.variant import mitsuba

    if dictionary["type"] == "envmap":
        return dictionary | {"bitmap": mitsuba().Bitmap(np.array(dictionary["bitmap"]) * np.float32(factor))}
    value = [factor * x for x in dictionary["emitter"]["radiance"]["value"]]
    return dictionary | {"emitter": dictionary["emitter"] | {"radiance": {"type": "rgb", "value": value}}}


def test_light_of_sun_and_sky_adds_up():
    spec = stand()
    with using(SCALAR) as mi:
        lights, integrator = two_lights(spec.sky, RGB), mi.load_dict(path())
        means, errors = [], []
        for names in (("sun", "sky"), ("sun",), ("sky",)):
            scene = loaded(spec, {name: lights[name] for name in names})
            images = [
                capture(integrator, scene, spec.cameras[0], samples=16, seed=10 * len(means) + k) for k in range(8)
            ]
            parts = np.array([image[..., :3].mean(axis=(0, 1)) for image in images])
            means.append(parts.mean(axis=0))
            errors.append(parts.std(axis=0, ddof=1) / np.sqrt(len(parts)))
    error = np.sqrt(sum(np.square(errors)))
    assert np.all(error < 0.01 * means[0])
    assert np.all(np.abs(means[0] - means[1] - means[2]) < 3.5 * error)


GREY = Material((0.6, 0.6, 0.6), (0.4, 0.4, 0.4))
COLOURED = Material((0.5, 0.7, 1.0), (0.5, 0.3, 0.0), gloss=0.03)


def white_forest(leaf: Material = COLOURED, plants: int = 60, size_m: float = 20.0, leaves: int = 800) -> SceneSpec:
    """Leaves that return all light; white bark with a texture; white soil; trees of 0.7 to 1.3 times their size."""
    ground = plain_ground(-3000, 3000, albedo=1.0)
    spec = scattered_scene(plants, size_m=size_m, exemplars=4, leaves=leaves, size_px=(64, 36), terrain=ground, seed=4)
    ones = SurfaceTexture(np.ones((16, 16, 3), dtype=np.float32), np.zeros((16, 16), dtype=np.float32), (0.1, 0.1))
    materials = {key: Material((1.0, 1.0, 1.0), texture=ones) if key[1] == "bark" else leaf for key in spec.materials}
    exemplars = tuple(replace(one, organs=tuple(unwrapped(organ) for organ in one.organs)) for one in spec.exemplars)
    return replace(spec, materials=materials, exemplars=exemplars)


def unwrapped(organ):
    """Bark with uv, so that its texture is used."""
    if organ.part is not Part.TRUNK:
        return organ
    return replace(organ, mesh=replace(organ.mesh, uv=organ.mesh.vertices_m[:, [0, 2]].copy()))


def regions(spec: SceneSpec) -> dict[str, np.ndarray]:
    """Pixels that show nothing else than one part, near or far."""
    camera, timings = spec.cameras[0], Timings()
    identity, surface = trace_identity(
        SceneTracer(spec, timings), camera, samples=4, timer=timings, advance=lambda rows: None
    )
    whole = (identity.part == identity.part[..., :1]).all(axis=-1)
    far = surface.depth_m > np.median(surface.depth_m[np.isfinite(surface.depth_m)])
    found = {
        f"{part.name} {'far' if away else 'near'}": whole & (surface.part == part) & (far == away)
        for part in (Part.GROUND, Part.TRUNK, Part.LEAF)
        for away in (False, True)
    }
    return {name: region for name, region in found.items() if region.sum() >= 8}


def white_images(spec: SceneSpec, lights: dict, integrator: dict, samples: int, count: int) -> np.ndarray:
    """(count, H, W, 3) independent images."""
    with using(SCALAR) as mi:
        scene, made = loaded(spec, lights), mi.load_dict(integrator)
        images = [capture(made, scene, spec.cameras[0], samples=samples, seed=k)[..., :3] for k in range(count)]
    return np.array(images)


def test_a_white_furnace_stays_white():
    """Radiance 1 from everywhere, and nothing that absorbs: 1 in every pixel, path by path, in a dense forest.

    Neither limit nor roulette ends a path here, and light is found by scattering alone: so a path brings just what its
    scatterings left of it. The other emitter shines not; it takes the light samples. A limit of 64 scatterings, the
    recipe's default, takes 14% from this forest, one of 256 takes 0.05%; leaves that absorb a tenth leave it nothing
    to take.
    """
    dark = {"type": "sphere", "center": [0, 0, 1e4], "emitter": {"type": "area", "radiance": 0.0}}
    lights = {"light": {"type": "constant", "radiance": 1.0, "sampling_weight": 0.0}, "dark": dark}
    spec = replace(white_forest(GREY, 200, 16.0, 6000), cameras=(camera_at((8, 8, 1.5), (8, 14, 2), (48, 27)),))
    image = white_images(spec, lights, path(-1, 1_000_000), 4, 1)[0]
    assert np.abs(image - 1.0).max() < 0.002
    assert np.abs(image.mean(axis=(0, 1)) - 1.0).max() < 0.0005
    assert path_share(spec, lights, 64) < 0.95


def path_share(spec: SceneSpec, lights: dict, max_depth: int) -> float:
    """Share of the light that a limit of scatterings leaves: that the forest is dense enough to tell."""
    return float(white_images(spec, lights, path(max_depth, 1_000_000), 1, 1)[0].mean())


def test_a_white_furnace_stays_white_with_roulette_and_light_sampling():
    """As images are made, but for the limit of scatterings: each region's mean is 1 within its noise."""
    spec = white_forest()
    images = white_images(spec, {"light": {"type": "constant", "radiance": 1.0}}, path(-1), 16, 8)
    found = regions(spec) | {"all": np.ones(images.shape[1:3], dtype=bool)}
    assert {"GROUND near", "LEAF near", "LEAF far"} <= set(found)
    for name, region in found.items():
        means = images[:, region].mean(axis=1)
        error = means.std(axis=0, ddof=1) / np.sqrt(len(means))
        assert np.all(np.abs(means.mean(axis=0) - 1.0) < 4 * error), name
    assert np.abs(images.mean(axis=(0, 1, 2)) - 1.0).max() < 0.002


def slab_scene(light: dict, material: Material, soil: float = 0.3):
    """A slab of leaves that repeats sideways, 50 times its depth wide."""
    leaves = strew(1.5, 0.02, 1.0, 1.0, SPHERICAL, np.random.default_rng(3), exact=True)
    spec = tiled(leaves, material, 51, plain_ground(-30, 30, albedo=soil), camera_at((0, 0, 3), (0, 0.01, 0), (8, 8)))
    return loaded(spec, {"light": light}, origin_m=np.zeros(3))


def towards(zenith_deg: float, azimuth_deg: float) -> np.ndarray:
    zenith, azimuth = np.radians([zenith_deg, azimuth_deg])
    return np.array([np.sin(zenith) * np.cos(azimuth), np.sin(zenith) * np.sin(azimuth), np.cos(zenith)])


def test_sun_and_eye_may_change_places():
    """Reciprocity of a canopy: bidirectional reflectance from a to b is that from b to a, glossy leaves and all."""
    material = Material((0.45, 0.10, 0.06), (0.40, 0.02, 0.05), roughness=0.4, gloss=0.02)
    first, second = towards(20, 30), towards(65, 160)
    factors = []
    for sun, eye in ((first, second), (second, first)):
        with using(SCALAR):
            light = {"type": "directional", "direction": (-sun).tolist(), "irradiance": 1.0}
            scene = slab_scene(light, material)
            seen = outgoing(scene, path_integrator(), Square(0.5, 1.03), eye, rays=32000, seed=9)
        factors.append(seen * (np.pi / sun[2]))
    one, other = factors
    error = np.hypot(one.error, other.error)
    assert np.all(error < 0.02 * one.value)
    assert np.all(np.abs(one.value - other.value) < 3.5 * error)


TILE_M = 4.0


def orchard(material: Material, bark: Material) -> tuple[SceneSpec, np.ndarray]:
    """Trees of several sizes on black soil, in a pattern that repeats every 4 m; and rows of the middle tile."""
    rng = np.random.default_rng(6)
    trees = tuple(simple_tree("tree", height, 700, rng) for height in (3.0, 4.5))
    tiles, each = 41, 5
    turn, scale, at = rng.random(each) * 2 * np.pi, 0.7 + 0.6 * rng.random(each), rng.random((each, 2)) * TILE_M
    place = np.stack(np.meshgrid(*[np.arange(tiles) - tiles // 2] * 2), axis=-1).reshape(-1, 1, 2) * TILE_M
    transform = np.zeros((tiles**2, each, 3, 4))
    transform[..., 0, 0] = transform[..., 1, 1] = np.cos(turn) * scale
    transform[..., 0, 1], transform[..., 1, 0] = -np.sin(turn) * scale, np.sin(turn) * scale
    transform[..., 2, 2] = scale
    transform[..., :2, 3] = at - TILE_M / 2 + place
    count = tiles**2 * each
    spec = replace(
        scattered_scene(1, exemplars=1, leaves=4, terrain=plain_ground(-100, 100, albedo=0.0)),
        exemplars=trees,
        materials={("tree", "leaf"): material, ("tree", "bark"): bark},
        instances=Instances(
            np.tile(np.arange(each, dtype=np.uint32) % 2, tiles**2),
            transform.reshape(-1, 3, 4),
            np.arange(1, count + 1, dtype=np.uint32),
        ),
    )
    middle = (tiles**2 // 2) * each
    return spec, np.arange(middle, middle + each)


@pytest.mark.slow
@pytest.mark.parametrize("effort", [1, pytest.param(6, marks=pytest.mark.slow)])
def test_energy_is_conserved_in_a_canopy(effort):
    """Reflected, absorbed and transmitted light add up to what comes in: three measurements of their own.

    What is absorbed is found from the light that falls on points of all leaves and trunks, by their material's
    1 - R - T; the other two are fluxes through level planes above and below the canopy.
    """
    leaf, bark = Material((0.45, 0.10, 0.06), (0.45, 0.12, 0.01)), Material((0.4, 0.2, 0.1))
    spec, rows = orchard(leaf, bark)
    incident = np.pi * TILE_M**2
    with using(SCALAR):
        scene, integrator = loaded(spec, {"light": upper_sky()}, origin_m=np.zeros(3)), path_integrator()
        top = max(tree.height_m for tree in spec.exemplars) * 1.3 + 0.01
        flux = {
            up: flux_through(scene, integrator, Square(TILE_M / 2, height), upward=up, rays=rays * effort, seed=1)
            * (TILE_M**2 / incident)
            for up, height, rays in ((True, top, 32000), (False, 2e-3, 96000))
        }
        taken = Mean(np.zeros(3), np.zeros(3))
        for part, material, sides, rays in ((Part.LEAF, leaf, 2, 96000), (Part.TRUNK, bark, 1, 8000)):
            light = light_on(scene, integrator, facets_of(spec, rows, part), sides=sides, rays=rays * effort, seed=2)
            absorptance = 1.0 - np.array(material.reflectance) - material.transmittance
            taken = taken + light * (absorptance / incident)
    total = flux[True] + flux[False] + taken
    assert np.all(flux[True].value > 0.01)
    assert np.all(taken.value > 0.05)
    assert np.all(total.error < 0.0025 / np.sqrt(effort))
    assert np.all(np.abs(total.value - 1.0) < 0.005)


def test_a_repainted_scene_is_one_built_anew():
    """Plants, ground and lights given other wavelengths in place: the image has the same bytes."""
    spec, channels = stand(), Channels((450.0, 670.0, 865.0))
    glossy = {key: replace(one, gloss=0.02 if key[1] == "leaf" else 0.0) for key, one in spec.materials.items()}
    spec = replace(spec, materials=glossy)
    with using(SCALAR) as mi:
        paints, integrator = SpectralBsdfs(), mi.load_dict(path())
        lights = {name: mi.load_dict(one) for name, one in two_lights(spec.sky, RGB).items()}
        scene = load({**scene_dict(spec, origin_of(spec.cameras[0]), paints), **lights})
        for passes in (channels, RGB):
            paints.repaint(passes)
            for name, one in two_lights(spec.sky, passes).items():
                repaint(lights[name], mi.load_dict(one))
            fresh = loaded(spec, two_lights(spec.sky, passes), passes)
            ours, theirs = (capture(integrator, one, spec.cameras[0], samples=4, seed=2) for one in (scene, fresh))
            assert np.array_equal(ours, theirs)


@pytest.mark.parametrize("by_m", [(1000.0, 0.0, 0.0), (-700.0, 700.0, 100.0)])
def test_moving_the_scene_changes_no_region(by_m):
    """Scene and camera a kilometre away, same paths: each block of 8 x 8 pixels keeps its mean within 0.3%."""
    spec = stand(plants=200, size_px=(64, 40))
    images = []
    with using(SCALAR) as mi:
        for one in (spec, shifted(spec, by_m)):
            scene = loaded(one, two_lights(one.sky, RGB))
            images.append(capture(mi.load_dict(path()), scene, one.cameras[0], samples=16, seed=3)[..., :3])
    ours = [radiance(one, 64, seed=3).mean for one in (spec, shifted(spec, by_m))]
    for here, there in (images, ours):
        blocks = [image.reshape(5, 8, 8, 8, 3).mean(axis=(1, 3)) for image in (here, there)]
        np.testing.assert_allclose(blocks[1], blocks[0], rtol=0.003)
