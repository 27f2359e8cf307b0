"""How clouds lie over a scene: their heights, the transport of light that these allow, and their shadow.

`farfield` renders the clouds once, as seen from one place, and has their light and shadow fall on the scene from
outside. That holds where the clouds are high above all that the cameras see near them, so that light from one cloud
reaches all parts of the site from about the same direction: the gap between the highest plant, ground or camera and the
clouds' lowest layer is at least 100 m, and at least half of the site's diagonal. `exact` has no condition, and costs
more for each camera. Clouds and fog count all over the field: ground out there would stand in them. Rain counts within
as much of the site and the cameras as the gap; of rain farther off `farfield` shows what stands before the sky, and its
shadow, but not that it veils the ground behind it.

The condition is on the safe side of what was measured: above a stand of 100 x 100 m under broken clouds from 60 m on, a
gap of a third of the diagonal, the forest's mean radiance differed from `exact` by 0.1 +- 0.7% and parts of the image
by 6% RMS, noise included; with clouds from 150 m on by 0.2 +- 0.8% and 4%. What breaks down first is the light's
direction, which is that at the middle of the site; how much light there is follows the place (render/sky.py).

The shadow is a partly transparent rectangle at the clouds' base, which the sun's disc shines through; where rain falls
beside the site it lies lower. It holds the share of the sun's light that comes down to each place of it, mean over the
disc and over the place's own area, by exact integrals of the field above it (atmosphere/optical_depth.py). It reaches
as far as the field and, away from the sun, as far as the shadow of its tops: land beyond the site sends its light to
it. Between plane and ground the disc that light is sampled on makes the penumbra.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.clouds.source import GAP_OF_SITE, LEAST_GAP_M
from forestgen.atmosphere.grid import CloudGrid
from forestgen.atmosphere.optical_depth import optical_depth
from forestgen.core.cache import BoundedCache
from forestgen.core.errors import RecipeError
from forestgen.render.build import ray_corners_m
from forestgen.render.frame import CloudTransport
from forestgen.render.light import SUN_RADIUS_DEG
from forestgen.render.variant import mi
from forestgen.scene.spec import Camera, SceneSpec

THICKEST_RAIN_PER_M = 0.01  # heavy rain, of 4 to 5 g/m^3; in the thinnest fog one sees as far
_CLEAR = 0.01  # optical depth of all layers together that count as empty
_ABOVE_ALL_M = 1.0
Floats = NDArray[np.float64]
_RAYS = 8  # of a cell of the plane
_MOST_CELLS = 640  # along its side
_LOWEST_SUN = 0.05  # sine of elevation below which shadows reach no further
_CALL_ROWS = 64
_KEPT_BYTES = 50_000_000
_kept: BoundedCache[Floats] = BoundedCache(_KEPT_BYTES, lambda one: one.nbytes)


def base_of(
    clouds: CloudGrid, within: tuple[Floats, Floats] | None = None, *, thicker_than_per_m: float = 0.0
) -> float | None:
    """World height of the clouds' base in metres, None if there are none.

    Only columns between the two places `within`, (2,) world x and y, count, and cells `thicker_than_per_m`. Layers
    whose largest optical depths add up to less than a hundredth count as empty: they would not be seen.
    """
    extinction = clouds.extinction_per_m
    if within is not None:
        across = [
            _cells_between(low, high, clouds.low_m[k], clouds.cell_m[k], extinction.shape[2 - k])
            for k, (low, high) in enumerate(zip(*within, strict=True))
        ]
        extinction = extinction[:, across[1], across[0]]
    if not extinction.size:
        return None
    largest = extinction.max(axis=(1, 2)).astype(np.float64)
    cell_m = clouds.cell_m[2]
    depth = np.cumsum(np.where(largest > thicker_than_per_m, largest, 0.0)) * cell_m
    full = np.nonzero(depth > _CLEAR)[0]
    if not len(full):
        return None
    # Values stand at the layers' middles, and the field between two of them is not 0.
    return clouds.low_m[2] + max(float(full[0]) - 0.5, 0.0) * cell_m


def height_of(clouds: CloudGrid) -> float:
    """World height of the clouds' middle, by extinction, in metres; of their base if they are empty."""
    layers = clouds.extinction_per_m.sum(axis=(1, 2), dtype=np.float64)
    height = clouds.low_m[2] + (np.arange(len(layers)) + 0.5) * clouds.cell_m[2]
    return float(np.sum(layers * height) / layers.sum()) if layers.any() else clouds.low_m[2]


def _cells_between(low: float, high: float, start: float, cell: float, count: int) -> slice:
    """Cells along an axis whose cloud reaches between two places: half a cell farther than their own edges."""
    first, last = np.floor((low - start) / cell - 0.5), np.ceil((high - start) / cell + 0.5)
    return slice(int(np.clip(first, 0, count)), int(np.clip(last, 0, count)))


def near_base_of(spec: SceneSpec, points_m: Sequence[Floats] = ()) -> float | None:
    """Base of the clouds and rain near plants, cameras and further (3,) points; None if there are none."""
    if spec.clouds is None:
        return None
    places = [spec.instances.on_site.transform[:, :2, 3], *(np.atleast_2d(one)[:, :2] for one in points_m)]
    places += [ray_corners_m(camera)[:, :2] for camera in spec.cameras]
    every, gap_m = np.concatenate(places).astype(np.float64), least_gap_m(spec)
    if not len(every):  # ground alone, seen by nobody
        return base_of(spec.clouds)
    return base_of(spec.clouds, (every.min(axis=0) - gap_m, every.max(axis=0) + gap_m))


def least_gap_m(spec: SceneSpec) -> float:
    """Gap below the clouds from which on farfield holds."""
    if not len(spec.instances):
        return LEAST_GAP_M
    place = spec.instances.on_site.transform[:, :2, 3]
    return max(LEAST_GAP_M, GAP_OF_SITE * float(np.linalg.norm(np.ptp(place, axis=0))))


def highest(spec: SceneSpec, others: Sequence[tuple[str, float]]) -> tuple[str, float]:
    """What reaches highest of ground below the clouds, plants and `others`, in words, and its world height."""
    assert spec.clouds is not None
    vertices = spec.terrain.mesh.vertices_m
    low, high = spec.clouds.low_m, spec.clouds.high_m
    under = np.all((vertices[:, :2] >= low[:2]) & (vertices[:, :2] <= high[:2]), axis=1)
    found = [("the ground", float(vertices[under, 2].max()))] if under.any() else []
    if len(spec.instances):
        height = np.array([one.height_m for one in spec.exemplars])[spec.instances.exemplar]
        top = spec.instances.transform[:, 2, 3] + height * spec.instances.transform[:, 2, 2]
        found.append(("the highest plant", float(top.max())))
    return max([*found, *others], key=lambda one: one[1], default=("the ground", 0.0))


def tops_of(cameras: Sequence[Camera]) -> list[tuple[str, float]]:
    """Names, and where the highest rays start."""
    return [(f"camera {one.name!r}", float(ray_corners_m(one)[:, 2].max())) for one in cameras]


def shadow_height_m(spec: SceneSpec, eye_m: float) -> float | None:
    """World height of the plane that the clouds' shadow is drawn on; None if there are no clouds.

    The clouds' base; where rain falls beside the site, just above the highest of the scene and an eye at height
    `eye_m`. Of the way to the sun the plane holds all that is above it.
    """
    base_m = None if spec.clouds is None else base_of(spec.clouds)
    if base_m is None:
        return None
    return max(base_m, highest(spec, [*tops_of(spec.cameras), ("the eye", eye_m)])[1] + _ABOVE_ALL_M)


def cloud_transport_of(
    asked: Literal["auto", "farfield", "exact"],
    spec: SceneSpec,
    cameras: Sequence[Camera],
    *,
    where: str = "render.clouds",
) -> CloudTransport:
    """The transport for the images of some cameras. `RecipeError`: farfield was asked for, and clouds are too near."""
    if asked == "exact":
        return "exact"
    near = _too_near(spec, tops_of(cameras), [ray_corners_m(one) for one in cameras])
    if near is None:
        return "farfield"
    expected, got = near
    if spec.clouds is not None and spec.clouds.above is not None:
        problem, hint = "cirrus need the clouds below them to be far above the scene", "leave out sky.clouds.cirrus"
        raise RecipeError(problem, where="sky.clouds", expected=expected, got=got, hint=hint)
    if asked == "auto":
        return "exact"
    problem = "the clouds are too near for light from afar"
    hint = "set render.clouds to auto or exact, or raise the clouds"
    raise RecipeError(problem, where=where, expected=expected, got=f"farfield, and {got}", hint=hint)


def check_far_clouds(spec: SceneSpec, point_m: Sequence[float]) -> None:
    """`RecipeError`: clouds so near that the plane of their shadow would lie among the plants or below a point; fog."""
    if spec.fog or spec.snow is not None:
        problem, expected = "light at a point cannot be measured in fog, rain or snow", "weather without them"
        hint = "measure with `set='weather=[]'`"
        raise RecipeError(
            problem, where="weather", expected=expected, got="weather that its light does not know", hint=hint
        )
    near = _too_near(spec, [("the point", float(point_m[2]))], [np.asarray(point_m)])
    if near is not None:
        problem = "light at a point cannot be measured in clouds or fog, or close below them"
        hint = "raise the clouds, or measure with `set='sky.clouds=none'`"
        raise RecipeError(problem, where="sky.clouds", expected=near[0], got=near[1], hint=hint)


def _too_near(spec: SceneSpec, tops: Sequence[tuple[str, float]], points_m: Sequence[Floats]) -> tuple[str, str] | None:
    """What was expected of the clouds and what they are, in words; None if they are far from all."""
    if spec.clouds is None:
        return None
    far_m = base_of(spec.clouds, thicker_than_per_m=THICKEST_RAIN_PER_M)  # clouds and fog anywhere, without rain
    for what, base_m in (("clouds", far_m), ("clouds or rain near it", near_base_of(spec, points_m))):
        if base_m is None:
            continue
        name, top_m = highest(spec, tops)
        gap_m, least_m = base_m - top_m, least_gap_m(spec)
        if gap_m < least_m:
            place = f"{gap_m:.0f} m above it" if gap_m >= 0 else f"{-gap_m:.0f} m below it"
            return (
                f"clouds from {least_m:.0f} m above {name} on, which reaches up to {top_m:.1f} m",
                f"{what} from {base_m:.0f} m on, {place}",
            )
    return None


@dataclass(frozen=True)
class ShadowPlane:
    """The clouds' shadow on a level plane above the scene, world."""

    transmittance: Floats  # (Y, X) share of the sun's light that comes through to each cell
    low_m: Floats  # (2,)
    high_m: Floats  # (2,)
    height_m: float


def content_key(clouds: CloudGrid) -> str:
    """Hash of a field and how it scatters."""
    digest = hashlib.blake2b(np.ascontiguousarray(clouds.inside_per_m).data, digest_size=16)
    for table in (clouds.detail.brick, clouds.detail.depth, clouds.detail.octave, clouds.detail.unit):
        digest.update(np.ascontiguousarray(table).data)
    shape = clouds.extinction_per_m.shape
    digest.update(repr((shape, clouds.low_m, clouds.high_m, clouds.albedo, clouds.phase)).encode())
    above = "" if clouds.above is None else content_key(clouds.above)
    return digest.hexdigest() + above


def plane_edges(clouds: CloudGrid, to_sun: Floats, base_m: float) -> tuple[Floats, Floats]:
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
    """(Y, X) transmittance of all the plane, and its (2,) lowest and highest x and y; kept for those who ask again."""
    low, high = plane_edges(clouds, to_sun, base_m)
    fine = min(clouds.cell_m[:2]) / 2.0
    columns, rows = (int(np.clip(np.ceil(length / fine), 8, _MOST_CELLS)) for length in high - low)
    key = (content_key(clouds), tuple(to_sun.tolist()), base_m)
    return _kept.get(key, lambda: sun_transmittance(clouds, to_sun, base_m, low, high, (columns, rows))), low, high


def shadow_plane_of(spec: SceneSpec, eye_m: Floats) -> ShadowPlane | None:
    """The plane above a scene and an eye at (3,) world metres; None where no cloud is."""
    assert spec.clouds is not None
    height_m, to_sun = shadow_height_m(spec, float(eye_m[2])), spec.sky.to_light
    if height_m is None or to_sun[2] <= 0.0:
        return None
    return ShadowPlane(*shadow_of(spec.clouds, to_sun, height_m), height_m)


def shadow_rectangle(spec: SceneSpec, origin_m: Floats) -> dict[str, Any] | None:
    """The plane as a dictionary of the renderer's, in its frame; None where no cloud is."""
    plane = shadow_plane_of(spec, origin_m)
    if plane is None:
        return None
    centre, half = (plane.low_m + plane.high_m) / 2 - origin_m[:2], (plane.high_m - plane.low_m) / 2
    place = mi.ScalarTransform4f().translate([centre[0], centre[1], plane.height_m - origin_m[2]])
    bitmap = mi.Bitmap(np.ascontiguousarray((1.0 - plane.transmittance)[..., None].astype(np.float32)))
    opacity = {"type": "bitmap", "bitmap": bitmap, "raw": True, "wrap_mode": "clamp"}
    black = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.0, 0.0, 0.0]}}
    return {
        "type": "rectangle",
        "to_world": place.scale([half[0], half[1], 1.0]),
        "bsdf": {"type": "mask", "opacity": opacity, "nested": black},
    }
