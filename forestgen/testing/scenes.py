"""Small scenes for tests and benchmarks that need geometry but no plant generator."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from forestgen.core.frames import look_at
from forestgen.core.parts import Part
from forestgen.geometry.mesh import Mesh
from forestgen.plants.exemplar import Exemplar, OrganMesh
from forestgen.atmosphere.grid import CloudGrid
from forestgen.scene.spec import Camera, Instances, Material, SceneSpec, Sky
from forestgen.scene.terrain import build_terrain, flat


def blade_cloud(leaves: int, height_m: float, width_m: float, leaf_m: float, rng: np.random.Generator) -> Mesh:
    """Randomly turned rhombic leaves that fill an ellipsoid crown."""
    centre = rng.normal(size=(leaves, 3))
    centre *= rng.random((leaves, 1)) ** (1 / 3) / np.linalg.norm(centre, axis=1, keepdims=True)
    centre = centre * [width_m / 2, width_m / 2, height_m * 0.35] + [0, 0, height_m * 0.65]
    along = rng.normal(size=(leaves, 3))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across = np.cross(along, rng.normal(size=(leaves, 3)))
    across *= 0.3 / np.linalg.norm(across, axis=1, keepdims=True)
    corners = np.stack([centre - along * leaf_m / 2, centre + across * leaf_m, centre + along * leaf_m / 2, centre - across * leaf_m], axis=1)  # fmt: skip
    first = np.arange(leaves)[:, None] * 4
    faces = np.concatenate([first + [0, 1, 2], first + [0, 2, 3]])
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
    organs = (OrganMesh(Part.TRUNK, "bark", post(height_m * 0.9, height_m * 0.012)), OrganMesh(Part.LEAF, "leaf", crown))
    return Exemplar(species, organs, height_m * 0.1, height_m, height_m * 0.35)


def camera_at(
    position_m: tuple[float, float, float], target_m: tuple[float, float, float], size_px: tuple[int, int], hfov_deg: float = 60.0
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
        terrain=build_terrain(flat(), (size_m, size_m), rng),
        sky=Sky(40.0, 140.0, 3.0),
        clouds=clouds,
        cameras=(camera_at((size_m / 2, -8.0, 4.0), (size_m / 2, size_m / 2, 5.0), size_px),),
    )


_MATERIALS = {
    "bark": Material((0.15, 0.12, 0.09)),
    "leaf": Material((0.05, 0.10, 0.03), (0.04, 0.09, 0.02)),
}


def random_transforms(count: int, size_m: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """(N, 3, 4) turns about z, scales of 0.7 to 1.3, places in the square."""
    angle, scale = rng.random(count) * 2 * np.pi, 0.7 + 0.6 * rng.random(count)
    transform = np.zeros((count, 3, 4))
    transform[:, 0, 0] = transform[:, 1, 1] = np.cos(angle) * scale
    transform[:, 1, 0], transform[:, 0, 1] = np.sin(angle) * scale, -np.sin(angle) * scale
    transform[:, 2, 2] = scale
    transform[:, :2, 3] = rng.random((count, 2)) * size_m
    return transform
