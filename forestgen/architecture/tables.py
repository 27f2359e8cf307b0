"""Prototypes and plant types as padded arrays, for compiled loops over modules.

Physiological ages are those of the plant type, 0 to its mature age. A module's frame has its root node at the origin
and its axis along z. What depends on a module's attitude to the vertical (Eq. 12) is not in the tables.

Makowski, M. (2023), chapter 2 (Synthetic Silviculture), sections 2.5.2 and 2.5.3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.architecture.plant_type import PlantType
from forestgen.architecture.prototype import MOST_NODES, Prototype

_COLUMNS = ("mature_age", "length_per_age_m", "longest_segment_m", "tropism_strength", "tropism_decay", "opacity")
SPHERE_AGES = 33  # shares of the mature age in the tables of spheres: 0, 1/32, ..., 1


@dataclass(frozen=True)
class Tables:
    """T plant types in the species' order, S prototypes in the order of their names, N = MOST_NODES nodes a prototype.

    Padding: parent, first_child, next_sibling, terminal and terminal_index -1; the rest 0.
    """

    names: tuple[str, ...]  # of the prototypes
    nodes: NDArray[np.int16]  # (S,) number of nodes
    parent: NDArray[np.int16]  # (S, N) -1 for node 0
    direction: NDArray[np.float64]  # (S, N, 3) unit, module's frame
    length: NDArray[np.float64]  # (S, N) factor
    birth: NDArray[np.float64]  # (S, N) over the mature age
    thickness: NDArray[np.float64]  # (S, N) factor
    first_child: NDArray[np.int16]  # (S, N) the main child; -1: a terminal
    next_sibling: NDArray[np.int16]  # (S, N) the next lateral of the same parent; -1: none
    terminals: NDArray[np.int16]  # (S,) number of terminals, K
    terminal: NDArray[np.int16]  # (S, N) node numbers of the terminals, ascending
    terminal_index: NDArray[np.int16]  # (S, N) place of a node among the terminals; -1: none
    disused_node: NDArray[np.int16]  # (S,) last node of the main axis that is no terminal: there disused pipes begin
    mature_age: NDArray[np.float64]  # (T,) physiological
    length_per_age_m: NDArray[np.float64]  # (T,)
    longest_segment_m: NDArray[np.float64]  # (T,)
    tropism_strength: NDArray[np.float64]  # (T,) g_2
    tropism_decay: NDArray[np.float64]  # (T,) g_1
    thickening_m: NDArray[np.float64]  # (T,) `pipe_diameter_m`, of a grown terminal segment of thickness 1
    opacity: NDArray[np.float64]  # (T,)
    sphere_scale: float  # of the spheres' radii
    sphere_centre_m: NDArray[np.float64]  # (T, S, SPHERE_AGES, 3) module's frame, no tropism
    sphere_radius_m: NDArray[np.float64]  # (T, S, SPHERE_AGES) no tropism

    @property
    def most_terminals(self) -> int:
        """Of any of the prototypes."""
        return int(self.terminals.max())

    @property
    def most_nodes(self) -> int:
        """Of any of the prototypes."""
        return int(self.nodes.max())


def tables_of(prototypes: Sequence[Prototype], types: Sequence[PlantType], *, sphere_scale: float = 1.0) -> Tables:
    """Tables of prototypes, in the order of their names, and plant types, in the species' order.

    Parameters
    ----------
    sphere_scale : factor on the spheres' radii; at 1 the spheres of a chain of modules touch.
    """
    s, n = len(prototypes), MOST_NODES
    parent = np.full((s, n), -1, dtype=np.int16)
    first_child, next_sibling, terminal, terminal_index = (np.full((s, n), -1, dtype=np.int16) for _ in range(4))
    direction = np.zeros((s, n, 3))
    length, birth, thickness = np.zeros((s, n)), np.zeros((s, n)), np.zeros((s, n))
    disused = np.zeros(s, dtype=np.int16)
    for index, prototype in enumerate(prototypes):
        count = len(prototype)
        parent[index, :count] = prototype.parent
        direction[index, :count] = _unit(prototype.direction.astype(np.float64))
        length[index, :count], birth[index, :count] = prototype.length, prototype.birth
        thickness[index, :count] = prototype.thickness
        for node in range(count - 1, 0, -1):  # from the last, so that the first child ends at the front
            bearer = prototype.parent[node]
            next_sibling[index, node] = first_child[index, bearer]
            first_child[index, bearer] = node
        ends = prototype.terminals
        terminal[index, : len(ends)] = ends
        terminal_index[index, ends] = np.arange(len(ends))
        while first_child[index, first_child[index, disused[index]]] >= 0:
            disused[index] = first_child[index, disused[index]]
    length[:, 0] = 0.0
    mature, per_age, longest, strength, decay, opacity = (
        np.array([getattr(one, name) for one in types], dtype=np.float64) for name in _COLUMNS
    )
    nodes = np.array([len(prototype) for prototype in prototypes], dtype=np.int16)
    centre, radius = _spheres(parent, direction, length, birth, mature, per_age, longest)
    return Tables(
        names=tuple(prototype.name for prototype in prototypes),
        nodes=nodes,
        parent=parent,
        direction=direction,
        length=length,
        birth=birth,
        thickness=thickness,
        first_child=first_child,
        next_sibling=next_sibling,
        terminals=np.array([len(prototype.terminals) for prototype in prototypes], dtype=np.int16),
        terminal=terminal,
        terminal_index=terminal_index,
        disused_node=disused,
        mature_age=mature,
        length_per_age_m=per_age,
        longest_segment_m=longest,
        tropism_strength=strength,
        tropism_decay=decay,
        thickening_m=np.array([pipe_diameter_m(one) for one in types], dtype=np.float64),
        opacity=opacity,
        sphere_scale=sphere_scale,
        sphere_centre_m=centre,
        sphere_radius_m=radius * sphere_scale,
    )


def pipe_diameter_m(one: PlantType) -> float:
    """Of the pipes that a grown terminal segment adds to the wood below: n shoots of phi have sqrt(n) phi (Eq. 10)."""
    return float(one.thickening_cm / 100.0 * np.sqrt(one.shoots_per_terminal))


def _unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def _spheres(
    parent: NDArray[np.int16],
    direction: NDArray[np.float64],
    length: NDArray[np.float64],
    birth: NDArray[np.float64],
    mature: NDArray[np.float64],
    per_age: NDArray[np.float64],
    longest: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Centres (T, S, A, 3) and radii (T, S, A), metres, of straight modules; as geometry.spheres has them."""
    s, n = parent.shape
    age = mature[:, None] * np.linspace(0.0, 1.0, SPHERE_AGES)  # (T, A)
    since = np.maximum(age[:, None, :, None] - (birth[None] * mature[:, None, None])[:, :, None], 0.0)  # (T, S, A, N)
    reached = np.minimum(longest[:, None, None, None], per_age[:, None, None, None] * since)
    metres = length[None, :, None] * reached
    place = np.zeros((*metres.shape, 3))
    every = np.arange(s)
    for node in range(1, n):
        bearer = np.maximum(parent[:, node], 0)
        step = metres[..., node, None] * direction[None, :, None, node]
        place[:, :, :, node] = np.moveaxis(place[:, every, :, bearer], 0, 1) + step
    weight = metres.sum(axis=-1)
    centre = (place * metres[..., None]).sum(axis=-2) / np.where(weight > 0, weight, 1.0)[..., None]
    away = np.linalg.norm(centre, axis=-1)
    axis = centre / np.where(away > 0, away, 1.0)[..., None]
    born = metres > 0
    reach = np.where(born, np.einsum("tsanc,tsac->tsan", place, axis), 0.0).max(axis=-1)
    return centre, 0.5 * reach
