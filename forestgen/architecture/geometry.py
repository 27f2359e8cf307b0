"""Where the nodes of module graphs are, how thick their segments are, and what follows: sizes and skeletal graphs.

A segment of age a_b, counted from its own birth, is ``length * min(longest, length per age * a_b)`` long (Eqs. 9, 11).
Tropism (Eq. 12) adds ``g_1 g_2 / (a_b + g_1)`` along the world's up to its unit direction, which is made a unit vector
again: lengths stay those of Eq. 11. A module's age ends at the mature age: a grown module is rigid. Squared diameters
add at forks (Eq. 10) and across joints: a terminal that bears a module is as thick as that module's root node, but no
thinner than it was before. The pipes of what a module has shed run down its main axis, from the last node that is no
terminal.

A module's sphere has its centre in the mean of its nodes, each with the weight of the segment that it ends, and half
the reach of the nodes along the line from the module's root through that centre as its radius: so the spheres of a
chain of modules about touch.

Sizes of plants, for populations, statistics and allometries:

- Height: the highest node.
- Crown radius: half the nodes' horizontal extent, the mean of those along four directions 45 degrees apart.
- Trunk diameter: at 1.3 m, along the thickest way up; at the foot of plants that do not reach so high.
- Foot diameter: of the root node, before any fork.
- Wood volume: frusta along an axis, from one node's diameter to the next; a lateral's first segment is a cylinder.
- Leaf area: by Beer's law for leaves of all angles alike (extinction 1/2), a layer that takes the share `opacity` of
  the light (at most 0.99) has the leaf area index -2 ln(1 - opacity). So much covers the disc of a grown module's
  sphere. By the pipe model (Shinozaki et al. 1964) the module's terminals have this area in proportion to their squared
  diameters, which rise from 0 as it grows; a terminal that bears a module keeps the share that this has still to grow.

A skeletal graph has the nodes of chosen plants over all their modules. A module's root node is its bearer's terminal:
the graph has it once, as the bearer's node, with the terminal's diameter. It has no segments that are not born yet.
Nodes of one axis lie together, from its foot to its tip; an axis runs on through modules along each first child.

Makowski, M. (2023), chapter 2 (Synthetic Silviculture), sections 2.5.3 and 2.6.5.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.architecture import kernels
from forestgen.architecture.kernels import Graphs, Poses, Shapes, fill_nodes, fill_spheres, fill_terminals
from forestgen.architecture.modules import Modules
from forestgen.architecture.prototypes import Tables
from forestgen.core.threads import parallel_for

MOST_OPACITY = 0.99
Types = NDArray[Any]  # (P,) index of each plant's type


@dataclass(frozen=True)
class Nodes:
    """Nodes of modules, one module's after another's."""

    start: NDArray[np.int64]  # (M + 1,) module m's nodes are start[m] to start[m + 1], in its prototype's order
    position_m: NDArray[np.float32]  # (., 3) from the plant's foot, world's axes
    length_m: NDArray[np.float32]  # (.,) of the segment that the node ends, 0 for root nodes and the unborn


def _packed(tables: Tables) -> Shapes:
    """The tables as kernels read them."""
    shapes = np.concatenate([tables.direction, tables.length[..., None], tables.birth[..., None]], axis=-1)
    lengths_m = tables.length_per_age_m, tables.longest_segment_m
    columns = tables.mature_age, *lengths_m, tables.tropism_strength, tables.tropism_decay
    shape, kind = np.ascontiguousarray(shapes), np.ascontiguousarray(np.stack(columns, axis=-1))
    return Shapes(shape, kind, *(getattr(tables, name) for name in Shapes._fields[2:]))


def _graphs(modules: Modules, type_of_plant: Types) -> Graphs:
    """The plants as kernels read them."""
    kind = np.ascontiguousarray(type_of_plant, dtype=np.uint16)
    return Graphs(kind, *(getattr(modules, name) for name in Graphs._fields[1:]))


def _poses(modules: Modules, type_of_plant: Types) -> Poses:
    kind = type_of_module(modules, type_of_plant)
    return Poses(kind, *(getattr(modules, name) for name in Poses._fields[1:]))


def type_of_module(modules: Modules, type_of_plant: Types) -> NDArray[np.uint16]:
    """(M,) index of each module's plant type."""
    return np.repeat(np.asarray(type_of_plant, dtype=np.uint16), np.diff(modules.first))


def spheres(tables: Tables, modules: Modules, type_of_plant: Types) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Bounding spheres: centres (M, 3), metres from the plant's foot along the world's axes, and radii (M,), metres."""
    shapes, poses = _packed(tables), _poses(modules, type_of_plant)
    centre, radius = np.empty((len(modules), 3), dtype=np.float32), np.empty(len(modules), dtype=np.float32)
    scale = tables.sphere_scale
    parallel_for(len(modules), lambda first, end: fill_spheres(shapes, poses, scale, first, end, centre, radius))
    return centre, radius


def terminal_pose(
    tables: Tables, kind: Types, prototype: Types, base_m: Any, rotation: Any, node: Types
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Where terminals of grown modules are, and along which way their segments end: where new modules begin.

    (K, 3) metres from the plant's foot, and (K, 3) unit vectors; world's axes. Of each terminal: the plant type, the
    prototype and the pose of its module, as in `Modules`, and its number in the prototype.
    """
    shapes, count = _packed(tables), len(prototype)
    position, direction = (np.empty((count, 3), dtype=np.float32) for _ in range(2))
    base_m, rotation = (np.ascontiguousarray(values, dtype=np.float32) for values in (base_m, rotation))
    kind, prototype = np.ascontiguousarray(kind, dtype=np.uint16), np.ascontiguousarray(prototype, dtype=np.uint8)
    poses = Poses(kind, prototype, tables.mature_age[kind], base_m, rotation)
    wanted = np.ascontiguousarray(node, dtype=np.int16)
    parallel_for(count, lambda first, end: fill_terminals(shapes, poses, wanted, first, end, position, direction))
    return position, direction


def node_positions(tables: Tables, modules: Modules, type_of_plant: Types) -> Nodes:
    """Nodes of all modules."""
    shapes, poses = _packed(tables), _poses(modules, type_of_plant)
    start = _node_starts(tables, modules)
    position, length = np.empty((start[-1], 3), dtype=np.float32), np.empty(start[-1], dtype=np.float32)
    parallel_for(len(modules), lambda first, end: fill_nodes(shapes, poses, start, first, end, position, length))
    return Nodes(start, position, length)


def diameters(tables: Tables, modules: Modules, type_of_plant: Types) -> NDArray[np.float32]:
    """(M,) diameter of each module's root node, metres, by the pipe model over the whole plant."""
    return _diameters(tables, modules, type_of_plant, np.zeros(1, dtype=np.int64))[0]


def node_diameters(tables: Tables, modules: Modules, type_of_plant: Types) -> NDArray[np.float32]:
    """(.,) diameter at each node of all modules, metres: that of the segment it ends; in the order of `Nodes`."""
    return _diameters(tables, modules, type_of_plant, _node_starts(tables, modules))[1]


def _diameters(
    tables: Tables, modules: Modules, type_of_plant: Types, start: NDArray[np.int64]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    root, node = np.empty(len(modules), dtype=np.float32), np.empty(start[-1], dtype=np.float32)
    shapes, plants = _packed(tables), _graphs(modules, type_of_plant)
    over_plants(modules, lambda first, end: kernels.fill_diameters(shapes, plants, first, end, start, root, node))
    return root, node


def _node_starts(tables: Tables, modules: Modules) -> NDArray[np.int64]:
    return np.concatenate([[0], np.cumsum(tables.nodes[modules.prototype], dtype=np.int64)])


def over_plants(modules: Modules, work: Any) -> None:
    """``work(first, end)`` over ranges of plants that hold about as many modules each, on all cores."""

    def of_modules(first: int, end: int) -> None:  # those plants whose first module lies in the range
        begins = modules.first[:-1]
        work(int(np.searchsorted(begins, first)), int(np.searchsorted(begins, end)))

    parallel_for(len(modules), of_modules)


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
    index = -2.0 * np.log1p(-np.minimum(tables.opacity, MOST_OPACITY))
    disc = np.pi * tables.grown_spheres_m[1] ** 2
    pipes = np.where(tables.terminal_index >= 0, tables.thickness**2, 0.0).sum(axis=1)
    return np.asarray(index[:, None] * disc / pipes)


def plant_sizes(tables: Tables, modules: Modules, type_of_plant: Types) -> PlantSizes:
    """Sizes of all plants; `type_of_plant` (P,) indexes the tables' plant types."""
    shapes, plants = _packed(tables), _graphs(modules, type_of_plant)
    sizes, leaf_area = np.zeros((modules.plants, 6)), terminal_leaf_area_m2(tables)
    over_plants(modules, lambda first, end: kernels.fill_sizes(shapes, plants, leaf_area, first, end, sizes))
    height, crown, trunk, foot = sizes[:, :4].astype(np.float32).T
    return PlantSizes(height, crown, trunk, foot, sizes[:, 4].copy(), sizes[:, 5].copy(), np.diff(modules.first))


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


def skeletal_graph(tables: Tables, modules: Modules, type_of_plant: Types, plants: Any = None) -> SkeletalGraph:
    """The graph of the plants of the rows `plants`, all if None.

    `type_of_plant` (P,) is the index of each plant's type in the tables.
    """
    chosen = np.arange(modules.plants) if plants is None else np.asarray(plants, dtype=np.int64)
    part, rows = modules.of_plants(chosen), modules.rows(chosen)
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
