"""Surfaces of water and other grounds of a shaped ground as the renderer takes them.

The numbers of wet rims are ours.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.core.randomness import child_rng
from forestgen.geometry.mesh import Floats, Mesh, part_of, vertex_normals
from forestgen.plants.bark.texture import with_mean
from forestgen.plants.exemplar import Exemplar, OrganMesh
from forestgen.recipe.registries import GROUND_COVERS, GROUND_OF
from forestgen.scene.colour import colours_of_surface
from forestgen.scene.ground_layers.layer import GROUND
from forestgen.scene.shaped_ground import ShapedGround, ragged
from forestgen.scene.spec import GroundPatch, Instances, Material, SceneSpec, Terrain
from forestgen.scene.terrain import HeightField, smooth_step
from forestgen.scene.water import WAVES_M, water_material, wave_height_m

# Heights above the water: up to where the bed's ground is bare and wet, how soft its end is, and how far it strays.
_RIM_M, _SOFT_M, _STRAYS_M = 0.16, 0.1, 0.03
_RUN_UP = 1.5  # of waves, over their height


def with_land(terrain: Terrain, ground: HeightField, wind_m_per_s: float, seed: int) -> Terrain:
    """The terrain with the grounds of paths, and those of beds up to a rim around water."""
    if not isinstance(ground, ShapedGround):
        return terrain
    x, y, z = terrain.mesh.vertices_m.astype(np.float64).T
    shares: dict[tuple[str, str], Floats] = {}  # by purpose and ground: beds lie on paths
    for track in ground.tracks:
        key = ("path", track.keys.surface)
        shares[key] = np.maximum(shares.get(key, 0.0), track.shares(x, y)[0])
    green = ground.bare_and_green(x, y)[1]
    if green.any():
        shares["strip", GROUND_OF["strip"]] = green
    for body in ground.bodies:
        near = body.near(x, y)
        above = z[near.rows] - near.level_m + _STRAYS_M * ragged(x[near.rows], y[near.rows])
        top = _RIM_M + _RUN_UP * wave_height_m(body.keys, wind_m_per_s)
        share, key = np.zeros(len(x)), ("bed", body.keys.ground)
        share[near.rows] = smooth_step((top - above) / _SOFT_M + 0.5)
        shares[key] = np.maximum(shares.get(key, 0.0), share)
    return replace(terrain, patches=tuple(_patch(name, share, seed) for (_, name), share in shares.items()))


def _patch(name: str, share: Floats, seed: int) -> GroundPatch:
    cover = GROUND_COVERS.load(name)
    spectrum = cover.reflectance()
    colour, _ = colours_of_surface(spectrum, None)
    texture = with_mean(cover.pattern(child_rng(seed, "terrain", "patch", name)), colour)
    return GroundPatch(share.astype(np.float32), texture, colour, spectrum)


def with_water(spec: SceneSpec, ground: HeightField, wind_m_per_s: float, seed: int) -> SceneSpec:
    """The scene with the surfaces of its ponds and streams, which have no plant_id."""
    if not isinstance(ground, ShapedGround) or not ground.bodies:
        return spec
    organs: list[OrganMesh] = []
    materials: dict[tuple[str, str], Material] = {}
    for index, mesh in _surfaces(ground, spec.terrain.mesh).items():
        name = f"water-{index}"
        organs.append(OrganMesh(Part.WATER, name, mesh))
        rng = child_rng(seed, "water", index)
        materials[GROUND, name] = water_material(ground.bodies[index].keys, wind_m_per_s, rng)
    if not organs:
        return spec
    low, high = (np.array([pick(one.mesh.vertices_m, axis=0) for one in organs]) for pick in (np.min, np.max))
    wide = float(np.max(high.max(axis=0) - low.min(axis=0)))
    surface = Exemplar(GROUND, tuple(organs), 0.5 * wide, float(high[:, 2].max()), wide, 0.0, 0.0)
    old = spec.instances
    return replace(
        spec,
        exemplars=(*spec.exemplars, surface),
        materials={**spec.materials, **materials},
        instances=Instances(
            exemplar=np.append(old.exemplar, np.uint32(len(spec.exemplars))),
            transform=np.concatenate([old.transform, np.eye(3, 4)[None]]),
            plant_id=np.append(old.plant_id, np.uint32(0)),
            outside=old.outside + 1,
        ),
    )


def _surfaces(ground: ShapedGround, terrain: Mesh) -> Mapping[int, Mesh]:
    """By body: the triangles of the terrain's mesh that have a corner under water, at the height of the level."""
    x, y, z = terrain.vertices_m.astype(np.float64).T
    count = len(ground.bodies)
    levels = np.full((count, len(x)), np.nan)
    shore = np.full((count, len(x)), np.inf)
    for index, body in enumerate(ground.bodies):
        near = body.near(x, y)
        levels[index, near.rows], shore[index, near.rows] = near.level_m, near.shore_m
    level = ground.level(x, y)
    owner = np.where(level > z, np.argmin(shore, axis=0), -1)
    of_face = owner[terrain.faces].max(axis=1)
    found = {}
    for index in range(count):
        faces = terrain.faces[(of_face == index) & np.isfinite(levels[index])[terrain.faces].all(axis=1)]
        if len(faces):
            found[index] = _level_mesh(terrain, faces, levels[index])
    return found


def _level_mesh(terrain: Mesh, faces: NDArray[np.uint32], level_m: Floats) -> Mesh:
    vertices = terrain.vertices_m.astype(np.float64)
    vertices[:, 2] = np.nan_to_num(level_m)
    mesh = part_of(Mesh(vertices.astype(np.float32), terrain.faces), faces)
    normals = vertex_normals(mesh.vertices_m.astype(np.float64), mesh.faces)
    uv = mesh.vertices_m[:, :2] / np.float32(WAVES_M)
    return replace(mesh, normals=normals.astype(np.float32), uv=uv.astype(np.float32))
