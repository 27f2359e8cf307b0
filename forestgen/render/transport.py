"""Which transport of light takes a scene through its clouds.

`farfield` renders the clouds once, as seen from one place, and has their light and shadow fall on the scene from
outside. That holds where the clouds are high above all that the cameras see near them: nothing of the scene stands in
or above them, and light from one cloud reaches all parts of the site from about the same direction. The condition is a
gap between the highest plant, ground or camera and the clouds' lowest layer: of at least 100 m, and of at least half of
the site's diagonal; rain counts within as much of the site (render/cloud_heights.py). `exact` has no condition, and
costs more for each camera. Of rain farther off `farfield` shows what stands before the sky, and its shadow, but not
that it veils the ground behind it.

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

from forestgen.core.errors import RecipeError
from forestgen.render.build import ray_corners_m
from forestgen.render.cloud_heights import far_base_of, highest, least_gap_m, near_base_of, tops_of
from forestgen.render.shot import CloudTransport
from forestgen.scene.spec import Camera, SceneSpec

Floats = NDArray[np.float64]


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
    """Light at a point is measured under clouds that are far above it and the scene, and no others.

    Raises
    ------
    RecipeError : the clouds are too near. The sheet of their shadow would lie among the plants, or below the point.
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
    for what, base_m in (("clouds", far_base_of(spec)), ("clouds or rain near it", near_base_of(spec, points_m))):
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
