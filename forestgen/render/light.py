"""Emitters: sky and sun.

The sun is a disc of its own, far away, so that penumbrae are right, and shadow rays go to it alone.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.render.settings import SKY_BESIDE_SUN_WEIGHT
from forestgen.render.sky_radiance import SUN_RADIUS_DEG, sky_map, sun_radiance
from forestgen.render.variant import mitsuba
from forestgen.scene.channels import RGB, Channels
from forestgen.scene.spec import Sky

_SUN_DISTANCE_M = 1e6


def has_sun(sky: Sky) -> bool:
    """Whether the sun shines: an overcast sky has none."""
    return bool(sun_radiance(sky, RGB).any())


def emitters_of(sky: Sky) -> dict[str, Callable[[Channels], dict[str, Any]]]:
    """All lights of a cloudless scene by name, as functions of the channels."""
    if not has_sun(sky):
        return {"sky": partial(sky_light, sky)}
    return {"sky": partial(sky_beside_sun, sky), "sun": partial(sun_disc, sky)}


def lights(sky: Sky, channels: Channels) -> dict[str, dict[str, Any]]:
    """All lights of a cloudless scene by name."""
    return {name: emitter(channels) for name, emitter in emitters_of(sky).items()}


def sky_light(sky: Sky, channels: Channels) -> dict[str, Any]:
    """The sky without its sun."""
    return envmap(sky_map(sky, channels))


def sky_beside_sun(sky: Sky, channels: Channels) -> dict[str, Any]:
    """The same for a scene that the sun lights too, where light samples are better spent on the sun."""
    return sky_light(sky, channels) | {"sampling_weight": SKY_BESIDE_SUN_WEIGHT}


def sun_disc(sky: Sky, channels: Channels) -> dict[str, Any]:
    """The sun: a disc that shines."""
    mi = mitsuba()
    to_sun = sky.to_sun
    radius = _SUN_DISTANCE_M * np.tan(np.radians(SUN_RADIUS_DEG))
    centre = (_SUN_DISTANCE_M * to_sun).tolist()
    up = [1.0, 0.0, 0.0] if abs(to_sun[0]) < 0.9 else [0.0, 1.0, 0.0]
    radiance = [float(value) for value in sun_radiance(sky, channels)]
    return {
        "type": "disk",
        "to_world": mi.ScalarTransform4f().look_at(centre, [0, 0, 0], up).scale([radius, radius, 1.0]),
        "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.0, 0.0, 0.0]}},
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": radiance}},
    }


def envmap(image: NDArray[np.float32]) -> dict[str, Any]:
    """An `envmap` dictionary of an equirectangular image; see `sky_radiance.map_directions`."""
    mi = mitsuba()
    # Mitsuba's map is y-up: its direction for (u, v) is (sin(2 pi u) sin(pi v), cos(pi v), -cos(2 pi u) sin(pi v)).
    # Rotating y to z by 90 degrees about x turns that into azimuth 90 degrees - 2 pi u, measured from x over y.
    columns = image.shape[1]
    turned = np.roll(image[:, ::-1], columns // 4, axis=1)
    return {
        "type": "envmap",
        "bitmap": mi.Bitmap(np.ascontiguousarray(turned)),
        "to_world": mi.ScalarTransform4f().rotate([1, 0, 0], 90),
    }
