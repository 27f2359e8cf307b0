"""Forked stems: above a height a tree has two stems alike in place of one.

Both are the stem that the generator grew, the second one turned by half a circle. They part in a curve, and each keeps
the branches of its outer side, so that a forked crown has about as many as another. Together they have a little more
cross-section than the one below (`FORKED`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from forestgen.geometry.mesh import Bools, Floats, Ints
from forestgen.plants.crown_twigs import first_stem
from forestgen.plants.skeleton import OrganPlacements, Skeleton
from forestgen.recipe.wood import Wood

FORKED = 0.75  # radius of each stem of a fork over that of one stem there: 0.71 keeps the cross-section; by estimate
_CURVE = (0.0, 0.15, 0.4, 0.8, 1.4)  # where the curve has nodes, above the fork, over `_UPRIGHT` of the rest
_UPRIGHT = 0.3  # of the height above the fork: where the stems' lean has fallen to 1/e
Placed = Callable[[Floats, Bools, Floats | None], Floats]
_HALF_TURN = np.array([-1.0, -1.0, 1.0])


def forked(skeleton: Skeleton, wood: Wood | None, rng: np.random.Generator) -> Skeleton:
    """The skeleton with a fork by the law's chance; as it was where no stem goes on above."""
    if wood is None or wood.forks is None:
        return skeleton
    law, (chance, height, way, angle) = wood.forks, rng.spawn(1)[0].random(4)
    stem = np.flatnonzero(first_stem(skeleton.axis))
    z_m = skeleton.position_m[stem, 2].astype(np.float64)
    low, high = law.between
    at_m = (low + (high - low) * height) * float(z_m.max())
    above = int(np.argmax(z_m > at_m))
    if chance >= law.share or above == 0 or len(stem) - above < 2:
        return skeleton
    reach_m = _UPRIGHT * (float(z_m.max()) - at_m)
    whole = skeleton
    for share in reversed(_CURVE):
        whole = _with_node(whole, at_m + share * reach_m)
    azimuth = 2.0 * np.pi * way
    lean = np.tan(np.radians(0.5 * law.angle_deg * (0.6 + 0.8 * angle)))
    aside = lean * np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    own_lean = skeleton.position_m[stem[-1]] - skeleton.position_m[stem[above]]
    aside *= -1.0 if float(aside @ own_lean) < 0.0 else 1.0  # so that the second one, turned, does not cross it
    return _two(whole, int(stem[above]), aside)


def _with_node(skeleton: Skeleton, at_m: float) -> Skeleton:
    """The skeleton with one more node on its stem, at a height that the stem reaches."""
    stem, position = np.flatnonzero(first_stem(skeleton.axis)), skeleton.position_m.astype(np.float64)
    above = int(np.argmax(position[stem, 2] > at_m))
    upper, lower = int(stem[above]), int(stem[above - 1])
    share = (at_m - position[lower, 2]) / (position[upper, 2] - position[lower, 2])
    parent = skeleton.parent + (skeleton.parent >= upper)
    parent = np.insert(parent, upper, lower)
    parent[upper + 1] = upper
    made = position[lower] + share * (position[upper] - position[lower])
    radius = (1.0 - share) * skeleton.radius_m[lower] + share * skeleton.radius_m[upper]
    columns = (np.insert(one, upper, one[upper]) for one in (skeleton.order, skeleton.axis))
    organs = tuple(replace(one, node=one.node + (one.node >= upper).astype(np.int32)) for one in skeleton.organs)
    return Skeleton.of(
        parent,
        np.insert(position, upper, made, axis=0),
        np.insert(skeleton.radius_m, upper, radius),
        *columns,
        organs=organs,
    )


def _two(skeleton: Skeleton, fork: int, aside: Floats) -> Skeleton:
    """Two stems above the node `fork`; `aside`: (3,) where the first one leans, the tangent of its lean."""
    parent = skeleton.parent.tolist()
    number = len(parent)
    stem, position = first_stem(skeleton.axis), skeleton.position_m.astype(np.float64)
    upper = np.zeros(number, dtype=bool)  # the stem above the fork, and what it bears
    bearer = np.zeros(number, dtype=np.int64)  # the node of the stem that bears each
    for node in range(1, number):
        bearer[node] = node if stem[node] else bearer[parent[node]]
        upper[node] = bearer[node] > fork
    branch = np.zeros(number, dtype=np.int64)  # the first node of the branch that each belongs to
    for node in np.flatnonzero(upper & ~stem).tolist():
        branch[node] = node if stem[parent[node]] else branch[parent[node]]
    outward = np.zeros(number)
    np.add.at(outward, branch, (position - position[bearer]) @ aside)
    kept = ~upper | stem | (outward[branch] >= 0.0)
    row = np.cumsum(kept) - 1
    copied = np.flatnonzero(kept & upper)
    second = np.zeros(number, dtype=np.int64)
    second[copied] = np.arange(len(copied)) + int(kept.sum())
    second[fork] = row[fork]
    foot, length_m = position[fork], max(float(position[stem, 2].max()) - float(position[fork, 2]), 1e-6)

    def placed(points_m: Floats, above: Bools, half: Floats | None) -> Floats:
        way = points_m - foot
        if half is not None:
            way = way * half
        reach = _UPRIGHT * length_m
        moved = reach * (1.0 - np.exp(-np.maximum(way[:, 2:], 0.0) / reach)) * aside
        return np.where(above[:, None], foot + way + (moved if half is None else -moved), points_m)

    one, every = placed(position, upper, None)[kept], np.ones(len(copied), dtype=bool)
    two = placed(position[copied], every, _HALF_TURN)
    organs = tuple(_organs(each, kept, upper, row, second, placed) for each in skeleton.organs)
    whole = np.concatenate([np.flatnonzero(kept), copied])
    bearers = skeleton.parent.astype(np.int64)
    below = np.where(bearers[kept] >= 0, row[np.maximum(bearers[kept], 0)], -1)
    parents = np.concatenate([below, second[bearers[copied]]])
    axis = np.concatenate([skeleton.axis[kept], skeleton.axis[copied] + skeleton.axis.max() + 1])
    radius = skeleton.radius_m[whole] * np.where(upper[whole], np.float32(FORKED), np.float32(1.0))
    return Skeleton.of(parents, np.concatenate([one, two]), radius, skeleton.order[whole], axis, organs=organs)


def _organs(
    organs: OrganPlacements, kept: Bools, upper: Bools, row: Ints, second: Ints, placed: Placed
) -> OrganPlacements:
    """The organs of both stems."""
    stay = kept[organs.node]
    both = stay & upper[organs.node]
    frame, turned = organs.frame[stay].copy(), organs.frame[both].copy()
    frame[:, :, 3] = placed(frame[:, :, 3].astype(np.float64), upper[organs.node[stay]], None)
    at = turned[:, :, 3].astype(np.float64)
    turned *= _HALF_TURN[:, None].astype(np.float32)
    turned[:, :, 3] = placed(at, np.ones(len(at), dtype=bool), _HALF_TURN)
    node: NDArray[np.int64] = np.concatenate([row[organs.node[stay]], second[organs.node[both]]])
    return replace(organs, frame=np.concatenate([frame, turned]), node=node.astype(np.int32), twigs=None)
