"""Patterns of trees and water for benchmarks/ecoclimates.py: Figure 46, with every plant a tree of branch modules.

One wet stand of each seed, recipes/ecoclimates/dryland.yaml, and then less rain: what it becomes tells how much less.
Rainfalls and the recipe's shrub were chosen by trials with seed 100; that of bands, and the year of the first look at
what lasts, after a run of seeds 0 to 2, too. That leaves and cover rise with rain, that spots skew the field upwards
and gaps downwards, is theory (Rietkerk et al. 2004; Meron 2018) and was written down before any run. Contrast and the
lives of islands and lakes took the place of holes between single plants after these had failed; their bounds were
chosen with seed 100 and with seeds 0 to 2 of an earlier version of the model.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from ecoclimate_stands import (
    INK,
    SITE,
    SMALL_SITE,
    Moment,
    Pattern,
    draw_plants,
    grown_on,
    pattern_of,
    plan_of,
    rain_of,
    scale_bar,
    smoothed,
    wet_stand,
)
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from silviculture_stands import Report

from forestgen.community.plots import new_figure

RAIN = {"bare soil": 0.5, "spots": 0.9, "bands": 1.25, "gaps": 1.55, "full cover": None}  # mm/d; None: as in wet years
LASTING = "bands"  # what is looked at through 500 years
FALLING_YR = 40.0
SOIL = LinearSegmentedColormap.from_list("soil", ["#EFDDBB", "#E9DFC4", "#C6D6CC", "#9DC3CB", "#7FAEC2"])
PATTERNED, EVEN = 1.33, 1.0  # contrast over that of chance
KIND = {"spots": (2.0, 99.0), "bands": (0.5, 2.0), "gaps": (0.0, 0.67)}  # lives of islands over those of lakes


@dataclass(frozen=True)
class Plan46:
    """How large and how long."""

    settings: tuple[str, ...]
    seeds: range
    until_yr: int  # of every rain
    lasting_yr: tuple[int, ...]  # years in which the pattern that lasts is looked at


def plan_46(quick: bool, seeds: range) -> Plan46:
    if quick:
        return Plan46(SMALL_SITE, seeds[:1], 200, (200, 250, 300))
    return Plan46(SITE, seeds, 240, (240, 490, 740))


@dataclass(frozen=True)
class Stand:
    """A stand at its end."""

    moment: Moment
    pattern: Pattern


def forests(report: Report, quick: bool, seeds: range) -> Figure:
    """Figure 46 with trees: the pattern by rainfall, over several seeds, and one of them through 500 years."""
    plan = plan_46(quick, seeds)
    wet = rain_of(plan_of(plan.settings, 0))
    report.line(f"rain of {wet:.2f} mm/d falls within {FALLING_YR:g} years; seen in year {plan.until_yr}")
    report.line(
        "seeds "
        + ", ".join(map(str, plan.seeds))
        + "; islands, lakes, beyond: lives and contrast over those of the same plants anywhere"
    )
    report.line(
        f"{'':<10} {'mm/d':>5} {'seed':>4} {'plants':>6} {'g/m2':>6} {'cover':>6} {'contrast':>8} {'skew':>6} "
        f"{'wave m':>7} islands  lakes  beyond"
    )
    stands: dict[str, list[Stand]] = {name: [] for name in RAIN}
    lasting: list[Stand] = []
    for seed in plan.seeds:
        start = wet_stand(plan.settings, seed)
        for name, rain in RAIN.items():
            lasts = name == LASTING and seed == plan.seeds[0]
            years = (plan.until_yr, *plan.lasting_yr) if lasts else (plan.until_yr,)
            steps = f"community.steps={max(years)}"
            recipe = plan_of([*plan.settings, steps], seed, rain=rain, over_yr=FALLING_YR)
            moments = grown_on(recipe, start, years).moments
            seen = {
                year: Stand(one, pattern_of(recipe, one, np.random.default_rng(seed))) for year, one in moments.items()
            }
            stands[name].append(seen[plan.until_yr])
            tell(report, name, wet if rain is None else rain, seed, seen[plan.until_yr].pattern)
            if lasts:
                lasting = [seen[year] for year in plan.lasting_yr]
    judge(report, {name: [one.pattern for one in all_of] for name, all_of in stands.items()})
    judge_lasting(report, lasting)
    return picture({name: all_of[0].moment for name, all_of in stands.items()}, lasting[-1].moment, wet)


def tell(report: Report, name: str, rain: float, seed: int, one: Pattern) -> None:
    m = one.field
    report.line(
        f"{name:<10} {rain:5.2f} {seed:>4} {one.plants:>6} {m.mean:6.1f} {one.cover:6.3f} {m.contrast:8.2f} "
        f"{m.skewness:6.2f} {m.waves.wavelength_m:7.1f} {one.islands:7.2f} {one.lakes:6.2f} {one.contrast:7.2f}"
    )


def judge(report: Report, found: dict[str, list[Pattern]]) -> None:
    """Each pattern by what tells it, in every seed."""

    def check(what: str, values: Sequence[float], least: float, most: float) -> None:
        held = all(least <= value <= most for value in values)
        report.check(what, f"{min(values):.3g} to {max(values):.3g}", held, f"{least:g} to {most:g}")

    def rising(what: str, columns: Sequence[Sequence[float]]) -> None:
        held = all(a < b for row in zip(*columns, strict=True) for a, b in pairwise(row))
        report.check(what, " < ".join(f"{np.mean(one):.3g}" for one in columns), held, "rising, in every seed")

    rising("more rain, more leaves, g/m2", [[one.field.mean for one in found[name]] for name in RAIN])
    rising("more rain, more cover", [[one.cover for one in found[name]] for name in RAIN])
    skewness = {name: [one.field.skewness for one in found[name]] for name in RAIN}
    rising("skewness of gaps, bands, spots", [skewness[name] for name in ("gaps", "bands", "spots")])
    check("bare soil: cover", [one.cover for one in found["bare soil"]], 0, 0.02)
    check("spots: skewness", skewness["spots"], 0.3, 9)
    check("gaps: skewness", skewness["gaps"], -9, -0.3)
    for name in ("spots", "bands", "gaps"):
        check(f"{name}: wavelength, m", [one.field.waves.wavelength_m for one in found[name]], 20, 65)
        check(f"{name}: contrast over chance", [one.contrast for one in found[name]], PATTERNED, 99)
    check("full cover: contrast over chance", [one.contrast for one in found["full cover"]], 0, EVEN)
    kinds = {name: [kind_of(one) for one in found[name]] for name in KIND}
    rising("islands over lakes: gaps, bands, spots", [kinds[name] for name in ("gaps", "bands", "spots")])
    for name, (least, most) in KIND.items():
        check(f"{name}: islands over lakes", kinds[name], least, most)
    pairs = zip(found["full cover"], found["gaps"], strict=True)
    check("full cover: contrast over that of gaps", [a.field.contrast / b.field.contrast for a, b in pairs], 0, 0.5)


def kind_of(one: Pattern) -> float:
    """Lives of islands over those of lakes; infinite without lakes."""
    return one.islands / one.lakes if one.lakes > 0 else math.inf


def judge_lasting(report: Report, stands: Sequence[Stand]) -> None:
    """Whether the pattern of the first look is still there."""
    first = stands[0]
    for one in stands:
        m, alike = one.pattern.field, _alike(first.moment, one.moment)
        report.line(
            f"{LASTING}, year {one.moment.time_yr:g}: cover {m.cover:.3f}, skewness {m.skewness:.2f}, wave "
            f"{m.waves.wavelength_m:.1f} m, contrast {one.pattern.contrast:.2f} times chance, islands and lakes "
            f"{one.pattern.islands:.2f} and {one.pattern.lakes:.2f} times; like the first {alike:.2f}"
        )
    years = f"{first.moment.time_yr:g} to {stands[-1].moment.time_yr:g}"
    f, rest = first.pattern.field, [one.pattern.field for one in stands[1:]]
    cover = max(abs(m.cover - f.cover) for m in rest)
    skew = max(abs(m.skewness - f.skewness) for m in rest)
    longer = [m.waves.wavelength_m / f.waves.wavelength_m for m in rest]
    report.check(f"{LASTING}, years {years}: change of cover", f"{cover:.3f}", cover < 0.1, "below 0.1")
    report.check(f"{LASTING}: of skewness", f"{skew:.2f}", skew < 0.5, "below 0.5")
    kept = all(0.75 < one < 1.33 for one in longer)
    report.check(f"{LASTING}: wavelength, ratio", ", ".join(f"{one:.2f}" for one in longer), kept, "0.75 to 1.33")
    strong = min(one.pattern.contrast for one in stands)
    report.check(f"{LASTING}: contrast over chance, least", f"{strong:.2f}", strong > PATTERNED, f"over {PATTERNED:g}")
    kinds = [kind_of(one.pattern) for one in stands]
    least, most = KIND[LASTING]
    held = all(least < one < most for one in kinds)
    report.check(f"{LASTING}: islands over lakes", ", ".join(f"{x:.2f}" for x in kinds), held, f"{least:g} to {most:g}")
    still = min(_alike(one.moment, after.moment) for one, after in pairwise(stands))
    report.check(f"{LASTING}: like the one before, least", f"{still:.2f}", still > 0.5, "over 0.5")


def _alike(one: Moment, other: Moment) -> float:
    """Correlation of two moments' leaves, smoothed."""
    return float(np.corrcoef(smoothed(one).ravel(), smoothed(other).ravel())[0, 1])


def picture(moments: dict[str, Moment], lasting: Moment, wet: float) -> Figure:
    """Stands from wet to dry, and one of them much later."""
    figure = new_figure(13.2, 9.7)
    figure.set_facecolor("white")
    axes = figure.subplots(2, 3).ravel()
    panels = [(f"{name}, {RAIN[name] or wet:.2g} mm of rain a day", one) for name, one in reversed(moments.items())]
    panels.append((f"{LASTING}, the same in year {lasting.time_yr:g}", lasting))
    soil_mm = np.concatenate([one.soil_mm.ravel() for _, one in panels])
    least, most = np.quantile(soil_mm, 0.002), np.quantile(soil_mm, 0.998)
    for axis, (title, one) in zip(axes, panels, strict=True):
        shown = draw_stand(axis, one, float(least), float(most))
        axis.set_title(title, fontsize=13, color=INK)
    scale_bar(axes[0], panels[0][1].size_m)
    bar = figure.colorbar(shown, ax=axes, location="bottom", shrink=0.3, aspect=40, pad=0.02)
    bar.set_label("soil water (mm)", color=INK, fontsize=11)
    bar.outline.set_visible(False)
    return figure


def draw_stand(axis: Any, one: Moment, least_mm: float, most_mm: float) -> Any:
    """Soil water in soft colours, plants above it as discs in greens."""
    width, height = one.size_m
    shown = axis.imshow(
        one.soil_mm, origin="lower", cmap=SOIL, vmin=least_mm, vmax=most_mm, extent=(0, width, 0, height),
        interpolation="bicubic",
    )  # fmt: skip
    shade = np.random.default_rng(0).random((len(one.radius_m), 1))
    dark, light = np.array([[0.13, 0.33, 0.19]]), np.array([[0.42, 0.56, 0.24]])
    draw_plants(axis, one, colour=dark + shade * (light - dark), edge="#16301C", width=0.35)
    for side in axis.spines.values():
        side.set_visible(False)
    return shown
