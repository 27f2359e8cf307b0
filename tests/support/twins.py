"""Twins of an instanced scene, to test the identity pass against.

`bake` writes every instance's triangles out in the world. `trace_twin` traces them in the renderer without a single
instance or shape group, along the identity pass' own rays. `Oracle` meets the same triangles in NumPy, in double
precision, by brute force, along rays of its own, from the camera's definition.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.geometry.mesh import Mesh
from forestgen.render.build import load, origin_of, to_mesh
from forestgen.render.identity import camera_rays, sample_offsets
from forestgen.render.variant import LLVM, drjit, mitsuba
from forestgen.scene.spec import Camera, SceneSpec
from support.lens_points import lens_points

_RAYS_AT_ONCE = 64


@dataclass(frozen=True)
class BakedMesh:
    """One organ of one instance, or the terrain."""

    plant_id: int  # 0 for the terrain
    part: int
    exemplar: int  # index into SceneSpec.exemplars + 1; 0 for the terrain
    first_face: int  # of the organ within its exemplar
    vertices_m: NDArray[np.float64]  # (V, 3) world
    faces: NDArray[np.uint32]  # (F, 3)
    normals: NDArray[np.float64] | None  # (V, 3) world, as long as the instance's inverse transpose leaves them


def baked_meshes(spec: SceneSpec) -> list[BakedMesh]:
    """Each organ of each instance in the world, in double precision, and the terrain last."""
    meshes = []
    instances = spec.instances
    for row in range(len(instances)):
        matrix, exemplar, first = instances.transform[row], int(instances.exemplar[row]), 0
        for organ in spec.exemplars[exemplar].organs:
            mesh = organ.mesh
            vertices = mesh.vertices_m.astype(np.float64) @ matrix[:, :3].T + matrix[:, 3]
            normals = None if mesh.normals is None else mesh.normals.astype(np.float64) @ np.linalg.inv(matrix[:, :3])
            kind = int(organ.part)
            meshes.append(
                BakedMesh(int(instances.plant_id[row]), kind, exemplar + 1, first, vertices, mesh.faces, normals)
            )
            first += len(mesh.faces)
    ground = spec.terrain.mesh
    normals = None if ground.normals is None else ground.normals.astype(np.float64)
    vertices = ground.vertices_m.astype(np.float64)
    return [*meshes, BakedMesh(0, int(Part.GROUND), 0, 0, vertices, ground.faces, normals)]


def _unit(vectors: NDArray[Any]) -> NDArray[np.float64]:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.maximum(length, 1e-300), dtype=np.float64)


@dataclass(frozen=True)
class Baked:
    """All triangles of a scene in the world."""

    corner_m: NDArray[np.float64]  # (T, 3, 3) triangle, corner, coordinate
    normal: NDArray[np.float64]  # (T, 3, 3) at the corners; the geometric one where the mesh has none
    plant_id: NDArray[np.uint32]  # (T,) 0 for the terrain
    part: NDArray[np.uint8]  # (T,)
    exemplar: NDArray[np.uint32]  # (T,) as in `BakedMesh`
    face: NDArray[np.uint32]  # (T,) triangle of the exemplar, its organs one after another, or of the terrain


def bake(spec: SceneSpec) -> Baked:
    """Triangles of the plants and of the terrain."""
    meshes = baked_meshes(spec)
    corner_m = np.concatenate([mesh.vertices_m[mesh.faces] for mesh in meshes])
    flat = _unit(np.cross(corner_m[:, 1] - corner_m[:, 0], corner_m[:, 2] - corner_m[:, 0]))[:, None]
    normals = [np.full((len(m.faces), 3, 3), np.nan) if m.normals is None else m.normals[m.faces] for m in meshes]
    smooth = np.concatenate(normals)

    def each(values: list[int], kind: type[np.generic]) -> NDArray[Any]:
        return np.repeat(np.asarray(values, dtype=kind), [len(mesh.faces) for mesh in meshes])

    return Baked(
        corner_m=corner_m,
        normal=np.where(np.isnan(smooth), flat, smooth),
        plant_id=each([mesh.plant_id for mesh in meshes], np.uint32),
        part=each([mesh.part for mesh in meshes], np.uint8),
        exemplar=each([mesh.exemplar for mesh in meshes], np.uint32),
        face=np.concatenate([mesh.first_face + np.arange(len(mesh.faces), dtype=np.uint32) for mesh in meshes]),
    )


@dataclass(frozen=True)
class TwinHits:
    """What rays hit: any shape, names as in `forestgen.render.frame`."""

    plant_id: NDArray[np.uint32]
    part: NDArray[np.uint8]
    exemplar: NDArray[np.uint32]
    face: NDArray[np.uint32]
    depth_m: NDArray[np.float32]
    sun_visible: NDArray[np.bool_]


@dataclass(frozen=True)
class TwinSamples:
    """What the twin's samples hit; shapes as in `forestgen.render.frame.Identity`, and centres as in `Surface`."""

    plant_id: NDArray[np.uint32]  # (H, W, S)
    part: NDArray[np.uint8]  # (H, W, S)
    exemplar: NDArray[np.uint32]  # (H, W, S)
    face: NDArray[np.uint32]  # (H, W, S)
    depth_m: NDArray[np.float32]  # (H, W)
    centre: TwinHits  # (H, W) each


class Twin:
    """The expanded scene in the renderer: one mesh a plant and organ, told apart by the renderer's shape alone."""

    def __init__(self, spec: SceneSpec, camera: Camera) -> None:
        mi, dr = mitsuba(), drjit()
        self._camera, self._meshes, self._sun = camera, baked_meshes(spec), spec.sky.to_sun
        origin = origin_of(camera)
        shapes = {}
        for number, baked in enumerate(self._meshes):
            mesh = Mesh((baked.vertices_m - origin).astype(np.float32), baked.faces)
            shapes[f"baked-{number}"] = to_mesh(mesh, None, None, f"baked-{number}")
        self._scene = load(shapes)
        entry = {}
        for shape in self._scene.shapes():
            registry = int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape))[0])
            entry[registry] = int(shape.id().removeprefix("baked-"))
        if len(entry) != len(self._meshes):
            raise RuntimeError(f"the renderer holds {len(entry)} of {len(self._meshes)} shapes")
        self._mesh_of_registry = np.zeros(max(entry) + 1, dtype=np.int64)
        self._mesh_of_registry[list(entry)] = list(entry.values())

    def trace(self, offset: NDArray[np.float64]) -> TwinHits:
        """(H, W, S) hits of the identity pass' rays at (S, 2) sub-pixel positions."""
        mi, dr = mitsuba(), drjit()
        width, height = self._camera.size_px
        rays = camera_rays(self._camera, offset, 0, height)
        start = mi.Point3f(0.0) if rays.shift_m is None else mi.Point3f(rays.shift_m)
        hit = self._scene.ray_intersect_preliminary(mi.Ray3f(start, rays.direction), coherent=True)
        found = hit.is_valid() if rays.valid is None else hit.is_valid() & rays.valid
        depth = dr.select(found, hit.t * rays.depth_share, dr.inf)
        shape = (height, width, len(np.atleast_2d(offset)))
        valid = np.array(found).reshape(shape)
        mesh = self._mesh_of_registry[np.array(dr.reinterpret_array(mi.UInt32, hit.shape)).astype(np.int64)]
        mesh, triangle = mesh.reshape(shape), np.array(hit.prim_index).reshape(shape)

        def of(values: list[int], kind: type[np.generic]) -> NDArray[Any]:
            return np.where(valid, np.asarray(values, dtype=kind)[mesh], kind(0))

        face = np.asarray([m.first_face for m in self._meshes], dtype=np.uint32)[mesh] + triangle
        return TwinHits(
            plant_id=of([m.plant_id for m in self._meshes], np.uint32),
            part=of([m.part for m in self._meshes], np.uint8),
            exemplar=of([m.exemplar for m in self._meshes], np.uint32),
            face=np.where(valid, face, 0).astype(np.uint32),
            depth_m=np.array(depth).reshape(shape),
            sun_visible=valid & self._lit(hit, start + hit.t * rays.direction, mesh, triangle).reshape(shape),
        )

    def _lit(self, hit: Any, point: Any, mesh: NDArray[np.int64], triangle: NDArray[np.uint32]) -> NDArray[Any]:
        """Shadow rays from a tenth of a millimetre off the surface, at the sun's side."""
        mi, dr = mitsuba(), drjit()
        normal = np.zeros((mesh.size, 3))
        for number in np.unique(mesh):
            mine = mesh.ravel() == number
            faces = self._meshes[number].faces
            corner = self._meshes[number].vertices_m[faces[np.minimum(triangle.ravel()[mine], len(faces) - 1)]]
            normal[mine] = _unit(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]))
        normal *= np.where(normal @ self._sun < 0, -1e-4, 1e-4)[:, None]
        start = point + mi.Vector3f(np.ascontiguousarray(normal.T))
        start = dr.select(hit.is_valid(), start, 0.0)
        to_sun = mi.Vector3f(*[float(x) for x in self._sun])
        return ~np.array(self._scene.ray_test(mi.Ray3f(mi.Point3f(start), to_sun)))


def trace_twin(spec: SceneSpec, camera: Camera, samples: int) -> TwinSamples:
    """Trace the expanded scene."""
    with mitsuba().variant_context(LLVM):
        twin = Twin(spec, camera)
        hits, centre = twin.trace(sample_offsets(samples)), twin.trace(np.array([0.5, 0.5]))
    middle = TwinHits(**{name: values[..., 0] for name, values in vars(centre).items()})
    return TwinSamples(hits.plant_id, hits.part, hits.exemplar, hits.face, middle.depth_m, middle)


@dataclass(frozen=True)
class Hits:
    """Nearest hits of R rays."""

    plant_id: NDArray[np.uint32]  # (R,)
    part: NDArray[np.uint8]  # (R,)
    exemplar: NDArray[np.uint32]  # (R,)
    face: NDArray[np.uint32]  # (R,)
    distance_m: NDArray[np.float64]  # (R,) inf where nothing is hit
    normal: NDArray[np.float64]  # (R, 3) unit, geometric, towards the ray's origin; 0 where nothing is hit
    shading_normal: NDArray[np.float64]  # (R, 3) unit, interpolated, on the geometric one's side; 0 likewise
    triangle: NDArray[np.intp]  # (R,) of `Baked`; meaningless where nothing is hit


class Oracle:
    """Brute force: every ray against every triangle, in double precision (Möller and Trumbore 1997).

    Points of the image may carry the number of their sample: then a lens' rays go through that sample's point of it,
    and through its middle without.
    """

    def __init__(self, spec: SceneSpec, camera: Camera) -> None:
        self._baked, self._camera, self._sun = bake(spec), camera, spec.sky.to_sun
        corner = self._baked.corner_m - np.asarray(camera.position_m)
        self._a, self._e1, self._e2 = corner[:, 0], corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]

    def rays(
        self, x_px: NDArray[np.float64], y_px: NDArray[np.float64], number: NDArray[np.integer] | None = None
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
        """Origins (R, 3) from the camera's place, unit directions (R, 3), world, and whether there is such a ray (R,).

        Through points of the image: x right, y down, the first pixel's centre at (.5, .5).
        """
        camera = self._camera
        width, height = camera.size_px
        right, down, forward = camera.world_from_camera.T
        across, below = ((x_px - width / 2)[:, None], (y_px - height / 2)[:, None])
        start, valid = np.zeros((len(x_px), 3)), np.ones(len(x_px), dtype=bool)
        if camera.projection == "orthographic":
            start = (across * right + below * down) * (camera.width_m / width)
            return start, np.tile(forward, (len(x_px), 1)), valid
        if camera.projection == "panorama":
            turn, tilt = across / width * 2 * np.pi, below / height * np.pi
            level = np.cos(turn) * forward + np.sin(turn) * right
            return start, np.cos(tilt) * level + np.sin(tilt) * down, valid
        if camera.projection == "fisheye":
            radius = np.sqrt(across**2 + below**2)
            theta = radius / (width / 2) * np.radians(camera.hfov_deg / 2)
            aside = (across * right + below * down) / np.maximum(radius, 1e-300)
            return start, np.cos(theta) * forward + np.sin(theta) * aside, radius[:, 0] <= width / 2
        half = np.tan(np.radians(camera.hfov_deg) / 2)
        if camera.projection == "distorted":
            across, below = (
                one[:, None] * width / 2 / half
                for one in _undistorted(across[:, 0] * half * 2 / width, below[:, 0] * half * 2 / width, camera.numbers)
            )
        ray = forward + (across * half * right + below * half * down) / (width / 2)
        if camera.lens is not None and number is not None:
            pixel = np.floor([x_px, y_px]).astype(np.int64)
            disc = lens_points(pixel[0], pixel[1], number) * camera.lens.aperture_radius_m
            start = disc[:, :1] * right + disc[:, 1:] * down
            ray = ray * camera.lens.focus_m - start
        return start, np.asarray(ray / np.linalg.norm(ray, axis=1, keepdims=True)), valid

    def trace(
        self, x_px: NDArray[np.float64], y_px: NDArray[np.float64], number: NDArray[np.integer] | None = None
    ) -> Hits:
        """O(rays x triangles)."""
        start, direction, exists = self.rays(*_flat(x_px, y_px, number))
        blocks = [slice(k, k + _RAYS_AT_ONCE) for k in range(0, len(direction), _RAYS_AT_ONCE)]
        parts = [self._nearest(start[rows], direction[rows]) for rows in blocks]
        distance = np.where(exists, np.concatenate([d for d, _ in parts]), np.inf)
        face = np.concatenate([f for _, f in parts])
        valid, baked = np.isfinite(distance), self._baked
        normal = _unit(np.cross(self._e1[face], self._e2[face]))
        normal *= -np.sign(np.sum(normal * direction, axis=1, keepdims=True))
        point = start + direction * np.where(valid, distance, 0.0)[:, None]
        shading = self._interpolated(point, face)
        shading *= np.where(np.sum(shading * normal, axis=1, keepdims=True) < 0, -1.0, 1.0)
        return Hits(
            plant_id=np.where(valid, baked.plant_id[face], 0).astype(np.uint32),
            part=np.where(valid, baked.part[face], 0).astype(np.uint8),
            exemplar=np.where(valid, baked.exemplar[face], 0).astype(np.uint32),
            face=np.where(valid, baked.face[face], 0).astype(np.uint32),
            distance_m=distance,
            normal=np.where(valid[:, None], normal, 0.0),
            shading_normal=np.where(valid[:, None], shading, 0.0),
            triangle=face,
        )

    def _interpolated(self, point: NDArray[np.float64], face: NDArray[np.intp]) -> NDArray[np.float64]:
        """(R, 3) unit: the corners' normals weighed by the areas of the triangles opposite to them."""
        corner = [self._a[face], self._a[face] + self._e1[face], self._a[face] + self._e2[face]]
        whole = np.cross(self._e1[face], self._e2[face])
        total = np.zeros(point.shape)
        for k in range(3):
            opposite = np.cross(corner[(k + 1) % 3] - point, corner[(k + 2) % 3] - point)
            total += np.sum(opposite * whole, axis=1, keepdims=True) * self._baked.normal[face, k]
        return _unit(total)

    def sun_visible(
        self, x_px: NDArray[np.float64], y_px: NDArray[np.float64], hits: Hits, start_m: float = 0.0
    ) -> NDArray[np.bool_]:
        """(R,) no other triangle lies between the hits of `trace` and the sun; from `start_m` along the way on."""
        start, direction, _ = self.rays(*_flat(x_px, y_px, None))
        found = np.isfinite(hits.distance_m)
        for k in np.flatnonzero(found):
            away = start[k] + direction[k] * hits.distance_m[k] - self._a
            p, q = np.cross(self._sun, self._e2), np.cross(away, self._e1)
            det = np.sum(p * self._e1, axis=1)
            with np.errstate(divide="ignore", invalid="ignore"):
                u, v = np.sum(away * p, axis=1) / det, q @ self._sun / det
                t = np.sum(self._e2 * q, axis=1) / det
                meets = (det != 0) & (u >= 0) & (v >= 0) & (u + v <= 1) & (t > start_m)
            meets[hits.triangle[k]] = False
            found[k] = not meets.any()
        return found

    def _nearest(
        self, start: NDArray[np.float64], direction: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
        # As matrix products: d . (e2 x (s - a)) = d . (e2 x -a) + e2 . (s x d), and det = d . (e2 x e1), either sign.
        whole = np.cross(self._e1, self._e2)
        det = direction @ whole.T * -1.0
        moment = np.cross(start, direction)
        with np.errstate(divide="ignore", invalid="ignore"):
            u = (direction @ np.cross(self._e2, -self._a).T + moment @ self._e2.T) / det
            v = (direction @ np.cross(-self._a, self._e1).T - moment @ self._e1.T) / det
            t = (start @ whole.T + np.sum(self._e2 * np.cross(-self._a, self._e1), axis=1)) / det
            inside = (det != 0) & (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
        t = np.where(inside, t, np.inf)
        face = np.argmin(t, axis=1)
        return t[np.arange(len(t)), face], face


def _undistorted(x: NDArray[np.float64], y: NDArray[np.float64], k: Mapping[str, float]) -> NDArray[np.float64]:
    """(2, R) slopes that a lens shows at distorted ones, by OpenCV's fixed-point iteration."""
    a, b = x, y
    for _ in range(500):
        r2 = a * a + b * b
        radial = 1 + k["k1"] * r2 + k["k2"] * r2**2 + k["k3"] * r2**3
        aside = 2 * k["p1"] * a * b + k["p2"] * (r2 + 2 * a * a)
        a, b = (x - aside) / radial, (y - k["p1"] * (r2 + 2 * b * b) - 2 * k["p2"] * a * b) / radial
    return np.array([a, b])


def _flat(
    x_px: NDArray[np.float64], y_px: NDArray[np.float64], number: NDArray[np.integer] | None
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.integer] | None]:
    """Points of the image and their numbers, one-dimensional."""
    if number is None:
        return np.ravel(x_px), np.ravel(y_px), None
    x, y, numbers = np.broadcast_arrays(x_px, y_px, number)
    return x.ravel(), y.ravel(), numbers.ravel()
