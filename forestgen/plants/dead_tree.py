"""What death leaves of a tree's skeleton: fewer branches with every decay class, and a stem that stands or lies.

The skeleton is the one that the species' generator grows and `tree_fit` fits, of the height that the tree had. What a
class has lost the next one has lost too:

- Twigs: of those thinner than `_THINNEST_M` none is left; of others a share goes, by a number of each axis' own.
- Branches break off at a share of their length, by the same number; short stubs are left.
- The stem ends at `DeadTree.left` of the height, in splinters; a felled one's stump at a sawn face.

The radius of the stem follows `core.stem_form`, so that volumes are those of forestry.

A stem that lies along +y touches the ground all along: its axis is as high as its radius, less what has sunk in. What
of its branches points steeply down has broken off; others that would be below the ground lie on it. An uprooted tree's
root plate stands on its edge at the foot, half of it above the ground.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from forestgen.core.dead_wood import SNAPPED_AT, DeadForm, DeadTree, stump_height_m
from forestgen.geometry.mesh import Bools, Floats, Ints, unit
from forestgen.plants.crown_twigs import TWIG_ORDER, first_stem
from forestgen.plants.skeleton import Skeleton
from forestgen.plants.splinters import splinters
from forestgen.plants.tree_fit import with_taper

# By decay class, 1 to 5. Where no number is in the sources of `core.dead_wood`, they are ours.
_THINNEST_M = (0.0, 0.005, 0.012, 0.03, 0.05)  # diameter
_LOST = (0.0, 0.12, 0.3, 0.6, 0.96)  # share of the axes
_LOST_TWIGS = (0.0, 0.01, 0.04, 0.2, 1.0)  # of twigs, each of which bears others
_REACH = (20.0, 2.5, 0.8, 0.3, 0.07)  # share of the length that is left of the axis of which most is left
_SUNK = (0.02, 0.04, 0.12, 0.3, 0.45)  # share of a lying stem's diameter in the ground
_PLATE = (1.0, 0.95, 0.85, 0.65, 0.45)  # radius of the root plate over the first class'
_LEAN_DEG, _LEANING, _LEANING_DEG = 2.0, 0.15, (8.0, 22.0)  # of most; share of trees that lean more, and how far
_STEEP = 0.4  # of a branch's way from the stem, downwards, over the way: below the ground it has broken off
_LIES = 0.7  # of its radius: how high a branch on the ground is
_STEP_RADII = 0.8  # between nodes of a stem, over its radius
_SPLINTER_RADII, _MOST_SPLINTERS = 2.6, 18  # length of the longest over the break's radius
_BREAK_M = 0.02  # radius of a broken stem that shows splinters
_ROOTS, _ROOT_NODES, _ROOT_WANDER_RAD = 60, 9, 0.13  # of a root plate: number, nodes of one, turn at each
_LOST_ROOTS = (0.0, 0.1, 0.3, 0.6, 0.85)  # share of them
_THREAD_M = 1e-6  # see `Skeleton.is_thread`
_BEHIND = 0.6  # of the stem's diameter, between a high stump and the stem that has fallen off it


@dataclass(frozen=True)
class DeadSkeleton:
    """A dead tree's skeleton, and the faces that its mesh has besides."""

    skeleton: Skeleton
    lying_m3: float = 0.0  # volume of the stem on the ground
    sawn: tuple[Floats, float] | None = None  # height and diameter of a sawn face
    plate_m: float = 0.0  # radius of the root plate; 0: none


def dead_skeleton(
    living: Skeleton, dead: DeadTree, whole_m: float, dbh_m: float, rng: np.random.Generator
) -> DeadSkeleton:
    """What is left of a tree of `whole_m`, its skeleton at its final size, whatever organs it has.

    Random numbers are the same for all classes of a form, so that what is left of a class is part of what is left of
    the one before.
    """
    axis_rng, end_rng, form_rng = rng.spawn(3)
    turned = _turned_about_z(replace(living, organs=(), mark=None), form_rng.uniform(0.0, 2.0 * np.pi))
    own = axis_rng.random(int(turned.axis.max()) + 1)  # of each axis
    fine = _finer(turned, _STEP_RADII * 0.5 * dbh_m)
    stem = first_stem(fine.axis)
    tapered = with_taper(fine, whole_m, dbh_m)
    top_m = float(stump_height_m(np.array(dbh_m))) if dead.form == DeadForm.STUMP else dead.left * whole_m
    bare = _cut(tapered, _ends(tapered, stem, own, dead.decay, top_m))
    match dead.form:
        case DeadForm.UPROOTED:
            return _uprooted(bare, dead, dbh_m, end_rng)
        case DeadForm.SNAPPED:
            return _snapped(bare, dead, whole_m, end_rng)
        case DeadForm.STUMP:
            return _stump(bare)
        case _:
            broken = _splintered(bare, end_rng) if dead.left < 1.0 else bare
            return DeadSkeleton(_leaning(broken, form_rng))


def _turned_about_z(skeleton: Skeleton, angle_rad: float) -> Skeleton:
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return replace(skeleton, position_m=(skeleton.position_m.astype(np.float64) @ turn.T).astype(np.float32))


def _finer(skeleton: Skeleton, step_m: float) -> Skeleton:
    """With nodes on the stem at least so close, between which patches of bark end."""
    start = skeleton.position_m[np.maximum(skeleton.parent, 0)].astype(np.float64)
    way = skeleton.position_m - start
    pieces = np.ceil(np.linalg.norm(way, axis=1) / step_m).astype(np.int64)
    pieces = np.where(first_stem(skeleton.axis), np.maximum(pieces, 1), 1)
    node, last = np.repeat(np.arange(len(pieces)), pieces), np.cumsum(pieces) - 1
    part = np.arange(len(node)) - (last - pieces)[node]
    bearer = np.where(skeleton.parent[node] < 0, -1, last[np.maximum(skeleton.parent[node], 0)])
    return Skeleton.of(
        np.where(part == 1, bearer, np.arange(len(node)) - 1),
        start[node] + (part / pieces[node])[:, None] * way[node],
        skeleton.radius_m[node],
        skeleton.order[node],
        skeleton.axis[node],
    )


def _ends(skeleton: Skeleton, stem: Bools, own: Floats, decay: int, top_m: float) -> Floats:
    """(N,) how far each segment is left, as a share of it: 1 whole, 0 gone."""
    parent = np.maximum(skeleton.parent, 0)
    position = skeleton.position_m.astype(np.float64)
    step = np.linalg.norm(position - position[parent], axis=1)
    first, last = skeleton.axes()
    number = np.repeat(np.arange(len(first)), last - first)
    along = np.cumsum(step)
    begins = (along - step)[first]
    length = along[last - 1] - begins
    lost, reach, number_of = _LOST[decay - 1], _REACH[decay - 1], own[skeleton.axis[first]]
    share = np.clip(reach * (number_of - lost) / (1.0 - lost), 0.0, 1.0)
    share = np.where(skeleton.order[first] >= TWIG_ORDER, number_of >= _LOST_TWIGS[decay - 1], share)
    end = (begins + share * length)[number]
    left = np.clip((end - (along - step)) / np.maximum(step, 1e-9), 0.0, 1.0)
    left[2.0 * skeleton.radius_m < _THINNEST_M[decay - 1]] = 0.0
    low, high = position[parent, 2], position[:, 2]
    rise = np.maximum(high - low, 1e-9)
    left[stem] = np.clip((top_m - low) / rise, 0.0, 1.0)[stem]
    left[0] = 1.0
    return np.asarray(left)


def _cut(skeleton: Skeleton, left: Floats) -> Skeleton:
    """The skeleton less what is gone; the last segment of what has broken is shortened."""
    kept = left > 0.0
    whole, parents = (left >= 1.0).tolist(), skeleton.parent.tolist()
    alive = kept.tolist()
    for node in range(1, len(alive)):
        alive[node] = alive[node] and alive[parents[node]] and whole[parents[node]]
    kept, parent = np.array(alive), np.maximum(skeleton.parent, 0)
    start = skeleton.position_m[parent].astype(np.float64)
    position = start + left[:, None] * (skeleton.position_m - start)
    onward = skeleton.axis[parent] == skeleton.axis
    begin = np.where(onward, skeleton.radius_m[parent], skeleton.radius_m)
    radius = np.minimum(begin + left * (skeleton.radius_m - begin), begin)
    position[0], radius[0] = skeleton.position_m[0], skeleton.radius_m[0]
    shorter = replace(skeleton, position_m=position.astype(np.float32), radius_m=radius.astype(np.float32))
    return _part(shorter, np.flatnonzero(kept))


def _part(skeleton: Skeleton, node: Ints) -> Skeleton:
    """Some nodes of a skeleton, none of whose bearers but the first's is left out."""
    number = np.full(len(skeleton.parent), -1)
    number[node] = np.arange(len(node))
    parent = number[np.maximum(skeleton.parent[node], 0)]
    parent[0] = -1
    axis = np.unique(skeleton.axis[node], return_inverse=True)[1]
    return Skeleton.of(parent, skeleton.position_m[node], skeleton.radius_m[node], skeleton.order[node], axis)


def _with_axis(skeleton: Skeleton, points: Floats, radius: Floats, bearer: int, order: int = 1) -> Skeleton:
    """The skeleton with one more chain of (K, 3) points on a node."""
    count, more = len(skeleton.parent), len(points)
    return Skeleton.of(
        np.concatenate([skeleton.parent, [bearer], np.arange(count, count + more - 1)]),
        np.concatenate([skeleton.position_m, points]),
        np.concatenate([skeleton.radius_m, radius]),
        np.concatenate([skeleton.order, np.full(more, order)]),
        np.concatenate([skeleton.axis, np.full(more, skeleton.axis.max() + 1)]),
    )


def _splintered(skeleton: Skeleton, rng: np.random.Generator, *, foot: bool = False) -> Skeleton:
    """With splinters at the stem's upper end, or its foot."""
    nodes = np.flatnonzero(first_stem(skeleton.axis))
    end, inner = (nodes[0], nodes[1]) if foot else (nodes[-1], nodes[-2])
    radius = float(skeleton.radius_m[end])
    if radius < _BREAK_M:
        return skeleton
    place = skeleton.position_m[end].astype(np.float64)
    along = unit(place - skeleton.position_m[inner].astype(np.float64))
    for line, thick in splinters(place, along, radius, _SPLINTER_RADII * radius, _MOST_SPLINTERS, rng):
        skeleton = _with_axis(skeleton, line, thick, int(end))
    return skeleton


def _leaning(skeleton: Skeleton, rng: np.random.Generator) -> Skeleton:
    lean, leans, more = abs(rng.normal()) * _LEAN_DEG, rng.random(), rng.uniform(*_LEANING_DEG)
    angle = np.radians(more if leans < _LEANING else lean)
    cos, sin = np.cos(angle), np.sin(angle)
    turn = np.array([[1.0, 0.0, 0.0], [0.0, cos, sin], [0.0, -sin, cos]])
    return replace(skeleton, position_m=(skeleton.position_m.astype(np.float64) @ turn.T).astype(np.float32))


def _stump(skeleton: Skeleton) -> DeadSkeleton:
    stem = np.flatnonzero(first_stem(skeleton.axis))
    alone = _part(skeleton, stem)
    return DeadSkeleton(alone, sawn=(alone.position_m[-1].astype(np.float64), 2.0 * float(alone.radius_m[-1])))


def _uprooted(bare: Skeleton, dead: DeadTree, dbh_m: float, rng: np.random.Generator) -> DeadSkeleton:
    broken = _splintered(bare, rng) if dead.left < 1.0 else bare
    volume = _stem_volume_m3(broken)
    laid = _laid(broken, dead.decay)
    plate = _PLATE[dead.decay - 1] * float(np.clip(0.35 + 3.2 * dbh_m, 0.4, 2.6))
    return DeadSkeleton(_with_roots(laid, plate, dead.decay, rng), volume, plate_m=plate)


def _snapped(bare: Skeleton, dead: DeadTree, whole_m: float, rng: np.random.Generator) -> DeadSkeleton:
    """A high stump, and the stem above on the ground behind it."""
    stump_rng, top_rng = rng.spawn(2)
    at_m, stem = SNAPPED_AT * whole_m, first_stem(bare.axis)
    above = np.zeros(len(bare.parent), dtype=bool)
    above[stem] = bare.position_m[stem, 2] > at_m
    for node in np.flatnonzero(~stem).tolist():
        above[node] = above[bare.parent[node]]
    stump = _splintered(_cut(bare, np.where(above, _to_height(bare, stem, at_m), 1.0)), stump_rng)
    first = int(np.flatnonzero(above & stem)[0])
    nodes = np.concatenate([[bare.parent[first]], np.flatnonzero(above)])
    top = _part(bare, nodes)
    foot = top.position_m[0].astype(np.float64)
    up = (top.position_m[1] - foot) / max(float(top.position_m[1, 2] - foot[2]), 1e-6)
    foot += up * (at_m - foot[2])
    moved = top.position_m - foot
    moved[0] = 0.0
    top = _splintered(replace(top, position_m=moved.astype(np.float32)), top_rng)
    volume = _stem_volume_m3(top)
    laid = _laid(_splintered(top, top_rng, foot=True), dead.decay)
    behind = np.array([0.0, stump.radius_m[0] + _BEHIND * 2.0 * float(top.radius_m[0]), 0.0])
    return DeadSkeleton(_joined(stump, replace(laid, position_m=(laid.position_m + behind).astype(np.float32))), volume)


def _to_height(skeleton: Skeleton, stem: Bools, at_m: float) -> Floats:
    """(N,) share of each segment of the stem below a height; 0 of branches."""
    low, high = skeleton.position_m[np.maximum(skeleton.parent, 0), 2], skeleton.position_m[:, 2]
    share = np.clip((at_m - low) / np.maximum(high - low, 1e-9), 0.0, 1.0)
    return np.where(stem, share, 0.0)


def _joined(stump: Skeleton, top: Skeleton) -> Skeleton:
    """Both, by a thread."""
    butt = top.position_m[:1].astype(np.float64)
    thread = np.concatenate([butt - [[0.0, 1e-3, 0.0]], butt])
    whole = _with_axis(stump, thread, np.full(2, _THREAD_M), 0)
    count = len(whole.parent)
    # The top's foot takes the thread's end as its bearer: its line begins there.
    parent = np.where(top.parent[1:] == 0, count - 1, top.parent[1:] + count - 1)
    return Skeleton.of(
        np.concatenate([whole.parent, parent]),
        np.concatenate([whole.position_m, top.position_m[1:]]),
        np.concatenate([whole.radius_m, top.radius_m[1:]]),
        np.concatenate([whole.order, top.order[1:]]),
        np.concatenate([whole.axis, top.axis[1:] + whole.axis.max() + 1]),
    )


def _stem_volume_m3(skeleton: Skeleton) -> float:
    return _part(skeleton, np.flatnonzero(first_stem(skeleton.axis))).volume_m3()


def _laid(skeleton: Skeleton, decay: int) -> Skeleton:
    """The tree on its side along +y, its foot at the origin; see the module."""
    stem = first_stem(skeleton.axis)
    x, y, z = skeleton.position_m.astype(np.float64).T
    placed = np.stack([x, z, -y], axis=1)
    bearer = np.where(stem, np.arange(len(x)), 0)  # node of the stem that each node hangs on
    for node, parent in enumerate(skeleton.parent.tolist()):
        if not stem[node]:
            bearer[node] = bearer[parent]
    radius = skeleton.radius_m.astype(np.float64)
    axis_m = radius * (1.0 - 2.0 * _SUNK[decay - 1])
    placed[:, 2] += (axis_m - placed[:, 2])[bearer]
    way = placed - placed[bearer]
    down = -way[:, 2] / np.maximum(np.linalg.norm(way, axis=1), 1e-9)
    below = ~stem & (placed[:, 2] < _LIES * radius)
    left = np.where(below & (down > _STEEP), 0.0, 1.0)
    placed[:, 2] = np.where(below, _LIES * radius, placed[:, 2])
    return _cut(replace(skeleton, position_m=placed.astype(np.float32)), left)


def _with_roots(skeleton: Skeleton, plate_m: float, decay: int, rng: np.random.Generator) -> Skeleton:
    """Roots about the plane of the root plate, few of them thick, those into the ground broken off; fine ones rot."""
    foot, thick_m = skeleton.position_m[0].astype(np.float64), float(skeleton.radius_m[0])
    share = np.linspace(0.1, 1.0, _ROOT_NODES)
    for _ in range(_ROOTS):
        size, turn, is_left = rng.random() ** 2, rng.uniform(0.0, 2.0 * np.pi), rng.random() >= _LOST_ROOTS[decay - 1]
        reach_m, back = plate_m * (0.6 + 0.6 * size + 0.5 * rng.random()), rng.uniform(-0.45, 0.05)
        sides = np.cumsum(rng.normal(size=(2, _ROOT_NODES)), axis=1) * _ROOT_WANDER_RAD
        angle = turn + sides[0]
        behind = np.minimum(back + sides[1] - 0.3 * size * share, 0.0)
        out = np.stack([np.cos(angle), behind, np.sin(angle)], axis=1)
        line = foot + reach_m * share[:, None] * out
        radius_m = thick_m * (0.03 + 0.3 * size) * (1.0 - 0.85 * share**0.7)
        if is_left and np.sin(turn) > -0.3 and 2.0 * radius_m[0] > _THINNEST_M[decay - 1]:
            skeleton = _with_axis(skeleton, line, radius_m, 0)
    return skeleton
