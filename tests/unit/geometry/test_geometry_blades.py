"""Organ templates and their instances."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from forestgen.geometry import blades
from forestgen.geometry.mesh import Mesh

TEMPLATES = {
    "round_deltoid": (blades.round_deltoid(0.08, 0.09, 0.04, 14, 20), 7),
    "lanceolate": (blades.lanceolate(0.12, 0.02, 0.0, 15, 30), 4),
    "round_deltoid_fine": (blades.round_deltoid(0.08, 0.09, 0.04, 14, 20, fine=True), 15),
    "lanceolate_fine": (blades.lanceolate(0.12, 0.02, 0.003, 15, 30, fine=True), 9),
    "needle_shoot": (blades.needle_shoot(0.3, 0.2, 5), 16),
    "four_petals": (blades.four_petals(0.02, 0.015, 0.02, 65), 13),
    "bud": (blades.bud(0.02, 0.006, 0.01), 6),
}


def face_normals(mesh: Mesh) -> np.ndarray:
    a, b, c = (mesh.vertices_m[mesh.faces[:, k]].astype(np.float64) for k in range(3))
    return np.cross(b - a, c - a)


@pytest.mark.parametrize("name", TEMPLATES)
def test_template_is_sound(name: str) -> None:
    mesh, triangles = TEMPLATES[name]
    assert mesh.triangles == triangles
    assert mesh.normals is not None
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1.0, atol=1e-5)
    assert np.all(np.linalg.norm(face_normals(mesh), axis=1) > 0)
    assert np.linalg.norm(mesh.vertices_m, axis=1).min() < 0.003, "the foot is in the origin"


@pytest.mark.parametrize("name", ["round_deltoid", "lanceolate", "round_deltoid_fine", "lanceolate_fine"])
def test_leaf_shows_its_upper_side(name: str) -> None:
    mesh, _ = TEMPLATES[name]
    assert np.all(face_normals(mesh)[:, 2] >= -1e-12)


def test_bud_is_closed_and_wound_outward() -> None:
    mesh, _ = TEMPLATES["bud"]
    a, b, c = (mesh.vertices_m[mesh.faces[:, k]].astype(np.float64) for k in range(3))
    assert np.sum(a * np.cross(b, c)) > 0
    edges = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
    assert {tuple(e) for e in edges.tolist()} == {tuple(e[::-1]) for e in edges.tolist()}


def test_flat_leaf_has_its_outlines_area_and_size() -> None:
    mesh = blades.round_deltoid(0.08, 0.09, 0.0, 0, 0)
    assert np.ptp(mesh.vertices_m[:, 0]) == pytest.approx(0.09)
    assert np.ptp(mesh.vertices_m[:, 1]) == pytest.approx(0.08)
    assert 0.7 < 0.5 * np.linalg.norm(face_normals(mesh), axis=1).sum() / (0.08 * 0.09) < 0.8  # a disc has pi / 4


def test_instances_are_the_transformed_template() -> None:
    mesh, _ = TEMPLATES["round_deltoid"]
    rng = np.random.default_rng(5)
    turn = Rotation.random(6, random_state=5).as_matrix()
    scale = rng.uniform(0.5, 2.0, 6)
    frames = np.concatenate([turn * scale[:, None, None], rng.normal(size=(6, 3, 1))], axis=2).astype(np.float32)
    many = blades.instance(mesh, frames)
    assert many.triangles == 6 * mesh.triangles
    assert many.normals is not None
    assert mesh.normals is not None
    n = len(mesh.vertices_m)
    for k in range(6):
        piece = slice(k * n, (k + 1) * n)
        expected = mesh.vertices_m @ frames[k, :, :3].T + frames[k, :, 3]
        np.testing.assert_allclose(many.vertices_m[piece], expected, atol=1e-6)
        np.testing.assert_allclose(many.normals[piece], mesh.normals @ turn[k].T, atol=1e-5)


def test_no_instances_make_an_empty_mesh() -> None:
    assert blades.instance(TEMPLATES["bud"][0], np.zeros((0, 3, 4), np.float32)).triangles == 0
