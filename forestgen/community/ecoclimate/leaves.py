"""How much leaf stands over each cell of the ground (seeds 002, section 4.5.6: the density of plants)."""

from __future__ import annotations

import numpy as np

from forestgen.architecture.geometry import spheres
from forestgen.architecture.sizes import full_leaf_area_m2
from forestgen.community.branch_modules.kinds import kinds_at
from forestgen.community.branch_modules.state import State
from forestgen.community.branch_modules.vigour import stature_of
from forestgen.community.soil_water.ground import Floats, Ground


def leaf_area_index(forest: State, ground: Ground) -> Floats:
    """(rows, cols) one-sided leaf area over the area of each cell: of the modules whose middle is over it.

    Leaves that hang beyond a bounded site's edge count for the cell at the edge.
    """
    kinds, modules, plants = kinds_at(forest), forest.modules, forest.plants
    rows, cols = ground.shape
    if not len(modules):
        return np.zeros(ground.shape)
    counts = np.diff(modules.first)
    species = np.repeat(plants.species, counts)
    area_m2 = full_leaf_area_m2(kinds.tables)[species, modules.prototype]
    area_m2 = area_m2 * stature_of(modules, plants.species, kinds.tables, kinds.traits).leaves
    centre, _ = spheres(kinds.tables, modules, plants.species)
    place = np.repeat(plants.position_m, counts, axis=0) + centre[:, :2]
    cell = []
    for axis, count in ((1, rows), (0, cols)):
        at = np.floor(place[:, axis] / ground.size_m[axis] * count).astype(np.int64)
        cell.append(at % count if ground.periodic else np.clip(at, 0, count - 1))
    width_m, depth_m = ground.cell_m
    total = np.bincount(cell[0] * cols + cell[1], weights=area_m2, minlength=rows * cols)
    return np.asarray(total.reshape(rows, cols) / (width_m * depth_m))
