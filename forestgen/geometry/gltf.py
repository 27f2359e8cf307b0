"""glTF 2.0 binary files (Khronos Group, 2021): one node and one mesh a piece, below a node of the plant.

The standard wants y up: (x, y, z) becomes (x, z, -y), in the vertices themselves. A leaf's transmittance has no place
in the core standard and goes into its material's extras.
"""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.geometry.model import Model, Piece, Surface, images_of, png

_ARRAY_BUFFER, _ELEMENT_ARRAY_BUFFER = 34962, 34963
_FLOAT, _UNSIGNED_INT = 5126, 5125
_WIDTH_NAME = {1: "SCALAR", 2: "VEC2", 3: "VEC3"}


class _Buffer:
    """The one binary chunk, and the views and accessors into it."""

    def __init__(self) -> None:
        self.chunks: list[bytes] = []
        self.length = 0
        self.views: list[dict[str, int]] = []
        self.accessors: list[dict[str, Any]] = []

    def view(self, content: bytes, target: int | None = None) -> int:
        """Index of a new view of `content`, which begins on a multiple of four bytes."""
        view = {"buffer": 0, "byteOffset": self.length, "byteLength": len(content)}
        self.views.append(view if target is None else {**view, "target": target})
        padded = content + b"\0" * (-len(content) % 4)
        self.chunks.append(padded)
        self.length += len(padded)
        return len(self.views) - 1

    def accessor(self, values: NDArray[Any], target: int, *, bounds: bool = False) -> int:
        """Index of a new accessor of an (N, C) array of float32, or of (N, 1) uint32."""
        values = np.ascontiguousarray(values)
        accessor: dict[str, Any] = {
            "bufferView": self.view(values.tobytes(), target),
            "componentType": _FLOAT if values.dtype == np.float32 else _UNSIGNED_INT,
            "count": len(values),
            "type": _WIDTH_NAME[values.shape[1]],
        }
        if bounds:
            accessor |= {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
        self.accessors.append(accessor)
        return len(self.accessors) - 1


def glb(model: Model) -> bytes:
    """Content of a .glb file."""
    buffer = _Buffer()
    surfaces = model.surfaces
    index = {surface.name: number for number, surface in enumerate(surfaces)}
    images: list[dict[str, Any]] = []
    materials = [_material(surface, buffer, images) for surface in surfaces]
    meshes = [_mesh(piece, index[piece.surface.name], buffer) for piece in model.pieces]
    nodes: list[dict[str, Any]] = [
        {"name": model.name, "children": list(range(1, len(meshes) + 1)), "extras": dict(model.properties)}
    ]
    for number, piece in enumerate(model.pieces):
        extras = {"part": piece.part.name.lower(), **piece.properties}
        nodes.append({"name": piece.name, "mesh": number, "extras": extras})
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "forestgen"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": nodes,
        "meshes": meshes,
        "materials": materials,
        "accessors": buffer.accessors,
        "bufferViews": buffer.views,
        "buffers": [{"byteLength": buffer.length}],
    }
    if images:
        repeating = {"wrapS": 10497, "wrapT": 10497, "magFilter": 9729, "minFilter": 9987}
        textures = [{"sampler": 0, "source": number} for number in range(len(images))]
        document |= {"samplers": [repeating], "images": images, "textures": textures}
    return _packed(document, b"".join(buffer.chunks))


def _packed(document: dict[str, Any], binary: bytes) -> bytes:
    text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sII", b"glTF", 2, 12 + 8 + len(text) + 8 + len(binary))
    return b"".join(
        [head, struct.pack("<I4s", len(text), b"JSON"), text, struct.pack("<I4s", len(binary), b"BIN\0"), binary]
    )


def _y_up(vectors: NDArray[np.float32]) -> NDArray[np.float32]:
    x, y, z = vectors.T
    return np.stack([x, z, -y], axis=1)


def _mesh(piece: Piece, material: int, buffer: _Buffer) -> dict[str, Any]:
    mesh = piece.mesh
    attributes = {"POSITION": buffer.accessor(_y_up(mesh.vertices_m), _ARRAY_BUFFER, bounds=True)}
    if mesh.normals is not None:
        attributes["NORMAL"] = buffer.accessor(_y_up(mesh.normals), _ARRAY_BUFFER)
    if mesh.uv is not None:  # v runs down from the image's first row, as ours does
        attributes["TEXCOORD_0"] = buffer.accessor(mesh.uv, _ARRAY_BUFFER)
    indices = buffer.accessor(mesh.faces.reshape(-1, 1), _ELEMENT_ARRAY_BUFFER)
    return {"name": piece.name, "primitives": [{"attributes": attributes, "indices": indices, "material": material}]}


def _material(surface: Surface, buffer: _Buffer, images: list[dict[str, Any]]) -> dict[str, Any]:
    def texture(kind: str, image: NDArray[np.uint8]) -> dict[str, int]:
        images.append(
            {"name": f"{surface.name}-{kind}", "mimeType": "image/png", "bufferView": buffer.view(png(image))}
        )
        return {"index": len(images) - 1}

    textures = {kind: texture(kind, image) for kind, image in images_of(surface).items()}
    look: dict[str, Any] = {"metallicFactor": 0.0, "roughnessFactor": surface.roughness}
    material: dict[str, Any] = {"name": surface.name, "pbrMetallicRoughness": look, "doubleSided": surface.sheet}
    if "colour" in textures:
        look["baseColorTexture"] = textures["colour"]
    else:
        look["baseColorFactor"] = [*surface.reflectance, 1.0]
    if "normal" in textures:
        material["normalTexture"] = textures["normal"]
    if any(surface.transmittance):
        material["extras"] = {"transmittance": list(surface.transmittance)}
    return material
