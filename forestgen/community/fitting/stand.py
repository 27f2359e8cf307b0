"""A measured stand as a fit takes it, new stands of the model deformation_kernel, and what is compared of both.

A fit counts pairs by distance and distances to nearest plants. Stand and new stands share their window, so counts need
no correction for its edges.

The test of a fit: whether functions of the measured stand lie within those of new stands, radius by radius. They are
K(r) by the translation correction, of pairs of species too; the pair correlation g(r) of a species; G(r) of the
distances to the nearest plant, uncorrected, for stand and new stands share their window. Envelopes are the least and
the greatest of 39 new stands.

A perfect model is left now and then: at one radius by one stand in twenty, somewhere along a curve by more.

Reference: Ripley 1977, J. R. Stat. Soc. B 39. Baddeley, Rubak and Turner 2015, Spatial Point Patterns, sections 7.8 and
10.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from forestgen.community.placement.densities import grid_shape
from forestgen.community.placement.field import DensityField, place
from forestgen.community.placement.kernels import KernelTable
from forestgen.community.point_patterns import Window, pair_correlation
from forestgen.community.point_statistics import PointTable
from forestgen.community.population import Floats, Site
from forestgen.core.errors import AssetError, ResourceError
from forestgen.core.randomness import child_rng

_CELLS_PER_SPACING = 12
_FEWEST_CELLS, _MOST_CELLS = 64, 320
_FINE_STANDS = 200  # plants: of larger stands, half as many cells
FEWEST = 20  # plants of a stand
FEWEST_OF_A_SPECIES = 10
MOST = 1500  # plants of a stand: beyond, a part of the window tells as much
MOST_SPECIES = 3
LARGEST_M = 5000
_ROUNDED = 0.9  # of the points lie on a lattice: the others were corrected later
_FINEST_STEP = 0.03  # of the spacing
STANDS = 39
RADII = 50
_PER_QUADRAT = 6  # plants
_FURTHEST = 0.25  # of the window's shorter side
_SMOOTHING = 0.15  # of the mean spacing: Stoyan's bandwidth
_TOLERANCE = 1e-9  # of the data's greatest value: sums of the same pairs in another order
_PAIR_RADII, _NEAR_RADII = 50, 32
_PAIRS_WORTH, _RINGS_WORTH, _NEAR_WORTH = 0.5, 1.0, 0.5  # of a number, against the smoothness of kernels
_PER_RING = 5  # radii; rings show g, which sums over circles hide
_NEAR_BEYOND = 1.2  # of the farthest nearest neighbour


@dataclass(frozen=True)
class MeasuredStand:
    """N plants of S species in a window [0, W] x [0, H]."""

    position_m: Floats  # (N, 2) metres, from the window's corner; ordered: largest plants first
    species: NDArray[np.int64]  # (N,) index into names
    names: tuple[str, ...]  # (S,)
    size_m: tuple[float, float]  # W, H
    radius_m: Floats | None  # (N,) metres, not ascending; None: unknown, and with it the order
    corner_m: tuple[float, float] = (0.0, 0.0)  # of the window, in the file's coordinates
    step_m: float = 0.0  # what the file's coordinates are multiples of; 0: too little to matter

    @property
    def n(self) -> int:
        return len(self.position_m)

    @property
    def ordered(self) -> bool:
        """Whether the order of placement is known: sizes differ."""
        return self.radius_m is not None and bool(np.ptp(self.radius_m) > 0)

    @property
    def area_m2(self) -> float:
        return self.size_m[0] * self.size_m[1]

    @property
    def spacing_m(self) -> float:
        """Side of the square that a plant has on average."""
        return math.sqrt(self.area_m2 / self.n)

    def as_measured(self, position_m: Floats) -> Floats:
        """Places as they would stand in the file: rounded to its step, in the window."""
        if self.step_m == 0:
            return position_m
        there = np.round((position_m + self.corner_m) / self.step_m) * self.step_m - self.corner_m
        return np.asarray(np.clip(there, 0.0, self.size_m))

    def blurred(self, rng: np.random.Generator) -> Floats:
        """(N, 2) places where the plants may have stood before they were rounded."""
        if self.step_m == 0:
            return self.position_m
        moved = self.position_m + self.step_m * (rng.random((self.n, 2)) - 0.5)
        return np.asarray(np.clip(moved, 0.0, self.size_m))

    def of(self, species: int) -> Floats:
        """Places of a species' plants."""
        return np.asarray(self.position_m[self.species == species])


def measured_stand(table: PointTable, where: str) -> tuple[MeasuredStand, list[str]]:
    """The stand of a table, and notes on it; an `AssetError` or `ResourceError` if it cannot be fitted."""
    _check_points(table, where)
    n = len(table.points_m)
    labels = np.array(table.species) if table.species is not None else np.full(n, "")
    names, species, numbers = np.unique(labels, return_inverse=True, return_counts=True)
    if len(names) > MOST_SPECIES:
        problem, got = "too many species for a fit", f"{len(names)}: " + ", ".join(str(one)[:40] for one in names[:8])
        hint = "give rare species one name together, such as other"
        raise AssetError(problem, where=where, expected=f"at most {MOST_SPECIES}", got=got, hint=hint)
    if numbers.min() < FEWEST_OF_A_SPECIES:
        rare = int(numbers.argmin())
        problem, expected = "too few plants of a species for a fit", f"{FEWEST_OF_A_SPECIES} at least"
        hint = "leave the species out, or give rare species one name together, such as other"
        raise AssetError(problem, where=where, expected=expected, got=f"{numbers[rare]} of {names[rare]}", hint=hint)
    spacing_m = math.sqrt(table.window.area_m2 / n)
    step_m = rounding_m(table.points_m, spacing_m)
    order = np.arange(n) if table.radius_m is None else np.argsort(-table.radius_m, kind="stable")
    stand = MeasuredStand(
        position_m=np.ascontiguousarray((table.points_m - table.window.corner_m)[order]),
        species=species[order].astype(np.int64),
        names=tuple(str(one) for one in names),
        size_m=table.window.size_m,
        radius_m=None if table.radius_m is None else table.radius_m[order],
        corner_m=(table.window.x0, table.window.y0),
        step_m=step_m,
    )
    return stand, _notes(stand)


def _check_points(table: PointTable, where: str) -> None:
    n = len(table.points_m)
    if n < FEWEST:
        raise AssetError("too few plants for a fit", where=where, expected=f"{FEWEST} at least", got=str(n))
    if n > MOST:
        share = math.sqrt(0.9 * MOST / n)
        expected = f"at most {MOST:,}: time grows with their number, and a part of the window tells as much"
        part = f"such as {share:.2f} of its width and of its height"
        hint = f"keep the plants of a part of the window, {part}, and state that part as the window"
        raise ResourceError("too many plants for a fit", where=where, expected=expected, got=f"{n:,}", hint=hint)
    if max(table.window.size_m) > LARGEST_M:
        expected = f"sides up to {LARGEST_M:,} m, those of a recipe's site; coordinates in metres"
        raise AssetError("the window is too large", where=where, expected=expected, got=str(table.window))
    spread = np.linalg.svd(table.points_m - table.points_m.mean(axis=0), compute_uv=False)
    if spread[1] < 1e-3 * spread[0]:
        raise AssetError("the plants stand on one line", where=where, expected="plants spread over an area")


def rounding_m(points_m: Floats, spacing_m: float) -> float:
    """The step of which nearly all coordinates are multiples, metres; 0 where it is too small against the spacing.

    Rounded places have few different distances, and hardly any below the step: that says nothing about the plants.
    """
    for power in range(math.ceil(math.log10(spacing_m)), math.floor(math.log10(spacing_m)) - 4, -1):
        for digit in (5, 2, 1):
            step_m = digit * 10.0**power
            if not _FINEST_STEP * spacing_m <= step_m < spacing_m:
                continue
            off = np.abs(points_m / step_m - np.round(points_m / step_m)).max(axis=1)
            if np.mean(off < 1e-6) >= _ROUNDED:
                return step_m
    return 0.0


def _notes(stand: MeasuredStand) -> list[str]:
    notes = []
    if stand.step_m:
        notes.append(
            f"the coordinates are rounded to {stand.step_m:g} m: new stands are rounded alike before they are compared"
        )
    if stand.radius_m is not None and not stand.ordered:
        notes.append("all radii are equal: they give no order")
    return notes


class NewStand(NamedTuple):
    """Plants in the order in which they were placed."""

    placed_m: Floats  # (N, 2) metres
    measured_m: Floats  # (N, 2) metres: rounded as the stand's were
    species: NDArray[np.int64]  # (N,)
    kind: NDArray[np.int64]  # (N,) by which kernels act: the species; or 0 founder, 1 follower


@dataclass(frozen=True)
class Nursery:
    """Where new stands are placed."""

    stand: MeasuredStand
    cells: int  # along the longer side
    founders: int = 0  # plants of the one species that come first and have kernels of their own; 0: all are alike

    def grow(self, kernels: list[list[KernelTable]], seed: int, number: int) -> NewStand:
        """The stand of one number, among those of a seed.

        Plants come in the stand's own order of species where sizes give one, else at random; founders first.
        """
        stand = self.stand
        rng = child_rng(seed, "fit", number)
        uniform = rng.random((stand.n, 2))
        species = stand.species if stand.ordered else rng.permutation(stand.species)
        kind = species if self.founders == 0 else (np.arange(stand.n) >= self.founders).astype(np.int64)
        even = np.ones(grid_shape(Site(stand.size_m), self.cells))
        fields = [DensityField(even, stand.size_m, periodic=False) for _ in kernels]
        placement = place(fields, kind, np.ones(stand.n), kernels, uniform)
        placed = placement.placed
        found = placement.position_m[placed]
        return NewStand(found, stand.as_measured(found), species[placed], kind[placed])


def fitting_cells(stand: MeasuredStand) -> int:
    """Cells along the longer side, sixteen in a mean spacing."""
    per_spacing = _CELLS_PER_SPACING if stand.n <= _FINE_STANDS else _CELLS_PER_SPACING // 2
    wanted = math.ceil(max(stand.size_m) / stand.spacing_m * per_spacing)
    return min(max(wanted, _FEWEST_CELLS), _MOST_CELLS)


@dataclass(frozen=True)
class Summaries:
    """What is counted; Q pairs of species, of which the first may be the second."""

    pairs: tuple[tuple[int, int], ...]  # (Q,)
    pair_radii_m: Floats  # (R,) metres
    near: tuple[tuple[int, int], ...]  # of a plant of the first species, the nearest of the second
    near_radii_m: Floats  # (len(near), G) metres
    worth: Floats  # weight of each number against the others and the expectation that kernels are smooth
    least: Floats  # of each number what counts as a step of difference at least: half a pair or plant

    def of(self, position_m: Floats, species: NDArray[np.int64]) -> Floats:
        """(Q * (R + R / 5) + len(near) * G,) roots of the numbers of pairs within each radius and in each ring of five
        radii; shares of plants that have a nearest one within each radius."""
        trees = [cKDTree(position_m[species == one]) for one in range(max(max(pair) for pair in self.near) + 1)]
        parts = []
        for one, other in self.pairs:
            counts = np.asarray(trees[one].count_neighbors(trees[other], self.pair_radii_m), dtype=np.float64)
            within = (counts - trees[one].n) / 2 if one == other else counts
            parts += [np.sqrt(within), np.sqrt(np.diff(within[_PER_RING - 1 :: _PER_RING], prepend=0.0))]
        for (one, other), radii in zip(self.near, self.near_radii_m, strict=True):
            parts.append(shares_within(nearest_m(trees[one], trees[other]), radii))
        return np.concatenate(parts)

    def nearest(self, values: Floats) -> Floats:
        """The part of (A,) numbers, or of their differences, that is about nearest neighbours."""
        return np.asarray(values[-self.near_radii_m.size :])


def nearest_m(points: cKDTree, others: cKDTree) -> Floats:
    """(N,) distance of each point to the nearest of the others, which may be the same points; inf where none is."""
    if points is others:
        return np.asarray(points.query(points.data, k=[2])[0])[:, 0]
    return np.asarray(others.query(points.data, k=[1])[0])[:, 0]


def shares_within(distance_m: Floats, radii_m: Floats) -> Floats:
    """(R,) share of distances that are no greater than each radius; G(r) of distances to nearest neighbours."""
    if not len(distance_m):
        return np.zeros(len(radii_m))
    return np.asarray(np.searchsorted(np.sort(distance_m), radii_m, side="right") / len(distance_m))


def summaries_for(stand: MeasuredStand, reach_m: float) -> Summaries:
    """Pairs up to a quarter of the window's shorter side, or the reach; nearest plants up to the farthest one."""
    kinds = range(len(stand.names))
    pairs = tuple((i, j) for i in kinds for j in kinds if i <= j)
    near = tuple((i, j) for i in kinds for j in kinds)
    most = max(reach_m, min(stand.size_m) / 4)
    trees = [cKDTree(stand.of(one)) for one in kinds]
    farthest = np.array([nearest_m(trees[i], trees[j]).max() for i, j in near])
    rings, shape = _PAIR_RADII // _PER_RING, (len(near), _NEAR_RADII)
    of_pairs = np.repeat([_PAIRS_WORTH, _RINGS_WORTH], [_PAIR_RADII, rings])
    of_plants = np.repeat([1.0 / len(stand.of(i)) for i, _ in near], _NEAR_RADII)
    return Summaries(
        pairs=pairs,
        pair_radii_m=most * np.arange(1, _PAIR_RADII + 1) / _PAIR_RADII,
        near=near,
        near_radii_m=_NEAR_BEYOND * farthest[:, None] * np.arange(1, _NEAR_RADII + 1) / _NEAR_RADII,
        worth=np.concatenate([np.tile(of_pairs, len(pairs)), np.full(math.prod(shape), _NEAR_WORTH)]),
        least=np.concatenate([np.full((_PAIR_RADII + rings) * len(pairs), 0.3), of_plants]),
    )


@dataclass(frozen=True)
class Envelope:
    """One function of the stand and of new stands."""

    name: str  # "K", "g" (pair correlation, of one species) or "G"
    species: tuple[int, int]  # from, to; twice the same: among one species
    radii_m: Floats  # (R,)
    stand: Floats  # (R,)
    low: Floats  # (R,) least of the new stands
    mean: Floats  # (R,)
    high: Floats  # (R,)
    own: Floats  # (R,) of one more new stand: how often a perfect fit would be left

    @property
    def left(self) -> NDArray[np.bool_]:
        """(R,) whether the stand lies outside."""
        return self._outside(self.stand)

    @property
    def own_left(self) -> NDArray[np.bool_]:
        """(R,) whether one more new stand does."""
        return self._outside(self.own)

    def _outside(self, values: Floats) -> NDArray[np.bool_]:
        slack = _TOLERANCE * max(float(values.max()), 1e-300)
        return np.asarray((values < self.low - slack) | (values > self.high + slack))


@dataclass(frozen=True)
class Functions:
    """K and G of a stand's species, at the same radii for every new stand."""

    species: tuple[tuple[str, int, int], ...]  # name, from, to
    radii_m: Floats  # (F, R)
    size_m: tuple[float, float]

    def of(self, position_m: Floats, species: NDArray[np.int64]) -> Floats:
        """(F, R) values."""
        trees = [cKDTree(position_m[species == k]) for k in range(1 + max(j for _, _, j in self.species))]
        rows = []
        for (name, one, other), radii in zip(self.species, self.radii_m, strict=True):
            if name == "g":
                rows.append(self._pair_correlation(np.asarray(trees[one].data), radii))
            elif name == "K":
                rows.append(cross_k(trees[one], trees[other], radii, self.size_m))
            else:
                rows.append(shares_within(nearest_m(trees[one], trees[other]), radii))
        return np.array(rows)

    def _pair_correlation(self, position_m: Floats, radii: Floats) -> Floats:
        if len(position_m) < 2:
            return np.zeros(len(radii))
        window = Window(0.0, self.size_m[0], 0.0, self.size_m[1])
        return pair_correlation(position_m, window, radii, "translation", bandwidth_m=2 * float(radii[0]))


def functions_for(stand: MeasuredStand) -> Functions:
    """K up to a quarter of the window's shorter side, G to a fifth beyond the farthest nearest neighbour."""
    kinds = range(len(stand.names))
    named = [("K", i, j) for i in kinds for j in kinds if i <= j] + [("g", i, i) for i in kinds]
    named += [("G", i, j) for i in kinds for j in kinds]
    trees = [cKDTree(stand.of(k)) for k in kinds]
    most = [
        _FURTHEST * min(stand.size_m) if name in "Kg" else 1.2 * float(nearest_m(trees[i], trees[j]).max())
        for name, i, j in named
    ]
    radii = np.array(most)[:, None] * np.arange(1, RADII + 1) / RADII
    for row, (name, i, _) in enumerate(named):
        if name == "g":  # from half of the smoothing's width on
            half = _SMOOTHING / 2 * np.sqrt(stand.area_m2 / len(stand.of(i)))
            radii[row] = np.linspace(min(half, most[row] / 2), most[row], RADII)
    return Functions(tuple(named), radii, stand.size_m)


def cross_k(points: cKDTree, others: cKDTree, radii_m: Floats, size_m: tuple[float, float]) -> Floats:
    """(R,) Ripley's K of one species about another (or itself) by the translation correction, square metres."""
    n = points.n * (others.n - 1 if points is others else others.n)
    if n <= 0:
        return np.zeros(len(radii_m))
    pairs = points.sparse_distance_matrix(others, float(radii_m[-1]), output_type="ndarray")
    if points is others:
        pairs = pairs[pairs["i"] != pairs["j"]]
    apart = np.abs(points.data[pairs["i"]] - others.data[pairs["j"]])
    area = size_m[0] * size_m[1]
    weight = area / ((size_m[0] - apart[:, 0]) * (size_m[1] - apart[:, 1]))
    ring = np.searchsorted(radii_m, pairs["v"], side="left")
    return np.asarray(np.cumsum(np.bincount(ring, weights=weight, minlength=len(radii_m) + 1)[:-1]) * (area / n))


def envelopes(nursery: Nursery, kernels: list[list[KernelTable]], seed: int) -> list[Envelope]:
    """All functions of the stand, and of one more new stand, against `STANDS` new stands of a seed."""
    stand = nursery.stand
    functions = functions_for(stand)
    new = np.array([functions.of(one.measured_m, one.species) for one in _stands(nursery, kernels, seed)])
    data = functions.of(stand.position_m, stand.species)
    more = nursery.grow(kernels, seed, STANDS)
    own = functions.of(more.measured_m, more.species)
    least, mean, most = new.min(axis=0), new.mean(axis=0), new.max(axis=0)
    return [
        Envelope(name, (i, j), functions.radii_m[k], data[k], least[k], mean[k], most[k], own[k])
        for k, (name, i, j) in enumerate(functions.species)
    ]


def _stands(nursery: Nursery, kernels: list[list[KernelTable]], seed: int) -> Iterator[NewStand]:
    return (nursery.grow(kernels, seed, number) for number in range(STANDS))


def trend(stand: MeasuredStand, nursery: Nursery, kernels: list[list[KernelTable]], seed: int) -> float:
    """Share of new stands whose plants are spread over quadrats as unevenly as the stand's, or more so.

    The chi-square of quadrats of six plants, not against a random pattern but against what the kernel makes: clusters
    are uneven too. Below 0.05 the stand has a trend that kernels cannot explain.
    """
    along = max(2, round(np.sqrt(stand.n / _PER_QUADRAT)))
    own = _unevenness(stand.position_m, stand.size_m, along)
    more = [_unevenness(new.measured_m, stand.size_m, along) >= own for new in _stands(nursery, kernels, seed)]
    return (1 + sum(more)) / (1 + len(more))


def _unevenness(position_m: Floats, size_m: tuple[float, float], along: int) -> float:
    cell = np.minimum((position_m / size_m * along).astype(np.int64), along - 1)
    counts = np.bincount(cell[:, 0] * along + cell[:, 1], minlength=along * along)
    return float(np.sum((counts - counts.mean()) ** 2) / max(counts.mean(), 1e-12))
