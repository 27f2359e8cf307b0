"""Swept tubes: closed, wound outward, of the analytic area and volume, free of twist, with texture coordinates."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from forestgen.core import threads
from forestgen.geometry.mesh import Mesh
from forestgen.geometry.sweep import (
    Polylines,
    rotation_minimising_frames,
    sides_for_radius,
    sweep_tubes,
)
from forestgen.geometry.sweep_kernel import circumradius
from support.swept import sweep, volume_m3

Floats = NDArray[np.float64]


def one(points: Floats, radius: Floats) -> Polylines:
    return Polylines(points, radius, np.array([0, len(points)]))


def straight(length: float = 3.0, n: int = 7, base: float = 0.5, tip: float = 0.5) -> Polylines:
    direction = np.array([1.0, 2.0, 2.0]) / 3.0
    return one(np.linspace(0, length, n)[:, None] * direction, np.linspace(base, tip, n))


def arc(bend_rad: float, n: int, radius: float) -> Polylines:
    turn = np.linspace(0.0, bend_rad, n)
    return one(np.column_stack([np.cos(turn), np.zeros(n), np.sin(turn)]), np.full(n, radius))


def corners(mesh: Mesh) -> tuple[Floats, Floats, Floats]:
    vertices = mesh.vertices_m.astype(np.float64)
    return vertices[mesh.faces[:, 0]], vertices[mesh.faces[:, 1]], vertices[mesh.faces[:, 2]]


def volume(mesh: Mesh) -> float:
    a, b, c = corners(mesh)
    return float(np.sum(a * np.cross(b, c)) / 6.0)


def area(mesh: Mesh) -> float:
    a, b, c = corners(mesh)
    return float(np.sum(np.linalg.norm(np.cross(b - a, c - a), axis=1)) / 2.0)


def merged_faces(mesh: Mesh) -> NDArray[np.int64]:
    """Faces by place: vertices of equal position are one."""
    _, place = np.unique(mesh.vertices_m, axis=0, return_inverse=True)
    return place.reshape(-1)[mesh.faces.astype(np.int64)]


def open_edges(mesh: Mesh) -> int:
    """Edges that are not walked as often one way as the other."""
    faces = merged_faces(mesh)
    ways = Counter(map(tuple, np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).tolist()))
    return sum(count != ways.get((b, a), 0) for (a, b), count in ways.items())


def assert_sound(mesh: Mesh) -> None:
    faces = merged_faces(mesh)
    assert open_edges(mesh) == 0
    assert not np.any((faces[:, 0] == faces[:, 1]) | (faces[:, 1] == faces[:, 2]) | (faces[:, 2] == faces[:, 0]))
    assert len(np.unique(np.sort(faces, axis=1), axis=0)) == len(faces), "no face twice"
    a, b, c = corners(mesh)
    assert np.all(np.any(np.cross(b - a, c - a) != 0.0, axis=1)), "every face has an area"
    assert mesh.normals is not None
    assert mesh.uv is not None
    for array in (mesh.vertices_m, mesh.normals, mesh.uv):
        assert np.all(np.isfinite(array))
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1.0, atol=1e-5)


@pytest.mark.parametrize("pointed", [True, False])
@pytest.mark.parametrize("sides", [3, 4, 7, 8, 16])
def test_a_tube_is_closed_and_wound_outward(pointed: bool, sides: int) -> None:
    mesh = sweep(straight(), np.array([sides]), pointed=pointed)
    assert_sound(mesh)
    assert volume(mesh) > 0
    ways = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
    assert len(np.unique(ways, axis=0)) == len(ways), "no edge is walked twice in one direction"


@pytest.mark.parametrize("sides", [3, 4, 5, 12, 96])
def test_a_cylinder_has_the_volume_of_a_round_one(sides: int) -> None:
    length, radius = 3.0, 0.5
    mesh = sweep(straight(length, base=radius, tip=radius), np.array([sides]), pointed=False)
    assert volume(mesh) == pytest.approx(np.pi * radius**2 * length, rel=1e-5)
    rim = 2.0 * sides * radius * circumradius(sides) * np.sin(np.pi / sides)
    assert area(mesh) == pytest.approx(rim * length + 2.0 * np.pi * radius**2, rel=1e-5)
    assert rim / (2.0 * np.pi * radius) == pytest.approx(np.sqrt(sides * np.tan(np.pi / sides) / np.pi), rel=1e-9)


@pytest.mark.parametrize("sides", [3, 8, 32])
def test_a_cone_and_a_frustum_have_their_volumes(sides: int) -> None:
    cone = sweep(straight(3.0, base=0.5, tip=0.0), np.array([sides]), pointed=True)
    assert volume(cone) == pytest.approx(np.pi * 0.25 * 3.0 / 3.0, rel=1e-5)
    lines = straight(3.0, base=0.5, tip=0.2)
    assert volume(sweep(lines, np.array([sides]), pointed=False)) == pytest.approx(volume_m3(lines), rel=1e-5)
    assert volume_m3(lines) == pytest.approx(np.pi * (0.25 + 0.1 + 0.04), rel=1e-12)


@pytest.mark.parametrize("bend_deg", [5.0, 40.0, 90.0, 119.0])
@pytest.mark.parametrize("sides", [3, 4, 9])
def test_a_mitred_bend_keeps_section_and_volume(bend_deg: float, sides: int) -> None:
    turn = np.radians(bend_deg)
    points = np.array([[0, 0, 0], [0, 0, 2.0], [2 * np.sin(turn), 0, 2 + 2 * np.cos(turn)]])
    lines = one(points, np.full(3, 0.3))
    mesh = sweep(lines, np.array([sides]), pointed=False)
    assert volume(mesh) == pytest.approx(volume_m3(lines), rel=1e-5)
    ring = mesh.vertices_m[:sides].astype(np.float64)  # the first ring's edges run on at right angles to it
    stride = sides + 1 + sides + (sides >= 8)
    bent = mesh.vertices_m[stride : stride + sides].astype(np.float64)
    np.testing.assert_allclose(bent[:, :2], ring[:, :2], atol=1e-5)


def test_a_sharper_bend_is_stretched_at_most_twofold() -> None:
    turn = np.radians(165.0)
    points = np.array([[0, 0, 0], [0, 0, 2.0], [2 * np.sin(turn), 0, 2 + 2 * np.cos(turn)]])
    mesh = sweep(one(points, np.full(3, 0.1)), np.array([12]), pointed=False)
    assert_sound(mesh)
    assert mesh.vertices_m[:, 2].max() < 2.0 + 2.01 * 0.1 * circumradius(12)


@pytest.mark.parametrize("ratio", [0.4, 1.0, 2.5])
def test_an_elliptical_section_has_its_ratio_and_area(ratio: float) -> None:
    lines = one(np.array([[0, 0, 0], [1, 0, 0.5], [2, 0, 1.0]], dtype=np.float64), np.full(3, 0.2))
    mesh = sweep(lines, np.array([64]), pointed=False, height_ratio=ratio)
    assert volume(mesh) == pytest.approx(volume_m3(lines), rel=1e-5)
    up = np.array([-1.0, 0.0, 2.0]) / np.sqrt(5.0)
    middle = mesh.vertices_m[64 + 1 + 64 + 1 :][:64] - np.array([1, 0, 0.5])
    assert np.ptp(middle @ up) / np.ptp(middle[:, 1]) == pytest.approx(ratio, rel=5e-3)


def test_an_upright_tube_stays_round() -> None:
    lines = one(np.array([[0, 0, 0], [0, 0, 1.0]]), np.full(2, 0.2))
    mesh = sweep(lines, np.array([64]), pointed=False, height_ratio=2.0)
    np.testing.assert_allclose(np.ptp(mesh.vertices_m[:, 0]), np.ptp(mesh.vertices_m[:, 1]), rtol=1e-3)


@pytest.mark.parametrize("factor", [None, "ridges"])
def test_smooth_normals_agree_with_the_facets(factor: str | None) -> None:
    """With many sides and rings, a vertex' normal is that of the faces around it, weighted by their areas."""
    n, sides = 160, 128
    turn = np.linspace(0.0, 1.2, n)
    points = np.column_stack([3 * np.cos(turn), 3 * np.sin(turn), turn])
    lines = one(points, np.linspace(0.5, 0.2, n))
    angle = np.arange(sides) * (2 * np.pi / sides)
    ridges = 1.0 + 0.15 * np.cos(3 * angle + 4 * turn[:, None])
    shaped = None if factor is None else ridges
    mesh = sweep(lines, np.array([sides]), pointed=False, radial_factor=shaped, height_ratio=1.5)
    assert mesh.normals is not None
    a, b, c = corners(mesh)
    facet = np.cross(b - a, c - a)
    _, place = np.unique(mesh.vertices_m, axis=0, return_inverse=True)
    total = np.zeros((place.max() + 1, 3))
    wall = np.abs(np.sum(facet * mesh.normals[mesh.faces[:, 0]], axis=1)) > 0
    for k in range(3):
        np.add.at(total, place.reshape(-1)[mesh.faces[wall, k]], facet[wall])
    expected = total / np.linalg.norm(total, axis=1, keepdims=True)
    first_free = (sides + 1) + (sides + 1)  # the end rings share their places with the caps
    inner = np.arange(first_free, first_free + (n - 2) * (sides + 1))
    cosine = np.sum(mesh.normals[inner] * expected[place.reshape(-1)[inner]], axis=1)
    assert cosine.min() > 0.995


def test_normals_of_a_cone_lean_by_its_slope() -> None:
    mesh = sweep(one(np.array([[0, 0, 0], [0, 0, 1], [0, 0, 2.0]]), np.array([1, 0.5, 0.0])), np.array([16]))
    assert mesh.normals is not None
    walls = np.abs(mesh.normals[:, 2] + 1.0) > 1e-3
    np.testing.assert_allclose(mesh.normals[walls, 2], 0.5 / np.hypot(1.0, 0.5), atol=0.01)


def test_texture_runs_by_arc_length_and_whole_repeats() -> None:
    lines = one(np.array([[0, 0, 0], [0, 0, 1], [0, 0.3, 1.4]], dtype=np.float64), np.array([0.5, 0.4, 0.3]))
    sides = 10
    mesh = sweep(lines, np.array([sides]), pointed=False, tile_m=(0.6, 0.25))
    assert mesh.uv is not None
    repeats = round(np.pi / 0.6)
    ring_of = [np.arange(sides + 1), *(sides + 1 + sides + 1 + k * (sides + 1) + np.arange(sides + 1) for k in (0, 1))]
    for ring, way in zip(ring_of, (0.0, 1.0, 1.5), strict=True):
        np.testing.assert_allclose(mesh.uv[ring, 0], np.linspace(0, repeats, sides + 1), atol=1e-5)
        np.testing.assert_allclose(mesh.uv[ring, 1], way / 0.25, rtol=1e-6)
        np.testing.assert_array_equal(mesh.vertices_m[ring[0]], mesh.vertices_m[ring[-1]])
    thin = sweep(straight(base=0.01, tip=0.01), np.array([5]), pointed=False)
    assert thin.uv is not None
    assert thin.uv[:6, 0].max() == 1.0, "at least one repeat"


def test_no_triangle_of_the_wall_spans_the_seam() -> None:
    mesh = sweep(arc(1.5, 12, 0.2), np.array([9]))
    assert mesh.uv is not None
    u = mesh.uv[mesh.faces[9:], 0]  # less the cap's nine
    assert np.ptp(u, axis=1).max() < 1.5 / 9 + 1e-6


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


def test_frames_do_not_mix_neighbouring_polylines() -> None:
    points = np.array([[0, 0, 0], [0, 0, 1], [5, 0, 0], [6, 0, 0]], dtype=np.float64)
    tangent, normal, _ = rotation_minimising_frames(Polylines(points, np.ones(4), np.array([0, 2, 4])))
    np.testing.assert_allclose(tangent, [[0, 0, 1], [0, 0, 1], [1, 0, 0], [1, 0, 0]])
    np.testing.assert_allclose(np.sum(tangent * normal, axis=1), 0.0, atol=1e-12)


def test_tubes_of_a_batch_equal_tubes_swept_alone() -> None:
    rng = np.random.default_rng(3)
    sizes = [4, 2, 9]
    points = [np.cumsum(rng.normal(loc=[0, 0, 3], size=(n, 3)), axis=0) for n in sizes]
    radius = [np.linspace(0.2, 0.1, n) for n in sizes]
    offset = np.concatenate([[0], np.cumsum(sizes)])
    pointed = np.array([True, False, True])
    lines = Polylines(np.concatenate(points), np.concatenate(radius), offset)
    batch, start = sweep_tubes(lines, np.array([5, 3, 9]), pointed=pointed)
    for k, (p, r, s) in enumerate(zip(points, radius, (5, 3, 9), strict=True)):
        alone = sweep(one(p, r), np.array([s]), pointed=bool(pointed[k]))
        np.testing.assert_array_equal(batch.vertices_m[start[k] : start[k + 1]], alone.vertices_m)
    assert batch.triangles == sum(
        sweep(one(p, r), np.array([s]), pointed=bool(q)).triangles
        for p, r, s, q in zip(points, radius, (5, 3, 9), pointed, strict=True)
    )


def test_the_mesh_does_not_depend_on_the_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    count = 25_000
    rng = np.random.default_rng(4)
    points = np.cumsum(rng.normal([0, 0, 2], size=(count, 3, 3)), axis=1).reshape(-1, 3)
    lines = Polylines(points, np.tile([0.2, 0.1, 0.05], count), np.arange(count + 1) * 3)
    meshes = []
    for cores in (1, 2):
        monkeypatch.setattr(threads, "cores", lambda cores=cores: cores)
        meshes.append(sweep(lines, np.full(count, 4)))
    for name in ("vertices_m", "faces", "normals", "uv"):
        assert getattr(meshes[0], name).tobytes() == getattr(meshes[1], name).tobytes()


COORDINATE = st.one_of(st.sampled_from([0.0, 1.0, -1.0, 0.5, 10.0]), st.floats(-20.0, 20.0, allow_nan=False, width=32))
RADIUS = st.one_of(st.sampled_from([0.0, 1e-6, 0.5, 1.0]), st.floats(0.0, 2.0, width=32))


@settings(max_examples=300, deadline=None)
@given(
    st.lists(st.tuples(COORDINATE, COORDINATE, COORDINATE, RADIUS), min_size=2, max_size=8),
    st.integers(3, 10),
    st.booleans(),
    st.sampled_from([0.4, 1.0, 2.5]),
)
@example([(0, 0, 0, 1), (0, 0, 1, 1), (0, 0, 0, 1), (0, 0, 2, 1)], 4, False, 1.0)  # there and back
@example([(0, 0, 0, 1), (0, 0, 0, 1)], 4, False, 1.0)  # no length
@example([(0, 0, 0, 1), (0, 0, 1, 1), (0, 0, 1, 0.5), (0, 0, 2, 0.5), (0, 0, 2, 0.5)], 8, True, 1.0)  # twice
@example([(0, 0, 0, 0), (0, 0, 1, 0)], 4, False, 1.0)  # no thickness
@example([(0, 0, 0, 1), (0, 0, 1, 0), (0, 0, 2, 1)], 4, False, 1.0)  # a pinch
@example([(0, 0, 0, 1), (0, 0, 1, 1), (0, 1, 1, 1), (0, 1, 0, 1)], 4, False, 1.0)  # rings that touch
def test_any_polyline_gives_a_sound_mesh_or_none(
    rows: list[tuple[float, float, float, float]], sides: int, pointed: bool, ratio: float
) -> None:
    table = np.array(rows, dtype=np.float64)
    mesh = sweep(one(table[:, :3], table[:, 3]), np.array([sides]), pointed=pointed, height_ratio=ratio)
    assert_sound(mesh)
    if not mesh.triangles:
        distance = np.linalg.norm(table[:, :3] - table[0, :3], axis=1)
        assert table[:, 3].max() < 1e-4 or distance.max() < 1e-4 or len(rows) > 2


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([3, 4, 6, 12]))
def test_a_random_gently_bent_tube_has_the_volume_of_its_frusta(seed: int, sides: int) -> None:
    rng = np.random.default_rng(seed)
    step = rng.normal([0, 0, 1.0], 0.15, size=(12, 3))  # bends of at most about 50 degrees
    points = np.cumsum(step, axis=0)
    lines = one(points, np.sort(rng.uniform(0.02, 0.12, 12))[::-1].copy())
    mesh = sweep(lines, np.array([sides]), pointed=False)
    assert_sound(mesh)
    assert volume(mesh) == pytest.approx(volume_m3(lines), rel=0.01)


def test_repeated_points_change_nothing() -> None:
    points = np.array([[0, 0, 0], [0, 0, 1], [0, 1, 2]], dtype=np.float64)
    radius = np.array([0.3, 0.2, 0.1])
    twice = one(np.repeat(points, 2, axis=0), np.repeat(radius, 2))
    once, again = (sweep(lines, np.array([6])) for lines in (one(points, radius), twice))
    np.testing.assert_array_equal(once.vertices_m, again.vertices_m)


def test_a_tube_that_float32_cannot_hold_is_left_out() -> None:
    far = np.array([[30, 0, 0], [30, 0, 1.0]])
    assert sweep(one(far, np.full(2, 1e-6)), np.array([4])).triangles == 0
    assert sweep(one(far, np.full(2, 1e-3)), np.array([4])).triangles > 0


def test_thick_tubes_have_more_sides() -> None:
    sides = sides_for_radius(np.array([0.0005, 0.002, 0.007, 0.015, 0.03, 0.08, 0.2, 0.5]))
    assert sides.tolist() == [3, 4, 5, 6, 8, 12, 16, 24]


def test_no_tubes_make_an_empty_mesh() -> None:
    mesh = sweep(Polylines(np.zeros((0, 3)), np.zeros(0), np.zeros(1, np.int64)), np.zeros(0, np.int64))
    assert mesh.triangles == 0
    assert mesh.uv is not None
