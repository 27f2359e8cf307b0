"""Which plants of a scene have leaves of true size: those near its cameras, each with a mesh of its own.

What decides is what a pixel covers at each organ that is in a camera's view: the image's size, its lens and the
distance, and nothing that the image shows. Organs out of view stay as they are. The near plants' meshes together have
about `triangles.most_near_triangles` at most. The nearest plants come first; one that has not enough room gets larger
leaves, or keeps the shared mesh.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from forestgen.core.parts import Part
from forestgen.geometry.mesh import Bools, Floats
from forestgen.plants.exemplar import Exemplar
from forestgen.plants.near_foliage import (
    VEINED,
    NearOrgans,
    largest_pixel_m,
    material_of_kind,
    near_organs,
    organ_sizes,
    with_near_foliage,
)
from forestgen.plants.organs.base import OrganForm
from forestgen.plants.organs.leaf_texture import LeafLooks, leaf_texture
from forestgen.plants.organs.sprays import LeafKind
from forestgen.plants.skeleton import OrganPlacements
from forestgen.recipe.phenology import TimeOfYear
from forestgen.scene.exemplar_plan import ExemplarPlan
from forestgen.scene.growth import pixel_size_m
from forestgen.scene.leaf_variation import single_leaves
from forestgen.scene.motion import with_their_ways
from forestgen.scene.plan import Plan
from forestgen.scene.projection import project, projection_of
from forestgen.scene.spec import Camera, Material, SceneSpec
from forestgen.scene.triangles import most_near_triangles

_LEAST_M = 0.02  # distance of a leaf that touches the camera
_MARGIN = 1.5  # of what is in view, in half lengths of the organ
_COARSER = (1.0, 1.5, 2.0, 3.0)  # times larger pixels, for a plant that has not enough room
_ROOM = 1.3  # around a plant, for leaves beyond its mean width


@dataclass(frozen=True)
class Leaves:
    """The forms of a species' organs."""

    shapes: Mapping[str, OrganForm]
    true_m: float | None  # length of a leaf or needle; None: as the forms say
    is_evergreen: bool  # leaves of years before are among them


def leaves_of(plan: Plan, chosen: ExemplarPlan, exemplars: Sequence[Exemplar]) -> tuple[Leaves | None, ...]:
    """The forms of the organs of each exemplar of a plan; None of a building, or where they are drawn as ever."""
    if not plan.drawn.recipe.plants.near_foliage:
        return (None,) * len(exemplars)
    found: list[Leaves | None] = []
    for exemplar, row in zip(exemplars, chosen.plant.tolist(), strict=True):
        parameters = (plan.plants.foliage if row >= 0 else plan.plants.generators).get(exemplar.species)
        known = plan.drawn.species.get(exemplar.species)
        if parameters is None or known is None:
            found.append(None)
            continue
        evergreen = known.phenology is None or known.phenology.habit == "evergreen"
        found.append(Leaves(parameters.shapes, known.tissue.leaf_length_m, evergreen))
    return tuple(found)


@dataclass(frozen=True)
class _NearPlant:
    """A plant that has organs in view."""

    row: int  # of the instances
    exemplar: int
    size: tuple[Floats, ...]  # of its organs, by shape
    pixel_m: tuple[Floats, ...]  # what a pixel covers of each, in the exemplar's own metres
    scale: float  # of these in the world

    def organs(self, spec: SceneSpec, leaves: Leaves, coarser: float) -> tuple[NearOrgans | None, ...]:
        """How its organs are drawn where pixels are so many times as coarse."""
        return tuple(
            near_organs(leaves.shapes[one.shape], leaves.true_m, size, coarser * pixel_m)
            for one, size, pixel_m in zip(spec.exemplars[self.exemplar].foliage, self.size, self.pixel_m, strict=True)
        )

    @property
    def order(self) -> tuple[float, int]:
        """Plants that are nearer to a camera come first."""
        return self.scale * min(float(one.min(initial=np.inf)) for one in self.pixel_m), self.row

    def organs_within(self, spec: SceneSpec, leaves: Leaves, room: int) -> tuple[NearOrgans | None, ...]:
        """How its organs are drawn within so many triangles; none if that is no more than its shared mesh has."""
        for coarser in _COARSER:
            organs = self.organs(spec, leaves, coarser)
            if self.triangles(spec, organs) <= room:
                return organs if any(one is not None and one.drawn.any() for one in organs) else ()
        return ()

    def triangles(self, spec: SceneSpec, organs: Sequence[NearOrgans | None]) -> int:
        """Of its own mesh, rather more than fewer; 0: it has none."""
        more = sum(one.triangles for one in organs if one is not None)
        return more + spec.exemplars[self.exemplar].triangles if more else 0


def with_near_plants(spec: SceneSpec, leaves: Sequence[Leaves | None], time: TimeOfYear) -> SceneSpec:
    """The scene with leaves of true size near its cameras.

    `leaves`: the forms of the organs of its first exemplars, the plants; None of what has none. Exemplars with leaves
    of true size follow these.
    """
    materials, of_exemplar = dict(spec.materials), dict[int, dict[str, list[LeafKind]]]()
    plants, room = len(leaves), most_near_triangles(spec.cameras)
    which = spec.instances.exemplar.copy()
    made: list[Exemplar] = []
    for plant, own in sorted(_near_plants(spec, leaves), key=lambda one: one[0].order):
        organs = plant.organs_within(spec, own, room)
        if organs:
            room -= plant.triangles(spec, organs)
            which[plant.row] = plants + len(made)
            exemplar = spec.exemplars[plant.exemplar]
            if plant.exemplar not in of_exemplar:
                of_exemplar[plant.exemplar] = _leaf_kinds(exemplar, materials, time, own.is_evergreen)
            kinds = of_exemplar[plant.exemplar]
            seed = int(spec.instances.plant_id[plant.row])
            made.append(with_near_foliage(exemplar, own.shapes, own.true_m, organs, kinds, seed))
            _add_veins(made[-1], own.shapes, materials)
    which[spec.instances.exemplar >= plants] += np.uint32(len(made))
    exemplars = (*spec.exemplars[:plants], *made, *spec.exemplars[plants:])
    return replace(spec, exemplars=exemplars, materials=materials, instances=replace(spec.instances, exemplar=which))


def _add_veins(exemplar: Exemplar, shapes: Mapping[str, OrganForm], materials: dict[tuple[str, str], Material]) -> None:
    """Add the materials of its leaves with uv."""
    for organ in exemplar.organs:
        key = exemplar.species, organ.material
        if not organ.material.endswith(VEINED) or key in materials:
            continue
        plain = materials[exemplar.species, organ.material.removesuffix(VEINED)]
        leaves = [one for one in shapes.values() if one.part == "leaf"]
        form = max(leaves, key=lambda one: float(getattr(one, "length_m", 0.0)))
        texture = leaf_texture(form, plain.reflectance, LeafLooks(), f"{exemplar.species}/live")
        materials[key] = replace(plain, texture=texture)


def _leaf_kinds(
    exemplar: Exemplar, materials: dict[tuple[str, str], Material], time: TimeOfYear, is_evergreen: bool
) -> dict[str, list[LeafKind]]:
    """Kinds of leaves by the exemplar's materials, to which those of the kinds are added."""
    found = {}
    for organ in exemplar.organs:
        if organ.part == Part.LEAF:
            kinds = single_leaves(materials[exemplar.species, organ.material], time, is_evergreen)
            found[organ.material] = [kind for kind, _ in kinds]
            for kind, material in kinds:
                materials[exemplar.species, material_of_kind(organ.material, kind)] = material
    return found


def _near_plants(spec: SceneSpec, leaves: Sequence[Leaves | None]) -> list[tuple[_NearPlant, Leaves]]:
    """Plants that have organs in view and near enough."""
    near, found = _near_rows(spec, leaves), []
    for row in np.flatnonzero(near.any(axis=1)).tolist():
        index, transform = int(spec.instances.exemplar[row]), spec.instances.transform[row]
        foliage, own = spec.exemplars[index].foliage, leaves[index]
        assert own is not None
        scale = float(np.cbrt(np.abs(np.linalg.det(transform[:, :3]))))
        cameras = [camera for camera, one in zip(spec.cameras, near[row], strict=True) if one]
        pixel_m = tuple(_pixels_m(cameras, transform, one, own.shapes[one.shape]) / scale for one in foliage)
        if any(np.isfinite(one).any() for one in pixel_m):
            sizes = tuple(organ_sizes(one.frame) for one in foliage)
            found.append((_NearPlant(row, index, sizes, pixel_m, scale), own))
    return found


def _near_rows(spec: SceneSpec, leaves: Sequence[Leaves | None]) -> Bools:
    """(N, C) which instances are so near to each camera that some of their organs may be drawn in another way."""
    limit = np.zeros(len(spec.exemplars))  # of what a pixel covers, metres of the exemplar
    for index, own in enumerate(leaves):
        if own is not None and spec.exemplars[index].foliage:
            limit[index] = largest_pixel_m(own.shapes, spec.exemplars[index].foliage)
    instances = spec.instances
    scale = np.cbrt(np.abs(np.linalg.det(instances.transform[:, :, :3])))
    sizes = np.array([[one.crown_width_m, one.height_m] for one in spec.exemplars]).reshape(-1, 2)
    width, height = (sizes[instances.exemplar] * scale[:, None] * _ROOM).T
    rows = np.flatnonzero(limit[instances.exemplar] > 0.0)
    near = np.zeros((len(instances), len(spec.cameras)), dtype=np.bool_)
    for number, camera in enumerate(spec.cameras):
        pixel_m = pixel_size_m([camera], instances.transform[rows, :, 3], height[rows], width[rows])
        near[rows, number] = pixel_m < (limit[instances.exemplar] * scale)[rows]
    return near


def _pixels_m(cameras: Sequence[Camera], transform: Floats, placed: OrganPlacements, form: OrganForm) -> Floats:
    """(M,) what a pixel covers at each organ in the camera that sees it best, world; inf where none sees it."""
    linear, frame = transform[:, :3], placed.frame.astype(np.float64)
    corners = form.template().vertices_m
    middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0)).astype(np.float64)
    reach = 0.5 * float(np.ptp(corners, axis=0).max()) * np.linalg.norm(frame[:, :, 1] @ linear.T, axis=1)
    place = (frame[:, :, :3] @ middle + frame[:, :, 3]) @ linear.T + transform[:, 3]
    finest = np.full(len(place), np.inf)
    for camera in with_their_ways(cameras):
        own = (place - np.asarray(camera.position_m)) @ camera.world_from_camera
        away = np.maximum(np.linalg.norm(own, axis=1) - reach, _LEAST_M)
        pixel_m = projection_of(camera).finest_pixel_m(camera, away)
        at, margin = project(camera, own), _MARGIN * reach / pixel_m
        inside = [
            (-margin <= x) & (x <= side + margin) for x, side in zip((at.x_px, at.y_px), camera.size_px, strict=True)
        ]
        seen = (at.in_front & inside[0] & inside[1]) | (away < 2.0 * reach)
        finest = np.where(seen, np.minimum(finest, pixel_m), finest)
    return finest
