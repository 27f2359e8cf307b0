"""Swept tubes: closed, wound outward, of the analytic area and volume, free of twist."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from forestgen.geometry.mesh import Mesh
from forestgen.geometry.sweep import Polylines, rotation_minimising_frames, sides_for_radius, sweep, tangents

Floats = NDArray[np.float64]


def one(points: Floats, radius: Floats) -> Polylines:
    return Polylines(points, radius, np.array([0, len(points)]))


def straight(length: float = 3.0, n: int = 7, base: float = 0.5, tip: float = 0.5) -> Polylines:
    direction = np.array([1.0, 2.0, 2.0]) / 3.0
    return one(np.linspace(0, length, n)[:, None] * direction, np.linspace(base, tip, n))


def corners(mesh: Mesh) -> tuple[Floats, Floats, Floats]:
    vertices = mesh.vertices_m.astype(np.float64)
    return vertices[mesh.faces[:, 0]], vertices[mesh.faces[:, 1]], vertices[mesh.faces[:, 2]]


def volume(mesh: Mesh) -> float:
    a, b, c = corners(mesh)
    return float(np.sum(a * np.cross(b, c)) / 6.0)


def area(mesh: Mesh) -> float:
    a, b, c = corners(mesh)
    return float(np.sum(np.linalg.norm(np.cross(b - a, c - a), axis=1)) / 2.0)


def directed_edges(mesh: Mesh) -> set[tuple[int, int]]:
    edges = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]]).tolist()
    assert len(edges) == len({tuple(e) for e in edges}), "an edge is walked twice in one direction"
    return {(a, b) for a, b in edges}


@pytest.mark.parametrize("pointed", [True, False])
def test_capped_tube_is_closed_and_wound_outward(pointed: bool) -> None:
    mesh = sweep(straight(), np.array([9]), pointed=pointed, closed_base=True)
    edges = directed_edges(mesh)
    assert edges == {(b, a) for a, b in edges}
    assert volume(mesh) > 0


def test_cylinder_has_its_analytic_volume_and_area() -> None:
    sides, length, radius = 96, 3.0, 0.5
    mesh = sweep(straight(length, base=radius, tip=radius), np.array([sides]), pointed=False, closed_base=True)
    disc = 0.5 * sides * radius**2 * np.sin(2 * np.pi / sides)
    wall = sides * 2 * radius * np.sin(np.pi / sides) * length
    assert volume(mesh) == pytest.approx(disc * length, rel=1e-5)
    assert area(mesh) == pytest.approx(wall + 2 * disc, rel=1e-5)


def test_cone_has_its_analytic_volume_and_area() -> None:
    mesh = sweep(straight(3.0, base=0.5, tip=0.0), np.array([128]), pointed=True, closed_base=True)
    assert volume(mesh) == pytest.approx(np.pi * 0.25 * 3.0 / 3.0, rel=1e-3)
    assert area(mesh) == pytest.approx(np.pi * 0.5 * np.hypot(0.5, 3.0) + np.pi * 0.25, rel=1e-3)


def test_an_open_base_leaves_one_rim() -> None:
    edges = directed_edges(sweep(straight(), np.array([6])))
    assert len({(a, b) for a, b in edges if (b, a) not in edges}) == 6


def test_normals_are_unit_and_point_outward() -> None:
    mesh = sweep(straight(), np.array([8]))
    assert mesh.normals is not None
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1.0, atol=1e-5)
    axis = np.array([1.0, 2.0, 2.0]) / 3.0
    radial = mesh.vertices_m - (mesh.vertices_m @ axis)[:, None] * axis
    ring = np.linalg.norm(radial, axis=1) > 0.1
    assert np.all(np.sum(mesh.normals[ring] * radial[ring], axis=1) > 0)


def test_frames_on_a_planar_curve_keep_the_plane_normal() -> None:
    turn = np.linspace(0, 2.5, 60)
    points = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(60)])
    tangent, normal, binormal = rotation_minimising_frames(one(points, np.ones(60)))
    height = normal[:, 2] + 1j * binormal[:, 2]  # angle of the plane's normal within the frame
    np.testing.assert_allclose(np.angle(height / height[0]), 0.0, atol=1e-9)
    np.testing.assert_allclose(np.cross(tangent, normal), binormal, atol=1e-12)


def test_frames_on_a_helix_do_not_twist() -> None:
    def twist(n: int) -> float:
        turn = np.linspace(0, 4 * np.pi, n)
        points = np.column_stack([np.cos(turn), np.sin(turn), 0.3 * turn])
        _, normal, binormal = rotation_minimising_frames(one(points, np.ones(n)))
        rate = np.sum(np.diff(normal, axis=0) * (binormal[1:] + binormal[:-1]) / 2, axis=1)
        return float(np.abs(rate[1:-1]).sum())  # radians about the tangent over two coils

    assert twist(400) < 0.01
    assert twist(400) < twist(100) / 3  # converges


def test_tubes_of_a_batch_equal_tubes_swept_alone() -> None:
    rng = np.random.default_rng(3)
    sizes = [4, 2, 9]
    points = [np.cumsum(rng.normal(loc=[0, 0, 3], size=(n, 3)), axis=0) for n in sizes]
    radius = [np.linspace(0.2, 0.1, n) for n in sizes]
    offset = np.concatenate([[0], np.cumsum(sizes)])
    batch = sweep(Polylines(np.concatenate(points), np.concatenate(radius), offset), np.array([5, 3, 5]))
    alone = [sweep(one(p, r), np.array([s])) for p, r, s in zip(points, radius, (5, 3, 5), strict=True)]
    assert batch.triangles == sum(mesh.triangles for mesh in alone)
    assert area(batch) == pytest.approx(sum(area(mesh) for mesh in alone), rel=1e-6)


def test_tangents_do_not_mix_neighbouring_polylines() -> None:
    points = np.array([[0, 0, 0], [0, 0, 1], [5, 0, 0], [6, 0, 0]], dtype=np.float64)
    lines = Polylines(points, np.ones(4), np.array([0, 2, 4]))
    np.testing.assert_allclose(tangents(lines), [[0, 0, 1], [0, 0, 1], [1, 0, 0], [1, 0, 0]])


def test_thick_tubes_have_more_sides() -> None:
    sides = sides_for_radius(np.array([0.001, 0.015, 0.03, 0.06, 0.12, 0.5]))
    assert sides.tolist() == [3, 5, 6, 8, 12, 16]


def test_malformed_polylines_are_refused() -> None:
    with pytest.raises(ValueError, match="at least two points"):
        Polylines(np.zeros((3, 3)), np.ones(3), np.array([0, 1, 3]))
