"""Skeletal graphs: the nodes of chosen plants over all their modules, with connectivity and diameters.

A module's root node is its bearer's terminal: the graph has it once, as the bearer's node, with the terminal's
diameter. Segments that are not born yet are not in it. Nodes of one axis lie together, from its foot to its tip; an
axis runs on through modules, along each node's first child. Makowski (2023), chapter 2, section 2.6.5, exports these.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.architecture.geometry import Types, node_diameters, node_positions, type_of_module
from forestgen.architecture.modules import Modules
from forestgen.architecture.tables import Tables


@dataclass(frozen=True)
class SkeletalGraph:
    """One row a node; plants in the order they were chosen, parents before children, the nodes of an axis together.

    A node other than a plant's root ends one branch segment, from its parent to itself.
    """

    plant: NDArray[np.int64]  # (N,) row of the plant in the population
    module: NDArray[np.int64]  # (N,) row of the module whose segment it ends, in the population's modules
    node: NDArray[np.int16]  # (N,) its number in that module's prototype; 0: the plant's root
    parent: NDArray[np.int64]  # (N,) row of the parent in this graph; -1: a plant's root
    position_m: NDArray[np.float32]  # (N, 3) from the plant's foot, along the world's axes
    diameter_m: NDArray[np.float32]  # (N,) of the segment; at a plant's root that of its foot
    age: NDArray[np.float32]  # (N,) physiological age of the segment, a_b
    order: NDArray[np.uint8]  # (N,) 0 the trunk's axis, 1 its laterals, ..., at most 255
    axis: NDArray[np.int64]  # (N,) number of its axis, over the whole graph, ascending
    is_main: NDArray[np.bool_]  # (N,) continues its parent's axis; a plant's root does not

    def __len__(self) -> int:
        return len(self.parent)

    def of_plant(self, row: int) -> SkeletalGraph:
        """The part of one plant, with parents and axes counted from 0."""
        found = np.flatnonzero(self.plant == row)
        first = int(found[0]) if len(found) else 0
        parts = {name: getattr(self, name)[found] for name in self.__dataclass_fields__}
        parts["parent"] = np.where(parts["parent"] < 0, -1, parts["parent"] - first)
        parts["axis"] = parts["axis"] - (parts["axis"][0] if len(found) else 0)
        return SkeletalGraph(**parts)


def modules_of(modules: Modules, plants: Any) -> tuple[Modules, NDArray[np.int64]]:
    """The modules of the plants of the rows `plants` (K,), and (M',) the rows that they have in `modules`."""
    chosen = np.asarray(plants, dtype=np.int64)
    count = modules.first[chosen + 1] - modules.first[chosen]
    first = np.concatenate([[0], np.cumsum(count)])
    rows = np.arange(first[-1]) + np.repeat(modules.first[chosen] - first[:-1], count)
    parts = {name: getattr(modules, name)[rows] for name in modules.__dataclass_fields__ if name != "first"}
    return Modules(first=first, **parts), rows


def skeletal_graph(tables: Tables, modules: Modules, type_of_plant: Types, plants: Any = None) -> SkeletalGraph:
    """The graph of the plants of the rows `plants`, all if None.

    Parameters
    ----------
    type_of_plant : (P,) index of each plant's type in the tables.
    """
    chosen = np.arange(modules.plants) if plants is None else np.asarray(plants, dtype=np.int64)
    part, rows = modules_of(modules, chosen)
    kinds = np.asarray(type_of_plant)[chosen]
    nodes = node_positions(tables, part, kinds)
    diameter = node_diameters(tables, part, kinds)
    start = nodes.start
    module = np.repeat(np.arange(len(part)), np.diff(start))
    number = np.arange(start[-1]) - start[module]
    prototype = part.prototype[module]
    bearer = part.parent_row()
    kept = (number > 0) & (nodes.length_m > 0)
    kept[start[:-1][bearer < 0]] = True  # roots of plants
    # A node of the root of a module that grows from a terminal is that terminal.
    joint = np.where(bearer < 0, -1, start[np.maximum(bearer, 0)] + part.node)
    parent = start[module] + tables.parent[prototype, number]
    at_root = (number > 0) & (tables.parent[prototype, number] == 0)
    parent = np.where(at_root & (bearer[module] >= 0), joint[module], parent)
    parent[number == 0] = -1

    new = np.cumsum(kept) - 1
    parent = np.where(parent[kept] < 0, -1, new[np.maximum(parent[kept], 0)])
    module, number = module[kept], number[kept]
    mature = tables.mature_age[type_of_module(part, kinds)[module]]
    born = tables.birth[part.prototype[module], number] * mature
    age = np.maximum(np.minimum(part.age[module], mature) - born, 0.0)
    is_main = _main(parent)
    axis, order = _axes(parent, is_main)
    rank = np.argsort(axis, kind="stable")
    back = np.empty_like(rank)
    back[rank] = np.arange(len(rank))
    parent = parent[rank]
    return SkeletalGraph(
        plant=chosen[part.plant()[module]][rank],
        module=rows[module][rank],
        node=number[rank].astype(np.int16),
        parent=np.where(parent < 0, -1, back[np.maximum(parent, 0)]),
        position_m=nodes.position_m[kept][rank],
        diameter_m=diameter[kept][rank],
        age=age[rank].astype(np.float32),
        order=np.minimum(order[rank], 255).astype(np.uint8),
        axis=axis[rank],
        is_main=is_main[rank],
    )


def _main(parent: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(N,) which nodes are the first child of their parent."""
    child = np.flatnonzero(parent >= 0)
    _, first = np.unique(parent[child], return_index=True)
    main = np.zeros(len(parent), dtype=np.bool_)
    main[child[first]] = True
    return main


def _axes(parent: NDArray[np.int64], is_main: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(N,) number and (N,) order of each node's axis: axes are numbered by their first nodes, so bearers come first."""
    # Each pointer leaps twice as far a round, to the node that begins the axis: as many rounds as an axis has bits.
    begins = np.where(is_main, parent, np.arange(len(parent)))
    while True:
        further = begins[begins]
        if np.array_equal(further, begins):
            break
        begins = further
    starts = np.flatnonzero(~is_main)
    axis = np.searchsorted(starts, begins)
    bearer = np.where(parent[starts] < 0, -1, axis[np.maximum(parent[starts], 0)])  # of each axis
    order = np.zeros(len(starts), dtype=np.int64)
    up = bearer
    while np.any(up >= 0):  # one round an order
        order += up >= 0
        up = np.where(up >= 0, bearer[np.maximum(up, 0)], -1)
    return axis, order[axis]
