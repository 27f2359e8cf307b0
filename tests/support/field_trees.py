"""Measured trees, and the allometries of their sizes.

`tests/unit/plants/data/baad_trees.csv` has 3,453 trees of 20 genera from BAAD (Falster et al. 2015, Ecology 96:1445,
doi:10.1890/14-1889.1; CC0), compiled from its sources. Crown width is 2 sqrt(area / pi) where only the area was
measured. `beech_trees.csv` beside it has heights, diameters, ages and stem mass of 187 European beeches of nine
studies, as Wutzler, Wirth and Schumacher compiled them (2008, Canadian Journal of Forest Research 38, 1661-1675; of the
R package twNlme, github.com/bgctw/twNlme).

Allometries
-----------
Of a tree of height H metres, with D the diameter at breast height in metres::

    D = d (h(H) / h(10))^p e^(s x)      h(H) = (H - 1.3) / (T - H)
    W, M, C / (1 - C) = v (H / 10)^p (D / D(H))^q e^(s x)     D(H): the median diameter at this height

for crown width W in metres, dry leaf mass M in kg and crown length C as a share of H; T is the height of the tallest
trees. Each x is a standard normal
number of the tree's own. The spread s is linear in the logarithm of H. The fit is by least absolute deviations, since
an allometry gives the median.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from forestgen.api.plant_requests import drawn_of
from forestgen.core.frames import BREAST_HEIGHT_M
from forestgen.recipe.tree_sizes import TreeSizes

Floats = NDArray[np.float64]

_DATA = Path(__file__).parents[1] / "unit" / "plants" / "data"
FILES = (_DATA / "baad_trees.csv", _DATA / "beech_trees.csv")
IN_STANDS = ("FW", "PM", "PU")  # growing conditions: natural forests and plantations
CLASSES_M = (5.0, 10.0, 15.0, 20.0, 25.0, 30.0)  # of height
_SHORTEST_M = 3.0  # tree that a allometry is fitted to
_ROUNDS = 100  # of least absolute deviations
_NARROW = (0.02, 0.98)  # crown ratios
MEASURES = {"width": "crown_width_m", "leaves": "leaf_mass_kg", "crown": "crown_ratio"}
COLUMNS = {"dbh": "dbh_m", **MEASURES}
DRAWS = 200  # trees drawn for each measured one

#: Measured relatives of the shipped trees.
RELATIVES: Mapping[str, Sequence[str]] = {
    "spruce": ("Picea abies",),
    "pine": ("Pinus sylvestris",),
    "birch": ("Betula papyrifera", "Betula pendula", "Betula platyphylla", "Betula ermanii"),
    "beech": ("Fagus sylvatica", "Fagus crenata"),
    "oak": ("Quercus serrata", "Quercus crispula"),
    "maple": ("Acer mono",),
    "poplar": ("Populus tremuloides",),
    "larch": ("Larix kaempferi",),
    "meranti": ("Shorea stenoptera",),
    "cypress": ("Chamaecyparis obtusa",),
    "eucalyptus": ("Eucalyptus saligna", "Eucalyptus muellerana", "Eucalyptus regnans"),
}


def field_trees(species: Sequence[str] | None = None) -> pd.DataFrame:
    """Trees of stands of at least 2 m whose diameter is known; `species`: Latin names, None: all."""
    trees = pd.concat([pd.read_csv(file) for file in FILES], ignore_index=True)
    chosen = trees.condition.isin(IN_STANDS) & (trees.height_m >= 2.0) & (trees.dbh_m > 0.0)
    if species is not None:
        chosen &= trees.species.isin(species)
    trees = trees[chosen].reset_index(drop=True)
    base_m = trees.crown_base_m.where((trees.crown_base_m > 0) & (trees.crown_base_m < trees.height_m))
    return trees.assign(crown_ratio=(1.0 - base_m / trees.height_m).clip(*_NARROW))


def _stretched(height_m: Floats, tallest_m: float) -> Floats:
    """Height of which the logarithm is linear in that of the diameter; 10 m stay 10 m."""
    of = (height_m - BREAST_HEIGHT_M) / (tallest_m - height_m)
    return np.asarray(10.0 * of * (tallest_m - 10.0) / (10.0 - BREAST_HEIGHT_M))


@dataclass(frozen=True)
class Allometry:
    """Median and spread of a size over height and relative_dbh, in the logarithm (of the odds, for the crown ratio)."""

    at_10_m: float  # logarithm
    exponent: float  # of the height
    relative_dbh: float  # exponent of the diameter over its median at this height
    spread: tuple[float, float]  # standard deviation at 10 m, and its change for each e-fold of height
    trees: int

    def median(self, height_m: Floats, log_relative_dbh: Floats | float = 0.0) -> Floats:
        return np.asarray(self.at_10_m + self.exponent * np.log(height_m / 10.0) + self.relative_dbh * log_relative_dbh)

    def deviation(self, height_m: Floats) -> Floats:
        return np.asarray(np.clip(self.spread[0] + self.spread[1] * np.log(height_m / 10.0), 0.05, 1.2))


@dataclass(frozen=True)
class Allometries:
    """A species' allometries; those of what too few trees were measured for are missing."""

    dbh: Allometry
    tallest_m: float
    others: Mapping[str, Allometry]

    def draw(self, height_m: Floats, rng: np.random.Generator) -> dict[str, Floats]:
        """Sizes of a tree of each height: ``dbh`` in metres, and those of `MEASURES` that are known."""
        relative = self.dbh.deviation(height_m) * rng.normal(size=height_m.shape)
        sizes = {"dbh": np.exp(self.dbh.median(_stretched(height_m, self.tallest_m)) + relative)}
        for name, allometry in self.others.items():
            value = allometry.median(height_m, relative) + allometry.deviation(height_m) * rng.normal(
                size=height_m.shape
            )
            sizes[name] = 1.0 / (1.0 + np.exp(-value)) if name == "crown" else np.exp(value)
        return sizes


def sizes_of(name: str) -> TreeSizes:
    """The tree sizes of a shipped species."""
    tree = drawn_of(name, 0).species[name].tree
    assert tree is not None
    return tree


def fitted(trees: pd.DataFrame, tallest_m: float, fewest: int = 8) -> Allometries:
    """Allometries of `field_trees`; of a size that fewer than `fewest` trees have there is none."""
    trees = trees[(trees.height_m >= _SHORTEST_M) & (trees.height_m < 0.95 * tallest_m)]
    height = trees.height_m.to_numpy()
    stretched = _stretched(height, tallest_m)
    dbh = _allometry(stretched, np.log(trees.dbh_m.to_numpy()), spread_over_m=height)
    relative = np.log(trees.dbh_m.to_numpy()) - dbh.median(stretched)
    others = {}
    for name, column in MEASURES.items():
        value = trees[column].to_numpy()
        known = value > 0.0
        if known.sum() >= fewest:
            share = value[known]
            logarithm = np.log(share / (1.0 - share)) if name == "crown" else np.log(share)
            others[name] = _allometry(height[known], logarithm, relative[known])
    return Allometries(dbh, tallest_m, others)


def left_out(trees: pd.DataFrame, name: str, tallest_m: float, rng: np.random.Generator) -> dict[str, float]:
    """Drawn over measured median of each study, over trees of all heights, by allometries fitted to the others."""
    ratios = {}
    for study in sorted(trees.study.unique()):
        own = trees[(trees.study == study) & (trees.height_m >= CLASSES_M[0]) & (trees[COLUMNS[name]] > 0.0)]
        others = trees[trees.study != study]
        if len(own) < 5 or (others[COLUMNS[name]] > 0.0).sum() < 8:
            continue
        allometries = fitted(others, tallest_m)
        if name == "dbh" or name in allometries.others:
            drawn = allometries.draw(np.repeat(own.height_m.to_numpy(), DRAWS), rng)[name]
            ratios[study] = float(np.median(drawn) / np.median(own[COLUMNS[name]]))
    return ratios


def _allometry(
    height_m: Floats, value: Floats, relative: Floats | None = None, spread_over_m: Floats | None = None
) -> Allometry:
    columns = [np.ones_like(height_m), np.log(height_m / 10.0), *([] if relative is None else [relative])]
    terms = np.stack(columns, axis=1)
    found = np.linalg.lstsq(terms, value, rcond=None)[0]
    for _ in range(_ROUNDS):
        weight = 1.0 / np.sqrt(np.maximum(np.abs(value - terms @ found), 2e-3))
        found = np.linalg.lstsq(terms * weight[:, None], value * weight, rcond=None)[0]
    # The mean of |x| of a normal number is sqrt(2 / pi) of its standard deviation.
    away = np.sqrt(np.pi / 2.0) * np.abs(value - terms @ found)
    over = terms[:, 1] if spread_over_m is None else np.log(spread_over_m / 10.0)
    spread = np.linalg.lstsq(np.stack([np.ones_like(over), over], axis=1), away, rcond=None)[0]
    at_10_m, exponent, *others = (float(one) for one in found)
    return Allometry(at_10_m, exponent, sum(others), (float(spread[0]), float(spread[1])), len(value))


def classes(trees: pd.DataFrame, fewest: int = 5) -> list[tuple[float, float, pd.DataFrame]]:
    """Classes of height, lower and upper end in metres, that have at least `fewest` trees."""
    pairs = pairwise(CLASSES_M)
    found = [(low, high, trees[(trees.height_m >= low) & (trees.height_m < high)]) for low, high in pairs]
    return [one for one in found if len(one[2]) >= fewest]


def spread_of_median(values: Floats, rng: np.random.Generator, draws: int = 400) -> float:
    """Standard error of the logarithm of a sample's median, by bootstrap."""
    chosen = rng.choice(values, (draws, len(values)))
    return float(np.std(np.log(np.median(chosen, axis=1))))
