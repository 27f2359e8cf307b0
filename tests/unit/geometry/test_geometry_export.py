"""Mesh files come back as they went in."""

from __future__ import annotations

import io

import numpy as np
import pytest
import trimesh

from forestgen.geometry.export import FORMATS, mesh_file
from forestgen.geometry.mesh import Mesh, surface_area_m2


def wedge() -> Mesh:
    """A tetrahedron of extents 1, 2, 3 m along x, y, z."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]], dtype=np.float32)
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], dtype=np.uint32)
    return Mesh(vertices_m=vertices, faces=faces, normals=None, uv=None)


@pytest.mark.parametrize("suffix", FORMATS)
def test_size_volume_and_upright_axis_survive(suffix: str) -> None:
    data = mesh_file({"leaf-a": (wedge(), (0.1, 0.4, 0.05)), "trunk-b": (wedge(), (0.3, 0.2, 0.1))}, suffix)
    scene = trimesh.load(io.BytesIO(data), file_type=suffix[1:], force="scene")
    mesh = scene.to_geometry()
    assert len(mesh.faces) == 8
    # glTF is y up: x east stays, z up becomes y, y north becomes -z.
    expected = [1, 3, 2] if suffix == ".glb" else [1, 2, 3]
    assert mesh.extents == pytest.approx(expected)
    assert mesh.volume == pytest.approx(2 * 1.0)  # the winding survives: outside stays outside
    if suffix == ".glb":
        assert mesh.bounds[0] == pytest.approx([0, 0, -2])
        assert len(scene.geometry) == 2


def test_a_glb_keeps_materials_in_linear_colour() -> None:
    data = mesh_file({"leaf-a": (wedge(), (0.1, 0.4, 0.05))}, ".glb")
    (mesh,) = trimesh.load(io.BytesIO(data), file_type="glb", force="scene").geometry.values()
    material = mesh.visual.material
    assert material.name == "leaf-a"
    assert np.asarray(material.baseColorFactor[:3]) / 255 == pytest.approx([0.1, 0.4, 0.05], abs=0.003)
    assert material.doubleSided


def test_a_ply_has_srgb_colours() -> None:
    mesh = trimesh.load(io.BytesIO(mesh_file({"a": (wedge(), (0.2140, 0.0, 1.0))}, ".ply")), file_type="ply")
    assert np.unique(mesh.visual.face_colors, axis=0).tolist() == [[127, 0, 255, 255]]


def test_the_same_mesh_has_the_same_bytes() -> None:
    for suffix in FORMATS:
        one, two = (mesh_file({"a": (wedge(), (0.1, 0.2, 0.3))}, suffix) for _ in range(2))
        assert one == two


def test_area() -> None:
    slope = np.linalg.norm(np.cross([-1, 2, 0], [-1, 0, 3])) / 2
    assert surface_area_m2(wedge()) == pytest.approx(1 + 1.5 + 3 + slope)
