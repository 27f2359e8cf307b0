"""An atlas gives each point of a surface its own place."""

from __future__ import annotations

import numpy as np

from forestgen.geometry.mesh import Mesh
from forestgen.geometry.simplify import unwrap
from forestgen.geometry.sweep import Polylines
from support.swept import sweep


def tree() -> Mesh:
    points = np.array([[0, 0, 0], [0.1, 0, 1], [0, 0.2, 2], [0, 0, 1], [1, 0, 1.5], [2, 0.5, 2.5]], dtype=np.float64)
    lines = Polylines(points, np.array([0.3, 0.25, 0.1, 0.1, 0.08, 0.02]), np.array([0, 3, 6]))
    return sweep(lines, np.array([12, 7]), pointed=False)


def covered(uv: np.ndarray, faces: np.ndarray, size: int) -> np.ndarray:
    """How many triangles hold the centre of each texel of a square of `size`."""
    count = np.zeros((size, size), dtype=int)
    for corner in uv[faces].astype(np.float64) * size:
        low = np.floor(corner.min(axis=0)).astype(int)
        high = np.minimum(np.ceil(corner.max(axis=0)).astype(int), size)
        x, y = np.meshgrid(np.arange(low[0], high[0]) + 0.5, np.arange(low[1], high[1]) + 0.5, indexing="ij")
        sides = [
            (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])
            for a, b in ((corner[k], corner[(k + 1) % 3]) for k in range(3))
        ]
        inside = np.all([s > 1e-9 for s in sides], axis=0) | np.all([s < -1e-9 for s in sides], axis=0)
        count[low[0] : high[0], low[1] : high[1]] += inside
    return count


def test_charts_lie_in_the_unit_square_and_do_not_overlap() -> None:
    mesh = unwrap(tree())
    assert mesh.uv is not None
    assert mesh.uv.min() >= 0.0
    assert mesh.uv.max() <= 1.0
    count = covered(mesh.uv, mesh.faces, 400)
    assert count.max() == 1
    assert count.mean() > 0.3, "most of the square is used"


def test_an_overlap_would_be_seen() -> None:
    swept = tree()  # its texture repeats, so its own coordinates overlap
    assert swept.uv is not None
    uv = (swept.uv - swept.uv.min(axis=0)) / np.ptp(swept.uv, axis=0)
    assert covered(uv, swept.faces, 400).max() > 1


def test_faces_and_normals_stay() -> None:
    before, after = tree(), unwrap(tree())
    np.testing.assert_array_equal(after.vertices_m[after.faces], before.vertices_m[before.faces])
    assert before.normals is not None
    assert after.normals is not None
    np.testing.assert_array_equal(after.normals[after.faces], before.normals[before.faces])


def test_texels_are_alike_in_area() -> None:
    mesh = unwrap(tree())
    assert mesh.uv is not None
    a, b, c = (mesh.vertices_m[mesh.faces[:, k]].astype(np.float64) for k in range(3))
    p, q, r = (mesh.uv[mesh.faces[:, k]].astype(np.float64) for k in range(3))
    on_surface = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    on_map = np.abs((q - p)[:, 0] * (r - p)[:, 1] - (q - p)[:, 1] * (r - p)[:, 0])
    share = on_map / on_surface
    assert np.quantile(share, 0.95) < 2.0 * np.quantile(share, 0.05)


def test_the_same_mesh_gives_the_same_atlas() -> None:
    first, second = unwrap(tree()), unwrap(tree())
    assert first.uv is not None
    assert second.uv is not None
    assert first.uv.tobytes() == second.uv.tobytes()
    assert first.faces.tobytes() == second.faces.tobytes()


def test_nothing_unwraps_to_nothing() -> None:
    none = unwrap(Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint32)))
    assert none.uv is not None
    assert none.uv.shape == (0, 2)
