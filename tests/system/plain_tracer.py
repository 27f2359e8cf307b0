"""Another ray tracer, in single precision, that shares nothing with the renderer's: plain loops over all triangles.

Whatever device traces rounds in its own way. This one takes the camera's rays from double precision, brings them into
each plant's frame by the rounded inverse of its transform, and meets triangles as Möller and Trumbore (1997) do, where
Embree has its own rays, adjoints and edge functions. So where the two agree no device's arithmetic is at work.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.geometry.mesh import Mesh
from forestgen.render.identity import sample_offsets
from forestgen.scene.spec import Camera, SceneSpec
from support.twins import Oracle

_OVER = np.float32(1e-6)  # of a triangle's side: neighbours overlap, or rays slip through between them


@dataclass(frozen=True)
class PlainSamples:
    """Shapes as in `forestgen.render.frame.Identity`; distances are infinite where nothing is hit."""

    plant_id: NDArray[np.uint32]  # (H, W, S)
    part: NDArray[np.uint8]  # (H, W, S)
    face: NDArray[np.uint32]  # (H, W, S)
    distance_m: NDArray[np.float32]  # (H, W, S)


def trace_plainly(spec: SceneSpec, camera: Camera, samples: int) -> PlainSamples:
    """Every ray against every triangle of each plant whose sphere it meets, and against all of the ground."""
    width, height = camera.size_px
    offset = sample_offsets(samples)
    column, row = np.meshgrid(np.arange(width), np.arange(height))
    places = (column[..., None] + offset[:, 0]).ravel(), (row[..., None] + offset[:, 1]).ravel()
    start, direction, _ = Oracle(spec, camera).rays(*places)
    rays = (start.astype(np.float32), direction.astype(np.float32))
    nearest = np.full(len(direction), np.inf, dtype=np.float32)
    plant, part, face = (np.zeros(len(direction), dtype=kind) for kind in (np.uint32, np.uint8, np.uint32))
    triangles = [_triangles([organ.mesh for organ in exemplar.organs]) for exemplar in spec.exemplars]
    parts = [
        np.repeat([int(organ.part) for organ in exemplar.organs], [len(organ.mesh.faces) for organ in exemplar.organs])
        for exemplar in spec.exemplars
    ]
    ground, still = _triangles([spec.terrain.mesh]), np.eye(3, 4)
    everything = [(0, still, ground, np.full(len(ground), int(Part.GROUND)))]
    for number, matrix, exemplar in zip(
        spec.instances.plant_id, spec.instances.transform, spec.instances.exemplar, strict=True
    ):
        everything.append((int(number), matrix, triangles[exemplar], parts[exemplar]))
    for number, matrix, corner, kind in everything:
        moved = matrix.copy()
        moved[:, 3] -= np.asarray(camera.position_m)
        linear = np.linalg.inv(moved[:, :3])
        inverse = np.column_stack([linear, -linear @ moved[:, 3]]).astype(np.float32)
        middle = (corner.min(axis=(0, 1)) + corner.max(axis=(0, 1))) / 2
        radius = np.float32(np.linalg.norm(corner - middle, axis=2).max() * 1.001)
        found = _meet(*rays, inverse, corner, middle, radius, nearest)
        hit = found >= 0
        plant[hit], part[hit], face[hit] = number, kind[found[hit]], found[hit]
    shape = (height, width, samples)
    return PlainSamples(plant.reshape(shape), part.reshape(shape), face.reshape(shape), nearest.reshape(shape))


def _triangles(meshes: list[Mesh]) -> NDArray[np.float32]:
    """(T, 3, 3) triangle, corner, coordinate, in the frame of the exemplar."""
    return np.concatenate([mesh.vertices_m[mesh.faces] for mesh in meshes]).astype(np.float32)


@numba.njit(cache=True, nogil=True)
def _meet(start, direction, inverse, corner, middle, radius, nearest):  # type: ignore[no-untyped-def]
    """Of each ray the triangle that is nearer than `nearest`, which falls with it, or -1."""
    found = np.full(len(direction), -1, dtype=np.int64)
    for ray in range(len(direction)):
        ox, oy, oz = _turned(inverse, start[ray])
        ox, oy, oz = ox + inverse[0, 3], oy + inverse[1, 3], oz + inverse[2, 3]
        dx, dy, dz = _turned(inverse, direction[ray])
        ax, ay, az = middle[0] - ox, middle[1] - oy, middle[2] - oz
        along = ax * dx + ay * dy + az * dz
        gap = ax * ax + ay * ay + az * az - along * along / (dx * dx + dy * dy + dz * dz)
        if gap > radius * radius * np.float32(1.001):
            continue
        for t in range(len(corner)):
            x, y, z = corner[t, 0, 0], corner[t, 0, 1], corner[t, 0, 2]
            ex, ey, ez = corner[t, 1, 0] - x, corner[t, 1, 1] - y, corner[t, 1, 2] - z
            fx, fy, fz = corner[t, 2, 0] - x, corner[t, 2, 1] - y, corner[t, 2, 2] - z
            px, py, pz = dy * fz - dz * fy, dz * fx - dx * fz, dx * fy - dy * fx
            volume = ex * px + ey * py + ez * pz
            if volume == 0:
                continue
            sx, sy, sz = ox - x, oy - y, oz - z
            u = (sx * px + sy * py + sz * pz) / volume
            if u < -_OVER or u > 1 + _OVER:
                continue
            qx, qy, qz = sy * ez - sz * ey, sz * ex - sx * ez, sx * ey - sy * ex
            v = (dx * qx + dy * qy + dz * qz) / volume
            if v < -_OVER or u + v > 1 + _OVER:
                continue
            distance = (fx * qx + fy * qy + fz * qz) / volume
            if 0 < distance < nearest[ray]:
                nearest[ray], found[ray] = distance, t
    return found


@numba.njit(cache=True, nogil=True)
def _turned(matrix, vector):  # type: ignore[no-untyped-def]
    x, y, z = vector[0], vector[1], vector[2]
    return (
        matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2] * z,
        matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2] * z,
        matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2] * z,
    )
