"""Trees that lie: which of a population do, and how their instances follow the ground.

An exemplar that lies does so along its own +y (`plants.dead_tree`). Its instance is turned so that y runs along the
line through the heights of the ground under the stem (least squares) and x along the ground across it; where the ground
rises above the line, the stem is lowered by half of that.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from forestgen.community.population import Population, Status
from forestgen.core.dead_wood import UNKNOWN_CLASS, DeadForm, are_lying, dead_codes
from forestgen.geometry.mesh import unit
from forestgen.scene.spec import Instances
from forestgen.scene.terrain import HeightField

_STATIONS = 9  # along a stem
_ACROSS_M = 0.5  # to each side, where the ground's slope across is measured
_LOWERED = 0.5  # of what the ground rises above the line

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


def dead_codes_of(population: Population) -> Ints:
    """(N,) `core.dead_wood.dead_codes` of the plants; 0: alive, or a plant with dead branches of its own."""
    columns = population.columns
    if "dead_form" in columns:
        return dead_codes(columns["dead_form"], columns["decay_class"])
    dead = population.status == Status.DEAD
    if population.modules is not None:
        dead &= np.diff(population.modules.first) == 0
    return dead_codes(np.where(dead, DeadForm.STANDING, 0), np.full(len(population), UNKNOWN_CLASS))


def lying_plants(population: Population) -> Bools:
    """(N,) which plants lie on the ground."""
    if "dead_form" not in population.columns:
        return np.zeros(len(population), dtype=np.bool_)
    return are_lying(population.columns["dead_form"])


def laid_along_y(transform: Floats, lying: Bools) -> Floats:
    """(N, 3, 4) transforms whose scale of lengths is that of y, not of z, where a plant lies."""
    across, along = (np.linalg.norm(transform[lying, :, k], axis=1)[:, None] for k in (1, 2))
    made = transform.copy()
    made[lying, :, 1] *= along / across
    made[lying, :, 2] *= across / along
    return made


def on_the_ground(instances: Instances, lying: Bools, length_m: Floats, height: HeightField) -> Instances:
    """The instances, those that lie on the ground's slope.

    `lying`, `length_m`: (M,) of the first M instances, which stand upright so far; the others stay.
    """
    rows = np.flatnonzero(lying)
    if not len(rows):
        return instances
    own = instances.transform[rows]
    scale = np.linalg.norm(own[:, :, :3], axis=1)
    along = own[:, :2, 1] / np.linalg.norm(own[:, :2, 1], axis=1)[:, None]
    across = np.stack([along[:, 1], -along[:, 0]], axis=1)
    at = np.linspace(0.0, 1.0, _STATIONS) * length_m[rows, None]
    x, y = (own[:, k, 3, None] + at * along[:, k, None] for k in (0, 1))
    ground = height(x, y)
    middle = at.mean(axis=1, keepdims=True)
    spread = np.maximum(np.sum((at - middle) ** 2, axis=1), 1e-9)
    slope = np.sum((at - middle) * ground, axis=1) / spread
    foot_m = ground.mean(axis=1) - slope * middle[:, 0]
    line = foot_m[:, None] + slope[:, None] * at
    foot_m -= _LOWERED * np.maximum(line - ground, 0.0).max(axis=1)
    beside = [height(x + k * across[:, :1], y + k * across[:, 1:]).mean(axis=1) for k in (_ACROSS_M, -_ACROSS_M)]
    rise = (beside[0] - beside[1]) / (2.0 * _ACROSS_M)
    axis_y = unit(np.column_stack([along, slope]))
    side = np.column_stack([across, rise])
    axis_x = unit(side - np.sum(side * axis_y, axis=1)[:, None] * axis_y)
    axes = np.stack([axis_x, axis_y, np.cross(axis_x, axis_y)], axis=2)
    transform = instances.transform.copy()
    transform[rows, :, :3] = axes * scale[:, None, :]
    transform[rows, 2, 3] = foot_m
    return replace(instances, transform=transform)
