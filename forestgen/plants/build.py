"""One exemplar: a plant of a species at a community radius, grown and meshed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from forestgen.core.errors import RecipeError
from forestgen.core.parts import Part
from forestgen.geometry.mesh import Mesh, surface_area_m2
from forestgen.plants.budget import check_budget
from forestgen.plants.exemplar import Exemplar, OrganMesh
from forestgen.plants.fitting import fit
from forestgen.plants.grown import ModuleWood
from forestgen.plants.levels import FULL, Level, simplified
from forestgen.plants.meshing import organ_meshes
from forestgen.plants.organs.base import OrganForm
from forestgen.plants.parameters import Fit
from forestgen.plants.registry import GENERATORS
from forestgen.plants.skeleton import OrganPlacements, Skeleton
from forestgen.plants.variation.growth import vary
from forestgen.recipe.species import Species

_TRIANGLE_BYTES = 150  # of an organ's triangle while it is meshed
_LEAST_ORGAN_M = 5e-5  # single precision at a tree's top tells no points of a smaller organ apart
_FITTED = (0.5, 2.0)  # height over the height asked for; beyond, the fit did not reach the plant
_LARGEST_M = 1e4  # plant that keeps the size at which it grows
_TRIANGLES_PER_NODE = 10  # of wood: twigs have three to five sides, stems more
_FARTHEST = 1e15  # a grown point, in the generator's own unit; single precision squares no more


def size_m(species: Species, radius_m: float) -> tuple[float, float]:
    """Height and width of a plant of a species: H = A_H r^c_H, W = A_W r^c_W (Lane 2002, chapter 6)."""
    height, width = species.allometry.height_m, species.allometry.width_m
    return height.scale * radius_m**height.exponent, width.scale * radius_m**width.exponent


def build_exemplar(
    species_name: str,
    species: Species,
    plant: Any,
    radius_m: float,
    rng: np.random.Generator,
    *,
    level: Level = FULL,
    wood: ModuleWood | None = None,
) -> Exemplar:
    """Grow and mesh one plant.

    Parameters
    ----------
    plant : the generator's own `Parameters`; their `generator` names it in `GENERATORS`.
    radius_m : community radius.
    level : how much detail; the plant is the same one at every level.
    wood : branches that it has grown already: the generator clothes them, and they give its height.

    Raises
    ------
    RecipeError : a plant too large for memory, or a material that the species does not have.
    """
    if wood is None:
        height_m, width_m = size_m(species, radius_m)
        wood_rng, foliage_rng, level_rng, variation_rng = rng.spawn(4)
        skeleton = GENERATORS.load(plant.generator).grow(plant, height_m, width_m, wood_rng)
        if plant.variation is not None:
            skeleton = vary(skeleton, plant.variation, variation_rng)
        _check_grown(species_name, skeleton)
        placed = plant.place_foliage(skeleton, height_m, foliage_rng)
        skeleton = replace(skeleton, organs=(*skeleton.organs, *placed))
    else:
        clothing_rng, level_rng = rng.spawn(2)
        height_m, width_m = max(wood.height_m, 0.01), float(np.ptp(wood.position_m[:, :2], axis=0).max())
        skeleton = GENERATORS.load(plant.generator).clothe(plant, wood, height_m, clothing_rng)
    _check_grown(species_name, skeleton)
    templates = plant.templates()
    skeleton = _with_visible_organs(fit(skeleton, templates, plant.fit, height_m, width_m), templates)
    triangles = sum(len(organs.node) * templates[organs.shape].triangles for organs in skeleton.organs)
    check_budget("triangles in leaves and flowers", triangles, _TRIANGLE_BYTES, "fewer organs, a lower detail")
    seen = simplified(skeleton, templates, level, level_rng)
    organs = organ_meshes(seen, plant.shapes, plant.wood, pixel_m=level.pixel_m)
    _check_materials(species_name, organs, species.materials)
    low, high = _box(organs, species_name)
    _check_fitted(species_name, plant.fit, float(high[2]), height_m)
    return Exemplar(
        species=species_name,
        organs=organs,
        radius_m=radius_m,
        height_m=float(high[2]),
        crown_width_m=float(np.mean((high - low)[:2])),
        leaf_area_m2=leaf_area_m2(organs, plant.shapes),
        wood_volume_m3=skeleton.volume_m3(),
    )


def estimate_triangles(plant: Any, wood: ModuleWood, rng: np.random.Generator) -> int:
    """About how many triangles a plant with branches of its own will have, without meshing it."""
    skeleton = GENERATORS.load(plant.generator).clothe(plant, wood, max(wood.height_m, 0.01), rng)
    leaves = sum(len(one.node) * plant.shapes[one.shape].template().triangles for one in skeleton.organs)
    return int(leaves + _TRIANGLES_PER_NODE * len(skeleton.parent))


def _check_grown(species_name: str, skeleton: Skeleton) -> None:
    """Refuse what is too large for the numbers that it is written in, before it is meshed."""
    arrays = [skeleton.position_m, skeleton.radius_m, *(organs.frame for organs in skeleton.organs)]
    if not all(np.all(np.abs(array) < _FARTHEST) for array in arrays):  # NaN too
        raise RecipeError(
            "the plant grows beyond all measure",
            where=f"species {species_name}: plant",
            hint="look for lengths, or factors of lengths, that are far too large",
        )


def _with_visible_organs(skeleton: Skeleton, templates: Mapping[str, Mesh]) -> Skeleton:
    """Without organs that a size curve has shrunk to nothing: they have no normals."""
    kept = []
    for organs in skeleton.organs:
        extent_m = float(np.ptp(templates[organs.shape].vertices_m, axis=0).max(initial=0.0))
        size = np.linalg.norm(organs.frame[:, :, 1], axis=1)
        seen = ~(size * extent_m < _LEAST_ORGAN_M)
        kept.append(organs if seen.all() else OrganPlacements(organs.shape, organs.frame[seen], organs.node[seen]))
    return replace(skeleton, organs=tuple(kept))


def leaf_area_m2(organs: Iterable[OrganMesh], shapes: Mapping[str, OrganForm]) -> float:
    """Area of the blades, one side: of all that is labelled leaf, but for stalks that have a material of their own."""
    stalks = {getattr(shape, "stalk_material", None) for shape in shapes.values()}
    stalks -= {shape.material for shape in shapes.values()}
    blades = (one for one in organs if one.part == Part.LEAF and one.material not in stalks)
    return sum(surface_area_m2(one.mesh) for one in blades)


def _box(organs: tuple[OrganMesh, ...], species_name: str) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    if not organs:
        raise RecipeError(
            "nothing of the plant is large enough to be seen",
            where=f"species {species_name}: plant",
            hint="thicker stems or larger organs",
        )
    low = np.min([organ.mesh.vertices_m.min(axis=0) for organ in organs], axis=0)
    return low, np.max([organ.mesh.vertices_m.max(axis=0) for organ in organs], axis=0)


def _check_fitted(species_name: str, how: Fit, made_m: float, wanted_m: float) -> None:
    """Refuse a plant that has no size, or nothing like the one that it is fitted to."""
    least, most = (0.0, _LARGEST_M) if how == "none" else (_FITTED[0] * wanted_m, _FITTED[1] * wanted_m)
    if not least <= made_m <= most:
        raise RecipeError(
            f"the plant grows to {made_m:.3g} m" + ("" if how == "none" else " and cannot be fitted to its height"),
            where=f"species {species_name}: plant",
            expected=f"at most {most:.3g} m" if how == "none" else f"about {wanted_m:.3g} m",
            hint="lengths and organs in proportion to the height, or fit: scale_all, or fit: none",
        )


def _check_materials(species_name: str, organs: tuple[OrganMesh, ...], materials: Mapping[str, object]) -> None:
    for organ in organs:
        if organ.material not in materials:
            raise RecipeError(
                "the plant names a material that the species does not have",
                where=f"species {species_name}: plant",
                expected="one of " + ", ".join(materials),
                got=repr(organ.material),
            )
