"""Stands of one species for benchmarks/silviculture.py: logistic growth, self-thinning, allometries.

Every figure grows its stand, draws a picture and checks what the picture shows. A stand's types are Table 1's and 2's
in kind: fast, short-lived and light-demanding against slow, long-lived and tolerant; sizes are chosen so that a stand
grows in minutes (root vigours of tens, where the table's plants have hundreds).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from silviculture_stands import Course, Report, grow, only

from forestgen.community.plots import new_figure
from support.stand_measures import PowerLaw, fit_logistic, fit_power_law, thinning_line

COLOURS = ("#D6409F", "#F08C00", "#14532D")
PINE: dict[str, Any] = {
    "life_span_yr": 550,
    "root_vigour_max": 100,
    "growth_rate_per_yr": 0.2,
    "apical_control": 0.95,
    "apical_control_mature": 0.5,
    "determinacy": 0.82,
    "flowering_age_yr": 25,
    "tropism_angle_rad": 0.9,
    "tropism_weight": 0.5,
    "tropism_strength": 0.47,
    "thickening_cm": 2.0,
    "length_per_age_m": 1.9,
    "compensation": 0.1,
    "shade_tolerance": 0.05,
    "seeds_per_yr": 0,
}
POOR_SITE, GOOD_SITE = {"reach_m": 15}, {"reach_m": 40}  # medians of 16 and 29 m in year 240
ROOM_M2 = 40.0  # for each pine of Figures 18 and 19, so that they grow up before they meet
CLOSED = 0.9  # of the most leaves that a stand ever has: from then on it thins itself
LEAST_HEIGHT_M = 3.0  # trunks are measured at 1.3 m: of lower plants that is no trunk
DIAMETER_M = 0.05  # of plants that count for self-thinning


def pines(quick: bool) -> Course:
    """The stand of Figures 18 and 19: pines of one sowing, on a torus; a quarter of them where it must be quick."""
    plants = 250 if quick else 1000
    side = (ROOM_M2 * plants) ** 0.5
    return grow({"pine": PINE | POOR_SITE}, even_aged("pine", plants, 240), (side, side))


def even_aged(name: str, plants: int, years: int) -> dict[str, Any]:
    return {"initial_plants": {name: plants}, "steps": years, "periodic": True}


def logistic(report: Report, course: Course) -> Figure:
    """Figure 18b: biomass against the logistic curve."""
    biomass = course.sums("wood_kg")[:, 0]
    fit = fit_logistic(course.time_yr, biomass)
    figure = new_figure(6, 4)
    axes = figure.subplots()
    axes.plot(course.time_yr, biomass / 1e3, color=COLOURS[2], lw=2, label="stand")
    axes.set(xlabel="time (years)", ylabel="wood (t)")
    if fit is None:
        report.check("18b logistic curve", "none", False, "a curve that converges")
        return figure
    label = f"logistic, L = {fit.limit / 1e3:.3g} t, k = {fit.rate_per_yr:.3g}/yr, x0 = {fit.middle_yr:.0f} yr"
    axes.plot(course.time_yr, fit.at(course.time_yr) / 1e3, "--", color="black", label=label)
    axes.legend(frameon=False)
    last = float(course.time_yr[-1])
    report.check("18b R^2 of the logistic curve", f"{fit.r_squared:.4f}", fit.r_squared > 0.98, "over 0.98")
    # A straight or an exponential course can be near some logistic curve too: here the curve must turn, and level off.
    turns = 0.1 * last < fit.middle_yr < 0.75 * last
    report.check("18b fastest growth within the course", f"{fit.middle_yr:.0f} yr", turns, f"0.1 to 0.75 of {last:.0f}")
    levels = biomass[-1] / fit.limit
    report.check("18b share of the limit reached", f"{levels:.3f}", 0.9 <= levels <= 1.1, "0.9 to 1.1")
    report.line(f"{label}; the paper's has k = 0.0625/yr and x0 = 120 yr")
    return figure


def allometry(report: Report, course: Course) -> Figure:
    """Figure 19: height and leaf mass against the trunk's diameter at its foot, of a growing stand.

    The paper compares with Eloy et al. (2017, Fig. 6), who measure at the base. At 1.3 m small trees have no trunk yet.
    """
    growing = [one for one in course.moments[::10] if one.time_yr >= 10]
    columns = ("foot_m", "height_m", "leaf_kg")
    diameter, height, leaf = (np.concatenate([getattr(one, name) for one in growing]) for name in columns)
    tall = height > LEAST_HEIGHT_M
    diameter, height, leaf = diameter[tall], height[tall], leaf[tall]
    figure = new_figure(9, 4)
    sides = figure.subplots(1, 2)
    laws = [fit_power_law(diameter, height), fit_power_law(diameter, leaf)]
    for axes, y, law, name in zip(sides, (height, leaf), laws, ("height (m)", "leaf dry mass (kg)"), strict=True):
        axes.loglog(diameter * 100, np.maximum(y, 1e-4), ".", ms=1.5, alpha=0.3, color=COLOURS[2])
        axes.set(xlabel="diameter at the foot (cm)", ylabel=name)
        _draw_law(axes, law, diameter)
    for law, name, low, high in zip(laws, ("height", "leaf mass"), (0.57, 2.0), (0.77, 2.5), strict=True):
        text = f"{law.exponent:.3f} +- {law.error:.3f}" if law else "none"
        held = law is not None and low - 2 * law.error <= law.exponent <= high + 2 * law.error
        report.check(f"19 exponent of {name} on diameter", text, held, f"{low:g} to {high:g}, within two errors")
        if law:
            report.check(f"19 R^2 of {name}, logarithms", f"{law.r_squared:.3f}", law.r_squared > 0.8, "over 0.8")
    return figure


def _draw_law(axes: Any, law: PowerLaw | None, diameter: np.ndarray) -> None:
    if law is None:
        return
    x = np.array([diameter[diameter > 0].min(), diameter.max()])
    axes.loglog(x * 100, law.at(x), color="black", label=f"diameter^{law.exponent:.2f}")
    axes.legend(frameon=False)


def crowd(quick: bool) -> Course:
    """The stand of Figure 17: a dense sowing that thins itself; younger where it must be quick.

    With a fifth of the plants some 15 would be left, and the slope would be -1.49 to -1.80 from seed to seed.
    """
    side = 33.5
    return grow({"pine": PINE | GOOD_SITE}, even_aged("pine", 1500, 160 if quick else 240), (side, side))


def thinning(report: Report, course: Course) -> Figure:
    """Figure 17: mean mass against density of plants over 5 cm, from when the canopy is closed."""
    thick = [only(one, one.diameter_m > DIAMETER_M) for one in course.moments]
    density = np.array([len(one) for one in thick]) / course.site.area_ha
    mass = np.array([one.wood_kg.mean() if len(one) else np.nan for one in thick])
    leaf = course.sums("leaf_kg")[:, 0]
    line = thinning_line(density, mass, closed=int(np.argmax(leaf >= CLOSED * leaf.max())))
    figure = new_figure(5, 4.5)
    axes = figure.subplots()
    axes.loglog(density, mass, ".-", color=COLOURS[2], lw=0.5, ms=4, label="plants over 5 cm")
    axes.set(xlabel="density (1/ha)", ylabel="mean wood of a plant (kg)")
    text, held = "no stretch that thins", False
    if line is not None:
        text = f"{line.law.exponent:.3f} +- {line.law.error:.3f}"
        held = abs(line.law.exponent + 1.5) <= 0.15
        x = density[[line.first, line.last]]
        axes.loglog(x, line.law.at(x), color="black", lw=2, label=f"reduced major axis, {line.law.exponent:.2f}")
        middle = np.sqrt(x[0] * x[1])
        axes.loglog(x, line.law.at(middle) * (x / middle) ** -1.5, "--", color=COLOURS[1], lw=2, label="-3/2")
        years = course.time_yr[[line.first, line.last]]
        report.line(f"thins from year {years[0]:.0f} to {years[1]:.0f}, {x[0]:.0f} to {x[1]:.0f} plants/ha")
        report.check("17 decline along the line", f"{x[0] / x[1]:.1f} times", x[0] > 2 * x[1], "twice at least")
    report.check("17 slope of log mean mass on log density", text, held, "-1.5 +- 0.15")
    axes.legend(frameon=False)
    return figure
