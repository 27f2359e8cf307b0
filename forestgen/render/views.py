"""A view of a scene that is built once and captured pass after pass, in other channels and with other seeds.

clear_view.py has scenes without clouds. Under clouds, farfield.py lights the scene by a sky that was rendered once.
Both follow their paths by paths/. exact_view.py has Mitsuba trace the clouds' volume together with the scene.
"""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from forestgen.core.progress import Progress
from forestgen.render.shot import Shot, Timer, View, is_exact
from forestgen.render.variant import SCALAR, using
from forestgen.scene.projection import image_circle, rays
from forestgen.scene.spec import Camera

if TYPE_CHECKING:
    from forestgen.render.identity import SceneTracer


def build_view(shot: Shot, progress: Progress, timer: Timer, tracer: SceneTracer | None = None) -> View:
    """Build the scene of a shot.

    Parameters
    ----------
    tracer : of the shot's scene, if there is one already.
    """
    if is_exact(shot):
        from forestgen.render.exact_view import ExactView

        with using(SCALAR):
            return ExactView(shot, timer)
    if tracer is None:
        from forestgen.render.identity import SceneTracer

        with timer("radiance: build"):
            tracer = SceneTracer(replace(shot.spec, cameras=(shot.camera,)), lambda name: nullcontext())
    if shot.spec.clouds is None:
        from forestgen.render.clear_view import ClearView

        return ClearView(shot, tracer, timer)
    from forestgen.render.farfield import FarfieldView

    return FarfieldView(shot, tracer, progress, timer)


class PixelKinds(NamedTuple):
    """(H, W) pixels of a camera by what they can see."""

    seen: NDArray[np.bool_]  # the centre sees anything: it lies in a fisheye's circle
    whole: NDArray[np.bool_]  # all of the pixel does
    above: NDArray[np.bool_]  # all of it does, above a flat earth's horizon


def pixels_of(camera: Camera) -> PixelKinds:
    """What a camera's pixels can see."""
    width, height = camera.size_px
    seen = image_circle(camera)
    x, y = np.meshgrid(np.arange(width + 1.0), np.arange(height + 1.0))
    corners = rays(camera, x, y)
    whole = seen & _all_corners(corners.valid)
    return PixelKinds(seen, whole, whole & _all_corners(corners.direction @ camera.world_from_camera[2] > -1e-9))


def _all_corners(corners: NDArray[np.bool_]) -> NDArray[np.bool_]:
    return np.asarray(corners[:-1, :-1] & corners[:-1, 1:] & corners[1:, :-1] & corners[1:, 1:])
