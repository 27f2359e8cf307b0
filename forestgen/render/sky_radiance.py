"""Radiance of the sky by direction, and of the sun's disc.

A clear sky's radiance at a wavelength is distributed as that of Hosek and Wilkie (2012), from Mitsuba's `sunsky`; an
overcast one's as the CIE standard overcast sky, (1 + 2 sin elevation) / 3 of the zenith's (ISO 15469). The scale of
both is such that the light on a level plane is what atmosphere/daylight.py says.

Decisions
---------
- Hosek and Wilkie's data go from 320 to 720 nm: the shape beyond is that at the end.
- The sun's disc has one radiance, the mean; in truth its middle is up to a quarter brighter than that and its limb half
  as bright, which only penumbrae could show. Its size is that of the mean distance.
- The map's rows lie 1.4 degrees apart and one of them on the horizon; the next one below is black. A map eight times as
  fine changes the light within 5 degrees of the sun by 0.1% and that on level ground by less; one twice as fine already
  takes a simple scene 15% more time.
- A colour outside of Rec. 709, as of a sun at the horizon, is cut off at its edge, its luminance kept.

References
----------
Hosek, L., Wilkie, A. (2012): An analytic model for full spectral sky-dome radiance. ACM Trans. Graph. 31, 95.
ISO 15469:2004 (CIE S 011): Spatial distribution of daylight, CIE standard general sky.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.daylight import daylight_of
from forestgen.core.spectrum import LUMINANCE, Spectrum
from forestgen.render.variant import drjit, mitsuba
from forestgen.scene.channels import Channels
from forestgen.scene.spec import Sky

SUN_RADIUS_DEG = 0.2665  # at the earth's mean distance
MAP_ROWS, MAP_COLUMNS = 129, 256  # an odd number of rows: one is the horizon
_NODES_NM = np.arange(320.0, 721.0, 40.0)  # of the model's data
_SPECTRAL = "llvm_ad_spectral"
_SUN_SOLID_ANGLE_SR = float(np.pi * np.sin(np.radians(SUN_RADIUS_DEG)) ** 2)  # projected on a plane that faces it
Floats = NDArray[np.float64]


def map_directions(rows: int = MAP_ROWS, columns: int = MAP_COLUMNS) -> Floats:
    """(rows, columns, 3) of an equirectangular map: first and last row are zenith and nadir, columns turn x to y."""
    theta = np.arange(rows) / (rows - 1) * np.pi
    phi = (np.arange(columns) + 0.5) / columns * 2 * np.pi
    t, p = np.meshgrid(theta, phi, indexing="ij")
    return np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], axis=-1)


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
    """(MAP_ROWS, MAP_COLUMNS, 3) radiance of the sky without its sun, black below the horizon; see `map_directions`.

    W/m²/sr/nm at the wavelengths; or linear Rec. 709 in cd/m².
    """
    light = daylight_of(sky).sky
    result = np.zeros((MAP_ROWS, MAP_COLUMNS, 3), dtype=np.float32)
    up = result[: MAP_ROWS // 2 + 1]
    if sky.kind == "overcast":
        up[:] = _overcast_shape()[:, None, None] * channels.of_light(light)
    else:
        shape = _clear_shape(sky.sun_elevation_deg, sky.sun_azimuth_deg, sky.turbidity, sky.ground_albedo)
        # The radiance is a sum over the nodes, each times a hat function of wavelength.
        hats = (np.interp(light.wavelength_nm, _NODES_NM, hat) for hat in np.eye(len(_NODES_NM)))
        parts = [channels.of_light(Spectrum(light.wavelength_nm, light.value * hat)) for hat in hats]
        up[:] = shape @ np.array(parts, dtype=np.float32)
    return _within_gamut(result) if channels.wavelength_nm is None else result


def sun_radiance(sky: Sky, channels: Channels) -> Floats:
    """(3,) mean radiance of the sun's disc, in the same units; zero under an overcast sky."""
    radiance = channels.of_light(daylight_of(sky).sun) / _SUN_SOLID_ANGLE_SR
    return np.asarray(_within_gamut(radiance) if channels.wavelength_nm is None else radiance)


def sun_irradiance(sky: Sky, channels: Channels) -> Floats:
    """(3,) light of the disc on a plane that faces it: the radiance times its solid angle."""
    return sun_radiance(sky, channels) * _SUN_SOLID_ANGLE_SR


def _within_gamut(colour: NDArray[Any]) -> NDArray[Any]:
    """(..., 3) colours without negative parts, of the same luminance and type."""
    cut = np.maximum(colour, 0)
    weight = np.array(LUMINANCE, dtype=colour.dtype)
    scale = (colour @ weight) / np.maximum(cut @ weight, np.finfo(colour.dtype).tiny)
    return np.asarray(cut * scale[..., None])


def _row_weights() -> Floats:
    """(MAP_ROWS // 2 + 1,) solid angle of a pixel of a row times the sine of its elevation, down to the horizon."""
    step = np.pi / (MAP_ROWS - 1)
    theta = np.arange(MAP_ROWS // 2 + 1) * step
    return np.asarray(np.sin(theta) * np.cos(theta) * step * (2 * np.pi / MAP_COLUMNS))


def _overcast_shape() -> Floats:
    """(MAP_ROWS // 2 + 1,) radiance over irradiance on a level plane, 1/sr."""
    theta = np.arange(MAP_ROWS // 2 + 1) * np.pi / (MAP_ROWS - 1)
    radiance = (1.0 + 2.0 * np.cos(theta)) / 3.0
    return np.asarray(radiance / (radiance @ _row_weights() * MAP_COLUMNS))


@lru_cache(maxsize=4)
def _clear_shape(elevation_deg: float, azimuth_deg: float, turbidity: float, albedo: float) -> NDArray[np.float32]:
    """(MAP_ROWS // 2 + 1, columns, nodes) radiance over irradiance on a level plane, 1/sr."""
    mi, dr = mitsuba(), drjit()
    directions = map_directions(MAP_ROWS, MAP_COLUMNS)[: MAP_ROWS // 2 + 1]
    directions[-1, :, 2] = 1e-4  # the model has no light at the horizon itself
    flat = directions.reshape(-1, 3).astype(np.float32)
    to_sun = Sky(elevation_deg, azimuth_deg, turbidity).to_sun
    before = mi.variant()
    mi.set_variant(_SPECTRAL)
    try:
        emitter: Any = mi.load_dict(
            {"type": "sunsky", "sun_direction": [float(x) for x in to_sun], "turbidity": turbidity, "albedo": albedo,
             "sun_scale": 0.0}
        )  # fmt: skip
        interaction = dr.zeros(mi.SurfaceInteraction3f, len(flat))
        interaction.wi = mi.Vector3f(*(-mi.Float(np.ascontiguousarray(flat[:, k])) for k in range(3)))
        values = []
        for first in range(0, len(_NODES_NM), 4):
            four = np.resize(_NODES_NM[first : first + 4], 4)
            interaction.wavelengths = [float(x) for x in four]
            values.append(np.array(emitter.eval(interaction), dtype=np.float64)[: len(_NODES_NM) - first])
    finally:
        mi.set_variant(before)
    radiance = np.maximum(np.concatenate(values), 0.0).T.reshape(*directions.shape[:2], -1)
    irradiance = np.einsum("rck,r->k", radiance, _row_weights())
    return np.asarray(radiance / irradiance, dtype=np.float32)
