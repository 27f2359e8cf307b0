"""Where the nodes of module graphs are and how thick their segments: growth at module scale.

A segment of age a_b, counted from its own birth, is ``length * min(longest, length per age * a_b)`` long (Eqs. 9, 11).
Tropism (Eq. 12) adds ``g_1 g_2 / (a_b + g_1)`` along the world's up to its unit direction, which is made a unit vector
again: lengths stay those of Eq. 11, and a segment of no length moves nothing. As a module's age ends at the mature age,
a grown module is rigid. Squared diameters add at forks (Eq. 10) and across joints: a terminal that bears a module is as
thick as that module's root node, but no thinner than it was before it bore one. The pipes of what a module has shed run
down its main axis, from the last node that is no terminal.

A module's sphere has its centre in the mean of its nodes, each with the weight of the segment that it ends, and half
the reach of the nodes along the line from the module's root through that centre as its radius: so the spheres of a
chain of modules about touch.

Makowski, M. (2023), chapter 2 (Synthetic Silviculture), section 2.5.3.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.architecture.kernels import (
    Graphs,
    Poses,
    Shapes,
    fill_diameters,
    fill_nodes,
    fill_spheres,
    fill_terminals,
)
from forestgen.architecture.modules import Modules
from forestgen.architecture.tables import Tables
from forestgen.core.threads import over_ranges

Types = NDArray[Any]  # (P,) index of each plant's type


@dataclass(frozen=True)
class Nodes:
    """Nodes of chosen modules, one module's after another's."""

    start: NDArray[np.int64]  # (K + 1,) the k-th module's nodes are start[k] to start[k + 1], in its prototype's order
    position_m: NDArray[np.float32]  # (., 3) from the plant's foot, world's axes
    length_m: NDArray[np.float32]  # (.,) of the segment that the node ends, 0 for root nodes and the unborn


def packed(tables: Tables) -> Shapes:
    """The tables as kernels read them."""
    shapes = np.concatenate([tables.direction, tables.length[..., None], tables.birth[..., None]], axis=-1)
    columns = (
        tables.mature_age,
        tables.length_per_age_m,
        tables.longest_segment_m,
        tables.tropism_strength,
        tables.tropism_decay,
    )
    return Shapes(
        np.ascontiguousarray(shapes), np.ascontiguousarray(np.stack(columns, axis=-1)), tables.parent, tables.nodes,
        tables.birth, tables.thickness, tables.disused_node, tables.first_child, tables.next_sibling,
        tables.terminal_index, tables.mature_age, tables.thickening_m, tables.most_terminals,
    )  # fmt: skip


def graphs(modules: Modules, type_of_plant: Types) -> Graphs:
    """The plants as kernels read them."""
    kind = np.ascontiguousarray(type_of_plant, dtype=np.uint16)
    return Graphs(
        kind, modules.first, modules.parent, modules.node, modules.prototype, modules.age, modules.disused_m2,
        modules.base_m, modules.rotation,
    )  # fmt: skip


def _poses(modules: Modules, type_of_plant: Types) -> Poses:
    kind = type_of_module(modules, type_of_plant)
    return Poses(kind, modules.prototype, modules.age, modules.base_m, modules.rotation)


def type_of_module(modules: Modules, type_of_plant: Types) -> NDArray[np.uint16]:
    """(M,) index of each module's plant type."""
    return np.repeat(np.asarray(type_of_plant, dtype=np.uint16), np.diff(modules.first))


def spheres(tables: Tables, modules: Modules, type_of_plant: Types) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Bounding spheres: centres (M, 3), metres from the plant's foot along the world's axes, and radii (M,), metres."""
    shapes, poses = packed(tables), _poses(modules, type_of_plant)
    centre = np.empty((len(modules), 3), dtype=np.float32)
    radius = np.empty(len(modules), dtype=np.float32)

    def work(first: int, end: int) -> None:
        fill_spheres(shapes, poses, tables.sphere_scale, first, end, centre, radius)

    over_ranges(len(modules), work)
    return centre, radius


def terminal_pose(
    tables: Tables, kind: Types, prototype: Types, base_m: Any, rotation: Any, node: Types
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Where terminals of grown modules are, and along which way their segments end: where new modules begin.

    Parameters
    ----------
    kind, prototype : (K,) index of the plant type and of the prototype of each terminal's module.
    base_m, rotation : (K, 3) and (K, 4) of that module, as in `Modules`.
    node : (K,) the terminal's number in the prototype.

    Returns
    -------
    (K, 3) metres from the plant's foot, and (K, 3) unit; world's axes.
    """
    shapes, count = packed(tables), len(prototype)
    position, direction = (np.empty((count, 3), dtype=np.float32) for _ in range(2))
    base_m, rotation = (np.ascontiguousarray(values, dtype=np.float32) for values in (base_m, rotation))
    kind, prototype = np.ascontiguousarray(kind, dtype=np.uint16), np.ascontiguousarray(prototype, dtype=np.uint8)
    poses = Poses(kind, prototype, tables.mature_age[kind], base_m, rotation)
    wanted = np.ascontiguousarray(node, dtype=np.int16)

    def work(first: int, end: int) -> None:
        fill_terminals(shapes, poses, wanted, first, end, position, direction)

    over_ranges(count, work)
    return position, direction


def node_positions(tables: Tables, modules: Modules, type_of_plant: Types, rows: Any = None) -> Nodes:
    """Nodes of the modules of the rows, all if None."""
    shapes, poses = packed(tables), _poses(modules, type_of_plant)
    chosen = np.arange(len(modules)) if rows is None else np.ascontiguousarray(rows, dtype=np.int64)
    start = np.concatenate([[0], np.cumsum(tables.nodes[modules.prototype[chosen]], dtype=np.int64)])
    position = np.empty((start[-1], 3), dtype=np.float32)
    length = np.empty(start[-1], dtype=np.float32)

    def work(first: int, end: int) -> None:
        fill_nodes(shapes, poses, chosen, start, first, end, position, length)

    over_ranges(len(chosen), work)
    return Nodes(start, position, length)


def diameters(tables: Tables, modules: Modules, type_of_plant: Types) -> NDArray[np.float32]:
    """(M,) diameter of each module's root node, metres, by the pipe model over the whole plant."""
    return _diameters(tables, modules, type_of_plant, np.zeros(0, dtype=np.int64), 0)[0]


def node_diameters(tables: Tables, modules: Modules, type_of_plant: Types) -> NDArray[np.float32]:
    """(.,) diameter at each node of all modules, metres: that of the segment it ends; in the order of `Nodes`."""
    start = np.concatenate([[0], np.cumsum(tables.nodes[modules.prototype], dtype=np.int64)])
    return _diameters(tables, modules, type_of_plant, start, int(start[-1]))[1]


def _diameters(
    tables: Tables, modules: Modules, type_of_plant: Types, start: NDArray[np.int64], nodes: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    root = np.empty(len(modules), dtype=np.float32)
    node = np.empty(nodes, dtype=np.float32)
    shapes, plants = packed(tables), graphs(modules, type_of_plant)

    def work(first: int, end: int) -> None:
        fill_diameters(shapes, plants, first, end, start, root, node)

    over_plants(modules, work)
    return root, node


def over_plants(modules: Modules, work: Any) -> None:
    """``work(first, end)`` over ranges of plants that hold about as many modules each, on all cores."""

    def of_modules(first: int, end: int) -> None:  # those plants whose first module lies in the range
        begins = modules.first[:-1]
        work(int(np.searchsorted(begins, first)), int(np.searchsorted(begins, end)))

    over_ranges(len(modules), of_modules)
