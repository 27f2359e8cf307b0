"""Radiance of the sky by direction, and of the sun's disc, and their emitters; sky models are parts (render/skies).

Decisions
---------
- The sun is a disc of its own, far away, so that penumbrae are right, and shadow rays go to it alone. It has one
  radiance, the mean; in truth its middle is up to a quarter brighter than that and its limb half as bright, which only
  penumbrae could show. Its size is that of the mean distance.
- By night the moon is in its place. It has the sun's size, which is 3% more than its own. Its phase is seen by
  Lommel and Seeliger's law, in which a full moon is even; dark plains on it are left out.
- A colour outside of Rec. 709, as of a sun at the horizon, is cut off at its edge, its luminance kept.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.daylight import air_of, sunlight_aloft
from forestgen.core.spectrum import LUMINANCE
from forestgen.render.skies.model import MAP_COLUMNS, MAP_ROWS, daylight_of, sky_model_of
from forestgen.render.variant import SKY_BESIDE_SUN_WEIGHT, mi
from forestgen.scene.colour import RGB, Channels
from forestgen.scene.spec import Sky

SUN_RADIUS_DEG = 0.2665  # at the earth's mean distance
_SUN_SOLID_ANGLE_SR = float(np.pi * np.sin(np.radians(SUN_RADIUS_DEG)) ** 2)  # projected on a plane that faces it
Floats = NDArray[np.float64]
_SUN_DISTANCE_M = 1e6
_MOON_PX = 200  # of the picture of the disc, across
_NEWEST_DEG = 175.0  # of a phase: a thinner crescent has no width


def along(values: NDArray[np.floating], direction: Floats) -> Floats:
    """(..., C) values of a map (R, Q, C) along (..., 3) unit directions, bilinear as the renderer has its sky.

    The map's directions are those of `map_directions`; one of a single row is the same at all heights.
    """
    rows, columns = values.shape[:2]
    x, y, z = np.moveaxis(direction, -1, 0)
    row = np.arctan2(np.hypot(x, y), z) / np.pi * (rows - 1)
    column = np.arctan2(y, x) / (2.0 * np.pi) * columns - 0.5
    top, left = np.clip(np.floor(row).astype(np.int64), 0, max(rows - 2, 0)), np.floor(column).astype(np.int64)
    down, right = (row - top)[..., None], (column - left)[..., None]
    below, first, second = np.minimum(top + 1, rows - 1), left % columns, (left + 1) % columns
    upper = values[top, first] * (1.0 - right) + values[top, second] * right
    lower = values[below, first] * (1.0 - right) + values[below, second] * right
    return np.asarray(upper * (1.0 - down) + lower * down)


def sky_map(sky: Sky, channels: Channels) -> NDArray[np.float32]:
    """(MAP_ROWS, MAP_COLUMNS, 3) radiance without the sun, black below the horizon: W/m²/sr/nm; colour in cd/m²."""
    result = np.zeros((MAP_ROWS, MAP_COLUMNS, 3), dtype=np.float32)
    result[: MAP_ROWS // 2 + 1] = sky_model_of(sky).radiance(sky, daylight_of(sky).sky, channels)
    return _within_gamut(result) if channels.wavelength_nm is None else result


def sun_radiance(sky: Sky, channels: Channels, aloft_m: float = 0.0) -> Floats:
    """(3,) mean radiance of the sun's disc, in the same units; zero under an overcast sky.

    `aloft_m`: as clouds so high above the ground scatter it down; see `daylight.sunlight_aloft`.
    """
    light = daylight_of(sky).sun
    if aloft_m > 0.0 and light.value.any():
        air = air_of(sky.turbidity, sky.altitude_m, sky.precipitable_water_mm, sky.ozone_du)
        light = sunlight_aloft(light, float(np.degrees(np.arcsin(sky.to_light[2]))), air, sky.altitude_m, aloft_m)
    radiance = channels.of_light(light) / _SUN_SOLID_ANGLE_SR
    return np.asarray(_within_gamut(radiance) if channels.wavelength_nm is None else radiance)


@dataclass(frozen=True)
class MoonPhase:
    """Which part of the moon's disc shines."""

    to_sun: Floats  # (3,) unit, world
    angle_rad: float  # at the moon, between sun and site
    mean: float  # of the law over the whole disc


def moon_phase(sky: Sky) -> MoonPhase | None:
    """Of the disc of a sky; None: it is the sun's, which shines all over."""
    if sky.moon_by_night is None:
        return None
    angle = float(np.radians(min(sky.moon_by_night.phase_angle_deg, _NEWEST_DEG)))
    x, y = np.meshgrid(*[(np.arange(400) + 0.5) / 200 - 1.0] * 2)
    up = np.sqrt(np.maximum(1.0 - x**2 - y**2, 0.0))
    facing = np.maximum(np.sin(angle) * x + np.cos(angle) * up, 0.0)
    law = facing / np.maximum(facing + up, 1e-9)
    return MoonPhase(sky.to_sun, angle, float(law[x**2 + y**2 < 1].mean()))


def sun_irradiance(sky: Sky, channels: Channels, aloft_m: float = 0.0) -> Floats:
    """(3,) light of the disc on a plane that faces it: the radiance times its solid angle."""
    return sun_radiance(sky, channels, aloft_m) * _SUN_SOLID_ANGLE_SR


def _within_gamut(colour: NDArray[Any]) -> NDArray[Any]:
    """(..., 3) colours without negative parts, of the same luminance and type."""
    cut = np.maximum(colour, 0)
    weight = np.array(LUMINANCE, dtype=colour.dtype)
    scale = (colour @ weight) / np.maximum(cut @ weight, np.finfo(colour.dtype).tiny)
    return np.asarray(cut * scale[..., None])


def has_sun(sky: Sky) -> bool:
    """Whether the sun shines: an overcast sky has none."""
    return bool(sun_radiance(sky, RGB).any())


def emitters_of(sky: Sky) -> dict[str, Callable[[Channels], dict[str, Any]]]:
    """All lights of a cloudless scene by name, as functions of the channels."""
    if not has_sun(sky):
        return {"sky": partial(sky_light, sky)}
    weight = {"sampling_weight": SKY_BESIDE_SUN_WEIGHT}  # light samples are better spent on the sun
    return {"sky": lambda channels: sky_light(sky, channels) | weight, "sun": partial(sun_disc, sky)}


def sky_light(sky: Sky, channels: Channels) -> dict[str, Any]:
    """The sky without its sun."""
    return envmap(sky_map(sky, channels))


def sun_disc(sky: Sky, channels: Channels) -> dict[str, Any]:
    """The sun: a disc that shines."""
    to_sun = sky.to_light
    radius = _SUN_DISTANCE_M * np.tan(np.radians(SUN_RADIUS_DEG))
    centre = (_SUN_DISTANCE_M * to_sun).tolist()
    up = [1.0, 0.0, 0.0] if abs(to_sun[0]) < 0.9 else [0.0, 1.0, 0.0]
    radiance, black = sun_radiance(sky, channels), {"type": "rgb", "value": [0.0, 0.0, 0.0]}
    to_world = mi.ScalarTransform4f().look_at(centre, [0, 0, 0], up).scale([radius, radius, 1.0])
    disc = {"to_world": to_world, "bsdf": {"type": "diffuse", "reflectance": black}}
    phase = moon_phase(sky)
    if phase is None:
        shines = {"type": "rgb", "value": [float(value) for value in radiance]}
        return {"type": "disk", **disc, "emitter": {"type": "area", "radiance": shines}}
    # A square that shines where the moon does: the renderer's disc takes no picture.
    law = _moon_picture(phase, np.array(to_world.matrix, dtype=np.float64)[:3, :3] / [radius, radius, 1.0])
    shines, there = (_texture(one) for one in (law[..., None] * radiance, np.where(law < 0, 0.0, 1.0)[..., None]))
    bsdf = {"type": "mask", "opacity": there, "nested": disc["bsdf"]}
    return {"type": "rectangle", **disc, "bsdf": bsdf, "emitter": {"type": "area", "radiance": shines}}


def _texture(image: Floats) -> dict[str, Any]:
    bitmap = mi.Bitmap(np.ascontiguousarray(np.maximum(image, 0.0), dtype=np.float32))
    return {"type": "bitmap", "bitmap": bitmap, "raw": True, "filter_type": "nearest", "wrap_mode": "clamp"}


def _moon_picture(phase: MoonPhase, axes: Floats) -> Floats:
    """Square of the disc's radiance over its mean, x along the first of the axes (3, 3); negative beside the disc."""
    x, y = np.meshgrid(*[(np.arange(_MOON_PX) + 0.5) / (0.5 * _MOON_PX) - 1.0] * 2)
    inside = x**2 + y**2 < 1.0
    up = np.sqrt(np.maximum(1.0 - x**2 - y**2, 0.0))
    aside = phase.to_sun @ axes[:, :2]
    aside = aside / max(float(np.linalg.norm(aside)), 1e-12)
    facing = np.maximum(np.sin(phase.angle_rad) * (aside[0] * x + aside[1] * y) + np.cos(phase.angle_rad) * up, 0.0)
    law = np.where(inside, facing / np.maximum(facing + up, 1e-9), 0.0)
    return np.where(inside, law * (np.pi / 4 / max(float(law.mean()), 1e-12)), -1.0)


def envmap(image: NDArray[np.float32]) -> dict[str, Any]:
    """An `envmap` dictionary of an equirectangular image; see `skies.model.map_directions`."""
    # Mitsuba's map is y-up: its direction for (u, v) is (sin(2 pi u) sin(pi v), cos(pi v), -cos(2 pi u) sin(pi v)).
    # Rotating y to z by 90 degrees about x turns that into azimuth 90 degrees - 2 pi u, measured from x over y.
    columns = image.shape[1]
    turned = np.roll(image[:, ::-1], columns // 4, axis=1)
    return {
        "type": "envmap",
        "bitmap": mi.Bitmap(np.ascontiguousarray(turned)),
        "to_world": mi.ScalarTransform4f().rotate([1, 0, 0], 90),
    }
