"""Vegetation and air for benchmarks/ecoclimates.py: Figures 39 and 41, and what a year costs.

Stands are grown on 60 m by recipes/ecoclimates/stand.yaml. What such ground gives to the air in a day is then given off
by all of a landscape of 4 km, or by all but a clearing, and the air of a summer's afternoon is simulated over it.
"""

from __future__ import annotations

import resource
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, wraps
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from numpy.typing import NDArray
from silviculture_stands import Report

from forestgen.atmosphere.fluid.parameters import Surface
from forestgen.community.ecoclimate import months
from forestgen.community.ecoclimate.air import AreaRegridder, Hours, day_of, grid_of, hours_of
from forestgen.community.ecoclimate.parameters import Month, WeatherSection
from forestgen.community.model import simulate
from forestgen.community.plots import new_figure
from forestgen.community.population import Population
from forestgen.community.soil_water import Ground, SoilWater
from forestgen.core.progress import Timings
from forestgen.recipe.load import load_recipe
from forestgen.scene.plan import check_plan

Floats = NDArray[np.float64]
RECIPES = Path(__file__).resolve().parents[1] / "recipes" / "ecoclimates"
SUMMER = Month(18.0, 3.0)
SIDE_M, CELLS = 4000.0, 20
CLEARING_M = 1200.0  # radius
FELLED_YR = 55
MOMENTS = {
    "forest": FELLED_YR - 1,
    "cleared": FELLED_YR + 1,
    "15 years later": FELLED_YR + 15,
    "55 years later": FELLED_YR + 55,
}
STANDS: dict[str, tuple[str, ...]] = {
    "arid shrubland": (
        "species={shrub: {from: shrub}}",
        "community.steps=15",
        "community.initial_plants=100",
        f"community.climate.precipitation_mm={[20] * 12}",
    ),
    "sparse pine forest": ("community.steps=55", "community.initial_plants=60"),
    "young oak forest": ("species={oak: {from: oak}}", "community.steps=30", "community.initial_plants=900"),
    "dense pine forest": ("community.steps=55", "community.initial_plants=900"),
}
AIR = WeatherSection.model_validate({"wind_m_per_s": 0, "spread": 0})
QUICK_AIR = AIR.model_copy(update={"hours": 1.5, "cell_height_m": 100.0})


@dataclass(frozen=True)
class Stand:
    """What a grown stand is, means over its site."""

    plants: int
    leaf_area_index: float
    vapour_mm_per_day: float
    soil_mm: float


@cache
def grown(overrides: tuple[str, ...]) -> dict[int, Stand]:
    """A stand by step."""
    plan = check_plan(load_recipe(RECIPES / "stand.yaml", overrides))
    course = simulate(
        plan.community.model,
        plan.community.parameters,
        plan.community.site,
        plan.community.ecologies,
        plan.drawn.image_seed,
        steps=plan.community.steps,
    )
    return {one.step: _stand(one, plan.community.site.area_m2) for one in course}


def _stand(one: Population, area_m2: float) -> Stand:
    maps = one.maps
    leaves = float(one.columns["leaf_area_m2"].sum()) / area_m2
    return Stand(len(one), leaves, float(maps["vapour_mm_per_day"].mean()), float(maps["soil_mean_mm"].mean()))


def afternoon(section: WeatherSection, vapour_mm_per_day: Floats, seed: int) -> Hours:
    """The air over a landscape that gives so much vapour, by (Y, X) cells of the air."""
    ground = Ground((SIDE_M, SIDE_M), (CELLS, CELLS), True)
    grid = grid_of(section, ground)
    day = day_of(section, SUMMER, 6, 0, 270.0, seed)
    vapour = AreaRegridder(ground, grid).for_air(vapour_mm_per_day) / (3600.0 * section.daylight_h)
    heat = np.full(grid.shape[1:], day.heat_w_per_m2, np.float32)
    return hours_of(section, grid, day, Surface(heat, (day.vapour_kg_per_m2_s + vapour).astype(np.float32)))


def clouds(report: Report, quick: bool, seeds: range) -> Figure:
    """Figure 39: the same air over four kinds of vegetation."""
    section = QUICK_AIR if quick else AIR
    figure = new_figure(13.0, 3.9)
    axes = figure.subplots(1, len(STANDS))
    found: dict[str, list[float]] = {}
    report.line(f"{'':<20} plants  LAI  soil mm  vapour mm/d   clouds g/m2 by seed")
    for axis, (name, overrides) in zip(axes, STANDS.items(), strict=True):
        stand = list(grown(overrides).values())[-1]
        air = [afternoon(section, np.full((CELLS, CELLS), stand.vapour_mm_per_day), seed) for seed in seeds]
        found[name] = [1000.0 * float(one.condensed_kg_per_m2.mean()) for one in air]
        report.line(
            f"{name:<20} {stand.plants:>6} {stand.leaf_area_index:4.1f} {stand.soil_mm:8.0f} "
            f"{stand.vapour_mm_per_day:12.2f}   " + "  ".join(f"{one:.1f}" for one in found[name])
        )
        _show_clouds(axis, air[0].condensed_kg_per_m2)
        axis.set_title(
            f"{name}\n{stand.vapour_mm_per_day:.1f} mm/d, {np.mean(found[name]):.0f} g/m² of cloud", fontsize=9
        )
    for less, more in (
        ("arid shrubland", "young oak forest"),
        ("sparse pine forest", "dense pine forest"),
        ("arid shrubland", "dense pine forest"),
    ):
        a, b = np.array(found[less]), np.array(found[more])
        held = bool((b > a).all())
        report.check(
            f"more clouds over {more} than over {less}", f"{b.mean() / a.mean():.2f} times", held, "every seed"
        )
    figure.suptitle("Clouds of the same summer afternoon over four kinds of vegetation (seeds 002, Figure 39)")
    return figure


def clearing(report: Report, quick: bool, seeds: range) -> Figure:
    """Figure 41: a forest, a patch of it cleared, and the patch as it grows again."""
    section = QUICK_AIR if quick else AIR
    again = (
        f"[{{at_yr: {FELLED_YR}, fell: {{share: 1}}}}, {{at_yr: {FELLED_YR}, plant: {{species: pine, count: 900}}}}]"
    )
    overrides = ("community.steps=110", "community.initial_plants=900", f"community.disturbances={again}")
    stands = grown(overrides)
    forest = stands[MOMENTS["forest"]].vapour_mm_per_day
    x = (np.arange(CELLS) + 0.5) / CELLS * SIDE_M - SIDE_M / 2
    inside = np.hypot(*np.meshgrid(x, x)) < CLEARING_M
    figure = new_figure(13.0, 3.9)
    axes = figure.subplots(1, len(MOMENTS))
    ratio: dict[str, Floats] = {}
    for axis, (name, year) in zip(axes, MOMENTS.items(), strict=True):
        stand = stands[year]
        vapour = np.where(inside, stand.vapour_mm_per_day, forest)
        air = [afternoon(section, vapour, seed).condensed_kg_per_m2 for seed in seeds]
        ratio[name] = np.array([one[inside].mean() / one[~inside].mean() for one in air])
        report.line(
            f"{name:<16} patch: LAI {stand.leaf_area_index:.1f}, {stand.vapour_mm_per_day:.2f} mm/d; clouds of the "
            "patch over those around: " + "  ".join(f"{one:.2f}" for one in ratio[name])
        )
        _show_clouds(axis, np.mean(air, axis=0))
        axis.add_patch(_circle())
        axis.set_title(f"{name}\nover the patch {np.mean(ratio[name]):.2f} of those around", fontsize=9)
    before, cleared, late = (ratio[name].mean() for name in ("forest", "cleared", "55 years later"))
    report.check(
        "clouds of the patch, cleared over before", f"{cleared / before:.2f}", cleared < 0.7 * before, "below 0.7"
    )
    report.check("and grown again", f"{late / before:.2f}", abs(late / before - 1) < 0.3, "within 0.3 of 1")
    figure.suptitle(
        f"Clouds over a forest, a clearing and its regrowth, mean of {len(seeds)} afternoons (seeds 002, Figure 41)"
    )
    return figure


def _show_clouds(axis, condensed: Floats) -> None:  # type: ignore[no-untyped-def]
    half = SIDE_M / 2000.0
    axis.imshow(
        1000.0 * condensed,
        origin="lower", extent=(-half, half, -half, half), cmap="Blues_r", vmin=0, vmax=150, interpolation="bilinear",
    )  # fmt: skip
    axis.set_xlabel("km")


def _circle() -> Circle:
    return Circle((0, 0), CLEARING_M / 1000.0, fill=False, edgecolor="#F59E0B", linewidth=1.5)


PARTS: dict[str, tuple[Any, str]] = {
    "air": (months, "month_of_air"),
    "soil water": (SoilWater, "advance"),
    "map of leaves": (months, "leaf_area_index"),
    "plants": (months, "step_forest"),
}


@contextmanager
def parts_timed() -> Iterator[Timings]:
    """Seconds of the parts of a month, while this holds."""
    times, own = Timings(), {name: getattr(*where) for name, where in PARTS.items()}

    def timed(name: str, work: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(work)
        def done(*given: Any, **named: Any) -> Any:
            with times(name):
                return work(*given, **named)

        return done

    try:
        for name, where in PARTS.items():
            setattr(*where, timed(name, own[name]))
        yield times
    finally:
        for name, where in PARTS.items():
            setattr(*where, own[name])


def peak_memory_gb() -> float:
    """Most memory that this process has held so far."""
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e9


def year(report: Report, quick: bool, seeds: range) -> Figure:
    """A year of a forest on 1 km² with its weather: what it costs, and where its water goes."""
    side, plants = (250.0, 2500) if quick else (1000.0, 100_000)
    overrides: Sequence[str] = (
        f"site.size_m=[{side}, {side}]",
        f"community.initial_plants={plants}",
        f"community.step_yr={1 / 12}",
        "community.steps=12",
        "community.weather={}",
        "community.soil_water.cell_m=1.5",
        "community.soil_water.substep_days=1",
    )
    plan = check_plan(load_recipe(RECIPES / "stand.yaml", tuple(overrides)))
    start = perf_counter()
    seconds: list[float] = []
    last: Population | None = None
    with parts_timed() as times:
        for one in simulate(
            plan.community.model,
            plan.community.parameters,
            plan.community.site,
            plan.community.ecologies,
            seeds[0],
            steps=12,
        ):
            seconds.append(perf_counter() - start)
            if last is None:
                times.seconds.clear()  # those of the start
            start, last = perf_counter(), one
    assert last is not None
    water = last.state["water"]
    error = water["stored_mm"] + water["uptake_mm"] + water["loss_mm"] - water["rain_mm"] - water["start_mm"]
    share = abs(error) / water["rain_mm"]
    report.line(
        f"{len(last):,} plants on {side:g} m: the start with three years of soil {seconds[0]:.0f} s, months "
        + " ".join(f"{one:.1f}" for one in seconds[1:])
    )
    total, memory_gb = sum(seconds[1:]), peak_memory_gb()
    parts = {**times.seconds, "the rest": total - sum(times.seconds.values())}
    report.line("of a year: " + ", ".join(f"{name} {one:.1f} s ({one / total:.0%})" for name, one in parts.items()))
    report.line(" ".join(f"{name} {value:.1f}" for name, value in water.items()))
    if not quick:
        report.check("a year of 12 months", f"{total:.0f} s", total < 300, "under 300 s")
    report.check("memory of this process at its peak", f"{memory_gb:.2f} GB", memory_gb < 8, "under 8 GB")
    report.check("water of a year that does not add up", f"{share:.1e}", share < 5e-3, "under 0.5%")
    figure = new_figure(7.0, 4.0)
    axis = figure.subplots()
    axis.bar(range(1, 13), seconds[1:], color="#2563EB")
    axis.set_xlabel("month")
    axis.set_ylabel("seconds")
    return figure
