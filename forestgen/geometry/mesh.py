"""The mesh that every stage passes on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Mesh:
    """Triangles. Winding is counter-clockwise seen from outside; blades are sheets, seen from their upper side."""

    vertices_m: NDArray[np.float32]  # (V, 3) metres, the owner's frame
    faces: NDArray[np.uint32]  # (F, 3) indices into vertices
    normals: NDArray[np.float32] | None = None  # (V, 3) unit, or None for flat facets
    uv: NDArray[np.float32] | None = None  # (V, 2)

    def __post_init__(self) -> None:
        if self.vertices_m.ndim != 2 or self.vertices_m.shape[1] != 3 or self.vertices_m.dtype != np.float32:
            raise ValueError(f"vertices_m must be (V, 3) float32, got {self.vertices_m.shape} {self.vertices_m.dtype}")
        if self.faces.ndim != 2 or self.faces.shape[1] != 3 or self.faces.dtype != np.uint32:
            raise ValueError(f"faces must be (F, 3) uint32, got {self.faces.shape} {self.faces.dtype}")
        for name, array, width in (("normals", self.normals, 3), ("uv", self.uv, 2)):
            if array is not None and (array.shape != (len(self.vertices_m), width) or array.dtype != np.float32):
                raise ValueError(
                    f"{name} must be ({len(self.vertices_m)}, {width}) float32, got {array.shape} {array.dtype}"
                )

    @property
    def triangles(self) -> int:
        return len(self.faces)


def surface_area_m2(mesh: Mesh) -> float:
    """Sum of the triangles' areas, one side."""
    a, b, c = (mesh.vertices_m[mesh.faces[:, k]].astype(np.float64) for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def instance(template: Mesh, frames: NDArray[np.float32]) -> Mesh:
    """One mesh of the template under M transforms.

    Parameters
    ----------
    template : with normals.
    frames : (M, 3, 4) organ frame -> plant frame: rotation times uniform scale, and translation in metres.
    """
    if template.normals is None:
        raise ValueError("the template needs normals")
    count = len(template.vertices_m)
    linear = frames[:, :, :3]
    to_plant = linear.transpose(0, 2, 1)
    vertices = template.vertices_m @ to_plant + frames[:, None, :, 3]
    scale = np.cbrt(np.linalg.det(linear.astype(np.float64))).astype(np.float32)
    normals = template.normals @ (to_plant / scale[:, None, None])
    faces = template.faces[None] + (np.arange(len(frames), dtype=np.uint32) * np.uint32(count))[:, None, None]
    uv = None if template.uv is None else np.tile(template.uv, (len(frames), 1))
    return Mesh(vertices.reshape(-1, 3), faces.reshape(-1, 3), normals.reshape(-1, 3), uv)
