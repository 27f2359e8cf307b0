"""From a plant's skeletal graph, as its community grew it, to a skeleton: axes through modules, in smooth curves."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, fields, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from forestgen.architecture.geometry import skeletal_graph
from forestgen.architecture.prototypes import MOST_NODES, Tables
from forestgen.community.population import Population, Status
from forestgen.geometry.mesh import Bools, Floats, Ints, any_perpendicular, unit
from forestgen.plants.skeleton import Skeleton

MOST_ORDER = 7  # what is of a higher order counts as this
_LEADS = 0.5  # diameter of what goes on along an axis, at least, over that of the thickest beside it
_NO_LENGTH_M = 1e-3  # shorter segments have not begun to grow
_LEAST_STEM_M = 0.01  # of a plant whose first segment has not begun to grow
_LEAST_DIAMETER_M = 4e-4
_BEND_STEP_RAD = 0.2  # of a curve, from one node to the next
_MOST_PIECES = 12
_CROOKED_M = 0.15  # shorter segments are straight
_AT_THE_FOOT_M = 0.02  # forks this low are of several stems


@dataclass(frozen=True)
class ModuleWood:
    """One plant's skeletal graph: node i ends the segment from parent[i] to i. Parents precede children."""

    parent: Ints  # (N,) -1: the root
    position_m: Floats  # (N, 3) metres from the plant's foot, world axes
    diameter_m: Floats  # (N,) of the segment
    age_share: Floats  # (N,) physiological age of the segment over the mature age, 0 to 1
    age_yr: Floats  # (N,) since the node's module began
    light: Floats  # (N,) light exposure of the node's module, 0 to 1
    main: Bools  # (N,) whether the segment goes on along its parent's axis
    mark: NDArray[np.uint32]  # (N,) what the segment is called: see labels/channels/surface.py
    dead_yr: float | None = None  # since the plant died; None: it lives

    def __len__(self) -> int:
        return len(self.parent)

    @property
    def height_m(self) -> float:
        """Of the highest node."""
        return float(self.position_m[:, 2].max())

    def rows(self, node: Ints, parent: Ints, main: Bools) -> ModuleWood:
        """The graph of some nodes, with other parents."""
        columns = ("position_m", "diameter_m", "age_share", "age_yr", "light", "mark")
        return replace(self, parent=parent, main=main, **{name: getattr(self, name)[node] for name in columns})


@dataclass(frozen=True)
class ClothedWood:
    """A skeleton of wood, and what twigs need to know of each of its nodes."""

    skeleton: Skeleton
    age_share: Floats  # (N,) see `ModuleWood`
    light: Floats  # (N,)
    bears: Bools  # (N,) a twig stands out here
    free: Bools  # (N,) the end of a free terminal: nothing goes on from here


def wood_skeleton(
    wood: ModuleWood, bearing: Bools, spacing_m: float, *, smooth: bool, crook: float, rng: np.random.Generator
) -> ClothedWood:
    """Axes in curves through the graph's nodes, which stay where they are.

    A curve is Hermite's cubic from node to node: its tangent at a node halves the bend there, as Catmull and Rom's does
    for nodes at equal distances. A branch leaves its bearer straight.

    `bearing`: (N,) which segments bear twigs: they get nodes at `spacing_m`. `crook`: standard deviation of a segment's
    middle from the curve, share of its length.
    """
    wood, bearing = _seen(wood, bearing)
    main, free = _one_main(wood), np.ones(len(wood), dtype=bool)
    free[wood.parent[1:]] = False
    order, head = _axes(wood, main)
    # Axis after axis, base to tip, bearers first; parents precede children, so an axis' nodes are in order.
    at = np.lexsort((np.arange(len(wood)), head, order))
    parent = wood.parent[at]
    place = np.empty(len(at), dtype=np.int64)
    place[at] = np.arange(len(at))
    parent = np.where(parent < 0, -1, place[np.maximum(parent, 0)])
    curves = _Curves(wood.position_m[at], parent, main[at], smooth)
    chosen, steps = bearing[at], np.clip(np.round(curves.length / spacing_m), 1, _MOST_PIECES * 4).astype(np.int64)
    pieces = curves.pieces(crook, np.where(chosen, steps, 0))
    node = np.repeat(np.arange(len(at)), pieces)
    last = np.cumsum(pieces) - 1
    part = np.arange(len(node)) - (last - pieces + 1)[node] + 1
    share = part / pieces[node]
    position = curves.at(node, share) + _crooked(curves, node, share, crook, rng)
    radius = _radii(wood.diameter_m[at], parent, main[at], node, share)
    ends = part == pieces[node]
    foot = np.where(parent[node] < 0, -1, last[np.maximum(parent[node], 0)])
    above = np.where(part == 1, foot, np.arange(-1, len(node) - 1))
    axis = np.unique(np.stack([order[at], head[at]], axis=1), axis=0, return_inverse=True)[1].reshape(-1)
    skeleton = Skeleton.of(
        above, position, radius, np.minimum(order[at], MOST_ORDER)[node], axis[node], mark=wood.mark[at][node]
    )
    stations = (part * steps[node]) // pieces[node] > ((part - 1) * steps[node]) // pieces[node]
    borne, at_end = parent[node] >= 0, ends & free[at][node]
    bears = chosen[node] & stations & ~at_end & borne
    return ClothedWood(skeleton, wood.age_share[at][node], wood.light[at][node], bears, at_end & borne)


def _seen(wood: ModuleWood, bearing: Bools) -> tuple[ModuleWood, Bools]:
    """Without the segments that have not begun to grow; at least a short stem remains."""
    n = len(wood)
    way = wood.position_m - wood.position_m[np.maximum(wood.parent, 0)]
    gone = np.linalg.norm(way, axis=1) < _NO_LENGTH_M
    gone[0] = False
    if gone.sum() == n - 1:
        return _sprout(wood), np.array([False, bool(bearing.any())])
    if not gone.any():
        return wood, bearing
    holder, main = np.arange(n), wood.main.copy()
    for i in np.flatnonzero(gone).tolist():  # parents first: what holds them is known
        holder[i] = holder[wood.parent[i]]
    under = gone[np.maximum(wood.parent, 0)] & (wood.parent >= 0)
    for i in np.flatnonzero(under).tolist():
        main[i] = main[i] and main[wood.parent[i]]
    keep = ~gone
    number = np.cumsum(keep) - 1
    parent = np.where(wood.parent < 0, -1, number[holder[np.maximum(wood.parent, 0)]])
    return wood.rows(np.flatnonzero(keep), parent[keep], main[keep]), bearing[keep]


def _sprout(wood: ModuleWood) -> ModuleWood:
    """A stem of a centimetre, for a plant that has none yet."""
    stem = wood.rows(np.zeros(2, dtype=np.int64), np.array([-1, 0]), np.array([False, True]))
    position = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, _LEAST_STEM_M]])
    return replace(stem, position_m=position, diameter_m=np.full(2, 0.002))


def _one_main(wood: ModuleWood) -> Bools:
    """(N,) of each node's children, one goes on along the axis: the marked one, otherwise the thickest.

    A marked one that is much thinner than another is a module's last twig, beside the module that leads on.
    """
    main, thickest = np.zeros(len(wood), dtype=bool), np.zeros(len(wood))
    child, bearer = np.arange(1, len(wood)), wood.parent[1:]
    np.maximum.at(thickest, bearer, wood.diameter_m[1:])
    marked = wood.main[1:] & (wood.diameter_m[1:] >= _LEADS * thickest[bearer])
    order = np.lexsort((child, -wood.diameter_m[1:], ~marked, bearer))
    sorted_child = child[order]
    first = np.diff(wood.parent[sorted_child], prepend=-1) != 0
    main[sorted_child[first]] = True
    return main


def _axes(wood: ModuleWood, main: Bools) -> tuple[Ints, Ints]:
    """Branch order of each node, and the first node of its axis."""
    order, head = [0] * len(wood), [0] * len(wood)
    low = (np.linalg.norm(wood.position_m, axis=1) < _AT_THE_FOOT_M).tolist()
    parents, goes_on = wood.parent.tolist(), main.tolist()
    for i in range(1, len(wood)):
        p = parents[i]
        if goes_on[i]:
            order[i], head[i] = order[p], head[p]
        else:
            stem = low[p] and order[p] == 0
            order[i], head[i] = (0 if stem else order[p] + 1), i
    return np.array(order), np.array(head)


class _Curves:
    """The segments as cubics."""

    def __init__(self, position: Floats, parent: Ints, main: Bools, smooth: bool) -> None:
        self.smooth, self.parent = smooth, np.maximum(parent, 0)
        self.start, self.end = position[self.parent], position
        way = self.end - self.start
        self.length = np.linalg.norm(way, axis=1)
        self.along = unit(way)
        after = np.full(len(position), -1)
        goes_on = np.flatnonzero(main)
        after[self.parent[goes_on]] = goes_on
        following = self.along[np.maximum(after, 0)]
        self.out = np.where((after >= 0)[:, None], unit(self.along + following), self.along)
        self.out[0] = following[0] if after[0] >= 0 else self.along[0]
        self.into = np.where(main[:, None], self.out[self.parent], self.along)

    def pieces(self, crook: float, least: Ints) -> Ints:
        """(N,) how many straight pieces show no corners, and at least `least`."""
        pieces = np.ones(len(self.length), dtype=np.int64)
        if self.smooth and len(pieces) > 1:
            tangents = self.into, self.out
            bend = sum(np.arccos(np.clip(np.sum(self.along * one, axis=1), -1.0, 1.0)) for one in tangents)
            pieces = np.clip(np.ceil(np.asarray(bend) / _BEND_STEP_RAD), 1, _MOST_PIECES).astype(np.int64)
        if crook > 0.0:
            pieces = np.where(self.length > _CROOKED_M, np.maximum(pieces, 3), pieces)
        pieces = np.maximum(pieces, least)
        pieces[0] = 1
        return pieces

    def at(self, node: Ints, share: Floats) -> Floats:
        """(M, 3) points of the segments."""
        t = share[:, None]
        if not self.smooth:
            return np.asarray(self.start[node] * (1.0 - t) + self.end[node] * t)
        length = self.length[node, None]
        return np.asarray(
            (2 * t**3 - 3 * t**2 + 1) * self.start[node]
            + (t**3 - 2 * t**2 + t) * length * self.into[node]
            + (3 * t**2 - 2 * t**3) * self.end[node]
            + (t**3 - t**2) * length * self.out[node]
        )


def _crooked(curves: _Curves, node: Ints, share: Floats, crook: float, rng: np.random.Generator) -> Floats:
    """(M, 3) metres to the side, none at the nodes."""
    count = len(curves.length)
    side = any_perpendicular(np.where(curves.length[:, None] > 0.0, curves.along, [0.0, 0.0, 1.0]))
    other = np.cross(curves.along, side)
    size = crook * np.where(curves.length > _CROOKED_M, curves.length, 0.0)[:, None] * rng.normal(size=(count, 2))
    offset = size[:, :1] * side + size[:, 1:] * other
    return np.asarray(offset[node] * (np.sin(np.pi * share) ** 2)[:, None])


def _radii(diameter: Floats, parent: Ints, main: Bools, node: Ints, share: Floats) -> Floats:
    """(M,) a segment is as thick at its end as the graph says; where it goes on along an axis it begins like that."""
    radius = 0.5 * np.maximum(diameter, _LEAST_DIAMETER_M)
    begins = np.where(main, radius[np.maximum(parent, 0)], radius)
    begins[parent == 0] = radius[parent == 0]  # a stem's foot; the root node's own diameter is a stem's too
    radius[0] = max(float(radius[0]), float(begins[main & (parent == 0)].max(initial=0.0)))
    return np.asarray(begins[node] * (1.0 - share) + radius[node] * share)


def wood_key(wood: ModuleWood) -> str:
    """Hash of all that a plant's own wood is, hexadecimal."""
    digest = hashlib.blake2b(digest_size=20)
    for field in fields(wood):
        value = getattr(wood, field.name)
        digest.update(b"" if value is None else np.ascontiguousarray(value).tobytes())
    return digest.hexdigest()


def woods_of(population: Population, tables: Tables, plants: Ints) -> list[ModuleWood]:
    """The skeletal graphs of the plants of some rows, each as its own.

    `tables`: of all species of the population, in their order. Raises `ValueError`: a population without modules.
    """
    modules = population.modules
    if modules is None:
        raise ValueError("the population has no modules")
    if not len(plants):
        return []
    graph = skeletal_graph(tables, modules, population.species, plants)
    kind = population.species[graph.plant].astype(np.int64)
    prototype = modules.prototype[graph.module]
    grown = tables.mature_age[kind] * (1.0 - tables.birth[prototype, graph.node])
    share = np.clip(graph.age / np.maximum(grown, 1e-9), 0.0, 1.0)
    change = np.concatenate([[0], np.cumsum(np.diff(graph.plant) != 0)])  # which of `plants` each node's is
    assert len(plants) == change[-1] + 1  # every plant has a root, and nodes are in the plants' order
    start = np.searchsorted(change, np.arange(len(plants) + 1))
    mark = modules.number[graph.module] * np.uint32(MOST_NODES) + graph.node.astype(np.uint32)
    dead, dead_yr = population.status == Status.DEAD, population.columns.get("dead_yr", np.zeros(len(population)))
    woods = []
    for plant, (first, last) in zip(plants.tolist(), pairwise(start), strict=True):
        part = slice(int(first), int(last))
        parent = graph.parent[part]
        woods.append(
            ModuleWood(
                parent=np.where(parent < 0, -1, parent - first).astype(np.int64),
                position_m=graph.position_m[part].astype(np.float64),
                diameter_m=graph.diameter_m[part].astype(np.float64),
                age_share=share[part].astype(np.float64),
                age_yr=modules.age_yr[graph.module[part]].astype(np.float64),
                light=modules.light[graph.module[part]].astype(np.float64),
                main=graph.is_main[part],
                mark=mark[part].astype(np.uint32),
                dead_yr=float(dead_yr[plant]) if dead[plant] else None,
            )
        )
    return woods
