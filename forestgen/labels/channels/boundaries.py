"""Label channel `boundaries`: pixels of a nearer surface where it hides another from a neighbouring pixel.

The surfaces at the centres of two neighbouring pixels (of four) are taken to go on as their tangent planes. The inverse
depth w of a plane is linear along the image's line from one centre to the other: one plane changes it by a, the other
by b. The pixel p is a boundary towards q where w falls faster than either plane does,

    w_p - w_q > 1.25 max(-a, -b, 0) + 1e-4 max(w_p, w_q),

so its surface ends before the other one begins. Where the planes cross between the centres, the surfaces touch, and
there is none: as at the foot of a trunk, at a fold, or on a slope however grazing. The factor is for facets between
the two that no centre sees: without it, a tenth of rolling ground seen by a walker counted. The sky is behind
everything. Plants and parts do not matter: a plant's leaves hide one another too. What is finer than a pixel, as
ground at the horizon, is judged as sampled.

In a fisheye's image and in a panorama the line runs straight from one ray's unit direction to the other's, and w is the
inverse distance: it is linear there for the same reason. A panorama's last column neighbours its first one; what lies
outside of a fisheye's circle is no neighbour. Along the parallel rays of an orthographic camera it is the depth itself
that is linear, and p is a boundary towards q where

    z_q - z_p > 1.25 max(a, b, 0) + 1e-6 max(z_p, z_q) + 1e-3 of a pixel's width.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from forestgen.core.compiled import compiled
from forestgen.labels.channels.channel import LabelChannel, Layers, layer
from forestgen.labels.labelled import LabelledFrame
from forestgen.render.frame import Surface
from forestgen.scene.motion import is_rolling
from forestgen.scene.projection import projection_of, world_rays
from forestgen.scene.spec import Camera

_STEEPER = 1.25  # than both tangent planes
_TOLERANCE = 1e-4  # of the inverse depth: above the rounding of depths and normals in single precision
_DEPTH_TOLERANCE, _PIXEL_TOLERANCE = 1e-6, 1e-3  # of the depth and of a pixel's width, for parallel rays


class Boundaries(LabelChannel):
    """Occlusion boundaries."""

    name = "boundaries"

    def parts(self, labelled: LabelledFrame) -> dict[str, Layers]:
        found = occlusion_boundaries(labelled.frame.surface, labelled.frame.camera)
        return {"boundary": layer("occluding", found)}


CHANNEL = Boundaries()


def occlusion_boundaries(surface: Surface, camera: Camera) -> NDArray[np.bool_]:
    """(H, W) whether a pixel's surface hides what a neighbouring pixel sees; see above."""
    found = np.zeros(surface.depth_m.shape, dtype=np.bool_)
    projection = projection_of(camera)
    if projection.is_parallel:
        pixel_m = camera.width_m / camera.size_px[0]
        steps = np.ascontiguousarray(camera.world_from_camera.T * [[pixel_m], [pixel_m], [1.0]], dtype=np.float64)
        least = _PIXEL_TOLERANCE * pixel_m
        _mark_parallel(surface.depth_m, surface.normal, steps, _DEPTH_TOLERANCE, least, found)
        return found
    if projection.is_pinhole and not is_rolling(camera):
        (x, y), rotation = camera.pixel_slopes, np.asarray(camera.world_from_camera, dtype=np.float64)
        direction = x[:, None] * rotation[:, 0] + y[:, None, None] * rotation[:, 1] + rotation[:, 2]  # of depth 1
        _mark(surface.depth_m, surface.normal, direction, np.ones_like(found), False, _TOLERANCE, found)
        return found
    rays, wraps = world_rays(camera), projection.wraps_x
    direction = np.ascontiguousarray(rays.direction)
    _mark(surface.distance_m, surface.normal, direction, rays.valid, wraps, _TOLERANCE, found)
    return found


@compiled
def _mark(reach_m, normal, direction, valid, around, tolerance, found):  # type: ignore[no-untyped-def]
    """`reach_m` is how many times `direction` leads to a surface; `around`: the last column neighbours the first."""
    height, width = reach_m.shape
    for y in range(height):
        for x in range(width):
            for axis in range(2):
                other_x, other_y = (x + 1, y) if axis == 0 else (x, y + 1)
                if other_x == width and around:
                    other_x = 0
                if other_x == width or other_y == height or not (valid[y, x] and valid[other_y, other_x]):
                    continue
                near, far = 1.0 / reach_m[y, x], 1.0 / reach_m[other_y, other_x]
                if near == 0.0 or far == 0.0:
                    found[y, x] |= near > 0.0
                    found[other_y, other_x] |= far > 0.0
                    continue
                here = there = here_there = there_here = 0.0
                for k in range(3):
                    here += normal[y, x, k] * direction[y, x, k]
                    here_there += normal[y, x, k] * direction[other_y, other_x, k]
                    there += normal[other_y, other_x, k] * direction[other_y, other_x, k]
                    there_here += normal[other_y, other_x, k] * direction[y, x, k]
                # A degenerate face has no normal, and stands across the view.
                slope = near * here_there / here - near if here != 0.0 else 0.0
                other_slope = far - far * there_here / there if there != 0.0 else 0.0
                least = tolerance * max(near, far)
                _mark_nearer(found, y, x, other_y, other_x, near - far, -slope, -other_slope, least)


@compiled
def _mark_parallel(depth_m, normal, steps, tolerance, least_m, found):  # type: ignore[no-untyped-def]
    """Of parallel rays; `steps` (3, 3): from a pixel to the next one along x and y, and the rays' direction; world."""
    height, width = depth_m.shape
    for y in range(height):
        for x in range(width):
            for axis in range(2):
                other_x, other_y = (x + 1, y) if axis == 0 else (x, y + 1)
                if other_x == width or other_y == height:
                    continue
                near, far = np.float64(depth_m[y, x]), np.float64(depth_m[other_y, other_x])
                if np.isinf(near) or np.isinf(far):
                    found[y, x] |= not np.isinf(near)
                    found[other_y, other_x] |= not np.isinf(far)
                    continue
                slope = _depth_step(normal[y, x], steps, axis)
                other_slope = _depth_step(normal[other_y, other_x], steps, axis)
                least = tolerance * max(near, far) + least_m
                _mark_nearer(found, y, x, other_y, other_x, far - near, slope, other_slope, least)


@compiled
def _mark_nearer(found, y, x, other_y, other_x, gap, slope, other_slope, least):  # type: ignore[no-untyped-def]
    """Mark the pixel whose surface ends: a gap beyond both planes' slopes, positive where the pixel y, x is nearer."""
    if gap > _STEEPER * max(slope, other_slope, 0.0) + least:
        found[y, x] = True
    elif -gap > _STEEPER * max(-slope, -other_slope, 0.0) + least:
        found[other_y, other_x] = True


@compiled
def _depth_step(normal, steps, axis):  # type: ignore[no-untyped-def]
    """By how much a plane's depth grows from a pixel to the next one; 0 for a plane that no ray meets."""
    aside = normal[0] * steps[axis, 0] + normal[1] * steps[axis, 1] + normal[2] * steps[axis, 2]
    along = normal[0] * steps[2, 0] + normal[1] * steps[2, 1] + normal[2] * steps[2, 2]
    return -aside / along if along != 0.0 else 0.0
