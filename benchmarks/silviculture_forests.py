"""Mixed stands for benchmarks/silviculture.py: succession, gaps, clustering, elevation, biomes.

Types as in silviculture_figures: Table 1's and 2's in kind, small enough that a stand grows in minutes.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from silviculture_stands import Course, Plants, Report, grow

from forestgen.community.plots import new_figure
from forestgen.community.point_patterns import Window
from support.stand_measures import Clustering, belt, clustering, leaders, shares_in_bands

COLOURS = ("#D6409F", "#F08C00", "#14532D")
SHRUB: dict[str, Any] = {
    "life_span_yr": 25,
    "root_vigour_max": 3,
    "growth_rate_per_yr": 0.6,
    "apical_control": 0.44,
    "determinacy": 0.31,
    "tropism_angle_rad": 0.8,
    "tropism_weight": 1.0,
    "thickening_cm": 0.8,
    "length_per_age_m": 0.7,
    "longest_segment_m": 0.7,
    "flowering_age_yr": 3,
    "shade_tolerance": 0.02,
    "seeds_per_yr": 5,
    "seeding_radius_m": 8,
}
PINE: dict[str, Any] = {
    "life_span_yr": 120,
    "root_vigour_max": 14,
    "growth_rate_per_yr": 0.25,
    "apical_control": 0.8,
    "determinacy": 0.86,
    "tropism_angle_rad": 0.17,
    "tropism_weight": 0.5,
    "tropism_strength": 0.47,
    "thickening_cm": 1.2,
    "length_per_age_m": 1.6,
    "flowering_age_yr": 20,
    "shade_tolerance": 0.08,
    "seeds_per_yr": 2,
    "seeding_radius_m": 8,
}
TOLERANT: dict[str, Any] = {
    "life_span_yr": 500,
    "root_vigour_max": 30,
    "growth_rate_per_yr": 0.08,
    "apical_control": 0.8,
    "determinacy": 0.86,
    "tropism_angle_rad": 0.5,
    "tropism_weight": 0.3,
    "thickening_cm": 1.2,
    "length_per_age_m": 1.6,
    "flowering_age_yr": 40,
    "shade_tolerance": 0.3,
    "seeds_per_yr": 1,
    "seeding_radius_m": 8,
}
PALM: dict[str, Any] = {
    "life_span_yr": 60,
    "root_vigour_max": 4,
    "growth_rate_per_yr": 0.5,
    "apical_control": 0.96,
    "determinacy": 0.9,
    "length_per_age_m": 1.0,
    "flowering_age_yr": 10,
    "flowering_delay_max": 1,
}
PIONEER = PALM | {"shade_tolerance": 0.08, "seeds_per_yr": 4, "seeding_radius_m": 15}  # palms, as in Figure 12
SIDE_M = 40.0


def draw_shares(course: Course, name: str, label: str) -> Figure:
    amount = course.sums(name)
    figure = new_figure(7, 4)
    axes = figure.subplots()
    for k, species in enumerate(course.names):
        axes.plot(course.time_yr, amount[:, k] / course.site.area_ha, color=COLOURS[k], lw=1.5, label=species)
    axes.set(xlabel="time (years)", ylabel=label)
    axes.legend(frameon=False)
    return figure


def stages(quick: bool) -> Course:
    """The stand of Figure 3: shrub, pine and a tolerant tree from a few seeds of each, 500 years."""
    side = SIDE_M / 2 if quick else SIDE_M
    each = 10 if quick else 40
    community = {"initial_plants": {"shrub": each, "pine": each, "tolerant": each}, "steps": 500, "periodic": True}
    return grow({"shrub": SHRUB, "pine": PINE, "tolerant": TOLERANT}, community, (side, side))


def succession(report: Report, course: Course) -> Figure:
    """Figure 3: dominance passes from shrub to pine to the tolerant tree."""
    for name, what in (("leaf_kg", "leaf mass"), ("wood_kg", "wood")):
        reigns = leaders(course.sums(name), shortest=5)
        told = " > ".join(f"{course.names[one.species]} {course.time_yr[one.first]:.0f}" for one in reigns)
        in_order = [one.species for one in reigns] == [0, 1, 2]
        report.check(f"3 leaders by {what}, from year", told[:60], in_order, "shrub > pine > tolerant, once each")
    final = course.sums("leaf_kg")[course.time_yr >= course.time_yr[-1] - 50].mean(axis=0)
    share = float(final[2] / max(final.sum(), 1e-12))
    report.check("3 climax share of leaves, last 50 years", f"{share:.2f}", share > 0.5, "over 0.5")
    height = course.moments[-1]
    tops = [float(np.max(height.height_m[height.species == k], initial=0.0)) for k in range(3)]
    report.check("3 tallest at the end", course.names[int(np.argmax(tops))], int(np.argmax(tops)) == 2, "tolerant")
    return draw_shares(course, "leaf_kg", "leaf mass (kg/ha)")


FELLED_YR, AFTER_YR = 250, 150
GAP_M = 8.0


def gapped(quick: bool) -> Course:
    """The stand of Figure 12: grown, opened by felling, and followed for 150 years."""
    side = SIDE_M * 0.75 if quick else SIDE_M
    each = 20 if quick else 40
    gap = {"at_yr": FELLED_YR, "fell": {"circle": {"center_m": [side / 2, side / 2], "radius_m": GAP_M}}}
    community = {
        "initial_plants": {"pioneer": each, "climax": each},
        "steps": FELLED_YR + AFTER_YR,
        "periodic": True,
        "disturbances": [gap],
    }
    return grow({"pioneer": PIONEER, "climax": TOLERANT}, community, (side, side))


def gaps(report: Report, course: Course) -> Figure:
    """Figure 12: in the gap pioneers lead for a while, then the climax species; in the shade about it they never do."""
    middle = np.array(course.site.size_m) / 2
    inside = np.array([_share(one, _within(one, middle, GAP_M)) for one in course.moments])
    outside = np.array([_share(one, ~_within(one, middle, GAP_M + 4.0)) for one in course.moments])
    time = course.time_yr - FELLED_YR
    before, after, end = (time >= -30) & (time < 0), (time > 0) & (time <= 100), time > AFTER_YR - 20
    figure = new_figure(7, 4)
    axes = figure.subplots()
    axes.plot(time, inside, color=COLOURS[1], label="in the gap")
    axes.plot(time, outside, color=COLOURS[2], label="outside")
    axes.axvline(0, color="black", lw=0.6)
    axes.set(xlabel="years after the felling", ylabel="pioneers' share of leaf mass", ylim=(0, 1))
    axes.legend(frameon=False)
    climax = float(np.nanmean(inside[before]))
    peak, fringe, late = (
        float(np.nanmax(inside[after])),
        float(np.nanmax(outside[after])),
        float(np.nanmean(inside[end])),
    )
    report.check("12 pioneers' share there before", f"{climax:.2f}", climax < 0.3, "under 0.3")
    report.check("12 in the gap, at most within 100 years", f"{peak:.2f}", peak > 0.5, "over 0.5")
    report.check("12 outside in those years, at most", f"{fringe:.2f}", fringe < 0.5 * peak, "under half of that")
    report.check("12 in the gap at the end", f"{late:.2f}", late < 0.5, "under 0.5")
    return figure


def _within(plants: Plants, middle: np.ndarray, radius_m: float) -> np.ndarray:
    return np.sum((plants.position_m[:, :2] - middle) ** 2, axis=1) <= radius_m**2


def _share(plants: Plants, pick: np.ndarray) -> float:
    """Share of the first species in the leaf mass of some plants."""
    leaf = np.bincount(plants.species[pick], weights=plants.leaf_kg[pick], minlength=2)
    return float(leaf[0] / leaf.sum()) if leaf.sum() > 0 else float("nan")


TROPICS = {"temperature_c": 28, "precipitation_mm_per_yr": 4100}
TOLERANCES, RADII_M = {"c, d": 0.1, "a, b": 0.9}, (9.0, 3.0, 1.0)  # Table 2


def patterns(quick: bool) -> dict[tuple[str, float], Course]:
    """The stands of Figure 9: two tolerances by three seeding radii."""
    side, start, years = (24.0, 8, 22) if quick else (40.0, 20, 24)
    return {
        (name, radius): grow(
            {"palm": PALM | TROPICS | {"shade_tolerance": tolerance, "seeding_radius_m": radius, "seeds_per_yr": 3.0}},
            {"initial_plants": {"palm": start}, "steps": years, "periodic": True},
            (side, side),
            every=years,
        )
        for name, tolerance in TOLERANCES.items()
        for radius in RADII_M
    }


def clustered(report: Report, courses: dict[tuple[str, float], Course]) -> Figure:
    """Figure 9, Table 2: clustering rises as the seeding radius falls, measured by the pair correlation."""
    figure = new_figure(9, 7)
    panels = figure.subplots(2, 3, sharex=True)
    for row, name in enumerate(TOLERANCES):
        near = []
        for axes, radius in zip(panels[row], RADII_M, strict=True):
            course = courses[name, radius]
            found = _pattern(course)
            near.append(found.near)
            axes.fill_between(found.radii_m, found.low, found.high, color="0.85", label="random patterns, 95%")
            axes.plot(found.radii_m, found.g, color=COLOURS[2])
            axes.set(title=f"tolerance {TOLERANCES[name]:g}, radius {radius:g} m, n = {len(course.moments[-1])}")
            axes.set(xlabel="distance (m)", ylabel="pair correlation")
            if radius == min(RADII_M):
                told = f"{found.g.max():.2f} at most"
                report.check(f"9 {name}: radius 1 m, g above the envelope", told, found.clustered, "somewhere")
        told = " < ".join(f"{one:.2f}" for one in near)
        report.check(f"9 {name}: g nearer than 3 m, radii 9, 3, 1 m", told, near[0] < near[1] < near[2], "rising")
    return figure


def _pattern(course: Course) -> Clustering:
    points = course.moments[-1].position_m[:, :2]
    window = Window(0.0, course.site.size_m[0], 0.0, course.site.size_m[1])
    radii = np.linspace(0.5, 6.0, 23)
    rng = np.random.default_rng(9)
    return clustering(points, window, radii, rng, near_m=3.0, correction="periodic", bandwidth_m=0.4, simulations=99)


BELTS: dict[str, dict[str, Any]] = {  # Table 2, Fig. 16 (I) to (III)
    "shrub": {"temperature_c": 8, "seeds_per_yr": 5, "seeding_radius_m": 8, "shade_tolerance": 0.15},
    "conifer": {"temperature_c": 12, "seeds_per_yr": 2, "seeding_radius_m": 3, "shade_tolerance": 0.45},
    "deciduous": {"temperature_c": 16, "seeds_per_yr": 1, "seeding_radius_m": 3, "shade_tolerance": 0.6},
}
TOP_M = 1400.0
WIDTH_C = 2.2


def mountain(quick: bool) -> Course:
    """The stand of Figure 16: an empty slope of 1,400 m, a strip from its foot to its top."""
    forms = {"shrub": SHRUB, "conifer": PINE, "deciduous": TOLERANT}
    types = {
        name: forms[name] | keys | {"precipitation_mm_per_yr": 672, "temperature_width_c": WIDTH_C}
        for name, keys in BELTS.items()
    }
    length, width = (240.0, 8.0) if quick else (1000.0, 16.0)
    each = 40 if quick else 300
    community = {
        "initial_plants": dict.fromkeys(types, each),
        "steps": 120 if quick else 250,
        "temperature_c": 15.2,
        "precipitation_mm_per_yr": 672.6,
    }
    return grow(types, community, (length, width), terrain=ramp(), every=10)


def ramp() -> dict[str, Any]:
    """Ground that rises evenly from 0 to the top along x; a map's numbers are those of the middles of its pixels."""
    return {"kind": "map", "map": [[0.25 * TOP_M, 0.75 * TOP_M]] * 2}


def elevation(report: Report, course: Course) -> Figure:
    """Figure 16, Table 2: the shrub grows highest, the deciduous tree lowest."""
    last = course.moments[-1]
    height = course.site.height
    ground = height(last.position_m[:, 0], last.position_m[:, 1]) if height is not None else last.position_m[:, 2]
    figure = new_figure(7, 4)
    axes = figure.subplots()
    edges = np.linspace(0.0, TOP_M, 15)
    sums = shares_in_bands(ground, last.species, last.leaf_kg, edges, len(course.names))
    share = sums / np.maximum(sums.sum(axis=1, keepdims=True), 1e-12)
    middles = (edges[:-1] + edges[1:]) / 2
    belts = []
    for k, name in enumerate(course.names):
        axes.plot(middles, share[:, k], ".-", color=COLOURS[k], label=name)
        pick = last.species == k
        belts.append(belt(ground[pick], last.leaf_kg[pick]))
    axes.set(xlabel="elevation (m)", ylabel="share of leaf mass")
    axes.legend(frameon=False)
    middle = [one.middle if one else float("nan") for one in belts]
    told = " > ".join(f"{name} {value:.0f}" for name, value in zip(course.names, middle, strict=True))
    report.check("16 half of the leaves grow below, m", told[-60:], middle[0] > middle[1] > middle[2], "in this order")
    grown = np.flatnonzero(sums.sum(axis=1) > 0)
    ends = course.names[int(share[grown[-1]].argmax())], course.names[int(share[grown[0]].argmax())]
    report.check(
        "16 leaders of the highest and lowest band",
        ", ".join(ends),
        ends == (course.names[0], course.names[2]),
        "shrub, deciduous",
    )
    return figure
