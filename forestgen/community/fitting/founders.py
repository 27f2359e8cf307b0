"""Kernels of two kinds of plants, where one kernel cannot make the stand's nearest neighbours.

A kernel that invites multiplies with every plant of a clump. One strong enough to leave few strays tends to let the
first clumps swallow all the rest. Here some plants come first, the founders, and keep apart; those that follow are
drawn to founders, so strongly that few stand elsewhere, and act on one another by a kernel of their own. Then there are
about as many clumps as founders. It is the sequential cousin of processes of parents and offspring; the parents are
plants, too. Who was a founder in the measured stand is unknown and not asked: new stands and the stand are compared as
plants of one kind.

References
----------
Neyman and Scott 1958, J. R. Stat. Soc. B 20, for parents and offspring.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from forestgen.community.fitting.matching import ROUNDS, Climb, Matched, Matcher, climb, matched
from forestgen.community.fitting.shapes import KernelShapes, founder_shapes
from forestgen.community.fitting.simulate import Nursery
from forestgen.community.fitting.stand import MeasuredStand
from forestgen.community.fitting.summaries import nearest_m

_PLANTS_OF_A_FOUNDER = (7.0, 4.5, 3.0)  # itself and those that follow it
_WIDTHS = (1.0, 1.6, 2.4)  # of a clump, in the distance within which most plants have a neighbour
_MOST = 0.85
_DRAWN = 10.0  # field about founders, against the rest of the window: so much a start has
_APART = -2.0  # log κ among founders, at a start
_GREATEST = 3.9  # of a start's log κ
#: A look at all stands, at most: for bars.
LOOKS = math.ceil(
    len(_PLANTS_OF_A_FOUNDER) * (len(_WIDTHS) + ROUNDS[0].steps + 1) * ROUNDS[0].share + ROUNDS[1].steps + 1
)


_BETTER = 0.5  # of one kernel's loss, after either round: with more, founders are not worth their kernels


@dataclass(frozen=True)
class Founded:
    """A search for a fit with founders."""

    nursery: Nursery
    shapes: KernelShapes
    matched: Matched | None  # None: one kernel does nearly as well
    stands: int  # placed in all


def match_founders(plain: Matcher, of_one: Matched, told: Callable[[int], None]) -> Founded:
    """Try several numbers of founders for a round each, and the best of them for the second round.

    Differences count as in `plain`, the matcher of one kernel, which came to `of_one`.
    """
    stand, shapes = plain.nursery.stand, founder_shapes(plain.shapes)
    found: list[tuple[Matcher, Climb]] = []
    for plants in _PLANTS_OF_A_FOUNDER:
        founders = max(2, round(stand.n / plants))
        nursery = replace(plain.nursery, founders=founders)
        matcher = Matcher(nursery, shapes, plain.summaries, plain.all_stands, plain.seed, plain.scale)
        matcher.begin(ROUNDS[0])
        looks = [matcher.look(start.ravel()) for start in _starts(stand, shapes, founders)]
        told(len(looks) * matcher.number)
        best = min(looks, key=lambda look: look.loss)
        found.append((matcher, climb(matcher, best.log_kappa, ROUNDS[0], told)))
    stands = sum(one.stands + len(_WIDTHS) * matcher.number for matcher, one in found)
    matcher, first = min(found, key=lambda pair: pair[1].look.loss)
    if first.look.loss > _BETTER * of_one.rough_loss:
        return Founded(matcher.nursery, shapes, None, stands)
    second = climb(matcher, first.look.log_kappa, ROUNDS[1], told)
    better = second.look.loss <= _BETTER * of_one.losses[-1]
    result = matched(matcher, first, second) if better else None
    return Founded(matcher.nursery, shapes, result, stands + second.stands)


def _starts(stand: MeasuredStand, shapes: KernelShapes, founders: int) -> list[NDArray[np.float64]]:
    """(3, M) log κ: founders keep apart, those that follow are drawn to them and do not mind one another."""
    tree = cKDTree(stand.position_m)
    near_m = float(np.quantile(nearest_m(tree, tree), _MOST))
    starts = []
    for width in _WIDTHS:
        radius_m = width * near_m
        drawn = math.log(_DRAWN * stand.area_m2 / (founders * math.pi * radius_m**2))
        start = np.zeros(shapes.free)
        start[0] = np.interp(shapes.knots_m[0, :-1], [radius_m, 2 * radius_m], [_APART, 0.0])
        start[1] = np.interp(
            shapes.knots_m[1, :-1], [radius_m, 1.5 * radius_m], [float(np.clip(drawn, 0.0, _GREATEST)), 0.0]
        )
        starts.append(start)
    return starts
