"""Decimation: fewer triangles, closed bodies of the same volume, sheets left sheets."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from forestgen.geometry.mesh import Mesh
from forestgen.geometry.simplify import decimate, merged
from forestgen.geometry.sweep import Polylines
from support.swept import sweep

Floats = NDArray[np.float64]


def volume(mesh: Mesh) -> float:
    a, b, c = (mesh.vertices_m.astype(np.float64)[mesh.faces[:, k]] for k in range(3))
    return float(np.sum(a * np.cross(b, c)) / 6.0)


def is_closed(mesh: Mesh) -> bool:
    _, faces = merged(mesh)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    key = edges @ [len(mesh.vertices_m), 1]
    return bool(np.array_equal(np.sort(key), np.sort(edges[:, ::-1] @ [len(mesh.vertices_m), 1])))


def tubes(count: int, points: int, sides: int, radius_m: float) -> Mesh:
    rng = np.random.default_rng(5)
    line = np.cumsum(rng.normal(size=(count, points, 3)) * 0.1 + [0.0, 0.0, 0.4], axis=1)
    line += rng.uniform(0.0, 5.0, (count, 1, 3))
    radius = np.tile(np.linspace(radius_m, 0.5 * radius_m, points), count)
    lines = Polylines(line.reshape(-1, 3), radius, np.arange(count + 1) * points)
    return sweep(lines, np.full(count, sides), pointed=False)


@pytest.mark.parametrize(("count", "sides", "radius_m"), [(1, 24, 0.2), (40, 4, 0.003), (12, 8, 0.02)])
@pytest.mark.parametrize("share", [0.6, 0.3])
def test_tubes_keep_volume_and_stay_closed(count: int, sides: int, radius_m: float, share: float) -> None:
    mesh = tubes(count, 20, sides, radius_m)
    target = int(share * mesh.triangles)
    fewer = decimate(mesh, target)
    assert fewer.triangles <= 1.02 * target
    assert is_closed(fewer)
    assert volume(fewer) == pytest.approx(volume(mesh), rel=0.03)
    assert fewer.normals is not None
    np.testing.assert_allclose(np.linalg.norm(fewer.normals, axis=1), 1.0, atol=1e-5)
    np.testing.assert_allclose(np.ptp(fewer.vertices_m, axis=0), np.ptp(mesh.vertices_m, axis=0), rtol=0.12)


def test_every_body_remains_where_the_target_is_too_low() -> None:
    mesh = tubes(30, 6, 5, 0.01)
    fewer = decimate(mesh, 10)
    assert 30 * 4 <= fewer.triangles < mesh.triangles
    assert volume(fewer) == pytest.approx(volume(mesh), rel=0.03)


def test_a_mesh_below_the_target_keeps_its_triangles() -> None:
    mesh = tubes(2, 5, 6, 0.1)
    same = decimate(mesh, 10_000)
    assert same.triangles == mesh.triangles
    assert volume(same) == pytest.approx(volume(mesh), rel=1e-6)


def test_a_sheet_is_not_inflated() -> None:
    x, y = np.meshgrid(np.linspace(0, 1, 12), np.linspace(0, 1, 12), indexing="ij")
    z = 0.05 * np.sin(3.0 * x)
    vertices = np.stack([x, y, z], axis=-1).reshape(-1, 3).astype(np.float32)
    corner = (np.arange(11)[:, None] * 12 + np.arange(11)).reshape(-1)
    faces = np.concatenate(
        [
            np.stack([corner, corner + 12, corner + 13], axis=1),
            np.stack([corner, corner + 13, corner + 1], axis=1),
        ]
    )
    fewer = decimate(Mesh(vertices, faces.astype(np.uint32)), 80)
    assert fewer.triangles <= 82
    assert np.abs(fewer.vertices_m[:, 2] - 0.05 * np.sin(3.0 * fewer.vertices_m[:, 0])).max() < 0.01


def test_the_same_mesh_gives_the_same_triangles() -> None:
    mesh = tubes(10, 12, 6, 0.02)
    first, second = decimate(mesh, 500), decimate(mesh, 500)
    assert first.vertices_m.tobytes() == second.vertices_m.tobytes()
    assert first.faces.tobytes() == second.faces.tobytes()


def test_nothing_stays_nothing() -> None:
    none = Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint32))
    assert decimate(none, 100).triangles == 0
