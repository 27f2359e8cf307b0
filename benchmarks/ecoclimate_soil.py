"""A year of soil water over a terrain for benchmarks/ecoclimates.py: where the water goes, and what it costs."""

from __future__ import annotations

from time import perf_counter, process_time

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from silviculture_stands import Report

from forestgen.community.plots import new_figure
from forestgen.community.population import Site
from forestgen.community.soil_water import Ground, SoilWater, Water
from forestgen.core.threads import cores

SIDE_M, CELL_M, MONTH_DAYS = 1000.0, 1.5, 365.25 / 12
YEAR_BOUND_S = 75.0  # a quarter of what the coupled model may take for a year


def hills(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Two crests, a valley between them, and folds of 60 m."""
    folds = np.sin(2 * np.pi * x / 310 + 1) * np.sin(2 * np.pi * y / 170)
    return 40 * np.sin(2 * np.pi * x / SIDE_M) + 0.02 * y + 6 * folds


def soil(report: Report, quick: bool, seeds: range) -> Figure:
    """Twelve months of rain that varies by month, over dense and sparse plants, between closed edges."""
    ground = Ground.of_site(Site((SIDE_M, SIDE_M), hills), 4 * CELL_M if quick else CELL_M, periodic=False)
    model = SoilWater(ground)
    rng = np.random.default_rng(seeds[0])
    plants = 20 * rng.random(ground.shape)
    water = Water(np.zeros(ground.shape), np.zeros(ground.shape))
    before, uptake, loss, rain = 0.0, 0.0, 0.0, 0.0
    error, wall, own = 0.0, perf_counter(), process_time()
    for month in range(12):
        rain_mm_per_day = 1.5 + np.cos(2 * np.pi * month / 12)
        passed = model.advance(water, MONTH_DAYS, plants_g_per_m2=plants, rain_mm_per_day=rain_mm_per_day)
        water, budget = passed.water, passed.budget
        uptake, loss, rain = uptake + budget.uptake_mm, loss + budget.loss_mm, rain + budget.rain_mm
        stored = float(water.soil_mm.mean() + water.surface_mm.mean())
        left = stored + budget.uptake_mm + budget.loss_mm
        error = max(error, abs(left - budget.rain_mm - budget.start_mm) / budget.rain_mm)
    wall, own = perf_counter() - wall, process_time() - own
    stored = float(water.soil_mm.mean() + water.surface_mm.mean())
    rows, cols = ground.shape
    report.line(f"{rows} x {cols} cells, {cores()} cores: a year in {wall:.1f} s, {own:.1f} s of processor time")
    report.line(f"rain {rain:.1f} mm = stored {stored - before:.1f} + uptake {uptake:.1f} + loss {loss:.1f}")
    report.check("water made of nothing in a month, of its rain", f"{error:.1e}", error < 1e-10, "below 1e-10")
    left = abs(rain - (stored + uptake + loss)) / rain
    report.check("the same of the year", f"{left:.1e}", left < 5e-3, "below 0.5% (the issue's)")
    report.check(
        "processor seconds a year, on two cores", f"{own / 2:.1f} s", own / 2 < YEAR_BOUND_S, f"{YEAR_BOUND_S:g}"
    )
    assert ground.height_m is not None
    low = ground.height_m < np.quantile(ground.height_m, 0.2)
    high = ground.height_m > np.quantile(ground.height_m, 0.8)
    ratio = float(water.soil_mm[low].mean() / water.soil_mm[high].mean())
    report.check("soil water of the lowest fifth, over the highest", f"{ratio:.1f}", ratio > 2, "over 2")
    figure = new_figure(12, 4)
    maps = (
        (ground.height_m, "height (m)"),
        (water.soil_mm, "soil water (mm)"),
        (passed.uptake_mm, "uptake (mm, last month)"),
    )
    for axis, (field, name) in zip(figure.subplots(1, 3), maps, strict=True):
        shown = axis.imshow(
            field, origin="lower", extent=(0, SIDE_M, 0, SIDE_M), cmap="viridis", vmax=np.quantile(field, 0.99)
        )
        figure.colorbar(shown, ax=axis, label=name, shrink=0.8)
        axis.set(xticks=[], yticks=[])
    return figure
