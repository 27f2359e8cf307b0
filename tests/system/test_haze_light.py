"""Haze as it is put over an image, against the same haze traced as a volume; and over all kinds of cameras."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from shots import radiance, seen

from forestgen.atmosphere.grid import CloudGrid
from forestgen.core.parts import Part
from forestgen.core.progress import Timings
from forestgen.core.spectrum import Band, Spectrum
from forestgen.geometry.mesh import Mesh
from forestgen.render.denoise import guide_values, guides_of
from forestgen.render.frame import Radiance
from forestgen.render.haze import (
    ASYMMETRY,
    Haze,
    airlight_of,
    extinction_of,
    extinction_towards,
    seen_of,
    seen_values,
    under_clouds,
)
from forestgen.render.identity import SceneTracer
from forestgen.render.identity.surface import pixel_sums
from forestgen.render.identity.tracer import sample_offsets
from forestgen.render.skies.model import MAP_ROWS, daylight_of
from forestgen.render.variant import SCALAR, drjit, mitsuba, using
from forestgen.render.wavelengths import ColourAtOnce, Pass, quadrature_of
from forestgen.scene.colour import RGB, Channels
from forestgen.scene.projection import rays, world_rays
from forestgen.scene.spec import Camera, Lens, Sky
from support.guides import seen_through_haze, trace_guides, trace_seen
from support.radiometry import lights
from support.scenes import camera_at, plain_ground, scattered_scene
from support.tiers import few

LAYER_M = 1.0  # so low that the wall blocks hardly any of the light that the haze scatters
GREEN = Channels((550.0, 550.0, 550.0))


class Green:
    """An image of one wavelength."""

    names, bands, passes = ("green",), (), 1

    def of_light(self, spectrum) -> list[float]:
        return [float(spectrum.at(550.0))]

    def draw(self, rng, number) -> tuple[Pass, ...]:
        return (Pass(GREEN, np.array([[1.0, 0.0, 0.0]])),)


def wall(sky: Sky, distance_m: float, towards, reflectance: float, haze_per_m: float, samples: int) -> float:
    """Mean radiance of a low wall, seen through a low layer of haze over wide ground: its light is not dimmed."""
    mi = mitsuba()
    frame = mi.ScalarTransform4f()
    eye, target = [0.0, 0.0, LAYER_M / 2], [float(x) for x in np.array(towards) * distance_m + [0, 0, LAYER_M / 2]]

    def grey(value: float) -> dict[str, Any]:
        return {"type": "diffuse", "reflectance": {"type": "rgb", "value": [value] * 3}}

    scene: dict[str, Any] = {
        "type": "scene",
        **lights(sky, GREEN),
        "ground": {
            "type": "rectangle",
            # Below the layer: the renderer lifts rays by decimetres this far out.
            "to_world": frame.translate([0, 0, -5]).scale([60000, 60000, 1]),
            "bsdf": grey(sky.ground_albedo),
        },
        "wall": {
            "type": "rectangle",
            "to_world": frame.look_at(target, eye, [0, 0, 1]) @ frame.scale([LAYER_M, LAYER_M / 2, 1]),
            "bsdf": {"type": "twosided", "bsdf": grey(reflectance)},
        },
    }
    sensor: dict[str, Any] = {
        "type": "perspective",
        "fov": float(np.degrees(2 * np.arctan(0.3 * LAYER_M / distance_m))),
        "to_world": frame.look_at(eye, target, [0, 0, 1]),
        "film": {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}, "pixel_format": "rgb"},
    }
    if haze_per_m:
        phase = {"type": "hg", "g": ASYMMETRY}
        air = mi.load_dict({"type": "homogeneous", "albedo": 1.0, "sigma_t": haze_per_m, "phase": phase})
        size = [6000, 6000, LAYER_M / 2]
        scene["air"] = {
            "type": "cube",
            "to_world": frame.translate([0, 0, LAYER_M / 2]).scale(size),
            "bsdf": {"type": "null"},
            "interior": air,
        }
        sensor["medium"] = air
    integrator = mi.load_dict({"type": "volpath" if haze_per_m else "path", "max_depth": 64, "rr_depth": 32})
    image = integrator.render(mi.load_dict(scene), sensor=mi.load_dict(sensor), spp=samples, seed=1)
    return float(np.array(image)[..., 0].mean())


@pytest.mark.parametrize(
    ("sky", "azimuth_deg"),
    few([(Sky(40, 140, 3), 140.0), (Sky(40, 140, 3), 0.0), (Sky(40, 140, 3, kind="overcast"), 0.0)]),
    ids=["towards the sun", "away from the sun", "overcast"],
)
def test_a_wall_in_haze_is_as_bright_as_in_a_volume(sky, azimuth_deg):
    """At optical depths of 0.2 to 2, black and grey, within 4%."""
    haze, azimuth = Haze(3000.0), np.radians(azimuth_deg)
    towards = np.array([np.sin(azimuth), np.cos(azimuth), 0.0])
    with using(SCALAR):
        air = airlight_of(haze, Green(), sky).unjoined(towards)[0]
        extinction = float(haze.extinction_per_m(np.array(550.0)))
        for distance_m in (150.0, 500.0, 1500.0):
            through = np.exp(-extinction * distance_m)
            for reflectance in (0.0, 0.5):
                truth = wall(sky, distance_m, towards, reflectance, extinction, 1024)
                bare = wall(sky, distance_m, towards, reflectance, 0.0, 256)
                ours = bare * through + air * (1.0 - through)
                assert ours == pytest.approx(truth, rel=0.04), (distance_m, reflectance, ours / truth)


def views() -> dict[str, Camera]:
    look = camera_at((20.0, -30.0, 6.0), (20.0, 20.0, 4.0), (32, 24))
    return {
        "perspective": look,
        "fisheye": replace(look, projection="fisheye", hfov_deg=170.0, size_px=(24, 24)),
        "panorama": replace(look, projection="panorama", size_px=(32, 16)),
        "orthographic": replace(look, projection="orthographic", width_m=60.0),
    }


def stand(camera: Camera, visibility_m: float | None, plants: int = 40):
    ground = plain_ground(-12000, 12000)
    spec = scattered_scene(plants, size_m=40, exemplars=3, leaves=300, terrain=ground, clouds=None, seed=4)
    return replace(spec, cameras=(camera,), sky=replace(spec.sky, visibility_m=visibility_m))


@pytest.mark.parametrize("kind", list(views()))
def test_shares_and_transmittances_are_those_of_the_samples(kind):
    """The identity pass, with as many samples, says how many see the sky; distances of even ground are known."""
    camera = views()[kind]
    spec = stand(camera, 2000.0)
    extinction = np.array([1e-3, 4e-3])
    found = trace_seen(SceneTracer(spec, Timings()), camera, extinction)
    identity, _ = seen(spec, 64)
    whole = found.inside == 1
    up = world_rays(camera).direction[..., 2] > 0.15  # the sliver between ground and horizon counts as surface
    sky = (identity.part == Part.NOTHING).mean(axis=2)
    np.testing.assert_allclose(found.surface[whole & up], 1 - sky[whole & up], atol=1e-9)
    # Even ground, whose distances are known, through the pixels' own samples.
    ground = whole & (identity.part == Part.GROUND).all(axis=2)
    assert ground.any()
    expected = np.mean([np.exp(-ground_distance(camera, *at)[..., None] * extinction) for at in sample_offsets(64)], 0)
    np.testing.assert_allclose(found.transmittance[ground], expected[ground], rtol=2e-3)


def test_the_rays_are_traced_once_for_all_channels():
    camera, dr = views()["perspective"], drjit()
    tracer = SceneTracer(stand(camera, 2000.0), Timings())
    with using(tracer.variant), dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        trace_seen(tracer, camera, np.array([1e-3, 2e-3, 4e-3]))
        launched = [kernel for kernel in dr.kernel_history() if kernel["type"] == dr.KernelType.JIT]
    assert len(launched) == 1


def test_guides_and_haze_share_their_rays():
    """One launch finds both, equal to the last bit to what each finds alone."""
    camera, dr = views()["perspective"], drjit()
    tracer, extinction = SceneTracer(stand(camera, 2000.0), Timings()), np.array([1e-3, 4e-3])
    alone = trace_guides(tracer, camera), trace_seen(tracer, camera, extinction)
    with using(tracer.variant), dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        sums = pixel_sums(tracer, camera, [guide_values(tracer, camera), seen_values(tracer, camera, extinction)])
        launched = [kernel for kernel in dr.kernel_history() if kernel["type"] == dr.KernelType.JIT]
    assert len(launched) == 1
    for ours, theirs in zip((guides_of(sums[0]), seen_of(sums[1])), alone, strict=True):
        for name, value in vars(ours).items():
            np.testing.assert_array_equal(value, getattr(theirs, name))


def test_haze_under_a_roof_is_in_shadow():
    """The sun overhead, and a roof over 60 of the 200 m to the ground that is seen: 70% of the haze is sunny."""
    camera = camera_at((0.0, 0.0, 2.0), (0.0, 200.0, 0.0), (16, 16), hfov_deg=0.01)
    bare = stand(camera, 300_000.0, plants=1)
    corners = np.array([[-3000, 0, 9], [3000, 0, 9], [3000, 60, 9], [-3000, 60, 9]], np.float32)
    roof = Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]], np.uint32))
    organ = replace(bare.exemplars[0].organs[0], mesh=roof)
    over = replace(bare.exemplars[0], organs=(organ,))
    instances = replace(bare.instances, exemplar=np.zeros(1, np.uint32), transform=np.eye(3, 4)[None])
    sky = replace(bare.sky, sun_elevation_deg=90.0)
    spec = replace(bare, exemplars=(over,), instances=instances, sky=sky)
    found = trace_seen(SceneTracer(spec, Timings()), camera, np.array([1e-5, 2e-5]))
    assert found.sunny.mean() == pytest.approx(0.7, abs=0.05)
    # Beyond the roof half of the sky and more is open; below it, towards the south alone and little.
    assert 0.55 < found.open.mean() < 0.85
    open_land = trace_seen(
        SceneTracer(replace(spec, instances=instances.at(slice(0))), Timings()), camera, np.ones(1) * 1e-5
    )
    assert open_land.sunny.mean() == pytest.approx(1.0, abs=0.05)
    assert open_land.open.mean() == pytest.approx(1.0, abs=0.05)


def ground_distance(camera: Camera, dx: float, dy: float):
    """(H, W) along rays through places of the pixels."""
    columns, rows = np.meshgrid(np.arange(camera.size_px[0]) + dx, np.arange(camera.size_px[1]) + dy)
    own = rays(camera, columns, rows)
    start = own.origin_m @ camera.world_from_camera[2] + camera.position_m[2]
    fall = -(own.direction @ camera.world_from_camera[2])
    return np.where(fall > 0, start / np.where(fall > 0, fall, 1.0), np.inf)


@pytest.mark.parametrize("kind", list(views()))
def test_every_camera_sees_through_haze(kind):
    """Far ground takes the horizon's colour, sky keeps its own, and what is near is hardly changed."""
    camera = views()[kind]
    spec = stand(camera, 1500.0, plants=0)
    clear = radiance(stand(camera, None, plants=0), 16, seed=1)
    tracer = SceneTracer(spec, Timings())
    hazy = seen_through_haze(clear, tracer, camera, "rgb")
    identity, surface = seen(spec, 16)
    sky = (identity.part == Part.NOTHING).all(axis=2) & (world_rays(camera).direction[..., 2] > 0.25)
    np.testing.assert_array_equal(hazy.mean[sky], clear.mean[sky])
    np.testing.assert_array_equal(hazy.variance[sky], clear.variance[sky])
    light = airlight_of(Haze(1500.0), ColourAtOnce(), spec.sky)
    extinction = extinction_of(Haze(1500.0), ColourAtOnce(), spec.sky)
    ground = (identity.part == Part.GROUND).all(axis=2) & (surface.distance_m < 40)
    direction = world_rays(camera).direction[ground]
    through = np.exp(-surface.distance_m[ground, None] * extinction)
    expected = clear.mean[ground] * through + light.towards(direction) * (1 - through)
    np.testing.assert_allclose(hazy.mean[ground], expected, rtol=0.03)


def test_no_haze_takes_no_light():
    camera = views()["perspective"]
    assert extinction_towards(camera, stand(camera, None).sky, "rgb") is None


def under(depth: float, base_m: float = 600.0) -> Any:
    """A stand under a closed sheet of cloud of an optical depth."""
    value = np.full((4, 8, 8), depth / 200.0, np.float32)
    clouds = CloudGrid(value, (-15000, -15000, base_m), (15000, 15000, base_m + 200.0))
    return replace(stand(views()["perspective"], 3000.0, plants=0), clouds=clouds)


@pytest.mark.slow
def test_airlight_under_clouds_is_that_of_their_light():
    """Below a closed sheet it is half the sheet's light, half the ground's; under next to nothing the clear sky's."""
    haze, colour = Haze(3000.0), ColourAtOnce()
    angle = np.radians(np.arange(0, 360, 30))
    level = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
    with using(SCALAR):
        none = under_clouds(under(0.0))
        clear = airlight_of(haze, colour, under(0.0).sky, none).towards(level)
        found, share = [], []
        for depth in (0.02, 40.0):
            spec = under(depth)
            below = under_clouds(spec)
            assert below is not None
            assert below.sun_share == pytest.approx(np.exp(-depth / spec.sky.to_sun[2]), abs=0.02)
            light = below.on_level(below.sky.radiance(RGB), spec.sky, RGB)
            share.append(light / RGB.of_light(daylight_of(spec.sky).on_level))
            found.append(airlight_of(haze, colour, spec.sky, below))
    assert none is None
    np.testing.assert_allclose(found[0].towards(level), clear, rtol=0.08)
    # Light from all around, of no direction: half of the haze's comes from the sheet, half from the ground.
    thick = found[1].towards(level)
    even = share[1] * RGB.of_light(daylight_of(under(0.0).sky).on_level) / np.pi
    assert (share[1] < 0.4).all()
    assert (thick < 0.5 * clear.mean(axis=0)).all()
    assert (np.abs(thick / (even * (1 + under(0.0).sky.ground_albedo) / 2) - 1) < 0.35).all()
    # What it hides takes the airlight's colour too, instead of the clear sky's.
    np.testing.assert_allclose(found[1].open_sky[MAP_ROWS // 2].mean(axis=0), thick.mean(axis=0), rtol=0.05)


@pytest.mark.slow
def test_haze_under_thick_clouds_adds_no_sunlight():
    camera = views()["perspective"]
    black = Radiance(np.zeros((24, 32, 3), np.float32), np.zeros((24, 32, 3), np.float32), None, 4)
    far = world_rays(camera).direction[..., 2] < -0.02
    seen_light = {}
    for depth in (0.0, 10.0):
        tracer = SceneTracer(under(depth), Timings())
        seen_light[depth] = seen_through_haze(black, tracer, camera, "rgb").mean[far].mean()
    assert 0 < seen_light[10.0] < 0.7 * seen_light[0.0]


@pytest.mark.parametrize("kind", ["bands", "spectral", "lens", "clouds"])
def test_near_infrared_lenses_and_clouds_go_through_haze_too(kind):
    """Longer waves are dimmed less; and what sees surfaces alone gets the channels' own airlight and nothing else."""
    camera = replace(views()["perspective"], size_px=(16, 12))
    if kind == "bands":
        bands = [
            Band(str(nm), Spectrum(np.array([nm - 9.0, nm, nm + 9.0]), np.array([0.0, 1.0, 0.0]))) for nm in (450, 860)
        ]
        camera = replace(camera, bands=tuple(bands))
    if kind == "lens":
        camera = replace(camera, lens=Lens(0.05, 20.0))
    spec = stand(camera, 5000.0)
    if kind == "clouds":
        field = np.random.default_rng(1).uniform(0, 0.02, (4, 8, 8)).astype(np.float32)
        spec = replace(spec, clouds=CloudGrid(field, (-3000, -3000, 800), (3000, 3000, 1000)))
    mode = "spectral" if kind == "spectral" else "rgb"
    channels = 2 if kind == "bands" else 3
    clear = Radiance(np.full((12, 16, channels), 0.01, np.float32), np.ones((12, 16, channels), np.float32), None, 4)
    tracer = SceneTracer(spec, Timings())
    hazy = seen_through_haze(clear, tracer, camera, mode)
    quadrature = quadrature_of(camera, mode, daylight_of(spec.sky).on_level)
    extinction = extinction_of(Haze(5000.0), quadrature, spec.sky)
    assert np.isfinite(hazy.mean).all()
    found = trace_seen(tracer, camera, extinction)
    with using(SCALAR):
        light = airlight_of(Haze(5000.0), quadrature, spec.sky, under_clouds(spec))
    whole = (found.inside == 1) & (found.surface == 1)
    assert whole.mean() > 0.2
    through = found.transmittance[whole]
    air = light.towards(world_rays(camera).direction[whole], found.sunny[whole], found.open[whole])
    expected = 0.01 * through + air * (1 - through)
    np.testing.assert_allclose(hazy.mean[whole], expected, rtol=1e-5)
    assert (expected > 0.02).any()
    if kind == "bands":
        assert extinction[1] < 0.6 * extinction[0]
