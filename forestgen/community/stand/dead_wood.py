"""Dead trees of a stand: how many a recipe asks for, and which, where and how they stand or lie.

The dead are trees of the stand: species, diameter and height of a living one drawn at random, of those of at least
`min_dbh_cm`, and a decay class by the shares of `decay`. Amounts are numbers, or volumes of the stems over bark, of
what the class has left (`core.dead_wood`). Trees are drawn until a volume is reached, then diameters and heights are
multiplied by one factor so that it is exact.

Standing dead trees and stumps have places as living stems have. A stem that lies has the best of up to 64 random places
and directions: it hits no stem that stands or lies, ends on the site where that has edges, and lies on straight ground.
Directions scatter about that of the wind, by a standard deviation of 60 degrees.

The manual page of the stand model has the sources of the published amounts, `_AMOUNTS`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from forestgen.community.arrivals import radii_m
from forestgen.community.population import Ecologies, Floats, Indices, Site
from forestgen.community.stand import spacing
from forestgen.community.stand.build import StandTrees
from forestgen.community.static_model import Placement
from forestgen.core.dead_wood import (
    CLASSES,
    DeadForm,
    are_lying,
    left_of,
    lying_volume_m3,
    standing_volume_m3,
    stump_height_m,
)
from forestgen.core.errors import RecipeError
from forestgen.recipe.fields import Fraction, NonNegative, Section, violation

_WHERE = "community.dead_wood"
_MOST_M3, _MOST_TREES = 3000.0, 1e4  # per hectare
_SLENDER, _LEAST_DBH_M = 80.0, 0.02  # height over diameter, and diameter, of a stem by which numbers are estimated
_FACTOR = (0.8, 1.25)  # on the diameters and heights of whole trees, for the volume asked for
_DRAWN_AT_ONCE = 1000
_TRIES, _AT_ONCE, _GOOD = 64, 8, 0.15  # places; the cost below which no more are tried
_WIND_DEG = 60.0
_STATION_M, _FEWEST, _CELL_M = 0.3, 9, 0.4
# What a place of a lying stem costs, by the share of the stem: across another one, off the site or where nothing may
# stand; and by metre that the ground is off a line.
_HIT, _OFF, _UNEVEN = 30.0, 20.0, 5.0

_AMOUNTS: dict[str, dict[str, float]] = {
    "managed_beech": {"standing_m3_per_ha": 3.6, "lying_m3_per_ha": 5.4, "stumps_per_ha": 150},
    "beech_reserve": {"standing_m3_per_ha": 33, "lying_m3_per_ha": 97, "stumps_per_ha": 0},
    "boreal_managed": {"standing_m3_per_ha": 3.2, "lying_m3_per_ha": 7.3, "stumps_per_ha": 200},
    "boreal_old_growth": {"standing_m3_per_ha": 33, "lying_m3_per_ha": 78, "stumps_per_ha": 0},
}


class DeadWood(Section):
    """Dead trees of a stand; what is not said is that of `type`, or none."""

    type: Literal["managed_beech", "beech_reserve", "boreal_managed", "boreal_old_growth"] | None = Field(
        None, description="Published amounts for a kind of forest; `dead_wood: beech_reserve` says the same."
    )
    standing_per_ha: NonNegative | None = Field(None, le=_MOST_TREES, description="Standing dead trees per hectare.")
    standing_m3_per_ha: NonNegative | None = Field(None, le=_MOST_M3, description="Or their stems' volume, m3/ha.")
    lying_per_ha: NonNegative | None = Field(None, le=_MOST_TREES, description="Lying trees per hectare.")
    lying_m3_per_ha: NonNegative | None = Field(None, le=_MOST_M3, description="Or their stems' volume, m3/ha.")
    stumps_per_ha: NonNegative | None = Field(None, le=_MOST_TREES, description="Stumps of felled trees per hectare.")
    snapped: Fraction = Field(0.4, description="Share of lying trees that snapped; the others are uprooted.")
    decay: Annotated[tuple[NonNegative, ...], Field(min_length=CLASSES, max_length=CLASSES)] = Field(
        (0.1, 0.25, 0.3, 0.25, 0.1), description="Share of trees in each of the decay classes 1 to 5."
    )
    min_dbh_cm: NonNegative = Field(10.0, le=100, description="Least diameter of the trees that the dead are drawn of.")

    @model_validator(mode="after")
    def _says_it_once(self) -> Self:
        for kind in ("standing", "lying"):
            number, volume = getattr(self, f"{kind}_per_ha"), getattr(self, f"{kind}_m3_per_ha")
            if number is not None and volume is not None:
                expected, got = f"{kind}_per_ha or {kind}_m3_per_ha", f"{number:g} trees and {volume:g} m3"
                raise violation(expected, problem="two amounts of the same", got=got, at=f"{kind}_m3_per_ha")
        if sum(self.decay) <= 0.0:
            raise violation("a share above 0", problem="no decay class", got="0 in all", at="decay")
        return self

    def amount(self, key: str) -> float:
        """A number or volume per hectare, of the recipe or of its type; a number said takes the place of a volume."""
        own = getattr(self, key)
        other = getattr(self, key.replace("_m3", "") if "_m3" in key else key.replace("_per", "_m3_per"), None)
        if own is not None:
            return float(own)
        return _AMOUNTS[self.type].get(key, 0.0) if self.type is not None and other is None else 0.0

    def most_trees(self, site: Site) -> float:
        """About how many dead trees there are at most."""
        numbers = sum(self.amount(f"{kind}_per_ha") for kind in ("standing", "lying", "stumps"))
        volume = sum(self.amount(f"{kind}_m3_per_ha") for kind in ("standing", "lying"))
        dbh_m = max(0.01 * self.min_dbh_cm, _LEAST_DBH_M)
        return site.area_ha * min(numbers + volume / (0.125 * np.pi * _SLENDER * dbh_m**3), 2.0 * _MOST_TREES)


@dataclass(frozen=True)
class DeadTrees:
    """Dead trees of a stand; heights are of what is left."""

    species: Indices  # (N,)
    position_m: Floats  # (N, 2)
    dbh_m: Floats  # (N,)
    height_m: Floats  # (N,)
    form: NDArray[np.uint8]  # (N,) `DeadForm`
    decay: NDArray[np.uint8]  # (N,) 1 to 5
    azimuth_deg: Floats  # (N,) where what lies points; NaN of others


def dead_trees(
    keys: DeadWood,
    trees: StandTrees,
    site: Site,
    opened: Floats,
    rng: np.random.Generator,
    *,
    periodic: bool,
) -> DeadTrees:
    """The dead of a stand of living trees. `opened`: (rows, cols) relative density, 0 where no tree may stand.

    Raises `RecipeError`: there are no trees that they could have been, or no room.
    """
    drawing, placing = rng.spawn(2)
    kinds = [_drawn(keys, trees, site, kind, own) for kind, own in zip(_KINDS, drawing.spawn(3), strict=True)]
    row, size, form, decay = (np.concatenate(one) for one in zip(*kinds, strict=True))
    dbh_m, whole_m = size * trees.dbh_m[row], size * trees.height_m[row]
    height_m = np.where(form == DeadForm.STUMP, stump_height_m(dbh_m), whole_m * left_of(form, decay))
    position_m, azimuth_deg = np.empty((len(row), 2)), np.full(len(row), np.nan)
    stand_rng, lie_rng = placing.spawn(2)
    lying = are_lying(form)
    position_m[~lying] = _standing_places(trees, dbh_m[~lying], site, opened, stand_rng, periodic=periodic)
    stems = np.concatenate([trees.position_m, position_m[~lying]]), np.concatenate([trees.dbh_m, dbh_m[~lying]])
    ground = _Ground(site, opened, *stems, periodic=periodic)
    for one, own in zip(np.flatnonzero(lying).tolist(), lie_rng.spawn(int(lying.sum())), strict=True):
        position_m[one], azimuth_deg[one] = ground.place(float(height_m[one]), float(dbh_m[one]), own)
    return DeadTrees(trees.species[row], position_m, dbh_m, height_m, form, decay, azimuth_deg)


_KINDS = ("standing", "lying", "stumps")
_Drawn = tuple[Indices, Floats, NDArray[np.uint8], NDArray[np.uint8]]


def _drawn(keys: DeadWood, trees: StandTrees, site: Site, kind: str, rng: np.random.Generator) -> _Drawn:
    """Rows of living trees, what their sizes are multiplied by, forms and classes, of the dead of a kind."""
    volume_m3 = 0.0 if kind == "stumps" else keys.amount(f"{kind}_m3_per_ha") * site.area_ha
    count = round(keys.amount(f"{kind}_per_ha") * site.area_ha)
    if not count and not volume_m3:
        none = np.zeros(0, dtype=np.uint8)
        return np.zeros(0, dtype=np.int64), np.zeros(0), none, none
    able = np.flatnonzero(trees.dbh_m >= 0.01 * keys.min_dbh_cm)
    if not len(able):
        got = f"{100 * trees.dbh_m.max():.3g} cm at most" if len(trees.dbh_m) else "no trees"
        expected, hint = f"trees of {keys.min_dbh_cm:g} cm, which the dead were", "a smaller min_dbh_cm"
        raise RecipeError("the stand has no such trees", where=_WHERE, expected=expected, got=got, hint=hint)
    chance, found = np.array(keys.decay) / sum(keys.decay), 0.0
    parts: list[tuple[NDArray[Any], ...]] = []
    while True:
        many = count or _DRAWN_AT_ONCE
        row = rng.choice(able, many)
        decay = (1 + rng.choice(CLASSES, many, p=chance)).astype(np.uint8)
        form = _forms(kind, rng.random(many) < keys.snapped)
        own_m3 = _volumes_m3(form, decay, trees.dbh_m[row], trees.height_m[row])
        if count:
            return row, np.ones(count), form, decay
        total = found + np.cumsum(own_m3)
        last = int(np.searchsorted(total, volume_m3))
        if last < many:  # with the last or without it, whichever is nearer
            before = float(total[last - 1]) if last else found
            last += int(total[last] - volume_m3 < volume_m3 - before or not (last or parts))
        parts.append(tuple(one[:last] for one in (row, form, decay)))
        found = float(total[-1])
        if found >= volume_m3:
            break
        if len(parts) * many > _MOST_TREES * site.area_ha + _DRAWN_AT_ONCE:
            expected, got = f"at most {_MOST_TREES:,.0f} dead trees/ha", f"trees from {keys.min_dbh_cm:g} cm on"
            problem, hint = "too many dead trees for this volume", "a larger min_dbh_cm, or less volume"
            raise RecipeError(problem, where=_WHERE, expected=expected, got=got, hint=hint)
    row, form, decay = (np.concatenate(one) for one in zip(*parts, strict=True))
    factor = _factor(trees, row, form, decay, volume_m3)
    if len(row) == 1 and factor < _FACTOR[0]:  # a part of a tree: a whole one on so many of the stands
        some = slice(0, int(rng.random() < factor**3))
        return row[some], np.ones(len(row[some])), form[some], decay[some]
    return row, np.full(len(row), np.clip(factor, *_FACTOR)), form, decay


def _forms(kind: str, snapped: NDArray[np.bool_]) -> NDArray[np.uint8]:
    if kind == "lying":
        return np.where(snapped, np.uint8(DeadForm.SNAPPED), np.uint8(DeadForm.UPROOTED))
    return np.full(len(snapped), DeadForm.STANDING if kind == "standing" else DeadForm.STUMP, dtype=np.uint8)


def _volumes_m3(form: NDArray[np.uint8], decay: NDArray[np.uint8], dbh_m: Floats, whole_m: Floats) -> Floats:
    height_m = whole_m * left_of(form, decay)
    return lying_volume_m3(form, decay, height_m, dbh_m) + np.where(
        form == DeadForm.STANDING, standing_volume_m3(form, decay, height_m, dbh_m), 0.0
    )


def _factor(
    trees: StandTrees, row: Indices, form: NDArray[np.uint8], decay: NDArray[np.uint8], volume_m3: float
) -> float:
    """By which diameters and heights are multiplied to have a volume in sum."""
    factor = 1.0
    for _ in range(20):  # volumes go nearly with the third power
        made = float(_volumes_m3(form, decay, factor * trees.dbh_m[row], factor * trees.height_m[row]).sum())
        factor *= (volume_m3 / made) ** (1.0 / 3.0)
    return factor


def _standing_places(
    trees: StandTrees, dbh_m: Floats, site: Site, opened: Floats, rng: np.random.Generator, *, periodic: bool
) -> Floats:
    """(N, 2) places among living stems."""
    living, count = len(trees.dbh_m), len(trees.dbh_m) + len(dbh_m)
    if not len(dbh_m):
        return np.zeros((0, 2))
    widest = 2.0 * float(max(trees.dbh_m.max(), dbh_m.max()))
    grid = spacing.empty_grid(count, widest, site.size_m, periodic=periodic)
    spacing.insert(grid, trees.position_m, trees.dbh_m)
    order = np.argsort(-dbh_m, kind="stable")
    ground = opened, np.zeros(opened.shape)
    placed = spacing.place_storey(grid, living, dbh_m[order], np.ones(len(dbh_m)), 1.0, ground, rng)
    if placed < len(dbh_m):
        expected, got = f"at most about {placed / site.area_ha:,.0f} per hectare", f"{len(dbh_m) / site.area_ha:,.0f}"
        raise RecipeError("so many dead trees and stumps have no room", where=_WHERE, expected=expected, got=got)
    position_m = np.empty((len(dbh_m), 2))
    position_m[order] = np.stack([grid.x, grid.y], axis=1)[living:]
    return position_m


class _Ground:
    """What a stem that falls may meet."""

    def __init__(self, site: Site, opened: Floats, position_m: Floats, dbh_m: Floats, *, periodic: bool) -> None:
        from scipy.spatial import cKDTree  # slow to import

        self._site, self._opened, self._periodic, self._dbh_m = site, opened, periodic, dbh_m
        self._size = np.array(site.size_m)
        box = self._size if periodic else None
        self._stems = cKDTree(position_m % self._size if periodic else position_m, boxsize=box)
        cells = np.maximum(1, np.ceil(self._size / _CELL_M)).astype(np.int64)
        self._taken = np.zeros(cells, dtype=np.bool_)  # by what lies already

    def place(self, length_m: float, dbh_m: float, rng: np.random.Generator) -> tuple[Floats, float]:
        """Foot and direction, degrees clockwise from north, of a stem; its own ground is taken then."""
        least, found = np.inf, None
        for _ in range(_TRIES // _AT_ONCE):
            foot = rng.random((_AT_ONCE, 2)) * self._size
            azimuth = (self._site.wind_from_deg + 180.0 + _WIND_DEG * rng.normal(size=_AT_ONCE)) % 360.0
            cost, cell = self._costs(foot, np.radians(azimuth), length_m, dbh_m)
            best = int(np.argmin(cost))
            if cost[best] < least:
                least, found = float(cost[best]), (foot[best], float(azimuth[best]), cell[best])
            if least < _GOOD:
                break
        assert found is not None  # costs are finite
        self._taken[found[2][:, 0], found[2][:, 1]] = True
        return found[0], found[1]

    def _costs(self, foot: Floats, angle: Floats, length_m: float, dbh_m: float) -> tuple[Floats, Indices]:
        """(T,) cost of each place, and (T, K, 2) the cells that a stem would take there."""
        way = np.stack([np.sin(angle), np.cos(angle)], axis=1)
        at = np.linspace(0.0, length_m, max(_FEWEST, math.ceil(length_m / _STATION_M)))
        points = foot[:, None] + at[:, None] * way[:, None]
        inside = np.all((points >= 0.0) & (points < self._size), axis=2)
        on_site = points % self._size if self._periodic else np.clip(points, 0.0, self._size * (1.0 - 1e-9))
        apart, nearest = self._stems.query(on_site)
        cell = np.minimum((on_site / _CELL_M).astype(np.int64), np.array(self._taken.shape) - 1)
        hit = (apart < 0.5 * (dbh_m + self._dbh_m[nearest])) | self._taken[cell[..., 0], cell[..., 1]]
        shape = np.array(self._opened.shape)[::-1]
        at_map = np.minimum((on_site / self._size * shape).astype(np.int64), shape - 1)
        off = self._opened[at_map[..., 1], at_map[..., 0]] <= 0.0
        if not self._periodic:
            off |= ~inside
        cost = _HIT * hit.mean(axis=1) + _OFF * off.mean(axis=1) + _UNEVEN * self._unevenness_m(points)
        return np.asarray(cost + 100.0 * off[:, 0]), cell  # a foot stands where trees may

    def _unevenness_m(self, points: Floats) -> Floats:
        """(T,) how far the ground is off a straight line at most, of (T, K, 2) points along lines."""
        if self._site.height is None:
            return np.zeros(len(points))
        ground = self._site.height(points[..., 0], points[..., 1])
        share = np.linspace(-1.0, 1.0, points.shape[1])
        slope = (ground @ share) / (share @ share)
        off = ground - ground.mean(axis=1, keepdims=True) - slope[:, None] * share
        return np.asarray(np.abs(off).max(axis=1))


def with_dead(living: Placement, dead: DeadTrees, species: Ecologies) -> Placement:
    """The plants of a stand, and its dead after them."""
    n, more = len(living.species), len(dead.species)
    assert living.height_m is not None
    assert living.age_yr is not None
    unknown = np.full(more, np.nan)
    known = {"dbh_m": dead.dbh_m}
    sizes = {name: np.append(values, known.get(name, unknown)) for name, values in living.tree_sizes.items()}
    return replace(
        living,
        species=np.concatenate([living.species, dead.species]),
        position_m=np.concatenate([living.position_m, dead.position_m]),
        radius_m=np.concatenate([living.radius_m, radii_m(species, dead.species, dead.height_m)]),
        height_m=np.concatenate([living.height_m, dead.height_m]),
        tree_sizes=sizes,
        age_yr=np.concatenate([living.age_yr, np.zeros(more)]),
        azimuth_deg=np.concatenate([np.full(n, np.nan), dead.azimuth_deg]),
        dead=np.arange(n + more) >= n,
        dead_form=np.concatenate([np.zeros(n, dtype=np.uint8), dead.form]),
        decay_class=np.concatenate([np.zeros(n, dtype=np.uint8), dead.decay]),
    )


def dead_report(dead: DeadTrees, site: Site) -> dict[str, Any]:
    """What a stand has of dead wood, with the names of a recipe's keys."""
    standing, stumps = dead.form == DeadForm.STANDING, dead.form == DeadForm.STUMP
    of = dead.form, dead.decay, dead.height_m, dead.dbh_m
    area = site.area_ha
    return {
        "standing_per_ha": int(standing.sum()) / area,
        "standing_m3_per_ha": float(standing_volume_m3(*of)[standing].sum()) / area,
        "lying_per_ha": int(are_lying(dead.form).sum()) / area,
        "lying_m3_per_ha": float(lying_volume_m3(*of).sum()) / area,
        "stumps_per_ha": int(stumps.sum()) / area,
    }
