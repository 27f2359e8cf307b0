"""OpenUSD files: an Xform of the plant, a Mesh a piece, UsdPreviewSurface materials; metres, z up.

Custom data under the key ``forestgen`` holds the plant's and the pieces' properties. Image rows run up from v = 0 here,
so v is written as 1 - v. A .usd is a binary crate as a .usdc is; a .usda is text; a .usdz holds its textures.
"""

from __future__ import annotations

import os
import re
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from forestgen.geometry.export import MeshExporter, Model, Piece, Surface, texture_files

_LONG_AGO_S = 315_964_800  # 1980-01-06, which a zip file can tell in any time zone


class Usd(MeshExporter):
    """OpenUSD, which its library usd-core writes."""

    def files(self, model: Model, file_name: str) -> dict[str, bytes]:
        from pxr import Sdf, UsdUtils

        names, textures = texture_files(model, file_name)
        stem, _, suffix = file_name.rpartition(".")
        packed = suffix.lower() == "usdz"
        with tempfile.TemporaryDirectory(prefix="forestgen-usd-") as folder:
            for name, content in textures.items():
                (Path(folder) / name).write_bytes(content)
            written = Path(folder) / (f"{_identifier(stem)}.usdc" if packed else f"plant.{suffix.lower()}")
            layer = _stage(model, names)
            layer.Export(str(written))
            if packed:
                for file in Path(folder).iterdir():
                    os.utime(file, (_LONG_AGO_S, _LONG_AGO_S))  # the package keeps its files' times
                package = Path(folder) / "plant.usdz"
                if not UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(str(written)), str(package)):
                    raise RuntimeError("OpenUSD could not write the .usdz package")
                return {file_name: package.read_bytes()}
            return {file_name: written.read_bytes(), **textures}


EXPORTER = Usd()


def _identifier(name: str) -> str:
    """A name that USD takes: letters, digits and underscores, no digit first."""
    cleaned = re.sub(r"[^A-Za-z0-9_]", "_", name) or "_"
    return f"_{cleaned}" if cleaned[0].isdigit() else cleaned


def new_stage(root: str) -> tuple[Any, Any, Any]:
    """A layer in memory, its stage in metres with z up, and the stage's default prim, an Xform at `root`."""
    from pxr import Sdf, Usd, UsdGeom

    layer = Sdf.Layer.CreateAnonymous(".usda")
    stage = Usd.Stage.Open(layer)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    prim = UsdGeom.Xform.Define(stage, root).GetPrim()
    stage.SetDefaultPrim(prim)
    return layer, stage, prim


def _stage(model: Model, textures: dict[tuple[str, str], str]) -> Any:
    """The layer of a model's stage."""
    from pxr import Usd, UsdGeom, UsdShade

    root = f"/{_identifier(model.name)}"
    layer, stage, plant = new_stage(root)
    Usd.ModelAPI(plant).SetKind("component")
    plant.SetCustomDataByKey("forestgen", dict(model.properties))
    UsdGeom.Scope.Define(stage, f"{root}/materials")
    materials = {
        surface.name: _material(stage, f"{root}/materials/{_identifier(surface.name)}", surface, textures)
        for surface in model.surfaces
    }
    for piece in model.pieces:
        mesh = _mesh(stage, f"{root}/{_identifier(piece.name)}", piece)
        UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(materials[piece.surface.name])
    return layer


def _mesh(stage: Any, path: str, piece: Piece) -> Any:
    from pxr import Gf, Sdf, UsdGeom, Vt

    mesh, usd = piece.mesh, UsdGeom.Mesh.Define(stage, path)
    usd.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(mesh.vertices_m)))
    usd.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(mesh.faces), 3, dtype=np.int32)))
    usd.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(mesh.faces.astype(np.int32).ravel()))
    usd.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    usd.CreateDoubleSidedAttr(piece.surface.sheet)
    extent = np.stack([mesh.vertices_m.min(axis=0), mesh.vertices_m.max(axis=0)])
    usd.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(extent))
    if mesh.normals is not None:
        usd.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(mesh.normals)))
        usd.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    variables = UsdGeom.PrimvarsAPI(usd)
    if mesh.uv is not None:
        flipped = np.stack([mesh.uv[:, 0], 1 - mesh.uv[:, 1]], axis=1)
        place = variables.CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.vertex)
        place.Set(Vt.Vec2fArray.FromNumpy(flipped))
    usd.CreateDisplayColorAttr([Gf.Vec3f(*piece.surface.reflectance)])
    transmittance = Vt.DoubleArray(list(piece.surface.transmittance))
    custom = {"part": piece.part.name.lower(), "transmittance": transmittance, **piece.properties}
    usd.GetPrim().SetCustomDataByKey("forestgen", custom)
    return usd


def _material(stage: Any, path: str, surface: Surface, textures: dict[tuple[str, str], str]) -> Any:
    from pxr import Gf, Sdf, UsdShade

    kinds = Sdf.ValueTypeNames
    material = UsdShade.Material.Define(stage, path)
    shader = UsdShade.Shader.Define(stage, f"{path}/surface")
    shader.CreateIdAttr("UsdPreviewSurface")
    shader.CreateInput("roughness", kinds.Float).Set(surface.roughness)
    shader.CreateInput("metallic", kinds.Float).Set(0.0)
    material.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")
    diffuse = shader.CreateInput("diffuseColor", kinds.Color3f)
    diffuse.Set(Gf.Vec3f(*surface.reflectance))
    if not any(key[0] == surface.name for key in textures):
        return material
    reader = UsdShade.Shader.Define(stage, f"{path}/place")
    reader.CreateIdAttr("UsdPrimvarReader_float2")
    reader.CreateInput("varname", kinds.String).Set("st")
    reader.CreateOutput("result", kinds.Float2)

    # Values of 0 to 1 of a normal map stand for -1 to 1.
    normal = shader.CreateInput("normal", kinds.Normal3f)
    for kind, target, space, scale, bias in (("colour", diffuse, "sRGB", 1, 0), ("normal", normal, "raw", 2, -1)):
        if (surface.name, kind) not in textures:
            continue
        texture = UsdShade.Shader.Define(stage, f"{path}/{kind}")
        texture.CreateIdAttr("UsdUVTexture")
        texture.CreateInput("st", kinds.Float2).ConnectToSource(reader.ConnectableAPI(), "result")
        for name, value_type, value in (
            ("file", kinds.Asset, Sdf.AssetPath(f"./{textures[surface.name, kind]}")),
            ("sourceColorSpace", kinds.Token, space),
            ("wrapS", kinds.Token, "repeat"),
            ("wrapT", kinds.Token, "repeat"),
            ("scale", kinds.Float4, Gf.Vec4f(scale, scale, scale, 1)),
            ("bias", kinds.Float4, Gf.Vec4f(bias, bias, bias, 0)),
        ):
            texture.CreateInput(name, value_type).Set(value)
        texture.CreateOutput("rgb", kinds.Float3)
        target.ConnectToSource(texture.ConnectableAPI(), "rgb")
    return material
