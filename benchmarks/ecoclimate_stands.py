"""Stands of the coupled ecoclimate for benchmarks/ecoclimates.py: recipes grown on from one wet start, and measured."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from forestgen.community.ecoclimate.months import leaf_area_index, soil_of
from forestgen.community.ecoclimate.parameters import EcoclimateParameters
from forestgen.community.population import Population
from forestgen.community.simulation import snapshots
from forestgen.core.progress import Silent
from forestgen.recipe.load import load_recipe
from forestgen.scene.plan import Plan, check_plan
from support.field_measures import FieldMeasures, measure_field
from support.persistence import field_features, holes

Floats = NDArray[np.float64]
DRYLAND = Path(__file__).resolve().parents[1] / "recipes" / "ecoclimates" / "dryland.yaml"
WET_YR = 60  # years of the recipe's own rain before it changes
YEAR_DAYS = 365.25
SITE = ("site.size_m=[100,100]", "community.initial_plants=1500")
SMALL_SITE = ("site.size_m=[70,70]", "community.initial_plants=740")
CROWN_M = 3.0  # standard deviation of the Gaussian that turns leaves of single crowns into patches and gaps
PATCH_M = 5.0  # the same where islands and lakes are held against chance: clumps of a few plants go, patterns stay
INK = "#33312B"
LONGEST, DRAWS = 10, 8  # the longest-lived count; random patterns that they are compared with
SPREAD_DRAWS = 60  # random patterns whose spread tells what chance does
FEWEST = 50  # plants whose places are looked at


@dataclass(frozen=True)
class Moment:
    """The grown plants of a year and their soil."""

    time_yr: float
    size_m: tuple[float, float]
    position_m: Floats  # (N, 2)
    radius_m: Floats  # (N,) of the crowns
    leaf_m2: Floats  # (N,) area of each one's leaves
    leaf_g_per_m2: Floats  # (rows, cols) of all plants, as the soil sees them
    soil_mm: Floats  # (rows, cols) over the plants' memory


@dataclass(frozen=True)
class Course:
    """A stand through the years."""

    time_yr: Floats  # (T,)
    plants: NDArray[np.int64]  # (T,) grown
    leaf_g_per_m2: Floats  # (T,) mean over the site
    moments: dict[int, Moment]  # by year


@dataclass(frozen=True)
class Pattern:
    """What a moment measures."""

    plants: int
    cover: float  # share of the soil's cells with enough leaves to let in more than half of what they can
    field: FieldMeasures  # of the leaves' mass, smoothed over a crown
    islands: float  # lives of islands of leaves over those of the same plants anywhere (degree 0); nan without plants
    lakes: float  # the same of lakes (degree 1)
    contrast: float  # standard deviation of the leaves' patches over that of the same plants anywhere


def plan_of(settings: Sequence[str], seed: int, *, rain: float | None = None, over_yr: float = 0.0) -> Plan:
    """The dryland with some keys overridden; rain, mm/d, falls to a value over some years from the wet years on."""
    changes = []
    if rain is not None:
        wet = rain_of(plan_of(settings, seed))
        turn = f"{{from_yr: {WET_YR}, to_yr: {WET_YR + over_yr:g}, precipitation: {rain / wet:.6f}}}"
        changes = [f"community.climate_changes=[{turn}]"]
    else:
        changes = ["community.climate_changes=[]"]
    return check_plan(load_recipe(DRYLAND, [f"seed={seed}", *settings, *changes]), simulate_only=True)


def parameters_of(plan: Plan) -> EcoclimateParameters:
    parameters = plan.community.parameters
    assert isinstance(parameters, EcoclimateParameters)
    return parameters


def rain_of(plan: Plan) -> float:
    """Mean rain before it changes, mm/d."""
    return parameters_of(plan).climate.normals().precipitation_mm_per_yr / YEAR_DAYS


def wet_stand(settings: Sequence[str], seed: int) -> Population:
    """The stand after its wet years, from which every change begins."""
    *_, last = snapshots(plan_of([*settings, f"community.steps={WET_YR}"], seed).community, Silent())
    return last


def grown_on(plan: Plan, start: Population, years: Sequence[int]) -> Course:
    """The stand from `start` to the plan's last step, looked at closely in some years."""
    time_yr, plants, leaves, moments = [], [], [], {}
    for population in snapshots(plan.community, Silent(), start):
        time_yr.append(population.time_yr)
        plants.append(int(is_grown(population).sum()))
        mass_g = float(population.columns["leaf_area_m2"].sum()) * parameters_of(plan).soil_water.leaf_mass_g_per_m2
        leaves.append(mass_g / plan.community.site.area_m2)
        if population.step in years:
            moments[population.step] = moment_of(plan, population)
    return Course(np.array(time_yr), np.array(plants), np.array(leaves), moments)


def is_grown(population: Population) -> NDArray[np.bool_]:
    """(N,) whether a plant has flowered, which it does with its first grown module: seedlings have not."""
    return np.asarray(population.columns["flowering"] != 0)


def moment_of(plan: Plan, population: Population) -> Moment:
    parameters, grown = parameters_of(plan), is_grown(population)
    ground = soil_of(parameters, plan.community.site).ground
    state = plan.community.model.resume(
        parameters, plan.community.site, plan.community.ecologies, plan.drawn.image_seed, population
    )
    leaf = leaf_area_index(state.forest, ground) * parameters.soil_water.leaf_mass_g_per_m2
    return Moment(
        population.time_yr,
        plan.community.site.size_m,
        population.position_m[grown, :2],
        population.radius_m[grown],
        np.asarray(population.columns["leaf_area_m2"][grown], dtype=np.float64),
        leaf,
        population.maps["soil_mean_mm"],
    )


def smoothed(moment: Moment) -> Floats:
    """(rows, cols) leaves' mass without single crowns, g/m2."""
    cell_m = moment.size_m[0] / moment.leaf_g_per_m2.shape[1]
    return np.asarray(gaussian_filter(moment.leaf_g_per_m2, CROWN_M / cell_m, mode="wrap"))


def pattern_of(plan: Plan, moment: Moment, rng: np.random.Generator) -> Pattern:
    half = parameters_of(plan).soil_water.water().half_infiltration_g_per_m2
    field = measure_field(smoothed(moment), moment.size_m, threshold=half, periodic=True)
    cover = float((moment.leaf_g_per_m2 > half).mean())
    told = patches(moment.position_m, moment.leaf_m2, moment.size_m, rng)
    return Pattern(len(moment.position_m), cover, replace(field, cover=cover), *told)


def patches(
    points_m: Floats, leaf_m2: Floats, size_m: tuple[float, float], rng: np.random.Generator
) -> tuple[float, float, float]:
    """Islands, lakes and contrast of leaves, each over that of the same plants anywhere.

    Contrast tells how much of a pattern there is. Its kind: of spots islands live longest, of gaps lakes, of bands both
    alike. Holes between single points do not tell that: a shrub in a gap ends a hole, and between spots lies the sea.
    """
    if len(points_m) < FEWEST:
        return math.nan, math.nan, math.nan
    found = patch_measures(leaf_field(points_m, leaf_m2, size_m))
    chance = [
        patch_measures(leaf_field(rng.random(points_m.shape) * size_m, rng.permutation(leaf_m2), size_m))
        for _ in range(DRAWS)
    ]
    islands, lakes, contrast = found / np.mean(chance, axis=0)
    return float(islands), float(lakes), float(contrast)


def leaf_field(points_m: Floats, leaf_m2: Floats, size_m: tuple[float, float]) -> Floats:
    """(rows, cols) leaf area index of plants on a torus, smoothed to patches; cells of some 2 m."""
    cols, rows = (round(side / 2) for side in size_m)
    edges = np.linspace(0, size_m[1], rows + 1), np.linspace(0, size_m[0], cols + 1)
    leaf, _, _ = np.histogram2d(points_m[:, 1], points_m[:, 0], bins=edges, weights=leaf_m2)
    cell_m = size_m[1] / rows, size_m[0] / cols
    deviation = PATCH_M / cell_m[0], PATCH_M / cell_m[1]
    return np.asarray(gaussian_filter(leaf / (cell_m[0] * cell_m[1]), deviation, mode="wrap"))


def patch_measures(field: Floats) -> Floats:
    """(3,) summed lives of the longest-lived islands, without the one that joins no other, and of lakes; deviation."""
    lives = [-np.diff(field_features(field, degree, periodic=True)).ravel() for degree in (0, 1)]
    return np.array([lives[0][1 : 1 + LONGEST].sum(), lives[1][:LONGEST].sum(), field.std()])


def hole_lives(points_m: Floats) -> Floats:
    """Lives of the holes between points, longest first, metres."""
    diagram = holes(points_m)
    return np.asarray(diagram[:, 1] - diagram[:, 0])


def holes_over_chance(points_m: Floats, size_m: tuple[float, float], rng: np.random.Generator) -> float:
    """The lives of the longest holes over the mean of those of as many plants anywhere; nan of too few plants."""
    count = len(points_m)
    if count < FEWEST:
        return math.nan
    chance = [hole_lives(rng.random((count, 2)) * size_m)[:LONGEST].sum() for _ in range(DRAWS)]
    return float(hole_lives(points_m)[:LONGEST].sum() / np.mean(chance))


@cache
def spread_of_holes(count: int) -> float:
    """Standard deviation of `holes_over_chance` of so many plants anywhere; the site's size plays no part."""
    rng = np.random.default_rng(count)
    lives = np.array([hole_lives(rng.random((count, 2)))[:LONGEST].sum() for _ in range(SPREAD_DRAWS)])
    return float(np.std(lives / lives.mean(), ddof=1) * math.sqrt(1 + 1 / DRAWS))  # the mean of a few draws errs, too


def draw_plants(axes: Any, moment: Moment, *, colour: Any, edge: Any, alpha: float = 1.0, width: float = 0.3) -> None:
    """Plants as discs of their crowns' radii, large ones below; those over an edge come in at the other."""
    from matplotlib.collections import EllipseCollection

    order = np.argsort(-moment.radius_m, kind="stable")
    at, radius = moment.position_m[order], moment.radius_m[order]
    shifts = [(a * moment.size_m[0], b * moment.size_m[1]) for a in (-1, 0, 1) for b in (-1, 0, 1)]
    where = np.concatenate([at + shift for shift in shifts])
    row = np.tile(np.arange(len(at)), len(shifts))
    seen = np.all((where + radius[row, None] > 0) & (where - radius[row, None] < moment.size_m), axis=1)
    across, where, row = 2 * radius[row[seen]], where[seen], row[seen]
    drawn = np.argsort(row, kind="stable")
    faces = colour if isinstance(colour, str) else np.asarray(colour)[order][row[drawn]]
    axes.add_collection(
        EllipseCollection(
            across[drawn], across[drawn], np.zeros(len(drawn)), units="xy", offsets=where[drawn],
            offset_transform=axes.transData, facecolors=faces, edgecolors=edge, linewidths=width, alpha=alpha,
        )
    )  # fmt: skip
    axes.set(xlim=(0, moment.size_m[0]), ylim=(0, moment.size_m[1]), aspect="equal", xticks=[], yticks=[])


def scale_bar(axis: Any, size_m: tuple[float, float], length_m: float = 20.0) -> None:
    """A bar in the lower left corner, with its length."""
    x, y = 0.04 * size_m[0], 0.04 * size_m[1]
    box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 3}
    axis.plot([x, x + length_m], [y, y], color="white", lw=8, solid_capstyle="butt", alpha=0.85, zorder=4)
    axis.plot([x, x + length_m], [y, y], color=INK, lw=3, solid_capstyle="butt", zorder=5)
    axis.text(
        x + length_m / 2, y + 0.02 * size_m[1], f"{length_m:g} m", ha="center", va="bottom", color=INK, fontsize=11,
        bbox=box, zorder=5,
    )  # fmt: skip
