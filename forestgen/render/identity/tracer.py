"""One scene in a tracing variant, with the tables of its hits on the device.

Flat tables tell what a hit means: instance -> plant, (exemplar, organ) -> part and colour, face -> vertices. Entry 0 of
instances and organs is the terrain's. Bytes: 48 an instance, 24 a triangle, 12 a vertex with a normal, 8 a vertex of a
textured mesh, 12 a texel: 77 MB for the 10,000 instances of benchmarks/labels.py.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.geometry.mesh import Mesh
from forestgen.render.build import load, origin_of, plants_dict, to_mesh
from forestgen.render.surfaces import LEAFLIKE
from forestgen.render.variant import LLVM, dr, mi, on_device, require, tracing_variant, using
from forestgen.scene.bark_tones import bark_tones
from forestgen.scene.colour import RGB
from forestgen.scene.motion import is_rolling, row_poses, shutter_s
from forestgen.scene.projection import DeviceRays, Projection, Rays, projection_of
from forestgen.scene.spec import Camera, Material, SceneSpec
from forestgen.scene.surfaces import film_factor

# Steps of the R2 sequence (Roberts 2018) in units of 2^-32: powers of the inverse of the real root of x^3 = x + 1.
LENS_STEPS = (3242174889, 2447445414)
HASH_ROUNDS = 8  # of the cipher TEA; after 4, numbers of neighbouring pixels are not yet uniform
_TIMES = 29  # of the exposure, between a sample's time and the next one's; it has no divisor in common with 64
NONE = 2**32 - 1  # instead of a first row: the mesh has none


@dataclass(frozen=True)
class HitTables:
    """Everything that turns a hit into labels."""

    plant_id: NDArray[np.uint32]  # (1 + N,) by instance
    exemplar: NDArray[np.uint32]  # (1 + N,) 1 + index into SceneSpec.exemplars; 0: the terrain, or no plant_id
    rotation: NDArray[np.float32]  # (1 + N, 9) row-major inverse transpose of the instance's linear part
    first_organ: NDArray[np.uint32]  # (1 + N,) first organ of the instance's exemplar
    part: NDArray[np.uint8]  # (1 + O,) by organ
    albedo: NDArray[np.float32]  # (1 + O, 3) reflectance + transmittance, the mean of a texture
    first_face: NDArray[np.uint32]  # (1 + O,) first face of the organ
    normal: NDArray[np.float32]  # (F, 3) geometric, not normalised by the instance's transform
    corner: NDArray[np.uint32]  # (F, 3) vertices, counted within the organ's mesh
    first_normal: NDArray[np.uint32]  # (1 + O,) row of the organ's first vertex in `vertex_normal`, or NONE
    vertex_normal: NDArray[np.float32]  # (VN, 3)
    first_uv: NDArray[np.uint32]  # (1 + O,) row of the organ's first vertex in `uv`, or NONE
    uv: NDArray[np.float32]  # (VT, 2) of textured meshes alone
    texture: NDArray[np.uint32]  # (1 + O, 3) first texel, width, height; width 0: no texture
    texel: NDArray[np.float32]  # (T, 3) linear Rec. 709; row 0 of a texture is v = 0
    far_share: NDArray[np.float32]  # (VG,) by vertex of the terrain
    far_albedo: tuple[float, float, float]
    wet_share: NDArray[np.float32] | None  # (VG,) by vertex of the terrain; None: none is wet
    film_factor: tuple[float, float, float]  # of the wet ground's albedo
    patch_share: NDArray[np.float32] | None  # (K, VG) of the terrain's patches by vertex; None: there are none
    patch_texture: NDArray[np.uint32] | None  # (K, 3) as `texture`
    wood_tone: NDArray[np.float32] | None  # (1 + N,) by instance: of textured wood; None: no plant differs
    soaks: NDArray[np.float32] | None = None  # (1 + O,) share of a film's darkening; -1 of water; None: no rain
    film_share: NDArray[np.float32] | None = None  # (VG,) of the ground, by vertex
    pool_m: NDArray[np.float32] | None = None  # (VG,)

    @property
    def nbytes(self) -> int:
        return sum(value.nbytes for value in vars(self).values() if isinstance(value, np.ndarray))


def face_normals(mesh: Mesh) -> NDArray[np.float32]:
    """(F, 3) unit geometric normals; a degenerate face has zero."""
    # By coordinates: three times as fast as np.cross on half a million faces.
    a, b, c = (mesh.vertices_m.astype(np.float64).T[:, mesh.faces[:, k]] for k in range(3))
    (x, y, z), (u, v, w) = b - a, c - a
    normal = np.stack([y * w - z * v, z * u - x * w, x * v - y * u])
    length = np.sqrt(np.einsum("kf,kf->f", normal, normal))
    normal /= np.where(length > 0, length, 1.0)
    return np.ascontiguousarray(normal.T, dtype=np.float32)


def organs_of(spec: SceneSpec) -> Iterator[tuple[Part, Mesh, Material]]:
    """Organs in the order of the tables, the terrain left out."""
    for exemplar in spec.exemplars:
        for organ in exemplar.organs:
            yield organ.part, organ.mesh, spec.materials[exemplar.species, organ.material]


def albedo_of(part: Part, material: Material) -> NDArray[np.float64]:
    """(3,) reflectance, and of a thin leaf the transmittance too: what `render.surfaces.surface_bsdf` makes of it."""
    reflectance = np.asarray(material.reflectance, dtype=np.float64)
    return reflectance + material.transmittance if part in LEAFLIKE else reflectance


def hit_tables(spec: SceneSpec) -> HitTables:
    """Tables of `spec`: O(instances + faces and vertices of exemplars + texels)."""
    terrain, organs = spec.terrain, list(organs_of(spec))
    meshes = [terrain.mesh, *(mesh for _, mesh, _ in organs)]
    ground_albedo = np.array(terrain.mean_colour)
    of_material = {(id(one), part in LEAFLIKE): _image(part, one) for part, _, one in organs}
    images = [terrain.texture, *(of_material[id(one), part in LEAFLIKE] for part, _, one in organs)]  # colours
    images = [None if mesh.uv is None else image for mesh, image in zip(meshes, images, strict=True)]
    shown = {id(image): image for image in images if image is not None}  # species share none, organs may
    patches = [one.texture for one in terrain.overlays]
    shown |= {id(one): one for one in patches}
    first_texel = dict(zip(shown, _first_rows(list(shown.values()), 1).tolist(), strict=True))
    organ_of_exemplar = 1 + np.cumsum([0, *(len(exemplar.organs) for exemplar in spec.exemplars)])
    normals, uvs = ([getattr(mesh, name) for mesh in meshes] for name in ("normals", "uv"))
    uvs = [None if image is None else uv for uv, image in zip(uvs, images, strict=True)]
    # Normals go with the inverse transpose; for a rotation times a uniform scale that is the matrix itself up to scale.
    inverse_transpose = np.linalg.inv(spec.instances.transform[:, :, :3]).transpose(0, 2, 1)
    film_red, film_green, film_blue = film_factor(terrain, RGB).tolist()
    return HitTables(
        plant_id=np.concatenate([[0], spec.instances.plant_id]).astype(np.uint32),
        exemplar=np.concatenate([[0], np.where(spec.instances.plant_id, spec.instances.exemplar + 1, 0)]).astype(
            np.uint32
        ),
        rotation=np.concatenate([np.eye(3).reshape(1, 9), inverse_transpose.reshape(-1, 9)]).astype(np.float32),
        first_organ=np.concatenate([[0], organ_of_exemplar[spec.instances.exemplar]]).astype(np.uint32),
        part=np.array([Part.GROUND, *(part for part, _, _ in organs)], dtype=np.uint8),
        albedo=np.array([ground_albedo, *(albedo_of(part, one) for part, _, one in organs)], dtype=np.float32),
        first_face=_first_rows([mesh.faces for mesh in meshes], 0),
        normal=np.concatenate([face_normals(mesh) for mesh in meshes]),
        corner=np.concatenate([mesh.faces for mesh in meshes]),
        first_normal=_first_rows(normals, 1),
        vertex_normal=_joined(normals, 3),
        first_uv=_first_rows(uvs, 1),
        uv=_joined(uvs, 2),
        texture=np.array(
            [(0, 0, 0) if one is None else (first_texel[id(one)], one.shape[1], one.shape[0]) for one in images],
            dtype=np.uint32,
        ),
        texel=_joined([image.reshape(-1, 3) for image in shown.values()], 3),
        far_share=np.asarray(terrain.far_share, dtype=np.float32),
        far_albedo=terrain.far_reflectance,
        wet_share=None if terrain.wet is None else terrain.wet.share,
        film_factor=(film_red, film_green, film_blue),
        patch_share=np.stack([one.share for one in terrain.overlays]) if terrain.overlays else None,
        patch_texture=patch_rows(patches, [first_texel[id(one)] for one in patches]),
        wood_tone=_wood_tone(spec) if spec.bark_spread else None,
        soaks=None if spec.film is None else np.array([1.0, *(_soaks(*organ) for organ in organs)], dtype=np.float32),
        film_share=None if spec.film is None else spec.film.ground,
        pool_m=None if spec.film is None else spec.film.pool_m,
    )


def _wood_tone(spec: SceneSpec) -> NDArray[np.float32]:
    return np.append(np.float32(1.0), bark_tones(spec.instances.plant_id, spec.bark_spread))


def _soaks(part: Part, mesh: Mesh, material: Material) -> float:
    """Living leaves have a skin that water does not get into; litter has none."""
    if material.absorption is not None:
        return -1.0
    has_skin = max(material.transmittance) > 0.0 and part != Part.LITTER
    return 0.0 if has_skin or material.is_wet else 1.0


def patch_rows(images: Sequence[NDArray[np.float32]], first: Sequence[int]) -> NDArray[np.uint32] | None:
    """(K, 3) first texel, width and height of the textures of patches; None: there are none."""
    rows = [(row, image.shape[1], image.shape[0]) for row, image in zip(first, images, strict=True)]
    return np.array(rows, dtype=np.uint32) if rows else None


def _image(part: Part, material: Material) -> NDArray[np.float32] | None:
    """(H, W, 3) texture of `albedo_of`."""
    if material.texture is None:
        return None
    colour = material.texture.colour
    return colour + np.asarray(material.transmittance, np.float32) if part in LEAFLIKE else colour


def _first_rows(blocks: Sequence[NDArray[Any] | None], first: int) -> NDArray[np.uint32]:
    """Where each block begins in a table of them all, from a row on; NONE where there is no block."""
    rows = []
    for block in blocks:
        rows.append(NONE if block is None else first)
        first += 0 if block is None else block.size // block.shape[-1]
    return np.array(rows, dtype=np.uint32)


def _joined(blocks: Sequence[NDArray[np.float32] | None], width: int) -> NDArray[np.float32]:
    """All blocks, after one row that nothing refers to: the device gathers from no empty table."""
    return np.concatenate([np.zeros((1, width)), *(one for one in blocks if one is not None)], dtype=np.float32)


def uploaded(tables: Any) -> Any:
    """The fields of a dataclass on the device: arrays flat, and colours as opaque values."""
    fields: dict[str, Any] = {}
    for name, value in vars(tables).items():
        if isinstance(value, tuple):
            fields[name] = mi.Color3f(*[dr.opaque(mi.Float, float(one)) for one in value])
        elif value is not None:
            is_float = value.dtype.kind == "f"
            fields[name] = mi.Float(value.ravel()) if is_float else mi.UInt32(value.astype(np.uint32).ravel())
        else:
            fields[name] = None
    return SimpleNamespace(**fields)


def sample_offsets(samples: int) -> NDArray[np.float64]:
    """(S, 2) sub-pixel positions in (0, 1), x and y: the centres of a square grid. `samples` is a perfect square."""
    side = round(samples**0.5)
    if side * side != samples:
        raise ValueError(f"samples must be a perfect square, got {samples}")
    steps = (np.arange(side) + 0.5) / side
    return np.stack([np.tile(steps, side), np.repeat(steps, side)], axis=1)


def camera_rays(
    camera: Camera, offset: NDArray[np.float64], first_row: int, rows: int, *, exposed: bool = False
) -> DeviceRays:
    """Rays through sub-pixel positions of `rows` rows: an offset (2,), or `sample_offsets` (S, 2).

    Rays run row by row, pixel by pixel, and then over the S positions: neighbours on the device stay neighbours in the
    scene, which makes tracing 2.5 times as fast as position by position. A lens' rays of (2,) go through its middle,
    those of (S, 2) through all of it. `exposed`: those of (S, 2) take times spread over the exposure, the same ones in
    all pixels; else all are taken in its middle.
    """
    offsets, width = np.atleast_2d(offset), camera.size_px[0]
    index = dr.arange(mi.UInt32, rows * width * len(offsets))
    pixel = index // len(offsets)
    number = index - pixel * len(offsets)
    row = pixel // width
    dx, dy = (dr.gather(mi.Float, on_device(mi.Float, offsets[:, axis]), number) for axis in range(2))
    through = number if np.ndim(offset) == 2 else None
    time = (mi.Float(number * _TIMES % len(offsets)) + 0.5) / len(offsets) if exposed else None
    return pixel_rays(camera, pixel - row * width, row + dr.opaque(mi.UInt32, first_row), dx, dy, through, time)


def pixel_rays(
    camera: Camera, column: Any, row: Any, dx: Any, dy: Any, number: Any | None, time: Any | None = None
) -> DeviceRays:
    """Rays through positions (dx, dy) in [0, 1] of pixels; scene/projection.py has their definition.

    All passes take their rays from here, so that theirs are equal to the last bit. What changes from camera to camera
    goes in as opaque values: one compiled kernel serves all cameras of a kind. The `number` of the sample in its pixel
    chooses the point of the lens; None: its middle. `time` in [0, 1] is that in the exposure of the ray's row, of a
    camera that moves; None: the middle.
    """
    width, height = camera.size_px
    shift_m, axes = _row_pose(camera, row)
    x, y = mi.Float(column) + dx - width / 2, mi.Float(row) + dy - height / 2
    lens = None if camera.lens is None or number is None else _lens_points(column, row, number)
    projection = projection_of(camera)
    own = projection.device_rays(camera, x, y, lens, mi, dr)
    if own is None:
        own = _uploaded(projection.rays(camera, *(np.array(one, dtype=np.float64) for one in (x, y))), projection)
    direction, start_m = own.direction, own.shift_m
    if time is not None and camera.motion is not None:
        since_s = (time - 0.5) * dr.opaque(mi.Float, shutter_s(camera))
        direction, start_m = (None if one is None else _turned(camera, one, since_s) for one in (direction, start_m))
        way_m = mi.Vector3f(*[dr.opaque(mi.Float, one) for one in camera.motion.velocity_m_per_s]) * since_s
        shift_m = way_m if shift_m is None else shift_m + way_m
    if start_m is not None:
        shift_m = axes @ start_m if shift_m is None else shift_m + axes @ start_m
    return DeviceRays(axes @ direction, own.depth_share, shift_m, own.valid)


def _row_pose(camera: Camera, row: Any) -> tuple[Any | None, Any]:
    """Where the camera is in the middle of the exposure of rows, less its own place, and its axes; None: there."""
    if not is_rolling(camera):
        lines = [[dr.opaque(mi.Float, float(value)) for value in line] for line in camera.world_from_camera]
        return None, mi.Matrix3f(lines)
    place, axes = row_poses(camera)
    table = on_device(mi.Float, np.concatenate([place[:, 0], axes.reshape(-1, 9)], axis=1).ravel())
    x, y, z, *m = (dr.gather(mi.Float, table, mi.UInt32(row) * 12 + k) for k in range(12))
    return mi.Vector3f(x, y, z), mi.Matrix3f([m[:3], m[3:6], m[6:]])


def _turned(camera: Camera, vector: Any, since_s: Any) -> Any:
    """Vectors of the camera's axes as these stand a while later: Rodrigues' formula."""
    assert camera.motion is not None
    speed = float(np.linalg.norm(camera.motion.rotation_rad_per_s))
    axis = mi.Vector3f(*[dr.opaque(mi.Float, one / (speed or 1.0)) for one in camera.motion.rotation_rad_per_s])
    sine, cosine = dr.sincos(since_s * dr.opaque(mi.Float, speed))
    return vector * cosine + dr.cross(axis, vector) * sine + axis * (dr.dot(axis, vector) * (1.0 - cosine))


def _uploaded(rays: Rays, projection: Projection) -> DeviceRays:
    """Rays (R,) of a projection that has no code for the tracer."""
    direction = mi.Vector3f(*(on_device(mi.Float, axis) for axis in rays.direction.T))
    depth_share = mi.Float(1.0) if projection.depth_is_distance else direction.z
    shift_m = mi.Vector3f(*(on_device(mi.Float, axis) for axis in rays.origin_m.T)) if projection.is_parallel else None
    return DeviceRays(direction, depth_share, shift_m, None if rays.valid.all() else on_device(mi.Bool, rays.valid))


def _lens_points(column: Any, row: Any, number: Any) -> Any:
    """Points of the unit disc through which the samples of pixels go; uniform over it.

    A pixel's samples are points (a, b) of the R2 sequence on the torus, shifted by two random numbers of the pixel
    (Zafar, Olano and Curtis 2010), in whole steps of 2^-32; then r = sqrt(a), phi = 2 pi b.
    """
    keys = mi.sample_tea_32(mi.UInt32(column), mi.UInt32(row), HASH_ROUNDS)
    a, b = (mi.Float((shift + number * step) >> 8) * 2.0**-24 for shift, step in zip(keys, LENS_STEPS, strict=True))
    sine, cosine = dr.sincos(2 * np.pi * b)
    return dr.sqrt(a) * mi.Vector2f(cosine, sine)


@dataclass(frozen=True)
class Hits:
    """Nearest hits of R rays, as device arrays; where `valid` is false the rest is 0 or meaningless."""

    rays: DeviceRays
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
    shared = mi.Transform4f()

    class Share(mi.TraversalCallback):  # type: ignore[misc]
        """Replaces an instance's transform; `mi.traverse` would take twice as long, for what nobody asks."""

        def put(self, name: str, value: Any, flags: Any, kind: Any = None) -> None:
            self.put_value(name, value, flags, kind)

        def put_value(self, name: str, value: Any, flags: Any, kind: Any) -> None:
            if name == "to_world":
                mi.set_property(value, kind, shared)

        def put_object(self, name: str, value: Any, flags: Any) -> None:
            pass

    share = Share()
    groups = {name: mi.load_dict(value) for name, value in scene.items() if name.startswith("exemplar-")}
    rest = {name: value for name, value in scene.items() if not name.startswith(("exemplar-", "instance-"))}
    instances = {}
    for name, value in scene.items():
        if name.startswith("instance-"):
            made = {**value, "id": name, "exemplar": groups[value["exemplar"]["id"]]}
            instances[name] = mi.load_dict(made, parallel=False, optimize=False)
            instances[name].traverse(share)
    return {**groups, **instances, **rest}


class SceneTracer:
    """One scene in a tracing variant with its tables on the device: set up once, for all cameras.

    `timer` books time under a name. `variant` is by default the one that `tracing_variant` chooses.
    """

    def __init__(self, spec: SceneSpec, timer: Callable[[str], Any], variant: str | None = None) -> None:
        self.variant = tracing_variant() if variant is None else variant
        require(self.variant)
        # Of the cameras' own surroundings: a single camera stands in the origin, where coordinates are exact.
        self.spec, self.origin_m = spec, np.mean([origin_of(camera) for camera in spec.cameras], axis=0)
        with using(self.variant), timer("identity: build"):
            scene = plants_dict(spec, self.origin_m, None)
            scene["terrain"] = to_mesh(spec.terrain.mesh, None, self.origin_m, "terrain")
            self.scene = load(_slim(scene) if self.variant == LLVM else scene)
            self._row_of_registry = self._registry_rows(len(spec.instances))
            self.table = uploaded(hit_tables(spec))
            self.to_light = mi.Vector3f(*[dr.opaque(mi.Float, float(value)) for value in spec.sky.to_light])
            dr.eval()

    def _registry_rows(self, instances: int) -> Any:
        """Table from the renderer's registry id of an instance to its row + 1; anything else maps to 0."""
        names = [shape.id() for shape in self.scene.shapes()]
        registry = np.array(dr.reinterpret_array(mi.UInt32, self.scene.shapes_dr())).astype(np.int64)
        placed = np.array([name.startswith("instance-") for name in names], dtype=bool)
        if placed.sum() != instances or len(registry) != len(names):
            raise RuntimeError(f"the renderer holds {placed.sum()} of {instances} instances")
        table = np.zeros(int(registry[placed].max(initial=0)) + 1, dtype=np.uint32)
        table[registry[placed]] = [int(name[9:]) + 1 for name in names if name.startswith("instance-")]
        return mi.UInt32(table)

    def trace(
        self, camera: Camera, offset: NDArray[np.float64], first_row: int, rows: int, *, exposed: bool = False
    ) -> Hits:
        """Hits of the rays through sub-pixel positions of `rows` rows from `first_row`, as in `camera_rays`."""
        rays = camera_rays(camera, offset, first_row, rows, exposed=exposed)
        active = mi.Bool(True) if rays.valid is None else rays.valid
        ray = mi.Ray3f(self.start_of(camera, rays), rays.direction)
        return self.looked_up(rays, self.scene.ray_intersect_preliminary(ray, coherent=True, active=active), active)

    def by_rows(
        self, camera: Camera, offset: NDArray[np.float64], most_rays: int, *, exposed: bool = False
    ) -> Iterator[tuple[slice, Hits]]:
        """Rows of the whole image, as many at a time as have so many rays, and their hits; in the tracer's variant."""
        (width, height), samples = camera.size_px, len(np.atleast_2d(offset))
        step = max(1, most_rays // (width * samples))
        with using(self.variant):
            for first in range(0, height, step):
                last = min(first + step, height)
                yield slice(first, last), self.trace(camera, offset, first, last - first, exposed=exposed)
            dr.flush_malloc_cache()

    def looked_up(self, rays: DeviceRays, hit: Any, active: Any) -> Hits:
        """The hits that a `PreliminaryIntersection3f` of rays stands for."""
        valid = hit.is_valid() & active
        registry = dr.reinterpret_array(mi.UInt32, hit.instance)
        # Opaque, as all that changes from scene to scene: a literal would cost each image kernels of its own.
        known = valid & (registry < dr.opaque(mi.UInt32, dr.width(self._row_of_registry)))
        instance = dr.gather(mi.UInt32, self._row_of_registry, registry, known)
        inside = dr.select(valid & (instance > 0), hit.shape_index, 0)
        organ = dr.gather(mi.UInt32, self.table.first_organ, instance, valid) + inside
        return Hits(
            rays=rays,
            valid=valid,
            distance_m=hit.t,
            instance=instance,
            organ=organ,
            primitive=hit.prim_index,
            face=dr.gather(mi.UInt32, self.table.first_face, organ, valid) + hit.prim_index,
            uv=hit.prim_uv,
        )

    def start_of(self, camera: Camera, rays: DeviceRays) -> Any:
        """Where rays of the camera begin, in the frame of the scene's shapes."""
        place = mi.Point3f(*[dr.opaque(mi.Float, float(x)) for x in origin_of(camera) - self.origin_m])
        return place if rays.shift_m is None else place + rays.shift_m

    def face_in_exemplar(self, hits: Hits) -> Any:
        """Triangle of the exemplar with its organs one after another, or of the ground; 0 for the sky."""
        organ = dr.gather(mi.UInt32, self.table.first_organ, hits.instance, hits.valid)
        first = dr.gather(mi.UInt32, self.table.first_face, organ, hits.valid)
        return dr.select(hits.valid, hits.face - first, 0)

    def to_world(self, normal: Any, hits: Hits) -> Any:
        """Unit normals, world, of normals in their instances' frames."""
        m = [dr.gather(mi.Float, self.table.rotation, hits.instance * 9 + k, hits.valid) for k in range(9)]
        turned = mi.Vector3f(
            *[m[3 * r] * normal.x + m[3 * r + 1] * normal.y + m[3 * r + 2] * normal.z for r in range(3)]
        )
        return turned * dr.rcp(dr.maximum(dr.norm(turned), 1e-20))

    def direction_to_world(self, direction: Any, hits: Hits) -> Any:
        """World directions, of no special length, of directions in their instances' frames."""
        m = [dr.gather(mi.Float, self.table.rotation, hits.instance * 9 + k, hits.valid) for k in range(9)]
        rows = [mi.Vector3f(*m[3 * r : 3 * r + 3]) for r in range(3)]
        # Of an inverse transpose the cofactors are the matrix itself, but for its scale.
        return mi.Vector3f(*[dr.dot(dr.cross(rows[(r + 1) % 3], rows[(r + 2) % 3]), direction) for r in range(3)])

    def geometric_normal(self, hits: Hits) -> Any:
        """Unit normals, world, towards the camera; 0 for the sky."""
        normal = self.to_world(dr.gather(mi.Vector3f, self.table.normal, hits.face, hits.valid), hits)
        return dr.select(hits.valid, dr.select(dr.dot(normal, hits.rays.direction) > 0, -normal, normal), 0.0)
