"""How much leaf stands over each cell of the ground (seeds 002, section 4.5.6: the density of plants)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from forestgen.architecture.geometry import spheres
from forestgen.architecture.modules import Modules
from forestgen.architecture.sizes import terminal_leaf_area_m2
from forestgen.architecture.tables import Tables
from forestgen.community.branch_modules.kinds import kinds_at
from forestgen.community.branch_modules.state import State
from forestgen.community.soil_water.ground import Floats, Ground


def leaf_area_index(forest: State, ground: Ground) -> Floats:
    """(rows, cols) one-sided leaf area over the area of each cell: of the modules whose middle is over it.

    Leaves that hang beyond a bounded site's edge count for the cell at the edge.
    """
    tables, modules, plants = kinds_at(forest).tables, forest.modules, forest.plants
    rows, cols = ground.shape
    if not len(modules):
        return np.zeros(ground.shape)
    kind = np.repeat(plants.species, np.diff(modules.first))
    area_m2 = _leaf_area_m2(tables, modules, kind)
    centre, _ = spheres(tables, modules, plants.species)
    place = np.repeat(plants.position_m, np.diff(modules.first), axis=0) + centre[:, :2]
    cell = []
    for axis, count in ((1, rows), (0, cols)):
        at = np.floor(place[:, axis] / ground.size_m[axis] * count).astype(np.int64)
        cell.append(at % count if ground.periodic else np.clip(at, 0, count - 1))
    width_m, depth_m = ground.cell_m
    total = np.bincount(cell[0] * cols + cell[1], weights=area_m2, minlength=rows * cols)
    return np.asarray(total.reshape(rows, cols) / (width_m * depth_m))


def _leaf_area_m2(tables: Tables, modules: Modules, kind: NDArray[np.uint16]) -> Floats:
    """(M,) one-sided leaf area of each module; those of a plant sum to its `leaf_area_m2` (architecture/sizes.py)."""
    shape, shapes = modules.prototype, np.arange(len(tables.nodes))
    grown = np.minimum(modules.age / tables.mature_age[kind], 1.0)
    borne = np.flatnonzero(modules.parent >= 0)
    bearer = modules.parent_row()[borne]
    slot = tables.terminal_index[shape[bearer], modules.node[borne]]
    pipes = np.zeros(len(modules))
    for k in range(tables.most_terminals):
        node = tables.terminal[:, k]
        birth, thickness = tables.birth[shapes, node], np.where(node >= 0, tables.thickness[shapes, node], 0.0)
        bare = np.ones(len(modules))
        bare[bearer[slot == k]] -= grown[borne[slot == k]]
        share = np.maximum(grown - birth[shape], 0.0) / (1.0 - birth[shape])
        pipes += (share * thickness[shape]) ** 2 * bare
    return np.asarray(terminal_leaf_area_m2(tables)[kind, shape] * pipes)
