"""Triangles of the exemplars that a recipe needs, before anything is simulated or grown: for the estimate of memory.

Of each species there are as many exemplars as its recipe asks for, and no more than there are plants. Their heights lie
evenly between the least and the greatest height of its plants, on a ladder those of a library. Models that place plants
of given sizes say these heights (`AskedHeights`). In others, whose plants grow, all heights up to the mature one occur.
A plant's triangles follow from its height by the species' `triangles`, or else are those of `most_triangles`. Plants of
one age (`OneCohort`) may all be mature and, where they have thinned themselves out, broad and leafy.

Plants near a camera have meshes of their own (`near_foliage`), of at most so many triangles for each pixel of images.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from forestgen.community.capabilities import AskedHeights, OneCohort, capability
from forestgen.community.simulation import CommunityPlan
from forestgen.plants.levels import level_for
from forestgen.plants.near_foliage import near_pixel_m
from forestgen.plants.plan import PlantPlan
from forestgen.plants.registry import GENERATORS
from forestgen.plants.skeleton import most_triangles
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.species import Species
from forestgen.scene.exemplar_plan import SIZE_STEP
from forestgen.scene.phenology import leaf_states
from forestgen.scene.projection import projection_of
from forestgen.scene.spec import Camera

_MARGIN = 1.2  # heights are a guess, and plants of one height differ; without it the estimate is 1.0 to 1.53 times
_OF_BROAD_TREES = 1.85  # over those of trees in stands: measured on spruces of 18 m after self-thinning
_PER_PIXEL, _LEAST_NEAR, _MOST_NEAR = 4, 800_000, 4_000_000  # triangles of plants near a camera
LARGEST_ORGAN = 2.2  # factor on the size of its form
_OF_LEVELS = (1.0, 0.5, 0.3)  # triangles of a plant at each level of detail over those at the first; upper numbers


def exemplar_triangles(
    drawn: DrawnRecipe, plants: PlantPlan, community: CommunityPlan, cameras: Sequence[Camera]
) -> float:
    """About how many triangles all exemplars have, rather more than fewer; without plants with branches of their own.

    Open-grown plants may have more: see `plan.check_exemplars`.
    """
    section, states = drawn.recipe.plants, leaf_states(drawn)
    model, parameters = community.model, community.parameters
    cohort = capability(model, OneCohort)
    one_age = cohort is not None and cohort.is_cohort(parameters, community.site, community.ecologies)
    known = capability(model, AskedHeights)
    asked = {} if known is None else known.asked_heights_m(parameters, community.site, community.ecologies)
    most = model.expected_plants(parameters, community.site, community.ecologies)
    detail = _detail(cameras, community.site.size_m) if section.levels else 1.0
    total = 0.0
    for name, species in drawn.species.items():
        if name in plants.foliage or (known is not None and name not in asked and not parameters.disturbances):
            continue
        low_m, high_m = asked.get(name) or _grown_heights_m(species)
        count, on_ladder = section.exemplars_per_species, section.library is not None
        heights_m = np.full(count, high_m) if one_age else _heights(low_m, high_m, count, on_ladder=on_ladder)
        each = min(section.variants_per_size * len(states[name]), most / len(heights_m))
        total += each * (_OF_BROAD_TREES if one_age else 1.0) * float(triangles_of(species, heights_m).sum())
    return _MARGIN * total * detail


def most_near_triangles(cameras: Sequence[Camera]) -> int:
    """Of the meshes of all plants whose leaves have true size, at most."""
    pixels = sum(camera.size_px[0] * camera.size_px[1] for camera in cameras)
    return min(max(_PER_PIXEL * pixels, _LEAST_NEAR), _MOST_NEAR)


def near_triangles(
    drawn: DrawnRecipe, plants: PlantPlan, cameras: Sequence[Camera], size_m: tuple[float, float], ground_m: float
) -> int:
    """Triangles of plants near a camera, at most; 0 where every camera is too far away from all of the site.

    `ground_m`: the site's highest.
    """
    if not drawn.recipe.plants.near_foliage or drawn.recipe.plants.geometry == "silhouettes":
        return 0
    forms = [one.shapes for group in (plants.generators, plants.foliage) for one in group.values()]
    limit_m = max((LARGEST_ORGAN * near_pixel_m(shape) for one in forms for shape in one.values()), default=0.0)
    top_m = ground_m + max((one.mature_height_m for one in drawn.species.values()), default=0.0)
    for camera in cameras:
        x, y, z = camera.position_m
        aside = [max(-at, at - side, 0.0) for at, side in zip((x, y), size_m, strict=True)]
        distance_m = max(math.hypot(*aside, max(z - top_m, 0.0)), 1e-3)
        around = drawn.recipe.site.surroundings.kind != "open"
        distance_m = max(z - top_m, 1e-3) if around else distance_m
        if projection_of(camera).finest_pixel_m(camera, np.array([distance_m]))[0] < limit_m:
            return most_near_triangles(cameras)
    return 0


def _grown_heights_m(species: Species) -> tuple[float, float]:
    """Heights of a seedling and of a mature plant."""
    mature_m = species.mature_height_m
    return min(float(species.allometry.height(species.ecology.seedling_radius_m)), mature_m), mature_m


def triangles_of(species: Species, height_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N,) triangles of plants of heights, at full detail."""
    if species.triangles is not None:
        return np.asarray(np.interp(height_m, *np.array(species.triangles).T))
    width_m = np.zeros(len(height_m))
    if GENERATORS.load(species.plant.generator).has_crown:
        law = species.allometry.height_m
        width_m = species.allometry.width((height_m / law.scale) ** (1.0 / law.exponent))
    return np.array([most_triangles(*one) for one in zip(height_m.tolist(), width_m.tolist(), strict=True)])


def _heights(low_m: float, high_m: float, count: int, *, on_ladder: bool) -> NDArray[np.float64]:
    """Heights of a species' exemplars."""
    if not on_ladder:
        return np.asarray(low_m + (np.arange(count) + 0.5) / count * (high_m - low_m))
    steps = math.log(high_m / low_m) / math.log(SIZE_STEP)
    rungs = 1 + math.ceil(steps)  # of the ladder; see `rungs_of` for more than `count`
    if rungs <= count:
        return np.asarray(high_m / SIZE_STEP ** np.arange(rungs))
    return np.asarray(low_m * SIZE_STEP ** ((np.arange(count) + 0.5) / count * (steps + 1.0) - 0.5))


def _detail(cameras: Sequence[Camera], size_m: tuple[float, float]) -> float:
    """Triangles of a plant at all levels of detail that a site's plants may have, over those at the first."""
    finest, coarsest = math.inf, math.inf
    for camera in cameras:
        x, y, z = camera.position_m
        sides = tuple(zip((x, y), size_m, strict=True))
        nearest = math.hypot(*(max(-at, at - side, 0.0) for at, side in sides))
        farthest = math.hypot(*(max(abs(at), abs(side - at)) for at, side in sides))
        distance_m = np.array([nearest, math.hypot(farthest, z)])
        pixel_m = projection_of(camera).finest_pixel_m(camera, distance_m)
        finest, coarsest = min(finest, float(pixel_m[0])), min(coarsest, float(pixel_m[1]))
    first, last = level_for(np.array([finest, coarsest])).tolist()
    return sum(_OF_LEVELS[first : last + 1])
