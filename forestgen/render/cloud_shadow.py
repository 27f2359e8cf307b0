"""The clouds' shadow: a partly transparent sheet at their base, which the sun's disc shines through.

Where rain falls beside the site the sheet lies lower (render/cloud_heights.py). It holds the share of the sun's light
that comes down to each place of it, mean over the disc and over the place's own area, by exact integrals of the field
above it (atmosphere/optical_depth.py). It reaches as far as the field and, away from the sun, as far as the shadow of
its tops: land beyond the site sends its light to it, and shadows on it are seen. Between sheet and ground the disc that
light is sampled on makes the penumbra, so shadows soften as they should and sunflecks under the canopy stay discs.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.grid import CloudGrid
from forestgen.atmosphere.optical_depth import optical_depth
from forestgen.core.cache import BoundedCache
from forestgen.render.cloud_heights import sheet_height_m
from forestgen.render.sky_radiance import SUN_RADIUS_DEG
from forestgen.render.variant import mitsuba
from forestgen.scene.spec import SceneSpec

_RAYS = 8  # of a cell of the sheet
_MOST_CELLS = 640  # along its side
_LOWEST_SUN = 0.05  # sine of elevation below which shadows reach no further
_CALL_ROWS = 64
_KEPT_BYTES = 50_000_000
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Sheet:
    """The clouds' shadow on a level sheet above the scene, world."""

    transmittance: Floats  # (Y, X) share of the sun's light that comes through to each cell
    low_m: Floats  # (2,)
    high_m: Floats  # (2,)
    height_m: float


_kept: BoundedCache[Floats] = BoundedCache(_KEPT_BYTES, lambda one: one.nbytes)


def content_key(clouds: CloudGrid) -> str:
    """Hash of a field and how it scatters."""
    digest = hashlib.blake2b(np.ascontiguousarray(clouds.extinction_per_m).data, digest_size=16)
    shape = clouds.extinction_per_m.shape
    digest.update(repr((shape, clouds.low_m, clouds.high_m, clouds.albedo, clouds.phase)).encode())
    return digest.hexdigest()


def sheet_edges(clouds: CloudGrid, to_sun: Floats, base_m: float) -> tuple[Floats, Floats]:
    """(2,) lowest and highest x and y of the plane at the base from which the sun is seen through the field's box."""
    reach = -to_sun[:2] / max(float(to_sun[2]), _LOWEST_SUN) * (clouds.high_m[2] - base_m)
    low, high = np.array(clouds.low_m[:2]), np.array(clouds.high_m[:2])
    return low + np.minimum(reach, 0.0), high + np.maximum(reach, 0.0)


def sun_transmittance(
    clouds: CloudGrid, to_sun: Floats, base_m: float, low_m: Floats, high_m: Floats, cells: tuple[int, int]
) -> Floats:
    """(Y, X) share of the sun's light that comes through to each of `cells` = (X, Y) cells of a level rectangle."""
    columns, rows = cells
    endless = np.array(np.inf)
    result = np.empty((rows, columns))
    size = (high_m - low_m) / [columns, rows]
    # Each ray has its own place in the cell and its own on the disc; both are spread evenly.
    index = np.arange(_RAYS)
    place = np.stack([(index + 0.5) / _RAYS, (index * 0.6180339887498949) % 1.0], axis=-1)
    radius = np.tan(np.radians(SUN_RADIUS_DEG)) * np.sqrt((index * 0.7548776662466927 + 0.5) % 1.0)
    turn = 2 * np.pi * ((index * 0.5698402909980532 + 0.5) % 1.0)
    aside = np.cross(to_sun, [0.0, 1.0, 0.0] if abs(to_sun[1]) < 0.9 else [1.0, 0.0, 0.0])
    aside /= np.linalg.norm(aside)
    across = np.stack([aside, np.cross(to_sun, aside)])
    ways = to_sun + np.stack([radius * np.cos(turn), radius * np.sin(turn)], axis=-1) @ across
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    for first in range(0, rows, _CALL_ROWS):
        y, x = np.meshgrid(np.arange(first, min(first + _CALL_ROWS, rows)), np.arange(columns), indexing="ij")
        corner = np.stack([x, y], axis=-1)[:, :, None] + place
        origin = np.concatenate([low_m + corner * size, np.full((*corner.shape[:3], 1), base_m)], axis=-1)
        depth = optical_depth(clouds, origin, np.broadcast_to(ways, origin.shape), endless, enough=20.0)
        result[first : first + _CALL_ROWS] = np.exp(-depth).mean(axis=-1)
    return result


def shadow_of(clouds: CloudGrid, to_sun: Floats, base_m: float) -> tuple[Floats, Floats, Floats]:
    """(Y, X) transmittance of all the sheet, and its (2,) lowest and highest x and y; kept for those who ask again."""
    low, high = sheet_edges(clouds, to_sun, base_m)
    fine = min(clouds.cell_m[:2]) / 2.0
    columns, rows = (int(np.clip(np.ceil(length / fine), 8, _MOST_CELLS)) for length in high - low)
    key = (content_key(clouds), tuple(to_sun.tolist()), base_m)
    return _kept.get(key, lambda: sun_transmittance(clouds, to_sun, base_m, low, high, (columns, rows))), low, high


def sheet_of(spec: SceneSpec, eye_m: Floats) -> Sheet | None:
    """The sheet above a scene and an eye at (3,) world metres; None where no cloud is."""
    assert spec.clouds is not None
    height_m, to_sun = sheet_height_m(spec, float(eye_m[2])), spec.sky.to_sun
    if height_m is None or to_sun[2] <= 0.0:
        return None
    return Sheet(*shadow_of(spec.clouds, to_sun, height_m), height_m)


def sun_sheet(spec: SceneSpec, origin_m: Floats) -> dict[str, Any] | None:
    """The sheet as a dictionary of the renderer's, in its frame; None where no cloud is."""
    sheet = sheet_of(spec, origin_m)
    if sheet is None:
        return None
    mi = mitsuba()
    centre, half = (sheet.low_m + sheet.high_m) / 2 - origin_m[:2], (sheet.high_m - sheet.low_m) / 2
    place = mi.ScalarTransform4f().translate([centre[0], centre[1], sheet.height_m - origin_m[2]])
    bitmap = mi.Bitmap(np.ascontiguousarray((1.0 - sheet.transmittance)[..., None].astype(np.float32)))
    return {
        "type": "rectangle",
        "to_world": place.scale([half[0], half[1], 1.0]),
        "bsdf": {
            "type": "mask",
            "opacity": {"type": "bitmap", "bitmap": bitmap, "raw": True, "wrap_mode": "clamp"},
            "nested": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.0, 0.0, 0.0]}},
        },
    }
