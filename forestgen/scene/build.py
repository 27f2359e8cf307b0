"""Population -> exemplars -> scene."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.clouds.cirrus import below_cirrus
from forestgen.atmosphere.clouds.source import CloudRequest, cloud_source_of
from forestgen.community.population import Population
from forestgen.core.errors import RecipeError
from forestgen.core.progress import Progress
from forestgen.core.randomness import child_rng
from forestgen.plants.exemplar import Exemplar
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.phenology import SUMMER, fallen_lately
from forestgen.scene import bark_tones
from forestgen.scene.blocks import Stands
from forestgen.scene.building import building_materials
from forestgen.scene.exemplar_plan import TREE_SIZES, ExemplarPlan
from forestgen.scene.exemplars import SizeError
from forestgen.scene.ground_cover import ground_cover
from forestgen.scene.growth import choose_exemplars, errors_of_sizes, grow_planned, species_seen
from forestgen.scene.leaf_variation import vary_leaves
from forestgen.scene.lying import laid_along_y, lying_plants, on_the_ground
from forestgen.scene.near_foliage import leaves_of, with_near_plants
from forestgen.scene.phenology import colour_stages, inside_first, leaf_states
from forestgen.scene.plan import Plan
from forestgen.scene.site import sky_of, sun_notes, wetness_of
from forestgen.scene.snow_depth import Circles, FinerGround
from forestgen.scene.spec import Camera, Instances, Material, SceneSpec, Terrain
from forestgen.scene.surfaces import FreshLitter, fresh_litter, infrared_notes, materials_of, surface_of
from forestgen.scene.surroundings import Layer, SurroundedStand, layers_around, surrounded
from forestgen.scene.terrain import HeightField, build_terrain
from forestgen.scene.tree_exemplars import instance_scales, tree_sizes_of
from forestgen.scene.trunks import Trunks
from forestgen.scene.views import check_trunks, drawn_cameras, next_frame
from forestgen.scene.water_surface import with_land, with_water
from forestgen.scene.weather.kind import has_relief, in_weather, laid_m, weather_notes
from forestgen.scene.wind import Sway, spec_at, sway_in

Timer = Callable[[str], AbstractContextManager[None]]
_STEM_BASE_M = 0.5  # height up to which stems stand in snow
_NO_STEMS = np.zeros((0, 2)), np.zeros(0)
_MOST_TURN_RAD = np.pi / 3.0  # to either side, of a tree that has a weather side


@dataclass(frozen=True)
class BuiltScene:
    """A drawn recipe, simulated and assembled: the scene, and the plants in it with their feet on the ground."""

    plan: Plan
    spec: SceneSpec  # in still air
    population: Population
    size_errors: list[SizeError]  # how well exemplars stand for the plants
    sway: Sway | None = None  # of the plants in the wind; None: still air
    notes: tuple[str, ...] = ()  # for people: of the community, on cameras in trunks, and on unknown infrared
    labelled: Population | None = None  # with the plants outside of the site that have a plant_id; None: the same
    repeated: NDArray[np.intp] | None = None  # (K,) row of the plant that each plant of the site or near it repeats
    _posed: dict[float, SceneSpec] = field(default_factory=dict, repr=False, compare=False)  # by time, the last two

    @property
    def drawn(self) -> DrawnRecipe:
        return self.plan.drawn

    def at(self, time_s: float) -> SceneSpec:
        """The scene as the wind holds its plants at a time; in still air `spec` itself, and one object for one time."""
        if time_s not in self._posed:
            while len(self._posed) > 1:  # a frame and the next one, for its motion
                del self._posed[next(iter(self._posed))]
            self._posed[time_s] = spec_at(self.spec, self.sway, time_s)
        return self._posed[time_s]

    def next_view(self, camera: Camera) -> tuple[Camera, SceneSpec] | None:
        """The camera and the scene of the frame after `camera`'s in its sequence, if there is one."""
        following = next_frame(self.spec.cameras, camera)
        return None if following is None else (following, self.at(following.time_s))


def build_scene(plan: Plan, simulated: Population, progress: Progress, timer: Timer) -> BuiltScene:
    """Grow the exemplars, shape the ground, hang the clouds, place plants and cameras.

    `simulated`: the plants, heights above the ground.
    """
    drawn, recipe, stand = plan.drawn, plan.drawn.recipe, plan.community
    with timer("scene"):
        simulated, kept_off = off_paths_and_water(plan, simulated)
        height = plan.views.height
        population = stand_on(simulated, height)
        stands = _stands(plan)
        layers = _layers(plan, population, stands)
    with timer("plants"):
        chosen = choose_exemplars(plan, population, plan.views.all_cameras, layers)
        exemplars = grow_planned(plan, chosen, progress, population)
    with timer("clouds"):
        request = CloudRequest(drawn, plan.views.lowest_m, progress, stand, simulated)
        clouds = below_cirrus(request, cloud_source_of(drawn).grid(request))
    with timer("scene"):
        lying = lying_plants(population)
        instances = _instances(plan, population, chosen, exemplars)
        plant = chosen.first_plant(population.plant_id)
        base_materials = _materials(plan, population)
        varied = vary_leaves(
            exemplars, base_materials, plant, drawn.image_seed, colour_stages(drawn), inside_first(drawn)
        )
        site = SurroundedStand.of(population, instances, *varied)
        labelled = recipe.site.surroundings.labelled
        around = surrounded(site, layers, height, drawn.image_seed, labelled)
        around = _on_slopes(around, lying, population.height_m, height)
        population = replace(population, position_m=around.population.position_m[: len(population)])
        trunks = Trunks(exemplars, around.plants)
        views = drawn_cameras(drawn, trunks)
        stems = Circles(*(trunks.circles_m(_STEM_BASE_M) if recipe.weather else _NO_STEMS))
        terrain = _with_clearings(_terrain(plan, population, around.reach_m, stems, views), stands, height)
        spec = SceneSpec(
            exemplars=around.exemplars,
            materials=around.materials,
            instances=around.instances,
            terrain=terrain,
            sky=sky_of(recipe, float(np.mean(terrain.far_reflectance))),  # the region, which sky and clouds see
            clouds=clouds,
            cameras=tuple(camera for entry in views for camera in entry),
            bark_spread=bark_tones.SPREAD,
        )
        ground = ground_cover(plan, population, spec.cameras)
        spec = ground.on(with_near_plants(spec, leaves_of(plan, chosen, exemplars), recipe.time_of_year))
        spec = with_water(spec, height, recipe.wind.speed_m_per_s, drawn.image_seed)
        spec, in_snow = _in_weather(plan, spec, stems, views)
        known = (*simulated.notes, *kept_off, *ground.notes, *weather_notes(drawn))
        notes = [*_notes(plan, known), *check_trunks(drawn, views, trunks), *in_snow]
        notes += [*plan.views.check_outside_of_buildings(), *infrared_notes(base_materials, plan.views.all_cameras)]
        sway = _sway(drawn, instances, exemplars, around)
    errors = errors_of_sizes(plan, population, chosen, exemplars)
    repeated = around.source[: len(around.plants)] if recipe.site.surroundings.kind == "repeat" else None
    return BuiltScene(plan, spec, population, errors, sway, tuple(dict.fromkeys(notes)), around.population, repeated)


def _instances(plan: Plan, population: Population, chosen: ExemplarPlan, exemplars: Sequence[Exemplar]) -> Instances:
    """The plants of the site."""
    return place_instances(
        plan.community.obstacles.turned(population),
        chosen.exemplar_of_plant,
        exemplars,
        plan.drawn.image_seed,
        stands_for_m=np.where(chosen.dead > 0, chosen.tree[:, 0], chosen.stands_for(population.height_m)),
        tree=chosen.tree,
        is_unique=chosen.is_unique,
    )


def _in_weather(plan: Plan, spec: SceneSpec, stems: Circles, views: list[list[Camera]]) -> tuple[SceneSpec, list[str]]:
    """The scene in its weather, and notes on cameras in snow that lies. Raises `RecipeError` for those."""
    drawn, height = plan.drawn, plan.views.height
    notes = []
    if has_relief(drawn):
        laid = partial(laid_m, spec, drawn, height, stems)
        notes = replace(plan.views, cameras=views, laid_m=laid).check_above_ground()
    return in_weather(spec, drawn, height, stems), notes


def _notes(plan: Plan, known: Sequence[str]) -> list[str]:
    """What is known of an image's community, ground and sun."""
    return [f"image {plan.drawn.image_index}: {note}" for note in (*known, *sun_notes(plan.drawn.recipe))]


def _on_slopes(
    around: SurroundedStand, lying: NDArray[np.bool_], length_m: NDArray[np.float64], height: HeightField
) -> SurroundedStand:
    """With fallen trees, of the site and near it, on the slope of their ground. `length_m`: (N,) of the site's."""
    near, known = around.source[: len(around.plants)], len(around.population)
    instances = on_the_ground(around.instances, lying[near], length_m[near], height)
    position_m = around.population.position_m.copy()
    position_m[:, 2] = np.where(lying[near[:known]], instances.transform[:known, 2, 3], position_m[:, 2])
    return replace(around, instances=instances, population=replace(around.population, position_m=position_m))


def _sway(
    drawn: DrawnRecipe, instances: Instances, exemplars: Sequence[Exemplar], around: SurroundedStand
) -> Sway | None:
    """How the wind moves the plants; None in a calm."""
    wind = drawn.recipe.wind
    if wind.speed_m_per_s <= 0:
        return None
    own = sway_in(
        instances,
        exemplars,
        speed_m_per_s=wind.speed_m_per_s,
        gustiness=wind.gustiness,
        from_deg=drawn.recipe.site.wind_from_deg,
        seed=drawn.image_seed,
    )
    return around.sway(own)


def _stands(plan: Plan) -> Stands | None:
    """Of the land around the site."""
    is_forest = plan.drawn.recipe.site.surroundings.kind == "forest"
    return Stands.drawn(child_rng(plan.drawn.image_seed, "surroundings", "stands")) if is_forest else None


def _layers(plan: Plan, population: Population, stands: Stands | None) -> tuple[Layer, ...]:
    """What the recipe says to be around the site: no buildings."""
    kind, seed = plan.drawn.recipe.site.surroundings.kind, plan.drawn.image_seed
    if kind == "open":
        return ()
    rows = np.setdiff1d(np.arange(len(population)), list(plan.community.obstacles.rows_of(population)))
    rng = child_rng(seed, "surroundings") if kind == "forest" else None
    return layers_around(population, rows, plan.views.height, rng, plan.views.all_cameras, stands)


def _terrain(
    plan: Plan, population: Population, reach_m: float, stems: Circles, views: Sequence[Sequence[Camera]]
) -> Terrain:
    """The ground. `reach_m`: how far from the site's edge the stand goes on. `views`: cameras, on their ways."""
    height, kind, seed = plan.views.height, plan.drawn.recipe.site.ground.kind, plan.drawn.image_seed
    wetness, fresh = wetness_of(plan.community, population), _fresh_litter(plan, population)
    meshed = height
    if has_relief(plan.drawn):
        eyes_m = np.array([camera.position_m for entry in views for camera in entry])
        meshed = FinerGround(height.size_m, height, stems, eyes_m)
    terrain = build_terrain(meshed, child_rng(seed, "terrain", "colour"), kind, wetness, reach_m, fresh)
    return with_land(terrain, height, plan.drawn.recipe.wind.speed_m_per_s, seed)


def _with_clearings(terrain: Terrain, stands: Stands | None, height: HeightField) -> Terrain:
    """The ground with the colour of the distance in clearings."""
    if stands is None:
        return terrain
    x, y = terrain.mesh.vertices_m[:, :2].T.astype(np.float64)
    is_clear = stands.relative_height(x, y, height.distance_m(x, y)) == 0
    return replace(terrain, far_share=np.where(is_clear, np.float32(1.0), terrain.far_share))


def _fresh_litter(plan: Plan, population: Population) -> FreshLitter | None:
    """Of trees whose leaf area is known."""
    columns, known, time = population.columns, plan.drawn.species, plan.drawn.recipe.time_of_year
    area_m2 = np.nan_to_num(columns["leaf_area_m2"]) if "leaf_area_m2" in columns else np.zeros(len(population))
    site_m2 = plan.community.site.area_ha * 1e4
    return fresh_litter(
        known,
        {
            name: fallen_lately(known[name].phenology, time) * float(area_m2[population.species == k].sum()) / site_m2
            for k, name in enumerate(population.species_names)
            if name in known
        },
    )


def _materials(plan: Plan, population: Population) -> dict[tuple[str, str], Material]:
    """Of the species and the buildings."""
    materials = materials_of(species_seen(plan.drawn.species, population), leaf_states(plan.drawn))
    for (kind, key), one in building_materials(plan.community.obstacles.entries).items():
        materials[kind, key] = surface_of(one, SUMMER, f"{kind}/{key}")
    return materials


def off_paths_and_water(plan: Plan, population: Population) -> tuple[Population, tuple[str, ...]]:
    """The plants that stand neither in water nor on paths, and a note on the others.

    Raises `RecipeError`: plants with branches of their own among those, which lean on their neighbours.
    """
    barred = plan.views.height.barred(*population.position_m[:, :2].T)
    if not barred.any():
        return population, ()
    if population.modules is not None:
        keys, where = ("water" if plan.drawn.recipe.site.water else "paths"), plan.drawn.where
        problem, got = "plants of this community grow there", f"{int(barred.sum())} plants"
        hint = "bar them by a map of its soil, or choose another community.model"
        raise RecipeError(problem, where=where("site", keys), expected="no plant there", got=got, hint=hint)
    note = f"{int(barred.sum())} of {len(population)} plants would stand in water or on a path: they are left out"
    return population.at(~barred), (note,)


def stand_on(population: Population, height: HeightField) -> Population:
    """The same plants with their feet on the terrain."""
    position = population.position_m.copy()
    position[:, 2] = height(position[:, 0], position[:, 1])
    return replace(population, position_m=position)


def place_instances(
    population: Population,
    exemplar_of_plant: NDArray[np.uint32],
    exemplars: Sequence[Exemplar],
    seed: int,
    *,
    stands_for_m: NDArray[np.float64] | None = None,
    tree: NDArray[np.float64] | None = None,
    is_unique: NDArray[np.bool_] | None = None,
) -> Instances:
    """One instance a plant: its exemplar scaled to the plant's exact height, a tree's also across, and turned by the
    plant's own angle.

    The angle belongs to the plant_id, so a plant keeps it through time and whatever else grows beside it; a community
    that knows how its plants stand gives it in a column `azimuth_deg`, clockwise from north, NaN where it does not. A
    tree that lies points there. Trees with a weather side are turned by at most a sixth of a circle.

    Parameters
    ----------
    stands_for_m : (E,) height of the plant whose own branches an exemplar has, or of the dead tree that it is; NaN or
        None: the exemplar's height is that of its plants.
    tree : (E, 5) sizes that trees were built to, see `ExemplarPlan.tree`; None: there are none.
    is_unique : (E,) exemplars of one plant alone, whose branches know their neighbours: neither turned nor scaled.
    """
    heights = np.array([exemplar.height_m for exemplar in exemplars], dtype=np.float64)
    if stands_for_m is not None:
        heights = np.where(np.isnan(stands_for_m), heights, stands_for_m)
    made = np.full((len(exemplars), TREE_SIZES), np.nan) if tree is None else tree
    sizes = tree_sizes_of(population)
    scale, across = instance_scales(sizes, population.height_m, exemplar_of_plant, heights, made)
    angle = np.array([child_rng(seed, "plant", int(i)).random() for i in population.plant_id]) * 2 * np.pi
    weather = np.array([exemplar.has_weather_side for exemplar in exemplars], dtype=np.bool_)[exemplar_of_plant]
    angle = np.where(weather, (angle / np.pi - 1.0) * _MOST_TURN_RAD, angle)
    if "azimuth_deg" in population.columns:
        turned = -np.radians(population.columns["azimuth_deg"].astype(np.float64))
        angle = np.where(np.isnan(turned), angle, turned)
    if is_unique is not None:
        own = is_unique[exemplar_of_plant]
        scale, across, angle = np.where(own, 1.0, scale), np.where(own, 1.0, across), np.where(own, 0.0, angle)
    cos, sin = np.cos(angle) * across, np.sin(angle) * across
    zero = np.zeros_like(cos)
    transform = np.empty((len(population), 3, 4))
    transform[:, :, :3] = np.array([[cos, -sin, zero], [sin, cos, zero], [zero, zero, scale]]).transpose(2, 0, 1)
    transform[:, :, 3] = population.position_m
    return Instances(
        exemplar=exemplar_of_plant.astype(np.uint32),
        transform=laid_along_y(transform, lying_plants(population)),
        plant_id=population.plant_id.copy(),
    )
