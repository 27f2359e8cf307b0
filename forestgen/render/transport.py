"""Which transport of light takes a scene through its clouds.

`farfield` renders the clouds once, as seen from one place, and has their light and shadow fall on the scene from
outside. That holds where the clouds are high above all that the cameras see near them: nothing of the scene stands in
or above them, and light from one cloud reaches all parts of the site from about the same direction. The condition is a
gap between the highest plant, ground or camera and the clouds' lowest layer: of at least `LEAST_GAP_M`, and of at least
`GAP_OF_SITE` of the site's diagonal. `exact` has no condition, and costs more for each camera.

The condition is on the safe side of what was measured: above a stand of 100 x 100 m under broken clouds from 60 m on, a
gap of a third of the diagonal, the forest's mean radiance differed from `exact` by 0.1 +- 0.7% and parts of the image
by 6% RMS, noise included; with clouds from 150 m on by 0.2 +- 0.8% and 4%. What breaks down first is the light's
direction, which is that at the middle of the site; how much light there is follows the place (render/sky.py).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from forestgen.core.errors import RecipeError
from forestgen.render.build import ray_corners_m
from forestgen.render.cloud_shadow import base_of
from forestgen.render.views import CloudTransport
from forestgen.scene.spec import Camera, SceneSpec

LEAST_GAP_M = 100.0
GAP_OF_SITE = 0.5


def cloud_transport_of(
    asked: Literal["auto", "farfield", "exact"],
    spec: SceneSpec,
    cameras: Sequence[Camera],
    *,
    where: str = "render.clouds",
) -> CloudTransport:
    """The transport for the images of some cameras.

    Parameters
    ----------
    where : the key that asked, for the message.

    Raises
    ------
    RecipeError : farfield was asked for, and the clouds are too near.
    """
    if asked == "exact":
        return "exact"
    near = _too_near(spec, _tops(cameras))
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
    """Light at a point is measured under clouds that are far above it and the scene, and no others.

    Raises
    ------
    RecipeError : the clouds are too near. The sheet of their shadow would lie among the plants, or below the point.
    """
    near = _too_near(spec, [("the point", float(point_m[2]))])
    if near is not None:
        raise RecipeError(
            "light at a point cannot be measured in clouds or fog, or close below them",
            where="sky.clouds",
            expected=near[0],
            got=near[1],
            hint="raise the clouds, or measure with --set sky.clouds=none",
        )


def _too_near(spec: SceneSpec, tops: Sequence[tuple[str, float]]) -> tuple[str, str] | None:
    """What was expected of the clouds and what they are, in words; None if they are far above all."""
    base_m = None if spec.clouds is None else base_of(spec.clouds)
    if base_m is None:
        return None
    name, top_m = highest(spec, tops)
    gap_m, least_m = base_m - top_m, least_gap_m(spec)
    if gap_m >= least_m:
        return None
    said = f"{gap_m:.0f} m above it" if gap_m >= 0 else f"{-gap_m:.0f} m below it"
    return (
        f"clouds from {least_m:.0f} m above {name} on, which reaches up to {top_m:.1f} m",
        f"clouds from {base_m:.0f} m on, {said}",
    )


def _tops(cameras: Sequence[Camera]) -> list[tuple[str, float]]:
    """Names, and where the highest rays start."""
    return [(f"camera {one.name!r}", float(ray_corners_m(one)[:, 2].max())) for one in cameras]


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


def least_gap_m(spec: SceneSpec) -> float:
    """Gap below the clouds from which on farfield holds."""
    if not len(spec.instances):
        return LEAST_GAP_M
    place = spec.instances.transform[:, :2, 3]
    return max(LEAST_GAP_M, GAP_OF_SITE * float(np.linalg.norm(np.ptp(place, axis=0))))
