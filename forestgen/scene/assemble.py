"""Population + exemplars + terrain -> instances and cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from forestgen.community.population import Population
from forestgen.core.randomness import child_rng
from forestgen.plants.exemplar import Exemplar
from forestgen.scene.spec import Instances
from forestgen.scene.terrain import HeightField


def stand_on(population: Population, height: HeightField) -> Population:
    """The same plants with their feet on the terrain."""
    position = population.position_m.copy()
    position[:, 2] = height(position[:, 0], position[:, 1])
    return replace(population, position_m=position)


def place_instances(
    population: Population, exemplar_of_plant: NDArray[np.uint32], exemplars: Sequence[Exemplar], seed: int
) -> Instances:
    """One instance a plant: its exemplar scaled to the plant's exact height and turned by the plant's own angle.

    The angle belongs to the plant_id, so a plant keeps it through time and whatever else grows beside it.
    """
    heights = np.array([exemplar.height_m for exemplar in exemplars])
    scale = population.height_m / heights[exemplar_of_plant]
    angle = np.array([child_rng(seed, "plant", int(i)).random() for i in population.plant_id]) * 2 * np.pi
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
