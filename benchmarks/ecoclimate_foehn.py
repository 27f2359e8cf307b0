"""Foehn for benchmarks/ecoclimates.py (Figures 44 and 45): a wind over a ridge, and two species on its sides.

The recipe is recipes/ecoclimates/foehn.yaml. The sides are compared at equal heights, in bands of 100 m, since it is
colder higher up on both of them. Species are weighed by their leaf area.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from ecoclimate_places import Floats, Stand, grown, leaves, middles, spread
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from numpy.typing import NDArray
from silviculture_stands import Report

from forestgen.community.plots import new_figure

COLD, WARM = "spruce", "beech"
COLOURS = {COLD: "#B91C1C", WARM: "#16A34A"}
BANDS_M = (50.0, 150.0, 250.0, 350.0, 450.0)
LOW = slice(0, 2)  # the bands where both species may stand: above, it is too cold for beeches on either side
VARIANTS: dict[str, tuple[str, ...]] = {"microclimate": (), "no microclimate": ("community.microclimate=false",)}


@dataclass(frozen=True)
class Side:
    """One side of the ridge, by bands of height: all are (B,)."""

    warmth_k: Floats  # of the air, over what is usual at its elevation
    rain: Floats  # over the region's
    soil_mm: Floats
    warm_share: Floats  # of the leaves, of those of the warm-adapted species
    leaf_m2: Floats  # of both species


def sides_of(stand: Stand) -> tuple[Side, Side]:
    """The windward side, which is the western one, and the lee."""
    last, site = stand.moments[-1], stand.plan.community.site
    assert site.height is not None
    shape = last.maps["warmth_mean_k"].shape
    place = middles(site.size_m, shape)
    ground_m = np.asarray(site.height(place[..., 0], place[..., 1]))
    x, y = last.position_m[:, 0], last.position_m[:, 1]
    foot_m, leaf = np.asarray(site.height(x, y)), leaves(last)
    warm = last.species == last.species_names.index(WARM)
    middle = site.size_m[0] / 2

    def side(over: NDArray[np.bool_], trees: NDArray[np.bool_]) -> Side:
        rows = []
        for low, high in pairwise(BANDS_M):
            cells, feet = (over & (low <= h) & (h < high) for over, h in ((over, ground_m), (trees, foot_m)))
            means = [float(last.maps[name][cells].mean()) for name in ("warmth_mean_k", "wetness", "soil_mean_mm")]
            total = float(leaf[feet].sum())
            rows.append((*means, float(leaf[feet & warm].sum()) / total if total else 0.0, total))
        return Side(*np.array(rows).T)

    return side(place[..., 0] < middle, x < middle), side(place[..., 0] > middle, x > middle)


def foehn(report: Report, quick: bool, seeds: range) -> Figure:
    """Figures 44 and 45: the lee is warmer and drier, and has other trees than the windward side."""
    settings = ("community.steps=40", "community.weather.hours=0.5") if quick else ()
    stands = {
        name: [grown("foehn.yaml", seed, (*settings, *own)) for seed in (seeds[:1] if quick else seeds)]
        for name, own in VARIANTS.items()
    }
    seconds = [one.seconds for each in stands.values() for one in each]
    last = stands["microclimate"][0].moments[-1]
    report.line(f"{last.time_yr:g} years; a run takes {min(seconds):.0f} to {max(seconds):.0f} s")
    report.line(f"bands of height: {'  '.join(f'{low:g}-{high:g}' for low, high in pairwise(BANDS_M))} m")
    for name, each in stands.items():
        for seed, stand in enumerate(each, start=seeds[0]):
            for where, side in zip(("windward", "lee"), sides_of(stand), strict=True):
                report.line(
                    f"{name:<16} seed {seed} {where:<8} warmth K {_row(side.warmth_k, 2)}  rain {_row(side.rain, 2)}  "
                    f"soil mm {_row(side.soil_mm, 0)}  {WARM}'s share of leaves {_row(side.warm_share, 2)}"
                )
    judge_foehn(report, stands)
    return foehn_picture(stands)


def _row(values: Floats, digits: int) -> str:
    return " ".join(f"{one:.{digits}f}" for one in values)


def judge_foehn(report: Report, stands: dict[str, list[Stand]]) -> None:
    on, off = ([sides_of(stand) for stand in each] for each in stands.values())

    def check(what: str, values: list[float], held: list[bool], bound: str) -> None:
        report.check(what, spread(values), all(held), bound)

    warmer = [float((lee.warmth_k - wind.warmth_k).min()) for wind, lee in on]
    check("lee over windward side, least of the bands, K", warmer, [x > 0.3 for x in warmer], "above 0.3")
    rain = [float((lee.rain / wind.rain)[LOW].max()) for wind, lee in on]
    check(
        "rain of the lee over that of the other side, most of the low bands", rain, [x < 0.7 for x in rain], "below 0.7"
    )
    soil = [float((lee.soil_mm / wind.soil_mm)[LOW].max()) for wind, lee in on]
    check("the same of soil water", soil, [x < 0.7 for x in soil], "below 0.7")
    windward, lee = ([float(one[k].warm_share[LOW].mean()) for one in on] for k in (0, 1))
    check(f"{WARM}'s share of leaves, windward", windward, [x < 0.1 for x in windward], "below 0.1")
    check("on the lee", lee, [0.3 < x < 0.95 for x in lee], "0.3 to 0.95")
    apart = [abs(float((b.warm_share - a.warm_share)[LOW].mean())) for a, b in off]
    split = [y - x for x, y in zip(windward, lee, strict=True)]
    check("lee less windward", split, [x > 0.3 for x in split], "above 0.3")
    check("without microclimate, the same", apart, [x < 0.15 for x in apart], "below 0.15, either way")


def foehn_picture(stands: dict[str, list[Stand]]) -> Figure:
    stand = stands["microclimate"][0]
    maps, site = stand.moments[-1].maps, stand.plan.community.site
    assert site.height is not None
    width, depth = site.size_m
    x = middles(site.size_m, maps["wetness"].shape)[0, :, 0]
    figure = new_figure(12.0, 8.0)
    section, *trees = figure.subplots(1 + len(stands), 1, height_ratios=(2.2, *(1.0,) * len(stands)))
    section.fill_between(x, np.asarray(site.height(x, np.full_like(x, depth / 2))), color="#78716C", alpha=0.35, lw=0)
    section.set(xlim=(0, width), ylabel="ground (m)", title="The wind blows from the left")
    warmth, rain = section.twinx(), section.twinx()
    rain.spines["right"].set_position(("outward", 70))
    for axis, name, label, colour in (
        (warmth, "warmth_mean_k", "warmth of the air, over the usual (K)", "#B91C1C"),
        (rain, "wetness", "rain, over the region's", "#2563EB"),
    ):
        for one in stands["microclimate"]:
            axis.plot(x, one.moments[-1].maps[name].mean(axis=0), color=colour, lw=1.5)
        axis.set_ylabel(label, color=colour)
    rain.set_ylim(bottom=0)
    for axis, (name, each) in zip(trees, stands.items(), strict=True):
        last = each[0].moments[-1]
        order = np.argsort(leaves(last), kind="stable")
        colours = ListedColormap([COLOURS[one] for one in last.species_names])
        place, leaf = last.position_m[order], leaves(last)[order]
        axis.scatter(place[:, 0], place[:, 1], s=0.02 * leaf, c=last.species[order], cmap=colours, vmin=0, vmax=1, lw=0)
        axis.set(
            xlim=(0, width),
            ylim=(0, depth),
            ylabel="m",
            title=f"{name}, year {last.time_yr:g}: {COLD} red, {WARM} green",
        )
    trees[-1].set_xlabel("m")
    figure.suptitle("A wind over a ridge, and what grows on its sides (seeds 002, Figures 44 and 45)")
    return figure
