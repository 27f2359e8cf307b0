"""Small scenes for tests and benchmarks that need geometry but no plant generator."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.grid import CloudGrid
from forestgen.core.frames import look_at
from forestgen.core.parts import Part
from forestgen.geometry.mesh import Mesh, surface_area_m2
from forestgen.plants.exemplar import Exemplar, OrganMesh
from forestgen.render.frame import Amodal
from forestgen.scene.spec import Camera, Instances, Material, SceneSpec, Sky, Terrain
from forestgen.scene.terrain import HeightField, build_terrain


def blade_cloud(leaves: int, height_m: float, width_m: float, leaf_m: float, rng: np.random.Generator) -> Mesh:
    """Randomly turned rhombic leaves that fill an ellipsoid crown."""
    centre = rng.normal(size=(leaves, 3))
    centre *= rng.random((leaves, 1)) ** (1 / 3) / np.linalg.norm(centre, axis=1, keepdims=True)
    centre = centre * [width_m / 2, width_m / 2, height_m * 0.35] + [0, 0, height_m * 0.65]
    along = rng.normal(size=(leaves, 3))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across = np.cross(along, rng.normal(size=(leaves, 3)))
    across *= 0.3 / np.linalg.norm(across, axis=1, keepdims=True)
    tip, side = along * leaf_m / 2, across * leaf_m
    corners = np.stack([centre - tip, centre + side, centre + tip, centre - side], axis=1)
    first = np.arange(leaves)[:, None] * 4
    faces = np.concatenate([first + np.array([0, 1, 2]), first + np.array([0, 2, 3])])
    return Mesh(corners.reshape(-1, 3).astype(np.float32), faces.astype(np.uint32))


def post(height_m: float, radius_m: float) -> Mesh:
    """An eight-sided cone as a trunk."""
    angle = np.arange(8) / 8 * 2 * np.pi
    ring = np.stack([radius_m * np.cos(angle), radius_m * np.sin(angle), np.full(8, -0.2)], axis=1)
    vertices = np.concatenate([ring, [[0, 0, height_m]]]).astype(np.float32)
    faces = np.array([[k, (k + 1) % 8, 8] for k in range(8)], dtype=np.uint32)
    return Mesh(vertices, faces)


def simple_tree(species: str, height_m: float, leaves: int, rng: np.random.Generator) -> Exemplar:
    """A cone trunk in an ellipsoid of leaves."""
    crown = blade_cloud(leaves, height_m, height_m * 0.35, 0.1, rng)
    organs = (
        OrganMesh(Part.TRUNK, "bark", post(height_m * 0.9, height_m * 0.012)),
        OrganMesh(Part.LEAF, "leaf", crown),
    )
    return Exemplar(
        species=species,
        organs=organs,
        radius_m=height_m * 0.1,
        height_m=height_m,
        crown_width_m=height_m * 0.35,
        leaf_area_m2=surface_area_m2(organs[1].mesh),
        wood_volume_m3=np.pi / 3 * (0.012 * height_m) ** 2 * 0.9 * height_m,
    )


def camera_at(
    position_m: tuple[float, float, float],
    target_m: tuple[float, float, float],
    size_px: tuple[int, int],
    hfov_deg: float = 60.0,
) -> Camera:
    return Camera("test", position_m, look_at(position_m, target_m), size_px, hfov_deg)


def scattered_scene(
    instances: int,
    *,
    size_m: float = 100.0,
    exemplars: int = 10,
    leaves: int = 2000,
    size_px: tuple[int, int] = (128, 72),
    clouds: CloudGrid | None = None,
    terrain: Terrain | None = None,
    seed: int = 1,
) -> SceneSpec:
    """`instances` simple trees at random on flat ground, seen from the middle of the south side."""
    rng = np.random.default_rng(seed)
    trees = tuple(simple_tree(f"kind{k % 3}", 4 + 2 * k, leaves, rng) for k in range(exemplars))
    material = {(f"kind{k}", name): value for k in range(3) for name, value in _MATERIALS.items()}
    return SceneSpec(
        exemplars=trees,
        materials=material,
        instances=Instances(
            exemplar=rng.integers(0, exemplars, instances).astype(np.uint32),
            transform=random_transforms(instances, size_m, rng),
            plant_id=(np.arange(instances) + 1).astype(np.uint32),
        ),
        terrain=build_terrain(HeightField((size_m, size_m)), rng) if terrain is None else terrain,
        sky=Sky(40.0, 140.0, 3.0),
        clouds=clouds,
        cameras=(camera_at((size_m / 2, -8.0, 4.0), (size_m / 2, size_m / 2, 5.0), size_px),),
    )


_MATERIALS = {
    "bark": Material((0.15, 0.12, 0.09)),
    "leaf": Material((0.05, 0.10, 0.03), (0.04, 0.09, 0.02)),
}


def window_hits(found: Amodal, row: int) -> NDArray[np.uint16]:
    """(h, w) counts of the window of a row."""
    _, _, width, height = found.window_px[row]
    return found.hits[found.first[row] : found.first[row + 1]].reshape(height, width)


def random_transforms(count: int, size_m: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """(N, 3, 4) turns about z, scales of 0.7 to 1.3, places in the square."""
    angle, scale = rng.random(count) * 2 * np.pi, 0.7 + 0.6 * rng.random(count)
    transform = np.zeros((count, 3, 4))
    transform[:, 0, 0] = transform[:, 1, 1] = np.cos(angle) * scale
    transform[:, 1, 0], transform[:, 0, 1] = np.sin(angle) * scale, -np.sin(angle) * scale
    transform[:, 2, 2] = scale
    transform[:, :2, 3] = rng.random((count, 2)) * size_m
    return transform


def plain_ground(
    low_m: float, high_m: float, cells: int = 1, *, bumps_m: float = 0.0, albedo: float = 0.2, seed: int = 0
) -> Terrain:
    """A square of `cells` x `cells` cells with one colour; heights are multiples of 1/64 m up to `bumps_m`."""
    x, y = np.meshgrid(*[np.linspace(low_m, high_m, cells + 1)] * 2)
    z = np.round(np.random.default_rng(seed).random(x.shape) * bumps_m * 64) / 64
    corner = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    lower = np.stack([corner, corner + 1, corner + cells + 2], axis=1)
    upper = np.stack([corner, corner + cells + 2, corner + cells + 1], axis=1)
    vertices = np.stack([x, y, z], axis=-1).reshape(-1, 3).astype(np.float32)
    mesh = Mesh(vertices, np.concatenate([lower, upper]).astype(np.uint32), uv=vertices[:, :2].copy())
    colour = np.full((2, 2, 3), albedo, dtype=np.float32)
    return Terrain(mesh, colour, far_share=np.zeros(len(vertices), dtype=np.float32))


def dyadic_scene(instances: int, *, quarter_turns: int, size_px: tuple[int, int], seed: int = 3) -> SceneSpec:
    """A scene in which baking an instance into the world rounds nothing: all coordinates are short binary fractions.

    Parameters
    ----------
    quarter_turns : instances turn about z by random multiples of this many right angles.
    """
    spec = scattered_scene(
        instances,
        size_m=64.0,
        exemplars=5,
        leaves=300,
        size_px=size_px,
        terrain=plain_ground(-64, 128, 24, bumps_m=0.5),
        seed=seed,
    )
    rng = np.random.default_rng(seed)
    turn = rng.integers(0, 4, instances) // quarter_turns * quarter_turns
    scale = 2.0 ** rng.integers(-1, 2, instances)
    transform = np.zeros((instances, 3, 4))
    cos, sin = np.array([1, 0, -1, 0])[turn] * scale, np.array([0, 1, 0, -1])[turn] * scale
    transform[:, 0, 0], transform[:, 0, 1], transform[:, 1, 0], transform[:, 1, 1] = cos, -sin, sin, cos
    transform[:, 2, 2] = scale
    transform[:, :2, 3] = rng.integers(0, 256, (instances, 2)) / 4
    return replace(
        spec,
        exemplars=tuple(_quantised(exemplar) for exemplar in spec.exemplars),
        instances=replace(spec.instances, transform=transform),
        cameras=(camera_at((32.0, -8.0, 4.0), (32.0, 32.0, 5.0), size_px),),
    )


def _quantised(exemplar: Exemplar) -> Exemplar:
    """Vertices on a grid of 1/256 m."""
    organs = []
    for organ in exemplar.organs:
        vertices = (np.round(organ.mesh.vertices_m.astype(np.float64) * 256) / 256).astype(np.float32)
        organs.append(replace(organ, mesh=Mesh(vertices, organ.mesh.faces)))
    return replace(exemplar, organs=tuple(organs))


def shifted(spec: SceneSpec, by_m: tuple[float, float, float]) -> SceneSpec:
    """The same scene and cameras at another place."""
    offset = np.asarray(by_m, dtype=np.float64)
    transform = spec.instances.transform.copy()
    transform[:, :, 3] += offset
    ground = replace(spec.terrain.mesh, vertices_m=(spec.terrain.mesh.vertices_m + offset).astype(np.float32))
    cameras = []
    for camera in spec.cameras:
        x, y, z = (float(v) for v in np.asarray(camera.position_m) + offset)
        cameras.append(replace(camera, position_m=(x, y, z)))
    return replace(
        spec,
        instances=replace(spec.instances, transform=transform),
        terrain=replace(spec.terrain, mesh=ground),
        cameras=tuple(cameras),
    )
