"""How points lie in a rectangular window: clustered, at random, or regular.

Indices from distances to nearest points cost O(N log N) by a k-d tree. Statistics of all pairs are Ripley's K, Besag's
L and the pair correlation. Circles that reach over the window's edge miss points, and each pair (i, j) therefore counts
with a weight e:

    isotropic     1 / share of the circle about i through j that lies in the window (Ripley), at most 100
    translation   |W| / |W ∩ (W + p_j - p_i)| (Ohser)
    periodic      1: opposite edges of the window meet

    K(r) = |W| / (n (n - 1)) * sum of e over ordered pairs not farther apart than r

These are spatstat's conventions (`Kest`). A random pattern has K = π r², L = r, g = 1. Their time is that of the pairs
within the greatest radius, N * density * π r² of them, at about eight million a second; pairs are made in portions, so
memory is that of a portion and of the points.

Reference: Ripley 1977, J. R. Stat. Soc. B 39. Baddeley, Rubak and Turner 2015, Spatial Point Patterns, ch. 7.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from forestgen.community.population import Floats

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

Correction = Literal["isotropic", "translation", "periodic"]

_PAIRS_AT_ONCE = 1_000_000
_MOST_WEIGHT = 100.0  # as spatstat: a circle that hardly touches the window must not outweigh all others
_FEWEST_FOR_ERROR = 10
_BLOCKS = 36  # of the jackknife; more would be smaller than clusters, fewer would make the error itself uncertain
SAMPLES = 10_000  # points of the window
_FARTHEST_M, _LEAST_M, _MOST_M = 1e12, 1e-6, 1e9  # of a window's corners from the origin; of its sides


class Estimate(NamedTuple):
    """A number with its standard error; nan where that is not defined, as for fewer than ten points."""

    value: float
    error: float


@dataclass(frozen=True)
class Window:
    """The rectangle [x0, x1] x [y0, y1] in which a pattern was observed, metres."""

    x0: float
    x1: float
    y0: float
    y1: float

    def __post_init__(self) -> None:
        for name, low, high in (("x", self.x0, self.x1), ("y", self.y0, self.y1)):
            if not (math.isfinite(low) and math.isfinite(high) and low < high):
                raise ValueError(f"a window must have finite {name}0 < {name}1, got {low!r} and {high!r}")
            if not (max(-low, high) <= _FARTHEST_M and _LEAST_M <= high - low <= _MOST_M):
                raise ValueError(f"a window's sides are {_LEAST_M:g} to {_MOST_M:g} m, got {low!r} to {high!r}")

    def __str__(self) -> str:
        return f"[{self.x0:g}, {self.x1:g}] x [{self.y0:g}, {self.y1:g}] m"

    @property
    def size_m(self) -> tuple[float, float]:
        return self.x1 - self.x0, self.y1 - self.y0

    @property
    def area_m2(self) -> float:
        return self.size_m[0] * self.size_m[1]

    @property
    def corner_m(self) -> Floats:
        """(2,) the corner of least x and y."""
        return np.array([self.x0, self.y0])

    def outside(self, points_m: Floats) -> NDArray[np.bool_]:
        """(N,) whether a point lies outside; the edge belongs to the window."""
        beyond = (points_m < (self.x0, self.y0)) | (points_m > (self.x1, self.y1))
        return np.asarray(np.any(beyond, axis=1))


def pattern_tree(points_m: Floats, window: Window, periodic: bool) -> tuple[cKDTree, Floats]:
    """Tree of the points moved to the origin, and the moved points."""
    from scipy.spatial import cKDTree  # late: half a second

    moved = points_m - window.corner_m
    if not periodic:
        return cKDTree(moved), moved
    moved = np.mod(moved, window.size_m)
    moved[moved >= window.size_m] = 0.0  # the remainder of -1e-20 is the modulus itself
    return cKDTree(moved, boxsize=np.array(window.size_m)), moved


def _grid(window: Window, cells: int) -> tuple[int, int]:
    """Columns and rows of at least `cells` nearly square cells."""
    width, height = window.size_m
    nx = min(cells, max(1, math.ceil(math.sqrt(cells * width / height))))
    return nx, max(1, math.ceil(cells / nx))


def _block(moved: Floats, window: Window, grid: tuple[int, int]) -> NDArray[np.intp]:
    """(N,) index of the cell of a grid in which a point lies."""
    cell = np.minimum((moved / window.size_m * grid).astype(np.intp), np.array(grid) - 1)
    return np.asarray(cell[:, 0] * grid[1] + cell[:, 1])


@dataclass(frozen=True)
class Distances:
    """Distances to the nearest point of a pattern, and the blocks of the window to which they belong."""

    from_window_m: Floats  # (M,) a: from points spread over the window
    from_points_m: Floats  # (N,) b: from the pattern's own points, to another one
    window_block: NDArray[np.intp]  # (M,)
    point_block: NDArray[np.intp]  # (N,)


def measure_distances(
    points_m: Floats, window: Window, rng: np.random.Generator, *, samples: int = SAMPLES
) -> Distances:
    """Distances behind both Hopkins indices; N must be 2 at least.

    Parameters
    ----------
    points_m : (N, 2) float64, metres, in the window.
    rng : places points in the window, one in each cell of a grid: many times less scatter than free ones.
    samples : least number of them.
    """
    tree, moved = pattern_tree(points_m, window, periodic=False)
    grid = _grid(window, samples)
    cell = np.stack(np.meshgrid(np.arange(grid[0]), np.arange(grid[1])), axis=-1).reshape(-1, 2)
    spread = (cell + rng.random(cell.shape)) * (np.array(window.size_m) / grid)
    blocks = _grid(window, min(_BLOCKS, len(points_m)))
    return Distances(
        from_window_m=np.asarray(tree.query(spread)[0]),
        from_points_m=np.asarray(tree.query(moved, k=2)[0])[:, 1],
        window_block=_block(spread, window, blocks),
        point_block=_block(moved, window, blocks),
    )


def _ratio(above: tuple[Floats, NDArray[np.intp]], below: tuple[Floats, NDArray[np.intp]]) -> Estimate:
    """Ratio of two means, and its standard error by a jackknife that leaves out one block of the window at a time.

    A block takes its neighbours' dependence along, as single distances would not.
    """
    most = 1 + max(int(above[1].max()), int(below[1].max()))
    sums = np.array([np.bincount(block, weights=values, minlength=most) for values, block in (above, below)])
    numbers = np.array([np.bincount(block, minlength=most) for _, block in (above, below)])
    total, number = sums.sum(axis=1), numbers.sum(axis=1)
    if total[1] == 0:
        return Estimate(math.inf, math.nan)
    value = (total[0] / number[0]) / (total[1] / number[1])
    with np.errstate(divide="ignore", invalid="ignore"):
        means = (total[:, None] - sums) / (number[:, None] - numbers)
        without = means[0] / means[1]
    if min(number) < _FEWEST_FOR_ERROR or not np.all(np.isfinite(without)):
        return Estimate(float(value), math.nan)
    return Estimate(float(value), float(np.sqrt((most - 1) * np.var(without))))


def hopkins(distances: Distances) -> Estimate:
    """Hopkins index H of points in a bounded window: 1 is random, above 1 clustered, below 1 regular.

    H = <a> / <b>: the mean distance from a point of the window to the nearest point of the pattern, over the mean
    distance from a point of the pattern to the nearest other one. Nothing corrects for edges: they lengthen both means
    alike. The error is that of the pattern as one of many of its kind. H is inf where every point has a twin.

    Reference: Lane 2002, section 2.4 and Figure 2.3.
    """
    window, points = (distances.from_window_m, distances.window_block), (distances.from_points_m, distances.point_block)
    return _ratio(window, points)


def hopkins_index(
    points_m: Floats, size_m: tuple[float, float], rng: np.random.Generator, *, samples: int = SAMPLES
) -> float:
    """`hopkins` of points in [0, W] x [0, H]; nan for fewer than two points."""
    if len(points_m) < 2:
        return float("nan")
    window = Window(0.0, size_m[0], 0.0, size_m[1])
    return hopkins(measure_distances(points_m, window, rng, samples=samples)).value


def hopkins_skellam(distances: Distances) -> Estimate:
    """Hopkins-Skellam index A: 1 is random, below 1 clustered, above 1 regular.

    A = <b^2> / <a^2>, with a and b as in `hopkins`: the other way up, and of squares. By its definition <a^2> is the
    mean of as many random points as the pattern has, and A scatters with them. This is the mean of A over all such
    choices of points, which scatters no more. The error is that of the pattern as one of many of its kind.

    Reference: Hopkins and Skellam 1954, Annals of Botany 18; `hopskel` in spatstat (Baddeley, Rubak and Turner 2015,
    ch. 8).
    """
    a2, b2 = distances.from_window_m**2, distances.from_points_m**2
    ratio = _ratio((b2, distances.point_block), (a2, distances.window_block))
    lift = _mean_reciprocal(a2 / a2.mean(), len(b2))
    return Estimate(lift * ratio.value, lift * ratio.error)


def _mean_reciprocal(values: Floats, n: int) -> float:
    """Expectation of 1 / mean of n values, each drawn at random from `values`, positive and of mean 1.

    E[1 / S] is the integral of E[exp(-t S)] over t > 0, and the sum S of independent draws makes it a power.
    """
    from scipy.integrate import quad  # late, as above

    def integrand(u: float) -> float:
        return float(np.mean(np.exp(-u / n * values)) ** n)

    return float(quad(integrand, 0.0, math.inf, epsabs=1e-9, epsrel=1e-7, limit=200)[0])


def clark_evans(nearest_m: Floats, window: Window) -> Estimate:
    """Clark and Evans' index R without edge correction: 1 is random, below 1 clustered, above 1 regular.

    The mean of (N,) distances to the nearest other point over its expectation 1 / (2 sqrt(density)) in a random
    pattern. Edges lengthen distances, so a random pattern of few points has an R above 1. The error is that of a random
    pattern.

    Reference: Clark and Evans 1954, Ecology 35.
    """
    n = len(nearest_m)
    expected_m = 0.5 * math.sqrt(window.area_m2 / n)
    return Estimate(float(np.mean(nearest_m)) / expected_m, math.sqrt((4 / math.pi - 1) / n))


def clark_evans_donnelly(nearest_m: Floats, window: Window) -> Estimate:
    """`clark_evans` with Donnelly's correction for the edges of a rectangle; the error is that of a random pattern.

    Reference: Donnelly 1978, in Simulation Methods in Archaeology (ed. Hodder), p. 91.
    """
    n, area, perimeter = len(nearest_m), window.area_m2, 2 * sum(window.size_m)
    expected_m = 0.5 * math.sqrt(area / n) + (0.0514 + 0.0412 / math.sqrt(n)) * perimeter / n
    variance_m2 = 0.0703 * area / n**2 + 0.037 * perimeter * math.sqrt(area / n**5)
    return Estimate(float(np.mean(nearest_m)) / expected_m, math.sqrt(variance_m2) / expected_m)


def greatest_radius(window: Window, correction: Correction = "translation") -> float:
    """Radius up to which an edge correction has no bias, metres.

    Farther apart, translation leaves no overlap in some direction, and no circle about some points meets the window.
    """
    shorter_m = min(window.size_m)
    return shorter_m / 2 if correction == "periodic" else min(shorter_m, math.hypot(*window.size_m) / 2)


def count_pairs(points_m: Floats, reach_m: float) -> int:
    """How many ordered pairs lie within a distance."""
    from scipy.spatial import cKDTree

    tree = cKDTree(points_m)
    return int(np.asarray(tree.count_neighbors(tree, reach_m))) - len(points_m)


def ripley_k(points_m: Floats, window: Window, radii_m: Floats, correction: Correction) -> Floats:
    """(R,) Ripley's K, square metres, of (N, 2) points in the window, two at least.

    The (R,) radii are metres, in any order, from 0 to `greatest_radius`.
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


def besag_l(k_m2: Floats) -> Floats:
    """Besag's L = sqrt(K / π), metres, which is r for a random pattern."""
    return np.asarray(np.sqrt(k_m2 / np.pi))


def ripley_bound(n: int, window: Window) -> float:
    """The greatest |L(r) - r|, metres, of nineteen random patterns in twenty, over all radii that are not large.

    Reference: Ripley 1979, J. R. Stat. Soc. B 41: 1.45 sqrt(|W|) / n.
    """
    return 1.45 * math.sqrt(window.area_m2) / n


def pair_correlation(
    points_m: Floats, window: Window, radii_m: Floats, correction: Correction, *, bandwidth_m: float | None = None
) -> Floats:
    """Pair correlation g(r) = K'(r) / (2 π r): how much likelier than at random another point is at a distance r.

    g(r) = |W| / (2 π n (n - 1)) * sum over ordered pairs of e k(r - d) / d, with Epanechnikov's kernel k. Below the
    bandwidth a part of the kernel reaches past d = 0, and g is too low.

    Points and (R,) radii are those of `ripley_k`. `bandwidth_m` is half the width of the kernel, by default Stoyan's
    0.15 / sqrt(density).
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
        differ = distance > 0
        d, w = distance[differ], weight[differ]
        interval = np.searchsorted(edges, d, side="left")
        for power in range(3):
            moments[power] += np.bincount(interval, weights=w * d ** (power - 1), minlength=moments.shape[1])
    below = np.concatenate([np.zeros((3, 1)), np.cumsum(moments, axis=1)], axis=1)
    first, last = np.searchsorted(edges, radii - h, side="right"), np.searchsorted(edges, radii + h, side="left")
    m0, m1, m2 = below[:, last + 1] - below[:, first]
    kernel_sum = 0.75 / h * (m0 - (radii**2 * m0 - 2 * radii * m1 + m2) / h**2)
    return np.asarray(np.maximum(kernel_sum, 0.0)) * (window.area_m2 / (2 * math.pi * n * (n - 1)))


def _checked(points_m: Floats, window: Window, radii_m: Floats, correction: Correction) -> Floats:
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
    points_m: Floats, window: Window, reach_m: float, correction: Correction
) -> Iterator[tuple[Floats, Floats]]:
    """Distances and weights e of all ordered pairs within a distance, a portion at a time."""
    from scipy.spatial import cKDTree

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


def _weights(here: Floats, there: Floats, distance: Floats, window: Window, correction: Correction) -> Floats:
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


def _angle_outside(sides: Floats, radius: Floats) -> Floats:
    """(P,) angle of circles outside a rectangle; `sides` (4, P): the centre's distances to its sides, in turn."""
    half = np.arccos(np.minimum(sides / radius, 1.0))  # half of the arc beyond a side's line
    angle = np.zeros(len(radius))
    for one, other in ((0, 1), (1, 2), (2, 3), (3, 0)):
        # Towards a corner inside the circle, the arcs beyond its two sides overlap: each ends at the corner.
        corner = np.arctan2(sides[other], sides[one])
        angle += np.minimum(half[one], corner) + np.minimum(half[other], np.pi / 2 - corner)
    return angle
