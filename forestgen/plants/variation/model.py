"""Variation by growth responses: any skeleton, grown again with errors of direction and their correction.

Reference
---------
Streit, L., Federl, P., Sousa, M. C. (2005). Modelling plant variation through growth. Computer Graphics Forum 24(3),
497-506, section 4 and appendix A.

Equations
---------
::

    H_sense(n) = H_curr(n), off by a radial Gaussian error v             # the sensor
    theta(n) = acos(H_sense . H_tar)                                     # about the axis H_sense x H_tar
    u(n) = kappa theta(n) [+ kappa_d (theta(n) - theta(n-1)) + kappa_i sum theta]   # D(s), a signal of lifetime lag
    H_curr(n) = w(n) u(n - 1 - lag) H_curr(n-1)                          # G(s): response to the expired, disturbance
    H_tar(n) = T_M b(n), bent by a function, or (1 - weight) T_M b(n) + weight up

b(n) is the base skeleton's own direction at growth step n; T_M is the identity (`reference: global`) or the rotation
of the axis' bearer where it begins (`local`). One displacement alone decays as E(n) = E(n-1) - kappa E(n-1-lag), which
with a lag of l steps is stable for kappa < 2 sin(pi / (2 (2 l + 1))). For long lags that is kappa l < pi/2, a
compensation ratio (kappa l)^-1 above 0.64; above 1.0 for one step, 0.81 for two, 0.75 for three, 0.72 for four, 0.70
for five. So the ratio 0.7 that the paper found by experiment is stable from six steps on.

Parameters: those of the key `variation` of every plant generator.

Positions run along an axis from 0, its base, to 1, its tip.

Recipe
------
::

    plant:
      variation: {lag: 0.1, compensation_ratio: 1.0, disturbance_deg: 4, sensor_error_deg: 3}  # wilder: more degrees

    variation:                                             # a pot turned over when a fifth has grown (Fig. 9)
      {growth_steps: 100, lag: 0.08, displacements: [{at: 0.2, turn_deg: 90, plane: 90, turns: plant}]}
    variation: {target_pull: {weight: [[0, 0], [1, 0.9]], orders: [1]}, disturbance_deg: 5}                # Fig. 13

Decisions
---------
- The loop works on the rotation between the base's course and the varied one: bends and kinks of the base stay where
  they are, lengths too, and where nothing disturbs an axis the skeleton comes back to the bit. Nodes are inserted where
  a growth step turns, with thickness interpolated. Organs follow their node stiffly.
- An axis begins at its bearer's new place and in its rotated frame; it then keeps its direction in that frame (local),
  or corrects its direction in space as it grows (global).
- Lifetime counts growth steps: the form depends on how much has grown between sensing and response. The growth zone is
  at a fixed distance behind the tip. In a step the tip goes up by one step and the signal down by `transmission` steps,
  and the signal loses `decay`; so it ages by decay (1 + transmission) / 2 steps: for Fig. 7, of equal rates, its
  lifetime is the lag. Where rates vary, signals catch up with one another and several may act in one step. The response
  turns what grows from then on, not what has grown.
- The lag is rounded to whole steps, to one at least if kappa comes from a compensation ratio. The default ratio of
  1.1 is stable for every lag.
- A signal runs down a flank of the stem. So its turn is kept in the frame of the tip, which turns along.
- Only a direction is sensed: errors are at most 180 degrees and wrap beyond. Straight backwards, the shoot turns about
  an arbitrary axis.
- Radial: the angle is Gaussian (uniform), its azimuth uniform. Random disturbances are per growth step, as in the
  paper, and depend on their number; an `Influence` is per length of axis, and does not.
- What lies within the bearer's thickness does not grow: steps and positions begin at its surface.
- Axes thinner than 20 micrometres are joints between parts that do not touch, and stay straight.
- `Displacement.turns: plant` turns a potted plant: what has grown by then lies turned, and grew towards a target
  turned with it. It is meant for plants of one axis: branches begin on what was turned.
- Signals and errors of one axis do not reach another. Light comes from a direction of the plant's own frame.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from forestgen.geometry.mesh import UP, Floats, Ints, rotate, unit
from forestgen.plants.skeleton import OrganPlacements, Skeleton, check_budget
from forestgen.plants.variation.loop import NewNodes, carry, walk
from forestgen.recipe.curves import Curve, Function, PositiveCurve, evaluate
from forestgen.recipe.fields import Section

#: Where a positive angle turns to. up: to the sky; side: to the left (an upright axis: to +x and to -y, east and
#: south); random: any side, drawn for each axis; a number: an azimuth in degrees clockwise from +y, as of a compass.
Plane = Literal["up", "side", "random"] | Annotated[float, Field(ge=-360, le=360)]
_Vector = tuple[float, float, float]
_DEFAULT_LAG, _DEFAULT_RATIO = 0.1, 1.1


class Influence(Section):
    """A disturbance that is a function of the position on the axis (Fig. 8, upper curve)."""

    turn_deg: Curve = Field(description="turn over the position, degrees per length of the axis")
    plane: Plane = Field("up", description="up, side, random, or an azimuth in degrees clockwise from +y")
    orders: tuple[int, ...] | None = Field(None, description="orders that feel it; all if not given")


class Displacement(Section):
    """A single turn (Figs. 2, 9 and 10)."""

    at: float = Field(ge=0, lt=1, description="when, as the share of the axis that has grown")
    turn_deg: float = Field(ge=-180, le=180, description="by how much, degrees")
    plane: Plane = Field("up", description="up, side, random, or an azimuth in degrees clockwise from +y")
    turns: Literal["tip", "plant"] = Field("tip", description="the tip, or all that has grown, as of a pot turned over")
    orders: tuple[int, ...] | None = Field((0,), description="orders of the axes that are turned; null: all")


class Bend(Section):
    """A target that leaves the base's course by a function of the position (Fig. 8, lower curve)."""

    turn_deg: Curve = Field(description="angle between target and base over the position, degrees")
    plane: Plane = Field("up", description="up, side, random, or an azimuth in degrees clockwise from +y")
    orders: tuple[int, ...] | None = Field(None, description="orders with this target; all if not given")


class Pull(Section):
    """A target between the base's own direction and one in space (Fig. 13)."""

    weight: Curve = Field(description="weight of the direction in space over the position, 0 to 1")
    toward: Literal["up"] | _Vector = Field("up", description="up, or a vector in the plant's frame, to a light say")
    orders: tuple[int, ...] | None = Field(None, description="orders with this target; all if not given")

    @model_validator(mode="after")
    def _points_somewhere(self) -> Self:
        if not isinstance(self.toward, str) and not 1e-6 < np.linalg.norm(self.toward) < 1e6:
            raise ValueError("toward must be a vector of some length")
        return self

    def direction(self) -> _Vector:
        """Unit vector."""
        if isinstance(self.toward, str):
            return 0.0, 0.0, 1.0
        x, y, z = np.array(self.toward) / np.linalg.norm(self.toward)
        return float(x), float(y), float(z)


class Variation(Section):
    """How a plant grows away from its base model; this module's page has the equations."""

    growth_steps: PositiveCurve = Field(((0.0, 32.0), (3.0, 4.0)), description="growth steps of an axis over its order")
    step_m: float | None = Field(None, gt=0, description="length of a growth step, metres; instead of growth_steps")
    orders: tuple[int, ...] | None = Field(None, description="orders that vary, others are carried along; all if null")
    reference: Literal["global", "local"] = Field(
        "global", description="T_M: whether base directions are relative to gravity or to the bearing axis"
    )
    lag: float | None = Field(None, ge=0, le=1, description="a signal's lifetime, as a share of the growth steps")
    kappa: float | None = Field(None, gt=0, le=100, description="share of the error that one signal corrects")
    compensation_ratio: float | None = Field(None, gt=0, le=1e4, description="1 / (kappa x lag in steps); 0.5 to 1.2")
    derivative_gain: float = Field(0.0, ge=-100, le=100, description="kappa_d: response to the error's change a step")
    integral_gain: float = Field(0.0, ge=-100, le=100, description="kappa_i: response to the sum of errors")
    decay: PositiveCurve = Field(((0.0, 1.0),), description="loss of lifetime a growth step, over the position")
    transmission: PositiveCurve = Field(((0.0, 1.0),), description="speed of signals over that of growth")
    sensor_error_deg: PositiveCurve = Field(((0.0, 0.0),), description="v: error of sensing, degrees, over the order")
    disturbance_deg: PositiveCurve = Field(((0.0, 0.0),), description="w: disturbance of a step, degrees, by the order")
    distribution: Literal["gaussian", "uniform"] = Field(
        "gaussian", description="disturbance_deg is the standard deviation, or the largest angle"
    )
    influences: tuple[Influence, ...] = Field((), description="disturbances that are functions of the position")
    displacements: tuple[Displacement, ...] = Field((), description="single turns")
    target_bend: Bend | None = Field(None, description="H_tar: a target that leaves the base's course")
    target_pull: Pull | None = Field(None, description="H_tar: a target drawn upward, or to a light")

    @model_validator(mode="before")
    @classmethod
    def _two_of_three(cls, data: object) -> object:
        """Of lag, kappa and the compensation ratio two set the third."""
        if not isinstance(data, dict):
            return data
        given = [key for key in ("lag", "kappa", "compensation_ratio") if data.get(key) is not None]
        if len(given) == 3:
            raise ValueError("compensation_ratio is 1 / (kappa lag): give two of lag, kappa, compensation_ratio")
        if len(given) < 2:
            defaults = {"lag": _DEFAULT_LAG} | ({} if "kappa" in given else {"compensation_ratio": _DEFAULT_RATIO})
            data = {**data, **{key: value for key, value in defaults.items() if key not in given}}
        return data

    @model_validator(mode="after")
    def _makes_sense(self) -> Self:
        if self.lag == 0 and self.kappa is None:
            raise ValueError("without lag there is no compensation ratio: give kappa")
        if self.step_m is not None and "growth_steps" in self.model_fields_set:
            raise ValueError("give growth_steps or step_m, not both")
        if sum(one.turns == "plant" for one in self.displacements) > 1:
            raise ValueError("a plant is turned over once: at most one displacement with turns: plant")
        return self


_UPRIGHT_SINE = 0.05  # an axis nearer to the vertical has no side that is up
_BYTES_PER_STEP = 400  # tables, the new nodes in the loop and in the skeleton
_MOST_LAG_STEPS = 1e9


class Axes(NamedTuple):
    """A axes of a skeleton: runs of nodes that are chained."""

    first: Ints  # (A,) node
    last: Ints  # (A,) one beyond its last node
    bearer: Ints  # (A,) node at which it begins; -1: at its own first, the root
    order: Ints  # (A,)
    length_m: Floats  # (A,) from where it begins
    hidden_m: Floats  # (A,) of that, within the bearer's thickness
    foot: Floats  # (A, 3) unit direction in which it begins
    thread: NDArray[np.bool_]  # (A,) whether it only joins what does not touch
    arc_m: Floats  # (N,) of each node, from its axis' start


class Tables(NamedTuple):
    """Influences on each of A axes, and on each of S growth steps, axis after axis; (0, ...): none."""

    steps: Ints  # (A,) growth steps; 0: the axis is carried along stiffly
    begin: Ints  # (A,) row of the first
    life: Floats  # (A,) of a signal, growth steps
    kappa: Floats  # (A,)
    age: Floats  # (S,) growth steps by which signals have aged, summed
    sensor: Floats  # (S, 2) angle and azimuth, radians
    disturbance: Floats  # (S, 2) as well
    turn: Floats  # (S, 3) rotation vectors in the base's frame
    target: Floats  # (S, 3) as well, of the target
    weight: Floats  # (S,) of the direction to which the target is drawn
    whole: Floats  # (A, 3) rotation vector of what has grown before step `until`, with its targets
    until: Ints  # (A,)


def axes_of(skeleton: Skeleton, position: Floats) -> Axes:
    """The axes of a skeleton whose (N, 3) places are given in double precision."""
    first, last = skeleton.axes()
    parent = np.maximum(skeleton.parent, 0)
    way = position - position[parent]
    length = np.linalg.norm(way, axis=1)
    total = np.cumsum(length)
    arc = total - np.repeat(total[first] - length[first], last - first)
    arc[first] = length[first]
    borne = skeleton.parent[first] >= 0
    within = np.where(borne, skeleton.radius_m[parent[first]].astype(np.float64), 0.0)
    apart = length > 0.0
    index = np.where(apart, np.arange(len(position)), len(position))
    leads = np.minimum.reduceat(index, first)
    foot = unit(np.append(way, [UP], axis=0)[np.minimum(leads, len(position))])
    bearer, order = skeleton.parent[first].astype(np.int64), skeleton.order[first].astype(np.int64)
    hidden = np.minimum(within, length[first])
    return Axes(first, last, bearer, order, arc[last - 1], hidden, foot, skeleton.is_thread(), arc)


def tables(axes: Axes, variation: Variation, rng: np.random.Generator) -> Tables:
    """Growth steps, gains and influences of every axis. Raises `RecipeError`: more growth steps than memory holds."""
    grows = (axes.length_m > (1.0 + 1e-6) * axes.hidden_m) & ~axes.thread
    if variation.orders is not None:
        grows &= np.isin(axes.order, variation.orders)
    steps = _growth_steps(axes, variation, grows)
    begin = np.cumsum(steps) - steps
    axis = np.repeat(np.arange(len(steps)), steps)
    k = np.arange(len(axis)) - begin[axis]
    share = k / np.maximum(steps, 1)[axis]
    middle = (k + 0.5) / np.maximum(steps, 1)[axis]
    life, kappa = _gains(variation, steps)
    rate = evaluate(variation.decay, share) * 0.5 * (1.0 + evaluate(variation.transmission, share))
    age = np.cumsum(rate)
    if len(age):
        age -= np.repeat(age[np.minimum(begin, len(age) - 1)], steps)
    sensor_rng, disturbance_rng, plane_rng = rng.spawn(3)
    azimuth = plane_rng.uniform(0.0, 2.0 * np.pi, len(steps))
    turn, whole, until = _turns(axes, variation, steps, begin, middle, axis, azimuth)
    target, weight = _targets(axes, variation, share, axis, azimuth)
    of_order = axes.order[axis]
    sensor = _radial(variation.sensor_error_deg, "gaussian", of_order, sensor_rng)
    disturbance = _radial(variation.disturbance_deg, variation.distribution, of_order, disturbance_rng)
    return Tables(steps, begin, life, kappa, age, sensor, disturbance, turn, target, weight, whole, until)


def _growth_steps(axes: Axes, variation: Variation, grows: NDArray[np.bool_]) -> Ints:
    if variation.step_m is not None:
        wanted = (axes.length_m - axes.hidden_m) / variation.step_m
        hint = "raise variation.step_m"
    else:
        wanted = evaluate(variation.growth_steps, axes.order.astype(np.float64))
        hint = "lower variation.growth_steps"
    wanted = np.where(grows, np.maximum(np.rint(wanted), 1.0), 0.0)
    check_budget("growth steps", float(wanted.sum()), _BYTES_PER_STEP, hint)
    return wanted.astype(np.int64)


def _gains(variation: Variation, steps: Ints) -> tuple[Floats, Floats]:
    """Lifetime of a signal in growth steps, and kappa, of each axis."""
    lag, kappa, ratio = (
        variation.lag,
        variation.kappa,
        variation.compensation_ratio or 1.0,
    )  # two of the three are given
    if lag is not None:
        lag_steps = np.rint(lag * steps) if kappa is not None else np.maximum(np.rint(lag * steps), 1.0)
        return lag_steps, 1.0 / (ratio * lag_steps) if kappa is None else np.full(len(steps), kappa)
    assert kappa is not None
    return np.full(len(steps), np.rint(min(1.0 / (kappa * ratio), _MOST_LAG_STEPS))), np.full(len(steps), kappa)


def _radial(size_deg: Function, distribution: str, order: Ints, rng: np.random.Generator) -> Floats:
    """(S, 2) angle and azimuth of random directions about another; (0, 2) where there are none."""
    size = np.radians(evaluate(size_deg, np.arange(order.max(initial=0) + 1.0)))[order]
    if not np.any(size):
        return np.zeros((0, 2))
    count = len(order)
    angle = rng.standard_normal(count) if distribution == "gaussian" else rng.uniform(-1.0, 1.0, count)
    return np.stack([size * angle, rng.uniform(0.0, 2.0 * np.pi, count)], axis=1)


def _chosen(axes: Axes, orders: tuple[int, ...] | None) -> NDArray[np.bool_]:
    return np.ones(len(axes.order), np.bool_) if orders is None else np.isin(axes.order, orders)


def _turns(
    axes: Axes, variation: Variation, steps: Ints, begin: Ints, middle: Floats, axis: Ints, azimuth: Floats
) -> tuple[Floats, Floats, Ints]:
    """Turns of each step in the base's frame, turns of whole axes, and the step before which those have grown."""
    turn = np.zeros((len(axis), 3))
    whole, until = np.zeros((len(steps), 3)), np.zeros(len(steps), np.int64)
    for one in variation.influences:
        normal = normals(axes.foot, one.plane, azimuth)
        angle = np.radians(evaluate(one.turn_deg, middle)) / np.maximum(steps, 1)[axis]
        turn += np.where(_chosen(axes, one.orders)[axis], angle, 0.0)[:, None] * normal[axis]
    for event in variation.displacements:
        chosen = np.flatnonzero((steps > 0) & _chosen(axes, event.orders))
        rotation = np.radians(event.turn_deg) * normals(axes.foot[chosen], event.plane, azimuth[chosen])
        at = np.rint(event.at * steps[chosen]).astype(np.int64)
        if event.turns == "plant":
            whole[chosen], until[chosen] = rotation, at
            chosen, at, rotation = chosen[at == 0], at[at == 0], rotation[at == 0]
        inside = at < steps[chosen]
        turn[(begin[chosen] + at)[inside]] += rotation[inside]
    return (turn if np.any(turn) else np.zeros((0, 3))), whole, until


def _targets(axes: Axes, variation: Variation, share: Floats, axis: Ints, azimuth: Floats) -> tuple[Floats, Floats]:
    """Turn of the target at each step in the base's frame, and the weight of the direction to which it is drawn."""
    turn, weight = np.zeros((0, 3)), np.zeros(0)
    bend, pull = variation.target_bend, variation.target_pull
    if bend is not None:
        angle = np.where(_chosen(axes, bend.orders)[axis], np.radians(evaluate(bend.turn_deg, share)), 0.0)
        turn = angle[:, None] * normals(axes.foot, bend.plane, azimuth)[axis]
    if pull is not None:
        weight = np.clip(evaluate(pull.weight, share), 0.0, 1.0)
        weight = np.where(_chosen(axes, pull.orders)[axis], weight, 0.0)
    return turn, weight


def normals(foot: Floats, plane: Plane, azimuth: Floats) -> Floats:
    """(A, 3) unit axes about which a positive angle turns as `plane` says; see `variation.Plane`.

    `foot`: (A, 3) unit directions in which the axes begin. `azimuth`: (A,) radians, for random planes.
    """
    if isinstance(plane, int | float):
        angle = np.radians(plane)
        return np.broadcast_to(np.cross(UP, [np.sin(angle), np.cos(angle), 0.0]), foot.shape)
    up = np.cross(foot, UP)
    upright = np.linalg.norm(up, axis=1) < _UPRIGHT_SINE
    up[upright] = np.cross(foot[upright], [1.0, 0.0, 0.0])
    up = unit(up)
    match plane:
        case "up":
            return up
        case "side":
            return np.cross(up, foot)
        case "random":
            return rotate(up, foot, azimuth)


def vary(skeleton: Skeleton, variation: Variation, rng: np.random.Generator) -> Skeleton:
    """The plant as it would have grown under the influences of `variation`.

    Lengths, and the base's own bends, are as they were; axes may have more nodes. Without influences the skeleton
    comes back unchanged.

    Raises `RecipeError`: more growth steps than memory holds.
    """
    axes, new = varied_nodes(skeleton, variation, rng)
    parent = np.arange(-1, len(new.source) - 1)
    begins = axes.bearer >= 0
    parent[new.piece_of[axes.first[begins]]] = new.new_of[axes.bearer[begins]]
    position = skeleton.position_m.astype(np.float64)
    start = position[np.maximum(skeleton.parent, 0)]
    organs = tuple(_carried(one, start, position, new) for one in skeleton.organs)
    order, axis = skeleton.order[new.source], skeleton.axis[new.source]
    return Skeleton.of(parent, new.point_m + new.shift_m, _radius(skeleton, axes, new), order, axis, organs=organs)


def varied_nodes(skeleton: Skeleton, variation: Variation, rng: np.random.Generator) -> tuple[Axes, NewNodes]:
    """Where the loop takes every node of a skeleton, in double precision."""
    base = skeleton.position_m.astype(np.float64)
    axes = axes_of(skeleton, base)
    t = tables(axes, variation, rng)
    most = len(base) + int(t.steps.sum())
    new = NewNodes(
        new_of=np.zeros(len(base), np.int64),
        piece_of=np.zeros(len(base), np.int64),
        point_m=np.empty((most, 3)),
        shift_m=np.empty((most, 3)),
        quaternion=np.empty((most, 4)),
        source=np.empty(most, np.int64),
        share=np.empty(most),
    )
    gains = (variation.derivative_gain, variation.integral_gain)
    toward = variation.target_pull.direction() if variation.target_pull else (0.0, 0.0, 1.0)
    signal = np.empty((int(t.steps.max(initial=1)), 3))
    made = walk(base, axes, t, gains, variation.reference == "local", toward, new, signal)
    filled: dict[str, NDArray[Any]] = {name: column[:made] for name, column in new._asdict().items()}
    return axes, NewNodes(**{**filled, "new_of": new.new_of, "piece_of": new.piece_of})


def _radius(base: Skeleton, axes: Axes, new: NewNodes) -> Floats:
    """Thickness, even between the base's nodes; an axis begins as thick as its own first node."""
    end = base.radius_m.astype(np.float64)
    start = end[np.maximum(base.parent, 0)]
    start[axes.first] = end[axes.first]
    radius = start[new.source] + new.share * (end - start)[new.source]
    return np.where(new.share == 1.0, end[new.source], radius)


def _carried(placement: OrganPlacements, start: Floats, end: Floats, new: NewNodes) -> OrganPlacements:
    frame = placement.frame.astype(np.float64)
    out, node = np.empty_like(frame), np.empty(len(frame), np.int64)
    carry(frame, placement.node.astype(np.int64), start, end, new, out, node)
    return replace(placement, frame=out.astype(np.float32), node=node.astype(np.int32))
