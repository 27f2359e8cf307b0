"""What projections share: boxes of convex hulls in flat images, and in curved ones, whose edges they bend.

A hull that does not hold the camera covers a part of the sphere of directions. Image coordinates have no extreme inside
such a part, wherever the image is whole: they are reached at its border, on the hull's edges, which are arcs of great
circles. So edges are cut into pieces so short that the image of each is straight to _BEND_PX, and boxes are those of
the pieces' ends, widened by what the pieces bend between them. An image may be torn, straight behind a fisheye, at a
panorama's poles and its seam: `torn_boxes` widens the boxes of hulls that lie over such a place.

A hull that holds the camera is everywhere. The plane that tells which hulls lie over a direction is the one across it:
the hull's line along it is met where its projection on that plane surrounds the origin.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from forestgen.scene.projection import Bools, Floats, Projection, project
from forestgen.scene.spec import Camera

_BEND_PX = 0.005
_MOST_PIECES = 256  # of an edge
_NEAR_M = 1e-3  # what reaches as near to the camera may be seen anywhere
_POINTS_AT_ONCE = 1 << 19


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


class CurvedProjection(Projection):
    """A projection of directions around the camera."""

    def pixels_a_radian(self, camera: Camera) -> tuple[float, float]:
        """Along x and y, away from tears."""
        raise NotImplementedError

    def everywhere(self, camera: Camera) -> Floats:
        """(4,) box of all directions."""
        raise NotImplementedError

    def stretch_sine(self, seen: Floats, distance_m: Floats) -> Floats:
        """(N, V) sine of the angle from (N, V, 3) points to the nearest tear, near which the image bends more."""
        raise NotImplementedError

    def torn_boxes(self, camera: Camera, box: Floats, unit: Floats) -> Floats:
        """(N, 4) boxes, of hulls with vertices towards (N, V, 3) `unit`, that hold what lies over tears too."""
        raise NotImplementedError

    def hull_boxes(self, camera: Camera, seen: Floats, edges: NDArray[np.int64]) -> tuple[Floats, Bools]:
        around = _around(seen)
        box = np.tile(self.everywhere(camera), (len(seen), 1))
        rows = np.flatnonzero(~around)
        pieces = np.full(len(seen), _MOST_PIECES)
        pieces[rows] = self._pieces(camera, seen[rows], edges)
        for count in np.unique(pieces[rows]):
            mine = rows[pieces[rows] == count]
            step = max(1, _POINTS_AT_ONCE // (len(edges) * (int(count) + 1)))
            for first in range(0, len(mine), step):
                some = mine[first : first + step]
                box[some] = self._box_of(camera, seen[some], edges, int(count))
        return box, around

    def _pieces(self, camera: Camera, seen: Floats, edges: NDArray[np.int64]) -> NDArray[np.int64]:
        """(N,) pieces for each edge of a hull, a power of 2."""
        distance = np.sqrt(np.einsum("nvk,nvk->nv", seen, seen))
        unit = seen / distance[..., None]
        chord = unit[:, edges[:, 0]] - unit[:, edges[:, 1]]
        angle = 2.0 * np.arcsin(np.minimum(np.sqrt(np.einsum("nek,nek->ne", chord, chord)).max(axis=1) / 2.0, 1.0))
        stretch = 1.0 / np.clip(self.stretch_sine(seen, distance).min(axis=1), 1e-3, 1.0) ** 2
        # An arc of angle a strays from its chord by a^2 / 8 of its bend, which is a few pixels a radian squared.
        bend = 3.0 * max(self.pixels_a_radian(camera)) * stretch
        wanted = angle / np.sqrt(8 * _BEND_PX / bend)
        power = np.ceil(np.log2(np.clip(wanted, 1.0, _MOST_PIECES)))
        return np.asarray((2**power).astype(np.int64))

    def _box_of(self, camera: Camera, seen: Floats, edges: NDArray[np.int64], pieces: int) -> Floats:
        """(N, 4) of hulls that do not hold the camera."""
        unit = seen / np.linalg.norm(seen, axis=-1, keepdims=True)
        hull, edge = np.nonzero(self._outermost(camera, unit, edges, pieces))
        share = (np.arange(pieces + 1) / pieces)[:, None]
        a, b = unit[hull, edges[edge, 0], None], unit[hull, edges[edge, 1], None]
        at = project(camera, a + share * (b - a))  # along the chord, whose directions are the arc's
        x, y = self._unrolled(camera, at.x_px, at.x_px[np.searchsorted(hull, hull), :1]), at.y_px
        first = np.searchsorted(hull, np.arange(len(seen)))
        low = [np.minimum.reduceat((v - _bend(v)).min(axis=1), first) for v in (x, y)]
        high = [np.maximum.reduceat((v + _bend(v)).max(axis=1), first) for v in (x, y)]
        return self.torn_boxes(camera, np.stack([*low, *high], axis=1), unit)

    def _unrolled(self, camera: Camera, x_px: Floats, from_px: Floats) -> Floats:
        """From a point of each hull on, so that no edge jumps from one end of the image to the other."""
        width = camera.size_px[0]
        return x_px - width * np.round((x_px - from_px) / width) if self.wraps_x else x_px

    def _outermost(self, camera: Camera, unit: Floats, edges: NDArray[np.int64], pieces: int) -> Bools:
        """(N, E) edges that may reach the border of their hull's box: an end is as near as an arc may stray, or it is
        long.
        """
        if pieces == _MOST_PIECES:
            return np.ones((len(unit), len(edges)), dtype=np.bool_)
        at = project(camera, unit)
        stray, kept = _BEND_PX * pieces**2, np.zeros((len(unit), len(edges)), dtype=np.bool_)
        for v in (self._unrolled(camera, at.x_px, at.x_px[:, :1]), at.y_px):
            a, b = v[:, edges[:, 0]], v[:, edges[:, 1]]
            low, high = v.min(axis=1, keepdims=True) + stray, v.max(axis=1, keepdims=True) - stray
            kept |= (np.minimum(a, b) <= low) | (np.maximum(a, b) >= high) | (np.abs(a - b) > camera.size_px[0] / 4)
        return kept


def _around(seen: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(N,) the hull holds the camera, or comes too near to it."""
    # A plane between hull and camera shows that it does not. Three that are likely; few hulls need the last word.
    unit = seen / np.maximum(np.linalg.norm(seen, axis=-1, keepdims=True), 1e-300)
    clear = np.zeros(len(seen), dtype=np.bool_)
    for towards in (unit.mean(axis=1), seen.mean(axis=1), 0.5 * (unit.min(axis=1) + unit.max(axis=1))):
        clear |= np.einsum("nvk,nk->nv", seen, towards).min(axis=1) > _NEAR_M * np.linalg.norm(towards, axis=1)
    around = ~clear
    for row in np.flatnonzero(around):
        around[row] = _distance(seen[row]) < _NEAR_M
    return around


def _distance(points: NDArray[np.float64]) -> float:
    """From the origin to the convex hull of (V, 3) points: weights w >= 0 of least |w p|^2 + (1 - sum w)^2."""
    from scipy.optimize import nnls

    _, rest = nnls(np.vstack([points.T, np.ones(len(points))]), np.array([0.0, 0.0, 0.0, 1.0]))
    return float(rest / np.sqrt(max(1.0 - rest * rest, 1e-300)))


def _bend(way: NDArray[np.float64]) -> NDArray[np.float64]:
    """By how much ways of (N, P) points may stray from the chords beside each: an eighth of the second step."""
    if way.shape[1] < 3:
        return np.zeros(way.shape)
    return np.pad(np.abs(np.diff(way, n=2, axis=1)) / 8, ((0, 0), (1, 1)), mode="edge")


def lies_over(unit: NDArray[np.float64], direction: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(N,) hulls that do not hold the camera lie over a direction: it is met by a line from the camera."""
    along = unit @ direction
    first, second = np.linalg.svd(direction[None])[2][1:]
    angle = np.sort(np.arctan2(unit @ second, unit @ first), axis=1)
    gap = np.concatenate([np.diff(angle, axis=1), angle[:, :1] + 2 * np.pi - angle[:, -1:]], axis=1).max(axis=1)
    # Surrounded: the line along the direction meets the hull. It does so on the one side on which the hull is: that of
    # the middle of its directions, or else the hull would hold the camera.
    found = (gap < np.pi + 1e-9) & (along > 0).any(axis=1)
    rows = np.flatnonzero(found & (along < 0).any(axis=1))
    for row in rows:
        found[row] = _meets(unit[row], direction)
    return np.asarray(found)


def _meets(unit: NDArray[np.float64], direction: NDArray[np.float64]) -> bool:
    """Whether a direction is among those of a convex cone, given by rays of it: non-negative least squares."""
    from scipy.optimize import nnls

    _, rest = nnls(unit.T, direction)
    return bool(rest < 1e-9)
