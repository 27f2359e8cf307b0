"""A fit as a whole: the likeliest kernels, those whose new stands match the measured one, and the test of them.

Kernels match of which new stands have, on average, the pairs and the nearest plants of the measured one.
Newton steps on the mean differences between new stands and the stand, in units of the scatter of the first new stands:
in units of their own, kernels would be preferred whose stands differ most. How a mean answers to log κ is the
covariance of the number with the derivative of the log-likelihood of the stand it was counted in: one set of stands
gives the means and all their derivatives. All steps use the same random numbers.

Where one kernel cannot make the stand's nearest neighbours, there are two kinds of plants. A kernel that invites
multiplies with every plant of a clump. One strong enough to leave few strays tends to let the first clumps swallow all
the rest. Here some plants come first, the founders, and keep apart; those that follow are drawn to founders, so
strongly that few stand elsewhere, and act on one another by a kernel of their own. Then there are about as many clumps
as founders. It is the sequential cousin of processes of parents and offspring; the parents are plants, too. Founders of
the measured stand are unknown: new stands and the stand are compared as plants of one kind.

Reference: Neyman and Scott 1958, J. R. Stat. Soc. B 20, for parents and offspring.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from forestgen.community.fitting import likelihood
from forestgen.community.fitting import stand as measured
from forestgen.community.placement.kernels import KernelTable
from forestgen.community.population import Floats
from forestgen.core.errors import RecipeError
from forestgen.core.progress import Progress, Silent
from forestgen.core.randomness import child_rng

_PLANTS_AT_ONCE = 16_000  # in the new stands of a look
_FEWEST_STANDS, _MOST_STANDS = 40, 250
_POOR = 2.0  # deviations: with nearest neighbours as far from the stand's as this, founders are tried
_CHECKS = 1_000_000  # seeds of checks are far from those of a fit
_GREATEST_STEP = 0.7  # of a log κ
_LEAST_GAIN, _SMALL_GAINS = 0.01, 2  # of the loss: with less in so many steps on end, a round is done
_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 0.1, 0.01, 20.0


class Round(NamedTuple):
    """How a round of the fit goes."""

    share: float  # of the stands
    steps: int  # at most
    knee: float  # deviations: of greater differences the fourth power weighs more than the square


#: First roughly the mean, then all radii alike.
ROUNDS = (Round(0.4, 10, 2.0), Round(1.0, 16, 1.0))
LOOKS = 22  # a look at all stands of a round with a share of 1, at most: for bars
_PLANTS_OF_A_FOUNDER = (7.0, 4.5, 3.0)  # itself and those that follow it
_WIDTHS = (1.0, 1.6, 2.4)  # of a clump, in the distance within which most plants have a neighbour
_MOST = 0.85
_DRAWN = 10.0  # field about founders, against the rest of the window: so much a start has
_APART = -2.0  # log κ among founders, at a start
_GREATEST = 3.9  # of a start's log κ
#: A look at all stands, at most: for bars.
FOUNDERS_LOOKS = math.ceil(
    len(_PLANTS_OF_A_FOUNDER) * (len(_WIDTHS) + ROUNDS[0].steps + 1) * ROUNDS[0].share + ROUNDS[1].steps + 1
)
_BETTER = 0.5  # of one kernel's loss, after either round: with more, founders are not worth their kernels


@dataclass(frozen=True)
class Matched:
    """What the steps came to."""

    log_kappa: Floats  # (P, M)
    differences: Floats  # (A,) mean of new stands less the stand, in their standard deviations
    loss: float
    rough_loss: float  # at the end of the first round


@dataclass(frozen=True)
class Look:
    """New stands of one set of kernels."""

    log_kappa: Floats  # (P * M,)
    loss: float
    z: Floats  # (A,)
    slope: Floats  # (A, P * M) of z


class Matcher:
    """New stands against the measured one."""

    def __init__(
        self,
        nursery: measured.Nursery,
        shapes: likelihood.KernelShapes,
        summaries: measured.Summaries,
        number: int,
        seed: int,
        scale: Floats | None = None,
    ) -> None:
        self.nursery, self.shapes, self.summaries = nursery, shapes, summaries
        self.all_stands, self.number, self.seed, self.knee = number, number, seed, 1.0
        self.scale = scale  # (A,) of the first look, for all: wide scatter is no merit
        self.penalty = likelihood.roughness_penalty(shapes)
        stand = nursery.stand
        self.target = summaries.of(stand.position_m, stand.species)
        self.grid = likelihood.likelihood_shape(stand, shapes)

    def begin(self, one: Round) -> None:
        """Set the number of stands and what differences weigh."""
        self.number, self.knee = max(2, round(one.share * self.all_stands)), one.knee

    def look(self, flat: Floats) -> Look:
        """Simulate, count, and take derivatives."""
        shapes, stand = self.shapes, self.nursery.stand
        log_kappa = flat.reshape(shapes.free)
        kernels = shapes.tables(log_kappa)
        counts = np.empty((self.number, len(self.target)))
        scores = np.empty((self.number, flat.size))
        for number in range(self.number):
            new = self.nursery.grow(kernels, self.seed, number)
            counts[number] = self.summaries.of(new.measured_m, new.species)
            found = likelihood.score(new.placed_m, new.kind, shapes, shapes.core_m, log_kappa, stand.size_m, self.grid)
            scores[number] = found.gradient.ravel()
        mean = counts.mean(axis=0)
        if self.scale is None:
            self.scale = np.maximum(counts.std(axis=0), self.summaries.least)
        z = (mean - self.target) / self.scale
        slope = (counts - mean).T @ (scores - scores.mean(axis=0)) / (self.number * self.scale[:, None])
        worth = self.summaries.worth
        loss = float(np.sum(worth * (z**2 / 2 + z**4 / (4 * self.knee**2))) + flat @ self.penalty @ flat / 2)
        return Look(flat, loss, z, slope)

    def step(self, here: Look, damping: float) -> Floats:
        """Where to look next."""
        weight = self.summaries.worth * (1 + here.z**2 / self.knee**2)
        normal = here.slope.T @ (weight[:, None] * here.slope)
        gradient = here.slope.T @ (weight * here.z) + self.penalty @ here.log_kappa
        held = damping * np.diag(np.diag(normal) + 1)
        move = -np.linalg.solve(normal + self.penalty + held, gradient)
        move *= min(1.0, _GREATEST_STEP / max(float(np.abs(move).max()), 1e-12))
        return np.clip(here.log_kappa + move, -6.0, 4.0)


def climb(matcher: Matcher, start: Floats, one: Round, advance: Callable[[int], None]) -> Look:
    """Take the steps of a round until they gain little: its best look.

    `advance` is called with the number of stands after each look.
    """
    matcher.begin(one)
    best, damping = matcher.look(start.ravel()), _DAMPING
    looks, small = 1, 0
    advance(matcher.number)
    while looks <= one.steps and damping <= _MOST_DAMPING:
        tried = matcher.look(matcher.step(best, damping))
        advance(matcher.number)
        looks += 1
        gain = (best.loss - tried.loss) / best.loss
        if gain <= 0:
            damping *= 5
            continue
        damping = max(damping / 3, _LEAST_DAMPING)
        best = tried
        small = small + 1 if gain < _LEAST_GAIN else 0
        if small == _SMALL_GAINS:
            break
    return best


def refine(matcher: Matcher, first: Look, advance: Callable[[int], None]) -> Matched:
    """What the second round makes of the first."""
    best = climb(matcher, first.log_kappa, ROUNDS[1], advance)
    return Matched(best.log_kappa.reshape(matcher.shapes.free), best.z, best.loss, first.loss)


def match_founders(plain: Matcher, of_one: Matched, advance: Callable[[int], None]) -> tuple[Matcher, Matched] | None:
    """Try several numbers of founders for a round each, and the best for the second; None: one kernel does as well.

    Differences count as in `plain`, the matcher of one kernel, which came to `of_one`.
    """
    stand, shapes = plain.nursery.stand, likelihood.founder_shapes(plain.shapes)
    found: list[tuple[Matcher, Look]] = []
    for plants in _PLANTS_OF_A_FOUNDER:
        founders = max(2, round(stand.n / plants))
        nursery = replace(plain.nursery, founders=founders)
        matcher = Matcher(nursery, shapes, plain.summaries, plain.all_stands, plain.seed, plain.scale)
        matcher.begin(ROUNDS[0])
        looks = [matcher.look(start.ravel()) for start in _starts(stand, shapes, founders)]
        advance(len(looks) * matcher.number)
        best = min(looks, key=lambda look: look.loss)
        found.append((matcher, climb(matcher, best.log_kappa, ROUNDS[0], advance)))
    matcher, first = min(found, key=lambda pair: pair[1].loss)
    if first.loss > _BETTER * of_one.rough_loss:
        return None
    matched = refine(matcher, first, advance)
    return (matcher, matched) if matched.loss <= _BETTER * of_one.loss else None


def _starts(stand: measured.MeasuredStand, shapes: likelihood.KernelShapes, founders: int) -> list[Floats]:
    """(3, M) log κ: founders keep apart, followers are drawn to them and ignore one another."""
    tree = cKDTree(stand.position_m)
    near_m = float(np.quantile(measured.nearest_m(tree, tree), _MOST))
    starts = []
    for width in _WIDTHS:
        radius_m = width * near_m
        drawn = math.log(_DRAWN * stand.area_m2 / (founders * math.pi * radius_m**2))
        start = np.zeros(shapes.free)
        start[0] = np.interp(shapes.knots_m[0, :-1], [radius_m, 2 * radius_m], [_APART, 0.0])
        most = float(np.clip(drawn, 0.0, _GREATEST))
        start[1] = np.interp(shapes.knots_m[1, :-1], [radius_m, 1.5 * radius_m], [most, 0.0])
        starts.append(start)
    return starts


@dataclass(frozen=True)
class Fit:
    """Kernels fitted to a stand, and how well new stands resemble it."""

    stand: measured.MeasuredStand
    nursery: measured.Nursery
    shapes: likelihood.KernelShapes
    matched: Matched
    plain: Matched  # with one kernel for each pair of species; the same as `matched` where no founders are
    placed: int  # new stands in all, for the fit
    checks: tuple[tuple[measured.Envelope, ...], ...]  # of each set of new stands
    trend: float  # share of new stands that are as uneven
    example: measured.NewStand
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

    def held(self, name: str, *, own: bool = False) -> int:
        """In how many of the checks all functions of a name lie within their envelopes; or those of one more stand."""
        left = [[one.own_left if own else one.left for one in check if one.name == name] for check in self.checks]
        return sum(not any(one.any() for one in check) for check in left)


def fit_stand(
    stand: measured.MeasuredStand,
    progress: Progress | None = None,
    *,
    seed: int = 0,
    checks: int = 1,
    reach_m: float | None = None,
    stands: int | None = None,
    founders: bool = True,
) -> Fit:
    """Fit, then test with new random numbers against so many sets of 39 new stands.

    `reach_m` is that of the kernels, by default that of `default_reach_m`, and a `RecipeError` if it does not suit the
    window; `stands` are the new ones of a look, by default by the stand's size; `founders` may be tried or not.
    """
    began, listener = time.perf_counter(), progress or Silent()
    _check_reach(stand, reach_m)
    shapes = likelihood.kernel_shapes(stand, reach_m)
    number = stands or int(np.clip(_PLANTS_AT_ONCE // stand.n, _FEWEST_STANDS, _MOST_STANDS))
    start = likelihood.likeliest(stand, shapes, child_rng(seed, "fit", "orders"))
    nursery = measured.Nursery(stand, measured.fitting_cells(stand))
    matcher = Matcher(nursery, shapes, measured.summaries_for(stand, shapes.reach_m), number, seed)
    placed = 0

    def counted(advance: Callable[[int], None]) -> Callable[[int], None]:
        def more(stands: int) -> None:
            nonlocal placed
            placed += stands
            advance(stands)

        return more

    with listener.stage("new stands", LOOKS * number) as advance:
        more = counted(advance)
        plain = matched = refine(matcher, climb(matcher, start, ROUNDS[0], more), more)
    if founders and _wants_founders(matcher, plain):
        with listener.stage("founders", FOUNDERS_LOOKS * number) as advance:
            founded = match_founders(matcher, plain, counted(advance))
        if founded:
            matcher, matched = founded
    nursery, shapes = matcher.nursery, matcher.shapes
    kernels = shapes.tables(matched.log_kappa)
    first, tested = seed + _CHECKS, []
    with listener.stage("check", checks) as advance:
        for check in range(checks):
            tested.append(tuple(measured.envelopes(nursery, kernels, first + check)))
            advance(1)
    return Fit(
        stand=stand,
        nursery=nursery,
        shapes=shapes,
        matched=matched,
        plain=plain,
        placed=placed,
        checks=tuple(tested),
        trend=measured.trend(stand, nursery, kernels, first),
        example=nursery.grow(kernels, first, 0),
        seed=seed,
        took_s=time.perf_counter() - began,
    )


def _wants_founders(matcher: Matcher, plain: Matched) -> bool:
    """Whether one kernel leaves nearest neighbours far from the stand's, which has neither sizes nor species."""
    stand = matcher.nursery.stand
    poor = np.abs(matcher.summaries.nearest(plain.differences)).max() >= _POOR
    return bool(poor) and not stand.ordered and len(stand.names) == 1


def _check_reach(stand: measured.MeasuredStand, reach_m: float | None) -> None:
    most = min(stand.size_m) / 2
    if reach_m is not None and not stand.spacing_m / 4 <= reach_m <= most:
        problem = "this reach does not suit the stand"
        expected = f"{stand.spacing_m / 4:.3g} (a quarter of the plants' spacing) to {most:.3g} m (half the window)"
        raise RecipeError(problem, parameter="reach_m", expected=expected, got=f"{reach_m:g}")
