"""Population -> exemplars -> scene."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass

import numpy as np

from forestgen.atmosphere.grid import CloudGrid
from forestgen.atmosphere.procedural import cumulus_field
from forestgen.community.population import Population
from forestgen.core.errors import RecipeError
from forestgen.core.frames import look_at
from forestgen.core.progress import Progress
from forestgen.core.randomness import child_rng
from forestgen.plants.build import build_exemplar
from forestgen.plants.exemplar import Exemplar
from forestgen.recipe.schema import Camera as CameraSection
from forestgen.recipe.species import Species
from forestgen.scene.assemble import place_instances, stand_on
from forestgen.scene.exemplars import ExemplarPlan, SizeError, plan_exemplars, size_errors
from forestgen.scene.spec import Camera, Material, SceneSpec, Sky
from forestgen.scene.terrain import HeightField, build_terrain, flat, rolling
from forestgen.stages.plan import Plan

Timer = Callable[[str], AbstractContextManager[None]]


@dataclass(frozen=True)
class BuiltScene:
    """A scene, the plants in it with their feet on the ground, and how well exemplars stand for them."""

    spec: SceneSpec
    population: Population
    size_errors: list[SizeError]


def build_scene(plan: Plan, population: Population, progress: Progress, timer: Timer) -> BuiltScene:
    """Grow the exemplars, shape the ground, hang the clouds, place plants and cameras."""
    recipe, seed = plan.drawn.recipe, plan.drawn.image_seed
    with timer("plants"):
        exemplar_plan = plan_exemplars(population, recipe.plants.exemplars_per_species, seed)
        exemplars = grow_exemplars(plan, exemplar_plan, progress)
    with timer("scene"):
        height = _height_field(plan)
        population = stand_on(population, height)
        cameras = tuple(place_camera(camera, height) for camera in recipe.cameras)
        terrain = build_terrain(height, child_rng(seed, "terrain", "colour"))
        albedo = float(np.mean(terrain.far_reflectance))  # of the region, which the sky and the clouds see
        sun = recipe.sky.sun
        spec = SceneSpec(
            exemplars=exemplars,
            materials=materials_of(plan.drawn.species),
            instances=place_instances(population, exemplar_plan.exemplar_of_plant, exemplars, seed),
            terrain=terrain,
            sky=Sky(sun.elevation_deg, sun.azimuth_deg, recipe.sky.turbidity, albedo),
            clouds=_clouds(plan),
            cameras=cameras,
        )
    _check_below_clouds(plan, spec)
    return BuiltScene(spec, population, _errors(plan, population, exemplar_plan, exemplars))


def _check_below_clouds(plan: Plan, spec: SceneSpec) -> None:
    """Plants, ground and cameras must stay below the clouds, which are traced apart from them."""
    if spec.clouds is None:
        return
    base_m = spec.clouds.low_m[2]
    highest = max(float(spec.terrain.mesh.vertices_m[:, 2].max()), *(camera.position_m[2] for camera in spec.cameras))
    if highest >= base_m:
        raise RecipeError(
            "ground or camera reaches into the clouds",
            where=plan.drawn.where("sky", "clouds", "base_m"),
            expected=f"a base above {highest:.0f} m",
            got=f"{base_m:g} m",
            hint="raise base_m, lower the camera, or flatten the terrain",
        )


def grow_exemplars(plan: Plan, exemplar_plan: ExemplarPlan, progress: Progress) -> tuple[Exemplar, ...]:
    """One plant a cluster of sizes; its randomness belongs to the species and the cluster's rank."""
    names = list(plan.drawn.species)
    grown = []
    rank: dict[str, int] = {}
    with progress.stage("plants", len(exemplar_plan.species)) as advance:
        for species_index, radius in zip(exemplar_plan.species, exemplar_plan.radius_m, strict=True):
            name = names[species_index]
            number = rank[name] = rank.get(name, -1) + 1
            rng = child_rng(plan.drawn.image_seed, "exemplar", name, number)
            species = plan.drawn.species[name]
            grown.append(build_exemplar(name, species, plan.generator_parameters[name], float(radius), rng))
            advance(1)
    return tuple(grown)


def materials_of(species: Mapping[str, Species]) -> dict[tuple[str, str], Material]:
    """Materials of all species by (species, material)."""
    return {
        (name, key): Material(m.reflectance, m.transmittance, m.roughness)
        for name, one in species.items()
        for key, m in one.materials.items()
    }


def _height_field(plan: Plan) -> HeightField:
    terrain = plan.drawn.recipe.site.terrain
    if terrain.kind == "flat":
        return flat(plan.drawn.recipe.site.size_m)
    rng = child_rng(plan.drawn.image_seed, "terrain", "height")
    return rolling(plan.drawn.recipe.site.size_m, terrain.amplitude_m, terrain.wavelength_m, rng)


def _clouds(plan: Plan) -> CloudGrid | None:
    recipe = plan.drawn.recipe
    clouds = recipe.sky.clouds
    if clouds.type == "none" or clouds.cover == 0:
        return None
    return cumulus_field(
        centre_m=(recipe.site.size_m[0] / 2, recipe.site.size_m[1] / 2),
        extent_m=clouds.extent_m,
        base_m=clouds.base_m,
        thickness_m=clouds.thickness_m,
        cover=clouds.cover,
        extinction_per_m=clouds.extinction_per_m,
        rng=child_rng(plan.drawn.image_seed, "clouds"),
    )


def place_camera(section: CameraSection, height: HeightField) -> Camera:
    """A recipe's camera in the world."""
    points = np.array([section.position_m, section.look_at_m], dtype=np.float64)
    if section.height_above_ground:
        points[:, 2] += height(points[:, 0], points[:, 1])
    x, y, z = (float(value) for value in points[0])
    return Camera(section.name, (x, y, z), look_at(points[0], points[1]), section.size_px, section.hfov_deg)


def _errors(
    plan: Plan, population: Population, exemplar_plan: ExemplarPlan, exemplars: tuple[Exemplar, ...]
) -> list[SizeError]:
    """Error of the approximation, each plant's width by its species' allometry."""
    width = np.ones(len(population))
    for index, name in enumerate(population.species_names):
        rows = population.species == index
        width[rows] = plan.drawn.species[name].allometry.width(population.radius_m[rows])
    return size_errors(
        population,
        exemplar_plan,
        np.array([exemplar.height_m for exemplar in exemplars]),
        np.array([exemplar.crown_width_m for exemplar in exemplars]),
        width,
    )
