"""Pieces of organs, and their instancing."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from forestgen.geometry.mesh import instance
from forestgen.geometry.patches import Patch, area_m2, bend, revolve, strip, to_mesh, tube, whorl
from forestgen.plants.organs.leaves import SimpleLeaf

SQUARE = Patch(
    np.array([[-1.0, 0, 0], [1, 0, 0], [1, 2, 0], [-1, 2, 0]]), np.array([[0, 1, 2], [0, 2, 3]]), np.eye(4, 2)
)
LEAF = SimpleLeaf(
    form="simple", material="leaf", length_m=0.08, width_m=0.05, fold_deg=14.0, curl_deg=20.0, stalk_m=0.04
)


def volume_m3(patch: Patch) -> float:
    a, b, c = (patch.points[patch.faces[:, k]] for k in range(3))
    return float(np.sum(a * np.cross(b, c)) / 6.0)


@pytest.mark.parametrize("growth", [1.0, 1.6, 2.5])
@pytest.mark.parametrize("angle", [-2.0, 0.5, 3.0])
def test_bending_keeps_the_length_of_the_middle_line(growth: float, angle: float) -> None:
    line = np.column_stack([np.zeros(400), np.linspace(0.0, 0.7, 400), np.zeros(400)])
    bent = bend(line, 0.7, angle, growth)
    assert np.linalg.norm(np.diff(bent, axis=0), axis=1).sum() == pytest.approx(0.7, rel=1e-4)
    last = bent[-1] - bent[-2]
    assert np.arctan2(-last[2], last[1]) % (2.0 * np.pi) == pytest.approx(angle % (2.0 * np.pi), abs=0.02)


def test_a_bend_of_one_growth_is_a_circular_arc() -> None:
    line = np.column_stack([np.zeros(50), np.linspace(0.0, 1.0, 50), np.zeros(50)])
    bent = bend(line, 1.0, np.pi / 2.0)
    np.testing.assert_allclose(np.linalg.norm(bent + np.array([0.0, 0.0, 2.0 / np.pi]), axis=1), 2.0 / np.pi, atol=1e-4)


def test_a_body_of_revolution_is_closed_and_wound_outward() -> None:
    angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 41)
    profile = np.column_stack([np.cos(angle), np.sin(angle)])
    profile[[0, -1], 0] = 0.0
    ball = revolve(profile, 64)
    assert volume_m3(ball) == pytest.approx(4.0 / 3.0 * np.pi, rel=0.01)
    edges = np.concatenate([ball.faces[:, [0, 1]], ball.faces[:, [1, 2]], ball.faces[:, [2, 0]]])
    assert {tuple(e) for e in edges.tolist()} == {tuple(e[::-1]) for e in edges.tolist()}


def test_a_tube_looks_outward_and_has_its_cylinders_area() -> None:
    path = np.column_stack([np.zeros(5), np.linspace(0.0, 2.0, 5), np.zeros(5)])
    pipe = tube(path, np.full(5, 0.1), 60)
    assert area_m2(pipe) == pytest.approx(2.0 * np.pi * 0.1 * 2.0, rel=0.001)
    a, b, c = (pipe.points[pipe.faces[:, k]] for k in range(3))
    outward = (a + b + c) / 3.0 * [1.0, 0.0, 1.0]
    assert np.all(np.sum(outward * np.cross(b - a, c - a), axis=1) > 0.0)


@pytest.mark.parametrize("folded", [False, True])
@pytest.mark.parametrize("keel_rad", [0.0, 0.5])
def test_a_strip_has_its_trapezoids_area(folded: bool, keel_rad: float) -> None:
    ribbon = strip(1.0, np.array([0.1, 0.2, 0.0]), keel_rad=keel_rad, folded=folded)
    flat = area_m2(ribbon) if folded else area_m2(ribbon) / np.cos(keel_rad)
    assert flat == pytest.approx(0.125, rel=0.01)
    a, b, c = (ribbon.points[ribbon.faces[:, k]] for k in range(3))
    assert np.all(np.cross(b - a, c - a)[:, 2] > 0.0)


def test_a_whorl_turns_its_upper_sides_inward() -> None:
    for opening in (0.3, 1.2):
        mesh = to_mesh(whorl(SQUARE, 5, opening, 0.5))
        assert mesh.normals is not None
        middle = mesh.vertices_m.reshape(5, 4, 3).mean(axis=1)
        radial = middle * [1.0, 0.0, 1.0]
        normal = mesh.normals.reshape(5, 4, 3)[:, 0]
        assert np.all(np.sum(radial * normal, axis=1) < 0.0)
        np.testing.assert_allclose(normal[:, 1], np.sin(opening), atol=1e-6)


def test_instances_are_the_transformed_template() -> None:
    mesh = LEAF.template()
    rng = np.random.default_rng(5)
    turn = Rotation.random(6, random_state=5).as_matrix()
    scale = rng.uniform(0.5, 2.0, 6)
    frames = np.concatenate([turn * scale[:, None, None], rng.normal(size=(6, 3, 1))], axis=2).astype(np.float32)
    many = instance(mesh, frames)
    assert many.triangles == 6 * mesh.triangles
    assert many.normals is not None
    assert mesh.normals is not None
    assert many.uv is not None
    n = len(mesh.vertices_m)
    for k in range(6):
        piece = slice(k * n, (k + 1) * n)
        expected = mesh.vertices_m @ frames[k, :, :3].T + frames[k, :, 3]
        np.testing.assert_allclose(many.vertices_m[piece], expected, atol=1e-6)
        np.testing.assert_allclose(many.normals[piece], mesh.normals @ turn[k].T, atol=1e-5)
        np.testing.assert_array_equal(many.uv[piece], mesh.uv)


def test_no_instances_make_an_empty_mesh() -> None:
    mesh = LEAF.template()
    assert instance(mesh, np.zeros((0, 3, 4), np.float32)).triangles == 0
