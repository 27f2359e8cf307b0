"""Leaves, needles and flowers: thin blades in their own frame, and their instancing into one mesh.

A blade's frame has its foot (where it joins the stem) in the origin, y along the blade and z towards its upper side.
Sheets are single: their winding shows the upper side.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from forestgen.geometry.mesh import Mesh
from forestgen.geometry.vectors import unit, vertex_normals

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_ROUND_DELTOID = np.array([[0.68, 0.01], [1.00, 0.33], [0.80, 0.69]])
_ROUND_DELTOID_FINE = np.array(
    [[0.40, -0.02], [0.76, 0.04], [0.97, 0.21], [0.99, 0.41], [0.84, 0.62], [0.55, 0.81], [0.17, 0.94]]
)
_LANCEOLATE_FINE = np.array([[0.62, 0.10], [1.00, 0.30], [0.90, 0.50], [0.52, 0.78]])
_LANCEOLATE = np.array([[1.00, 0.30], [0.62, 0.72]])
_STALK_WIDTH = 0.018  # of the blade's length


def leaf(outline: Floats, length_m: float, width_m: float, *, stalk_m: float, fold_deg: float, curl_deg: float) -> Mesh:
    """A leaf of 2 K triangles and a stalk.

    Parameters
    ----------
    outline : (K, 2) right half: share of half the width, share of the length; foot (0, 0) and tip (0, 1) are implied.
    length_m, width_m : of the blade without its stalk.
    stalk_m : petiole; 0 for none, otherwise one slim triangle.
    fold_deg : each half rises this much above the midrib's plane.
    curl_deg : how far the tip bends below the foot's direction, along a circular arc.
    """
    right = outline * [0.5 * width_m, length_m]
    left = right * [-1.0, 1.0]
    flat = np.concatenate([[[0.0, 0.0]], right, [[0.0, length_m]], left[::-1]])
    n = len(flat)
    faces = [(0, k, k + 1) for k in range(1, n - 1)]
    height = np.abs(flat[:, 0]) * np.tan(np.radians(fold_deg))
    vertices = _curl(np.column_stack([flat, height]), length_m, np.radians(curl_deg))
    vertices[:, 1] += stalk_m
    if stalk_m > 0.0:
        half = _STALK_WIDTH * length_m
        vertices = np.concatenate([vertices, [[half, 0.0, 0.0], vertices[0], [-half, 0.0, 0.0]]])
        faces.append((n, n + 1, n + 2))
    return _sheet(vertices, faces)


def round_deltoid(
    length_m: float, width_m: float, stalk_m: float, fold_deg: float, curl_deg: float, *, fine: bool = False
) -> Mesh:
    """The nearly round, short-pointed leaf of a poplar: 6 triangles, 14 if fine, and 1 for the stalk."""
    outline = _ROUND_DELTOID_FINE if fine else _ROUND_DELTOID
    return leaf(outline, length_m, width_m, stalk_m=stalk_m, fold_deg=fold_deg, curl_deg=curl_deg)


def lanceolate(
    length_m: float, width_m: float, stalk_m: float, fold_deg: float, curl_deg: float, *, fine: bool = False
) -> Mesh:
    """A narrow leaf, widest at a third of its length: 4 triangles, 8 if fine, and 1 for a stalk."""
    outline = _LANCEOLATE_FINE if fine else _LANCEOLATE
    return leaf(outline, length_m, width_m, stalk_m=stalk_m, fold_deg=fold_deg, curl_deg=curl_deg)


def needle_shoot(length_m: float, width_m: float, pairs: int) -> Mesh:
    """A shoot of needles: tufts to both sides, above and at the tip, each one pointed triangle; 3 `pairs` + 1.

    A conifer of life size has millions of needles; a triangle here stands for the needles that overlap it.
    """
    step = length_m / (pairs + 0.8)
    foot = step * np.arange(pairs, dtype=np.float64)
    taper = 1.0 - 0.40 * (np.arange(pairs) / pairs) ** 2
    width = 0.92 * step
    turns = np.radians([12.0, 168.0, 85.0])  # about the shoot: right, left, above
    triangles = []
    for k, turn in enumerate(turns):
        # Unlike neighbours in attitude, so that no row is a saw blade.
        swing = np.radians(22.0) * np.sin(2.4 * np.arange(pairs) + 1.9 * k)
        reach = 0.5 * width_m * taper * (0.8 if k == 2 else 1.0)
        triangles.append(_tufts(foot + step * (0.05 + 0.3 * k), width, reach, turn + swing))
    end = np.array([[[0.3 * step, 0.72 * length_m, 0.0], [0.0, length_m, 0.0], [-0.3 * step, 0.72 * length_m, 0.0]]])
    corners = np.concatenate([*triangles, end]).reshape(-1, 3)
    return _sheet(corners, np.arange(len(corners)).reshape(-1, 3))


def _tufts(foot: Floats, base_m: float, reach_m: Floats, turn_rad: Floats) -> Floats:
    """(N, 3, 3) triangles: a side along y from each foot, the tip `reach_m` off the axis at `turn_rad`, leaning on."""
    out = np.zeros((len(foot), 3, 3))
    out[:, 0, 1] = foot + base_m
    out[:, 1, 1] = foot
    out[:, 2, 0] = reach_m * np.cos(turn_rad)
    out[:, 2, 2] = reach_m * np.sin(turn_rad)
    out[:, 2, 1] = foot + 0.5 * base_m + 1.15 * reach_m
    upper = np.cos(turn_rad) > 0.0  # the side that looks up, or to the left of the shoot
    out[~upper] = out[~upper, ::-1]
    return out


def four_petals(length_m: float, width_m: float, stalk_m: float, opening_deg: float) -> Mesh:
    """A flower on its stalk: four obovate petals, opened by `opening_deg` from the stalk's direction; 13 triangles."""
    half = 0.5 * width_m
    petal = np.array([[0.0, 0.0], [half, 0.62], [0.45 * half, 1.0], [-0.45 * half, 1.0], [-half, 0.62]])
    petal[:, 1] *= length_m
    opening = np.radians(opening_deg)
    vertices, faces = [], []
    for k in range(4):
        turn = 0.5 * np.pi * (k + 0.5)
        outward = np.array([np.cos(turn), 0.0, np.sin(turn)])
        along = np.sin(opening) * outward + np.cos(opening) * np.array([0.0, 1.0, 0.0])
        across = np.cross(along, np.cross(outward, [0.0, 1.0, 0.0]))
        across = np.cross(along, across)
        points = petal[:, :1] * unit(across) + petal[:, 1:] * along + [0.0, stalk_m, 0.0]
        start = 5 * k
        vertices.append(points)
        faces += [(start, start + j, start + j + 1) for j in (1, 2, 3)]
    slim = 0.035 * length_m + 0.0006
    vertices.append(np.array([[slim, 0.0, 0.0], [0.0, stalk_m * 1.02, 0.0], [-slim, 0.0, 0.0]]))
    faces.append((20, 21, 22))
    return _sheet(np.concatenate(vertices), faces)


def bud(length_m: float, width_m: float, stalk_m: float) -> Mesh:
    """A closed bud or a pod: a three-sided spindle of 6 triangles, thickest at 45% of its length, on a stalk."""
    turn = np.arange(3) * (2.0 * np.pi / 3.0)
    ring = np.column_stack([np.cos(turn), np.zeros(3), -np.sin(turn)]) * 0.5 * width_m
    ring[:, 1] = stalk_m + 0.45 * length_m
    vertices = np.concatenate([[[0.0, 0.0, 0.0]], ring, [[0.0, stalk_m + length_m, 0.0]]])
    faces = [(0, 1 + (k + 1) % 3, 1 + k) for k in range(3)] + [(4, 1 + k, 1 + (k + 1) % 3) for k in range(3)]
    return _sheet(vertices, faces)


def instance(template: Mesh, frames: NDArray[np.float32]) -> Mesh:
    """One mesh of the template under M transforms.

    Parameters
    ----------
    template : with normals.
    frames : (M, 3, 4) organ frame -> plant frame: rotation times uniform scale, and translation in metres.
    """
    if template.normals is None:
        raise ValueError("the template needs normals")
    count = len(template.vertices_m)
    linear = frames[:, :, :3]
    to_plant = linear.transpose(0, 2, 1)
    vertices = template.vertices_m @ to_plant + frames[:, None, :, 3]
    scale = np.cbrt(np.linalg.det(linear.astype(np.float64))).astype(np.float32)
    normals = template.normals @ (to_plant / scale[:, None, None])
    faces = template.faces[None] + (np.arange(len(frames), dtype=np.uint32) * np.uint32(count))[:, None, None]
    return Mesh(vertices.reshape(-1, 3), faces.reshape(-1, 3), normals.reshape(-1, 3))


def _curl(points: Floats, length_m: float, angle_rad: float) -> Floats:
    """Bend the (V, 3) blade down along an arc that turns by `angle_rad` over its length."""
    if abs(angle_rad) < 1e-6:
        return points
    radius = length_m / angle_rad
    turn = points[:, 1] / radius
    arm = radius + points[:, 2]
    return np.column_stack([points[:, 0], arm * np.sin(turn), arm * np.cos(turn) - radius])


def _sheet(vertices: Floats, faces: Sequence[tuple[int, int, int]] | Ints) -> Mesh:
    index = np.asarray(faces, dtype=np.int64)
    normals = vertex_normals(vertices, index)
    return Mesh(vertices.astype(np.float32), index.astype(np.uint32), normals.astype(np.float32))
