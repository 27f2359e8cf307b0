"""Growth steps, gains and influences of a skeleton's axes, and running the loop of `loop.py` on them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from forestgen.geometry.mesh import UP, Floats, Ints, rotate, unit
from forestgen.plants.budget import check_budget
from forestgen.plants.skeleton import OrganPlacements, Skeleton
from forestgen.plants.variation.loop import NewNodes, carry, walk
from forestgen.plants.variation.model import Plane, Variation
from forestgen.recipe.curves import Function, evaluate

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
    return Skeleton.of(
        parent,
        new.point_m + new.shift_m,
        _radius(skeleton, axes, new),
        skeleton.order[new.source],
        skeleton.axis[new.source],
        organs=tuple(_carried(one, position[np.maximum(skeleton.parent, 0)], position, new) for one in skeleton.organs),
    )


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
