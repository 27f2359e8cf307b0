"""The forest's edge for benchmarks/ecoclimates.py: Figures 43 and 49."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from ecoclimate_places import (
    COLOURS,
    Floats,
    Stand,
    at_feet,
    draw_stand,
    grown,
    leaves,
    middles,
    parameters_of,
    spread,
)
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.ndimage import binary_fill_holes, distance_transform_edt
from silviculture_stands import Report

from forestgen.architecture.geometry import spheres
from forestgen.community.branch_modules.growth import stature_of
from forestgen.community.branch_modules.state import step_parameters, surroundings_of
from forestgen.community.ecoclimate.months import Ecoclimate, local_climate
from forestgen.community.plots import new_figure
from forestgen.community.population import Population
from forestgen.scene.plan import Plan
from support.stand_measures import shares_in_bands

MIDDLE_M = np.array([50.0, 40.0])  # of the circle that the recipe sows
INNER_M = 17.0  # from it: half of the circle
STRIP_M = (38.0, 62.0)  # west and east of what is felled
ALONG_M = 16.0  # of the strip to either side of the middle: what was deep inside
CLIMAX = "beech"
BANDS_M = np.array([0.5, 3.0, 6.0, 9.0, 12.0, 15.0, 20.0, 25.0])  # of the distance to the edge
EDGE_M, INSIDE_M = 4.0, 15.0
STRIP_BANDS_M = np.array([-12.0, -8.0, -4.0, 0.0, 4.0, 8.0, 12.0])  # of the distance to the strip's margins
CANOPY_M = 1.0  # what is higher is forest
MIXED_YR, FULL_YR, FELLED_YR, OPEN_YR, REGROWN_YR = 5, 50, 55, 60, 80  # what is kept of FELLED_YR is after the felling
PINES = (
    "species.pine={from: pine, modules: {root_vigour_max: 100, temperature_c: 13, temperature_width_c: 6, "
    "precipitation_mm_per_yr: 700, precipitation_width_mm_per_yr: 500}}",
    "community.disturbances=[{at_step: 0, plant: {species: pine, count: 800, circle: {center_m: [50, 40], "
    "radius_m: 24}}}]",
    f"community.steps={FULL_YR}",
)
STANDS: dict[str, tuple[str, ...]] = {
    "microclimate": (),
    "no microclimate": ("community.microclimate=false",),
    "pines": PINES,
}


def to_edge_m(stand: Stand, population: Population) -> Floats:
    """(rows, cols) of square metres: distance to the forest's edge; 0 outside of it.

    As in Figure 49: forest is what is higher than a metre; gaps within it are of the forest.
    """
    forest = binary_fill_holes(canopy_m(stand, population) > CANOPY_M)
    return np.asarray(distance_transform_edt(np.pad(forest, 1))[1:-1, 1:-1])


def from_edge(stand: Stand, population: Population) -> Floats:
    """(N,) of plants' feet."""
    return at_feet(to_edge_m(stand, population), stand.plan, population.position_m[:, :2])


def from_strip(population: Population) -> Floats:
    """(N,) metres of plants from the margins of the felled strip, below 0 within it; inf beside the forest's middle."""
    return strip_distance(population.position_m[:, 0], population.position_m[:, 1])


def strip_distance(x_m: Floats, y_m: Floats) -> Floats:
    """The same of points, of any shape."""
    near = np.abs(y_m - MIDDLE_M[1]) <= ALONG_M
    return np.where(near, np.maximum(STRIP_M[0] - x_m, x_m - STRIP_M[1]), np.inf)


def shares(population: Population, distance_m: Floats, bands_m: Floats) -> Floats:
    """(B, S) share of the leaves of each band that each species has; nan where there are none."""
    kinds = len(population.species_names)
    sums = shares_in_bands(distance_m, population.species, leaves(population), bands_m, kinds)
    with np.errstate(invalid="ignore"):
        return np.asarray(sums / sums.sum(axis=1, keepdims=True))


def climax_share(population: Population, distance_m: Floats, least_m: float, most_m: float) -> float:
    """The climax species' share of the leaves between two distances."""
    share = shares(population, distance_m, np.array([least_m, most_m]))
    return float(share[0, population.species_names.index(CLIMAX)])


def state_of(plan: Plan, population: Population) -> Ecoclimate:
    state = plan.community.model.resume(
        parameters_of(plan), plan.community.site, plan.community.ecologies, plan.drawn.image_seed, population
    )
    assert isinstance(state, Ecoclimate)
    return state


def microclimate_of(stand: Stand, population: Population) -> tuple[Floats, Floats]:
    """(rows, cols) temperature at the ground, deg C, and soil water, mm a year, as plants feel them."""
    state = state_of(stand.plan, population)
    kinds = step_parameters(state.forest)
    stature = stature_of(state.forest.modules, state.forest.plants.species, kinds)
    around = surroundings_of(state.forest, kinds, stature.leaves)
    shape = population.maps["soil_mean_mm"].shape
    place = middles(stand.plan.community.site.size_m, shape).reshape(-1, 2)
    warm, wet = local_climate(state).at(place, around.light_at(place))
    return warm.reshape(shape), wet.reshape(shape)


def canopy_m(stand: Stand, population: Population) -> Floats:
    """(rows, cols) height of the highest module over each square metre; 0 where there is none."""
    state = state_of(stand.plan, population)
    modules, plants = state.forest.modules, state.forest.plants
    centre, radius = spheres(step_parameters(state.forest).tables, modules, plants.species)
    foot = np.repeat(plants.position_m, np.diff(modules.first), axis=0)
    cols, rows = (round(side) for side in stand.plan.community.site.size_m)
    out = np.zeros((rows, cols))
    reach = int(np.ceil(radius.max(initial=0.0)))
    corner = np.floor(foot + centre[:, :2]).astype(np.int64)
    for b in range(-reach, reach + 1):
        for a in range(-reach, reach + 1):
            cell = corner + np.array([a, b])
            away = np.hypot(*(cell + 0.5 - foot - centre[:, :2]).T)
            on = (away <= np.maximum(radius, 0.5)) & np.all((cell >= 0) & (cell < (cols, rows)), axis=1)
            np.maximum.at(out, (cell[on, 1], cell[on, 0]), centre[on, 2])
    return out


@dataclass(frozen=True)
class Canopy:
    """Heights of a canopy by the distance to the forest's edge."""

    distance_m: Floats  # (D,)
    height_m: Floats  # (D,) mean at each

    @property
    def inside_m(self) -> float:
        """Mean beyond half of the largest distance."""
        return float(self.height_m[self.distance_m > 0.5 * self.distance_m[-1]].mean())

    @property
    def reach_m(self) -> float:
        """Distance at which nine tenths of the inside's height are reached."""
        return float(self.distance_m[np.argmax(self.height_m >= 0.9 * self.inside_m)])

    @property
    def gradient(self) -> float:
        """Metres of height a metre, from the ground at the edge to where nine tenths are reached."""
        return 0.9 * self.inside_m / self.reach_m


def canopy_by_distance(stand: Stand, population: Population) -> Canopy:
    height, distance = canopy_m(stand, population), np.ceil(to_edge_m(stand, population))
    far = np.arange(1, int(distance.max()) + 1)
    many = [d for d in far if np.sum(distance == d) >= 50]  # square metres, for a mean
    return Canopy(np.array(many, dtype=np.float64), np.array([height[distance == d].mean() for d in many]))


def edges(report: Report, quick: bool, seeds: range) -> Figure:
    """Figures 43 and 49: the climax species inside, others at the edge, also in a felled strip; canopies."""
    used = seeds[:1] if quick else seeds
    stands = {name: [grown("edges.yaml", seed, keys) for seed in used] for name, keys in STANDS.items()}
    seconds = [one.seconds for each in stands.values() for one in each]
    report.line(f"seeds {list(used)}; a run takes {min(seconds):.0f} to {max(seconds):.0f} s")
    for name in ("microclimate", "no microclimate"):
        for seed, stand in zip(used, stands[name], strict=True):
            for what, year, bands in (("edge", FULL_YR, BANDS_M), ("strip", REGROWN_YR, STRIP_BANDS_M)):
                one = stand.at(year)
                distance = from_edge(stand, one) if what == "edge" else from_strip(one)
                by_band = shares(one, distance, bands)[:, one.species_names.index(CLIMAX)]
                told = " ".join(f"{x:.2f}" for x in by_band)
                report.line(f"{name:<16} seed {seed} year {year}: {CLIMAX}'s share from the {what} inwards {told}")
    judge_edges(report, stands)
    judge_canopies(report, stands)
    return edges_picture(stands)


def judge_edges(report: Report, stands: dict[str, list[Stand]]) -> None:
    on, off = stands["microclimate"], stands["no microclimate"]
    full = [one.at(FULL_YR) for one in on]

    def check(what: str, values: Sequence[float], held: Sequence[bool], bound: str) -> None:
        report.check(what, spread(values), all(held), bound)

    def inside_and_edge(each: Sequence[Stand]) -> tuple[list[float], list[float]]:
        moments = [(one.at(FULL_YR), from_edge(one, one.at(FULL_YR))) for one in each]
        inside = [climax_share(one, far, INSIDE_M, 100) for one, far in moments]
        return inside, [climax_share(one, far, 0.5, EDGE_M) for one, far in moments]

    ratio = []
    for one in (stand.at(MIXED_YR) for stand in on):
        away = np.hypot(*(one.position_m[:, :2] - MIDDLE_M).T)
        ratio.append(plants_share(one, away >= INNER_M) / plants_share(one, away < INNER_M))
    held = [0.67 < x < 1.5 for x in ratio]
    check(f"43a {CLIMAX}'s share of plants without, over within, year {MIXED_YR}", ratio, held, "0.67 to 1.5: mixed")
    inside, edge = inside_and_edge(on)
    check(f"43b {CLIMAX}'s share inside, year {FULL_YR}", inside, [x > 0.6 for x in inside], "over 0.6")
    ratio = [b / a if a > 0 else np.nan for a, b in zip(inside, edge, strict=True)]
    check("43b share at the edge, over that inside", ratio, [x < 0.5 for x in ratio], "below 0.5")
    _, even = inside_and_edge(off)
    report.line(f"43b {CLIMAX}'s share at the edge {spread(edge)}; without microclimate {spread(even)}")
    most = [0.5 * (a - b) for a, b in zip(inside, edge, strict=True)]
    fall = [a - b for a, b in zip(*inside_and_edge(off), strict=True)]
    held = [x < y for x, y in zip(fall, most, strict=True)]
    check("43b inside less edge, without microclimate", fall, held, f"below half of that with it, {spread(most)}")
    warmer, drier = [], []
    for stand, one in zip(on, full, strict=True):
        warm, wet = microclimate_of(stand, one)
        place = middles(stand.plan.community.site.size_m, warm.shape).reshape(-1, 2)
        depth = at_feet(to_edge_m(stand, one), stand.plan, place).reshape(warm.shape)
        rim, within = (depth > 0) & (depth < EDGE_M), depth > INSIDE_M
        warmer.append(float(warm[rim].mean() - warm[within].mean()))
        drier.append(float(wet[rim].mean() / wet[within].mean()))
    check("43b the edge is warmer, K", warmer, [x > 1 for x in warmer], "over 1")
    check("43b soil water at the edge, over that inside", drier, [x < 0.95 for x in drier], "below 0.95")
    later = [(one, from_strip(one)) for one in (stand.at(REGROWN_YR) for stand in on)]
    away = [climax_share(one, far, EDGE_M, STRIP_BANDS_M[-1]) for one, far in later]
    strip = [climax_share(one, far, STRIP_BANDS_M[0], 0) / y for (one, far), y in zip(later, away, strict=True)]
    check(f"43d in the strip, over beside it, year {REGROWN_YR}", strip, [x < 0.5 for x in strip], "below 0.5")
    middle = [climax_share(one, far, *STRIP_BANDS_M[:2]) / y for (one, far), y in zip(later, away, strict=True)]
    check("43d the same near its centre line", middle, [x < 0.5 for x in middle], "below 0.5")
    report.line(
        f"43d {CLIMAX}'s share of the old trees at its margins, over farther "
        + spread([climax_share(one, far, 0, EDGE_M) / y for (one, far), y in zip(later, away, strict=True)])
    )
    rise, without = ([risen(one.at(REGROWN_YR)) for one in each] for each in (on, off))
    check("43d its share of what came up, margins less centre", rise, [x > 0.25 for x in rise], "over 0.25")
    held = [x < 0.5 * y for x, y in zip(without, rise, strict=True)]
    check("43d the same without microclimate", without, held, "below half of that")
    warmer, drier = [], []
    for stand in on:
        warm, wet = microclimate_of(stand, stand.at(OPEN_YR))
        far = strip_distance(*np.moveaxis(middles(stand.plan.community.site.size_m, warm.shape), -1, 0))
        rim, within = np.abs(far) <= EDGE_M, (far > EDGE_M) & (far <= STRIP_BANDS_M[-1])
        warmer.append(float(warm[rim].mean() - warm[within].mean()))
        drier.append(float(wet[rim].mean() / wet[within].mean()))
    check(f"43d the new edges are warmer, year {OPEN_YR}, K", warmer, [x > 1 for x in warmer], "over 1")
    check("43d soil water there, over that inside", drier, [x < 0.95 for x in drier], "below 0.95")


def risen(population: Population) -> float:
    """How much more of what came up in the strip is the climax species at its margins than near its centre line."""
    young = population.age_yr < REGROWN_YR - FELLED_YR
    far = np.where(young, from_strip(population), np.inf)
    return climax_share(population, far, -EDGE_M, 0) - climax_share(population, far, *STRIP_BANDS_M[:2])


def plants_share(population: Population, pick: NDArray[np.bool_]) -> float:
    """The climax species' share of some plants, by number."""
    return float(np.mean(population.species[pick] == population.species_names.index(CLIMAX)))


def judge_canopies(report: Report, stands: dict[str, list[Stand]]) -> None:
    found = {
        name: [canopy_by_distance(one, one.at(FULL_YR)) for one in stands[name]] for name in ("microclimate", "pines")
    }
    for name, each in found.items():
        for one in each:
            told = f"{one.gradient:.2f} m/m, {one.inside_m:.1f} m inside"
            report.line(f"49 {'mixed' if name == 'microclimate' else name:<6} {told}, nine tenths at {one.reach_m:g} m")
    ratio = [b.gradient / a.gradient for a, b in zip(*found.values(), strict=True)]
    report.check("49 gradient of pines, over the mixed stand's", spread(ratio), min(ratio) > 1, "above 1")
    share = [b.gradient / b.inside_m / (a.gradient / a.inside_m) for a, b in zip(*found.values(), strict=True)]
    report.check("49 the same of the height inside", spread(share), min(share) > 1, "above 1")


def edges_picture(stands: dict[str, list[Stand]]) -> Figure:
    figure = new_figure(16, 11)
    axes = figure.subplots(3, 4)
    on, off, pines = (stands[name][0] for name in STANDS)
    shown: Any = None
    years = (MIXED_YR, FULL_YR, FELLED_YR, REGROWN_YR)
    for axis, year in zip(axes[0], years, strict=True):
        shown = draw_stand(axis, on, on.at(year), f"year {year}", wettest=1200)
    for axis, (stand, name) in zip(axes[1], ((off, "no microclimate"), (pines, "pines")), strict=False):
        draw_stand(axis, stand, stand.at(FULL_YR), f"{name}, year {FULL_YR}", wettest=1200)
    figure.colorbar(shown, ax=axes[0, :], label="soil water (mm a year)", shrink=0.8, pad=0.01)
    warm, _ = microclimate_of(on, on.at(FULL_YR))
    width, depth = on.plan.community.site.size_m
    heat = axes[1, 2].imshow(warm, origin="lower", extent=(0, width, 0, depth), cmap="inferno")
    axes[1, 2].set(title=f"warmth at the ground, year {FULL_YR}", xticks=[], yticks=[])
    figure.colorbar(heat, ax=axes[1, 2], label="°C", shrink=0.8)
    for name, each in (("mixed", stands["microclimate"]), ("pines", stands["pines"])):
        for stand in each:
            one = canopy_by_distance(stand, stand.at(FULL_YR))
            colour = COLOURS["pine" if name == "pines" else CLIMAX]
            axes[1, 3].plot(
                one.distance_m, one.height_m, color=colour, lw=1.2, label=name if stand is each[0] else None
            )
    axes[1, 3].set(xlabel="distance to the edge (m)", ylabel="canopy (m)")
    axes[1, 3].legend(frameon=False)
    draw_shares(axes[2, 0], stands["microclimate"], FULL_YR)
    draw_shares(axes[2, 1], stands["no microclimate"], FULL_YR)
    draw_shares(axes[2, 2], stands["microclimate"], REGROWN_YR, strip=True)
    draw_shares(axes[2, 3], stands["no microclimate"], REGROWN_YR, strip=True)
    for axis in axes[2, 1::2]:
        axis.set_title(f"no microclimate, {axis.get_title()}")
    axes[2, 0].legend(frameon=False)
    return figure


def draw_shares(axes: Any, stands: Sequence[Stand], year: float, *, strip: bool = False) -> None:
    """Species' shares of the leaves by distance, a line a seed."""
    bands = STRIP_BANDS_M if strip else BANDS_M
    for stand in stands:
        one = stand.at(year)
        share = shares(one, from_strip(one) if strip else from_edge(stand, one), bands)
        for index, name in enumerate(one.species_names):
            label = name if stand is stands[0] else None
            axes.plot(0.5 * (bands[1:] + bands[:-1]), share[:, index], color=COLOURS[name], lw=1.2, label=label)
    axes.set(title=f"year {year:g}", ylabel="share of leaves", ylim=(0, 1))
    axes.set_xlabel("distance to the felled strip (m)" if strip else "distance to the edge (m)")
