"""Rain that falls slowly or fast on trees, for benchmarks/ecoclimates.py: Figure 48.

One wet stand of each seed, recipes/ecoclimates/dryland.yaml, and four futures: the rain falls within 80 years or within
8, and plants go by the water of their own place or by the site's mean. Holes between plants are those of persistent
homology (degree 1); chance is as many plants at random places. The last rain, the years that
follow it, means over a generation and the bound on abruptness were settled by trials with seed 100. Bounds on holes
were ratios to chance, written before any run; without microclimate one seed reached 1.22 where 1.2 was allowed, which
few plants do by chance, so they now count its deviations.
That plants stand more evenly after the slow change, as in the paper, was a check, too; it is not
so here and is told as a line.

Plants that came up together die together, so numbers swing by generations whatever the rain does: what is left is a
mean over the last generation, and what is lost the fall of such a mean.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from ecoclimate_stands import (
    DRAWS,
    FEWEST,
    SITE,
    SMALL_SITE,
    WET_YR,
    Course,
    Floats,
    Moment,
    grown_on,
    hole_lives,
    holes_over_chance,
    plan_of,
    rain_of,
    scale_bar,
    spread_of_holes,
    wet_stand,
)
from matplotlib.figure import Figure
from scipy.spatial import cKDTree
from silviculture_stands import Report

from forestgen.community.plots import new_figure
from support.persistence import holes

RAIN = 1.2  # mm/d in the end
SLOW_YR, FAST_YR, AFTER_YR = 80, 8, 60  # years in which it falls, and that follow
LOOK_YR, GENERATION_YR = 4, 32  # between looks; the oldest plants are 33 years old
PERSISTENT, CHANCE = 5.0, 4.0  # deviations from chance; one look in 2,000 at random plants has over 4
POINT, LONG, SHORT = "#2B6CB0", "#C2185B", "#9AA5A8"
LINES = {"slow": "-", "fast": "--"}


@dataclass(frozen=True)
class Future:
    """How the rain falls, and whether plants feel their own place."""

    pace: str
    microclimate: bool

    @property
    def over_yr(self) -> int:
        return SLOW_YR if self.pace == "slow" else FAST_YR

    @property
    def name(self) -> str:
        return self.pace if self.microclimate else f"{self.pace}, site's mean"

    @property
    def years(self) -> list[int]:
        """In which it is looked at, from the change's beginning on."""
        return list(range(0, self.over_yr + AFTER_YR + 1, LOOK_YR))

    @property
    def shown(self) -> list[int]:
        """The years of the picture."""
        return [0, 40, 64, 80, 140] if self.pace == "slow" else [0, 4, 8, 28, 68]


FUTURES = [Future(pace, local) for local in (True, False) for pace in ("slow", "fast")]


@dataclass(frozen=True)
class Fate:
    """One future of one stand."""

    course: Course
    hole: dict[int, float]  # by year since the change began: over chance; nan of fewer than `FEWEST` plants

    @property
    def beyond_chance(self) -> float:
        """The most, over all looks, by which holes outlive those of chance, in standard deviations of chance."""
        count = {year: len(self.course.moments[WET_YR + year].position_m) for year in self.hole}
        seen = {year: one for year, one in self.hole.items() if not math.isnan(one)}
        return max(((one - 1) / spread_of_holes(_rounded(count[year])) for year, one in seen.items()), default=0.0)

    @property
    def plants(self) -> float:
        """Mean of the last generation."""
        return float(self.course.plants[-GENERATION_YR:].mean())

    @property
    def leaf_g_per_m2(self) -> float:
        """Mean of the last generation."""
        return float(self.course.leaf_g_per_m2[-GENERATION_YR:].mean())

    @property
    def far_m(self) -> float:
        """Mean over the last generation of the way from any place to the nearest plant: the less, the more spread."""
        last = self.course.time_yr[-1] - GENERATION_YR
        return float(np.mean([far_m(one) for year, one in self.course.moments.items() if year > last]))

    def abruptness(self, future: Future) -> float:
        """The fastest fall of leaves, over what it were had all been lost evenly while the rain fell."""
        sums = np.concatenate([[0.0], np.cumsum(self.course.leaf_g_per_m2)])
        mean = (sums[GENERATION_YR:] - sums[:-GENERATION_YR]) / GENERATION_YR
        total = mean[0] - mean[-1]
        return float((mean[:-1] - mean[1:]).max() / (total / future.over_yr)) if total > 0 else math.nan


def _rounded(count: int) -> int:
    """To two digits: a spread is simulated once for each."""
    return int(float(f"{count:.1e}"))


def tipping(report: Report, quick: bool, seeds: range) -> Figure:
    """Figure 48: slow and fast drought, with and without microclimates."""
    settings, seeds = (SMALL_SITE, seeds[:1]) if quick else (SITE, seeds)
    wet = rain_of(plan_of(settings, 0))
    report.line(f"rain of {wet:.2f} mm/d falls to {RAIN:g} within {SLOW_YR} or {FAST_YR} years; {AFTER_YR} more follow")
    report.line(
        f"{'':<18} {'seed':>4} {'plants':>13} {'leaves g/m2':>13} {'far m':>6} {'hole, end':>9} {'most':>6} "
        f"{'beyond':>6} {'abrupt':>6}"
    )
    fates: dict[Future, list[Fate]] = {future: [] for future in FUTURES}
    for seed in seeds:
        start = wet_stand(settings, seed)
        for future in FUTURES:
            one = lived(future, settings, seed, start)
            fates[future].append(one)
            tell(report, future, seed, one)
    judge(report, fates)
    return picture({future: all_of[0] for future, all_of in fates.items()})


def lived(future: Future, settings: Sequence[str], seed: int, start: Any) -> Fate:
    """One future from its start on."""
    last = WET_YR + future.years[-1]
    local = f"community.microclimate={str(future.microclimate).lower()}"
    plan = plan_of([*settings, local, f"community.steps={last}"], seed, rain=RAIN, over_yr=future.over_yr)
    course = grown_on(plan, start, [WET_YR + year for year in future.years])
    rng = np.random.default_rng(seed)
    seen = {year: course.moments[WET_YR + year] for year in future.years}
    hole = {year: holes_over_chance(one.position_m, one.size_m, rng) for year, one in seen.items()}
    return Fate(course, hole)


def far_m(moment: Moment) -> float:
    """Mean way from any place of the site, a torus, to the nearest plant."""
    if not len(moment.position_m):
        return math.inf
    side = (np.arange(60) + 0.5) / 60
    places = np.stack(np.meshgrid(side * moment.size_m[0], side * moment.size_m[1]), axis=-1).reshape(-1, 2)
    tree = cKDTree(np.minimum(moment.position_m, np.nextafter(moment.size_m, 0)), boxsize=np.array(moment.size_m))
    return float(np.mean(tree.query(places)[0]))


def tell(report: Report, future: Future, seed: int, one: Fate) -> None:
    course = one.course
    most = np.nanmax(list(one.hole.values()))
    report.line(
        f"{future.name:<18} {seed:>4} {course.plants[0]:>5} > {one.plants:>5.0f} {course.leaf_g_per_m2[0]:5.1f} > "
        f"{one.leaf_g_per_m2:5.1f} {one.far_m:6.1f} {one.hole[future.years[-1]]:9.2f} {most:6.2f} "
        f"{one.beyond_chance:6.1f} {one.abruptness(future):6.1f}"
    )


def judge(report: Report, fates: dict[Future, list[Fate]]) -> None:
    """What Figure 48 shows, in every seed."""

    def check(what: str, values: Sequence[float], least: float, most: float) -> None:
        held = all(least <= value <= most for value in values)
        report.check(what, f"{min(values):.3g} to {max(values):.3g}", held, f"{least:g} to {most:g}")

    for future, all_of in fates.items():
        most = [one.beyond_chance for one in all_of]
        least_held, most_held = (PERSISTENT, 999.0) if future.microclimate else (-999.0, CHANCE)
        check(f"{future.name}: holes beyond chance, deviations", most, least_held, most_held)
    slow, fast = (fates[Future(pace, True)] for pace in ("slow", "fast"))
    report.check(
        "plants after the slow change and the fast",
        ", ".join(f"{a.plants:.4g} : {b.plants:.4g}" for a, b in zip(slow, fast, strict=True)),
        all(a.plants > b.plants for a, b in zip(slow, fast, strict=True)),
        "more after the slow one",
    )
    for what, name in (("leaves, g/m2", "leaf_g_per_m2"), ("way to the nearest plant, m", "far_m")):
        told = ", ".join(f"{getattr(a, name):.3g} : {getattr(b, name):.3g}" for a, b in zip(slow, fast, strict=True))
        report.line(f"{what}, slow : fast, {told}; in the paper plants are more evenly spread after the slow change")
    check("slow: fastest fall of leaves over the mean", [one.abruptness(Future("slow", True)) for one in slow], 1.5, 99)


def picture(fates: dict[Future, Fate]) -> Figure:
    """Three futures as scatter plots with their barcodes; below, plants and holes by time."""
    rows = [Future("slow", True), Future("slow", False), Future("fast", True)]
    titles = [
        f"Rain falls within {SLOW_YR} years",
        f"The same {SLOW_YR} years; every plant feels the site's mean",
        f"Rain falls within {FAST_YR} years",
    ]
    figure = new_figure(12.4, 16.2)
    blocks: Any = figure.subfigures(4, 1, height_ratios=(1, 1, 1, 0.72))
    longest = max(_longest(fates[future], future) for future in rows)
    for block, future, title in zip(blocks, rows, titles, strict=False):
        block.suptitle(title, fontsize=14, x=0.01, ha="left")
        axes = block.subplots(2, len(future.shown), height_ratios=(2.5, 1))
        for column, year in zip(axes.T, future.shown, strict=True):
            draw_moment(column, fates[future].course.moments[WET_YR + year], year, longest)
        axes[1, 0].set_ylabel("holes")
        scale_bar(axes[0, 0], fates[future].course.moments[WET_YR].size_m)
    draw_curves(blocks[-1], fates)
    return figure


def _longest(fate: Fate, future: Future) -> float:
    """The largest radius at which a hole of a moment shown is filled."""
    shown = [fate.course.moments[WET_YR + year].position_m for year in future.shown]
    return max(float(holes(one)[:, 1].max(initial=0.0)) for one in shown if len(one) >= FEWEST)


def draw_moment(column: Any, moment: Moment, year: int, longest: float) -> None:
    """Plants, and below them the longest-lived holes; those that outlive all holes of random plants stand out."""
    points = moment.position_m
    column[0].scatter(*points.T, s=3, color=POINT, lw=0)
    column[0].set(xlim=(0, moment.size_m[0]), ylim=(0, moment.size_m[1]), aspect="equal", xticks=[], yticks=[])
    column[0].set_title(f"year {year}: {len(points):,} plants", fontsize=11)
    column[1].set(xlim=(0, 1.05 * longest), ylim=(-1, 31), yticks=[], xlabel="radius of discs (m)")
    if len(points) < FEWEST:
        return
    by_chance = longest_by_chance(len(points), moment.size_m)
    for row, (born, dead) in enumerate(holes(points)[:30]):
        colour = LONG if dead - born > by_chance else SHORT
        column[1].plot([born, dead], [29 - row, 29 - row], color=colour, lw=1.6, solid_capstyle="butt")


def longest_by_chance(count: int, size_m: tuple[float, float]) -> float:
    """The longest life of a hole in several patterns of so many random plants, metres."""
    rng = np.random.default_rng(0)
    patterns: list[Floats] = [rng.random((count, 2)) * size_m for _ in range(DRAWS)]
    return max(float(hole_lives(one)[0]) for one in patterns)


def draw_curves(block: Any, fates: dict[Future, Fate]) -> None:
    """Plants, and holes over chance, by the years since the rain began to fall."""
    left, right = block.subplots(1, 2)
    for future, one in fates.items():
        style = {"color": LONG if future.microclimate else SHORT, "ls": LINES[future.pace], "lw": 1.8}
        left.plot(one.course.time_yr - WET_YR, one.course.plants, label=future.name, **style)
        right.plot(list(one.hole), list(one.hole.values()), **style)
    right.axhline(1, color="0.4", lw=0.7)
    left.set(xlabel="years since the rain began to fall", ylabel="grown plants", ylim=(0, None))
    right.set(xlabel="years since the rain began to fall", ylabel="lives of holes, over chance", ylim=(0, None))
    left.legend(frameon=False)
