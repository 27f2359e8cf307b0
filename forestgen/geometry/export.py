"""Files of plants' meshes: .glb, .ply, .obj and OpenUSD's .usd, .usda, .usdc, .usdz; and what they are written from.

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

A format is added by a module with a class of `MeshExporter` and its only object, EXPORTER, and a line of
`MESH_EXPORTERS` whose name is the suffix without its dot; or from another package:

    fg.register("mesh_exporter", "stl", "my_package.stl:EXPORTER")
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.core.registry import Registry
from forestgen.geometry.mesh import Mesh

Colour = tuple[float, float, float]
Value = str | int | float

MESH_EXPORTERS = Registry(
    "mesh exporter",
    {
        "glb": ("forestgen.geometry.gltf:EXPORTER", "glTF 2.0, binary: materials and textures inside, y up"),
        "ply": ("forestgen.geometry.ply:EXPORTER", "one mesh, coloured by vertex, with each face's part"),
        "obj": ("forestgen.geometry.obj:EXPORTER", "Wavefront text, its materials and textures beside it"),
        "usd": ("forestgen.geometry.usd:EXPORTER", "OpenUSD, binary, its textures beside it"),
        "usda": ("forestgen.geometry.usd:EXPORTER", "OpenUSD as text, its textures beside it"),
        "usdc": ("forestgen.geometry.usd:EXPORTER", "OpenUSD, binary, its textures beside it"),
        "usdz": ("forestgen.geometry.usd:EXPORTER", "OpenUSD as one package, textures inside"),
    },
    contract="forestgen.geometry.export:MeshExporter",
)


@dataclass(frozen=True)
class Surface:
    """How a piece looks."""

    name: str
    reflectance: Colour  # linear Rec. 709
    transmittance: Colour = (0.0, 0.0, 0.0)
    roughness: float = 0.8
    sheet: bool = False  # seen from both sides, as a leaf
    colour_image: NDArray[np.uint8] | None = None  # (H, W, 3) sRGB, row 0 at v = 0; in place of the reflectance
    normal_image: NDArray[np.uint8] | None = None  # (H, W, 3) (normal + 1) / 2 along u, v and outwards, row 0 at v = 0


@dataclass(frozen=True)
class Piece:
    """One mesh of a plant."""

    name: str
    part: Part
    mesh: Mesh
    surface: Surface
    properties: Mapping[str, Value] = field(default_factory=dict)  # custom data, keys with units


@dataclass(frozen=True)
class Model:
    """All pieces of a plant."""

    name: str
    pieces: Sequence[Piece]
    properties: Mapping[str, Value] = field(default_factory=dict)

    @property
    def surfaces(self) -> list[Surface]:
        """The pieces' different surfaces by name, in their order."""
        return list({piece.surface.name: piece.surface for piece in self.pieces}.values())


class MeshExporter:
    """A format of mesh files. An exporter has no state."""

    def files(self, model: Model, file_name: str) -> dict[str, bytes]:
        """Name -> content of a model's files: `file_name` first, then what goes beside it."""
        raise NotImplementedError

    def companions(self, file_name: str) -> tuple[str, ...]:
        """Names of the files that go beside `file_name` whatever the model is.

        If one exists, it is reported before a plant is grown.
        """
        return ()


def mesh_suffixes() -> tuple[str, ...]:
    """Suffixes of all mesh files, with their dots."""
    return tuple(f".{name}" for name in MESH_EXPORTERS)


def exporter_of(file_name: str) -> MeshExporter:
    """The exporter of a file's suffix, which is one of `mesh_suffixes` in small or capital letters."""
    found: MeshExporter = MESH_EXPORTERS.load(file_name.rsplit(".", 1)[-1].lower())
    return found


def texture_files(model: Model, file_name: str) -> tuple[dict[tuple[str, str], str], dict[str, bytes]]:
    """Textures that go beside `file_name`: (surface, "colour" or "normal") -> name, and name -> PNG."""
    names: dict[tuple[str, str], str] = {}
    files: dict[str, bytes] = {}
    for surface in model.surfaces:
        for kind, image in images_of(surface).items():
            name = f"{file_name.rsplit('.', 1)[0]}-{surface.name}-{kind}.png"
            names[surface.name, kind], files[name] = name, png(image)
    return names, files


def images_of(surface: Surface) -> dict[str, NDArray[np.uint8]]:
    """A surface's images as mesh files want them: "colour", and "normal" with its second axis up from row to row."""
    images = {}
    if surface.colour_image is not None:
        images["colour"] = surface.colour_image
    if surface.normal_image is not None:
        images["normal"] = surface.normal_image.copy()
        images["normal"][..., 1] = 255 - images["normal"][..., 1]  # ours runs along v, that is down the rows
    return images


def png(image: NDArray[np.uint8]) -> bytes:
    """A PNG of an (H, W, 3) picture."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(image)).save(buffer, format="PNG", compress_level=6)
    return buffer.getvalue()


def srgb(colour: Colour | NDArray[np.floating]) -> NDArray[np.uint8]:
    """sRGB of linear colours (IEC 61966-2-1), of the same shape."""
    linear = np.clip(np.asarray(colour, dtype=np.float64), 0.0, 1.0)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.asarray(np.round(255 * encoded), dtype=np.uint8)
