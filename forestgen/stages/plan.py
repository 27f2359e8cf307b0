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

from forestgen.community.branch_modules.parameters import BranchModulesParameters
from forestgen.community.disturbance import Ground
from forestgen.community.ecology import SpeciesEcology
from forestgen.community.model import CommunityParameters, Site
from forestgen.community.placement.density_map import check_maps
from forestgen.community.placement.stands import PlacementParameters
from forestgen.community.registry import COMMUNITY_MODELS
from forestgen.core.error_list import ErrorList
from forestgen.core.errors import RecipeError, ResourceError
from forestgen.core.figures import show_bytes
from forestgen.core.memory import free_bytes
from forestgen.dataset.formats.format import load_format
from forestgen.plants.bark.texture import with_bark_tiles
from forestgen.plants.parameters import PlantParameters
from forestgen.plants.registry import GENERATORS
from forestgen.recipe.load import DrawnRecipe, LoadedRecipe
from forestgen.recipe.sources import Keys
from forestgen.recipe.species import Plant, Species
from forestgen.recipe.suggestions import did_you_mean
from forestgen.scene.exemplars import check_traits
from forestgen.stages.clouds import check_clouds, cloud_bytes, known_base_m
from forestgen.stages.ground import community_site
from forestgen.stages.module_checks import check_branch_modules, check_dead_are_drawn, is_built
from forestgen.stages.own_clouds import check_own_clouds, own_cloud_bytes
from forestgen.stages.own_plants import clothing_of, own_triangles
from forestgen.stages.sky import check_sun
from forestgen.stages.views import below_ground, check_above_ground, drawn_cameras
from forestgen.stages.wet_soil import check_wet_soil

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
# More of the same under clouds, by render.clouds: exact ones have scenes of their own.
_BYTES_PER_TRIANGLE_UNDER_CLOUDS = {"farfield": 0, "exact": 160, "auto": 160}
# Of a mature tree, over its height times its width squared: birch 380, poplar 300, spruce 280, besides those of any.
# Crowns that are wide for their height have fewer: pine 180, maple 80, beech 67, oak 64, which have 207,000 to 436,000.
_TRIANGLES_PER_M3, _TRIANGLES_OF_ANY = 360, 20_000
_WIDTH_OF_A_WIDE_CROWN, _TRIANGLES_OF_A_WIDE_CROWN, _TRIANGLES_PER_M3_OF_IT = 0.32, 230_000, 40
# Herbs and shrubs have more: bracken 49,000, bramble 25,000, and at most 199,000 and 174,000 in all.
_HIGHEST_SHRUB_M, _TRIANGLES_PER_M3_OF_A_SHRUB, _TRIANGLES_OF_A_SHRUB = 5.0, 50_000, 220_000
_DETAIL_OF_ALL_LEVELS = 2.0  # a size at every level of detail, against one with all detail
_BYTES_PER_PLANT = 7_000  # an instance in the scene; 500,000 of benchmarks/labels.py take 4 kB each
_BYTES_PER_PLANT_UNDER_CLOUDS = {"farfield": 0, "exact": 27_000, "auto": 27_000}
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
        return [_ecology(name, species) for name, species in self.drawn.species.items()]

    @property
    def steps(self) -> int:
        return self.model_parameters.steps


def _ecology(name: str, species: Species) -> SpeciesEcology:
    law = species.allometry.height_m
    return SpeciesEcology(
        name=name,
        height_scale=law.scale,
        height_exponent=law.exponent,
        modules=species.modules,
        **species.ecology.model_dump(),
    )


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


def collect_plan(drawn: DrawnRecipe, errors: ErrorList, stand_ins: frozenset[str] = frozenset()) -> Plan | None:
    """The plan of a drawn recipe, or None if `errors` has some now.

    Parameters
    ----------
    stand_ins : sections that are not the recipe's own: what depends on them is not checked.
    """
    had = len(errors.found)
    generators = {}
    for name, species in drawn.species.items():
        parameters = errors.attempt(_generator, drawn, species, species.plant, ("species", name, "plant"))
        if parameters is not None:
            generators[name] = parameters
    for check, sections in _CHECKS_OF_THE_VIEW:
        if not sections & stand_ins:
            errors.attempt(check, drawn)
    if not {"cameras", "labels", "dataset"} & stand_ins:
        for index, name in enumerate(drawn.recipe.dataset.formats):
            found = errors.attempt(load_format, name, where=drawn.where("dataset", "formats", index))
            if found is not None:
                errors.attempt(found.check, drawn)
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
        clothing = errors.attempt(clothing_of, drawn, generators, _generator)
    if model_parameters is not None:
        _check_community(drawn, model_parameters, errors, stand_ins)
    if len(errors.found) > had or model_parameters is None or clothing is None:
        return None
    return Plan(drawn, model, model_parameters, generators, clothing)


def _check_community(
    drawn: DrawnRecipe, parameters: CommunityParameters, errors: ErrorList, stand_ins: frozenset[str]
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
            errors.attempt(check, drawn, parameters)
    if "site" not in stand_ins:
        size_m = drawn.recipe.site.size_m
        errors.attempt(check_maps, parameters, size_m, lambda *keys: drawn.where("community", *keys))


def _generator(drawn: DrawnRecipe, species: Species, plant: Plant, keys: tuple[str, ...]) -> PlantParameters:
    generator = GENERATORS.load(plant.generator, where=drawn.where(*keys, "generator"))
    parameters: PlantParameters = drawn.parse(generator.Parameters, plant.parameters, keys)
    return with_bark_tiles(parameters, species.materials)


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
            check_dead_are_drawn(plan.drawn, plan.model_parameters, plan.module_parameters)
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


def _check_disturbances(drawn: DrawnRecipe, parameters: CommunityParameters) -> None:
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
    check_clouds(drawn)
    base_m = known_base_m(drawn.recipe.sky.clouds)
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


_CHECKS_OF_THE_VIEW: tuple[tuple[Callable[[DrawnRecipe], None], frozenset[str]], ...] = (
    (check_above_ground, frozenset({"cameras", "site"})),
    (_check_clouds, frozenset({"sky", "cameras", "render", "site"})),
    (check_sun, frozenset({"sky", "site"})),
)
_CHECKS_OF_THE_COMMUNITY: tuple[tuple[Callable[[DrawnRecipe, CommunityParameters], None], frozenset[str]], ...] = (
    (_check_disturbances, frozenset({"species", "site"})),
    (check_branch_modules, frozenset({"species", "site"})),
    (check_wet_soil, frozenset({"site"})),
    (check_own_clouds, frozenset({"sky", "site"})),
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
    cloudy = recipe.sky.clouds.type != "none"
    per_plant = _BYTES_PER_PLANT + cloudy * _BYTES_PER_PLANT_UNDER_CLOUDS[recipe.render.clouds]
    clouds_per_triangle = cloudy * _BYTES_PER_TRIANGLE_UNDER_CLOUDS[recipe.render.clouds]
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
        "clouds": own_cloud_bytes(plan.drawn, plan.model_parameters)
        if recipe.sky.clouds.type == "community"
        else cloud_bytes(plan.drawn),
    }


def _located(cause: RecipeError | ResourceError, drawn: DrawnRecipe) -> RecipeError | ResourceError:
    """A model's error with the file and line of the key that it names: models know keys only."""
    keys = tuple(int(key) if key.isdigit() else key for key in (cause.where or "").split("."))
    if keys[0] != "community":
        return cause
    where = drawn.where(*keys)
    return type(cause)(cause.problem, where=where, expected=cause.expected, got=cause.got, hint=cause.hint)


def _exemplar_triangles(plan: Plan) -> int:
    """Triangles of all exemplars, as if each were a mature plant of its species; see `own_triangles` for the others."""
    section = plan.drawn.recipe.plants
    each = section.exemplars_per_species * section.variants_per_size * (_DETAIL_OF_ALL_LEVELS if section.levels else 1)
    species = (one for name, one in plan.drawn.species.items() if name not in plan.module_parameters)
    return int(each * sum(mature_triangles(one) for one in species if not is_built(one)))


def mature_triangles(species: Species) -> float:
    """Of a mature plant: an upper estimate by its size, the shape of its crown, and whether it has one."""
    height_m = species.mature_height_m
    width_m = float(species.allometry.width(species.ecology.max_radius_m))
    box_m3 = height_m * width_m**2
    if height_m <= _HIGHEST_SHRUB_M and GENERATORS.load(species.plant.generator).has_crown:
        return max(_TRIANGLES_OF_ANY, min(_TRIANGLES_PER_M3_OF_A_SHRUB * box_m3, _TRIANGLES_OF_A_SHRUB))
    more = _TRIANGLES_PER_M3 * box_m3
    if width_m > _WIDTH_OF_A_WIDE_CROWN * height_m:
        more = min(more, _TRIANGLES_OF_A_WIDE_CROWN + _TRIANGLES_PER_M3_OF_IT * box_m3)
    return _TRIANGLES_OF_ANY + more


def _check_traits(plan: Plan) -> None:
    """Refuse a trait that the model's plants will not have: seen on a small piece of land before the first step."""
    traits = plan.drawn.recipe.plants.traits
    if not traits:
        return
    site = Site((min(plan.site.size_m[0], 50.0), min(plan.site.size_m[1], 50.0)))
    parameters, species = plan.model_parameters, plan.ecologies
    if isinstance(parameters, PlacementParameters):  # its numbers are those of the whole site, and all plants are alike
        parameters, species = parameters.model_copy(update={"plants": {}}), []
    state = plan.model.init(parameters, site, species, plan.drawn.image_seed)
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
        "community": (("community",), _hint_of(plan.model_parameters)),
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


def _hint_of(parameters: CommunityParameters) -> str:
    """How a community takes less memory."""
    if isinstance(parameters, PlacementParameters):
        grids = [f", or fewer community.{name}" for name in ("cells", "pixels") if hasattr(parameters, name)]
        return "".join(["ask for fewer plants in community.plants", *grids])
    if isinstance(parameters, BranchModulesParameters):
        cells = "community.soil_water.cell_m larger, " if hasattr(parameters, "soil_water") else ""
        return f"make the site smaller, {cells}or lower community.most_modules"
    return "make the site smaller, or lower species' seedlings_per_ha_per_yr"
