"""Mesh files come back as they went in: triangles, bounds, metres, normals, materials, names."""

from __future__ import annotations

import io
import json
import struct
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from forestgen.core.parts import Part
from forestgen.geometry.export import Model, Piece, Surface, exporter_of, mesh_suffixes
from forestgen.geometry.mesh import Mesh, surface_area_m2

LEAF = Surface("leaf", (0.1, 0.4, 0.05), (0.05, 0.2, 0.02), 0.45, sheet=True)
BARK = Surface("bark", (0.2140, 0.0, 1.0), roughness=0.9)


def model_files(model: Model, file_name: str) -> dict[str, bytes]:
    return exporter_of(file_name).files(model, file_name)


def wedge() -> Mesh:
    """A tetrahedron of extents 1, 2, 3 m along x, y, z."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]], dtype=np.float32)
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], dtype=np.uint32)
    return Mesh(vertices_m=vertices, faces=faces, normals=None, uv=None)


def ball() -> Mesh:
    """A smooth sphere about (0, 0, 5) of radius 1 m, with normals that are not those of its facets, and uv."""
    body = trimesh.creation.icosphere(subdivisions=2)
    normals = np.asarray(body.vertices, dtype=np.float32)
    uv = np.stack([normals[:, 0], 3 * normals[:, 2]], axis=1)
    vertices = (normals + np.array([0, 0, 5], dtype=np.float32)).astype(np.float32)
    return Mesh(vertices, body.faces.astype(np.uint32), normals, uv)


def model(*, textured: bool = False) -> Model:
    rng = np.random.default_rng(1)
    images = {}
    if textured:
        images = {name: rng.integers(0, 256, (4, 8, 3), dtype=np.uint8) for name in ("colour_image", "normal_image")}
    bark = Surface("bark", BARK.reflectance, roughness=0.9, **images)
    pieces = [
        Piece("leaf-leaf", Part.LEAF, wedge(), LEAF, {"area_m2": 7.5}),
        Piece("trunk-bark", Part.TRUNK, ball(), bark, {"area_m2": 12.5}),
    ]
    return Model("oak", pieces, {"height_m": 6.0, "seed": 3, "description": "an oak"})


def loaded(name: str, folder: Path, one: Model) -> trimesh.Scene:
    """Written, and read by trimesh."""
    for file, content in model_files(one, name).items():
        (folder / file).write_bytes(content)
    return trimesh.load(folder / name, force="scene", process=False)


@pytest.mark.parametrize("suffix", [".glb", ".ply", ".obj"])
def test_triangles_size_volume_and_upright_axis_survive(suffix: str, tmp_path: Path) -> None:
    mesh = loaded(f"tree{suffix}", tmp_path, model()).to_geometry()
    assert len(mesh.faces) == 4 + 320
    # glTF is y up: x east stays, z up becomes y, y north becomes -z.
    expected = [[-1, -1, 0], [1, 2, 6]] if suffix != ".glb" else [[-1, 0, -2], [1, 6, 1]]
    assert mesh.bounds == pytest.approx(np.array(expected), abs=1e-5)
    sphere = trimesh.creation.icosphere(subdivisions=2).volume
    assert mesh.volume == pytest.approx(1.0 + sphere, rel=1e-5)  # the winding survives: outside stays outside


@pytest.mark.parametrize("suffix", [".glb", ".ply", ".obj"])
def test_vertex_normals_survive(suffix: str, tmp_path: Path) -> None:
    """Normals that no reader could work out by itself."""
    smooth = ball()
    tilted = smooth.normals + np.array([0.3, 0.0, 0.1], dtype=np.float32)
    tilted /= np.linalg.norm(tilted, axis=1, keepdims=True)
    alone = Model("oak", [Piece("trunk", Part.TRUNK, replace(smooth, normals=tilted), BARK)])
    (mesh,) = loaded(f"tree{suffix}", tmp_path, alone).geometry.values()
    assert len(mesh.vertices) == len(tilted)
    found, place = mesh.vertex_normals, mesh.vertices
    if suffix == ".glb":  # y is up there
        found, place = (np.stack([one[:, 0], -one[:, 2], one[:, 1]], axis=1) for one in (found, place))
    expected = place - [0, 0, 5] + [0.3, 0.0, 0.1]
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    assert found == pytest.approx(expected, abs=2e-5)


def test_facets_of_a_ply_stay_flat(tmp_path: Path) -> None:
    (mesh,) = loaded("tree.ply", tmp_path, Model("oak", [Piece("leaf", Part.LEAF, wedge(), LEAF)])).geometry.values()
    assert mesh.vertex_normals[mesh.faces] == pytest.approx(np.repeat(mesh.face_normals[:, None], 3, axis=1))


def chunks(data: bytes) -> tuple[dict[str, Any], bytes]:
    """The document and the binary chunk of a .glb, by the standard's section 4."""
    magic, version, length = struct.unpack_from("<4sII", data)
    assert (magic, version, length) == (b"glTF", 2, len(data))
    size, kind = struct.unpack_from("<I4s", data, 12)
    assert kind == b"JSON"
    assert size % 4 == 0
    document = json.loads(data[20 : 20 + size])
    binary_size, kind = struct.unpack_from("<I4s", data, 20 + size)
    assert kind == b"BIN\0"
    assert document["buffers"] == [{"byteLength": binary_size}]
    return document, data[28 + size :]


def test_a_glb_tells_names_materials_and_numbers() -> None:
    document, binary = chunks(model_files(model(textured=True), "tree.glb")["tree.glb"])
    root, leaf, trunk = document["nodes"]
    assert root == {"name": "oak", "children": [1, 2], "extras": dict(model().properties)}
    assert (leaf["name"], leaf["extras"]) == ("leaf-leaf", {"part": "leaf", "area_m2": 7.5})
    assert trunk["name"] == "trunk-bark"
    blade, bark = document["materials"]
    assert blade["pbrMetallicRoughness"]["baseColorFactor"] == [0.1, 0.4, 0.05, 1.0]  # exact, linear
    assert blade["doubleSided"]
    assert not bark["doubleSided"]
    for texture in (bark["pbrMetallicRoughness"]["baseColorTexture"], bark["normalTexture"]):
        image = document["images"][document["textures"][texture["index"]]["source"]]
        view = document["bufferViews"][image["bufferView"]]
        png = binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
        assert png.startswith(b"\x89PNG")
    assert all(view["byteOffset"] % 4 == 0 for view in document["bufferViews"])
    assert "NORMAL" not in document["meshes"][0]["primitives"][0]["attributes"]
    assert {"POSITION", "NORMAL", "TEXCOORD_0"} == set(document["meshes"][1]["primitives"][0]["attributes"])


def test_textures_lie_the_same_way_in_glb_and_obj(tmp_path: Path) -> None:
    """A vertex meets the same pixel whichever way a format counts v."""
    from PIL import Image

    one = model(textured=True)
    glb = loaded("tree.glb", tmp_path, one).geometry["trunk-bark"]
    obj = trimesh.load(tmp_path / next(iter(_written("tree.obj", tmp_path, one))), force="scene", process=False)
    ball_of_obj = next(one for one in obj.geometry.values() if len(one.faces) == 320)
    assert np.asarray(glb.visual.uv) == pytest.approx(ball_of_obj.visual.uv, abs=1e-5)
    pixels = np.asarray(glb.visual.material.baseColorTexture.convert("RGB"))
    with Image.open(tmp_path / "tree-bark-colour.png") as image:
        assert np.array_equal(np.asarray(image), pixels)
    assert np.array_equal(pixels, one.pieces[1].surface.colour_image)
    with Image.open(tmp_path / "tree-bark-normal.png") as image:  # the green axis runs up the rows, ours along v
        assert np.array_equal(np.asarray(image)[..., 1], 255 - one.pieces[1].surface.normal_image[..., 1])


def _written(name: str, folder: Path, one: Model) -> dict[str, bytes]:
    files = model_files(one, name)
    for file, content in files.items():
        (folder / file).write_bytes(content)
    return files


def test_a_ply_has_srgb_colours_and_parts() -> None:
    mesh = trimesh.load(io.BytesIO(model_files(model(), "a.ply")["a.ply"]), file_type="ply", process=False)
    assert np.unique(mesh.visual.vertex_colors[-10:], axis=0).tolist() == [[127, 0, 255, 255]]
    parts = mesh.metadata["_ply_raw"]["face"]["data"]["part"]
    assert np.bincount(parts)[[Part.TRUNK, Part.LEAF]].tolist() == [320, 4]


def test_an_obj_names_its_materials_beside_it() -> None:
    files = model_files(model(), "my.tree.obj")
    assert set(files) == {"my.tree.obj", "my.tree.mtl"}
    text = files["my.tree.obj"].decode()
    assert "mtllib my.tree.mtl\n" in text
    assert [line for line in text.splitlines() if line.startswith(("o ", "usemtl "))] == [
        "o leaf-leaf",
        "usemtl leaf",
        "o trunk-bark",
        "usemtl bark",
    ]
    assert "newmtl leaf\nKd 0.10000 0.40000 0.05000\n" in files["my.tree.mtl"].decode()


@pytest.mark.parametrize("suffix", ["usd", "usda", "usdc", "usdz"])
@pytest.mark.parametrize("textured", [False, True])
def test_a_usd_holds_all_of_it(suffix: str, textured: bool, tmp_path: Path) -> None:
    from pxr import Usd, UsdGeom, UsdShade

    files = _written(f"2 trees.{suffix}", tmp_path, model(textured=textured))
    textures = {f"2 trees-bark-{kind}.png" for kind in ("colour", "normal")} if textured else set()
    assert set(files) == {f"2 trees.{suffix}"} | (textures if suffix != "usdz" else set())
    stage = Usd.Stage.Open(str(tmp_path / f"2 trees.{suffix}"))
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    plant = stage.GetDefaultPrim()
    assert plant.GetName() == "oak"
    assert plant.GetCustomDataByKey("forestgen") == dict(model().properties)
    leaf, trunk = (UsdGeom.Mesh(one) for one in plant.GetChildren() if one.IsA(UsdGeom.Mesh))
    assert leaf.GetPrim().GetCustomDataByKey("forestgen")["area_m2"] == 7.5
    assert leaf.GetDoubleSidedAttr().Get()
    assert not trunk.GetDoubleSidedAttr().Get()
    for usd, mesh in ((leaf, wedge()), (trunk, ball())):
        assert np.array_equal(usd.GetPointsAttr().Get(), mesh.vertices_m)
        assert np.array_equal(np.reshape(usd.GetFaceVertexIndicesAttr().Get(), (-1, 3)), mesh.faces)
        assert np.array_equal(usd.GetExtentAttr().Get(), [mesh.vertices_m.min(axis=0), mesh.vertices_m.max(axis=0)])
    assert leaf.GetNormalsAttr().Get() is None
    assert np.array_equal(trunk.GetNormalsAttr().Get(), ball().normals)
    assert trunk.GetNormalsInterpolation() == "vertex"
    for usd, name in ((leaf, "leaf"), (trunk, "bark")):
        material, _ = UsdShade.MaterialBindingAPI(usd).ComputeBoundMaterial()
        assert material.GetPrim().GetName() == name
        shader = material.ComputeSurfaceSource()[0]
        connected = shader.GetInput("diffuseColor").HasConnectedSource()
        assert connected == (textured and name == "bark")
    if textured:
        texture = UsdShade.Shader(stage.GetPrimAtPath("/oak/materials/bark/colour"))
        resolved = texture.GetInput("file").Get().resolvedPath
        assert resolved.endswith("-bark-colour.png") or resolved.endswith("-bark-colour.png]")


def test_the_same_model_has_the_same_bytes() -> None:
    for suffix in mesh_suffixes():
        one, two = (model_files(model(textured=True), f"a{suffix}") for _ in range(2))
        assert one == two


def test_a_package_knows_nothing_of_the_clock() -> None:
    """A zip file tells its files' times to two seconds."""
    before = model_files(model(textured=True), "a.usdz")
    time.sleep(2.1)
    assert model_files(model(textured=True), "a.usdz") == before


def test_area() -> None:
    slope = np.linalg.norm(np.cross([-1, 2, 0], [-1, 0, 3])) / 2
    assert surface_area_m2(wedge()) == pytest.approx(1 + 1.5 + 3 + slope)


def test_surfaces_of_nearly_one_colour_stay_apart_and_exact() -> None:
    """trimesh keeps colours as bytes: of two whose bytes are equal, each has its own numbers in the file."""
    looks = [Surface(name, (value, 0.4, 0.05)) for name, value in (("young", 0.1), ("old", 0.1001))]
    pieces = [Piece(f"leaf-{one.name}", Part.LEAF, wedge(), one) for one in looks]
    document, _ = chunks(model_files(Model("oak", pieces), "a.glb")["a.glb"])
    colours = {one["name"]: one["pbrMetallicRoughness"]["baseColorFactor"][0] for one in document["materials"]}
    assert colours == {"young": 0.1, "old": 0.1001}
    assert [mesh["primitives"][0]["material"] for mesh in document["meshes"]] == [0, 1]


def test_coordinates_are_exact_in_glb_and_ply(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    scattered = replace(ball(), vertices_m=rng.normal(size=ball().vertices_m.shape).astype(np.float32))
    one = Model("oak", [Piece("trunk", Part.TRUNK, scattered, BARK)])
    (ply,) = loaded("tree.ply", tmp_path, one).geometry.values()
    assert np.array_equal(ply.vertices.astype(np.float32), scattered.vertices_m)
    document, binary = chunks(model_files(one, "tree.glb")["tree.glb"])
    (primitive,) = document["meshes"][0]["primitives"]
    x, y, z = scattered.vertices_m.T
    for name, expected in (("POSITION", np.stack([x, z, -y], axis=1)), ("TEXCOORD_0", scattered.uv)):
        view = document["bufferViews"][document["accessors"][primitive["attributes"][name]]["bufferView"]]
        values = np.frombuffer(binary, "<f4", view["byteLength"] // 4, view["byteOffset"]).reshape(expected.shape)
        assert np.array_equal(values, expected)
