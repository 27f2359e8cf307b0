"""One exemplar: a plant of a species at a community radius, grown, fitted to its size and meshed; and its poses."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.errors import RecipeError
from forestgen.core.parts import Part
from forestgen.core.randomness import child_rng
from forestgen.geometry.mesh import Mesh, surface_area_m2
from forestgen.plants.dead_branches import dead_branches
from forestgen.plants.exemplar import Exemplar, OrganMesh
from forestgen.plants.forks import forked
from forestgen.plants.grown import ModuleWood
from forestgen.plants.leaf_fall import with_leaves
from forestgen.plants.levels import simplified
from forestgen.plants.meshing import organ_meshes
from forestgen.plants.needle_twigs import needle_twigs
from forestgen.plants.organs.base import OrganForm
from forestgen.plants.organs.needles import bears_on_twigs
from forestgen.plants.parameters import Fit, ShapesTrees, Sways
from forestgen.plants.plan import PlantPlan
from forestgen.plants.registry import GENERATORS
from forestgen.plants.roots import HIGH, roots_of
from forestgen.plants.skeleton import OrganPlacements, Skeleton, check_budget
from forestgen.plants.stem_surface import COVERED
from forestgen.plants.tree_fit import fit_tree, organ_boxes, stalk_materials
from forestgen.plants.tree_size import TreeSize
from forestgen.plants.variation.model import vary
from forestgen.recipe.phenology import SUMMER, LeafState
from forestgen.recipe.species import Species
from forestgen.recipe.tree_sizes import Sizes

_TRIANGLE_BYTES = 150  # of an organ's triangle while it is meshed
_LEAST_ORGAN_M = 5e-5  # single precision at a tree's top tells no points of a smaller organ apart
_FITTED = (0.5, 2.0)  # height over the height asked for; beyond, the fit did not reach the plant
_LARGEST_M = 1e4  # plant that keeps the size at which it grows
_TRIANGLES_PER_NODE = 10  # of wood: twigs have three to five sides, stems more
_ROUNDS = 12  # of the fit
_STRETCH = (0.3, 3.0)
_FARTHEST = 1e15  # a grown point, in the generator's own unit; single precision squares no more


def size_m(species: Species, radius_m: float) -> tuple[float, float]:
    """Height and width of a plant of a species: H = A_H r^c_H, W = A_W r^c_W (Lane 2002, chapter 6)."""
    height, width = species.allometry.height_m, species.allometry.width_m
    return height.scale * radius_m**height.exponent, width.scale * radius_m**width.exponent


def tree_size(species: Species, height_m: float, sizes: Sizes, row: int = 0) -> TreeSize:
    """What a tree of a species, one of `sizes`, is built to."""
    return TreeSize(
        height_m=height_m,
        crown_width_m=float(sizes.crown_width_m[row]),
        dbh_m=float(sizes.dbh_m[row]),
        crown_base_m=float(sizes.crown_base_m[row]),
        leaf_area_m2=float(sizes.leaf_kg[row]) / species.tissue.leaf_mass_per_area_kg_per_m2,
    )


def build_exemplar(
    species_name: str,
    species: Species,
    plant: Any,
    radius_m: float,
    rng: np.random.Generator,
    *,
    pixel_m: float = 0.0,
    wood: ModuleWood | None = None,
    tree: TreeSize | None = None,
    leaves: LeafState = SUMMER,
) -> Exemplar:
    """Grow and mesh one plant.

    `plant`: the generator's own `Parameters`; their `generator` names it in `GENERATORS`. `radius_m`: community radius.
    `pixel_m`: what a pixel covers of the plant, metres, which sets the detail; 0: all. The plant is the same one.
    `wood`: branches that it has grown already: the generator clothes them, and they give its height.
    `tree`: its sizes; None: height and width by the radius. `leaves`: those of its season; its height stays that of the
    plant in leaf.

    Raises `RecipeError`: a plant too large for memory, or a material that the species does not have.
    """
    if wood is None:
        height_m, width_m = size_m(species, radius_m) if tree is None else (tree.height_m, tree.crown_width_m)
        skeleton, level_rng = _grown(species_name, plant, height_m, width_m, rng, tree)
    else:
        height_m, width_m = max(wood.height_m, 0.01), float(np.ptp(wood.position_m[:, :2], axis=0).max())
        skeleton, level_rng = _clothed(plant, wood, height_m, rng)
    _check_grown(species_name, skeleton)
    templates = plant.templates()
    if tree is None:
        fitted = fit(skeleton, templates, plant.fit, height_m, width_m)
    else:
        skeleton, height_m = forked(skeleton, plant.wood.years, rng), tree.height_m
        fitted = fit_tree(skeleton, plant, templates, tree, rng.spawn(1)[0]).skeleton
    skeleton = _with_visible_organs(fitted, templates)
    _check_organs(skeleton, templates)
    in_leaf_m, years, (season_rng, wood_rng) = 0.0, plant.wood.years, rng.spawn(2)
    if not leaves.is_whole:
        feet, _, upper = organ_boxes(skeleton.organs, templates)
        in_leaf_m = float((feet + upper)[:, 2].max())
        skeleton = with_leaves(skeleton, plant.shapes, leaves, season_rng)
    seen = simplified(skeleton, templates, pixel_m, level_rng)
    organs = organ_meshes(seen, plant.shapes, plant.wood, pixel_m=pixel_m)
    low, high = box_of(organs, species_name)
    organs = (*organs, *_dead_wood(plant, skeleton, tree, pixel_m, wood_rng))
    check_materials(species_name, organs, species.materials)
    _check_fitted(species_name, plant.fit, max(float(high[2]), in_leaf_m), height_m)
    return Exemplar(
        species=species_name,
        organs=organs,
        radius_m=radius_m,
        height_m=max(float(high[2]), in_leaf_m),
        crown_width_m=float(np.mean((high - low)[:2])),
        leaf_area_m2=leaf_area_m2(organs, plant.shapes),
        wood_volume_m3=skeleton.volume_m3(),
        foliage=() if pixel_m > 0.0 else _on_twigs(seen, plant.shapes),
        roots_m=_roots_m(plant, skeleton, pixel_m),
        has_weather_side=years is not None and years.has_weather_side,
    )


def _on_twigs(skeleton: Skeleton, shapes: Mapping[str, OrganForm]) -> tuple[OrganPlacements, ...]:
    """The organs, with the twigs that bear needles of theirs."""
    return tuple(
        replace(one, twigs=needle_twigs(skeleton, one)) if bears_on_twigs(shapes[one.shape]) else one
        for one in skeleton.organs
    )


def _check_organs(skeleton: Skeleton, templates: Mapping[str, Mesh]) -> None:
    """Raise `RecipeError`: more leaves and flowers than memory holds."""
    triangles = sum(len(organs.node) * templates[organs.shape].triangles for organs in skeleton.organs)
    check_budget("triangles in leaves and flowers", triangles, _TRIANGLE_BYTES, "fewer organs, a lower detail")


def _roots_m(plant: Any, skeleton: Skeleton, pixel_m: float) -> float:
    """Height up to which roots run out from the stem."""
    years, stem_m = plant.wood.years, float(skeleton.radius_m[0])
    law = None if years is None or pixel_m > 0.0 else years.roots
    return 0.0 if roots_of(law, stem_m) is None else HIGH * stem_m


def _dead_wood(
    plant: Any, skeleton: Skeleton, tree: TreeSize | None, pixel_m: float, rng: np.random.Generator
) -> tuple[OrganMesh, ...]:
    """What is dead on a living tree; `skeleton` at its final size."""
    years = plant.wood.years
    if tree is None or years is None or years.dead_branches is None:
        return ()
    return dead_branches(skeleton, years.dead_branches, plant.wood, tree, pixel_m, rng)


def _grown(
    species_name: str, plant: Any, height_m: float, width_m: float, rng: np.random.Generator, tree: TreeSize | None
) -> tuple[Skeleton, np.random.Generator]:
    """A plant of its generator with its foliage, before the fit; and the generator of its levels of detail."""
    generator = GENERATORS.load(plant.generator)
    wood_rng, foliage_rng, level_rng, variation_rng = rng.spawn(4)
    if tree is not None and isinstance(generator, ShapesTrees):
        plant = generator.shaped(plant, tree)
    skeleton = generator.grow(plant, height_m, width_m, wood_rng)
    if plant.variation is not None:
        skeleton = vary(skeleton, plant.variation, variation_rng)
    _check_grown(species_name, skeleton)
    placed = plant.place_foliage(skeleton, height_m, foliage_rng)
    return replace(skeleton, organs=(*skeleton.organs, *placed)), level_rng


def _clothed(
    plant: Any, wood: ModuleWood, height_m: float, rng: np.random.Generator
) -> tuple[Skeleton, np.random.Generator]:
    clothing_rng, level_rng = rng.spawn(2)
    return GENERATORS.load(plant.generator).clothe(plant, wood, height_m, clothing_rng), level_rng


def grown_tree(
    species_name: str, plant: Any, tree: TreeSize, rng: np.random.Generator, wood: ModuleWood | None
) -> tuple[Skeleton, np.random.Generator]:
    """A tree in leaf, before the fit; and the generator of its levels of detail. `wood`: see `build_exemplar`."""
    if wood is None:
        found = _grown(species_name, plant, tree.height_m, tree.crown_width_m, rng, tree)
    else:
        found = _clothed(plant, wood, max(wood.height_m, 0.01), rng)
    _check_grown(species_name, found[0])
    return found


def estimate_triangles(plant: Any, wood: ModuleWood, rng: np.random.Generator) -> int:
    """About how many triangles a plant with branches of its own will have, without meshing it."""
    skeleton = GENERATORS.load(plant.generator).clothe(plant, wood, max(wood.height_m, 0.01), rng)
    leaves = sum(len(one.node) * plant.shapes[one.shape].template().triangles for one in skeleton.organs)
    return int(leaves + _TRIANGLES_PER_NODE * len(skeleton.parent))


def _check_grown(species_name: str, skeleton: Skeleton) -> None:
    """Refuse what is too large for the numbers that it is written in, before it is meshed."""
    arrays = [skeleton.position_m, skeleton.radius_m, *(organs.frame for organs in skeleton.organs)]
    if not all(np.all(np.abs(array) < _FARTHEST) for array in arrays):  # NaN too
        hint = "look for lengths, or factors of lengths, that are far too large"
        raise RecipeError("the plant grows beyond all measure", where=f"species {species_name}: plant", hint=hint)


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
    stalks = stalk_materials(shapes)
    blades = (one for one in organs if one.part == Part.LEAF and one.material not in stalks)
    return sum(surface_area_m2(one.mesh) for one in blades)


def box_of(organs: tuple[OrganMesh, ...], species_name: str) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    if not organs:
        where, hint = f"species {species_name}: plant", "thicker stems or larger organs"
        raise RecipeError("nothing of the plant is large enough to be seen", where=where, hint=hint)
    columns = [np.ascontiguousarray(organ.mesh.vertices_m.T) for organ in organs]  # several times as fast as rows
    return np.min([one.min(axis=1) for one in columns], axis=0), np.max([one.max(axis=1) for one in columns], axis=0)


def _check_fitted(species_name: str, how: Fit, made_m: float, wanted_m: float) -> None:
    """Refuse a plant that has no size, or nothing like the one that it is fitted to."""
    least, most = (0.0, _LARGEST_M) if how == "none" else (_FITTED[0] * wanted_m, _FITTED[1] * wanted_m)
    if not least <= made_m <= most:
        problem = f"the plant grows to {made_m:.3g} m" + (
            "" if how == "none" else " and cannot be fitted to its height"
        )
        expected = f"at most {most:.3g} m" if how == "none" else f"about {wanted_m:.3g} m"
        hint = "lengths and organs in proportion to the height, or fit: scale_all, or fit: none"
        raise RecipeError(problem, where=f"species {species_name}: plant", expected=expected, hint=hint)


def check_materials(species_name: str, organs: tuple[OrganMesh, ...], materials: Mapping[str, object]) -> None:
    for organ in organs:
        if organ.material.split(COVERED)[0] not in materials:
            where, expected = f"species {species_name}: plant", "one of " + ", ".join(materials)
            problem = "the plant names a material that the species does not have"
            raise RecipeError(problem, where=where, expected=expected, got=repr(organ.material))


def fit(skeleton: Skeleton, templates: Mapping[str, Mesh], how: Fit, height_m: float, width_m: float) -> Skeleton:
    """The plant at the size that the community asks for; `how` as in `PlantParameters.fit`.

    `templates`: organ shapes by name, for the organs' own extents. `height_m`: of the topmost point. `width_m`: mean of
    the extents in x and y; "stretch" alone keeps to it.
    """
    match how:
        case "stretch":
            return _stretch(skeleton, templates, height_m, width_m)
        case "scale":
            return _scale(skeleton, templates, height_m)
        case "scale_all":
            feet, _, high = organ_boxes(skeleton.organs, templates)
            top = max(float(skeleton.position_m[:, 2].max()), float((feet + high)[:, 2].max()))
            return _scaled(skeleton, height_m / max(top, 1e-9), organs_too=True)
        case "none":
            return skeleton


def _scale(skeleton: Skeleton, templates: Mapping[str, Mesh], height_m: float) -> Skeleton:
    """The wood scaled until the topmost point, of wood or organ, is at `height_m`; organs keep their size."""
    feet, _, high = organ_boxes(skeleton.organs, templates)
    nodes = float(skeleton.position_m[:, 2].max())
    factor = height_m / max(nodes, 1e-9)
    for _ in range(_ROUNDS):
        top = max(nodes * factor, float((feet[:, 2] * factor + high[:, 2]).max()))
        factor = float(np.clip(factor + (height_m - top) / max(nodes, 1e-9), 1e-3 * factor, 1e3 * factor))
    return _scaled(skeleton, factor, organs_too=False)


def _scaled(skeleton: Skeleton, factor: float, *, organs_too: bool) -> Skeleton:
    stretch = np.full(3, factor)
    return replace(
        skeleton,
        position_m=(skeleton.position_m * np.float32(factor)).astype(np.float32),
        radius_m=(skeleton.radius_m * np.float32(factor)).astype(np.float32),
        organs=tuple(moved(placement, stretch, factor if organs_too else 1.0) for placement in skeleton.organs),
    )


def _stretch(skeleton: Skeleton, templates: Mapping[str, Mesh], height_m: float, width_m: float) -> Skeleton:
    """Scale node positions and organ feet, horizontally and vertically apart, until the geometry's extents fit.

    Organs keep their size and attitude, wood its thickness. Where leaves alone are wider than `width_m` (a seedling
    is mostly leaf), the organs shrink too.
    """
    organs = skeleton.organs
    feet, low, high = organ_boxes(organs, templates)
    nodes = skeleton.position_m.astype(np.float64)
    top = max(float(nodes[:, 2].max()), 1e-9)
    stretch, organ_size = np.ones(3), 1.0
    for _ in range(_ROUNDS):
        lowest = np.minimum((nodes * stretch).min(axis=0), (feet * stretch + low * organ_size).min(axis=0))
        highest = np.maximum((nodes * stretch).max(axis=0), (feet * stretch + high * organ_size).max(axis=0))
        width = 0.5 * float(np.sum((highest - lowest)[:2]))
        span = 0.5 * float(np.sum(np.ptp(nodes, axis=0)[:2]))
        stretch[:2] = np.clip(stretch[:2] + (width_m - width) / max(span, 0.05 * width_m), *_STRETCH)
        stretch[2] = np.clip(stretch[2] + (height_m - highest[2]) / top, *_STRETCH)
        if stretch[0] in _STRETCH:
            organ_size = float(np.clip(organ_size * width_m / max(width, 1e-9), 0.4, 1.6))
    return replace(
        skeleton,
        position_m=(nodes * stretch).astype(np.float32),
        organs=tuple(moved(placement, stretch, organ_size) for placement in organs),
    )


def moved(placement: OrganPlacements, stretch: NDArray[np.floating], organ_size: float) -> OrganPlacements:
    """The organs with their feet stretched and their size multiplied."""
    frame = placement.frame.copy()
    frame[:, :, 3] *= stretch.astype(np.float32)
    frame[:, :, :3] *= np.float32(organ_size)
    return replace(placement, frame=frame)


def check_sways(species_name: str, parameters: Any) -> None:
    """Raise `RecipeError` if the plant's generator has no poses."""
    if parameters.variation is not None or not isinstance(GENERATORS.load(parameters.generator), Sways):
        able = " or ".join(name for name, generator in GENERATORS.parts() if isinstance(generator, Sways))
        got = f"{species_name}, of the generator {parameters.generator}"
        hint = "`forestgen plant --list` shows generators; or leave `frames` out"
        expected = f"a species of the generator {able}, without variation"
        problem = "plants of this species cannot sway"
        raise RecipeError(problem, parameter="frames", expected=expected, got=got, hint=hint)


def sway(
    plan: PlantPlan,
    species_name: str,
    radius_m: float,
    seed: int,
    frames: int,
    frames_per_s: float,
    tree: TreeSize | None = None,
) -> Iterator[Exemplar]:
    """The plant of a seed at times 0, 1 / frames_per_s, ...; `tree`: its sizes; None: by the radius."""
    species, parameters = plan.drawn.species[species_name], plan.generators[species_name]
    generator: Sways = GENERATORS.load(parameters.generator)
    parameters = without_stem_details(generator.in_wind(parameters))  # poses share their faces
    anew = partial(child_rng, seed, "exemplar", species_name)
    still = build_exemplar(species_name, species, parameters, radius_m, anew(), tree=tree)
    first: tuple[OrganMesh, ...] | None = None
    times_s = (np.arange(frames) / frames_per_s).tolist()
    size = size_m(species, radius_m) if tree is None else (tree.height_m, tree.crown_width_m)
    for skeleton in generator.poses(parameters, *size, anew(), times_s, tree):
        organs = organ_meshes(skeleton, parameters.shapes, parameters.wood)
        first = first or organs
        posed = replace(still, organs=_with_the_faces_of(first, organs))
        low, high = posed.bounds_m()
        yield replace(
            posed,
            wood_volume_m3=skeleton.volume_m3(),
            height_m=float(high[2]),
            crown_width_m=float(np.mean((high - low)[:2])),
            leaf_area_m2=leaf_area_m2(posed.organs, parameters.shapes),
        )


def without_stem_details(plant: Any) -> Any:
    """The plant's parameters without dead branches, bark zones and covers.

    Plants that sway have none of them: the number of their triangles would change from one pose to the next.
    """
    years = plant.wood.years
    if years is None:
        return plant
    years = years.model_copy(update={"dead_branches": None, "bark_zones": (), "covers": ()})
    return plant.model_copy(update={"wood": plant.wood.model_copy(update={"years": years})})


def _with_the_faces_of(first: tuple[OrganMesh, ...], posed: tuple[OrganMesh, ...]) -> tuple[OrganMesh, ...]:
    """Frames share their faces, as shape keys must; the mesher may cut a quad along its other diagonal."""
    shapes = [
        [(one.part, one.material, one.mesh.vertices_m.shape, one.mesh.faces.shape) for one in organs]
        for organs in (first, posed)
    ]
    if shapes[0] != shapes[1]:
        return posed
    pairs = zip(first, posed, strict=True)
    return tuple(replace(new, mesh=replace(new.mesh, faces=old.mesh.faces)) for old, new in pairs)
