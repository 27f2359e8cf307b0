"""Everything that can be known to be wrong before anything is simulated.

A `Plan` is a drawn recipe whose model and generators are found, whose parameters are checked, and that fits into this
machine's memory by estimate.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from forestgen.atmosphere.clouds.source import cloud_source_of
from forestgen.community.capabilities import (
    HasObstacles,
    OwnSkeletons,
    PlanChecks,
    capability,
)
from forestgen.community.disturbance import Ground
from forestgen.community.ecology import SpeciesEcology, ecology_of
from forestgen.community.model import CommunityParameters, Site
from forestgen.community.obstacles import NO_OBSTACLES, Obstacles, check_obstacles
from forestgen.community.placement.density_map import check_maps
from forestgen.community.registry import COMMUNITY_MODELS
from forestgen.core.error_list import ErrorList
from forestgen.core.errors import RecipeError, ResourceError
from forestgen.core.figures import show_bytes
from forestgen.core.memory import free_bytes
from forestgen.plants.budget import most_triangles
from forestgen.plants.parameters import PlantParameters
from forestgen.plants.registry import GENERATORS, is_built
from forestgen.recipe.load import DrawnRecipe, LoadedRecipe
from forestgen.recipe.registries import DATASET_FORMATS, LABEL_CHANNELS
from forestgen.recipe.sources import Keys
from forestgen.recipe.suggestions import did_you_mean
from forestgen.scene.exemplars import check_traits
from forestgen.stages.ground import check_wet_soil, community_site, height_field
from forestgen.stages.own_plants import clothing_of, generator_parameters, own_triangles
from forestgen.stages.sky import check_sun
from forestgen.stages.views import below_ground, check_above_ground, check_outside_of_houses, drawn_cameras

# Kept free for the operating system and for what no estimate sees.
_SHARE_OF_MEMORY = 0.8
# Measured by tests/system/test_memory.py as the peak resident memory of whole runs.
_LOADED_SIMULATOR_BYTES = 520_000_000
_LOADED_RENDERER_BYTES = 900_000_000  # libraries, kernels, the ground's texture and what it was made from
_BYTES_PER_SAMPLE = 5 + 16  # an identity sample, and the sorting of it
_BYTES_PER_PIXEL = 800  # radiance sums in double precision, buffers, channels on their way to files
_BYTES_PER_TRIANGLE = 200  # mesh, the scene with its tree, normals' table
# Of plants with branches of their own: 267 measured on tall spruces.
_BYTES_PER_OWN_TRIANGLE = 300
_BYTES_PER_TRIANGLE_UNDER_CLOUDS = 160  # more, where light goes through clouds exactly: they have scenes of their own
_DETAIL_OF_ALL_LEVELS = 2.0  # a size at every level of detail, over `most_triangles`; measured up to 1.8
_BYTES_PER_PLANT = 7_000  # an instance in the scene; 500,000 of benchmarks/labels.py take 4 kB each
_BYTES_PER_PLANT_UNDER_CLOUDS = 27_000  # more, as above
# Clouds that are so much higher than they must be are surely far: plants differ in height, and the ground in places.
_SURELY_FAR_M = 200.0
_GROUND_POINTS = 33  # along a side, at which the ground's height is looked up
_GROUND_CELL_M, _MOST_GROUND_CELLS, _GROUND_BEYOND = 0.75, 1200, 160  # see scene/terrain.py
_FILM_BYTES = 60_000_000  # numbers and pictures that stages/history.py keeps


@dataclass(frozen=True)
class Plan:
    """A drawn recipe with its model and generators."""

    drawn: DrawnRecipe
    model: Any  # a CommunityModel
    model_parameters: CommunityParameters
    generator_parameters: Mapping[str, PlantParameters]  # by species
    module_parameters: Mapping[str, PlantParameters] = field(default_factory=dict)  # of species clothed by modules

    @cached_property
    def site(self) -> Site:
        return community_site(self.drawn)

    @property
    def ecologies(self) -> list[SpeciesEcology]:
        return [ecology_of(name, species) for name, species in self.drawn.species.items()]

    @cached_property
    def obstacles(self) -> Obstacles:
        return _obstacles(self.drawn, self.model, self.model_parameters)

    @property
    def steps(self) -> int:
        return self.model_parameters.steps


def _obstacles(drawn: DrawnRecipe, model: object, parameters: CommunityParameters) -> Obstacles:
    """The obstacles of a community that may have some."""
    stands = capability(model, HasObstacles)
    if stands is None:
        return NO_OBSTACLES
    built = frozenset(name for name, one in drawn.species.items() if is_built(one.plant.generator))
    return Obstacles(stands.obstacles(parameters), built)


def make_plan(drawn: DrawnRecipe) -> Plan:
    """Find and check the community model and the plant generators that a drawn recipe names.

    Raises
    ------
    RecipeError : an unknown model or generator, or parameters that it rejects; with file, line and key.
    RecipeErrors : several of these.
    """
    errors = ErrorList(drawn.sources.place(()).origin)
    plan = collect_plan(drawn, errors)
    errors.raise_all()
    assert plan is not None
    return plan


def plan_of_plants(drawn: DrawnRecipe) -> Plan:
    """The plan of single plants, without a community.

    Raises
    ------
    RecipeError, RecipeErrors : see `make_plan`.
    """
    errors = ErrorList(drawn.sources.place(()).origin)
    generators = generator_parameters(drawn, errors)
    errors.raise_all()
    return Plan(drawn, None, CommunityParameters.model_validate({}), generators)


def collect_plan(drawn: DrawnRecipe, errors: ErrorList, stand_ins: frozenset[str] = frozenset()) -> Plan | None:
    """The plan of a drawn recipe, or None if `errors` has some now.

    Parameters
    ----------
    stand_ins : sections that are not the recipe's own: what depends on them is not checked.
    """
    had = len(errors.found)
    generators = generator_parameters(drawn, errors)
    for check, sections in _CHECKS_OF_THE_VIEW:
        if not sections & stand_ins:
            errors.attempt(check, drawn)
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
    community = drawn.recipe.community.parameters
    model_parameters = errors.attempt(drawn.parse, model.Parameters, community, ("community",))
    clothing = None
    if len(generators) == len(drawn.species) and "species" not in stand_ins:
        clothing = errors.attempt(clothing_of, drawn, model, generators)
    if model_parameters is not None:
        _check_community(drawn, model, model_parameters, errors, stand_ins)
    if len(errors.found) > had or model_parameters is None or clothing is None:
        return None
    return Plan(drawn, model, model_parameters, generators, clothing)


def _check_community(
    drawn: DrawnRecipe, model: object, parameters: CommunityParameters, errors: ErrorList, stand_ins: frozenset[str]
) -> None:
    """What the community's keys and those of other sections say of each other."""
    if "species" not in stand_ins:
        had = len(errors.found)
        for keys, name in parameters.named_species():
            errors.attempt(_check_named_species, drawn, keys, name)
        if len(errors.found) > had:
            stand_ins |= {"species"}
    for check, sections in _CHECKS_OF_THE_COMMUNITY:
        if not sections & stand_ins:
            errors.attempt(check, drawn, model, parameters)
    if "site" not in stand_ins:
        size_m = drawn.recipe.site.size_m
        errors.attempt(check_maps, parameters, size_m, lambda *keys: drawn.where("community", *keys))


def check_plan(loaded: LoadedRecipe, *, simulate_only: bool = False) -> Plan:
    """Check a recipe at the ends of all of its distributions; the plan of its first image.

    Raises
    ------
    RecipeError : see `make_plan`.
    ResourceError : more memory than this machine has free would be needed.
    """
    errors = ErrorList(loaded.sources.place(()).origin)
    plans = [collect_plan(drawn, errors) for drawn in loaded.probes()]
    errors.raise_all()
    for plan in plans:
        assert plan is not None
        check_memory(plan, simulate_only=simulate_only)
        if not simulate_only:
            _check_traits(plan)
            skeletons = capability(plan.model, OwnSkeletons)
            if skeletons is not None:
                skeletons.check_foliage(plan.drawn, plan.model_parameters, plan.module_parameters)
    assert plans[0] is not None
    return plans[0]


def why_barren(plan: Plan) -> str | None:
    """Why no plant can ever grow from this recipe, or None if some may: an empty site is no error, and no surprise."""
    reason: str | None = plan.model.why_barren(plan.model_parameters, plan.site, plan.ecologies)
    return reason


def views_below_ground(plan: Plan) -> list[str]:
    """Names of the cameras, or frames of a path, that stand below the ground, of those that may."""
    return [camera.name for _, camera, _ in below_ground(plan.drawn)]


def _check_named_species(drawn: DrawnRecipe, keys: Keys, name: str) -> None:
    if name not in drawn.species:
        raise RecipeError(
            "the recipe has no species of this name",
            where=drawn.where("community", *keys),
            expected="one of " + ", ".join(drawn.species),
            got=repr(name),
            hint=did_you_mean(name, drawn.species),
        )


def _check_disturbances(drawn: DrawnRecipe, model: object, parameters: CommunityParameters) -> None:
    """Times within the simulation, places on the site, planted radii that the species can have."""
    ground = Ground(drawn.recipe.site.size_m, parameters.periodic)
    for index, one in enumerate(parameters.disturbances):
        keys = ("community", "disturbances", index)
        step = one.step(parameters.step_yr)
        if step > parameters.steps:
            key, got = ("at_yr", f"{one.at_yr:g} years, in step {step}") if one.at_step is None else ("at_step", step)
            end_yr = parameters.steps * parameters.step_yr
            raise RecipeError(
                "the simulation ends before this happens",
                where=drawn.where(*keys, key),
                expected=f"at most step {parameters.steps}, which is year {end_yr:g}",
                got=str(got),
                hint="raise community.steps",
            )
        for beyond, point in one.off_site(ground):
            width, height = ground.size_m
            raise RecipeError(
                "this does not lie on the site",
                where=drawn.where(*keys, *beyond),
                expected=f"x from 0 to {width:g} and y from 0 to {height:g} metres",
                got=f"[{point[0]:g}, {point[1]:g}]",
            )
        if one.plant is not None and one.plant.radius_m is not None:
            largest = drawn.species[one.plant.species].ecology.max_radius_m
            if one.plant.radius_m > largest:
                raise RecipeError(
                    f"no {one.plant.species} is so large",
                    where=drawn.where(*keys, "plant", "radius_m"),
                    expected=f"at most ecology.max_radius_m = {largest:g} m",
                    got=f"{one.plant.radius_m:g} m",
                )


def _check_clouds(drawn: DrawnRecipe) -> None:
    """Clouds that can be made; and cameras below them, where their light comes from afar.

    Such clouds are traced apart from the plants, which a camera inside or above them would see through.
    """
    source = cloud_source_of(drawn)
    source.check(drawn)
    base_m = source.known_base_m(drawn)
    if base_m is None or drawn.recipe.render.clouds != "farfield":
        return
    for index, (section, cameras) in enumerate(zip(drawn.recipe.cameras, drawn_cameras(drawn), strict=True)):
        highest_m = max(camera.position_m[2] for camera in cameras)
        if highest_m >= base_m:
            later = section.path is not None and cameras[0].position_m[2] < base_m
            key = ("rig",) if section.position_m is None else ("path", "position_m") if later else ("position_m",)
            raise RecipeError(
                "the camera stands in or above the clouds",
                where=drawn.where("cameras", index, *key),
                expected=f"a height below sky.clouds.base_m = {base_m:g} m",
                got=f"{highest_m:g} m",
                hint="set render.clouds to exact; or lower the camera, raise base_m, or set sky.clouds to none",
            )


def _check_obstacles(drawn: DrawnRecipe, model: object, parameters: CommunityParameters) -> None:
    """Buildings on the site, and cameras outside of them."""
    obstacles = _obstacles(drawn, model, parameters)
    check_obstacles(drawn, obstacles)
    check_outside_of_houses(drawn, obstacles.entries)


def _check_models_own(drawn: DrawnRecipe, model: object, parameters: CommunityParameters) -> None:
    checks = capability(model, PlanChecks)
    if checks is not None:
        checks.check_recipe(drawn, parameters)


def _check_clouds_of_community(drawn: DrawnRecipe, model: object, parameters: CommunityParameters) -> None:
    cloud_source_of(drawn).check_community(drawn, model, parameters)


_CHECKS_OF_THE_VIEW: tuple[tuple[Callable[[DrawnRecipe], None], frozenset[str]], ...] = (
    (check_above_ground, frozenset({"cameras", "site"})),
    (_check_clouds, frozenset({"sky", "cameras", "render", "site"})),
    (check_sun, frozenset({"sky", "site"})),
)
_CommunityCheck = Callable[[DrawnRecipe, object, CommunityParameters], object]
_CHECKS_OF_THE_COMMUNITY: tuple[tuple[_CommunityCheck, frozenset[str]], ...] = (
    (_check_disturbances, frozenset({"species", "site"})),
    (_check_obstacles, frozenset({"species", "site"})),
    (_check_models_own, frozenset({"species", "site"})),
    (check_wet_soil, frozenset({"site"})),
    (_check_clouds_of_community, frozenset({"sky", "site"})),
)


def estimate_bytes(plan: Plan, *, simulate_only: bool = False, plants: int = 0) -> dict[str, int]:
    """Peak memory by what takes it: an upper estimate, without simulating.

    Parameters
    ----------
    plants : how many the scene will hold; before the simulation nobody knows, and their share is left out.
    """
    recipe = plan.drawn.recipe
    try:
        community = plan.model.estimate_bytes(plan.model_parameters, plan.site, plan.ecologies)
    except (RecipeError, ResourceError) as cause:
        raise _located(cause, plan.drawn) from cause
    if simulate_only:
        return {"community": community + _FILM_BYTES, "libraries": _LOADED_SIMULATOR_BYTES}
    pixels = max(camera.size_px[0] * camera.size_px[1] for camera in recipe.cameras)
    exact = recipe.sky.clouds.has_clouds and _may_be_exact(plan.drawn)
    per_plant = _BYTES_PER_PLANT + exact * _BYTES_PER_PLANT_UNDER_CLOUDS
    clouds_per_triangle = exact * _BYTES_PER_TRIANGLE_UNDER_CLOUDS
    per_triangle = _BYTES_PER_TRIANGLE + clouds_per_triangle
    own = own_triangles(plan.module_parameters, recipe.plants)
    across, along = (
        min(math.ceil((side + 40) / _GROUND_CELL_M), _MOST_GROUND_CELLS) + _GROUND_BEYOND for side in recipe.site.size_m
    )
    return {
        "community": community,
        "libraries": _LOADED_RENDERER_BYTES,
        "ground": 2 * across * along * per_triangle,
        "images": pixels * (_BYTES_PER_PIXEL + recipe.labels.samples * _BYTES_PER_SAMPLE),
        "exemplars": _exemplar_triangles(plan) * per_triangle + own * (_BYTES_PER_OWN_TRIANGLE + clouds_per_triangle),
        "plants": plants * per_plant,
        "clouds": cloud_source_of(plan.drawn).estimate_bytes(plan.drawn, plan.model, plan.model_parameters),
    }


def _located(cause: RecipeError | ResourceError, drawn: DrawnRecipe) -> RecipeError | ResourceError:
    """A model's error with the file and line of the key that it names: models know keys only."""
    keys = tuple(int(key) if key.isdigit() else key for key in (cause.where or "").split("."))
    if keys[0] != "community":
        return cause
    where = drawn.where(*keys)
    return type(cause)(cause.problem, where=where, expected=cause.expected, got=cause.got, hint=cause.hint)


def _may_be_exact(drawn: DrawnRecipe) -> bool:
    """Whether the light of a recipe with clouds may be traced through them; see `render.transport`."""
    from forestgen.render.cloud_shadow import GAP_OF_SITE, LEAST_GAP_M

    recipe, base_m = drawn.recipe, cloud_source_of(drawn).known_base_m(drawn)
    if recipe.render.clouds != "auto" or base_m is None:
        return recipe.render.clouds != "farfield"
    x_m, y_m = np.meshgrid(*(np.linspace(0.0, side_m, _GROUND_POINTS) for side_m in recipe.site.size_m))
    plants_m = max((species.mature_height_m for species in drawn.species.values()), default=0.0)
    tops_m = [float(height_field(drawn)(x_m, y_m).max()) + plants_m]
    tops_m += [camera.position_m[2] for cameras in drawn_cameras(drawn) for camera in cameras]
    return base_m < max(tops_m) + max(LEAST_GAP_M, GAP_OF_SITE * math.hypot(*recipe.site.size_m)) + _SURELY_FAR_M


def _exemplar_triangles(plan: Plan) -> int:
    """Triangles of all exemplars, as if each were a mature plant of its species; see `own_triangles` for the others."""
    section = plan.drawn.recipe.plants
    each = section.exemplars_per_species * section.variants_per_size * (_DETAIL_OF_ALL_LEVELS if section.levels else 1)
    total = 0.0
    for name, species in plan.drawn.species.items():
        if name not in plan.module_parameters and not is_built(species.plant.generator):
            has_crown = GENERATORS.load(species.plant.generator).has_crown
            width_m = float(species.allometry.width(species.ecology.max_radius_m)) if has_crown else 0.0
            total += most_triangles(species.mature_height_m, width_m)
    return int(each * total)


def _check_traits(plan: Plan) -> None:
    """Refuse a trait that the model's plants will not have: seen on a small piece of land before the first step."""
    traits = plan.drawn.recipe.plants.traits
    if not traits:
        return
    site = Site((min(plan.site.size_m[0], 50.0), min(plan.site.size_m[1], 50.0)))
    state = plan.model.init(plan.model_parameters.for_trial(), site, plan.ecologies, plan.drawn.image_seed)
    check_traits(traits, plan.model.population(state), plan.drawn.where("plants", "traits"))


def check_memory(plan: Plan, *, simulate_only: bool = False, plants: int = 0, room_bytes: int | None = None) -> None:
    """Raise `ResourceError` if the estimate does not fit into memory; see `estimate_bytes`.

    Parameters
    ----------
    room_bytes : memory that there is for it; None: what is free now.
    """
    free = int((free_bytes() if room_bytes is None else room_bytes) * _SHARE_OF_MEMORY)
    parts = estimate_bytes(plan, simulate_only=simulate_only, plants=plants)
    need = sum(parts.values())
    if need <= free:
        return
    largest = max(parts, key=lambda name: parts[name])
    where, hint = {
        "community": (("community",), plan.model_parameters.memory_hint),
        "ground": (("site", "size_m"), "make the site smaller"),
        "images": (("cameras",), "make the images smaller, or lower labels.samples"),
        "exemplars": (("plants", "exemplars_per_species"), "lower plants.exemplars_per_species or variants_per_size"),
        "plants": (("site", "size_m"), f"{plants:,} plants grew: make the site smaller, or stop after fewer steps"),
        "clouds": (("sky", "clouds"), "make the clouds' extent_m smaller, or their cells larger"),
        "libraries": ((), "close other programs"),
    }[largest]
    there = "is free" if room_bytes is None else "there is"
    raise ResourceError(
        f"this would need more memory than {there}, most of it for the {largest}",
        where=plan.drawn.where(*where),
        expected=f"at most {show_bytes(free)}",
        got=f"about {show_bytes(need)} ({largest}: {show_bytes(parts[largest])})",
        hint=hint,
    )


def check_own_triangles(plan: Plan, triangles: float) -> None:
    """Raise `ResourceError` if so many triangles of plants as themselves do not fit into the memory that is free."""
    free, need = int(free_bytes() * _SHARE_OF_MEMORY), int(triangles * _BYTES_PER_OWN_TRIANGLE)
    if need > free:
        raise ResourceError(
            "plants with branches of their own would need more memory than is free",
            where=plan.drawn.where("plants", "unique"),
            expected=f"at most {show_bytes(free)}",
            got=f"about {show_bytes(need)} for {triangles / 1e6:,.0f} million triangles",
            hint="set plants.unique to auto, or to a smaller number",
        )
