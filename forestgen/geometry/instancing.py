"""One mesh of many copies of an organ."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from forestgen.geometry.mesh import Mesh


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
