"""Sun and sky as they are rendered: shadows where they must fall, light on level ground, the scale of Mitsuba's own."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from forestgen.atmosphere.daylight import illuminance
from forestgen.core.frames import look_at
from forestgen.core.spectrum import Spectrum
from forestgen.recipe.load import load_recipe
from forestgen.render.capture import capture
from forestgen.render.light import sun_irradiance
from forestgen.render.skies.model import daylight_of, map_directions
from forestgen.render.skies.overcast import overcast_illuminance
from forestgen.render.variant import SCALAR, drjit, mitsuba, path_tracer, using
from forestgen.scene.colour import RGB, Channels
from forestgen.scene.site import sky_of
from forestgen.scene.spec import Camera, Sky
from support.radiometry import lights

QUICKSTART = Path(__file__).parents[2] / "recipes" / "quickstart.yaml"
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
VISIBLE = Channels((450.0, 553.0, 690.0))
HALF_M, POLE_M = 2.0, 0.8


def from_above(sky: Sky, channels: Channels, things: dict[str, Any], size_px: int, samples: int) -> NDArray[np.float64]:
    """(size, size, 3) radiance of a white plane 4 m wide, seen straight down; the image's top is north."""
    with using(SCALAR) as mi:
        transform = mi.ScalarTransform4f
        scene = {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 2},
            "plane": {
                "type": "rectangle",
                "to_world": transform().scale([20.0, 20.0, 1.0]),
                "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [1.0, 1.0, 1.0]}},
            },
            "sensor": {
                "type": "orthographic",
                "to_world": transform().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0]).scale([HALF_M, HALF_M, 1.0]),
                "film": {"type": "hdrfilm", "width": size_px, "height": size_px, "rfilter": {"type": "box"},
                         "pixel_format": "rgb", "component_format": "float32"},
                "sampler": {"type": "multijitter", "sample_count": samples},
            },
            **lights(sky, channels),
            **things,
        }  # fmt: skip
        return np.array(mi.render(mi.load_dict(scene), seed=1), dtype=np.float64)


def black(shape: dict[str, Any]) -> dict[str, Any]:
    return {**shape, "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.0, 0.0, 0.0]}}}


@pytest.mark.parametrize(
    ("sun", "latitude_deg", "longitude_deg", "azimuth_deg", "elevation_deg"),
    [
        # NREL's published example: Golden, Colorado, zenith 50.11 and azimuth 194.34 degrees.
        ("{date: 2003-10-17, time: '12:30:30', utc_offset_h: -7}", 39.742476, -105.1786, 194.34, 39.89),
        # Sydney at noon of its midwinter: the sun in the north, 90 - 33.87 - 23.44 degrees high.
        ("{date: 2026-06-21, time: '11:57', utc_offset_h: 10}", -33.87, 151.21, 0.0, 32.7),
        # Greenwich on the evening of the equinox: the sun in the west, 3 hours and 52.3 minutes before setting.
        ("{date: 2026-09-22T15:00Z}", 51.4779, 0.0, 236.3, 25.8),
    ],
)
def test_a_pole_throws_its_shadow_away_from_the_sun(
    sun: str, latitude_deg: float, longitude_deg: float, azimuth_deg: float, elevation_deg: float
) -> None:
    place = [f"site.latitude_deg={latitude_deg}", f"site.longitude_deg={longitude_deg}"]
    sky = sky_of(load_recipe(QUICKSTART, [f"sky.sun={sun}", *place]).draw(0).recipe, 0.2)
    pole = black({"type": "cylinder", "p0": [0, 0, 0], "p1": [0, 0, POLE_M], "radius": 0.05})
    marks = {
        f"mark{k}": black({"type": "sphere", "center": [x, y, 0.0], "radius": 0.12})
        for k, (x, y) in enumerate([(1.75, -1.75), (-1.75, 1.75), (1.75, 1.75)])  # none in the south-west
    }
    size_px = 64
    image = from_above(sky, RGB, {"pole": pole, **marks}, size_px, 81) @ LUMINANCE
    x = (np.arange(size_px) + 0.5) / size_px * 2 * HALF_M - HALF_M
    east, north = np.meshgrid(x, -x)
    # The marks tell that the image's columns go east and its rows south.
    corners = [
        image[(np.abs(east - 1.75 * i) < 0.06) & (np.abs(north - 1.75 * j) < 0.06)].max()
        for i, j in ((1, 1), (1, -1), (-1, 1), (-1, -1))
    ]
    assert max(corners[:3]) < 1e-6 < corners[3]
    lit = np.median(image)
    distance = np.hypot(east, north)
    shadow = (image < 0.65 * lit) & (distance > 0.1) & (distance < 1.6)
    assert shadow.sum() > 8
    weight = distance[shadow]
    toward = np.degrees(np.arctan2((weight * east[shadow]).sum(), (weight * north[shadow]).sum()))
    off = (toward - (azimuth_deg + 180.0) + 180.0) % 360.0 - 180.0
    assert abs(off) < 2.5
    length_m = distance[shadow].max()
    assert length_m == pytest.approx(min(POLE_M / np.tan(np.radians(elevation_deg)), 1.6), abs=0.1)


@pytest.mark.parametrize(
    "sky",
    [Sky(60.0, 150.0, 3.0), Sky(30.0, 20.0, 2.0), Sky(5.0, 270.0, 4.0), Sky(40.0, 150.0, 3.0, kind="overcast")],
)
def test_rendered_ground_gets_the_light_of_the_spectra(sky: Sky) -> None:
    light = daylight_of(sky)
    assert ("sun" in lights(sky, RGB)) == (sky.kind == "clear")
    rendered = np.pi * from_above(sky, VISIBLE, {}, 32, 256).mean(axis=(0, 1))
    np.testing.assert_allclose(rendered, light.on_level.at(VISIBLE.wavelength_nm), rtol=0.005)
    in_lux = np.pi * from_above(sky, RGB, {}, 32, 256).mean(axis=(0, 1)) @ LUMINANCE
    assert in_lux == pytest.approx(illuminance(light.on_level), rel=0.005)
    if sky.kind == "overcast":
        assert in_lux == pytest.approx(overcast_illuminance(sky.sun_elevation_deg), rel=0.005)


def test_the_scale_of_mitsubas_own_sky_is_near() -> None:
    """Mitsuba's `sunsky`, in W/m²/sr/nm, against SPCTRL2: another sky, of another haze, on the same scale."""
    elevation_deg, turbidity = 60.0, 3.0
    sky = Sky(elevation_deg, 90.0, turbidity)
    directions = map_directions(129, 256)[:64]
    theta = np.arange(64) * np.pi / 128
    weight = (np.sin(theta) * np.cos(theta) * np.pi / 128 * 2 * np.pi / 256)[:, None]
    mi, dr = mitsuba(), drjit()
    nodes = np.arange(360.0, 721.0, 30.0)
    before = mi.variant()
    mi.set_variant("llvm_ad_spectral")
    try:
        emitter = mi.load_dict({"type": "sunsky", "sun_direction": sky.to_sun.tolist(), "turbidity": turbidity,
                                "albedo": 0.2, "sun_scale": 0.0})  # fmt: skip
        interaction = dr.zeros(mi.SurfaceInteraction3f, directions[..., 0].size)
        flat = directions.reshape(-1, 3).astype(np.float32)
        interaction.wi = mi.Vector3f(*(-mi.Float(np.ascontiguousarray(flat[:, k])) for k in range(3)))
        level = []
        for node in nodes:
            interaction.wavelengths = [float(node)] * 4
            radiance = np.array(emitter.eval(interaction), dtype=np.float64)[0].reshape(directions.shape[:2])
            level.append((radiance * weight).sum())
    finally:
        mi.set_variant(before)
    theirs, ours = Spectrum(nodes, np.array(level)), daylight_of(sky).sky
    assert illuminance(theirs) / illuminance(ours) == pytest.approx(0.72, abs=0.05)
    for nm, ratio in ((450.0, 0.89), (560.0, 0.68), (660.0, 0.60)):
        assert theirs.at(nm) / ours.at(nm) == pytest.approx(ratio, abs=0.05)


def test_a_camera_sees_the_whole_disc_of_the_sun() -> None:
    sky = Sky(42.0, 215.0, 3.0)
    camera = Camera("sun", (0.0, 0.0, 0.0), look_at((0.0, 0.0, 0.0), sky.to_sun.tolist()), (32, 32), 2.0)
    with using(SCALAR) as mi:
        scene = mi.load_dict({"type": "scene", **lights(sky, RGB)})
        image = capture(path_tracer("path", 2), scene, camera, samples=64, seed=3)[..., :3]
    pixel_sr = (2 * np.tan(np.radians(1.0)) / 32) ** 2  # within 0.02% over so small a view
    around = image[0].mean(axis=0)  # the sky beside the disc
    np.testing.assert_allclose(((image - around) * pixel_sr).sum(axis=(0, 1)), sun_irradiance(sky, RGB), rtol=0.01)
