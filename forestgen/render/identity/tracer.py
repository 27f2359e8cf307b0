"""One scene in a tracing variant, with the tables of its hits on the device."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.render.build import load, origin_of, plants_dict, sun_direction, to_mesh
from forestgen.render.identity.tables import HitTables, hit_tables
from forestgen.render.variant import LLVM, drjit, mitsuba, require, tracing_variant, using
from forestgen.scene.spec import Camera, SceneSpec


def sample_offsets(samples: int) -> NDArray[np.float64]:
    """(S, 2) sub-pixel positions in (0, 1), x and y: the centres of a square grid. `samples` is a perfect square."""
    side = round(samples**0.5)
    if side * side != samples:
        raise ValueError(f"samples must be a perfect square, got {samples}")
    steps = (np.arange(side) + 0.5) / side
    return np.stack([np.tile(steps, side), np.repeat(steps, side)], axis=1)


def camera_rays(camera: Camera, offset: NDArray[np.float64], first_row: int, rows: int) -> tuple[Any, Any]:
    """Unit directions through sub-pixel positions of `rows` rows: in the camera's axes, and in the world's.

    Parameters
    ----------
    offset : (2,) or (S, 2), of `sample_offsets`. Rays run row by row, pixel by pixel, and then over the S positions:
        neighbours on the device stay neighbours in the scene, which makes tracing 2.5 times as fast as position by
        position.
    """
    mi, dr = mitsuba(), drjit()
    offsets, width = np.atleast_2d(offset), camera.size_px[0]
    index = dr.arange(mi.UInt32, rows * width * len(offsets))
    pixel = index // len(offsets)
    number = index - pixel * len(offsets)
    row = pixel // width
    dx, dy = (dr.gather(mi.Float, mi.Float(offsets[:, axis]), number) for axis in range(2))
    return pixel_rays(camera, pixel - row * width, row + dr.opaque(mi.UInt32, first_row), dx, dy)


def pixel_rays(camera: Camera, column: Any, row: Any, dx: Any, dy: Any) -> tuple[Any, Any]:
    """Unit directions through positions (dx, dy) in [0, 1] of pixels: in the camera's axes, and in the world's.

    All passes take their rays from here, so that theirs are equal to the last bit. What changes from camera to camera
    goes in as opaque values: one compiled kernel serves them all.
    """
    mi, dr = mitsuba(), drjit()
    width, height = camera.size_px
    scale = dr.opaque(mi.Float, float(np.float32(1) / np.float32(camera.focal_px)))  # in single precision throughout
    axes = mi.Matrix3f([[dr.opaque(mi.Float, float(value)) for value in line] for line in camera.world_from_camera])
    u = (mi.Float(column) + dx - width / 2) * scale
    v = (mi.Float(row) + dy - height / 2) * scale
    along = dr.normalize(mi.Vector3f(u, v, 1.0))
    return along, axes @ along


@dataclass(frozen=True)
class Hits:
    """Nearest hits of R rays, as device arrays; where `valid` is false the rest is 0 or meaningless."""

    direction: Any  # Vector3f, world, unit
    along_z: Any  # Float, the direction's share along the camera's z
    valid: Any  # Bool
    distance_m: Any  # Float
    instance: Any  # UInt32, row of the instances + 1; 0 for the terrain
    organ: Any  # UInt32, row of the organs' tables
    primitive: Any  # UInt32, triangle within the organ
    face: Any  # UInt32, row of the faces' tables
    uv: Any  # Point2f, barycentric weights of the triangle's second and third corner


def _slim(scene: dict[str, Any]) -> dict[str, Any]:
    """The scene with its instances loaded one by one, each taking 2 kB instead of 17.

    An instance keeps its transform twice: as numbers, which the ray tracer's own structure is built from, and as 32
    device arrays for shading, which nothing here asks for. The latter give way to one transform that all share.
    """
    mi = mitsuba()
    shared = mi.Transform4f()
    groups = {name: mi.load_dict(value) for name, value in scene.items() if name.startswith("exemplar-")}
    rest = {name: value for name, value in scene.items() if not name.startswith(("exemplar-", "instance-"))}
    instances = {}
    for name, value in scene.items():
        if name.startswith("instance-"):
            made = {**value, "id": name, "exemplar": groups[value["exemplar"]["id"]]}
            instances[name] = mi.load_dict(made, parallel=False, optimize=False)
            mi.traverse(instances[name])["to_world"] = shared
    return {**groups, **instances, **rest}


class SceneTracer:
    """One scene in a tracing variant with its tables on the device: set up once, for all cameras.

    Parameters
    ----------
    timer : context manager that books time under a name.
    variant : `render.variant.LLVM` or `CUDA`; by default the one that `tracing_variant` chooses.
    """

    def __init__(self, spec: SceneSpec, timer: Callable[[str], Any], variant: str | None = None) -> None:
        self.variant = tracing_variant() if variant is None else variant
        require(self.variant)
        with using(self.variant), timer("identity: build"):
            self._load(spec)

    def _load(self, spec: SceneSpec) -> None:
        # Of the cameras' own surroundings: a single camera stands in the origin, where coordinates are exact.
        self.spec, self.origin_m = spec, np.mean([origin_of(camera) for camera in spec.cameras], axis=0)
        scene = plants_dict(spec, self.origin_m, shaded=False)
        scene["terrain"] = to_mesh(spec.terrain.mesh, None, self.origin_m, "terrain")
        self.scene = load(_slim(scene) if self.variant == LLVM else scene)
        self._row_of_registry = self._registry_rows(len(spec.instances))
        self._upload(hit_tables(spec))

    def _upload(self, tables: HitTables) -> None:
        mi, dr = mitsuba(), drjit()
        self.table_bytes = tables.nbytes
        self.plant_id, self.exemplar = mi.UInt32(tables.plant_id), mi.UInt32(tables.exemplar)
        self.rotation = mi.Float(tables.rotation.ravel())
        self.first_organ, self.part = mi.UInt32(tables.first_organ), mi.UInt32(tables.part.astype(np.uint32))
        self.mean_albedo = mi.Float(tables.albedo.ravel())
        self.first_face, self.face_normal = mi.UInt32(tables.first_face), mi.Float(tables.normal.ravel())
        self.corner = mi.UInt32(tables.corner.ravel())
        self.first_normal, self.vertex_normal = mi.UInt32(tables.first_normal), mi.Float(tables.vertex_normal.ravel())
        self.first_uv, self.uv = mi.UInt32(tables.first_uv), mi.Float(tables.uv.ravel())
        self.texture, self.texel = mi.UInt32(tables.texture.ravel()), mi.Float(tables.texel.ravel())
        self.far_share = mi.Float(tables.far_share)
        self.far_albedo = mi.Color3f(*[dr.opaque(mi.Float, float(value)) for value in tables.far_albedo])
        self.to_sun = mi.Vector3f(*[dr.opaque(mi.Float, float(value)) for value in sun_direction(self.spec)])
        dr.eval()

    def _registry_rows(self, instances: int) -> Any:
        """Table from the renderer's registry id of an instance to its row + 1; anything else maps to 0."""
        mi, dr = mitsuba(), drjit()
        names = [shape.id() for shape in self.scene.shapes()]
        registry = np.array(dr.reinterpret_array(mi.UInt32, self.scene.shapes_dr())).astype(np.int64)
        placed = np.array([name.startswith("instance-") for name in names], dtype=bool)
        if placed.sum() != instances or len(registry) != len(names):
            raise RuntimeError(f"the renderer holds {placed.sum()} of {instances} instances")
        table = np.zeros(int(registry[placed].max(initial=0)) + 1, dtype=np.uint32)
        table[registry[placed]] = [int(name[9:]) + 1 for name in names if name.startswith("instance-")]
        return mi.UInt32(table)

    def trace(self, camera: Camera, offset: NDArray[np.float64], first_row: int, rows: int) -> Hits:
        """Hits of the rays through sub-pixel positions of `rows` rows from `first_row`; order as in `camera_rays`."""
        mi, dr = mitsuba(), drjit()
        along, direction = camera_rays(camera, offset, first_row, rows)
        hit = self.scene.ray_intersect_preliminary(mi.Ray3f(self.start_of(camera), direction), coherent=True)
        valid = hit.is_valid()
        registry = dr.reinterpret_array(mi.UInt32, hit.instance)
        known = valid & (registry < dr.width(self._row_of_registry))
        instance = dr.gather(mi.UInt32, self._row_of_registry, registry, known)
        inside = dr.select(valid & (instance > 0), hit.shape_index, 0)
        organ = dr.gather(mi.UInt32, self.first_organ, instance, valid) + inside
        return Hits(
            direction=direction,
            along_z=along.z,
            valid=valid,
            distance_m=hit.t,
            instance=instance,
            organ=organ,
            primitive=hit.prim_index,
            face=dr.gather(mi.UInt32, self.first_face, organ, valid) + hit.prim_index,
            uv=hit.prim_uv,
        )

    def start_of(self, camera: Camera) -> Any:
        """The camera's place in the frame of the scene's shapes."""
        mi, dr = mitsuba(), drjit()
        return mi.Point3f(*[dr.opaque(mi.Float, float(x)) for x in origin_of(camera) - self.origin_m])

    def face_in_exemplar(self, hits: Hits) -> Any:
        """Triangle of the exemplar with its organs one after another, or of the ground; 0 for the sky."""
        mi, dr = mitsuba(), drjit()
        organ = dr.gather(mi.UInt32, self.first_organ, hits.instance, hits.valid)
        first = dr.gather(mi.UInt32, self.first_face, organ, hits.valid)
        return dr.select(hits.valid, hits.face - first, 0)

    def to_world(self, normal: Any, hits: Hits) -> Any:
        """Unit normals, world, of normals in their instances' frames."""
        mi, dr = mitsuba(), drjit()
        m = [dr.gather(mi.Float, self.rotation, hits.instance * 9 + k, hits.valid) for k in range(9)]
        turned = mi.Vector3f(
            *[m[3 * r] * normal.x + m[3 * r + 1] * normal.y + m[3 * r + 2] * normal.z for r in range(3)]
        )
        return turned * dr.rcp(dr.maximum(dr.norm(turned), 1e-20))

    def geometric_normal(self, hits: Hits) -> Any:
        """Unit normals, world, towards the camera; 0 for the sky."""
        mi, dr = mitsuba(), drjit()
        normal = self.to_world(dr.gather(mi.Vector3f, self.face_normal, hits.face, hits.valid), hits)
        return dr.select(hits.valid, dr.select(dr.dot(normal, hits.direction) > 0, -normal, normal), 0.0)
