"""Kernels as a fit varies them, their likelihood, and the likeliest ones, where a fit begins.

A kernel is log κ at knots, with a hard core where the stand has no pair at all. Plant k is drawn from the field that
the plants before it have deformed,

    p(x_k | x_1 ... x_k-1) = f_k(x_k) / sum of f_k over the window,     f_k(x) = product over j < k of κ(|x - x_j|)

so the likelihood of a stand in a given order is a product of known numbers, and log κ at the knots enters it linearly
but for the sums, which makes the logarithm concave: there is one best kernel. The sums are kept over a grid and mended
where a plant changes them, so that a stand costs N times the cells within reach of a plant.

Reference: Lane 2002, section 5.1, for the model. The likelihood is ours.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.spatial import cKDTree

from forestgen.community.fitting.stand import MeasuredStand
from forestgen.community.placement.densities import grid_shape
from forestgen.community.placement.kernels import KernelSection, KernelTable, table
from forestgen.community.population import Floats, Site
from forestgen.core.compiled import compiled

_MEND_EVERY = 64  # plants: sums that are mended gather rounding errors, so they are taken afresh now and then
ROUGHNESS = 0.7  # standard deviation that log κ's second differences between knots are expected to have
STEEPNESS = 1.5  # and its first differences
_ORDERS = 24
_PLANTS_IN_ALL = 3000  # of all orders
_CELLS_IN_REACH = 12
KNOTS = 14
_CROWDED = 1.4  # knots lie at distances of this power of their number: closer together near the plant
_REACH_SPACINGS = 6.0  # a kernel's reach in mean spacings, at most
_PAIRS_FOR_A_CORE = 5.0  # so many pairs expected at random where there is none: chance would do that once in 150 stands
_CORE_OF_STEP = 0.75  # of the step to which places are rounded
_EDGE = 0.02  # κ rises from 0 over this share of the core's radius


@dataclass(frozen=True)
class KernelShapes:
    """The kernels of a stand; S species, P kernels, M knots with a free κ."""

    kernel_of: NDArray[np.int64]  # (S, S) kernel by which species j (second) deforms the field of species i (first)
    pairs: tuple[tuple[int, int], ...]  # (P,) of each kernel the species that is affected, and the one that deforms
    knots_m: Floats  # (P, M + 1) metres, ascending; the last is the reach, where κ is 1
    core_m: Floats  # (P,) metres; κ is 0 up to here

    @property
    def free(self) -> tuple[int, int]:
        """P, M."""
        return len(self.pairs), self.knots_m.shape[1] - 1

    @property
    def reach_m(self) -> float:
        return float(self.knots_m[:, -1].max())

    def control_points(self, log_kappa: Floats) -> list[list[tuple[float, float]]]:
        """Of each kernel: distances in metres and κ, rounded as a recipe shows them."""
        found = []
        for knots, core, values in zip(self.knots_m, self.core_m, log_kappa, strict=True):
            at = np.concatenate([knots[:-1], (knots[1:] + knots[:-1]) / 2])  # straight lines, close to the exponentials
            at = np.append(np.sort(at), knots[-1])
            kappa = np.exp(np.interp(at, knots, np.append(values, 0.0)))
            points = [(_digits(float(r)), _digits(float(k))) for r, k in zip(at, kappa, strict=True)]
            if core > 0:
                points = [(0.0, 0.0), (_digits(core * (1 - _EDGE)), 0.0), *points]
            found.append(points)
        return found

    def tables(self, log_kappa: Floats) -> list[list[KernelTable]]:
        """As `place` takes them: of species i (first) the kernels of species j (second)."""
        sections = [{"curve": points, "distance": "metres"} for points in self.control_points(log_kappa)]
        made = [table(KernelSection.model_validate(one)) for one in sections]
        return [[made[kernel] for kernel in row] for row in self.kernel_of]


def _digits(value: float) -> float:
    return float(f"{value:.4g}")


def kernel_shapes(stand: MeasuredStand, reach_m: float | None) -> KernelShapes:
    """Knots and hard cores for a stand.

    Kernels are symmetric between species (κ of i by j is κ of j by i) where the order of placement is unknown; where
    sizes give it, each has its own, since only the smaller of two plants was placed in the other's field.
    """
    kinds = len(stand.names)
    pairs = [(i, j) for i in range(kinds) for j in range(kinds) if stand.ordered or i <= j]
    kernel_of = np.zeros((kinds, kinds), dtype=np.int64)
    for index, (i, j) in enumerate(pairs):
        kernel_of[i, j] = index
        if not stand.ordered:
            kernel_of[j, i] = index
    reach = reach_m if reach_m is not None else default_reach_m(stand)
    core = np.array([_core_m(stand, i, j) for i, j in pairs])
    core = np.where(core < 0.8 * reach, core, 0.0)
    steps = (np.arange(KNOTS + 1) / KNOTS) ** _CROWDED
    knots = core[:, None] + (reach - core)[:, None] * steps
    return KernelShapes(kernel_of, tuple(pairs), knots, core)


def founder_shapes(shapes: KernelShapes) -> KernelShapes:
    """Of a stand of one kind, of which some come first: kernels among founders, between the two, among followers.

    What followers do to founders' field has no effect: founders have been placed by then.
    """
    kernel_of = np.array([[0, 1], [1, 2]])
    return KernelShapes(kernel_of, ((0, 0), (1, 0), (1, 1)), np.tile(shapes.knots_m, (3, 1)), np.tile(shapes.core_m, 3))


def default_reach_m(stand: MeasuredStand) -> float:
    """A quarter of the window's shorter side, or six mean spacings where that is less."""
    return min(min(stand.size_m) / 4, _REACH_SPACINGS * stand.spacing_m)


def _core_m(stand: MeasuredStand, one: int, other: int) -> float:
    """Radius without any pair, 0 where chance may have made it.

    The least of N distances overestimates a hard core by about its Nth part.
    """
    a, b = stand.of(one), stand.of(other)
    if stand.ordered and one != other:
        return 0.0
    if stand.step_m:
        return _CORE_OF_STEP * stand.step_m  # closer plants would mostly be written down at one place
    distance = np.asarray(cKDTree(a).query(b, k=[2] if one == other else [1])[0])
    least, numbers = float(distance.min()), len(a) * len(b) / (2 if one == other else 1)
    expected = numbers * math.pi * least**2 / stand.area_m2
    smaller = min(len(a), len(b))
    return least * smaller / (smaller + 1) if expected > _PAIRS_FOR_A_CORE else 0.0


class Score(NamedTuple):
    """Log-likelihood of a stand in its order, and its derivatives by log κ at the knots."""

    log_likelihood: float  # of the places against uniform ones
    gradient: Floats  # (P, M)


def score(
    position_m: Floats,
    species: NDArray[np.int64],
    shapes: KernelShapes,
    core_m: Floats,
    log_kappa: Floats,
    size_m: tuple[float, float],
    shape: tuple[int, int],
) -> Score:
    """Of plants, (N, 2) in [0, W] x [0, H] and (N,) of S species, in the order in which they were placed.

    log κ of the shapes' kernels (P, M) is linear between knots, constant below the first and 0 from the last on. Below
    `core_m` (P,), at most the first knot, κ is 0. The field is summed over a grid of `shape`, rows and columns.
    """
    ended = np.concatenate([log_kappa, np.zeros((len(log_kappa), 1))], axis=1)
    value, gradient = _score(
        np.ascontiguousarray(position_m), species, shapes.kernel_of, shapes.knots_m, core_m, ended, *size_m, *shape
    )
    return Score(float(value), gradient)


@compiled
def _lower_knot(distance, knots, kernel):  # type: ignore[no-untyped-def]
    """The last knot that is no farther than a distance within reach; the first if none is."""
    low, high = 0, knots.shape[1] - 1
    while high - low > 1:
        middle = (low + high) // 2
        if knots[kernel, middle] <= distance:
            low = middle
        else:
            high = middle
    return low


@compiled
def _deform(x, y, mine, field, kernel, knots, core, log_kappa, weight, feature, sums, dx, dy):  # type: ignore[no-untyped-def]
    """Multiply a field by the kernel of a plant, and mend its sums: [0] of f, [1 + k] of f times feature k."""
    rows, cols, features = weight.shape[1], weight.shape[2], feature.shape[3]
    parts = knots.shape[1] - 1
    reach = knots[kernel, parts]
    first_row, last_row = max(0, int((y - reach) / dy)), min(rows, int((y + reach) / dy) + 1)
    first_col, last_col = max(0, int((x - reach) / dx)), min(cols, int((x + reach) / dx) + 1)
    for row in range(first_row, last_row):
        for col in range(first_col, last_col):
            distance = math.sqrt(((col + 0.5) * dx - x) ** 2 + ((row + 0.5) * dy - y) ** 2)
            before = weight[field, row, col]
            if distance >= reach or before == 0.0:
                continue
            low, on, after = 0, 0.0, 0.0
            if distance >= core[kernel]:
                low = _lower_knot(distance, knots, kernel)
                start, end = knots[kernel, low], knots[kernel, low + 1]
                on = max(0.0, (distance - start) / (end - start))
                after = before * math.exp((1 - on) * log_kappa[kernel, low] + on * log_kappa[kernel, low + 1])
            weight[field, row, col] = after
            change = after - before
            sums[field, 0] += change
            for k in range(features):
                sums[field, 1 + k] += change * feature[field, row, col, k]
            at = mine * parts + low
            feature[field, row, col, at] += 1 - on
            sums[field, 1 + at] += after * (1 - on)
            if low + 1 < parts:
                feature[field, row, col, at + 1] += on
                sums[field, 2 + at] += after * on


@compiled
def _sum_afresh(field, weight, feature, sums):  # type: ignore[no-untyped-def]
    sums[field] = 0.0
    for row in range(weight.shape[1]):
        for col in range(weight.shape[2]):
            sums[field, 0] += weight[field, row, col]
            for k in range(feature.shape[3]):
                sums[field, 1 + k] += weight[field, row, col] * feature[field, row, col, k]


@compiled
def _score(position, species, kernel_of, knots, core, log_kappa, width, height, rows, cols):  # type: ignore[no-untyped-def]
    n, kinds, parts = len(position), len(kernel_of), log_kappa.shape[1] - 1
    weight = np.ones((kinds, rows, cols))
    feature = np.zeros((kinds, rows, cols, kinds * parts))  # of a cell: by the species that deformed it, by knot
    sums = np.zeros((kinds, 1 + kinds * parts))
    sums[:, 0] = rows * cols
    value, gradient = 0.0, np.zeros((len(knots), parts))
    for k in range(n):
        x, y, mine = position[k, 0], position[k, 1], species[k]
        for j in range(k):
            kernel = kernel_of[mine, species[j]]
            distance = math.sqrt((position[j, 0] - x) ** 2 + (position[j, 1] - y) ** 2)
            if distance < knots[kernel, parts]:
                low = _lower_knot(distance, knots, kernel)
                on = max(0.0, (distance - knots[kernel, low]) / (knots[kernel, low + 1] - knots[kernel, low]))
                value += (1 - on) * log_kappa[kernel, low] + on * log_kappa[kernel, low + 1]
                gradient[kernel, low] += 1 - on
                if low + 1 < parts:
                    gradient[kernel, low + 1] += on
        total = max(sums[mine, 0], 1e-300)  # nothing left: rounding must not make it negative
        value -= math.log(total / (rows * cols))
        for other in range(kinds):
            for part in range(parts):
                gradient[kernel_of[mine, other], part] -= sums[mine, 1 + other * parts + part] / total
        for field in range(kinds):
            kernel = kernel_of[field, mine]
            _deform(
                x, y, mine, field, kernel, knots, core, log_kappa, weight, feature, sums, width / cols, height / rows
            )
            if k % _MEND_EVERY == _MEND_EVERY - 1:
                _sum_afresh(field, weight, feature, sums)
    return value, gradient


def likelihood_shape(stand: MeasuredStand, shapes: KernelShapes) -> tuple[int, int]:
    """Rows and columns of the grid on which likelihoods are summed, twelve cells in a kernel's reach."""
    cells = int(np.clip(round(max(stand.size_m) / shapes.reach_m * _CELLS_IN_REACH), 32, 160))
    return grid_shape(Site(stand.size_m), cells)


def roughness_penalty(shapes: KernelShapes) -> Floats:
    """(P M, P M) matrix A of the penalty θ' A θ / 2 of all log κ: the squares of their differences, first and second.

    The knot at the reach counts as 0, so that kernels fade into 1.
    """
    kernels, knots = shapes.free
    first, second = (np.diff(np.eye(knots + 1), order, axis=0)[:, :knots] for order in (1, 2))
    one = first.T @ first / STEEPNESS**2 + second.T @ second / ROUGHNESS**2
    return np.asarray(np.kron(np.eye(kernels), one), dtype=np.float64)


def likeliest(stand: MeasuredStand, shapes: KernelShapes, rng: np.random.Generator) -> Floats:
    """(P, M) log κ of the greatest mean log-likelihood over random orders, less the penalty.

    Where sizes give the order there is but one; rounded places are blurred anew for each.
    """
    number = int(np.clip(_PLANTS_IN_ALL // stand.n, 4, _ORDERS))
    if stand.ordered:
        number = 1 if stand.step_m == 0 else min(number, 8)
    draws = []
    for one in rng.spawn(number):
        order = np.arange(stand.n) if stand.ordered else one.permutation(stand.n)
        draws.append((stand.blurred(one)[order], stand.species[order]))
    penalty, grid = roughness_penalty(shapes), likelihood_shape(stand, shapes)
    core_m = np.zeros_like(shapes.core_m) if stand.step_m else shapes.core_m

    def loss(flat: Floats) -> tuple[float, Floats]:
        value, gradient = 0.5 * float(flat @ penalty @ flat), penalty @ flat
        for position_m, species in draws:
            found = score(position_m, species, shapes, core_m, flat.reshape(shapes.free), stand.size_m, grid)
            value -= found.log_likelihood / number
            gradient = gradient - found.gradient.ravel() / number
        return value, gradient

    start = np.zeros(shapes.free[0] * shapes.free[1])
    found = minimize(loss, start, jac=True, method="L-BFGS-B", bounds=[(-6.0, 4.0)] * len(start),
                     options={"maxiter": 40, "ftol": 1e-7})  # fmt: skip
    return np.asarray(found.x).reshape(shapes.free)
