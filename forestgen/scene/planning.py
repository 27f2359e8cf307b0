"""Everything that can be known to be wrong before anything is simulated."""

from __future__ import annotations

from forestgen.atmosphere.clouds.source import cloud_source_of
from forestgen.community.capabilities import HasObstacles, OwnSkeletons, PlanChecks, capability, models_with
from forestgen.community.disturbance import Ground
from forestgen.community.model import Site
from forestgen.community.placement.density_map import check_maps
from forestgen.community.plan import CommunityPlan
from forestgen.community.registry import COMMUNITY_MODELS
from forestgen.core.errors import ErrorList, RecipeError
from forestgen.plants.plan import PlantPlan, foliage_of, generator_parameters
from forestgen.recipe.load import DrawnRecipe, LoadedRecipe
from forestgen.recipe.registries import DATASET_FORMATS, LABEL_CHANNELS
from forestgen.recipe.sources import Keys
from forestgen.recipe.suggestions import did_you_mean
from forestgen.scene.exemplars import check_traits
from forestgen.scene.ground import check_wet_soil, community_site
from forestgen.scene.plan import Plan, check_memory
from forestgen.scene.sky import check_sun
from forestgen.scene.views import Views


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
    if not {"sky", "site"} & stand_ins:
        errors.attempt(check_sun, drawn)
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
            errors.attempt(_check_named_species, drawn, keys, name)
        if len(errors.found) > had:
            stand_ins |= {"species"}
    if "site" in stand_ins:
        return
    if "species" not in stand_ins:
        errors.attempt(_check_disturbances, plan)
    errors.attempt(_check_buildings, plan)
    own_checks = capability(plan.model, PlanChecks)
    if own_checks is not None and "species" not in stand_ins:
        errors.attempt(own_checks.check_recipe, drawn, parameters)
    errors.attempt(check_wet_soil, plan)
    if "sky" not in stand_ins:
        errors.attempt(cloud_source_of(drawn).check_community, drawn, plan.model, parameters)
    errors.attempt(check_maps, parameters, drawn.recipe.site.size_m, lambda *keys: drawn.where("community", *keys))


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


def _check_named_species(drawn: DrawnRecipe, keys: Keys, name: str) -> None:
    if name not in drawn.species:
        raise RecipeError(
            "the recipe has no species of this name",
            where=drawn.where("community", *keys),
            expected="one of " + ", ".join(drawn.species),
            got=repr(name),
            hint=did_you_mean(name, drawn.species),
        )


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


def _check_clouds(views: Views) -> None:
    """Clouds that can be made; and cameras below them, where their light comes from afar.

    Such clouds are traced apart from the plants, which a camera inside or above them would see through.
    """
    drawn, source = views.drawn, cloud_source_of(views.drawn)
    source.check(drawn)
    base_m = source.known_base_m(drawn)
    if base_m is None or drawn.recipe.render.clouds != "farfield":
        return
    for index, (section, cameras) in enumerate(zip(drawn.recipe.cameras, views.cameras, strict=True)):
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


def _check_buildings(plan: CommunityPlan) -> None:
    """A community that knows of buildings."""
    drawn = plan.drawn
    if drawn.recipe.site.buildings and capability(plan.model, HasObstacles) is None:
        raise RecipeError(
            "plants of this community would grow into the buildings",
            where=drawn.where("site", "buildings"),
            expected=f"community.model: {models_with(HasObstacles)}",
            got=drawn.recipe.community.model,
            hint="leave out site.buildings",
        )


def _check_traits(plan: Plan) -> None:
    """Refuse a trait that the model's plants will not have: seen on a small piece of land before the first step."""
    traits, community = plan.drawn.recipe.plants.traits, plan.community
    if traits:
        width_m, depth_m = community.site.size_m
        site = Site((min(width_m, 50.0), min(depth_m, 50.0)))
        parameters = community.parameters.for_trial()
        state = community.model.init(parameters, site, community.ecologies, plan.drawn.image_seed)
        check_traits(traits, community.model.population(state), plan.drawn.where("plants", "traits"))
