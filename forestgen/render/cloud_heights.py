"""How high the clouds of a scene are, where the plane of their shadow lies, and which transport of light they allow.

A thunderhead two kilometres off rains to the ground. Its rain is far from the site, as its cloud is: light from it
comes to all parts of the site from about the same direction. So rain counts within a distance of the site and the
cameras, and is left out beyond. Clouds and fog count all over the field: ground out there would stand in them.

`farfield` renders the clouds once, as seen from one place, and has their light and shadow fall on the scene from
outside. That holds where the clouds are high above all that the cameras see near them: nothing of the scene stands in
or above them, and light from one cloud reaches all parts of the site from about the same direction. The condition is a
gap between the highest plant, ground or camera and the clouds' lowest layer: of at least 100 m, and of at least half of
the site's diagonal; rain counts within as much of the site. `exact` has no condition, and costs more for each camera.
Of rain farther off `farfield` shows what stands before the sky, and its shadow, but not that it veils the ground behind
it.

The condition is on the safe side of what was measured: above a stand of 100 x 100 m under broken clouds from 60 m on, a
gap of a third of the diagonal, the forest's mean radiance differed from `exact` by 0.1 +- 0.7% and parts of the image
by 6% RMS, noise included; with clouds from 150 m on by 0.2 +- 0.8% and 4%. What breaks down first is the light's
direction, which is that at the middle of the site; how much light there is follows the place (render/sky.py).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.grid import CloudGrid
from forestgen.core.errors import RecipeError
from forestgen.render.build import ray_corners_m
from forestgen.render.job import CloudTransport
from forestgen.scene.spec import Camera, SceneSpec

LEAST_GAP_M = 100.0
GAP_OF_SITE = 0.5
THICKEST_RAIN_PER_M = 0.01  # heavy rain, of 4 to 5 g/m^3; in the thinnest fog one sees as far
_CLEAR = 0.01  # optical depth of all layers together that count as empty
_ABOVE_ALL_M = 1.0
Floats = NDArray[np.float64]


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


def _cells_between(low: float, high: float, start: float, cell: float, count: int) -> slice:
    """Cells along an axis whose cloud reaches between two places: half a cell farther than their own edges."""
    first, last = np.floor((low - start) / cell - 0.5), np.ceil((high - start) / cell + 0.5)
    return slice(int(np.clip(first, 0, count)), int(np.clip(last, 0, count)))


def near_base_of(spec: SceneSpec, points_m: Sequence[Floats] = ()) -> float | None:
    """Base of the clouds and rain near plants, cameras and further (3,) points; None if there are none."""
    if spec.clouds is None:
        return None
    places = [spec.instances.transform[:, :2, 3], *(np.atleast_2d(one)[:, :2] for one in points_m)]
    places += [ray_corners_m(camera)[:, :2] for camera in spec.cameras]
    every, gap_m = np.concatenate(places).astype(np.float64), least_gap_m(spec)
    if not len(every):  # ground alone, seen by nobody
        return base_of(spec.clouds)
    return base_of(spec.clouds, (every.min(axis=0) - gap_m, every.max(axis=0) + gap_m))


def least_gap_m(spec: SceneSpec) -> float:
    """Gap below the clouds from which on farfield holds."""
    if not len(spec.instances):
        return LEAST_GAP_M
    place = spec.instances.transform[:, :2, 3]
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
    if asked == "auto":
        return "exact"
    expected, got = near
    raise RecipeError(
        "the clouds are too near for light from afar",
        where=where,
        expected=expected,
        got=f"farfield, and {got}",
        hint="set render.clouds to auto or exact, or raise the clouds",
    )


def check_far_clouds(spec: SceneSpec, point_m: Sequence[float]) -> None:
    """Raise `RecipeError` where clouds are too near to measure light at a point.

    The plane of their shadow would lie among the plants, or below the point.
    """
    near = _too_near(spec, [("the point", float(point_m[2]))], [np.asarray(point_m)])
    if near is not None:
        raise RecipeError(
            "light at a point cannot be measured in clouds or fog, or close below them",
            where="sky.clouds",
            expected=near[0],
            got=near[1],
            hint="raise the clouds, or measure with `set='sky.clouds=none'`",
        )


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
            said = f"{gap_m:.0f} m above it" if gap_m >= 0 else f"{-gap_m:.0f} m below it"
            return (
                f"clouds from {least_m:.0f} m above {name} on, which reaches up to {top_m:.1f} m",
                f"{what} from {base_m:.0f} m on, {said}",
            )
    return None
