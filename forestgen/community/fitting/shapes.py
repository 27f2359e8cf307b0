"""Kernels as a fit varies them: log κ at knots, and a hard core where the stand has no pair at all."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from forestgen.community.fitting.stand import MeasuredStand
from forestgen.community.placement.kernels import KernelSection, KernelTable, table

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
    knots_m: NDArray[np.float64]  # (P, M + 1) metres, ascending; the last is the reach, where κ is 1
    core_m: NDArray[np.float64]  # (P,) metres; κ is 0 up to here

    @property
    def free(self) -> tuple[int, int]:
        """P, M."""
        return len(self.pairs), self.knots_m.shape[1] - 1

    @property
    def reach_m(self) -> float:
        return float(self.knots_m[:, -1].max())

    def control_points(self, log_kappa: NDArray[np.float64]) -> list[list[tuple[float, float]]]:
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

    def tables(self, log_kappa: NDArray[np.float64]) -> list[list[KernelTable]]:
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

    Followers act on founders' field in vain: founders have been placed by then.
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
