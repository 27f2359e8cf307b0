"""The identity pass: who is in each sample of each pixel, traced exactly.

`ray_intersect_preliminary` of an LLVM (or CUDA) variant needs no code per instance, so its one small kernel serves any
number of instances. What a hit means is looked up in flat tables: instance -> plant, (exemplar, organ) -> part and
colour, face -> normal. Rays leave in a regular grid of S sub-pixel positions; a further ray through the pixel's
centre gives depth, position and normal.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.geometry.mesh import Mesh
from forestgen.render.build import load, origin_of, plants_dict, to_mesh
from forestgen.render.frame import Identity
from forestgen.render.variant import LLVM, drjit, mitsuba, require_llvm
from forestgen.scene.spec import Camera, SceneSpec


@dataclass(frozen=True)
class HitTables:
    """Flat tables behind a hit; entry 0 of each is the terrain's."""

    plant_id: NDArray[np.uint32]  # (1 + N,) by instance
    rotation: NDArray[np.float32]  # (1 + N, 9) row-major linear part of the instance's transform
    first_organ: NDArray[np.uint32]  # (1 + N,) first organ of the instance's exemplar
    part: NDArray[np.uint8]  # (1 + O,) by organ
    albedo: NDArray[np.float32]  # (1 + O, 3) reflectance + transmittance
    first_face: NDArray[np.uint32]  # (1 + O,) first face of the organ
    normal: NDArray[np.float32]  # (F, 3) geometric, not normalised by the instance's transform


def face_normals(mesh: Mesh) -> NDArray[np.float32]:
    """(F, 3) unit geometric normals; a degenerate face has zero."""
    # By coordinates: three times as fast as np.cross on half a million faces.
    a, b, c = (mesh.vertices_m.astype(np.float64).T[:, mesh.faces[:, k]] for k in range(3))
    (x, y, z), (u, v, w) = b - a, c - a
    normal = np.stack([y * w - z * v, z * u - x * w, x * v - y * u])
    length = np.sqrt(np.einsum("kf,kf->f", normal, normal))
    normal /= np.where(length > 0, length, 1.0)
    return np.ascontiguousarray(normal.T, dtype=np.float32)


def hit_tables(spec: SceneSpec) -> HitTables:
    """Tables of `spec`: O(instances + faces of exemplars)."""
    part, albedo, first_face = [int(Part.GROUND)], [spec.terrain.texture.mean(axis=(0, 1))], [0]
    normals = [face_normals(spec.terrain.mesh)]
    faces = len(normals[0])
    organ_of_exemplar = np.zeros(len(spec.exemplars), dtype=np.uint32)
    for index, exemplar in enumerate(spec.exemplars):
        organ_of_exemplar[index] = len(part)
        for organ in exemplar.organs:
            material = spec.materials[exemplar.species, organ.material]
            part.append(int(organ.part))
            albedo.append(np.add(material.reflectance, material.transmittance))
            first_face.append(faces)
            normals.append(face_normals(organ.mesh))
            faces += len(normals[-1])
    linear = spec.instances.transform[:, :, :3]
    # Normals go with the inverse transpose; for a rotation times a uniform scale that is the matrix itself up to scale.
    inverse_transpose = np.linalg.inv(linear).transpose(0, 2, 1)
    return HitTables(
        plant_id=np.concatenate([[0], spec.instances.plant_id]).astype(np.uint32),
        rotation=np.concatenate([np.eye(3).reshape(1, 9), inverse_transpose.reshape(-1, 9)]).astype(np.float32),
        first_organ=np.concatenate([[0], organ_of_exemplar[spec.instances.exemplar]]).astype(np.uint32),
        part=np.asarray(part, dtype=np.uint8),
        albedo=np.asarray(albedo, dtype=np.float32),
        first_face=np.asarray(first_face, dtype=np.uint32),
        normal=np.concatenate(normals),
    )


def sample_offsets(samples: int) -> NDArray[np.float64]:
    """(S, 2) sub-pixel positions in (0, 1), x and y: the centres of a square grid. `samples` is a perfect square."""
    side = round(samples**0.5)
    if side * side != samples:
        raise ValueError(f"samples must be a perfect square, got {samples}")
    steps = (np.arange(side) + 0.5) / side
    return np.stack([np.tile(steps, side), np.repeat(steps, side)], axis=1)


def camera_rays(camera: Camera, offset: NDArray[np.float64], first_row: int, rows: int) -> tuple[Any, Any]:
    """Unit directions through one sub-pixel position of `rows` rows: in the camera's axes, and in the world's."""
    mi, dr = mitsuba(), drjit()
    width, height = camera.size_px
    index = dr.arange(mi.UInt32, rows * width)
    row = index // width
    # The offsets go in as opaque values, so that one compiled kernel serves all of them.
    dx, dy, top = (dr.opaque(mi.Float, float(v)) for v in (offset[0], offset[1], first_row))
    focal = camera.focal_px
    u = (mi.Float(index - row * width) + dx - width / 2) / focal
    v = (mi.Float(row) + top + dy - height / 2) / focal
    along = dr.normalize(mi.Vector3f(u, v, 1.0))
    return along, mi.Matrix3f(camera.world_from_camera) @ along


class _Tracer:
    """One scene in the LLVM variant with its tables on the device."""

    def __init__(self, spec: SceneSpec, camera: Camera) -> None:
        mi, dr = mitsuba(), drjit()
        self.camera, self.origin_m = camera, origin_of(camera)
        scene = plants_dict(spec, self.origin_m, shaded=False)
        scene["terrain"] = to_mesh(spec.terrain.mesh, None, self.origin_m, "terrain")
        self.scene = load(scene)
        self.tables = hit_tables(spec)
        self.row_of_registry = mi.UInt32(self._registry_rows(len(spec.instances)))
        self.plant_id = mi.UInt32(self.tables.plant_id)
        self.rotation = mi.Float(self.tables.rotation.ravel())
        self.first_organ = mi.UInt32(self.tables.first_organ)
        self.part = mi.UInt32(self.tables.part.astype(np.uint32))
        self.albedo = mi.Float(self.tables.albedo.ravel())
        self.first_face = mi.UInt32(self.tables.first_face)
        self.normal = mi.Float(self.tables.normal.ravel())
        dr.eval()

    def _registry_rows(self, instances: int) -> NDArray[np.uint32]:
        """Table from the renderer's registry id of an instance to its row + 1; anything else maps to 0."""
        mi, dr = mitsuba(), drjit()
        rows: dict[int, int] = {}
        for shape in self.scene.shapes():
            name = shape.id()
            if name.startswith("instance-"):
                rows[int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape))[0])] = int(name[9:]) + 1
        if len(rows) != instances:
            raise RuntimeError(f"the renderer holds {len(rows)} of {instances} instances")
        table = np.zeros(max(rows, default=0) + 1, dtype=np.uint32)
        table[list(rows)] = list(rows.values())
        return table

    def trace(self, offset: NDArray[np.float64], first_row: int, rows: int) -> dict[str, Any]:
        """Hits of the rays at one sub-pixel position in `rows` rows from `first_row`, as device arrays."""
        mi, dr = mitsuba(), drjit()
        along, direction = camera_rays(self.camera, offset, first_row, rows)
        hit = self.scene.ray_intersect_preliminary(mi.Ray3f(mi.Point3f(0.0), direction), coherent=True)
        valid = hit.is_valid()
        registry = dr.reinterpret_array(mi.UInt32, hit.instance)
        instance = dr.gather(
            mi.UInt32, self.row_of_registry, registry, valid & (registry < dr.width(self.row_of_registry))
        )
        in_plant = valid & (instance > 0)
        organ = dr.gather(mi.UInt32, self.first_organ, instance, valid) + dr.select(in_plant, hit.shape_index, 0)
        face = dr.gather(mi.UInt32, self.first_face, organ, valid) + hit.prim_index
        local = dr.gather(mi.Vector3f, self.normal, face, valid)
        matrix = [dr.gather(mi.Float, self.rotation, instance * 9 + k, valid) for k in range(9)]
        normal = mi.Vector3f(
            *[matrix[3 * r] * local.x + matrix[3 * r + 1] * local.y + matrix[3 * r + 2] * local.z for r in range(3)]
        )
        normal *= dr.rcp(dr.maximum(dr.norm(normal), 1e-20))
        normal = dr.select(dr.dot(normal, direction) > 0, -normal, normal)
        return {
            "valid": valid,
            "plant_id": dr.gather(mi.UInt32, self.plant_id, instance, valid),
            "part": dr.gather(mi.UInt32, self.part, organ, valid),
            "distance_m": dr.select(valid, hit.t, dr.inf),
            "depth_m": dr.select(valid, hit.t * along.z, dr.inf),
            "direction": direction,
            "normal": dr.select(valid, normal, 0.0),
            "albedo": dr.select(valid, dr.gather(mi.Color3f, self.albedo, organ, valid), 1.0),
        }


def _image(array: Any, rows: int, width: int) -> NDArray[Any]:
    """Device array -> (rows, W) or (rows, W, 3)."""
    values = np.array(array)
    return values.reshape(rows, width) if values.ndim == 1 else np.ascontiguousarray(values.T).reshape(rows, width, 3)


def trace_identity(
    spec: SceneSpec, camera: Camera, *, samples: int, timer: Callable[[str], Any], advance: Callable[[int], None]
) -> Identity:
    """Identity of `camera`'s view with `samples` (a perfect square) samples a pixel; see `Identity`.

    Time O(pixels x samples x log triangles); memory 5 bytes a sample plus 60 bytes a pixel of a block of rows.
    """
    require_llvm()
    mi, dr = mitsuba(), drjit()
    width, height = camera.size_px
    offsets = sample_offsets(samples)
    with mi.variant_context(LLVM):
        with timer("identity: build"):
            tracer = _Tracer(spec, camera)
        result = _empty(height, width, samples)
        block = max(1, 2_000_000 // width)
        with timer("identity: trace"):
            for first in range(0, height, block):
                rows = min(block, height - first)
                _trace_block(tracer, offsets, slice(first, first + rows), result)
                advance(rows)
        del tracer
        dr.flush_malloc_cache()
    return result


def _empty(height: int, width: int, samples: int) -> Identity:
    return Identity(
        plant_id=np.zeros((height, width, samples), dtype=np.uint32),
        part=np.zeros((height, width, samples), dtype=np.uint8),
        depth_m=np.full((height, width), np.inf, dtype=np.float32),
        position_m=np.full((height, width, 3), np.nan, dtype=np.float32),
        normal=np.zeros((height, width, 3), dtype=np.float32),
        albedo=np.zeros((height, width, 3), dtype=np.float32),
        mean_normal=np.zeros((height, width, 3), dtype=np.float32),
    )


def _trace_block(tracer: _Tracer, offsets: NDArray[np.float64], rows: slice, result: Identity) -> None:
    """Fill the rows of `result`."""
    dr = drjit()
    width, count = tracer.camera.size_px[0], rows.stop - rows.start
    for number, offset in enumerate(offsets):
        hit = tracer.trace(offset, rows.start, count)
        dr.eval(hit["plant_id"], hit["part"], hit["albedo"], hit["normal"])
        result.plant_id[rows, :, number] = _image(hit["plant_id"], count, width)
        result.part[rows, :, number] = _image(hit["part"], count, width)
        result.albedo[rows] += _image(hit["albedo"], count, width) / np.float32(len(offsets))
        result.mean_normal[rows] += _image(hit["normal"], count, width) / np.float32(len(offsets))
    hit = tracer.trace(np.array([0.5, 0.5]), rows.start, count)
    dr.eval(hit["depth_m"], hit["normal"], hit["distance_m"], hit["direction"])
    result.depth_m[rows] = _image(hit["depth_m"], count, width)
    result.normal[rows] = _image(hit["normal"], count, width)
    distance = _image(hit["distance_m"], count, width).astype(np.float64)
    position = _image(hit["direction"], count, width) * np.where(np.isfinite(distance), distance, np.nan)[..., None]
    result.position_m[rows] = position + tracer.origin_m
