"""A fit as a whole: the likeliest kernels, those whose new stands match the measured one, and the test of them."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.community.fitting.envelopes import Envelope, envelopes, trend
from forestgen.community.fitting.likeliest import likeliest
from forestgen.community.fitting.matching import LOOKS, Matched, Matcher, match
from forestgen.community.fitting.shapes import KernelShapes, kernel_shapes
from forestgen.community.fitting.simulate import NewStand, Nursery, fitting_cells
from forestgen.community.fitting.stand import MeasuredStand
from forestgen.community.fitting.summaries import summaries_for
from forestgen.community.placement.kernels import KernelTable
from forestgen.core.errors import RecipeError
from forestgen.core.progress import Progress, Silent
from forestgen.core.randomness import child_rng

_PLANTS_AT_ONCE = 16_000  # in the new stands of a look
_FEWEST_STANDS, _MOST_STANDS = 40, 250
_CHECKS = 1_000_000  # seeds of checks are far from those of a fit


@dataclass(frozen=True)
class Settings:
    """How to fit."""

    seed: int = 0
    checks: int = 1  # sets of 39 new stands against which the stand is tested
    reach_m: float | None = None  # of the kernels; None: see `default_reach_m`
    stands: int | None = None  # new stands of a look; None: by the stand's size


@dataclass(frozen=True)
class Fit:
    """Kernels fitted to a stand, and how well new stands resemble it."""

    stand: MeasuredStand
    nursery: Nursery
    shapes: KernelShapes
    likeliest: NDArray[np.float64]  # (P, M) log κ where the fit began
    matched: Matched
    checks: tuple[tuple[Envelope, ...], ...]  # of each set of new stands
    trend: float  # share of new stands that are as uneven
    example: NewStand
    seed: int
    took_s: float

    @property
    def kernels(self) -> list[list[KernelTable]]:
        return self.shapes.tables(self.matched.log_kappa)

    @property
    def check_seed(self) -> int:
        """Seed of the new stands of the first check."""
        return self.seed + _CHECKS

    def held(self, name: str) -> int:
        """In how many of the checks all functions of a name lie within their envelopes."""
        return sum(not any(one.left.any() for one in check if one.name == name) for check in self.checks)


def fit_stand(stand: MeasuredStand, settings: Settings, progress: Progress | None = None) -> Fit:
    """Fit, then test with new random numbers.

    Raises
    ------
    RecipeError : `reach_m` does not suit the window.
    """
    began, listener = time.perf_counter(), progress or Silent()
    _check_reach(stand, settings.reach_m)
    shapes = kernel_shapes(stand, settings.reach_m)
    nursery = Nursery(stand, fitting_cells(stand))
    number = settings.stands or int(np.clip(_PLANTS_AT_ONCE // stand.n, _FEWEST_STANDS, _MOST_STANDS))
    start = likeliest(stand, shapes, child_rng(settings.seed, "fit", "orders"))
    matcher = Matcher(nursery, shapes, summaries_for(stand, shapes.reach_m), number, settings.seed)
    with listener.stage("new stands", LOOKS * number) as told:
        matched = match(matcher, start, told)
    kernels = shapes.tables(matched.log_kappa)
    seeds = [settings.seed + _CHECKS + check for check in range(settings.checks)]
    with listener.stage("check", len(seeds)) as told:
        checks = []
        for seed in seeds:
            checks.append(tuple(envelopes(nursery, kernels, seed)))
            told(1)
    return Fit(
        stand, nursery, shapes, start, matched, tuple(checks), trend(stand, nursery, kernels, seeds[0]),
        nursery.grow(kernels, seeds[0], 0), settings.seed, time.perf_counter() - began,
    )  # fmt: skip


def _check_reach(stand: MeasuredStand, reach_m: float | None) -> None:
    most = min(stand.size_m) / 2
    if reach_m is not None and not stand.spacing_m / 4 <= reach_m <= most:
        raise RecipeError(
            "this reach does not suit the stand",
            where="--reach-m",
            expected=f"{stand.spacing_m / 4:.3g} (a quarter of the plants' spacing) to {most:.3g} m (half the window)",
            got=f"{reach_m:g}",
        )
