"""Axes of one order, grown side by side: Lane's L-system 6.1 as a loop over internodes, not over branches."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from forestgen.core.errors import RecipeError
from forestgen.geometry.mesh import UP, Floats, Ints, any_perpendicular, rotate, unit
from forestgen.plants.skeleton import Skeleton, check_budget
from forestgen.recipe.curves import Curve, FallingCurve, PositiveCurve, StrictlyPositiveCurve, evaluate
from forestgen.recipe.fields import Section

_LAST_INTERNODE = 0.4  # a rest shorter than this share of an internode joins the one before it
_MOST_INTERNODES = 20_000  # of one axis
_NODE_BYTES = 600  # of an internode while it grows and is meshed
_WANDER_MEMORY = 0.6  # correlation of one internode's turn with the turn before
_PARENT_SHARE = 0.7  # a branch is at most this share of the radius of what bears it


class Order(Section):
    """One branch order. Curves run over rel, from 0 at the base of the longest branch to 1 at the tip."""

    longest_m: float = Field(gt=0, le=1000, description="max_len[o]: length of the longest branch, metres")
    internode_m: StrictlyPositiveCurve = Field(description="int_len(o, rel), metres")
    internode_jitter: float = Field(0.0, ge=0, le=2, description="standard deviation of the internodes' logarithm")
    diameter_m: FallingCurve = Field(((0.0, 0.01),), description="int_width(o, rel), metres; order 0 has `trunk`")
    upturn_deg_per_m: Curve = Field(((0.0, 0.0),), description="bend to the sky, of a horizontal axis, degrees/metre")
    wander_deg: float = Field(0.0, ge=0, description="random bend, degrees per square root of a metre")
    branch_angle_deg: Curve = Field(((0.0, 50.0),), description="branch_ang(o, rel), degrees from the bearing axis")
    branch_angle_jitter_deg: float = Field(0.0, ge=0, description="standard deviation of that angle, degrees")
    branch_length: PositiveCurve = Field(
        ((0.0, 1.0),), description="branch_len(o, rel): share of max_len[o+1]; order 0: of the silhouette's length"
    )
    branch_length_jitter: float = Field(0.0, ge=0, lt=0.5, description="standard deviation of that length, as a share")
    shortest_m: float = Field(0.05, gt=0, description="a branch on this axis that would be shorter does not grow")
    branches_per_node: int = Field(1, ge=0, le=1000, description="branches of a whorl")
    nodes_per_whorl: int = Field(1, ge=1, le=1000, description="a whorl every so many nodes; one branch between")
    between_length: float = Field(1.0, gt=0, le=1, description="length of the branches between whorls, as a share")
    missing: float = Field(0.0, ge=0, lt=1, description="share of branches that failed")
    phyllotaxis_deg: float = Field(137.5, description="phyllo_ang[o]: turn from one node to the next, degrees")
    phyllotaxis_jitter_deg: float = Field(0.0, ge=0, description="standard deviation of that turn, degrees")
    planar: bool = Field(False, description="the first branch stands out horizontally: with 180 degrees, flat sprays")


@dataclass(frozen=True)
class Shoots:
    """A axes that are about to grow."""

    start_m: Floats  # (A, 3)
    direction: Floats  # (A, 3) unit
    length_m: Floats  # (A,)
    parent: Ints  # (A,) skeleton node that bears the axis


@dataclass(frozen=True)
class Grown:
    """N nodes of A axes, axis after axis, base to tip. A node's internode is the one that ends in it."""

    axis: Ints  # (N,) axis, 0 .. A-1
    step: Ints  # (N,) internodes before this one on its axis
    position_m: Floats  # (N, 3)
    direction: Floats  # (N, 3) unit, of the internode
    remaining_m: Floats  # (N,) length from the node to the axis' tip
    relative: Floats  # (N,) s / max_len[o] at the node: branch mapping's coordinate
    first: Ints  # (A,) each axis' first node


def grow(shoots: Shoots, rules: Order, rng: np.random.Generator) -> Grown:
    """Production 1 of L-system 6.1, applied to all axes of an order at once.

    An axis of length l starts at s = longest - l, so a short axis is the top of a longer one.
    """
    _check_size(shoots, rules)
    count = len(shoots.length_m)
    s = rules.longest_m - shoots.length_m
    position, direction = shoots.start_m.copy(), shoots.direction.copy()
    turn = np.zeros((count, 3))
    active = np.arange(count)
    rows: list[tuple[Ints, int, Floats, Floats, Floats]] = []
    while len(active):
        step = _internodes(s[active], rules, rng)
        turn[active] = _WANDER_MEMORY * turn[active] + rng.normal(size=(len(active), 3))
        direction[active] = _bend(direction[active], turn[active], step, s[active], rules)
        position[active] += direction[active] * step[:, None]
        s[active] += step
        rows.append((active, len(rows), position[active], direction[active], s[active]))
        active = active[s[active] < rules.longest_m - 1e-9]
    return _by_axis(rows, count, rules.longest_m)


def _check_size(shoots: Shoots, rules: Order) -> None:
    """Refuse axes of more internodes than memory, or patience, holds."""
    if not len(shoots.length_m):
        return
    shortest = float(evaluate(rules.internode_m, np.linspace(0.0, 1.0, 101)).min()) * np.exp(-rules.internode_jitter)
    check_budget(
        "internodes", float(np.sum(shoots.length_m / shortest)), _NODE_BYTES, "longer internode_m, fewer orders"
    )
    longest = float(shoots.length_m.max())
    if longest > _MOST_INTERNODES * shortest:
        problem = f"an axis of {longest:g} m would have {longest / shortest:,.0f} internodes"
        expected = f"at most {_MOST_INTERNODES:,}"
        raise RecipeError(problem, where="plant", expected=expected, hint="longer internode_m")


def _internodes(s: Floats, rules: Order, rng: np.random.Generator) -> Floats:
    length = evaluate(rules.internode_m, np.clip(s / rules.longest_m, 0.0, 1.0))
    length = length * np.exp(rules.internode_jitter * rng.normal(size=len(s)))
    rest = rules.longest_m - s
    return np.where(rest - length < _LAST_INTERNODE * length, rest, length)


def _bend(direction: Floats, turn: Floats, step: Floats, s: Floats, rules: Order) -> Floats:
    """Turn towards the sky (or, for a negative upturn, the ground) as a torque does, and wander."""
    rate = evaluate(rules.upturn_deg_per_m, np.clip(s / rules.longest_m, 0.0, 1.0))
    lever = np.cross(direction, UP)
    sine = np.linalg.norm(lever, axis=1)
    angle = np.clip(np.radians(rate) * step * sine, -0.5, 0.5)
    bent = rotate(direction, unit(lever), angle)
    side = turn - np.sum(turn * bent, axis=1, keepdims=True) * bent
    return unit(bent + np.radians(rules.wander_deg) * np.sqrt(step)[:, None] * side)


def _by_axis(rows: list[tuple[Ints, int, Floats, Floats, Floats]], count: int, longest_m: float) -> Grown:
    if not rows:
        none = np.zeros(0, dtype=np.int64)
        return Grown(none, none, np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0), none)
    axis = np.concatenate([row[0] for row in rows])
    step = np.concatenate([np.full(len(row[0]), row[1]) for row in rows])
    order = np.lexsort((step, axis))
    s = np.concatenate([row[4] for row in rows])[order]
    position, direction = (np.concatenate([row[k] for row in rows])[order] for k in (2, 3))
    remaining, relative = np.maximum(longest_m - s, 0.0), np.clip(s / longest_m, 0.0, 1.0)
    first = np.searchsorted(axis[order], np.arange(count))
    return Grown(axis[order], step[order], position, direction, remaining, relative, first)


@dataclass(frozen=True)
class Sites:
    """M places where lateral branches may start."""

    node: Ints  # (M,) node of `Grown`
    direction: Floats  # (M, 3) unit
    angle_rad: Floats  # (M,) from the bearing axis
    in_whorl: NDArray[np.bool_]  # (M,) False for the single branches between whorls


def lateral_sites(grown: Grown, rules: Order, rng: np.random.Generator) -> Sites:
    """Directions of the branches of every node but the tips: branch_ang(o, rel) and phyllo_ang[o]."""
    axes = len(grown.first)
    phase = rng.uniform(0.0, 2.0 * np.pi, axes)
    if rules.planar:
        phase = np.where(phase > np.pi, np.pi, 0.0)
    whorl = grown.step % rules.nodes_per_whorl == 0
    inner = grown.remaining_m > 1e-9
    per_node = np.where(inner, np.where(whorl, rules.branches_per_node, 1), 0)
    check_budget("branches", float(np.sum(per_node)), _NODE_BYTES, "fewer branches_per_node, longer internode_m")
    node = np.repeat(np.arange(len(grown.axis)), per_node)
    rank = np.arange(len(node)) - np.repeat(np.cumsum(per_node) - per_node, per_node)
    azimuth = (
        phase[grown.axis[node]]
        + np.radians(rules.phyllotaxis_deg) * grown.step[node]
        + 2.0 * np.pi * rank / np.maximum(per_node[node], 1)
        + np.radians(rules.phyllotaxis_jitter_deg) * rng.normal(size=len(node))
    )
    angle = np.radians(
        evaluate(rules.branch_angle_deg, grown.relative[node])
        + rules.branch_angle_jitter_deg * rng.normal(size=len(node))
    )
    direction = around(grown.direction[node], azimuth, angle)
    return Sites(node, direction, angle, whorl[node])


class Assembly:
    """Nodes of a skeleton, collected order by order."""

    def __init__(self, wood: Skeleton, axes: int) -> None:
        self.axes = axes
        self.radius_m = wood.radius_m.astype(np.float64)
        self._columns: list[tuple[NDArray[Any], ...]] = [(wood.parent, wood.position_m, wood.order, wood.axis)]
        self._mark = wood.mark

    def add(self, order: int, grown: Grown, shoots: Shoots, radius_m: Floats) -> Ints:
        """Append the axes of an order; returns the (N,) skeleton indices of their nodes."""
        index = len(self.radius_m) + np.arange(len(grown.axis))
        parent = index - 1
        parent[grown.first] = shoots.parent
        self._columns.append((parent, grown.position_m, np.full(len(index), order), self.axes + grown.axis))
        self.radius_m = np.concatenate([self.radius_m, radius_m])
        self.axes += len(grown.first)
        if self._mark is not None:
            self._mark = np.concatenate([self._mark, self._mark[shoots.parent][grown.axis]])
        return index

    def add_branches(self, order: int, grown: Grown, shoots: Shoots, rules: Order) -> Ints:
        """As `add`. A short branch is the top of a longer one, and no thicker than what bears it allows."""
        radius = 0.5 * evaluate(rules.diameter_m, grown.relative)
        foot = 0.5 * evaluate(rules.diameter_m, np.clip(1.0 - shoots.length_m / rules.longest_m, 0.0, 1.0))
        cap = _PARENT_SHARE * self.radius_m[shoots.parent]
        return self.add(order, grown, shoots, radius * np.minimum(1.0, cap / np.maximum(foot, 1e-9))[grown.axis])

    def skeleton(self) -> Skeleton:
        parent, position, order, axis = (np.concatenate(column) for column in zip(*self._columns, strict=True))
        return Skeleton.of(parent, position, self.radius_m, order, axis, mark=self._mark)


def around(axis: Floats, azimuth_rad: Floats, angle_rad: Floats) -> Floats:
    """(M, 3) unit directions at `angle_rad` from `axis`, turned about it from the horizontal by `azimuth_rad`."""
    side = np.cross(axis, UP)
    steep = np.linalg.norm(side, axis=1) < 0.2
    side[steep] = np.cross(axis[steep], [0.0, 1.0, 0.0])
    side = np.where(np.linalg.norm(side, axis=1, keepdims=True) > 1e-9, unit(side), any_perpendicular(axis))
    other = np.cross(axis, side)
    radial = np.cos(azimuth_rad)[:, None] * side + np.sin(azimuth_rad)[:, None] * other
    return unit(np.cos(angle_rad)[:, None] * axis + np.sin(angle_rad)[:, None] * radial)
