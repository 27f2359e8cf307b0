"""Meshes -> files: .glb, .ply, .obj and OpenUSD's .usd, .usda, .usdc, .usdz.

=======  =======  ========  ==========================  ====================================================
suffix   up       normals   colour                      besides
=======  =======  ========  ==========================  ====================================================
.glb     y        yes       materials, textures inside  names, extras; geometry/gltf.py
.ply     z        yes       vertices, sRGB              each face's part as a number; geometry/ply.py
.obj     z        yes       materials in a .mtl         a group a piece; textures beside it; geometry/obj.py
.usd     z        yes       materials                   custom data; textures beside it, or inside a .usdz;
                                                        geometry/usd.py
=======  =======  ========  ==========================  ====================================================

All are in metres. The same pieces give the same bytes.
"""

from __future__ import annotations

from forestgen.geometry.model import Model

FORMATS = (".glb", ".ply", ".obj", ".usd", ".usda", ".usdc", ".usdz")


def model_files(model: Model, file_name: str) -> dict[str, bytes]:
    """Name -> content of a model's files: `file_name` first, then what goes beside it.

    Parameters
    ----------
    file_name : ends with one of `FORMATS`.
    """
    suffix = "." + file_name.rsplit(".", 1)[-1].lower()
    if suffix == ".glb":
        from forestgen.geometry.gltf import glb

        return {file_name: glb(model)}
    if suffix == ".ply":
        from forestgen.geometry.ply import ply

        return {file_name: ply(model)}
    if suffix == ".obj":
        from forestgen.geometry.obj import obj_files

        return obj_files(model, file_name)
    from forestgen.geometry.usd import usd_files

    return usd_files(model, file_name)
