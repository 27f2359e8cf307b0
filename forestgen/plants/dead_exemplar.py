"""One exemplar of a dead tree: the living tree of its species, what death leaves of it (`dead_tree`), and its surface.

Bark falls off the stem in patches, more with every decay class; below it is wood, grey of what stands in the sun and
brown of what lies. Branches lose theirs first. Moss grows on what lies, on its upper side, and the covers of the
species' `wood` on its bark. Noise along and around the stem says where, the same for all classes. Surfaces are uneven,
more with every class.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from forestgen.core.dead_wood import DeadForm, DeadTree
from forestgen.core.parts import Part
from forestgen.geometry.mesh import Floats, Mesh, part_of, triangle_areas, unit, vertex_normals
from forestgen.plants.build import box_of, check_materials, grown_tree
from forestgen.plants.dead_tree import DeadSkeleton, dead_skeleton
from forestgen.plants.exemplar import Exemplar, OrganMesh
from forestgen.plants.grown import ModuleWood
from forestgen.plants.levels import simplified
from forestgen.plants.meshing import organ_meshes
from forestgen.plants.parameters import PlantParameters
from forestgen.plants.skeleton import Skeleton
from forestgen.plants.stem_surface import EDGE_M, split, surfaced
from forestgen.plants.tree_fit import fit_tree
from forestgen.plants.tree_size import TreeSize
from forestgen.recipe.species import Material, Species

WEATHERED, FALLEN, MOSS = "dead_wood", "dead_wood_fallen", "dead_wood_moss"
END_GRAIN, SOIL = "dead_wood_end_grain", "dead_wood_soil"
_MATERIALS: Mapping[str, dict[str, Any]] = {
    WEATHERED: {
        "spectrum": "wood/snag",
        "roughness": 0.9,
        "bark": {"pattern": "fibrous", "tile_m": [0.3, 0.6], "dark": [0.05, 0.045, 0.04], "lichen": 0.06},
    },
    FALLEN: {
        "spectrum": "wood/fallen",
        "roughness": 0.9,
        "bark": {"pattern": "fibrous", "tile_m": [0.3, 0.6], "dark": [0.03, 0.025, 0.02], "marks": 0.09},
    },
    MOSS: {
        "spectrum": "wood/moss",
        "roughness": 0.9,
        "bark": {"pattern": "scaly", "tile_m": [0.2, 0.2], "scale_m": 0.01, "depth_m": 0.006},
    },
    END_GRAIN: {
        "spectrum": "wood/end_grain",
        "bark": {"pattern": "end_grain", "tile_m": [0.4, 0.4], "dark": [0.10, 0.06, 0.03]},
    },
    SOIL: {
        "spectrum": "bark/log",  # browner than the tables of soil, which are of a dry and a wet pale one
        "roughness": 0.95,
        "bark": {
            "pattern": "scaly",
            "tile_m": [0.5, 0.5],
            "scale_m": 0.012,
            "depth_m": 0.012,
            "dark": [0.03, 0.022, 0.016],
        },
    },
}
# By decay class: share of the stem's surface without bark; of the upper half of what lies, or of a stump, under moss.
_BARE = (0.0, 0.15, 0.5, 0.85, 1.0)
_MOSSY = (0.0, 0.03, 0.25, 0.5, 0.6)
_GREY_BRANCHES = 2  # the class from which branches have no bark; below it they have that of dead branches
_ROTTEN = 4  # the class from which a sawn face is as grey as the rest
_TWIGS = 0.7  # of the tree's leaf area, by which twigs are counted: the finest are gone
_UPPER = 0.1  # least z of a normal of the upper side
_UNEVEN = (0.02, 0.03, 0.06, 0.09, 0.12)  # by decay class, of the radius: standard deviation of the surface, about
_BARK = 0.06, 0.012  # how much lower bare wood is than bark: of the radius, at most metres
_FLAT_M = 1e-3  # of a sawn face
_PLATE_SIDES, _PLATE_RINGS, _PLATE_DEEP, _PLATE_UNEVEN, _PLATE_SOIL = 48, 9, 0.14, 0.3, 0.85


def with_dead_wood(species: Species) -> Species:
    """The species with the materials of its dead trees; a species' own `dead_wood` stays."""
    own = {key: Material.model_validate(one) for key, one in _MATERIALS.items() if key not in species.materials}
    return species.model_copy(update={"materials": {**species.materials, **own}}) if own else species


def bare_parameters(plant: PlantParameters, dead: DeadTree | None = None) -> PlantParameters:
    """The plant's parameters for dead wood: of a dead tree's class; None: all of it grey."""
    bare = WEATHERED if dead is None else _bare_wood(dead)
    has_bark = dead is not None and _BARE[dead.decay - 1] < 1.0
    grey = dead is None or dead.decay >= _GREY_BRANCHES
    changed: dict[str, Any] = {"dead": True}
    if not has_bark:
        changed["material"] = bare
    if grey:
        changed |= {"branch_material": bare if has_bark else None, "thick_branch_m": None}
    years = plant.wood.years
    if not grey and years is not None and years.dead_branches is not None:
        changed |= {"branch_material": years.dead_branches.material, "thick_branch_m": None}
    if dead is not None and dead.form == DeadForm.STUMP and years is not None:
        changed["years"] = years.model_copy(update={"roots": None})  # some are higher than it
    return plant.model_copy(update={"wood": plant.wood.model_copy(update=changed)})


def build_dead(
    species_name: str,
    species: Species,
    plant: Any,
    dead: DeadTree,
    tree: TreeSize,
    rng: np.random.Generator,
    *,
    radius_m: float,
    pixel_m: float = 0.0,
    wood: ModuleWood | None = None,
) -> Exemplar:
    """One dead tree: grown, less what decay has taken, meshed.

    `species`: with the materials of dead wood. `plant`: parameters of its generator, see `bare_parameters`. `tree`:
    sizes of the whole tree when it lived. Others as for `build.build_exemplar`.
    """
    grown, level_rng = grown_tree(species_name, plant, tree, rng, wood)
    fit_rng, dead_rng, patch_rng, uneven_rng = rng.spawn(4)
    leafless = replace(tree, leaf_area_m2=_TWIGS * tree.leaf_area_m2)
    living = fit_tree(grown, plant, plant.templates(), leafless, fit_rng).skeleton
    left = dead_skeleton(living, dead, tree.height_m, tree.dbh_m, dead_rng)
    seen = simplified(left.skeleton, {}, pixel_m, level_rng)
    organs = organ_meshes(seen, plant.shapes, plant.wood, pixel_m=pixel_m)
    organs = _uneven(organs, left.skeleton, dead, uneven_rng)
    organs = _sawn(_patched(organs, plant, left.skeleton, dead, pixel_m, patch_rng), left, dead)
    if left.plate_m > 0.0:
        foot_m = float(left.skeleton.position_m[0, 2])
        organs = (*organs, OrganMesh(Part.DEAD_WOOD, SOIL, _root_plate(left.plate_m, foot_m, patch_rng)))
    check_materials(species_name, organs, species.materials)
    low, high = box_of(organs, species_name)
    return Exemplar(
        species=species_name,
        organs=organs,
        radius_m=radius_m,
        height_m=float(high[2]),
        crown_width_m=float(np.mean((high - low)[:2])),
        leaf_area_m2=0.0,
        wood_volume_m3=left.skeleton.volume_m3(),
        lying_m3=left.lying_m3,
    )


def _bare_wood(dead: DeadTree) -> str:
    return FALLEN if dead.lies or dead.form == DeadForm.STUMP else WEATHERED


class _Waves(NamedTuple):
    """Smooth noise: waves of 0.3 to 3 m."""

    way: Floats  # (W, 3) radians a metre
    phase: Floats  # (W,)

    @classmethod
    def of(cls, rng: np.random.Generator) -> _Waves:
        length_m = np.repeat([3.0, 1.4, 0.7, 0.3], 3)[:, None]
        return cls(2.0 * np.pi / length_m * rng.normal(size=(12, 3)), rng.uniform(0.0, 2.0 * np.pi, 12))

    def at(self, mesh: Mesh) -> Floats:
        """(V,) at a mesh's vertices, about -1 to 1."""
        return np.asarray(np.sin(mesh.vertices_m.astype(np.float64) @ self.way.T + self.phase).sum(axis=1) / 3.0)

    def slope(self, mesh: Mesh) -> Floats:
        """(V, 3) a metre."""
        return np.asarray(np.cos(mesh.vertices_m.astype(np.float64) @ self.way.T + self.phase) @ self.way / 3.0)


@dataclass(frozen=True)
class _Patches:
    """Above 0 where bark is gone or, on the upper side, moss grows."""

    waves: _Waves
    is_moss: bool
    level: float = 0.0
    near: float = 0.3  # see `stem_surface.Field`

    def score(self, mesh: Mesh) -> Floats:
        """(V,) how soon a place is part of a patch."""
        return 0.6 * self.waves.at(mesh) + _up(mesh) if self.is_moss else -self.waves.at(mesh)

    def at(self, mesh: Mesh) -> Floats:
        value = self.level + self.score(mesh)
        return np.minimum(value, _up(mesh) - _UPPER) if self.is_moss else value


def _up(mesh: Mesh) -> Floats:
    assert mesh.normals is not None  # wood has
    return mesh.normals[:, 2].astype(np.float64)


def _uneven(
    organs: tuple[OrganMesh, ...], skeleton: Skeleton, dead: DeadTree, rng: np.random.Generator
) -> tuple[OrganMesh, ...]:
    """The wood with lumps and hollows; a stump keeps the shape that its sawn face has."""
    if dead.form == DeadForm.STUMP:
        return organs
    waves, made = _Waves.of(rng), []
    for organ in organs:
        mesh = organ.mesh
        assert mesh.normals is not None  # wood has
        size = _UNEVEN[dead.decay - 1] * _radius_at(skeleton, mesh)[:, None]
        normal = mesh.normals.astype(np.float64)
        moved = mesh.vertices_m + size * waves.at(mesh)[:, None] * normal
        slope = size * waves.slope(mesh)
        leant = unit(normal - slope + np.sum(slope * normal, axis=1, keepdims=True) * normal)
        new = replace(mesh, vertices_m=moved.astype(np.float32), normals=leant.astype(np.float32))
        made.append(replace(organ, mesh=new))
    return tuple(made)


def _radius_at(skeleton: Skeleton, mesh: Mesh) -> Floats:
    """(V,) radius of the wood at the nearest node of each vertex."""
    from scipy.spatial import cKDTree  # slow to import

    nearest = cKDTree(skeleton.position_m).query(mesh.vertices_m)[1]
    return skeleton.radius_m[nearest].astype(np.float64)


def _patched(
    organs: tuple[OrganMesh, ...],
    plant: PlantParameters,
    skeleton: Skeleton,
    dead: DeadTree,
    pixel_m: float,
    rng: np.random.Generator,
) -> tuple[OrganMesh, ...]:
    """The surfaces with moss, and the stem's with patches of bare wood, and covers on its bark."""
    bare_waves, moss_waves = (_Waves.of(one) for one in rng.spawn(2))
    bare, moss = _BARE[dead.decay - 1], _MOSSY[dead.decay - 1]
    mossy = dead.lies or dead.form == DeadForm.STUMP
    edge_m = max(EDGE_M, 0.5 * pixel_m)
    made: list[OrganMesh] = []
    for organ in organs:
        pieces = [organ]
        if mossy and moss > 0.0:
            pieces = _grown(organ, _Patches(moss_waves, True), moss, edge_m, MOSS)
        for piece in pieces:
            if piece.material != plant.wood.material or piece.material == _bare_wood(dead):
                made.append(piece)
                continue
            for part in _grown(piece, _Patches(bare_waves, False), bare, edge_m, _bare_wood(dead)):
                if part.material == plant.wood.material:
                    made += _covered(part, plant, skeleton, pixel_m)
                else:
                    made.append(_sunken(part, skeleton))
    return tuple(made)


def _grown(organ: OrganMesh, patches: _Patches, share: float, edge_m: float, material: str) -> list[OrganMesh]:
    """The surface, and as another one its patches, of a share of the area; of moss, a share of the upper side."""
    mesh = organ.mesh
    if share <= 0.0 or not mesh.triangles:
        return [organ]
    area, score = triangle_areas(mesh.vertices_m, mesh.faces), patches.score(mesh)[mesh.faces].mean(axis=1)
    if patches.is_moss:
        area = np.where(_up(mesh)[mesh.faces].mean(axis=1) > _UPPER, area, 0.0)
    order = np.argsort(-score, kind="stable")
    last = int(np.searchsorted(np.cumsum(area[order]), share * area.sum()))
    level = -float(score[order[min(last, len(order) - 1)]])
    return split(organ, replace(patches, level=level), edge_m, material)


def _covered(bark: OrganMesh, plant: PlantParameters, skeleton: Skeleton, pixel_m: float) -> list[OrganMesh]:
    """Bark with what grows on it."""
    years = plant.wood.years
    if years is None:
        return [bark]
    alone = years.model_copy(update={"bark_zones": ()})
    return surfaced(bark, alone, float(skeleton.radius_m[0]), pixel_m, plant.wood.bark_tile_m)


def _sunken(wood: OrganMesh, skeleton: Skeleton) -> OrganMesh:
    """Bare wood, lower than the bark around."""
    mesh = wood.mesh
    assert mesh.normals is not None  # wood has
    deep = np.minimum(_BARK[0] * _radius_at(skeleton, mesh), _BARK[1])
    lowered = mesh.vertices_m - deep[:, None] * mesh.normals
    return replace(wood, mesh=replace(mesh, vertices_m=lowered.astype(np.float32)))


def _sawn(organs: tuple[OrganMesh, ...], left: DeadSkeleton, dead: DeadTree) -> tuple[OrganMesh, ...]:
    """A stump's surfaces with its sawn face as one of its own."""
    if left.sawn is None:
        return organs
    (x, y, top_m), material = left.sawn[0], FALLEN if dead.decay >= _ROTTEN else END_GRAIN
    made = []
    for organ in organs:
        mesh = organ.mesh
        on_top = np.all(mesh.vertices_m[mesh.faces][:, :, 2] > top_m - _FLAT_M, axis=1)
        made += [replace(organ, mesh=part_of(mesh, mesh.faces[~on_top]))] if not on_top.all() else []
        if on_top.any():
            face = part_of(mesh, mesh.faces[on_top])
            flat = face.vertices_m[:, :2] - np.array([x, y], dtype=np.float32)
            uv = 0.5 + 0.5 * flat / max(float(np.linalg.norm(flat, axis=1).max()), 1e-6)
            made.append(OrganMesh(Part.DEAD_WOOD, material, replace(face, uv=uv.astype(np.float32))))
    return tuple(made)


def _root_plate(radius_m: float, middle_m: float, rng: np.random.Generator) -> Mesh:
    """Uneven soil that stands on its edge, its middle at a height, bulging away from the tree."""
    turn = np.arange(_PLATE_SIDES) * (2.0 * np.pi / _PLATE_SIDES)
    waves = ((k, rng.normal(), rng.uniform(0.0, 2.0 * np.pi)) for k in (1, 2, 3, 4, 6, 9, 14, 21))
    rim = 1.0 + sum(_PLATE_UNEVEN / k**0.8 * size * np.cos(k * turn + phase) for k, size, phase in waves)
    share = (np.arange(_PLATE_RINGS) + 1.0) / _PLATE_RINGS
    out = _PLATE_SOIL * radius_m * share[:, None] * np.clip(rim, 0.35, 1.4)
    out *= 1.0 + 0.25 / _PLATE_RINGS * rng.normal(size=out.shape)
    rough = 1.0 + 0.6 * rng.normal(size=(2, _PLATE_RINGS, _PLATE_SIDES))
    deep = _PLATE_DEEP * radius_m * (0.25 + 0.75 * np.sqrt(1.0 - share**2))[:, None] * np.clip(rough, 0.2, 1.8)
    x, z = out * np.cos(turn), middle_m + out * np.sin(turn)
    shell = [np.stack([x, y, z], axis=2) for y in (-deep[0], 0.25 * deep[1])]
    ends = np.array([[0.0, -_PLATE_DEEP * radius_m, middle_m], [0.0, 0.25 * _PLATE_DEEP * radius_m, middle_m]])
    points = np.concatenate([*(one.reshape(-1, 3) for one in shell), ends])
    k, nxt, ring = np.arange(_PLATE_SIDES), (np.arange(_PLATE_SIDES) + 1) % _PLATE_SIDES, _PLATE_SIDES
    count, faces = _PLATE_RINGS * ring, []
    for side in (0, 1):
        base = side * count
        strips = [np.column_stack([np.full(ring, 2 * count + side), base + k, base + nxt])]
        for row in range(_PLATE_RINGS - 1):
            low, high = base + row * ring, base + (row + 1) * ring
            strips += [
                np.column_stack([low + k, high + k, high + nxt]),
                np.column_stack([low + k, high + nxt, low + nxt]),
            ]
        faces += [one if side == 0 else one[:, ::-1] for one in strips]
    outer = count - ring
    faces += [np.column_stack([outer + nxt, outer + k, count + outer + k]),
              np.column_stack([outer + nxt, count + outer + k, count + outer + nxt])]  # fmt: skip
    triangles = np.concatenate(faces)
    normals = vertex_normals(points, triangles)
    uv = points[:, [0, 2]].astype(np.float32)
    return Mesh(points.astype(np.float32), triangles.astype(np.uint32), normals.astype(np.float32), uv)
