"""What flat images share: straight lines stay straight, and depth runs along the camera's axis."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from forestgen.scene.projection import Bools, Floats, Projection
from forestgen.scene.spec import Camera


class FlatProjection(Projection):
    """A projection of flat images.

    A convex hull's projection bounds its mesh's, as long as it lies in front of the camera. What reaches behind is cut
    by a plane `nearest_m` in front of it. Nothing of a plant that stays clear of the camera's own surroundings is lost
    from the image by that; a plant that does not may be anywhere.
    """

    depth_is_distance = False
    nearest_m: float  # in front of the camera

    def hull_boxes(self, camera: Camera, seen: Floats, edges: NDArray[np.int64]) -> tuple[Floats, Bools]:
        front = seen[..., 2] >= self.nearest_m
        whole, some = front.all(axis=1), front.any(axis=1)
        box = np.full((len(seen), 4), np.nan)
        box[whole] = self.box_of(camera, seen[whole])
        for row in np.flatnonzero(some & ~whole):
            points = seen[row]
            crossing = edges[front[row, edges[:, 0]] != front[row, edges[:, 1]]]
            a, b = points[crossing[:, 0]], points[crossing[:, 1]]
            share = (self.nearest_m - a[:, 2]) / (b[:, 2] - a[:, 2])
            cut = a + share[:, None] * (b - a)
            cut[:, 2] = self.nearest_m
            box[row] = self.box_of(camera, np.concatenate([points[front[row]], cut])[None])[0]
        return box, self.around_camera(camera, seen)

    def box_of(self, camera: Camera, seen: Floats) -> Floats:
        """(N, 4) of (N, V, 3) points in front of the camera."""
        raise NotImplementedError

    def around_camera(self, camera: Camera, seen: Floats) -> Bools:
        """(N,) the instance's box holds a point of the view nearer than `nearest_m`: it may be seen in any pixel."""
        raise NotImplementedError


def extent(x: Floats, y: Floats) -> Floats:
    """(N, 4) boxes of (N, V) points: left, top, right, bottom."""
    return np.stack([x.min(axis=1), y.min(axis=1), x.max(axis=1), y.max(axis=1)], axis=1)
