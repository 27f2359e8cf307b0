"""A checked recipe, all that can be known to be wrong before anything is simulated, and memory by estimate."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from forestgen.atmosphere.clouds.cirrus import CIRRUS_BYTES, check_cirrus_above, cirrus_above
from forestgen.atmosphere.clouds.source import GAP_OF_SITE, LEAST_GAP_M, cloud_source_of
from forestgen.community.capabilities import HasObstacles, OwnSkeletons, PlanChecks, capability, models_with
from forestgen.community.disturbance import Ground
from forestgen.community.model import CommunityParameters
from forestgen.community.placement.density_map import check_maps
from forestgen.community.population import Site
from forestgen.community.registry import COMMUNITY_MODELS
from forestgen.community.simulation import CommunityPlan, located
from forestgen.core.errors import ErrorList, RecipeError, ResourceError
from forestgen.core.figures import show_bytes
from forestgen.core.processes import free_bytes
from forestgen.plants.exemplar import Exemplar
from forestgen.plants.plan import PlantPlan, foliage_of, generator_parameters
from forestgen.recipe.load import DrawnRecipe, LoadedRecipe
from forestgen.recipe.registries import DATASET_FORMATS, GROUND_LAYERS, LABEL_CHANNELS
from forestgen.recipe.schema import Recipe
from forestgen.recipe.suggestions import did_you_mean
from forestgen.scene.exact_light import chooses_exact, exact_light_error
from forestgen.scene.exemplars import MOST_TRIANGLES, check_traits
from forestgen.scene.ground_view import MOST_TILES
from forestgen.scene.phenology import leaf_states
from forestgen.scene.site import check_wet_soil, community_site
from forestgen.scene.snow_depth import FINE_TRIANGLES
from forestgen.scene.surroundings import MOST_FAR, most_far_triangles
from forestgen.scene.terrain import FINE_M, TEXTURE_PX
from forestgen.scene.triangles import exemplar_triangles, near_triangles
from forestgen.scene.views import Views, place_key
from forestgen.scene.weather.kind import check_weather, has_relief

# Kept free for the operating system and for what no estimate sees.
_SHARE_OF_MEMORY = 0.8
# Measured by tests/system/test_memory.py as the peak resident memory of whole runs.
_LOADED_SIMULATOR_BYTES = 520_000_000
_LOADED_RENDERER_BYTES = 900_000_000  # libraries, kernels, the ground's texture and what it was made from
# A ground's texture: in the scene, in the labels' tables, as light and as relief in the light paths' tables, and once
# while these are made; 146 MB each measured with five.
_BYTES_PER_TEXTURE = 5 * 12 * TEXTURE_PX**2
_BYTES_PER_SAMPLE = 5 + 16  # an identity sample, and the sorting of it
_BYTES_PER_PIXEL = 800  # radiance sums in double precision, buffers, channels on their way to files
_BYTES_PER_TRIANGLE = 250  # mesh, the scene with its tree, normals' table; 242 measured on 60 spruces of 18 m
# Of plants with branches of their own: 267 measured on tall spruces.
_BYTES_PER_OWN_TRIANGLE = 300
_BYTES_PER_TRIANGLE_UNDER_CLOUDS = 160  # more, where light goes through clouds exactly: they have scenes of their own
_BYTES_PER_PLANT = 7_000  # an instance in the scene; 500,000 of benchmarks/labels.py take 4 kB each
_BYTES_PER_PLANT_UNDER_CLOUDS = 27_000  # more, as above
# Clouds that are so much higher than they must be are surely far: plants differ in height, and the ground in places.
_SURELY_FAR_M = 200.0
_GROUND_POINTS = 33  # along a side, at which the ground's height is looked up
_TRIANGLES_OF_A_PLANT = 300_000  # of a large one, at a guess
_FILM_BYTES = 60_000_000  # numbers and pictures that community/history_files.py keeps


@dataclass(frozen=True)
class Plan:
    """A drawn recipe whose models and generators are found and whose parameters are checked."""

    drawn: DrawnRecipe
    community: CommunityPlan
    plants: PlantPlan
    views: Views


def estimate_bytes(plan: Plan, *, simulate_only: bool = False, plants: int = 0) -> dict[str, int]:
    """Peak memory by what takes it: an upper estimate, without simulating.

    `plants`: how many the scene will hold; before the simulation nobody knows, and their share is left out.
    """
    recipe, stand = plan.drawn.recipe, plan.community
    try:
        community = stand.model.estimate_bytes(stand.parameters, stand.site, stand.ecologies)
    except (RecipeError, ResourceError) as cause:
        raise located(cause, plan.drawn) from cause
    if simulate_only:
        return {"community": community + _FILM_BYTES, "libraries": _LOADED_SIMULATOR_BYTES}
    source = cloud_source_of(plan.drawn)
    pixels = max(camera.size_px[0] * camera.size_px[1] for camera in recipe.cameras)
    exact = _may_be_exact(plan.views)
    per_plant = _BYTES_PER_PLANT + exact * _BYTES_PER_PLANT_UNDER_CLOUDS
    clouds_per_triangle = exact * _BYTES_PER_TRIANGLE_UNDER_CLOUDS
    per_triangle = _BYTES_PER_TRIANGLE + clouds_per_triangle
    own = own_triangles(plan)
    grown = exemplar_triangles(plan.drawn, plan.plants, stand, plan.views.all_cameras)
    grown += near_triangles(plan.drawn, plan.plants, plan.views.all_cameras, stand.site.size_m, _highest_m(plan.views))
    across, along = (len(one) - 1 for one in plan.views.height.axes)
    fine = math.ceil(2.0 * plan.views.height.fine_m2 / FINE_M**2) + has_relief(plan.drawn) * FINE_TRIANGLES
    return {
        "community": community,
        "libraries": _LOADED_RENDERER_BYTES,
        "ground": (2 * across * along + fine) * per_triangle
        + _ground_cover_bytes(recipe, per_triangle, per_plant)
        + _more_textures(plan.drawn) * _BYTES_PER_TEXTURE,
        "images": pixels * (_BYTES_PER_PIXEL + recipe.labels.samples * _BYTES_PER_SAMPLE),
        "exemplars": math.ceil(grown * per_triangle + own * (_BYTES_PER_OWN_TRIANGLE + clouds_per_triangle)),
        "plants": plants * per_plant,
        "surroundings": recipe.site.surroundings.kind != "open"
        and most_far_triangles(stand.site.size_m) * per_triangle + MOST_FAR * per_plant,
        "clouds": source.estimate_bytes(plan.drawn, stand.model, stand.parameters)
        + (cirrus_above(plan.drawn) is not None) * CIRRUS_BYTES,
    }


def _highest_m(views: Views) -> float:
    """Height of the site's highest ground, of a grid of points."""
    x_m, y_m = np.meshgrid(*(np.linspace(0.0, side_m, _GROUND_POINTS) for side_m in views.drawn.recipe.site.size_m))
    return float(views.height(x_m, y_m).max())


def _ground_cover_bytes(recipe: Recipe, per_triangle: int, per_instance: int) -> int:
    layers = [GROUND_LAYERS.load(keys.what) for keys in recipe.site.ground.layers]
    return sum(int(one.most_triangles) for one in layers) * per_triangle + bool(layers) * MOST_TILES * per_instance


def _more_textures(drawn: DrawnRecipe) -> int:
    """Of other grounds on the site: of paths and beds, shores, between things that lie there, below crowns on snow."""
    site = drawn.recipe.site
    grounds = {("path", one.surface) for one in site.paths} | {("bed", one.ground) for one in site.water}
    strips = any(one.what == "forest_road" for one in site.paths)
    return len(grounds) + sum(map(bool, (strips, site.water, site.ground.layers, has_relief(drawn))))


def own_triangles(plan: Plan) -> int:
    """Triangles of plants with branches of their own and of those that stand for the far ones, before any has grown.

    The stand-ins of the standing dead, bare wood, are not counted. How many plants there will be, and how large, nobody
    knows yet: see `check_own_triangles`.
    """
    section, states = plan.drawn.recipe.plants, leaf_states(plan.drawn)
    if not plan.plants.foliage or section.unique == "none":
        unique = 0
    elif isinstance(section.unique, int):
        unique = min(section.unique * _TRIANGLES_OF_A_PLANT, MOST_TRIANGLES)
    else:
        unique = MOST_TRIANGLES
    classes = sum(len(states[name]) for name in plan.plants.foliage)
    return unique + classes * section.exemplars_per_species * _TRIANGLES_OF_A_PLANT


def _may_be_exact(views: Views) -> bool:
    """Whether the light of a recipe may be traced through clouds; see `render.cloud_shadow`."""
    drawn, recipe = views.drawn, views.drawn.recipe
    base_m = cloud_source_of(drawn).known_base_m(drawn)
    if not recipe.sky.clouds.has_clouds:
        return False
    if recipe.render.clouds != "auto" or base_m is None:
        return recipe.render.clouds != "farfield"
    standing_m = [species.mature_height_m for species in drawn.species.values()]
    standing_m += [building.size_m[2] for building in recipe.site.buildings]
    tops_m = [_highest_m(views) + max(standing_m, default=0.0)]
    tops_m += [camera.position_m[2] for camera in views.all_cameras]
    return base_m < max(tops_m) + max(LEAST_GAP_M, GAP_OF_SITE * math.hypot(*recipe.site.size_m)) + _SURELY_FAR_M


def check_memory(
    plan: Plan, *, simulate_only: bool = False, plants: int = 0, memory_budget_bytes: int | None = None
) -> None:
    """Raise `ResourceError` if the estimate does not fit into memory; see `estimate_bytes`.

    `memory_budget_bytes`: memory that there is for it; None: what is free now.
    """
    free = int((free_bytes() if memory_budget_bytes is None else memory_budget_bytes) * _SHARE_OF_MEMORY)
    parts = estimate_bytes(plan, simulate_only=simulate_only, plants=plants)
    need = sum(parts.values())
    if need <= free:
        return
    largest = max(parts, key=lambda name: parts[name])
    where, hint = {
        "community": (("community",), plan.community.parameters.memory_hint),
        "ground": (("site", "size_m"), "make the site smaller"),
        "images": (("cameras",), "make the images smaller, or lower labels.samples"),
        "exemplars": (("plants", "exemplars_per_species"), "lower plants.exemplars_per_species or variants_per_size"),
        "plants": (("site", "size_m"), f"{plants:,} plants grew: make the site smaller, or stop after fewer steps"),
        "surroundings": (("site", "surroundings"), "set site.surroundings to open, or close other programs"),
        "clouds": (("sky", "clouds"), "make the clouds' extent_m smaller, or their cells larger"),
        "libraries": ((), "close other programs"),
    }[largest]
    there = "is free" if memory_budget_bytes is None else "there is"
    problem = f"this would need more memory than {there}, most of it for the {largest}"
    expected, got = f"at most {show_bytes(free)}", f"about {show_bytes(need)} ({largest}: {show_bytes(parts[largest])})"
    raise ResourceError(problem, where=plan.drawn.where(*where), expected=expected, got=got, hint=hint)


def check_own_triangles(plan: Plan, triangles: float) -> None:
    """Raise `ResourceError` if so many triangles of plants as themselves do not fit into the memory that is free."""
    problem = "plants with branches of their own would need more memory than is free"
    hint = "set plants.unique to auto, or to a smaller number"
    _check_triangles(plan, "unique", triangles, triangles * _BYTES_PER_OWN_TRIANGLE, problem, hint)


def check_exemplars(plan: Plan, exemplars: Sequence[Exemplar]) -> None:
    """Raise `ResourceError` if too little memory is free to render exemplars that have grown: more than estimated."""
    triangles, made = sum(one.triangles for one in exemplars), sum(one.nbytes for one in exemplars)
    each = _BYTES_PER_TRIANGLE + _may_be_exact(plan.views) * _BYTES_PER_TRIANGLE_UNDER_CLOUDS
    problem = "rendering the plants that were modelled would need more memory than is free"
    hint = "lower plants.exemplars_per_species or variants_per_size"
    _check_triangles(plan, "exemplars_per_species", triangles, triangles * each - made, problem, hint)


def _check_triangles(plan: Plan, key: str, triangles: float, need: float, problem: str, hint: str) -> None:
    free = int(free_bytes() * _SHARE_OF_MEMORY)
    if need > free:
        got = f"about {show_bytes(int(need))} for {triangles / 1e6:,.0f} million triangles"
        where, expected = plan.drawn.where("plants", key), f"at most {show_bytes(free)}"
        raise ResourceError(problem, where=where, expected=expected, got=got, hint=hint)


def make_plan(drawn: DrawnRecipe) -> Plan:
    """Find and check the community model and the plant generators that a drawn recipe names.

    Raises `RecipeError`: an unknown model or generator, or parameters that it rejects; with file, line and key. Raises
    `RecipeErrors`: several of these.
    """
    errors = ErrorList(drawn.sources.place(()).origin)
    plan = collect_plan(drawn, errors)
    errors.raise_all()
    assert plan is not None
    return plan


def collect_plan(drawn: DrawnRecipe, errors: ErrorList, stand_ins: frozenset[str] = frozenset()) -> Plan | None:
    """The plan of a drawn recipe, or None if `errors` has some now.

    `stand_ins`: sections that are not the recipe's own: what depends on them is not checked.
    """
    had = len(errors.found)
    generators = generator_parameters(drawn, errors)
    views = None if {"cameras", "site"} & stand_ins else errors.attempt(Views.of, drawn)
    if views is not None:
        errors.attempt(views.check_above_ground)
        if not {"sky", "render"} & stand_ins:
            errors.attempt(_check_clouds, views)
    if not {"weather", "sky", "render"} & stand_ins:
        errors.attempt(check_weather, drawn)
    if not {"site", "species"} & stand_ins:
        for index, layer in enumerate(drawn.recipe.site.ground.layers):
            check = GROUND_LAYERS.load(layer.what).check
            errors.attempt(check, layer, drawn, ("site", "ground", "layers", index))
    if not {"cameras", "labels", "dataset"} & stand_ins:
        for index, name in enumerate(drawn.recipe.dataset.formats):
            found = errors.attempt(DATASET_FORMATS.load, name, where=drawn.where("dataset", "formats", index))
            if found is not None:
                errors.attempt(found.check, drawn)
        for index, name in enumerate(drawn.recipe.labels.channels):
            errors.attempt(LABEL_CHANNELS.use, name, where=drawn.where("labels", "channels", index))
    if "community" in stand_ins:
        return None
    where = drawn.where("community", "model")
    model = errors.attempt(COMMUNITY_MODELS.load, drawn.recipe.community.model, where=where)
    if model is None:
        return None
    foliage = None
    if len(generators) == len(drawn.species) and "species" not in stand_ins:
        foliage = errors.attempt(foliage_of, drawn, model, generators)
    keys = drawn.recipe.community.parameters
    parameters = errors.attempt(drawn.parse, model.Parameters, keys, ("community",))
    if parameters is None:
        return None
    site = errors.attempt(community_site, drawn) or Site(drawn.recipe.site.size_m)
    community = CommunityPlan.of(drawn, model, parameters, site)
    _check_community(community, errors, stand_ins)
    if views is not None:
        errors.attempt(views.check_outside_of_buildings)
    if len(errors.found) > had or foliage is None or views is None:
        return None
    return Plan(drawn, community, PlantPlan(drawn, generators, foliage), views)


def _check_community(plan: CommunityPlan, errors: ErrorList, stand_ins: frozenset[str]) -> None:
    """What the community's keys and those of other sections say of each other."""
    drawn, parameters = plan.drawn, plan.parameters
    if "species" not in stand_ins:
        had = len(errors.found)
        for keys, name in parameters.named_species():
            if name not in drawn.species:
                problem, where = "the recipe has no species of this name", drawn.where("community", *keys)
                expected, hint = "one of " + ", ".join(drawn.species), did_you_mean(name, drawn.species)
                errors.add(RecipeError(problem, where=where, expected=expected, got=repr(name), hint=hint))
        if len(errors.found) > had:
            stand_ins |= {"species"}
    if "site" in stand_ins:
        return
    if "species" not in stand_ins:
        errors.attempt(_check_disturbances, plan)
    errors.attempt(_check_buildings, plan)
    had = len(errors.found)
    errors.attempt(check_maps, parameters, drawn.recipe.site.size_m, lambda *keys: drawn.where("community", *keys))
    own_checks = capability(plan.model, PlanChecks)
    if own_checks is not None and "species" not in stand_ins and len(errors.found) == had:
        errors.attempt(_check_own, own_checks, drawn, parameters)
    errors.attempt(check_wet_soil, plan)
    if "sky" not in stand_ins:
        errors.attempt(cloud_source_of(drawn).check_community, drawn, plan.model, parameters)


def _check_own(checks: PlanChecks, drawn: DrawnRecipe, parameters: CommunityParameters) -> None:
    try:
        checks.check_recipe(drawn, parameters)
    except RecipeError as cause:
        raise located(cause, drawn) from cause


def check_plan(loaded: LoadedRecipe, *, simulate_only: bool = False) -> Plan:
    """Check a recipe at the ends of all of its distributions; the plan of its first image.

    Raises `RecipeError`: see `make_plan`. Raises `ResourceError`: more memory than this machine has free would be
    needed.
    """
    errors = ErrorList(loaded.sources.place(()).origin)
    plans = [collect_plan(drawn, errors) for drawn in loaded.probes()]
    errors.raise_all()
    for plan in plans:
        assert plan is not None
        check_memory(plan, simulate_only=simulate_only)
        if not simulate_only:
            _check_traits(plan)
            skeletons = capability(plan.community.model, OwnSkeletons)
            if skeletons is not None:
                skeletons.check_foliage(plan.drawn, plan.community.parameters, plan.plants.foliage)
    assert plans[0] is not None
    return plans[0]


def _check_disturbances(plan: CommunityPlan) -> None:
    """Times within the simulation, places on the site, planted radii that the species can have."""
    drawn, parameters = plan.drawn, plan.parameters
    ground = Ground(drawn.recipe.site.size_m, parameters.periodic)
    for index, one in enumerate(parameters.disturbances):
        keys = ("community", "disturbances", index)
        step = one.step(parameters.step_yr)
        if step > parameters.steps:
            key, got = ("at_yr", f"{one.at_yr:g} years, in step {step}") if one.at_step is None else ("at_step", step)
            end_yr = parameters.steps * parameters.step_yr
            problem, where = "the simulation ends before this happens", drawn.where(*keys, key)
            expected = f"at most step {parameters.steps}, which is year {end_yr:g}"
            raise RecipeError(problem, where=where, expected=expected, got=str(got), hint="raise community.steps")
        for beyond, point in one.off_site(ground):
            width, height = ground.size_m
            problem, where = "this does not lie on the site", drawn.where(*keys, *beyond)
            expected = f"x from 0 to {width:g} and y from 0 to {height:g} metres"
            raise RecipeError(problem, where=where, expected=expected, got=f"[{point[0]:g}, {point[1]:g}]")
        if one.plant is not None and one.plant.radius_m is not None:
            largest = drawn.species[one.plant.species].ecology.max_radius_m
            if one.plant.radius_m > largest:
                problem, where = f"no {one.plant.species} is so large", drawn.where(*keys, "plant", "radius_m")
                expected = f"at most ecology.max_radius_m = {largest:g} m"
                raise RecipeError(problem, where=where, expected=expected, got=f"{one.plant.radius_m:g} m")


def _check_clouds(views: Views) -> None:
    """Clouds that can be made; and cameras below them, where their light comes from afar.

    Such clouds are traced apart from the plants, which a camera inside or above them would see through.
    """
    drawn, source = views.drawn, cloud_source_of(views.drawn)
    source.check(drawn)
    check_cirrus_above(drawn)
    if chooses_exact(drawn):
        if drawn.recipe.site.water:
            raise exact_light_error("water", drawn.where("site", "water"), "site.water", chosen=True)
        for index, section in enumerate(drawn.recipe.cameras):
            if section.motion is not None:
                where = drawn.where("cameras", index, "motion")
                raise exact_light_error("a camera that moves", where, "the camera's motion", chosen=True)
    base_m = source.known_base_m(drawn)
    cirrus = cirrus_above(drawn)
    if base_m is None or (drawn.recipe.render.clouds != "farfield" and cirrus is None):
        return
    for index, (section, cameras) in enumerate(zip(drawn.recipe.cameras, views.cameras, strict=True)):
        highest_m = max(camera.position_m[2] for camera in cameras)
        if highest_m >= base_m:
            later = section.path is not None and cameras[0].position_m[2] < base_m
            key = place_key(section, path=later)
            problem, where = "the camera stands in or above the clouds", drawn.where("cameras", index, *key)
            expected = f"a height below sky.clouds.base_m = {base_m:g} m"
            instead = "set render.clouds to exact" if cirrus is None else "leave out sky.clouds.cirrus"
            hint = f"{instead}; or lower the camera, raise base_m, or set sky.clouds to none"
            raise RecipeError(problem, where=where, expected=expected, got=f"{highest_m:g} m", hint=hint)


def _check_buildings(plan: CommunityPlan) -> None:
    """A community that knows of buildings."""
    drawn = plan.drawn
    if drawn.recipe.site.buildings and capability(plan.model, HasObstacles) is None:
        problem, where = "plants of this community would grow into the buildings", drawn.where("site", "buildings")
        expected, got = f"community.model: {models_with(HasObstacles)}", drawn.recipe.community.model
        raise RecipeError(problem, where=where, expected=expected, got=got, hint="leave out site.buildings")


def _check_traits(plan: Plan) -> None:
    """Refuse a trait that the model's plants will not have: seen on a small piece of land before the first step."""
    traits, community = plan.drawn.recipe.plants.traits, plan.community
    if traits:
        width_m, depth_m = community.site.size_m
        site = Site((min(width_m, 50.0), min(depth_m, 50.0)))
        parameters = community.parameters.for_trial()
        state = community.model.init(parameters, site, community.ecologies, plan.drawn.image_seed)
        check_traits(traits, community.model.population(state), plan.drawn.where("plants", "traits"))
