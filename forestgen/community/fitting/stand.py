"""A measured stand as a fit takes it, checked, and new stands of the model deformation_kernel, measured like it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from forestgen.community.model import Site
from forestgen.community.placement.densities import grid_shape
from forestgen.community.placement.field import DensityField, place
from forestgen.community.placement.kernels import KernelTable
from forestgen.community.point_statistics import PointTable
from forestgen.community.population import Floats
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
        raise AssetError(
            "too many species for a fit",
            where=where,
            expected=f"at most {MOST_SPECIES}",
            got=f"{len(names)}: " + ", ".join(str(one)[:40] for one in names[:8]),
            hint="give rare species one name together, such as other",
        )
    if numbers.min() < FEWEST_OF_A_SPECIES:
        rare = int(numbers.argmin())
        raise AssetError(
            "too few plants of a species for a fit",
            where=where,
            expected=f"{FEWEST_OF_A_SPECIES} at least",
            got=f"{numbers[rare]} of {names[rare]}",
            hint="leave the species out, or give rare species one name together, such as other",
        )
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
        raise ResourceError(
            "too many plants for a fit",
            where=where,
            expected=f"at most {MOST:,}: time grows with their number, and a part of the window tells as much",
            got=f"{n:,}",
            hint=f"keep the plants of a part of the window, such as {share:.2f} of its width and of its height, "
            "and state that part as the window",
        )
    if max(table.window.size_m) > LARGEST_M:
        raise AssetError(
            "the window is too large",
            where=where,
            expected=f"sides up to {LARGEST_M:,} m, those of a recipe's site; coordinates in metres",
            got=str(table.window),
        )
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
