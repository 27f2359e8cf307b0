"""The trees of a stand: their places, species and sizes, so that the targets of a recipe are met."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from forestgen.community.population import Ecologies, Floats, Indices, Site, SpeciesEcology
from forestgen.community.stand import cover, spacing
from forestgen.community.stand.targets import (
    THICKEST_PER_HA,
    Storey,
    diameters_m,
    laws_of,
    species_of,
    stocking,
)
from forestgen.community.tree_columns import COLUMNS, HIGHEST_BASE, competition_shifts
from forestgen.core.errors import RecipeError
from forestgen.core.frames import BREAST_HEIGHT_M
from forestgen.recipe.tree_sizes import NUMBERS, TOP, Sizes

MOST_DEVIATIONS = 3.0  # by which the trees of a stand may differ from their species' allometry in the mean
MOST_LEAVES = 18.0  # leaf area index: the highest of 1,008 published ones (Asner et al. 2003, Glob. Ecol. Biogeogr. 12)
_LEAST_HEIGHT_M = 1.4
_MOST_MEASURED = 10_000  # trees whose nearest one is looked for
_TALLER = 1.05  # a lower storey over the one above it


@dataclass(frozen=True)
class StandTrees:
    """Living trees, storey by storey."""

    storey: Indices  # (N,)
    species: Indices  # (N,)
    position_m: Floats  # (N, 2)
    dbh_m: Floats
    height_m: Floats
    crown_radius_m: Floats
    crown_base_m: Floats
    leaf_area_m2: Floats
    canopy_cover: float  # share of the site's ground under crowns as discs

    @property
    def columns(self) -> dict[str, Floats]:
        """(N,) each of `tree_columns.COLUMNS`."""
        return {name: getattr(self, name) for name in COLUMNS}


def by_species(
    species: Ecologies,
    sp: Indices,
    height_m: Floats,
    normals: Floats,
    dbh_m: Floats | None = None,
) -> Sizes:
    """Sizes of trees by their species' allometry; `dbh_m`: those that are known."""
    made = Sizes(*(np.full(len(sp), np.nan) for _ in range(4)))
    for index in np.unique(sp).tolist():
        mine = sp == index
        known = None if dbh_m is None else dbh_m[mine]
        one = laws_of(species, species[index].name).sizes(height_m[mine], normals[mine], 0.0, known)
        for name, values in vars(made).items():
            values[mine] = getattr(one, name)
    return made


def heights_of(species: Ecologies, sp: Indices, dbh_m: Floats, normals: Floats, shift: Floats) -> Floats:
    """(N,) heights of trees of known diameters."""
    height = np.empty(len(sp))
    for index in np.unique(sp).tolist():
        mine = sp == index
        law = laws_of(species, species[index].name)
        height[mine] = law.height_of(dbh_m[mine], normals[mine], shift[mine])
    return np.maximum(height, _LEAST_HEIGHT_M)


def deviation_of(species: Ecologies, sp: Indices, height_m: Floats, size: str, weight: Floats) -> float:
    """Mean standard deviation of the logarithm of a size, of trees that count by a weight."""
    value = np.zeros(len(sp))
    for index in np.unique(sp).tolist():
        mine = sp == index
        law = laws_of(species, species[index].name)
        if size == "height_m":
            value[mine] = law.height_deviation(height_m[mine])
        else:
            value[mine] = getattr(law, size).deviation(np.log(height_m[mine] / 10.0))
    return float(np.average(value, weights=weight))


def leaf_areas_m2(species: Sequence[SpeciesEcology], sp: Indices, leaf_kg: Floats) -> Floats:
    """(N,) leaf area of trees of a mass of leaves."""
    return np.asarray(leaf_kg / np.array([one.leaf_mass_per_area_kg_per_m2 for one in species])[sp])


def thickest(dbh_m: Floats, site: Site) -> Indices:
    """Indices of the trees of a storey whose mean height is its dominant height: the thickest first."""
    return np.argsort(-dbh_m, kind="stable")[: max(1, round(THICKEST_PER_HA * site.area_ha))]


def level_factors(storey: Storey, species: Ecologies, dbh_m: Floats, shift: Floats) -> Floats:
    """Factor for each of `species` of heights above 1.3 m, with which those of a storey are equally tall.

    They are so at the diameters of the storey's thickest trees, `dbh_m`, of which `shift` is what competition makes.
    The common height is the mean of the species' heights by their shares. A species that ends below it stays below it.
    """
    index = {one.name: i for i, one in enumerate(species)}
    none = np.zeros((len(dbh_m), NUMBERS))
    laws = {name: laws_of(species, name) for name in storey.species}
    own = {name: float(law.height_of(dbh_m, none, shift).mean()) - BREAST_HEIGHT_M for name, law in laws.items()}
    common = sum(share * own[name] for name, share in storey.species.items()) / sum(storey.species.values())
    top = storey.top_height_m
    taller = 1.0 if top is None else (top - BREAST_HEIGHT_M) / common  # as the whole storey becomes
    factors = np.ones(len(species))
    for name, law in laws.items():
        end = (TOP * law.tallest_m - BREAST_HEIGHT_M) / taller
        factors[index[name]] = min(common, max(end, own[name])) / own[name]
    return factors


class StandBuilder:
    """Makes the trees of a stand; `storeys` from the top down."""

    def __init__(
        self,
        storeys: Sequence[Storey],
        site: Site,
        species: Ecologies,
        rng: np.random.Generator,
        *,
        periodic: bool,
    ) -> None:
        self._storeys, self._site, self._species, self._periodic = storeys, site, species, periodic
        self._rngs = rng.spawn(len(storeys))

    def trees(
        self, opened: Floats, gap: Floats, canopy_cover: float | None, leaf_area_index: float | None
    ) -> StandTrees:
        """The trees. `opened`: (rows, cols) relative density of all trees, at most 1; `gap`: 1 without an upper storey.

        Raises `RecipeError` for targets that contradict each other.
        """
        dbh, sp, normals = self._stems()
        position_m = self._places(dbh, sp, normals, opened, gap)
        storey = np.repeat(np.arange(len(dbh)), [len(one) for one in dbh])
        dbh_m, own = (np.concatenate(one) for one in (dbh, normals))
        sp_all = np.concatenate(sp)
        first = self._heights(sp_all, dbh_m, own, np.zeros(len(sp_all)), storey)
        laws = [one.tree for one in self._species]
        shift = competition_shifts(position_m, sp_all, first, laws, self._site, periodic=self._periodic)
        dbh_m = self._with_neighbours(dbh_m, shift, storey)
        self._check_heights(heights_of(self._species, sp_all, dbh_m, own, shift), sp_all, dbh_m, storey)
        height_m = self._heights(sp_all, dbh_m, own, shift, storey)
        self._check_order(height_m, dbh_m, storey)
        made = by_species(self._species, sp_all, height_m, own, dbh_m)
        factor, covered = self._crowns(position_m, 0.5 * made.crown_width_m, sp_all, height_m, canopy_cover)
        leaf_m2 = self._leaves(leaf_areas_m2(self._species, sp_all, made.leaf_kg), sp_all, height_m, leaf_area_index)
        base_m = np.minimum(made.crown_base_m, HIGHEST_BASE * height_m)
        radius_m = 0.5 * factor * made.crown_width_m
        return StandTrees(storey, sp_all, position_m, dbh_m, height_m, radius_m, base_m, leaf_m2, covered)

    def _stems(self) -> tuple[list[Floats], list[Indices], list[Floats]]:
        """Diameters, species and own numbers of the trees of each storey."""
        dbh, sp, normals = [], [], []
        for index, (storey, rng) in enumerate(zip(self._storeys, self._rngs, strict=True)):
            found = stocking(storey, self._species, f"community.storeys.{index}")
            dbh.append(diameters_m(storey, found, self._site.area_ha, rng))
            sp.append(species_of(storey, dbh[-1], self._species, rng))
            normals.append(rng.standard_normal((len(dbh[-1]), NUMBERS)))
        return dbh, sp, normals

    def _places(
        self, dbh: list[Floats], sp: list[Indices], normals: list[Floats], opened: Floats, gap: Floats
    ) -> Floats:
        """(N, 2) places of all trees; lower storeys know where the crowns of the upper ones are."""
        tolerance = np.array([one.shade_tolerance for one in self._species])
        stoutest = np.array([1.0 if one.tree is None else one.tree.open_grown for one in self._species])
        dbh = [  # as they may become, see `_with_neighbours`
            one * stoutest[kinds] if storey.by_height else one
            for one, kinds, storey in zip(dbh, sp, self._storeys, strict=True)
        ]
        area_m2 = self._site.area_m2
        widest = [
            max(2 * float(one.max()), float(spacing.own_distance_m(one, area_m2, storey.clark_evans).max()))
            for one, storey in zip(dbh, self._storeys, strict=True)
            if len(one)
        ]
        count = sum(map(len, dbh))
        grid = spacing.empty_grid(count, max(widest, default=1.0), self._site.size_m, periodic=self._periodic)
        shaded, first = np.zeros((1, 1)), 0
        for index, (storey, rng) in enumerate(zip(self._storeys, self._rngs, strict=True)):
            here = opened if index else opened * (1.0 - gap)
            if shaded.shape != here.shape:
                shaded = np.zeros(here.shape)
            chance = np.maximum(tolerance[sp[index]], 0.05)
            placed = spacing.place_storey(grid, first, dbh[index], chance, storey.clark_evans, (here, shaded), rng)
            if placed < len(dbh[index]):
                raise self._no_room(index, placed, len(dbh[index]))
            last = first + placed
            if placed and index + 1 < len(self._storeys):
                shaded = np.maximum(
                    shaded, self._shade(grid, slice(first, last), sp[index], normals[index], index, here.shape)
                )
            first = last
        return np.stack([grid.x, grid.y], axis=1)

    def _shade(
        self, grid: spacing.StemGrid, rows: slice, sp: Indices, normals: Floats, index: int, shape: tuple[int, ...]
    ) -> Floats:
        """1 in the cells below the crowns of the storey `index`, which has just been placed."""
        height_m = self._heights(sp, grid.dbh[rows], normals, np.zeros(len(sp)), np.full(len(sp), index))
        width_m = by_species(self._species, sp, height_m, normals, grid.dbh[rows]).crown_width_m
        position_m = np.stack([grid.x[rows], grid.y[rows]], axis=1)
        below = cover.crown_ratios(position_m, 0.5 * width_m, self._site, 1.0, periodic=self._periodic) <= 1.0
        row, col = (((np.arange(n) + 0.5) * m / n).astype(int) for n, m in zip(shape, below.shape, strict=True))
        return below[np.ix_(row, col)].astype(np.float64)

    def _no_room(self, index: int, placed: int, asked: int) -> RecipeError:
        area_ha = self._site.area_ha
        problem = "so many stems have no room"
        expected = f"at most about {placed / area_ha:,.0f} stems/ha of these diameters, where trees may stand"
        hint = "thinner or fewer trees, fewer gaps, or a map that leaves more ground"
        got = f"{asked / area_ha:,.0f} stems/ha"
        return RecipeError(problem, where=f"community.storeys.{index}", expected=expected, got=got, hint=hint)

    def _heights(self, sp: Indices, dbh_m: Floats, normals: Floats, shift: Floats, storey: Indices) -> Floats:
        """Heights of which each storey's thickest trees have its dominant height, and its species the same."""
        height_m = heights_of(self._species, sp, dbh_m, normals, shift)
        for index, one in enumerate(self._storeys):
            rows, top = np.flatnonzero(storey == index), one.top_height_m
            if not len(rows):
                continue
            thick = thickest(dbh_m[rows], self._site)
            above_m = height_m[rows] - BREAST_HEIGHT_M
            if len(one.species) > 1:
                tall = rows[thick]
                above_m *= level_factors(one, self._species, dbh_m[tall], shift[tall])[sp[rows]]
            if top is not None:
                above_m *= (top - BREAST_HEIGHT_M) / float(above_m[thick].mean())
            height_m[rows] = BREAST_HEIGHT_M + above_m
        return np.maximum(height_m, _LEAST_HEIGHT_M)

    def _check_heights(self, height_m: Floats, sp: Indices, dbh_m: Floats, storey: Indices) -> None:
        """Raise `RecipeError` for dominant heights that are too far from those by allometry, `height_m`."""
        for index, one in enumerate(self._storeys):
            rows, top = np.flatnonzero(storey == index), one.top_height_m
            if top is None or not len(rows):
                continue
            tall = rows[thickest(dbh_m[rows], self._site)]
            mean = float(height_m[tall].mean())
            factor = (top - BREAST_HEIGHT_M) / (mean - BREAST_HEIGHT_M)
            deviation = deviation_of(self._species, sp[tall], height_m[tall], "height_m", np.ones(len(tall)))
            most = math.exp(MOST_DEVIATIONS * deviation)
            if 1.0 / most <= factor <= most:
                continue
            low, high = (BREAST_HEIGHT_M + f * (mean - BREAST_HEIGHT_M) for f in (1.0 / most, most))
            problem = "the dominant height and the diameters contradict each other"
            expected = f"{low:.3g} to {high:.3g} m: the thickest trees have {100 * dbh_m[tall].mean():.3g} cm at 1.3 m"
            hint = f"other stems_per_ha, basal_area_m2_per_ha or dbh; these diameters have {mean:.3g} m by allometry"
            where = f"community.storeys.{index}"
            raise RecipeError(problem, where=where, expected=expected, got=f"{top:.3g} m", hint=hint)

    def _with_neighbours(self, dbh_m: Floats, shift: Floats, storey: Indices) -> Floats:
        """Diameters that are by heights follow the neighbours too; a storey's basal area stays."""
        dbh_m = dbh_m.copy()
        for index, one in enumerate(self._storeys):
            mine = storey == index
            if one.by_height and mine.any():
                before = float(np.sum(dbh_m[mine] ** 2))
                dbh_m[mine] *= np.exp(shift[mine])
                if one.basal_area_m2_per_ha is not None:
                    dbh_m[mine] *= math.sqrt(before / float(np.sum(dbh_m[mine] ** 2)))
        return dbh_m

    def _check_order(self, height_m: Floats, dbh_m: Floats, storey: Indices) -> None:
        above = math.inf
        for index in range(len(self._storeys)):
            rows, where = np.flatnonzero(storey == index), f"community.storeys.{index}"
            if not len(rows):
                continue
            top = float(height_m[rows[thickest(dbh_m[rows], self._site)]].mean())
            if top > _TALLER * above:
                problem, expected = "this storey is taller than the one above it", f"at most {above:.3g} m; or first"
                raise RecipeError(problem, where=where, expected=expected, got=f"a dominant height of {top:.3g} m")
            above = top

    def _crowns(
        self, position_m: Floats, radius_m: Floats, sp: Indices, height_m: Floats, target: float | None
    ) -> tuple[float, float]:
        """A factor of all crown radii so that they cover what is asked for, and what they cover."""
        if target is None or not len(radius_m):
            ratio = cover.crown_ratios(position_m, radius_m, self._site, 1.0, periodic=self._periodic)
            return 1.0, cover.cover_at(ratio, 1.0)
        most = math.exp(MOST_DEVIATIONS * deviation_of(self._species, sp, height_m, "crown_width_m", radius_m**2))
        ratio = cover.crown_ratios(position_m, radius_m, self._site, most, periodic=self._periodic)
        factor = cover.width_for(ratio, target)
        if 1.0 / most <= factor <= most:
            return factor, cover.cover_at(ratio, factor)
        low, usual, high = (cover.cover_at(ratio, k) for k in (1.0 / most, 1.0, most))
        problem = "canopy_cover contradicts the trees"
        expected = f"{low:.3g} to {high:.3g}: the crowns of these trees cover {usual:.3g} by their allometry"
        stems, covered = len(sp) / self._site.area_ha, min(max(usual, 1e-9), 0.999)
        fits = stems * math.log1p(-target) / math.log1p(-covered)  # where crowns lie at random
        hint = f"about {max(fits, 1):,.0f} stems/ha of these sizes instead of {stems:,.0f}; or other gaps"
        raise RecipeError(problem, where="community.canopy_cover", expected=expected, got=f"{target:g}", hint=hint)

    def _leaves(self, leaf_m2: Floats, sp: Indices, height_m: Floats, target: float | None) -> Floats:
        """(N,) leaf areas of which there are as many over the ground as is asked for."""
        if target is None or not len(leaf_m2):
            return leaf_m2
        usual = float(leaf_m2.sum()) / self._site.area_m2
        most = math.exp(MOST_DEVIATIONS * deviation_of(self._species, sp, height_m, "leaf_kg", leaf_m2))
        if 1.0 / most <= target / usual <= most:
            return leaf_m2 * (target / usual)
        problem = "leaf_area_index contradicts the trees"
        low, high = usual / most, min(usual * most, MOST_LEAVES)
        expected = f"{low:.3g} to {high:.3g}: these trees have {usual:.3g} by their allometry"
        if low > high:
            expected = f"fewer or smaller trees: these have at least {low:.3g}, and no forest more than {high:g}"
        stems = len(sp) / self._site.area_ha
        hint = f"about {max(stems * target / usual, 1):,.0f} stems/ha of these sizes instead of {stems:,.0f}"
        raise RecipeError(problem, where="community.leaf_area_index", expected=expected, got=f"{target:g}", hint=hint)


def nearest_index(position_m: Floats, site: Site, *, periodic: bool) -> float | None:
    """Clark and Evans' index of places, with Donnelly's correction (1978) on a site with edges; None below 2."""
    from scipy.spatial import cKDTree  # slow to import

    n = len(position_m)
    if n < 2:
        return None
    box = np.array(site.size_m)
    position_m = position_m % box if periodic else position_m
    tree = cKDTree(position_m, boxsize=box if periodic else None)
    mean = float(np.mean(np.asarray(tree.query(position_m[:: max(1, n // _MOST_MEASURED)], k=2)[0])[:, 1]))
    expected = 0.5 * math.sqrt(site.area_m2 / n)
    if not periodic:
        expected += (0.0514 + 0.041 / math.sqrt(n)) * 2.0 * float(box.sum()) / n
    return mean / expected


def measured(trees: StandTrees, storeys: int, site: Site, species: Ecologies, *, periodic: bool) -> dict[str, Any]:
    """What a stand is, plain as in JSON, with the names of a recipe's targets."""
    each: list[dict[str, Any]] = []
    for index in range(storeys):
        rows = np.flatnonzero(trees.storey == index)
        if not len(rows):
            each.append({"stems_per_ha": 0.0})
            continue
        area = 0.25 * math.pi * trees.dbh_m[rows] ** 2
        shares = np.bincount(trees.species[rows], area, len(species)) / area.sum()
        each.append(
            {
                "stems_per_ha": len(rows) / site.area_ha,
                "basal_area_m2_per_ha": float(area.sum()) / site.area_ha,
                "mean_dbh_cm": 100 * float(trees.dbh_m[rows].mean()),
                "dominant_height_m": float(trees.height_m[rows[thickest(trees.dbh_m[rows], site)]].mean()),
                "clark_evans": nearest_index(trees.position_m[rows], site, periodic=periodic),
                "share_of_basal_area": {one.name: float(s) for one, s in zip(species, shares, strict=True) if s},
            }
        )
    return {
        "storeys": each,
        "canopy_cover": trees.canopy_cover,
        "leaf_area_index": float(trees.leaf_area_m2.sum()) / site.area_m2,
    }
