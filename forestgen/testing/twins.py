"""Twins of an instanced scene, to test the identity pass against.

`bake` writes every instance's triangles out in the world. `trace_twin` traces them in the renderer without a single
instance or shape group, along the identity pass' own rays. `Oracle` meets the same triangles in NumPy, in double
precision, by brute force, along rays of its own, from the camera's definition.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.geometry.mesh import Mesh
from forestgen.render.build import load, origin_of, to_mesh
from forestgen.render.identity import camera_rays, sample_offsets
from forestgen.render.variant import LLVM, drjit, mitsuba
from forestgen.scene.spec import Camera, SceneSpec

_RAYS_AT_ONCE = 64


@dataclass(frozen=True)
class Baked:
    """All triangles of a scene in the world."""

    corner_m: NDArray[np.float64]  # (T, 3, 3) triangle, corner, coordinate
    plant_id: NDArray[np.uint32]  # (T,) 0 for the terrain
    part: NDArray[np.uint8]  # (T,)


def baked_meshes(spec: SceneSpec) -> list[tuple[int, int, NDArray[np.float64], NDArray[np.uint32]]]:
    """(plant_id, part, (V, 3) world vertices in double precision, faces) of each organ of each instance."""
    meshes = []
    instances = spec.instances
    for row in range(len(instances)):
        matrix = instances.transform[row]
        for organ in spec.exemplars[int(instances.exemplar[row])].organs:
            vertices = organ.mesh.vertices_m.astype(np.float64) @ matrix[:, :3].T + matrix[:, 3]
            meshes.append((int(instances.plant_id[row]), int(organ.part), vertices, organ.mesh.faces))
    return meshes


def bake(spec: SceneSpec) -> Baked:
    """Triangles of the plants and of the terrain."""
    ground = spec.terrain.mesh
    meshes = [*baked_meshes(spec), (0, int(Part.GROUND), ground.vertices_m.astype(np.float64), ground.faces)]
    return Baked(
        corner_m=np.concatenate([vertices[faces] for _, _, vertices, faces in meshes]),
        plant_id=np.concatenate([np.full(len(faces), plant, np.uint32) for plant, _, _, faces in meshes]),
        part=np.concatenate([np.full(len(faces), part, np.uint8) for _, part, _, faces in meshes]),
    )


@dataclass(frozen=True)
class TwinSamples:
    """What the twin's samples hit; shapes as in `forestgen.render.frame.Identity`."""

    plant_id: NDArray[np.uint32]  # (H, W, S)
    part: NDArray[np.uint8]  # (H, W, S)
    depth_m: NDArray[np.float32]  # (H, W)


def trace_twin(spec: SceneSpec, camera: Camera, samples: int) -> TwinSamples:
    """Trace the expanded scene: one mesh a plant and organ, told apart by the renderer's shape alone."""
    mi, dr = mitsuba(), drjit()
    width, height = camera.size_px
    with mi.variant_context(LLVM):
        origin = origin_of(camera)
        scene_dict = {"terrain": to_mesh(spec.terrain.mesh, None, origin, "terrain")}
        plant, part = [0], [int(Part.GROUND)]
        for number, (plant_id, kind, vertices, faces) in enumerate(baked_meshes(spec)):
            mesh = Mesh((vertices - origin).astype(np.float32), faces)
            scene_dict[f"baked-{number}"] = to_mesh(mesh, None, None, f"baked-{number}")
            plant.append(plant_id)
            part.append(kind)
        scene = load(scene_dict)
        entry = {}
        for shape in scene.shapes():
            registry = int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape))[0])
            entry[registry] = 0 if shape.id() == "terrain" else int(shape.id().removeprefix("baked-")) + 1
        if len(entry) != len(plant):
            raise RuntimeError(f"the renderer holds {len(entry)} of {len(plant)} shapes")
        table = np.zeros(max(entry) + 1, dtype=np.int64)
        table[list(entry)] = list(entry.values())
        plants, parts = np.asarray(plant, dtype=np.uint32)[table], np.asarray(part, dtype=np.uint8)[table]

        def trace(offset: NDArray[np.float64]) -> tuple[NDArray[np.bool_], NDArray[np.int64], NDArray[np.float32]]:
            along, direction = camera_rays(camera, offset, 0, height)
            hit = scene.ray_intersect_preliminary(mi.Ray3f(mi.Point3f(0.0), direction), coherent=True)
            depth = dr.select(hit.is_valid(), hit.t * along.z, dr.inf)
            shape = np.array(dr.reinterpret_array(mi.UInt32, hit.shape)).astype(np.int64).reshape(height, width)
            return np.array(hit.is_valid()).reshape(height, width), shape, np.array(depth).reshape(height, width)

        ids = np.zeros((height, width, samples), dtype=np.uint32)
        kinds = np.zeros((height, width, samples), dtype=np.uint8)
        for number, offset in enumerate(sample_offsets(samples)):
            valid, shape, _ = trace(offset)
            ids[..., number] = np.where(valid, plants[shape], 0)
            kinds[..., number] = np.where(valid, parts[shape], 0)
        _, _, depth_m = trace(np.array([0.5, 0.5]))
    return TwinSamples(ids, kinds, depth_m)


@dataclass(frozen=True)
class Hits:
    """Nearest hits of R rays."""

    plant_id: NDArray[np.uint32]  # (R,)
    part: NDArray[np.uint8]  # (R,)
    distance_m: NDArray[np.float64]  # (R,) inf where nothing is hit
    normal: NDArray[np.float64]  # (R, 3) unit, towards the ray's origin; 0 where nothing is hit


class Oracle:
    """Brute force: every ray against every triangle, in double precision (Möller and Trumbore 1997)."""

    def __init__(self, spec: SceneSpec, camera: Camera) -> None:
        self._baked, self._camera = bake(spec), camera
        corner = self._baked.corner_m - np.asarray(camera.position_m)
        self._a, self._e1, self._e2 = corner[:, 0], corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]

    def rays(self, x_px: NDArray[np.float64], y_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """(R, 3) unit directions through points of the image; x right, y down, the first pixel's centre at (.5, .5)."""
        camera = self._camera
        width, height = camera.size_px
        half = np.tan(np.radians(camera.hfov_deg) / 2)
        right, down, forward = camera.world_from_camera.T
        ray = (
            forward
            + ((x_px / width * 2 - 1) * half)[:, None] * right
            + ((y_px - height / 2) / (width / 2) * half)[:, None] * down
        )
        return np.asarray(ray / np.linalg.norm(ray, axis=1, keepdims=True))

    def trace(self, x_px: NDArray[np.float64], y_px: NDArray[np.float64]) -> Hits:
        """O(rays x triangles)."""
        direction = self.rays(np.ravel(x_px), np.ravel(y_px))
        parts = [self._nearest(direction[k : k + _RAYS_AT_ONCE]) for k in range(0, len(direction), _RAYS_AT_ONCE)]
        distance = np.concatenate([d for d, _ in parts])
        face = np.concatenate([f for _, f in parts])
        valid = np.isfinite(distance)
        normal = np.cross(self._e1[face], self._e2[face])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
        normal *= -np.sign(np.sum(normal * direction, axis=1, keepdims=True))
        return Hits(
            plant_id=np.where(valid, self._baked.plant_id[face], 0).astype(np.uint32),
            part=np.where(valid, self._baked.part[face], 0).astype(np.uint8),
            distance_m=distance,
            normal=np.where(valid[:, None], normal, 0.0),
        )

    def _nearest(self, direction: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
        # With the origin at 0: q = -a x e1 and e2 . q do not depend on the ray, and det = d . (e2 x e1) either sign.
        q = np.cross(-self._a, self._e1)
        det = direction @ np.cross(self._e1, self._e2).T * -1.0
        with np.errstate(divide="ignore", invalid="ignore"):
            u = direction @ np.cross(self._e2, -self._a).T / det
            v = direction @ q.T / det
            t = np.sum(self._e2 * q, axis=1) / det
            inside = (det != 0) & (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
        t = np.where(inside, t, np.inf)
        face = np.argmin(t, axis=1)
        return t[np.arange(len(t)), face], face
