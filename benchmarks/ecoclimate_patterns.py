"""Patterns of vegetation and water for benchmarks/ecoclimates.py: Figure 46, and what persists.

Every run begins with bare ground at rest, on a fifth of whose cells plants were sown at random.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from silviculture_stands import Report

from forestgen.community.plots import new_figure
from forestgen.community.soil_water import Ground, SoilWaterParameters
from support.field_measures import FieldMeasures, measure_field, radial_spectrum
from support.persistence import field_features, holes
from support.vegetation_water import PlantParameters, Vegetation, VegetationWater, grown_state

Floats = NDArray[np.float64]
RAIN = {"bare ground": 0.5, "spots": 0.75, "labyrinth": 1.0, "gaps": 1.2, "full cover": 1.5}  # mm/d
STRIPES = "stripes"  # the labyrinth's rain on a hillside
GRADIENT = (0.0, 0.005)
SIDE_M, CELLS, STEP_DAYS, YEAR_DAYS = 240.0, 80, 1.5, 365.25
SOWN_SHARE, SOWN_G_PER_M2 = 0.2, 20.0
COVERED_G_PER_M2 = 1.0
POINTS, HOLES = 3000, 10  # plants drawn from the density; of their holes, the longest-lived count
COLOUR, OTHER = "#14532D", "#D6409F"


@dataclass(frozen=True)
class Grown:
    """A field and what it measures."""

    field: Floats  # (rows, cols) g/m2
    measures: FieldMeasures
    hole: float  # life of holes between plants drawn from it, over that of as many plants anywhere; nan without plants


def patterns(report: Report, quick: bool, seeds: range) -> Figure:
    """Figure 46: the pattern by rainfall, over several seeds."""
    uniform_states(report)
    years = 8.0 if quick else 16.0
    report.line(
        f"{SIDE_M:g} m, {CELLS} x {CELLS} cells, {years:g} years in steps of {STEP_DAYS} d; seeds {list(seeds)}"
    )
    report.line(
        f"{'':<12} {'seed':>4} {'mean':>6} {'cover':>6} {'skew':>6} {'wave m':>7} {'aniso':>6} islands lakes  hole"
    )
    grown: dict[str, list[Grown]] = {}
    for name in (*RAIN, STRIPES):
        grown[name] = [run(name, seed, years) for seed in seeds]
        for seed, one in zip(seeds, grown[name], strict=True):
            m, w = one.measures, one.measures.waves
            report.line(
                f"{name:<12} {seed:>4} {m.mean:6.2f} {m.cover:6.3f} {m.skewness:6.2f} {w.wavelength_m:7.1f} "
                f"{w.anisotropy:6.2f} {m.islands:>7} {m.lakes:>5} {one.hole:5.2f}"
            )
        judge(report, name, grown[name])
    means = np.array([[one.measures.mean for one in grown[name]] for name in RAIN])
    report.check("more rain, more plants, in every seed", "", bool((np.diff(means, axis=0) > 0).all()), "ascending")
    return picture(grown)


def uniform_states(report: Report) -> None:
    """The uniform state and the threshold, as published and as simulated where all cells are alike."""
    soil, plants = SoilWaterParameters(), PlantParameters()
    model = VegetationWater(Ground((6.0, 6.0), (2, 2), periodic=True), soil, plants)
    state = grown_state(soil, plants, 1.4)
    assert state is not None
    start = model.of(state)
    near = Vegetation(0.8 * start.plants_g_per_m2, start.water)
    after = model.advance(near, 4000.0, rain_mm_per_day=1.4, step_days=1.0).water.soil_mm
    report.check("uniform plants: soil water", f"{after.mean():.6f} mm", abs(after - 5).max() < 1e-6, "5 mm")
    for rain, lives in ((0.98, False), (1.02, True)):
        left = model.advance(near, 20_000.0, rain_mm_per_day=rain, step_days=4.0).plants_g_per_m2.mean()
        bound = "over 0.5 g/m2" if lives else "below 1e-6 g/m2"
        report.check(f"uniform plants at {rain} mm/d", f"{left:.3g} g/m2", left > 0.5 if lives else left < 1e-6, bound)


def run(name: str, seed: int, years: float) -> Grown:
    """One pattern from its sowing on."""
    hillside = name == STRIPES
    rain = RAIN["labyrinth"] if hillside else RAIN[name]
    model = model_of(CELLS, SIDE_M, GRADIENT if hillside else (0.0, 0.0))
    rng = np.random.default_rng(seed)
    start = model.sown(rng, rain, share=SOWN_SHARE, g_per_m2=SOWN_G_PER_M2)
    after = model.advance(start, years * YEAR_DAYS, rain_mm_per_day=rain, step_days=STEP_DAYS)
    field = after.plants_g_per_m2
    return Grown(field, measured(field), relative_hole(field, rng))


def model_of(cells: int, side_m: float, gradient: tuple[float, float] = (0.0, 0.0)) -> VegetationWater:
    return VegetationWater(Ground((side_m, side_m), (cells, cells), periodic=True, gradient=gradient))


def measured(field: Floats, side_m: float = SIDE_M) -> FieldMeasures:
    return measure_field(field, (side_m, side_m), threshold=COVERED_G_PER_M2, periodic=True)


def plants_of(field: Floats, rng: np.random.Generator) -> Floats:
    """(N, 2) places of plants that stand as densely as the field says, anywhere in their cells."""
    cell = rng.choice(field.size, POINTS, p=field.ravel() / field.sum())
    row, col = np.divmod(cell, field.shape[1])
    return (np.stack([col, row], axis=1) + rng.random((POINTS, 2))) * (SIDE_M / field.shape[1])


def relative_hole(field: Floats, rng: np.random.Generator) -> float:
    if field.max() < COVERED_G_PER_M2:
        return math.nan
    both = plants_of(field, rng), SIDE_M * rng.random((POINTS, 2))
    life = [np.diff(holes(points)[:HOLES]).sum() for points in both]
    return float(life[0] / life[1])


def judge(report: Report, name: str, grown: Sequence[Grown]) -> None:
    """Each pattern by what tells it, in every seed."""
    m = [one.measures for one in grown]

    def check(what: str, values: Sequence[float], least: float, most: float) -> None:
        held = all(least <= value <= most for value in values)
        shown = f"{min(values):.3g} to {max(values):.3g}"
        report.check(f"{name}: {what}", shown, held, f"{least:g} to {most:g}")

    cover, skew = [one.cover for one in m], [one.skewness for one in m]
    islands, lakes = [one.islands for one in m], [one.lakes for one in m]
    wave = [one.waves.wavelength_m for one in m]
    hole = [one.hole for one in grown]
    match name:
        case "bare ground":
            check("cover", cover, 0, 0)
        case "spots":
            check("cover", cover, 0.25, 0.55)
            check("skewness", skew, 0.7, 3)
            check("islands", islands, 12, 60)
            check("lakes", lakes, 0, 1)
        case "labyrinth":
            check("cover", cover, 0.5, 0.8)
            check("skewness", skew, -0.4, 0.4)
            check("islands and lakes", [a + b for a, b in zip(islands, lakes, strict=True)], 0, 11)
            check("anisotropy", [one.waves.anisotropy for one in m], 0, 0.5)
        case "gaps":
            check("cover", cover, 0.75, 0.97)
            check("skewness", skew, -3, -0.7)
            check("islands", islands, 0, 2)
            check("lakes", lakes, 12, 60)
        case "full cover":
            check("cover", cover, 1, 1)
            check("contrast", [one.contrast for one in m], 0, 0.01)
            check("holes between plants, over chance", hole, 0.8, 1.2)
        case _:
            check("anisotropy", [one.waves.anisotropy for one in m], 0.6, 1)
            check("angle to the slope, deg", [90 - abs(math.degrees(one.waves.direction_rad)) for one in m], 0, 20)
    if name in ("spots", "labyrinth", "gaps"):
        check("wavelength, m", wave, 35, 65)
        check("sharpness of the waves", [one.waves.sharpness for one in m], 0.7, 1)
    if name in ("spots", "gaps"):  # between the bands of a labyrinth there is no round room
        check("holes between plants, over chance", hole, 1.4, 9)


def picture(grown: dict[str, list[Grown]]) -> Figure:
    """Fields side by side; below them spectra, bars of islands and lakes, and bars of the plants' holes."""
    figure = new_figure(2.6 * len(grown), 9.2)
    axes = figure.subplots(4, len(grown), height_ratios=(2.2, 1, 1, 1))
    most = max(float(all_of[0].field.max()) for all_of in grown.values())
    for column, (name, all_of) in zip(axes.T, grown.items(), strict=True):
        field = all_of[0].field
        shown = column[0].imshow(
            field,
            origin="lower",
            cmap="YlGn",
            vmin=0,
            vmax=most,
            extent=(0, SIDE_M, 0, SIDE_M),
            interpolation="nearest",
        )
        rain = RAIN.get(name, RAIN["labyrinth"])
        slope = f", {GRADIENT[1]:.1%} up north" if name == STRIPES else ""
        column[0].set(title=f"{name}\n{rain:g} mm/d{slope}", xticks=[], yticks=[])
        if all_of[0].measures.cover == 0:
            for axis in column[1:]:
                axis.set_axis_off()
            continue
        for one in all_of:
            number, power = radial_spectrum(one.field, (SIDE_M, SIDE_M), periodic=True)
            share = power / power.sum() if one.measures.contrast > 0.01 else np.zeros_like(power)
            column[1].plot(1000 * number, share, color=COLOUR, lw=1, alpha=0.8)
        column[1].set(xlim=(0, 80), ylim=(0, 0.9), xlabel="waves per km")
        if all_of[0].measures.contrast > 0.01:
            draw_bars(column[2], field_features(field, 0, periodic=True), OTHER, 0)
            draw_bars(column[2], field_features(field, 1, periodic=True), COLOUR, 45)
        column[2].set(xlim=(0, most), ylim=(0, 90), xlabel="level (g/m²)", yticks=[])
        draw_bars(column[3], holes(plants_of(field, np.random.default_rng(0))), COLOUR, 0, most=40)
        column[3].set(xlim=(0, 25), ylim=(0, 40), xlabel="radius of discs (m)", yticks=[])
    axes[1, 1].set_ylabel("share of power")
    axes[2, 1].set_ylabel("islands (below), lakes")
    axes[3, 1].set_ylabel("holes between plants")
    figure.colorbar(shown, ax=axes[0, :], label="plants (g/m²)", shrink=0.8, pad=0.01)
    return figure


def draw_bars(axes: Any, diagram: Floats, colour: str, first: int, *, most: int = 44) -> None:
    """The longest bars of a diagram, one above the other."""
    for row, (one, other) in enumerate(diagram[:most]):
        axes.plot([one, other], [first + row, first + row], color=colour, lw=1)


def persistence(report: Report, quick: bool, seeds: range) -> Figure:
    """Spots, labyrinth and gaps, looked at through 500 years."""
    side_m, cells, step_days = 180.0, 60, 2.0
    moments_yr = (25, 50, 100) if quick else (25, 100, 250, 500)
    names = ("spots", "labyrinth", "gaps")
    report.line(f"{side_m:g} m, {cells} x {cells} cells, steps of {step_days:g} d; seeds {list(seeds)}")
    figure = new_figure(2.6 * len(moments_yr), 8)
    axes = figure.subplots(len(names), len(moments_yr))
    for row, name in zip(axes, names, strict=True):
        for seed in seeds:
            model = model_of(cells, side_m)
            rng, rain = np.random.default_rng(seed), RAIN[name]
            state = model.sown(rng, rain, share=SOWN_SHARE, g_per_m2=SOWN_G_PER_M2)
            now_yr, first, before, alike = 0, None, state.plants_g_per_m2, 0.0
            for axis, moment_yr in zip(row, moments_yr, strict=True):
                days = (moment_yr - now_yr) * YEAR_DAYS
                state = model.advance(state, days, rain_mm_per_day=rain, step_days=step_days)
                now_yr, field = moment_yr, state.plants_g_per_m2
                m = measured(field, side_m)
                first = first or m
                alike = float(np.corrcoef(field.ravel(), before.ravel())[0, 1])
                before = field
                report.line(
                    f"{name:<10} seed {seed} year {now_yr:>4}: cover {m.cover:.3f}, skewness {m.skewness:5.2f}, "
                    f"wave {m.waves.wavelength_m:.1f} m, islands {m.islands}, lakes {m.lakes}; like the one before "
                    f"{alike:.3f}"
                )
                if seed == seeds[0]:
                    axis.imshow(field, origin="lower", cmap="YlGn", vmin=0)
                    axis.set(title=f"{name}, year {now_yr}", xticks=[], yticks=[])
            change = abs(m.cover - first.cover), abs(m.skewness - first.skewness)
            longer = m.waves.wavelength_m / first.waves.wavelength_m
            report.check(f"{name}, seed {seed}: change of cover", f"{change[0]:.3f}", change[0] < 0.05, "below 0.05")
            report.check(f"{name}, seed {seed}: of skewness", f"{change[1]:.2f}", change[1] < 0.3, "below 0.3")
            report.check(f"{name}, seed {seed}: wavelength, ratio", f"{longer:.2f}", 0.8 < longer < 1.25, "0.8 to 1.25")
            report.check(f"{name}, seed {seed}: like the one before", f"{alike:.3f}", alike > 0.8, "over 0.8")
    return figure
