"""How points lie in a rectangular window: clustered, at random, or apart. Indices from distances to nearest points.

All cost O(N log N) by a k-d tree. `ripley.py` holds the statistics of all pairs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

_FEWEST_FOR_ERROR = 10
_BLOCKS = 36  # of the jackknife; more would be smaller than clusters, fewer would make the error itself uncertain
SAMPLES = 10_000  # points of the window


class Estimate(NamedTuple):
    """A number with its standard error; nan where that is not defined, as for fewer than ten points."""

    value: float
    error: float


_FARTHEST_M, _LEAST_M, _MOST_M = 1e12, 1e-6, 1e9  # of a window's corners from the origin; of its sides


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
    def perimeter_m(self) -> float:
        return 2 * sum(self.size_m)

    @property
    def corner_m(self) -> NDArray[np.float64]:
        """(2,) the corner of least x and y."""
        return np.array([self.x0, self.y0])

    def outside(self, points_m: NDArray[np.float64]) -> NDArray[np.bool_]:
        """(N,) whether a point lies outside; the edge belongs to the window."""
        beyond = (points_m < (self.x0, self.y0)) | (points_m > (self.x1, self.y1))
        return np.asarray(np.any(beyond, axis=1))


def density(points_m: NDArray[np.float64], window: Window) -> float:
    """Points per square metre."""
    return len(points_m) / window.area_m2


def pattern_tree(points_m: NDArray[np.float64], window: Window, periodic: bool) -> tuple[cKDTree, NDArray[np.float64]]:
    """Tree of the points moved to the origin, and the moved points."""
    from scipy.spatial import cKDTree  # late: half a second

    moved = points_m - window.corner_m
    if not periodic:
        return cKDTree(moved), moved
    moved = np.mod(moved, window.size_m)
    moved[moved >= window.size_m] = 0.0  # the remainder of -1e-20 is the modulus itself
    return cKDTree(moved, boxsize=np.array(window.size_m)), moved


def nearest_distances(
    points_m: NDArray[np.float64], window: Window, *, periodic: bool = False
) -> NDArray[np.float64]:  # fmt: skip
    """(N,) distance of each point to the nearest other one, metres; N must be 2 at least."""
    tree, moved = pattern_tree(points_m, window, periodic)
    return np.asarray(tree.query(moved, k=2)[0])[:, 1]


def _grid(window: Window, cells: int) -> tuple[int, int]:
    """Columns and rows of at least `cells` nearly square cells."""
    width, height = window.size_m
    nx = min(cells, max(1, math.ceil(math.sqrt(cells * width / height))))
    return nx, max(1, math.ceil(cells / nx))


def _block(moved: NDArray[np.float64], window: Window, grid: tuple[int, int]) -> NDArray[np.intp]:
    """(N,) index of the cell of a grid in which a point lies."""
    cell = np.minimum((moved / window.size_m * grid).astype(np.intp), np.array(grid) - 1)
    return np.asarray(cell[:, 0] * grid[1] + cell[:, 1])


@dataclass(frozen=True)
class Distances:
    """Distances to the nearest point of a pattern, and the blocks of the window to which they belong."""

    from_window_m: NDArray[np.float64]  # (M,) a: from points spread over the window
    from_points_m: NDArray[np.float64]  # (N,) b: from the pattern's own points, to another one
    window_block: NDArray[np.intp]  # (M,)
    point_block: NDArray[np.intp]  # (N,)


def measure_distances(
    points_m: NDArray[np.float64],
    window: Window,
    rng: np.random.Generator,
    *,
    samples: int = SAMPLES,
    periodic: bool = False,
) -> Distances:
    """Distances behind both Hopkins indices; N must be 2 at least.

    Parameters
    ----------
    points_m : (N, 2) float64, metres, in the window.
    rng : places points in the window, one in each cell of a grid: many times less scatter than free ones.
    samples : least number of them.
    periodic : opposite edges of the window meet.
    """
    tree, moved = pattern_tree(points_m, window, periodic)
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


def _ratio(
    above: tuple[NDArray[np.float64], NDArray[np.intp]], below: tuple[NDArray[np.float64], NDArray[np.intp]]
) -> Estimate:
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

    References
    ----------
    Lane 2002, section 2.4 and Figure 2.3.
    """
    return _ratio(
        (distances.from_window_m, distances.window_block), (distances.from_points_m, distances.point_block)
    )  # fmt: skip


def hopkins_skellam(distances: Distances) -> Estimate:
    """Hopkins-Skellam index A: 1 is random, below 1 clustered, above 1 regular.

    A = <b^2> / <a^2>, with a and b as in `hopkins`: the other way up, and of squares. By its definition <a^2> is the
    mean of as many random points as the pattern has, and A scatters with them. This is the mean of A over all such
    choices of points, which scatters no more. The error is that of the pattern as one of many of its kind.

    References
    ----------
    Hopkins and Skellam 1954, Annals of Botany 18; `hopskel` in spatstat (Baddeley, Rubak and Turner 2015, ch. 8).
    """
    a2, b2 = distances.from_window_m**2, distances.from_points_m**2
    ratio = _ratio((b2, distances.point_block), (a2, distances.window_block))
    lift = _mean_reciprocal(a2 / a2.mean(), len(b2))
    return Estimate(lift * ratio.value, lift * ratio.error)


def _mean_reciprocal(values: NDArray[np.float64], n: int) -> float:
    """Expectation of 1 / mean of n values, each drawn at random from `values`, positive and of mean 1.

    E[1 / S] is the integral of E[exp(-t S)] over t > 0, and the sum S of independent draws makes it a power.
    """
    from scipy.integrate import quad  # late, as above

    def integrand(u: float) -> float:
        return float(np.mean(np.exp(-u / n * values)) ** n)

    return float(quad(integrand, 0.0, math.inf, epsabs=1e-9, epsrel=1e-7, limit=200)[0])


def clark_evans(nearest_m: NDArray[np.float64], window: Window) -> Estimate:
    """Clark and Evans' index R without edge correction: 1 is random, below 1 clustered, above 1 regular.

    The mean distance to the nearest other point over its expectation 1 / (2 sqrt(density)) in a random pattern. Edges
    lengthen distances, so a random pattern of few points has an R above 1. The error is that of a random pattern.

    Parameters
    ----------
    nearest_m : (N,) of `nearest_distances`.

    References
    ----------
    Clark and Evans 1954, Ecology 35.
    """
    n = len(nearest_m)
    expected_m = 0.5 * math.sqrt(window.area_m2 / n)
    return Estimate(float(np.mean(nearest_m)) / expected_m, math.sqrt((4 / math.pi - 1) / n))


def clark_evans_donnelly(nearest_m: NDArray[np.float64], window: Window) -> Estimate:
    """`clark_evans` with Donnelly's correction for the edges of a rectangle; the error is that of a random pattern.

    References
    ----------
    Donnelly 1978, in Simulation Methods in Archaeology (ed. Hodder), p. 91.
    """
    n, area, perimeter = len(nearest_m), window.area_m2, window.perimeter_m
    expected_m = 0.5 * math.sqrt(area / n) + (0.0514 + 0.0412 / math.sqrt(n)) * perimeter / n
    variance_m2 = 0.0703 * area / n**2 + 0.037 * perimeter * math.sqrt(area / n**5)
    return Estimate(float(np.mean(nearest_m)) / expected_m, math.sqrt(variance_m2) / expected_m)
