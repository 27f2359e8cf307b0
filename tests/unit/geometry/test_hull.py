"""A hull bounds its mesh as all of its vertices do, flat or solid."""

from __future__ import annotations

import numpy as np
import pytest

from forestgen.geometry.mesh import Mesh, hull_of


def mesh_of(points: np.ndarray) -> Mesh:
    """Triangles of three points each, in turn."""
    return Mesh(points.astype(np.float32), np.arange(len(points), dtype=np.uint32).reshape(-1, 3))


RNG = np.random.default_rng(1)
SHAPES = {
    "solid": RNG.normal(size=(3000, 3)),
    "flat": RNG.normal(size=(300, 3)) * [1, 1, 0] + [0, 0, 2],
    "flat and askew": RNG.normal(size=(300, 2)) @ RNG.normal(size=(2, 3)),
    "a line": RNG.normal(size=(30, 1)) * [1, 2, 3],
    "a point": np.ones((3, 3)),
    "a triangle": RNG.normal(size=(3, 3)),
    "thin": RNG.normal(size=(300, 3)) * [1, 1, 1e-12],
}


@pytest.mark.parametrize("shape", SHAPES)
def test_reaches_as_far_as_the_mesh_in_every_direction(shape):
    mesh = mesh_of(SHAPES[shape])
    hull = hull_of([mesh])
    direction = RNG.normal(size=(500, 3))
    expected = (mesh.vertices_m.astype(np.float64) @ direction.T).max(axis=0)
    np.testing.assert_allclose((hull.vertices_m @ direction.T).max(axis=0), expected, rtol=1e-12, atol=1e-12)
    assert set(map(tuple, hull.vertices_m)) <= set(map(tuple, mesh.vertices_m.astype(np.float64)))


def test_a_solid_keeps_few_points_and_the_edges_of_a_closed_surface():
    hull = hull_of([mesh_of(SHAPES["solid"])])
    assert len(hull.vertices_m) < 300
    assert len(hull.vertices_m) - len(hull.edges) + (2 * len(hull.edges)) // 3 == 2, "Euler: triangles are 2E/3"


def test_organs_are_one_and_points_of_no_face_are_left_out():
    near = Mesh(np.eye(3, dtype=np.float32), np.array([[0, 1, 2]], dtype=np.uint32))
    far = Mesh(np.eye(4, 3, dtype=np.float32) * 9 + 50, np.array([[0, 1, 2]], dtype=np.uint32))
    hull = hull_of([near, far])
    assert len(hull.vertices_m) == 6
    assert not (hull.vertices_m == 50).all(axis=1).any()


def test_nothing_has_an_empty_hull():
    assert len(hull_of([]).vertices_m) == 0
    assert len(hull_of([Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint32))]).edges) == 0
