"""The fit itself: kernels of which new stands have, on average, the pairs and the nearest plants of the measured one.

Newton steps on the mean differences between new stands and the stand, in units of the scatter of the first new stands:
in units of their own, kernels would be preferred whose stands differ most. How a mean answers to log κ is the
covariance of the number with the derivative of the log-likelihood of the stand it was counted in: one set of stands
gives the means and all their derivatives. All steps use the same random numbers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from forestgen.community.fitting.likeliest import likelihood_shape, roughness_penalty
from forestgen.community.fitting.likelihood import score
from forestgen.community.fitting.shapes import KernelShapes
from forestgen.community.fitting.simulate import Nursery
from forestgen.community.fitting.summaries import Summaries

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


@dataclass(frozen=True)
class Matched:
    """What the steps came to."""

    log_kappa: NDArray[np.float64]  # (P, M)
    differences: NDArray[np.float64]  # (A,) mean of new stands less the stand, in their standard deviations
    losses: tuple[float, ...]  # of the accepted steps of both rounds
    stands: int  # placed in all
    rough_loss: float  # at the end of the first round


@dataclass(frozen=True)
class Look:
    """New stands of one set of kernels."""

    log_kappa: NDArray[np.float64]  # (P * M,)
    loss: float
    z: NDArray[np.float64]  # (A,)
    slope: NDArray[np.float64]  # (A, P * M) of z


class Matcher:
    """New stands against the measured one."""

    def __init__(
        self,
        nursery: Nursery,
        shapes: KernelShapes,
        summaries: Summaries,
        number: int,
        seed: int,
        scale: NDArray[np.float64] | None = None,
    ) -> None:
        self.nursery, self.shapes, self.summaries = nursery, shapes, summaries
        self.all_stands, self.number, self.seed, self.knee = number, number, seed, 1.0
        self.scale = scale  # (A,) of the first look, for all: wide scatter is no merit
        self.penalty = roughness_penalty(shapes)
        stand = nursery.stand
        self.target = summaries.of(stand.position_m, stand.species)
        self.grid = likelihood_shape(stand, shapes)

    def begin(self, one: Round) -> None:
        """Set the number of stands and what differences weigh."""
        self.number, self.knee = max(2, round(one.share * self.all_stands)), one.knee

    def look(self, flat: NDArray[np.float64]) -> Look:
        """Simulate, count, and take derivatives."""
        shapes, stand = self.shapes, self.nursery.stand
        log_kappa = flat.reshape(shapes.free)
        kernels = shapes.tables(log_kappa)
        counts = np.empty((self.number, len(self.target)))
        scores = np.empty((self.number, flat.size))
        for number in range(self.number):
            new = self.nursery.grow(kernels, self.seed, number)
            counts[number] = self.summaries.of(new.measured_m, new.species)
            scores[number] = score(
                new.placed_m, new.kind, shapes.kernel_of, shapes.knots_m, shapes.core_m,
                log_kappa, stand.size_m, self.grid,
            ).gradient.ravel()  # fmt: skip
        mean = counts.mean(axis=0)
        if self.scale is None:
            self.scale = self.summaries.scales(stand, counts.std(axis=0))
        z = (mean - self.target) / self.scale
        slope = (counts - mean).T @ (scores - scores.mean(axis=0)) / (self.number * self.scale[:, None])
        worth = self.summaries.worth
        loss = float(np.sum(worth * (z**2 / 2 + z**4 / (4 * self.knee**2))) + flat @ self.penalty @ flat / 2)
        return Look(flat, loss, z, slope)

    def step(self, here: Look, damping: float) -> NDArray[np.float64]:
        """Where to look next."""
        weight = self.summaries.worth * (1 + here.z**2 / self.knee**2)
        normal = here.slope.T @ (weight[:, None] * here.slope)
        gradient = here.slope.T @ (weight * here.z) + self.penalty @ here.log_kappa
        held = damping * np.diag(np.diag(normal) + 1)
        move = -np.linalg.solve(normal + self.penalty + held, gradient)
        move *= min(1.0, _GREATEST_STEP / max(float(np.abs(move).max()), 1e-12))
        return np.clip(here.log_kappa + move, -6.0, 4.0)


@dataclass(frozen=True)
class Climb:
    """The steps of one round."""

    look: Look  # the best
    losses: tuple[float, ...]  # of the accepted steps
    stands: int  # placed


def climb(matcher: Matcher, start: NDArray[np.float64], one: Round, told: Callable[[int], None]) -> Climb:
    """Take the steps of a round until they gain little."""
    matcher.begin(one)
    best, damping = matcher.look(start.ravel()), _DAMPING
    losses = [best.loss]
    looks, small = 1, 0
    told(matcher.number)
    while looks <= one.steps and damping <= _MOST_DAMPING:
        tried = matcher.look(matcher.step(best, damping))
        told(matcher.number)
        looks += 1
        gain = (best.loss - tried.loss) / best.loss
        if gain <= 0:
            damping *= 5
            continue
        damping = max(damping / 3, _LEAST_DAMPING)
        best = tried
        losses.append(best.loss)
        small = small + 1 if gain < _LEAST_GAIN else 0
        if small == _SMALL_GAINS:
            break
    return Climb(best, tuple(losses), looks * matcher.number)


def match(matcher: Matcher, start: NDArray[np.float64], told: Callable[[int], None]) -> Matched:
    """Both rounds; `told` is called with the number of stands after each look."""
    first = climb(matcher, start, ROUNDS[0], told)
    second = climb(matcher, first.look.log_kappa, ROUNDS[1], told)
    return matched(matcher, first, second)


def matched(matcher: Matcher, first: Climb, second: Climb) -> Matched:
    """What two rounds came to."""
    log_kappa = second.look.log_kappa.reshape(matcher.shapes.free)
    losses, stands = first.losses + second.losses, first.stands + second.stands
    return Matched(log_kappa, second.look.z, losses, stands, first.look.loss)
