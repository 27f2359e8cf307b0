"""Where leaves, needles and flowers sit on a skeleton; what they look like: plants/organs/."""

from __future__ import annotations

from typing import Literal, Self

import numpy as np
from pydantic import Field, model_validator

from forestgen.geometry.mesh import UP, Bools, Floats, Ints, rotate, unit
from forestgen.plants.branching import around
from forestgen.plants.skeleton import OrganPlacements, Skeleton, check_budget
from forestgen.recipe.curves import Curve, PositiveCurve, evaluate, evaluate_one
from forestgen.recipe.fields import Section

_ORGAN_BYTES = 2000  # of an organ while it is placed, and of its smallest blade
_HINT = "foliage of the shape {!r}: a larger spacing_m, or a smaller within_m, count or per_node"
_DEEPEST_SEAT_M = 0.008  # an organ's foot sits on the bark, but no further than this from the axis
_SHARED = 0.7  # of the variance of roll and size, by all organs of a twig; ours


class Foliage(Section):
    """Where organs of one shape sit: at even steps along the axes, from each axis' tip towards its base."""

    shape: str = Field(description="name of an organ shape")
    heights_m: tuple[float, float] = Field((0.0, 1e3), description="heights that it serves, upper end excluded, metres")
    orders: tuple[int, ...] = Field(
        min_length=1, description="branch orders that bear it; 0 is the stem, 100 the twigs of `crown_twigs`"
    )
    spacing_m: float | None = Field(None, gt=0, description="distance between nodes along the axis, metres")
    count: int | None = Field(None, ge=1, le=10_000, description="nodes on each axis, in place of spacing_m")
    per_node: int = Field(1, ge=1, le=500, description="organs at a node, evenly about the axis: 2 for opposite leaves")
    within_m: float = Field(1e3, gt=0, description="no further than this from the end of the axis, metres")
    end: Literal["tip", "base"] = Field("tip", description="the end that within_m counts from")
    thinner_than_m: float = Field(1e3, gt=0, description="only where the axis has a smaller diameter, metres")
    zone: tuple[float, float] = Field((0.0, 1.0), description="part of the axis that bears it: 0 base, 1 tip")
    divergence_deg: float = Field(137.5, description="turn about the axis from one node to the next, degrees")
    turn_jitter_deg: float = Field(12.0, ge=0, description="standard deviation of that turn, degrees")
    planar: bool = Field(False, description="the first organ stands out horizontally, not at a random turn")
    angle_deg: Curve = Field(((0.0, 60.0),), description="angle from the axis over the zone, degrees")
    angle_jitter_deg: float = Field(0.0, ge=0, description="standard deviation of that angle, degrees")
    droop_deg: Curve = Field(((0.0, 0.0),), description="turn towards the ground over the zone, degrees")
    light: float = Field(0.0, ge=0, le=1, description="how far organs give up rise and droop to lie flat to the light")
    roll_jitter_deg: float = Field(
        0.0, ge=0, description="standard deviation of the turn about its midrib, degrees, shared as `size_jitter`"
    )
    facing: Literal["up", "axis"] = Field("up", description="upper side turned to the sky or along the axis")
    size: PositiveCurve = Field(((0.0, 1.0),), description="factor on the shape's size over the zone")
    size_jitter: float = Field(
        0.0,
        ge=0,
        lt=0.5,
        description="standard deviation of the size, as a share; 70% of its square is between twigs, of order 2 or "
        "more, where organs face up",
    )
    size_by_height: PositiveCurve = Field(((0.0, 1.0),), description="factor on size and spacing over height in metres")
    spacing_by_height: PositiveCurve = Field(((0.0, 1.0),), description="one more on spacing, over height in metres")
    terminal: bool = Field(False, description="one more at the very tip, along the axis")
    missing: float = Field(0.0, ge=0, lt=1, description="share of places left empty")

    @model_validator(mode="after")
    def _spaced_or_counted(self) -> Self:
        if (self.spacing_m is None) == (self.count is None):
            raise ValueError("either spacing_m, the distance between nodes, or count, the nodes on each axis")
        return self

    def suits(self, height_m: float) -> bool:
        """Whether a plant of this height follows the rule."""
        return self.heights_m[0] <= height_m < self.heights_m[1]


def place(rule: Foliage, skeleton: Skeleton, height_m: float, rng: np.random.Generator) -> OrganPlacements:
    """Frames of all organs of one rule on a skeleton. Raises `RecipeError`: more organs than memory holds."""
    growth = evaluate_one(rule.size_by_height, height_m)
    axes = _Axes(skeleton, rule.orders)
    spacing_m = (rule.spacing_m or 0.0) * growth * evaluate_one(rule.spacing_by_height, height_m)
    axis, distance_m, share, rank, member = _stations(rule, axes, spacing_m)
    node, foot, tangent = axes.at(axis, distance_m)
    keep = rng.random(len(axis)) >= rule.missing
    keep &= 2.0 * skeleton.radius_m[node] < rule.thinner_than_m
    node, axis, rank = node[keep], axis[keep], rank[keep]
    foot, tangent, share, member = foot[keep], tangent[keep], share[keep], member[keep]
    phase = rng.uniform(0.0, 2.0 * np.pi, len(axes.length))[axis]
    azimuth = np.where(rule.planar, np.round(phase / (2.0 * np.pi)) * np.pi, phase)
    azimuth = azimuth + np.radians(rule.divergence_deg) * rank + 2.0 * np.pi * member
    azimuth = azimuth + np.radians(rule.turn_jitter_deg) * rng.normal(size=len(axis))
    angle = np.radians(evaluate(rule.angle_deg, share) + rule.angle_jitter_deg * rng.normal(size=len(axis)))
    angle = np.where(rank < 0, 0.0, angle)
    along = droop(around(tangent, azimuth, angle), np.radians(evaluate(rule.droop_deg, share)))
    along = unit(along * [1.0, 1.0, 1.0 - 0.999 * rule.light])
    radius = np.minimum(skeleton.radius_m[node].astype(np.float64), _DEEPEST_SEAT_M)
    seat = along - np.sum(along * tangent, axis=1, keepdims=True) * tangent
    seat[np.linalg.norm(seat, axis=1) < 1e-9] = 0.0  # those that go on along the axis are seated on it
    foot = foot + 0.7 * radius[:, None] * unit(seat)
    shares = (rule.facing == "up") & (skeleton.order[node] > 1)  # on twigs: herbs have none
    larger, tilt = _deviations(axis, along, shares, rng)
    size = growth * evaluate(rule.size, share) * np.clip(1 + rule.size_jitter * larger, 0.4, 1.6)
    roll = np.radians(rule.roll_jitter_deg) * tilt
    upper = np.broadcast_to(UP, tangent.shape) if rule.facing == "up" else tangent
    frame = organ_frames(foot, along, upper, roll, size)
    return OrganPlacements(rule.shape, frame.astype(np.float32), node.astype(np.int32))


def _deviations(axis: Ints, along: Floats, shares: Bools, rng: np.random.Generator) -> Floats:
    """(2, M) of organs' sizes and rolls, standard normal. Those that share have a part of it in common on each axis:
    sprays are of larger leaves than others, and lean to one side, so that they are light or dark as a whole.
    """
    made = rng.normal(size=(2, len(axis)))
    of_axis = rng.normal(size=(len(np.unique(axis[shares])), 3))
    larger, x, y = of_axis[np.unique(axis[shares], return_inverse=True)[1]].T
    turn = np.arctan2(along[shares, 1], along[shares, 0])
    common = np.stack([larger, x * np.sin(turn) - y * np.cos(turn)])
    made[:, shares] = np.sqrt(_SHARED) * common + np.sqrt(1.0 - _SHARED) * made[:, shares]
    return made


class _Axes:
    """Arc length along the axes of some orders of a skeleton."""

    def __init__(self, skeleton: Skeleton, orders: tuple[int, ...]) -> None:
        parent = np.maximum(skeleton.parent, 0)
        self.end = skeleton.position_m.astype(np.float64)
        self.start = self.end[parent]
        segment = np.linalg.norm(self.end - self.start, axis=1)
        total = np.cumsum(segment)
        first, beyond = skeleton.axes()
        last = beyond - 1
        chosen = np.isin(skeleton.order[first], orders)
        self.segment, self.total = segment, total
        self.begin = (total[first] - segment[first])[chosen]
        self.length = total[last][chosen] - self.begin
        self.hidden = np.where(parent[first] == first, 0.0, skeleton.radius_m[parent[first]])[chosen]
        self.first, self.last = first[chosen], last[chosen]

    def at(self, axis: Ints, distance_m: Floats) -> tuple[Ints, Floats, Floats]:
        """Node whose segment holds the point `distance_m` from the base of `axis`, the point, the unit tangent."""
        place = self.begin[axis] + distance_m
        node = np.clip(np.searchsorted(self.total, place), self.first[axis], self.last[axis])
        node = np.where(self.segment[node] > 0.0, node, np.minimum(node + 1, self.last[axis]))
        way = self.end[node] - self.start[node]
        share = (place - self.total[node] + self.segment[node]) / np.maximum(self.segment[node], 1e-12)
        return node, self.start[node] + np.clip(share, 0.0, 1.0)[:, None] * way, unit(way)


def _stations(rule: Foliage, axes: _Axes, spacing_m: float) -> tuple[Ints, Floats, Floats, Ints, Floats]:
    """Where organs sit, (M,) each: axis; distance from its base; position within the zone; number of the node from the
    tip, -1: terminal; place of an organ about its node, share of a turn."""
    top = axes.length * rule.zone[1]
    bottom = np.maximum(axes.length * rule.zone[0], axes.hidden)
    if rule.end == "tip":
        bottom = np.maximum(bottom, axes.length - rule.within_m)
    else:
        top = np.minimum(top, axes.hidden + rule.within_m)
    room = np.maximum(top - bottom, 0.0)
    if rule.count is not None:
        step = room / rule.count
        nodes = np.where(room > 0.0, float(rule.count), 0.0)
    else:
        step = np.full(len(room), spacing_m)
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            nodes = np.where(room > 0.0, np.floor(room / step + 0.5), 0.0)
    check_budget("organs of one kind", float(nodes.sum()) * rule.per_node, _ORGAN_BYTES, _HINT.format(rule.shape))
    count = nodes.astype(np.int64)
    axis = np.repeat(np.arange(len(room)), count)
    rank = np.arange(len(axis)) - np.repeat(np.cumsum(count) - count, count)
    distance = np.maximum(top[axis] - (rank + 0.35) * step[axis], bottom[axis])
    share = (distance - bottom[axis]) / np.maximum(room[axis], 1e-12)
    member = np.tile(np.arange(rule.per_node) / rule.per_node, len(axis))
    axis, distance, share, rank = (np.repeat(array, rule.per_node) for array in (axis, distance, share, rank))
    if rule.terminal:
        every = np.flatnonzero(axes.length > axes.hidden)
        axis = np.concatenate([axis, every])
        rank = np.concatenate([rank, np.full(len(every), -1)])
        distance = np.concatenate([distance, axes.length[every]])
        share = np.concatenate([share, np.ones(len(every))])
        member = np.concatenate([member, np.zeros(len(every))])
    return axis, distance, share, rank, member


def droop(along: Floats, angle_rad: Floats | float) -> Floats:
    """Directions turned to the ground, level ones by `angle_rad`."""
    lever = np.cross(along, -UP)
    return rotate(along, unit(lever), angle_rad * np.linalg.norm(lever, axis=1))


def organ_frames(foot: Floats, along: Floats, upper: Floats, roll_rad: Floats, size: Floats) -> Floats:
    """(M, 3, 4) right-handed frames: y = along, z = upper made perpendicular and rolled about y."""
    across = np.cross(along, upper)
    weak = np.linalg.norm(across, axis=1) < 1e-3
    across[weak] = np.cross(along[weak], [0.6, 0.8, 0.0])
    weak = np.linalg.norm(across, axis=1) < 1e-3
    across[weak] = np.cross(along[weak], [0.8, -0.6, 0.0])
    across = rotate(unit(across), along, roll_rad)
    linear = np.stack([across, along, np.cross(across, along)], axis=-1) * size[:, None, None]
    return np.concatenate([linear, foot[:, :, None]], axis=2)
