"""Sizes of plants that are module graphs, for populations, statistics and allometries.

- Height: the highest node.
- Crown radius: half the nodes' horizontal extent, the mean of those along four directions 45 degrees apart.
- Trunk diameter: at 1.3 m, along the thickest way up; at the foot of plants that do not reach so high.
- Foot diameter: of the root node, before any fork.
- Wood volume: frusta along an axis, from one node's diameter to the next; a lateral's first segment is a cylinder.
- Leaf area: a layer of leaves that takes the share `opacity` of the light has, by Beer's law for leaves of all angles
  alike (extinction 1/2), the leaf area index -2 ln(1 - opacity). So much covers the disc of a grown module's sphere.
  By the pipe model (Shinozaki et al. 1964) a unit of pipes feeds a unit of leaves: the module's terminals have this
  area in proportion to their squared diameters, which rise from 0 as it grows. Leaves sit on the last shoots: a
  terminal that bears a module keeps the share that this has still to grow. An opacity over 0.99 counts as 0.99.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.architecture.geometry import Types, graphs, over_plants, packed
from forestgen.architecture.kernels import fill_sizes
from forestgen.architecture.modules import Modules
from forestgen.architecture.tables import Tables

_MOST_OPACITY = 0.99


@dataclass(frozen=True)
class PlantSizes:
    """Sizes of P plants; see the page."""

    height_m: NDArray[np.float32]  # (P,)
    crown_radius_m: NDArray[np.float32]  # (P,)
    trunk_diameter_m: NDArray[np.float32]  # (P,)
    foot_diameter_m: NDArray[np.float32]  # (P,)
    wood_volume_m3: NDArray[np.float64]  # (P,)
    leaf_area_m2: NDArray[np.float64]  # (P,) one-sided
    modules: NDArray[np.int64]  # (P,) number


def terminal_leaf_area_m2(tables: Tables) -> NDArray[np.float64]:
    """(T, S) one-sided leaf area of a terminal of thickness 1 of a grown module, m2."""
    index = -2.0 * np.log1p(-np.minimum(tables.opacity, _MOST_OPACITY))
    disc = np.pi * tables.sphere_radius_m[:, :, -1] ** 2
    pipes = np.where(tables.terminal_index >= 0, tables.thickness**2, 0.0).sum(axis=1)
    return np.asarray(index[:, None] * disc / pipes)


def plant_sizes(tables: Tables, modules: Modules, type_of_plant: Types) -> PlantSizes:
    """Sizes of all plants; `type_of_plant` (P,) indexes the tables' plant types."""
    shapes, plants = packed(tables), graphs(modules, type_of_plant)
    sizes = np.zeros((modules.plants, 6))
    leaf_area = terminal_leaf_area_m2(tables)

    def work(first: int, end: int) -> None:
        fill_sizes(shapes, plants, leaf_area, first, end, sizes)

    over_plants(modules, work)
    height, crown, trunk, foot = sizes[:, :4].astype(np.float32).T
    return PlantSizes(height, crown, trunk, foot, sizes[:, 4].copy(), sizes[:, 5].copy(), np.diff(modules.first))
