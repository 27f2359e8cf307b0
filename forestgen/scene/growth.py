"""Plants -> exemplars: which an image needs, and growing them.

Dead trees are the living ones of their species, less what decay has taken (`plants.dead_tree`).

Plants that grew branches of their own are meshed as themselves or stand for others of their kind. Their dead stand with
the branches that they died with, bare, of grey weathered wood: a species' material `dead_wood`, or that of all dead
wood. Leaves, flowers and fruits are gone; twigs go with the years. Fresh snags are as grey as old ones.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import astuple, replace
from functools import cache, partial
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.architecture.prototypes import Tables
from forestgen.community.capabilities import OwnSkeletons, capability
from forestgen.community.population import Population, Status
from forestgen.core.dead_wood import DeadTree
from forestgen.core.progress import Progress
from forestgen.core.randomness import child_rng, child_root
from forestgen.plants.bark.texture import with_bark_tiles
from forestgen.plants.build import estimate_triangles, size_m, tree_size
from forestgen.plants.dead_exemplar import bare_parameters, with_dead_wood
from forestgen.plants.exemplar import Exemplar, as_solids
from forestgen.plants.growing import LIBRARY_BYTES, MOST_BYTES, ExemplarRequest, exemplar_store, grow_exemplars
from forestgen.plants.grown import woods_of
from forestgen.plants.levels import PIXEL_STEPS_M, level_for
from forestgen.plants.parameters import CrownProfile, ShapesTrees
from forestgen.plants.registry import GENERATORS
from forestgen.plants.tree_size import TreeSize
from forestgen.recipe.schema import MOST_LIBRARY
from forestgen.recipe.species import Building, Species
from forestgen.recipe.tree_sizes import NUMBERS, own_normals
from forestgen.scene.building import exemplar_of, plan_buildings
from forestgen.scene.dead_trees import dead_library_tree, of_dead
from forestgen.scene.exemplar_plan import SIZE_STEP, ExemplarPlan
from forestgen.scene.exemplars import (
    SizeError,
    check_traits,
    modelled_species,
    origin_of,
    plan_exemplars,
    plan_own,
    size_errors,
    unique_plants,
)
from forestgen.scene.lying import lying_plants
from forestgen.scene.motion import with_their_ways
from forestgen.scene.phenology import leaf_class_of_plant, leaf_states
from forestgen.scene.plan import Plan, check_exemplars, check_own_triangles
from forestgen.scene.projection import projection_of
from forestgen.scene.spec import Camera
from forestgen.scene.surfaces import material_of_class
from forestgen.scene.surroundings import Layer
from forestgen.scene.tree_exemplars import tree_sizes_of

MOST_CACHED_IMAGES = 16  # a data set of many images would only wash the cache out
Floats = NDArray[np.float64]


def choose_exemplars(
    plan: Plan, population: Population, cameras: Sequence[Camera], around: Sequence[Layer] = ()
) -> ExemplarPlan:
    """Sizes, variants and levels of detail that the plants, and their copies around the site, need.

    Raises `RecipeError`: a trait that the plants do not have.
    """
    section = plan.drawn.recipe.plants
    check_traits(section.traits, population, plan.drawn.where("plants", "traits"))
    pixel_m, given, own = None, {}, has_branches(plan, population)
    if len(population) and (section.levels or plan.community.obstacles.entries or own.any()):
        width_m = _widths_m(plan, population)
        lying = lying_plants(population)
        width_m[lying] = 2.0 * population.height_m[lying]  # their length, to any side
        pixel_m = pixel_size_m(cameras, population.position_m, population.height_m, width_m)
        for one in around if section.levels else ():
            seen = pixel_size_m(cameras, one.position_m, population.height_m[one.source], width_m[one.source])
            np.minimum.at(pixel_m, one.source, seen)
        given = plan_buildings(plan.community.obstacles.rows_of(population), population)
        given |= _plan_own_plants(plan, population, own, pixel_m)
    chosen = plan_exemplars(
        population,
        section.exemplars_per_species,
        plan.drawn.image_seed,
        traits=section.traits,
        variants=section.variants_per_size,
        given=given,
        library=section.library,
        library_tree=partial(_library_tree, plan),
    )
    chosen = chosen.split("leaves", leaf_class_of_plant(plan.drawn, population))
    if not section.levels or pixel_m is None:
        return chosen
    built_m = np.where(chosen.plant < 0, chosen.tree[:, 0], chosen.stands_for(population.height_m))
    for index in np.flatnonzero(np.isnan(built_m)).tolist():
        species = modelled_species(plan.drawn, population.species_names[chosen.species[index]])
        built_m[index] = species.allometry.height(chosen.radius_m[index])
    scale = population.height_m / built_m[chosen.exemplar_of_plant]  # of the instance
    return chosen.split("level", level_for(pixel_m / scale))


def _library_tree(plan: Plan, name: str, rung: int, variant: int, code: int) -> Floats:
    """(5,) sizes of a library's tree, in the order of `TreeSize`: of a stand, with numbers of its own.

    `code`: of the dead, whose height is that of what is left.

    The fewer of a size an image shows, the nearer are they to the median tree, for which one alone must stand. Their
    leaf area is the mean of trees of their height, not the median.
    """
    species, drawn = plan.drawn.species[name], plan.drawn
    assert species.tree is not None  # its plants have sizes
    root, height_m = child_root(drawn.recipe.seed, "library", drawn.split, name, rung), SIZE_STEP**rung
    dead = DeadTree.of(code)
    if dead is not None:
        return dead_library_tree(species.tree, dead, height_m)
    many = own_normals(root, np.arange(MOST_LIBRARY, dtype=np.uint64))
    left = 1.0 / drawn.recipe.plants.variants_per_size  # of the variance, which the image's trees do not show
    normals = np.concatenate([np.sqrt(1.0 - left) * many[variant : variant + 1], np.zeros((1, NUMBERS)), many])
    sizes = species.tree.sizes(np.full(len(normals), height_m), normals)
    tree = np.array(astuple(tree_size(species, height_m, sizes)))
    tree[4] *= (sizes.leaf_kg[2:].mean() / sizes.leaf_kg[1]) ** left
    return tree


def pixel_size_m(
    cameras: Sequence[Camera],
    position_m: NDArray[np.float64],
    height_m: NDArray[np.float64],
    width_m: NDArray[np.float64],
) -> NDArray[np.float64]:
    """(N,) what a pixel covers of each plant, across, at its nearest point to the camera that sees it largest; metres.

    A plant behind a camera counts as if it were in front: its shadow may be in view.

    Parameters
    ----------
    position_m : (N, 3) feet of the plants, world.
    height_m, width_m : (N,) of the upright cylinders that hold the plants.
    """
    finest = np.full(len(position_m), np.inf)
    for camera in with_their_ways(cameras):
        x, y, z = camera.position_m
        away = np.hypot(position_m[:, 0] - x, position_m[:, 1] - y) - 0.5 * width_m
        above = np.maximum(z - (position_m[:, 2] + height_m), position_m[:, 2] - z)
        distance = np.hypot(np.maximum(away, 0.0), np.maximum(above, 0.0))
        finest = np.minimum(finest, projection_of(camera).finest_pixel_m(camera, distance))
    return finest


def _widths_m(plan: Plan, population: Population) -> NDArray[np.float64]:
    """(N,) crown width of each plant by its species' allometry."""
    width = np.ones(len(population))
    for index, name in enumerate(population.species_names):
        rows = population.species == index
        radius_m = population.radius_m[rows]
        grown = population.modules is not None and name in plan.plants.foliage
        species = None if grown else plan.drawn.species.get(name)  # none: a building, or as wide as its branches
        width[rows] = 2.0 * radius_m if species is None else species.allometry.width(radius_m)
    of_trees = tree_sizes_of(population)[:, 1]
    return np.where(np.isnan(of_trees), width, of_trees)


def has_branches(plan: Plan, population: Population) -> NDArray[np.bool_]:
    """(N,) plants that have modules, of species with foliage for them."""
    if population.modules is None:
        return np.zeros(len(population), dtype=np.bool_)
    clothed = np.array([name in plan.plants.foliage for name in population.species_names], dtype=np.bool_)
    return np.asarray(clothed[population.species] & (np.diff(population.modules.first) > 0), dtype=np.bool_)


def _plan_own_plants(
    plan: Plan, population: Population, own: NDArray[np.bool_], pixel_m: Floats
) -> dict[int, ExemplarPlan]:
    """Plans of the species whose plants have branches of their own, by their index in the population.

    Parameters
    ----------
    own : (N,) plants that have such branches.
    pixel_m : (N,) what a pixel covers of each plant where it is seen largest.

    Raises `ResourceError`: the recipe asks for more plants as themselves than the memory holds.
    """
    section, seed = plan.drawn.recipe.plants, plan.drawn.image_seed
    triangles = cache(lambda: _triangles(plan, population, own))
    is_unique = unique_plants(population, own, pixel_m, triangles, section.unique)
    if section.unique != "auto" and is_unique.any():  # auto keeps to a number of triangles
        check_own_triangles(plan, float(triangles()[is_unique].sum()))
    return {
        int(index): plan_own(population, int(index), is_unique, section.exemplars_per_species, seed)
        for index in np.unique(population.species[own])
    }


def _triangles(plan: Plan, population: Population, own: NDArray[np.bool_]) -> Floats:
    """(N,) of each plant, estimated by its modules, from a large plant of its species that lives or is dead as it."""
    assert population.modules is not None
    modules = np.diff(population.modules.first)
    estimate = np.zeros(len(population))
    tables = _tables(plan, population)
    dead = population.status == Status.DEAD
    for index, is_dead in product(np.unique(population.species[own]), (False, True)):
        rows = np.flatnonzero(own & (population.species == index) & (dead == is_dead))
        if not len(rows):
            continue
        largest = rows[np.argmax(modules[rows])]
        parameters: Any = plan.plants.foliage[population.species_names[index]]
        if is_dead:
            parameters = parameters.model_copy(update={"foliage": ()})
        [wood] = woods_of(population, tables, np.array([largest]))
        rng = child_rng(plan.drawn.image_seed, "triangles", int(population.plant_id[largest]))
        estimate[rows] = estimate_triangles(parameters, wood, rng) * modules[rows] / modules[largest]
    return estimate


def _tables(plan: Plan, population: Population) -> Tables:
    """Shapes and sizes of a population's modules at its time."""
    skeletons = capability(plan.community.model, OwnSkeletons)
    assert skeletons is not None  # the population has modules
    return skeletons.skeleton_tables(plan.community.parameters, plan.community.ecologies, population)


def grow_planned(
    plan: Plan, exemplar_plan: ExemplarPlan, progress: Progress, population: Population
) -> tuple[Exemplar, ...]:
    """The exemplars of a plan; see `exemplar_requests`.

    Raises `ResourceError`: too little memory is left to render them.
    """
    section = plan.drawn.recipe.plants
    kept = section.cache and (section.library is not None or plan.drawn.image_index < MOST_CACHED_IMAGES)
    buildings = _buildings(plan, exemplar_plan, population)
    with progress.stage("plants", len(exemplar_plan)) as advance:
        built = {index: exemplar_of(*building) for index, building in buildings.items()}
        advance(len(built))
        requests = exemplar_requests(plan, exemplar_plan, population)
        store = exemplar_store(MOST_BYTES if section.library is None else LIBRARY_BYTES) if kept else None
        grown = grow_exemplars(requests, store=store, advance=advance)
    if section.geometry == "silhouettes":
        grown = tuple(_silhouette(request, one) for request, one in zip(requests, grown, strict=True))
    check_exemplars(plan, grown)
    plants = iter(grown)
    exemplars = (built[index] if index in built else next(plants) for index in range(len(exemplar_plan)))
    columns = zip(exemplars, exemplar_plan.is_unique.tolist(), exemplar_plan.leaves.tolist(), strict=True)
    return tuple(replace(_of_class(one, leaves), is_unique=unique) for one, unique, leaves in columns)


def _of_class(exemplar: Exemplar, leaves: int) -> Exemplar:
    """The plant with the materials of its class of phenology."""
    organs = (replace(one, material=material_of_class(one.material, leaves)) for one in exemplar.organs)
    return replace(exemplar, organs=tuple(organs)) if leaves else exemplar


def _silhouette(request: ExemplarRequest, exemplar: Exemplar) -> Exemplar:
    """The plant's solid: of its generator's own curve where there is one, otherwise as wide as the plant grew."""
    generator, parameters, tree = GENERATORS.load(request.parameters.generator), request.parameters, request.tree
    size = size_m(request.species, request.radius_m) if tree is None else (tree.height_m, tree.crown_width_m)
    if tree is not None and isinstance(generator, ShapesTrees):
        parameters = generator.shaped(parameters, tree)
    known = isinstance(generator, CrownProfile)
    return as_solids(exemplar, generator.crown_profile(parameters, *size) if known else None)


def _buildings(plan: Plan, exemplar_plan: ExemplarPlan, population: Population) -> dict[int, tuple[Building, float]]:
    """The exemplars that are buildings, by their index: the building, and the radius of its row."""
    rows = plan.community.obstacles.rows_of(population)
    pairs = zip(exemplar_plan.plant.tolist(), exemplar_plan.radius_m.tolist(), strict=True)
    return {index: (rows[row], radius_m) for index, (row, radius_m) in enumerate(pairs) if row in rows}


def exemplar_requests(plan: Plan, exemplar_plan: ExemplarPlan, population: Population) -> list[ExemplarRequest]:
    """What to grow of a population's plan, all but buildings.

    A plant's randomness belongs to its species, cluster's rank and variant; if it grew branches of its own, to itself.
    """
    names, states = list(plan.drawn.species), leaf_states(plan.drawn)
    requests = _own_requests(plan, exemplar_plan, population)
    grown = set(range(len(exemplar_plan))) - _buildings(plan, exemplar_plan, population).keys() - requests.keys()
    for index in grown:
        name = names[exemplar_plan.species[index]]
        seed, identity = origin_of(plan.drawn, name, int(exemplar_plan.rank[index]), int(exemplar_plan.variant[index]))
        requests[index] = ExemplarRequest(
            species_name=name,
            species=modelled_species(plan.drawn, name),
            parameters=plan.plants.generators[name],
            radius_m=float(exemplar_plan.radius_m[index]),
            seed=seed,
            identity=identity,
            tree=_tree(exemplar_plan.tree[index]),
            pixel_m=PIXEL_STEPS_M[exemplar_plan.level[index]],
            leaves=states[name][exemplar_plan.leaves[index]],
            is_shared=plan.drawn.recipe.plants.library is not None,
        )
        requests[index] = of_dead(requests[index], DeadTree.of(int(exemplar_plan.dead[index])))
    return [requests[index] for index in sorted(requests)]


def _tree(sizes: Floats) -> TreeSize | None:
    """(5,) sizes of an exemplar's tree; None of a plant that goes by the radius."""
    return None if np.isnan(sizes[0]) else TreeSize(*sizes.tolist())


def _own_requests(plan: Plan, exemplar_plan: ExemplarPlan, population: Population) -> dict[int, ExemplarRequest]:
    """What to grow of the exemplars that have a plant's own branches, by their index.

    A plant's randomness belongs to the plant: its twigs are the same in every image.
    """
    buildings = list(plan.community.obstacles.rows_of(population))
    chosen = np.flatnonzero((exemplar_plan.plant >= 0) & ~np.isin(exemplar_plan.plant, buildings))
    if not len(chosen):
        return {}
    rows = np.unique(exemplar_plan.plant[chosen])
    grown = woods_of(population, _tables(plan, population), rows)
    woods = dict(zip(rows.tolist(), grown, strict=True))
    names, states = population.species_names, leaf_states(plan.drawn)
    requests = {}
    for index in chosen.tolist():
        row = int(exemplar_plan.plant[index])
        name = names[population.species[row]]
        species, parameters = plan.drawn.species[name], plan.plants.foliage[name]
        if population.status[row] == Status.DEAD:
            species = with_dead_wood(species)
            bare = bare_parameters(parameters).model_copy(update={"foliage": ()})
            parameters = with_bark_tiles(bare, species.materials)
        requests[index] = ExemplarRequest(
            species_name=name,
            species=species,
            parameters=parameters,
            radius_m=float(population.radius_m[row]),
            seed=plan.drawn.image_seed,
            identity=("own", int(population.plant_id[row])),
            pixel_m=PIXEL_STEPS_M[exemplar_plan.level[index]],
            wood=woods[row],
            leaves=states[name][exemplar_plan.leaves[index]],
            is_kept=not bool(exemplar_plan.is_unique[index]),
        )
    return requests


def species_seen(species: Mapping[str, Species], population: Population) -> dict[str, Species]:
    """The species, those with dead trees among their plants with a material for them."""
    dead = np.unique(population.species[population.status == Status.DEAD])
    names = {population.species_names[index] for index in dead.tolist()}
    return {name: with_dead_wood(one) if name in names else one for name, one in species.items()}


def errors_of_sizes(
    plan: Plan, population: Population, exemplar_plan: ExemplarPlan, exemplars: tuple[Exemplar, ...]
) -> list[SizeError]:
    """Error of the approximation, each plant's width by its species' allometry.

    An exemplar with a plant's own branches has that plant's own size: leaves beyond its modules are no error.
    """
    widths_m = _widths_m(plan, population)
    height_m, width_m = exemplar_plan.stands_for(population.height_m), exemplar_plan.stands_for(widths_m)
    height_m = np.where(np.isnan(height_m), [exemplar.height_m for exemplar in exemplars], height_m)
    width_m = np.where(np.isnan(width_m), [exemplar.crown_width_m for exemplar in exemplars], width_m)
    for index, name in enumerate(population.species_names):
        generator = plan.plants.generators.get(name)  # none: a building
        if generator is None or not GENERATORS.load(generator.generator).has_crown:
            widths_m[population.species == index] = np.nan
    return size_errors(population, exemplar_plan, height_m, width_m, widths_m)
