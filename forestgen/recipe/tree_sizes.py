"""Sizes of trees by their height: stem diameter, crown width, crown length and leaf mass, with their spread.

Of a tree of height H metres, with D the diameter at breast height::

    D = d (h(H) / h(10))^p e^x      h(H) = (H - 1.3) / (T - H)
    W, M, C / (H - C) = v (H / 10)^p (D / D(H))^q e^x      D(H): the median diameter at this height

for crown width W, dry leaf mass M and crown length C. Each x is a normal number of the tree's own, of standard
deviation s + t ln(H / 10); so trees of one height differ, and a tree with a stouter stem than others has a wider,
longer and leafier crown: D / D(H) counts as 0.5 to 2. Competition shifts D: what grows in the open is stouter, what is
suppressed is slender. A tree without neighbours has a wider and longer crown, too, than a tree of its diameter in a
stand: W and C / (H - C) are multiplied by numbers of the species, between the two in proportion to the shift of D.

The other way round, the height of a tree of a diameter is 1.3 m + (T - 1.3 m) / (1 + c D^(-1/p)): the curve of Hossfeld
(1822; form IV in Zeide 1993, Analysis of growth equations, Forest Science 39, 594-616), which ends at T. T of the
shipped species is that of 5 m steps with the least error of D over measured trees, or a published height of the tallest
trees near it; the species' files say which.

The shifts: an open-grown Norway spruce of 6.4 m and a Scots pine of 5.6 m have a diameter of 10 cm (Stampfer 1995, in
Vospernik, Monserud & Sterba 2010, Forest Ecology and Management 260, 1735-1753), 1.46 and 1.23 times that of trees in
stands; in theory the ratio to the mean stem of the densest stand is 2 (Sterba 1975, there).

Crowns of open-grown trees are as wide as Hasenauer (1997, Dimensional relationships of open-grown trees in Austria,
Forest Ecology and Management 96, 197-206) measured them, and as long as in the crown model of Hasenauer & Monserud
(1996, there 84, 49-60) without competition. Of measured trees of one height and diameter those with the longer crown
have more leaves, by the crown's length to the power 0.74 +- 0.08 (mean of seven species of BAAD); so have open-grown
ones.

Below 3 m, where few trees are measured, a seedling is a smaller tree: W is in proportion to H, M to H^2.5.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from forestgen.core.frames import BREAST_HEIGHT_M
from forestgen.core.randomness import SPLIT_MIX_STEP, mixed
from forestgen.recipe.fields import NonNegative, Number, Positive, Section, Text, violation

Floats = NDArray[np.float64]
Grown = Literal["stand", "open", "suppressed"]

NUMBERS = 4  # standard normal numbers of a tree: of D, W, C and M
MOST_NORMAL = 2.5  # a tree's own numbers are no further from 0
_MOST_FOLLOWED = math.log(2.0)  # of the diameter over its median, which other sizes follow; few trees are beyond
_SAPLING_M = 3.0
_LEAF_POWER = 2.5
TOP = 0.95  # of the height of the tallest: from here on slenderness stays
_SPREAD = (0.02, 1.0)
_WIDEST = 1.2  # crown width over height, whatever the allometry says
_CROWN = (0.2, 0.98)  # crown length over height; in BAAD 1% of the trees above 8 m have less than 0.2
_CROWN_TREND = 0.7  # of the tallest tree's height: above, the crown ratio's median and spread stay
_LEAST_DBH_M = 0.002
LEAVES_BY_CROWN = 0.74  # power of the crown's length that leaves follow, in trees of one height and diameter
_SAME = 1e-9  # heights that differ by so little are equal


class StemLaw(Section):
    """Median and spread of the stem's diameter over the height of a tree."""

    at_10_m: Positive = Field(description="Median of trees 10 m tall.")
    height_exponent: Number = Field(ge=0.2, le=3, description="Power p of the height above 1.3 m over what is left.")
    spread: NonNegative = Field(0.0, le=1, description="Standard deviation s of the logarithm, 10 m tall.")
    spread_slope: Number = Field(0.0, ge=-1, le=1, description="Its change t with the logarithm of the height.")

    def deviation(self, log_height: Floats) -> Floats:
        """Standard deviation of the logarithm; `log_height`: of the height over 10 m."""
        return np.asarray(np.clip(self.spread + self.spread_slope * log_height, *_SPREAD))


class SizeLaw(StemLaw):
    """Median and spread of another size over the height of a tree, and how it follows the stem's diameter."""

    height_exponent: Number = Field(0.0, ge=-5, le=6, description="Power p of the height.")
    dbh_exponent: Number = Field(0.0, ge=-1, le=5, description="Power q of the diameter over its median.")

    def log_median(self, log_height: Floats) -> Floats:
        """Logarithm of the median; `log_height`: of the height over 10 m."""
        return np.asarray(np.log(self.at_10_m) + self.height_exponent * log_height)


@dataclass(frozen=True)
class Sizes:
    """Sizes of N trees, each (N,)."""

    dbh_m: Floats  # NaN of trees below breast height
    crown_width_m: Floats
    crown_base_m: Floats  # height above the foot
    leaf_kg: Floats  # dry


class TreeSizes(Section):
    """How a species' trees are proportioned, where they grow in a closed stand."""

    tallest_m: Positive = Field(
        ge=12, le=200, description="Height T of the tallest trees, which no tree reaches by its diameter."
    )
    dbh_m: StemLaw = Field(description="Diameter at breast height, metres.")
    crown_width_m: SizeLaw = Field(description="Mean diameter of the crown, metres.")
    crown_ratio: SizeLaw = Field(description="Crown length over the length of the stem below it.")
    leaf_kg: SizeLaw = Field(description="Dry mass of the leaves, kg.")
    open_grown: Positive = Field(
        1.5, ge=1, le=4, description="Diameter of a tree without neighbours over that of one in a stand, equally tall."
    )
    suppressed: Positive = Field(
        0.85, ge=0.3, le=1, description="The same of a tree that taller ones have overgrown: below 1, slender."
    )
    open_crown_width: Positive = Field(
        1.0,
        ge=0.5,
        le=4,
        description="Crown width of a tree without neighbours over that of one in a stand, equally thick.",
    )
    open_crown_ratio: Positive = Field(
        1.0, ge=0.5, le=20, description="The same of the crown length over the length of the stem below it."
    )
    source: Text = Field("", max_length=500, description="Where the numbers come from.")

    @model_validator(mode="after")
    def _open_trees_are_stouter(self) -> Self:
        if self.open_grown == 1.0 and (self.open_crown_width, self.open_crown_ratio) != (1.0, 1.0):
            hint = "leave open_crown_width and open_crown_ratio out, which go with the diameter"
            raise violation("above 1", problem="trees in the open are no stouter", got="1", hint=hint, at="open_grown")
        return self

    def shift(self, grown: Grown) -> float:
        """Logarithm of the diameter over that of a tree in a stand."""
        return float(np.log({"stand": 1.0, "open": self.open_grown, "suppressed": self.suppressed}[grown]))

    def log_dbh(self, height_m: Floats) -> Floats:
        """Logarithm of the median diameter; of trees below breast height that of the least one.

        Trees that are taller than 0.95 T have the slenderness of that height.
        """
        top_m = TOP * self.tallest_m
        stretched = self._log_stretched(np.clip(height_m, BREAST_HEIGHT_M + 1e-3, top_m)) - self._log_stretched(10.0)
        median = np.log(self.dbh_m.at_10_m) + self.dbh_m.height_exponent * stretched
        return np.asarray(np.maximum(median + np.log(np.maximum(height_m / top_m, 1.0)), np.log(_LEAST_DBH_M)))

    def height_deviation(self, height_m: Floats) -> Floats:
        """(N,) standard deviation of the logarithm of the height of trees of one diameter."""
        height_m = np.clip(height_m, BREAST_HEIGHT_M + 0.1, TOP * self.tallest_m)
        steepness = height_m / (height_m - BREAST_HEIGHT_M) + height_m / (self.tallest_m - height_m)
        return np.asarray(self.dbh_m.deviation(np.log(height_m / 10.0)) / (self.dbh_m.height_exponent * steepness))

    def _log_stretched(self, height_m: Floats | float) -> Floats:
        return np.asarray(np.log((height_m - BREAST_HEIGHT_M) / (self.tallest_m - height_m)))

    def sizes(
        self, height_m: Floats, normals: Floats, shift: Floats | float = 0.0, dbh_m: Floats | None = None
    ) -> Sizes:
        """Sizes of trees.

        Parameters
        ----------
        height_m : (N,) heights, above 0.
        normals : (N, 4) standard normal numbers of each tree's own, for diameter, width, crown length and leaves.
        shift : (N,) logarithm of the diameter over its median that competition makes, before the tree's own number.
        dbh_m : (N,) diameters that are known; NaN, None: by the allometry.
        """
        own = np.clip(normals, -MOST_NORMAL, MOST_NORMAL)
        log_height = np.log(np.maximum(height_m, _SAPLING_M) / 10.0)
        median = self.log_dbh(height_m)
        relative = shift + self.dbh_m.deviation(np.log(np.maximum(height_m, 0.1) / 10.0)) * own[:, 0]
        if dbh_m is not None:
            known = np.log(np.maximum(np.where(np.isnan(dbh_m), 1.0, dbh_m), 1e-4)) - median
            relative = np.where(np.isnan(dbh_m), relative, known)
        relative = np.broadcast_to(relative, height_m.shape)

        followed = np.clip(relative, -_MOST_FOLLOWED, _MOST_FOLLOWED)
        openness = np.clip(shift / max(self.shift("open"), 1e-9), 0.0, 1.0)  # 1: no neighbours

        def of(law: SizeLaw, column: int, log_height: Floats = log_height, in_open: float = 1.0) -> Floats:
            value = law.log_median(log_height) + law.dbh_exponent * followed + np.log(in_open) * openness
            return np.asarray(np.exp(value + law.deviation(log_height) * own[:, column]))

        sapling = np.asarray(np.minimum(height_m / _SAPLING_M, 1.0))
        trend = np.minimum(log_height, np.log(_CROWN_TREND * self.tallest_m / 10.0))
        in_stand, odds = (of(self.crown_ratio, 2, trend, factor) for factor in (1.0, self.open_crown_ratio))
        crown, in_stand = (np.clip(one / (1.0 + one), *_CROWN) for one in (odds, in_stand))
        width_m = of(self.crown_width_m, 1, in_open=self.open_crown_width)
        diameter = np.exp(median + relative)
        return Sizes(
            dbh_m=np.where(height_m > BREAST_HEIGHT_M, diameter, np.nan),
            crown_width_m=np.minimum(width_m * sapling, _WIDEST * height_m),
            crown_base_m=height_m * (1.0 - crown),
            leaf_kg=of(self.leaf_kg, 3) * sapling**_LEAF_POWER * (crown / in_stand) ** LEAVES_BY_CROWN,
        )

    def height_of(self, dbh_m: Floats, normals: Floats, shift: Floats | float = 0.0) -> Floats:
        """(N,) heights of trees whose diameters are known: the diameter's allometry the other way round.

        The height is the most likely one of a tree of this diameter in a stand of all heights where its own number and
        the height share the deviation evenly: the number counts half.
        """
        from scipy.special import expit  # slow to import

        own = np.clip(normals[:, 0], -MOST_NORMAL, MOST_NORMAL)
        height = np.full(dbh_m.shape, 10.0)
        for _ in range(20):
            spread = self.dbh_m.deviation(np.log(np.maximum(height, 0.1) / 10.0))
            wanted = np.log(dbh_m) - shift - 0.5 * spread * own - np.log(self.dbh_m.at_10_m)
            stretched = wanted / self.dbh_m.height_exponent + self._log_stretched(10.0)
            before = height
            height = BREAST_HEIGHT_M + (self.tallest_m - BREAST_HEIGHT_M) * expit(stretched)
            if np.all(np.abs(height - before) <= _SAME * height):
                break
        return np.asarray(height)


def own_normals(seed: int, plant_id: NDArray[np.unsignedinteger]) -> Floats:
    """(N, 4) standard normal numbers of trees, each of the seed and the tree's own id alone."""
    from scipy.special import ndtri  # slow to import

    key = np.uint64(seed & (2**64 - 1))
    with np.errstate(over="ignore"):
        ids = np.asarray(plant_id, dtype=np.uint64)[:, None]
        state = np.asarray((ids << np.uint64(3)) + np.arange(NUMBERS, dtype=np.uint64), dtype=np.uint64)
        bits = mixed((mixed(state + SPLIT_MIX_STEP) ^ mixed(key + SPLIT_MIX_STEP)) + SPLIT_MIX_STEP)
    uniform = (bits >> np.uint64(11)).astype(np.float64) * 2.0**-53 + 2.0**-54
    return np.asarray(ndtri(uniform))
