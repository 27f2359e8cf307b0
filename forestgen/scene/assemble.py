"""Population + exemplars + terrain -> instances and cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from forestgen.community.population import Population
from forestgen.core.randomness import child_rng
from forestgen.plants.exemplar import Exemplar
from forestgen.scene.projection import projection_of
from forestgen.scene.spec import Camera, Instances
from forestgen.scene.terrain import HeightField


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
    is_unique: NDArray[np.bool_] | None = None,
) -> Instances:
    """One instance a plant: its exemplar scaled to the plant's exact height and turned by the plant's own angle.

    The angle belongs to the plant_id, so a plant keeps it through time and whatever else grows beside it; a community
    that knows how its plants stand gives it in a column `azimuth_deg`, clockwise from north, NaN where it does not.

    `stands_for_m`: (E,) height of the plant whose own branches an exemplar has; NaN or None: the exemplar's height is
    that of its plants. `is_unique`: (E,) exemplars of one plant alone, whose branches know their neighbours: neither
    turned nor scaled.
    """
    heights = np.array([exemplar.height_m for exemplar in exemplars], dtype=np.float64)
    if stands_for_m is not None:
        heights = np.where(np.isnan(stands_for_m), heights, stands_for_m)
    scale = population.height_m / heights[exemplar_of_plant]
    angle = np.array([child_rng(seed, "plant", int(i)).random() for i in population.plant_id]) * 2 * np.pi
    if "azimuth_deg" in population.columns:
        turned = -np.radians(population.columns["azimuth_deg"].astype(np.float64))
        angle = np.where(np.isnan(turned), angle, turned)
    if is_unique is not None:
        own = is_unique[exemplar_of_plant]
        scale, angle = np.where(own, 1.0, scale), np.where(own, 0.0, angle)
    cos, sin = np.cos(angle) * scale, np.sin(angle) * scale
    zero = np.zeros_like(cos)
    rows = [[cos, -sin, zero], [sin, cos, zero], [zero, zero, scale]]
    transform = np.empty((len(population), 3, 4))
    for r in range(3):
        for c in range(3):
            transform[:, r, c] = rows[r][c]
    transform[:, :, 3] = population.position_m
    return Instances(
        exemplar=exemplar_of_plant.astype(np.uint32), transform=transform, plant_id=population.plant_id.copy()
    )


def pixel_size_m(
    cameras: Sequence[Camera],
    position_m: NDArray[np.float64],
    height_m: NDArray[np.float64],
    width_m: NDArray[np.float64],
) -> NDArray[np.float64]:
    """(N,) what a pixel covers of each plant, across, at its nearest point to the camera that sees it largest; metres.

    A plant behind a camera counts as if it were in front: its shadow may be in view.

    `position_m`: (N, 3) feet of the plants, world. `height_m`, `width_m`: (N,) of the upright cylinders that hold the
    plants.
    """
    finest = np.full(len(position_m), np.inf)
    for camera in cameras:
        x, y, z = camera.position_m
        away = np.hypot(position_m[:, 0] - x, position_m[:, 1] - y) - 0.5 * width_m
        above = np.maximum(z - (position_m[:, 2] + height_m), position_m[:, 2] - z)
        distance = np.hypot(np.maximum(away, 0.0), np.maximum(above, 0.0))
        finest = np.minimum(finest, projection_of(camera).finest_pixel_m(camera, distance))
    return finest
