"""Population -> exemplars -> scene."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.clouds.source import CloudRequest, cloud_source_of
from forestgen.community.population import Population
from forestgen.core.progress import Progress
from forestgen.core.randomness import child_rng
from forestgen.plants.build import size_m
from forestgen.plants.cache import LIBRARY_BYTES, MOST_BYTES, ExemplarRequest, exemplar_store
from forestgen.plants.exemplar import Exemplar
from forestgen.plants.growing import grow_exemplars
from forestgen.plants.levels import level_for, level_of_index
from forestgen.plants.registry import GENERATORS
from forestgen.plants.solids import as_solids
from forestgen.render.cloud_shadow import cloud_transport_of
from forestgen.scene.assemble import pixel_size_m, place_instances, stand_on
from forestgen.scene.camera_path import next_frame
from forestgen.scene.exemplar_plan import ExemplarPlan
from forestgen.scene.exemplars import (
    SizeError,
    check_traits,
    plan_exemplars,
    size_errors,
    with_levels,
)
from forestgen.scene.spec import Camera, SceneSpec
from forestgen.scene.terrain import HeightField, build_terrain
from forestgen.scene.trunks import Trunks
from forestgen.scene.wind import Sway, spec_at, sway_in
from forestgen.stages.exemplar_library import library_of, modelled_species, origin_of
from forestgen.stages.ground import height_field, wetness_of
from forestgen.stages.own_plants import species_seen
from forestgen.stages.own_requests import has_own, own_requests, plan_own_plants
from forestgen.stages.plan import Plan
from forestgen.stages.sky import sky_of
from forestgen.stages.surfaces import infrared_notes, materials_of
from forestgen.stages.views import check_outside_of_houses, check_trunks, drawn_cameras

MOST_CACHED_IMAGES = 16  # a data set of many images would only wash the cache out
Timer = Callable[[str], AbstractContextManager[None]]


@dataclass(frozen=True)
class BuiltScene:
    """A scene, the plants in it with their feet on the ground, and how well exemplars stand for them."""

    spec: SceneSpec  # in still air
    population: Population
    size_errors: list[SizeError]
    sway: Sway | None = None  # of the plants in the wind; None: still air
    notes: tuple[str, ...] = ()  # on cameras in trunks, and on surfaces whose infrared is unknown
    _posed: dict[float, SceneSpec] = field(default_factory=dict, repr=False, compare=False)  # by time, the last two

    def at(self, time_s: float) -> SceneSpec:
        """The scene as the wind holds its plants at a time; in still air `spec` itself, and one object for one time."""
        if self.sway is None:
            return self.spec
        if time_s not in self._posed:
            while len(self._posed) > 1:  # a frame and the next one, for its motion
                del self._posed[next(iter(self._posed))]
            self._posed[time_s] = spec_at(self.spec, self.sway, time_s)
        return self._posed[time_s]

    def next_view(self, camera: Camera) -> tuple[Camera, SceneSpec] | None:
        """The camera and the scene of the frame after `camera`'s in its sequence, if there is one."""
        following = next_frame(self.spec.cameras, camera)
        return None if following is None else (following, self.at(following.time_s))


def build_scene(plan: Plan, population: Population, progress: Progress, timer: Timer) -> BuiltScene:
    """Grow the exemplars, shape the ground, hang the clouds, place plants and cameras."""
    recipe, seed = plan.drawn.recipe, plan.drawn.image_seed
    simulated = population  # in the community's own frame: heights above the ground
    with timer("scene"):
        height = height_field(plan.drawn)
        population = stand_on(population, height)
        cameras = [camera for entry in drawn_cameras(plan.drawn) for camera in entry]  # walks do not go around yet
    with timer("plants"):
        exemplar_plan = choose_exemplars(plan, population, cameras)
        exemplars = grow_planned(plan, exemplar_plan, progress, population)
    with timer("clouds"):
        request = CloudRequest(plan.drawn, _lowest_m(plan, height), progress, plan, simulated)
        clouds = cloud_source_of(plan.drawn).grid(request)
    with timer("scene"):
        wetness = wetness_of(plan.drawn, plan.model, plan.model_parameters, population)
        terrain = build_terrain(height, child_rng(seed, "terrain", "colour"), recipe.site.ground, wetness)
        albedo = float(np.mean(terrain.far_reflectance))  # of the region, which the sky and the clouds see
        stands_for_m = np.full(len(exemplar_plan), np.nan)
        unique = exemplar_plan.plant >= 0
        stands_for_m[unique] = population.height_m[exemplar_plan.plant[unique]]
        instances = place_instances(
            plan.obstacles.turned(population),
            exemplar_plan.exemplar_of_plant,
            exemplars,
            seed,
            stands_for_m=stands_for_m,
            is_unique=exemplar_plan.is_unique,
        )
        trunks = Trunks(exemplars, instances)
        views = drawn_cameras(plan.drawn, trunks)
        materials = materials_of(species_seen(plan.drawn.species, population), recipe.plants.season)
        notes = [
            *check_trunks(plan.drawn, views, trunks),
            *check_outside_of_houses(plan.drawn, plan.obstacles.entries),
            *infrared_notes(materials, cameras),
        ]
        spec = SceneSpec(
            exemplars=exemplars,
            materials=materials,
            instances=instances,
            terrain=terrain,
            sky=sky_of(recipe, albedo),
            clouds=clouds,
            cameras=tuple(camera for entry in views for camera in entry),
        )
    cloud_transport_of(recipe.render.clouds, spec, spec.cameras, where=plan.drawn.where("render", "clouds"))
    with timer("scene"):
        sway = _sway(plan, spec)
    return BuiltScene(spec, population, _errors(plan, population, exemplar_plan, exemplars), sway, tuple(notes))


def _sway(plan: Plan, spec: SceneSpec) -> Sway | None:
    recipe = plan.drawn.recipe
    if recipe.wind.speed_m_per_s == 0:
        return None
    return sway_in(
        spec.instances,
        spec.exemplars,
        speed_m_per_s=recipe.wind.speed_m_per_s,
        gustiness=recipe.wind.gustiness,
        from_deg=recipe.site.wind_from_deg,
        seed=plan.drawn.image_seed,
    )


def _lowest_m(plan: Plan, height: HeightField) -> float:
    """Height of the site's lowest ground, where weather begins."""
    x, y = np.meshgrid(*(np.linspace(0.0, side, 65) for side in plan.drawn.recipe.site.size_m))
    return float(np.min(height(x, y)))


def choose_exemplars(plan: Plan, population: Population, cameras: Sequence[Camera]) -> ExemplarPlan:
    """Sizes, variants and levels of detail that the plants need.

    Raises
    ------
    RecipeError : a trait that the plants do not have.
    """
    section = plan.drawn.recipe.plants
    check_traits(section.traits, population, plan.drawn.where("plants", "traits"))
    pixel_m = None
    if len(population) and (section.levels or has_own(plan, population)):
        pixel_m = pixel_size_m(cameras, population.position_m, population.height_m, _widths_m(plan, population))
    given = {} if pixel_m is None else plan_own_plants(plan, population, pixel_m)
    chosen = plan_exemplars(
        population,
        section.exemplars_per_species,
        plan.drawn.image_seed,
        traits=section.traits,
        variants=section.variants_per_size,
        given=given,
        library=library_of(plan),
    )
    if not section.levels or pixel_m is None:
        return chosen
    own_height_m = np.ones(len(population))
    for index, name in enumerate(population.species_names):
        rows = population.species == index
        exemplar_radius_m = chosen.radius_m[chosen.exemplar_of_plant[rows]]
        own_height_m[rows] = modelled_species(plan, name).allometry.height(exemplar_radius_m)
    stand_in = chosen.plant[chosen.exemplar_of_plant]
    own_height_m = np.where(stand_in < 0, own_height_m, population.height_m[np.maximum(stand_in, 0)])
    scale = population.height_m / own_height_m  # of the instance
    return with_levels(chosen, level_for(pixel_m / scale))


def grow_planned(
    plan: Plan, exemplar_plan: ExemplarPlan, progress: Progress, population: Population | None = None
) -> tuple[Exemplar, ...]:
    """The exemplars of a plan; see `exemplar_requests`."""
    section = plan.drawn.recipe.plants
    kept = section.cache and (section.library is not None or plan.drawn.image_index < MOST_CACHED_IMAGES)
    with progress.stage("plants", len(exemplar_plan)) as advance:
        requests = exemplar_requests(plan, exemplar_plan, population)
        store = exemplar_store(MOST_BYTES if section.library is None else LIBRARY_BYTES) if kept else None
        grown = grow_exemplars(requests, store=store, advance=advance)
    grown = tuple(
        replace(one, is_unique=bool(unique)) for one, unique in zip(grown, exemplar_plan.is_unique, strict=True)
    )
    if section.geometry == "silhouettes":
        return tuple(_silhouette(request, one) for request, one in zip(requests, grown, strict=True))
    return grown


def _silhouette(request: ExemplarRequest, exemplar: Exemplar) -> Exemplar:
    """The plant's solid: of its generator's own curve where there is one, otherwise as wide as the plant grew."""
    profile_of = getattr(GENERATORS.load(request.parameters.generator), "crown_profile", None)
    size = size_m(request.species, request.radius_m)
    return as_solids(exemplar, None if profile_of is None else profile_of(request.parameters, *size))


def exemplar_requests(
    plan: Plan, exemplar_plan: ExemplarPlan, population: Population | None = None
) -> list[ExemplarRequest]:
    """What to grow. A plant's randomness belongs to its species, its cluster's rank and its variant, at any level.

    Parameters
    ----------
    population : of the plan, which plants that grew branches of their own are part of.
    """
    names = list(plan.drawn.species)
    own = {} if population is None else own_requests(plan, exemplar_plan, population)
    requests = []
    for index in range(len(exemplar_plan)):
        if index in own:
            requests.append(own[index])
            continue
        name = names[exemplar_plan.species[index]]
        seed, identity = origin_of(plan, name, int(exemplar_plan.rank[index]), int(exemplar_plan.variant[index]))
        requests.append(
            ExemplarRequest(
                species_name=name,
                species=modelled_species(plan, name),
                parameters=plan.generator_parameters[name],
                radius_m=float(exemplar_plan.radius_m[index]),
                seed=seed,
                identity=identity,
                level=level_of_index(int(exemplar_plan.level[index])),
                is_shared=plan.drawn.recipe.plants.library is not None,
            )
        )
    return requests


def _errors(
    plan: Plan, population: Population, exemplar_plan: ExemplarPlan, exemplars: tuple[Exemplar, ...]
) -> list[SizeError]:
    """Error of the approximation, each plant's width by its species' allometry.

    An exemplar with a plant's own branches has that plant's own size: leaves beyond its modules are no error.
    """
    widths_m, plant = _widths_m(plan, population), exemplar_plan.plant
    height_m, width_m = (
        np.where(plant < 0, made, grown[np.maximum(plant, 0)]) if len(population) else made
        for made, grown in (
            (np.array([exemplar.height_m for exemplar in exemplars]), population.height_m),
            (np.array([exemplar.crown_width_m for exemplar in exemplars]), widths_m),
        )
    )
    for index, name in enumerate(population.species_names):
        if not GENERATORS.load(plan.generator_parameters[name].generator).has_crown:
            widths_m[population.species == index] = np.nan
    return size_errors(population, exemplar_plan, height_m, width_m, widths_m)


def _widths_m(plan: Plan, population: Population) -> NDArray[np.float64]:
    """(N,) crown width of each plant by its species' allometry."""
    width = np.ones(len(population))
    for index, name in enumerate(population.species_names):
        rows = population.species == index
        radius_m = population.radius_m[rows]
        own = population.modules is not None and name in plan.module_parameters
        width[rows] = 2.0 * radius_m if own else plan.drawn.species[name].allometry.width(radius_m)
    return width
