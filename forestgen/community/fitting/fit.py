"""A fit as a whole: the likeliest kernels, those whose new stands match the measured one, and the test of them."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from forestgen.community.fitting.envelopes import Envelope, envelopes, trend
from forestgen.community.fitting.founders import LOOKS as FOUNDERS_LOOKS
from forestgen.community.fitting.founders import Founded, match_founders
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
_POOR = 2.0  # deviations: with nearest neighbours as far from the stand's as this, founders are tried
_CHECKS = 1_000_000  # seeds of checks are far from those of a fit


@dataclass(frozen=True)
class Settings:
    """How to fit."""

    seed: int = 0
    checks: int = 1  # sets of 39 new stands against which the stand is tested
    reach_m: float | None = None  # of the kernels; None: see `default_reach_m`
    stands: int | None = None  # new stands of a look; None: by the stand's size
    founders: bool = True  # whether they may be tried


@dataclass(frozen=True)
class Fit:
    """Kernels fitted to a stand, and how well new stands resemble it."""

    stand: MeasuredStand
    nursery: Nursery
    shapes: KernelShapes
    matched: Matched
    plain: Matched  # with one kernel for each pair of species; the same as `matched` where no founders are
    placed: int  # new stands in all, for the fit
    checks: tuple[tuple[Envelope, ...], ...]  # of each set of new stands
    trend: float  # share of new stands that are as uneven
    example: NewStand
    seed: int
    took_s: float

    @property
    def kernels(self) -> list[list[KernelTable]]:
        return self.shapes.tables(self.matched.log_kappa)

    @property
    def kinds(self) -> tuple[str, ...]:
        """Names of those among which kernels act: the species, or founders and followers of the one."""
        names = self.stand.names
        return (f"{names[0]} founders".strip(), f"{names[0]} followers".strip()) if self.nursery.founders else names

    @property
    def directed(self) -> bool:
        """Whether kernels say who acts on whom: the order of placement is known."""
        return self.stand.ordered or self.nursery.founders > 0

    @property
    def kinds_count(self) -> tuple[int, ...]:
        """Plants of each kind."""
        first = self.nursery.founders
        if first:
            return first, self.stand.n - first
        return tuple(np.bincount(self.stand.species, minlength=len(self.stand.names)).tolist())

    def held(self, name: str) -> int:
        """In how many of the checks all functions of a name lie within their envelopes."""
        return sum(not any(one.left.any() for one in check if one.name == name) for check in self.checks)

    def own_held(self, name: str) -> int:
        """In how many of the checks those of one more new stand do."""
        return sum(not any(one.own_left.any() for one in check if one.name == name) for check in self.checks)


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
        plain = matched = match(matcher, start, told)
    founded = _founded(matcher, plain, listener) if settings.founders else None
    if founded and founded.matched:
        nursery, shapes, matched = founded.nursery, founded.shapes, founded.matched
    kernels = shapes.tables(matched.log_kappa)
    checks = _checked(nursery, kernels, settings, listener)
    first = settings.seed + _CHECKS
    return Fit(
        stand=stand,
        nursery=nursery,
        shapes=shapes,
        matched=matched,
        plain=plain,
        placed=plain.stands + (founded.stands if founded else 0),
        checks=checks,
        trend=trend(stand, nursery, kernels, first),
        example=nursery.grow(kernels, first, 0),
        seed=settings.seed,
        took_s=time.perf_counter() - began,
    )


def _checked(
    nursery: Nursery, kernels: list[list[KernelTable]], settings: Settings, listener: Progress
) -> tuple[tuple[Envelope, ...], ...]:
    checks = []
    with listener.stage("check", settings.checks) as told:
        for check in range(settings.checks):
            checks.append(tuple(envelopes(nursery, kernels, settings.seed + _CHECKS + check)))
            told(1)
    return tuple(checks)


def _founded(matcher: Matcher, plain: Matched, listener: Progress) -> Founded | None:
    """A fit with founders, if one kernel leaves nearest neighbours far from the stand's; without sizes or species."""
    stand = matcher.nursery.stand
    poor = np.abs(matcher.summaries.nearest(plain.differences)).max() >= _POOR
    if not poor or stand.ordered or len(stand.names) > 1:
        return None
    with listener.stage("founders", FOUNDERS_LOOKS * matcher.all_stands) as told:
        return match_founders(matcher, plain, told)


def _check_reach(stand: MeasuredStand, reach_m: float | None) -> None:
    most = min(stand.size_m) / 2
    if reach_m is not None and not stand.spacing_m / 4 <= reach_m <= most:
        raise RecipeError(
            "this reach does not suit the stand",
            parameter="reach_m",
            expected=f"{stand.spacing_m / 4:.3g} (a quarter of the plants' spacing) to {most:.3g} m (half the window)",
            got=f"{reach_m:g}",
        )
