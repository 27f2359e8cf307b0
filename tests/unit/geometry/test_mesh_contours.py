"""Meshes cut along contours, and finer ones: no surface is lost, and each part is on its side."""

from __future__ import annotations

import numpy as np

from forestgen.geometry.contours import bisected, cut
from forestgen.geometry.mesh import Mesh, surface_area_m2
from forestgen.geometry.sweep import Polylines, sweep_tubes


def tube() -> Mesh:
    """Of 2 m, with normals and uv."""
    points = np.stack([np.zeros(9), np.zeros(9), np.linspace(0.0, 2.0, 9)], axis=1)
    return sweep_tubes(Polylines(points, np.full(9, 0.2), np.array([0, 9])), np.array([16]), pointed=False)[0]


def test_a_cut_shares_out_the_surface() -> None:
    mesh = tube()
    value = np.sin(5.0 * mesh.vertices_m[:, 0] + 3.0 * mesh.vertices_m[:, 2].astype(np.float64))
    (below, below_of), (above, above_of) = cut(mesh, value)
    assert np.isclose(surface_area_m2(below) + surface_area_m2(above), surface_area_m2(mesh), rtol=1e-5)
    assert set(below_of) | set(above_of) == set(range(mesh.triangles))
    height_m = mesh.vertices_m[:, 2].astype(np.float64)
    (low, _), (high, _) = cut(mesh, height_m - 0.77)
    assert np.isclose(low.vertices_m[:, 2].max(), 0.77)
    assert np.isclose(high.vertices_m[:, 2].min(), 0.77)
    assert high.normals is not None
    assert np.allclose(np.linalg.norm(high.normals, axis=1), 1.0, atol=1e-5)


def test_a_cut_that_meets_nothing_leaves_all_on_one_side() -> None:
    mesh = tube()
    (below, _), (above, of) = cut(mesh, np.ones(len(mesh.vertices_m)))
    assert below.triangles == 0
    assert (above.triangles, len(of)) == (mesh.triangles, mesh.triangles)


def test_bisected_faces_are_two_of_the_same_surface() -> None:
    mesh = tube()
    chosen = np.arange(mesh.triangles) % 3 == 0
    finer, of = bisected(mesh, chosen)
    assert finer.triangles == mesh.triangles + int(chosen.sum())
    assert np.isclose(surface_area_m2(finer), surface_area_m2(mesh), rtol=1e-6)
    assert np.array_equal(np.bincount(of), np.where(chosen, 2, 1))
