"""Statistics of all pairs of a point pattern in a rectangular window: Ripley's K, Besag's L, the pair correlation.

K(r) is the mean number of other points within a distance r of a point, over the density. Circles that reach over the
window's edge miss points, and each pair (i, j) therefore counts with a weight e:

    isotropic     1 / share of the circle about i through j that lies in the window (Ripley), at most 100
    translation   |W| / |W ∩ (W + p_j - p_i)| (Ohser)
    periodic      1: opposite edges of the window meet

    K(r) = |W| / (n (n - 1)) * sum of e over ordered pairs not farther apart than r

These are spatstat's conventions (`Kest`). A random pattern has K = π r², L = r, g = 1.

Time is that of the pairs within the greatest radius, N * density * π r² of them, at about eight million a second; pairs
are made in portions, so memory is that of a portion and of the points.

References
----------
Ripley 1977, J. R. Stat. Soc. B 39. Baddeley, Rubak and Turner 2015, Spatial Point Patterns, ch. 7.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from forestgen.community.point_patterns import Window, pattern_tree

Correction = Literal["isotropic", "translation", "periodic"]

_PAIRS_AT_ONCE = 1_000_000
_MOST_WEIGHT = 100.0  # as spatstat: a circle that hardly touches the window must not outweigh all others


def greatest_radius(window: Window, correction: Correction = "translation") -> float:
    """Radius up to which an edge correction has no bias, metres.

    Farther apart, translation leaves no overlap in some direction, and no circle about some points meets the window.
    """
    shorter_m = min(window.size_m)
    return shorter_m / 2 if correction == "periodic" else min(shorter_m, math.hypot(*window.size_m) / 2)


def count_pairs(points_m: NDArray[np.float64], reach_m: float) -> int:
    """How many ordered pairs lie within a distance."""
    tree = cKDTree(points_m)
    return int(np.asarray(tree.count_neighbors(tree, reach_m))) - len(points_m)


def ripley_k(
    points_m: NDArray[np.float64], window: Window, radii_m: NDArray[np.float64], correction: Correction
) -> NDArray[np.float64]:
    """Ripley's K at some radii.

    Parameters
    ----------
    points_m : (N, 2) float64, metres, in the window; N must be 2 at least.
    radii_m : (R,) metres, in any order, from 0 to `greatest_radius`.

    Returns
    -------
    (R,) float64, square metres.
    """
    radii = _checked(points_m, window, radii_m, correction)
    order = np.argsort(radii, kind="stable")
    sums = np.zeros(len(radii) + 1)
    for distance, weight in _weighted_pairs(points_m, window, float(radii.max(initial=0.0)), correction):
        ring = np.searchsorted(radii[order], distance, side="left")  # the first radius that is no less
        sums += np.bincount(ring, weights=weight, minlength=len(sums))
    k = np.empty(len(radii))
    k[order] = np.cumsum(sums[:-1])
    n = len(points_m)
    return k * (window.area_m2 / (n * (n - 1)))


def besag_l(k_m2: NDArray[np.float64]) -> NDArray[np.float64]:
    """Besag's L = sqrt(K / π), metres, which is r for a random pattern."""
    return np.asarray(np.sqrt(k_m2 / np.pi))


def ripley_bound(n: int, window: Window) -> float:
    """The greatest |L(r) - r|, metres, of nineteen random patterns in twenty, over all radii that are not large.

    References
    ----------
    Ripley 1979, J. R. Stat. Soc. B 41: 1.45 sqrt(|W|) / n.
    """
    return 1.45 * math.sqrt(window.area_m2) / n


def pair_correlation(
    points_m: NDArray[np.float64],
    window: Window,
    radii_m: NDArray[np.float64],
    correction: Correction,
    *,
    bandwidth_m: float | None = None,
) -> NDArray[np.float64]:
    """Pair correlation g(r) = K'(r) / (2 π r): how much likelier than at random another point is at a distance r.

    g(r) = |W| / (2 π n (n - 1)) * sum over ordered pairs of e k(r - d) / d, with Epanechnikov's kernel k. Below the
    bandwidth a part of the kernel reaches past d = 0, and g is too low.

    Parameters
    ----------
    points_m, radii_m : as for `ripley_k`.
    bandwidth_m : half the width of the kernel; by default Stoyan's 0.15 / sqrt(density).

    Returns
    -------
    (R,) float64.
    """
    radii = _checked(points_m, window, radii_m, correction)
    n = len(points_m)
    h = bandwidth_m if bandwidth_m is not None else 0.15 * math.sqrt(window.area_m2 / n)
    if not h > 0:
        raise ValueError(f"bandwidth_m must be positive, got {h!r}")
    # The kernel is a parabola in d: three moments of the pairs between r - h and r + h give its sum.
    edges = np.sort(np.concatenate([radii - h, radii + h]))
    moments = np.zeros((3, len(edges) + 1))
    for distance, weight in _weighted_pairs(points_m, window, float(radii.max(initial=0.0)) + h, correction):
        apart = distance > 0
        d, w = distance[apart], weight[apart]
        interval = np.searchsorted(edges, d, side="left")
        for power in range(3):
            moments[power] += np.bincount(interval, weights=w * d ** (power - 1), minlength=moments.shape[1])
    below = np.concatenate([np.zeros((3, 1)), np.cumsum(moments, axis=1)], axis=1)
    first, last = np.searchsorted(edges, radii - h, side="right"), np.searchsorted(edges, radii + h, side="left")
    m0, m1, m2 = below[:, last + 1] - below[:, first]
    kernel_sum = 0.75 / h * (m0 - (radii**2 * m0 - 2 * radii * m1 + m2) / h**2)
    return np.asarray(np.maximum(kernel_sum, 0.0)) * (window.area_m2 / (2 * math.pi * n * (n - 1)))


def _checked(
    points_m: NDArray[np.float64], window: Window, radii_m: NDArray[np.float64], correction: Correction
) -> NDArray[np.float64]:
    radii = np.asarray(radii_m, dtype=np.float64)
    most = greatest_radius(window, correction)
    if len(points_m) < 2:
        raise ValueError(f"pairs need 2 points, got {len(points_m)}")
    if np.any(window.outside(points_m)):
        raise ValueError("all points must lie in the window")
    if radii.ndim != 1 or not np.all((radii >= 0) & (radii <= most)):
        raise ValueError(f"radii_m must lie in [0, {most:g}], got {radii_m!r}")
    return radii


def _weighted_pairs(
    points_m: NDArray[np.float64], window: Window, reach_m: float, correction: Correction
) -> Iterator[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Distances and weights e of all ordered pairs within a distance, a portion at a time."""
    tree, moved = pattern_tree(points_m, window, correction == "periodic")
    order = np.asarray(tree.indices)  # neighbours in the tree stay together
    numbers = np.asarray(tree.query_ball_point(moved[order], reach_m, return_length=True), dtype=np.int64)
    portion = (np.cumsum(numbers) - numbers) // _PAIRS_AT_ONCE
    for rows in np.split(order, np.flatnonzero(np.diff(portion)) + 1):
        some = cKDTree(moved[rows], boxsize=tree.boxsize)
        pairs = some.sparse_distance_matrix(tree, reach_m, output_type="ndarray")
        pairs = pairs[rows[pairs["i"]] != pairs["j"]]
        here, there, distance = moved[rows[pairs["i"]]], moved[pairs["j"]], pairs["v"]
        yield distance, _weights(here, there, distance, window, correction)


def _weights(
    here: NDArray[np.float64],
    there: NDArray[np.float64],
    distance: NDArray[np.float64],
    window: Window,
    correction: Correction,
) -> NDArray[np.float64]:
    weight = np.ones(len(distance))
    if correction == "translation":
        overlap = np.prod(window.size_m - np.abs(there - here), axis=1)
        np.divide(window.area_m2, overlap, out=weight, where=overlap > 0)
    if correction == "isotropic":
        width, height = window.size_m
        sides = np.stack([here[:, 0], here[:, 1], width - here[:, 0], height - here[:, 1]])
        cut = np.flatnonzero(sides.min(axis=0) < distance)
        inside = 1 - _angle_outside(sides[:, cut], distance[cut]) / (2 * np.pi)
        weight[cut] = 1 / np.maximum(inside, 1 / _MOST_WEIGHT)
    return weight


def _angle_outside(sides: NDArray[np.float64], radius: NDArray[np.float64]) -> NDArray[np.float64]:
    """(P,) angle of circles that lies outside a rectangle.

    Parameters
    ----------
    sides : (4, P) distances of the centre to the four sides, in order around the rectangle.
    """
    half = np.arccos(np.minimum(sides / radius, 1.0))  # half of the arc beyond a side's line
    angle = np.zeros(len(radius))
    for one, other in ((0, 1), (1, 2), (2, 3), (3, 0)):
        # Towards a corner inside the circle, the arcs beyond its two sides overlap: each ends at the corner.
        corner = np.arctan2(sides[other], sides[one])
        angle += np.minimum(half[one], corner) + np.minimum(half[other], np.pi / 2 - corner)
    return angle
