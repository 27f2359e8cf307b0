"""The thin twigs between shoots: a spruce keeps its needles for years, and so they stand along what bears the shoots.

Each shoot takes the piece of its axis below it, down to the next shoot, or at most as far again as that one where it is
the lowest.
"""

from __future__ import annotations

import numpy as np

from forestgen.geometry.mesh import Floats, Ints
from forestgen.plants.skeleton import OrganPlacements, Skeleton, Twigs

_BARE_M = 0.005  # radius of a twig that has shed its needles, about ten years old
_LEAST_M = 1e-3


def needle_twigs(skeleton: Skeleton, placed: OrganPlacements) -> Twigs:
    """Pieces of a skeleton that bear the needles of some shoots."""
    end = skeleton.position_m.astype(np.float64)
    start = end[np.maximum(skeleton.parent, 0)]
    segment = np.linalg.norm(end - start, axis=1)
    total = np.cumsum(segment)
    low, high, organ = _stretches(skeleton, placed, start, segment, total)
    piece, inner = _cut(low, high, total)
    bounds = np.concatenate([[0.0], total])
    node = np.minimum(np.searchsorted(total, low, side="right")[piece] + inner, len(total) - 1)
    ends = np.stack([np.maximum(low[piece], bounds[node]), np.minimum(high[piece], total[node])], axis=1)
    share = np.clip((ends - bounds[node][:, None]) / np.maximum(segment[node], 1e-12)[:, None], 0.0, 1.0)
    points = start[node][:, None] + share[..., None] * (end - start)[node][:, None]
    radius = skeleton.radius_m[node].astype(np.float64)
    kept = (radius < _BARE_M) & (np.diff(ends, axis=1)[:, 0] > _LEAST_M)
    return Twigs(points[kept].astype(np.float32), radius[kept].astype(np.float32), organ[piece][kept].astype(np.int32))


def _stretches(
    skeleton: Skeleton, placed: OrganPlacements, start: Floats, segment: Floats, total: Floats
) -> tuple[Floats, Floats, Ints]:
    """Lower and upper end of what each organ takes, as lengths along all axes one after another; and the organ."""
    node = placed.node.astype(np.int64)
    way = skeleton.position_m[node] - start[node]
    along = np.sum((placed.frame[:, :, 3] - start[node]) * way, axis=1) / np.maximum(segment[node], 1e-12)
    at = total[node] - segment[node] + np.clip(along, 0.0, segment[node])
    first, _ = skeleton.axes()
    axis = np.searchsorted(first, node, side="right") - 1
    order = np.lexsort((at, axis))
    at, axis = at[order], axis[order]
    bearer = skeleton.parent[first]
    hidden = np.where(bearer >= 0, skeleton.radius_m[np.maximum(bearer, 0)], 0.0)
    base = (total[first] - segment[first] + hidden)[axis]
    same = np.diff(axis, prepend=-1) == 0
    gap = np.diff(at, prepend=0.0)
    above = np.append(np.where(same, gap, 0.0)[1:], 0.0)
    low = np.where(same, at - gap, np.maximum(at - above, base))
    return np.minimum(low, at), at, order


def _cut(low: Floats, high: Floats, total: Floats) -> tuple[Ints, Ints]:
    """Stretches cut where nodes are: the stretch of each piece, and how many nodes of it lie below the piece."""
    nodes = np.searchsorted(total, high, side="left") - np.searchsorted(total, low, side="right") + 1
    nodes = np.maximum(nodes, 1)
    piece = np.repeat(np.arange(len(low)), nodes)
    return piece, np.arange(len(piece)) - np.repeat(np.cumsum(nodes) - nodes, nodes)
