"""Valleys for benchmarks/ecoclimates.py (Figure 42): a pioneer of dry ground and a species that likes it wet, on hills.

The recipe is recipes/ecoclimates/valleys.yaml. Species are weighed by their leaf area.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from ecoclimate_places import (
    COLOURS,
    Floats,
    Places,
    Stand,
    at_feet,
    draw_stand,
    grown,
    leaves,
    middles,
    spread,
    wetness,
)
from matplotlib.figure import Figure
from silviculture_stands import Report

from forestgen.community.plots import new_figure
from forestgen.community.population import Population
from forestgen.scene.plan import Plan

LAKE_M = 10.0  # of the site's south, where nothing grows
PIONEER, WET = "shrub", "poplar"
VARIANTS: dict[str, tuple[str, ...]] = {
    "microclimate": (),
    "no pioneer": ("community.initial_plants={shrub: 0}",),
    "no microclimate": ("community.microclimate=false",),
}
EARLY_YR = 10
SETTLED_M2_PER_HA = 200.0  # of leaves, of a species that has established itself


def rise_above_floor(plan: Plan, place: Places) -> Floats:
    """(N,) metres above the lowest ground at the same distance from the lake: how far up the valley's side."""
    assert plan.community.site.height is not None
    x = np.arange(0.5, plan.community.site.size_m[0])
    along = plan.community.site.height(*np.meshgrid(x, place[:, 1]))
    return np.asarray(plan.community.site.height(place[:, 0], place[:, 1]) - along.min(axis=1))


def weighted(values: Floats, weight: Floats) -> float:
    return float(np.sum(values * weight) / np.sum(weight)) if np.sum(weight) > 0 else float("nan")


@dataclass(frozen=True)
class Relief:
    """Where species stand at one moment, and how wet it is there; the site's are means over the ground."""

    rise_m: dict[str, float]  # by species, and of the site
    wet_mm_per_yr: dict[str, float]
    valley_share: dict[str, float]  # of a species' leaves, on the quarter of the ground that lies lowest


def relief_of(stand: Stand, population: Population) -> Relief:
    plan, wet = stand.plan, wetness(stand.plan, population)
    ground = middles(plan.community.site.size_m, wet.shape).reshape(-1, 2)
    ground = ground[ground[:, 1] > LAKE_M]
    site_rise = rise_above_floor(plan, ground)
    low = float(np.quantile(site_rise, 0.25))
    rise, water, valley = {"site": float(site_rise.mean())}, {"site": float(at_feet(wet, plan, ground).mean())}, {}
    for index, name in enumerate(population.species_names):
        of = population.species == index
        place, weight = population.position_m[of, :2], leaves(population)[of]
        up = rise_above_floor(plan, place)
        rise[name], water[name] = weighted(up, weight), weighted(at_feet(wet, plan, place), weight)
        valley[name] = weighted((up <= low).astype(np.float64), weight)
    return Relief(rise, water, valley)


def established_yr(stand: Stand, name: str) -> float:
    """When a species first has so many leaves, years; inf: never."""
    enough = SETTLED_M2_PER_HA * stand.plan.community.site.area_ha
    years = [one.time_yr for one, leaf in zip(stand.moments, stand.leaf_m2()[name], strict=True) if leaf >= enough]
    return years[0] if years else float("inf")


def valleys(report: Report, quick: bool, seeds: range) -> Figure:
    """Figure 42: the wet species comes up in the valleys, after the pioneer and thanks to it, by microclimate alone."""
    settings = ("community.steps=60",) if quick else ()
    stands = {
        name: [grown("valleys.yaml", seed, (*settings, *own)) for seed in seeds] for name, own in VARIANTS.items()
    }
    last_yr = stands["microclimate"][0].moments[-1].time_yr
    seconds = [one.seconds for each in stands.values() for one in each]
    report.line(f"{last_yr:g} years, seeds {list(seeds)}; a run takes {min(seconds):.0f} to {max(seconds):.0f} s")
    report.line("rise: metres above the valley's floor; wet: soil water, mm a year; both weighed by leaf area")
    for name, each in stands.items():
        for seed, stand in zip(seeds, each, strict=True):
            end, leaf = relief_of(stand, stand.moments[-1]), stand.leaf_m2()
            told = "  ".join(
                f"{k}: {leaf[k][-1]:6.0f} m2, rise {end.rise_m[k]:.2f}, wet {end.wet_mm_per_yr[k]:4.0f}"
                for k in (PIONEER, WET)
            )
            site = f"site: rise {end.rise_m['site']:.2f}, wet {end.wet_mm_per_yr['site']:4.0f}"
            report.line(f"{name:<16} seed {seed}  {told}  {site}; settled in year {established_yr(stand, WET):g}")
    judge_valleys(report, stands)
    return valleys_picture(stands)


def judge_valleys(report: Report, stands: dict[str, list[Stand]]) -> None:
    on, off, alone = (stands[name] for name in ("microclimate", "no microclimate", "no pioneer"))
    end = [relief_of(one, one.moments[-1]) for one in on]
    early = [relief_of(one, one.at(EARLY_YR)) for one in on]
    even = [relief_of(one, one.moments[-1]) for one in off]

    def check(what: str, values: Sequence[float], held: Sequence[bool], bound: str) -> None:
        report.check(what, spread(values), all(held), bound)

    ratio = [one.rise_m[WET] / one.rise_m[PIONEER] for one in end]
    check("rise of the wet species, over the pioneer's", ratio, [x < 0.5 for x in ratio], "below 0.5")
    ratio = [one.rise_m[WET] / one.rise_m["site"] for one in end]
    check("the same over the site's", ratio, [x < 0.5 for x in ratio], "below 0.5")
    share = [one.valley_share[WET] for one in end]
    check("share of it on the lowest quarter of the ground", share, [x > 0.75 for x in share], "over 0.75")
    ratio = [one.wet_mm_per_yr[WET] / one.wet_mm_per_yr[PIONEER] for one in end]
    check("soil water at its feet, over the pioneer's", ratio, [x > 1.5 for x in ratio], "over 1.5")
    first = [one.valley_share[PIONEER] for one in early]
    check(f"pioneer on the lowest quarter, year {EARLY_YR}", first, [0.15 <= x <= 0.35 for x in first], "0.15 to 0.35")
    later = [abs(one.valley_share[PIONEER] - 0.25) for one in end]
    least = [abs(one.valley_share[PIONEER] - 0.25) for one in even]
    moved = [x > 2 * y for x, y in zip(later, least, strict=True)]
    check("the same at the end, away from 0.25", later, moved, f"over twice that without microclimate, {spread(least)}")
    leaf_on, leaf_off, leaf_alone = ([one.leaf_m2()[WET][-1] for one in each] for each in (on, off, alone))
    share = [b / a for a, b in zip(leaf_on, leaf_alone, strict=True)]
    check("its leaves without the pioneer, over those with", share, [x < 0.5 for x in share], "below 0.5")
    when = [(established_yr(a, WET), established_yr(b, WET)) for a, b in zip(on, alone, strict=True)]
    delay = [b - a for a, b in when]
    check("later without it, years", delay, [x > 0 for x in delay], "above 0")
    share = [b / a for a, b in zip(leaf_on, leaf_off, strict=True)]
    check("its leaves without microclimate, over those with", share, [x < 0.05 for x in share], "below 0.05")


def valleys_picture(stands: dict[str, list[Stand]]) -> Figure:
    figure = new_figure(15, 10)
    axes = figure.subplots(len(stands), 4, width_ratios=(1, 1, 1, 1.1))
    shown: Any = None
    for row, (name, each) in zip(axes, stands.items(), strict=True):
        last = each[0].moments[-1].time_yr
        for axis, year in zip(row, (EARLY_YR, 0.4 * last, last), strict=False):
            population = each[0].at(year)
            shown = draw_stand(axis, each[0], population, f"{name}, year {population.time_yr:g}", wettest=1500)
        time = [one.time_yr for one in each[0].moments]
        for stand in each:
            for species, leaf in stand.leaf_m2().items():
                label = species if stand is each[0] else None
                row[3].plot(time, leaf / 1e3, color=COLOURS[species], lw=1.2, label=label)
        row[3].set(xlabel="time (years)", ylabel="leaves (1000 m²)")
        row[3].legend(frameon=False)
    figure.colorbar(shown, ax=axes[:, :3], label="soil water (mm a year)", shrink=0.5, pad=0.01)
    return figure
