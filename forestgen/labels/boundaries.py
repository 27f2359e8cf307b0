"""Occlusion boundaries: pixels of a nearer surface where it hides another from a neighbouring pixel.

The surfaces at the centres of two neighbouring pixels (of four) are taken to go on as their tangent planes. The inverse
depth w of a plane is linear along the image's line from one centre to the other: one plane changes it by a, the other
by b. The pixel p is a boundary towards q where w falls faster than either plane does,

    w_p - w_q > 1.25 max(-a, -b, 0) + 1e-4 max(w_p, w_q),

so its surface ends before the other one begins. Where the planes cross between the centres, the surfaces touch, and
there is none: as at the foot of a trunk, at a fold, or on a slope however grazing. The factor is for facets between
the two that no centre sees: without it, a tenth of rolling ground seen by a walker counted. The sky is behind
everything. Plants and parts do not matter: a plant's leaves hide one another too. What is finer than a pixel, as
ground at the horizon, is judged as sampled.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from forestgen.core.compiled import compiled
from forestgen.render.frame import Surface
from forestgen.scene.spec import Camera

_STEEPER = 1.25  # than both tangent planes
_TOLERANCE = 1e-4  # of the inverse depth: above the rounding of depths and normals in single precision


def occlusion_boundaries(surface: Surface, camera: Camera) -> NDArray[np.bool_]:
    """(H, W) whether a pixel's surface hides what a neighbouring pixel sees; see above."""
    found = np.zeros(surface.depth_m.shape, dtype=np.bool_)
    rotation = np.ascontiguousarray(camera.world_from_camera, dtype=np.float64)
    _mark(surface.depth_m, surface.normal, rotation, camera.focal_px, _STEEPER, _TOLERANCE, found)
    return found


@compiled
def _mark(depth_m, normal, rotation, focal_px, steeper, tolerance, found):  # type: ignore[no-untyped-def]
    height, width = depth_m.shape
    for y in range(height):
        for x in range(width):
            for axis in range(2):
                other_x, other_y = (x + 1, y) if axis == 0 else (x, y + 1)
                if other_x == width or other_y == height:
                    continue
                near, far = 1.0 / depth_m[y, x], 1.0 / depth_m[other_y, other_x]
                if near == 0.0 or far == 0.0:
                    found[y, x] |= near > 0.0
                    found[other_y, other_x] |= far > 0.0
                    continue
                u, v = (x + 0.5 - 0.5 * width) / focal_px, (y + 0.5 - 0.5 * height) / focal_px
                here = there = here_there = there_here = 0.0
                for k in range(3):
                    ray = rotation[k, 0] * u + rotation[k, 1] * v + rotation[k, 2]
                    other_ray = ray + rotation[k, axis] / focal_px
                    here += normal[y, x, k] * ray
                    here_there += normal[y, x, k] * other_ray
                    there += normal[other_y, other_x, k] * other_ray
                    there_here += normal[other_y, other_x, k] * ray
                # A degenerate face has no normal, and stands across the view.
                slope = near * here_there / here - near if here != 0.0 else 0.0
                other_slope = far - far * there_here / there if there != 0.0 else 0.0
                fall, least = near - far, tolerance * max(near, far)
                if fall > steeper * max(-slope, -other_slope, 0.0) + least:
                    found[y, x] = True
                elif -fall > steeper * max(slope, other_slope, 0.0) + least:
                    found[other_y, other_x] = True
