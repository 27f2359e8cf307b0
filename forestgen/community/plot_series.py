"""Pictures of a community in time: counts, cover, the self-thinning line, sizes, water; and of simulated weather.

References: Lane 2002, Figures 2.1 and 4.4 (the self-thinning line) and 2.2 (how many plants there are of each mass).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, cast

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.clouds.source import WeatherReport
from forestgen.atmosphere.extinction import droplet_extinction, rain_extinction
from forestgen.community.plots import colours_of, darker, draw_discs, figure_png, new_figure, save_figure, tidy
from forestgen.community.population import Floats, Population, Site, Status, plant_mass
from forestgen.community.trajectory import Slope, Trajectory, fit_log_normal

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.container import BarContainer

_STYLES = ("-", "--", "-.", ":")  # a second cue beside colour
_LINE = "#222222"
_BINS = 40
_MOST_ROWS = 6  # of species, the first of them
_FEW = 10  # times the median of a bin fit on a plain axis
_SPARE = 1.03  # of the plain axis: the largest plants' bar is not its frame
_OUTLINE_PT = 0.6
_OWN_SHARE = 1 / 3  # of the common axis: a species that fills less of it has an axis of its own
_LEAST_DECADES = 0.05  # of the axis, for plants all alike
SOIL = "soil_water_mm"  # the map
_FLOWS = {"rain": ("#0072B2", "-"), "uptake": ("#14803C", "-"), "loss": ("#D55E00", "--")}  # name -> colour, style
_STORED = "#3B3B3B"
_WETNESS = ("#F4E9CD", "#CFE0C3", "#8FC1C4", "#4A90B8", "#1F5A96", "#12305F")  # dry ... wet
_WETTEST = 0.98  # share of the ground that the scale ends above: hollows hold many times what slopes do
_MOST_POINTS = 300
_SOIL_IN, _CURVES_IN = 6.0, 6.2
_MOST_IN_LEGEND = 12
_SKY, _RAIN = np.array([0.27, 0.45, 0.72]), np.array([0.35, 0.40, 0.50])
_WIDE_IN = 9.0


def _draw_curves(axes: Axes, time_yr: Floats, values: Floats, colours: Mapping[str, str]) -> None:
    for k, (name, colour) in enumerate(colours.items()):
        axes.plot(time_yr, values[:, k], color=colour, ls=_STYLES[k % len(_STYLES)], lw=1.8, label=name)
    if len(time_yr) > 1 and time_yr[-1] > time_yr[0]:
        axes.set_xlim(time_yr[0], time_yr[-1])
    axes.set_ylim(bottom=0)
    tidy(axes)


def plot_curves(trajectory: Trajectory, species_colours: Mapping[str, str], path: Path) -> None:
    """Number of plants, and share of the ground, of each species in time, as a PNG."""
    colours = colours_of(species_colours, trajectory.species_names)
    figure = new_figure(7.5, 6.5)
    above, below = figure.subplots(2, 1, sharex=True)
    _draw_curves(above, trajectory.time_yr, trajectory.counts.astype(np.float64), colours)
    _draw_curves(below, trajectory.time_yr, 100 * trajectory.cover, colours)
    above.set(ylabel="plants")
    below.set(ylabel="ground under undominated plants (%)", xlabel="time (years)")
    above.legend(frameon=False, fontsize=10, ncols=3, loc="lower right", bbox_to_anchor=(1, 1))
    save_figure(figure, path)


def plot_thinning(trajectory: Trajectory, slope: Slope | None, species_colours: Mapping[str, str], path: Path) -> None:
    """Mean mass against density on logarithmic axes, a line in time for each species, beside a slope of -3/2.

    The community's own `slope` (`trajectory.thinning_slope`) is drawn too.
    """
    colours = colours_of(species_colours, trajectory.species_names)
    figure = new_figure(6.4, 6.0)
    axes = figure.add_subplot(xscale="log", yscale="log")
    unit = "kg" if trajectory.mass_unit == "kg" else "radius³, m³"
    axes.set(xlabel="plants per hectare", ylabel=f"mean mass of a plant ({unit})")
    density = trajectory.counts / trajectory.area_m2 * 1e4
    drawn = []
    for k, (name, colour) in enumerate(colours.items()):
        some = (trajectory.counts[:, k] > 0) & (trajectory.mass_sum[:, k] > 0)
        if not some.any():
            continue
        x, y = density[some, k], trajectory.mass_sum[some, k] / trajectory.counts[some, k]
        axes.plot(x, y, color=colour, ls=_STYLES[k % len(_STYLES)], lw=2.2, label=name, zorder=3)
        axes.plot(x[:1], y[:1], "o", color=colour, ms=7, mfc="white", mew=1.8, zorder=4)
        axes.plot(x[-1:], y[-1:], "o", color=colour, ms=7, zorder=4)
        drawn.append(np.stack([x, y]))
    if drawn:
        _draw_line(axes, np.concatenate(drawn, axis=1))
        if slope is not None:
            _draw_slope(axes, trajectory, slope)
        axes.plot([], [], "o", color="#777777", mfc="white", mew=1.8, label="first year")
        axes.plot([], [], "o", color="#777777", label="last year")
        figure.legend(loc="outside lower center", ncols=3, frameon=False, fontsize=10)
    tidy(axes)
    save_figure(figure, path)


def _draw_line(axes: Axes, points: Floats) -> None:
    """A line of slope -3/2 above all points, touching them, as far as they go."""
    x, y = points
    constant = float(np.max(y * x**1.5))
    ends_x, (low, high) = np.array([x.min() / 1.5, x.max() * 1.5]), (y.min() / 2, y.max() * 2)
    axes.set(xlim=ends_x, ylim=(low, high))
    axes.plot(ends_x, constant * ends_x**-1.5, ls=(0, (1, 1.5)), color=_LINE, lw=1.4, label="slope −3/2")


def _draw_slope(axes: Axes, trajectory: Trajectory, slope: Slope) -> None:
    x = trajectory.density_per_ha[[slope.first, slope.last]]
    y = math.exp(slope.intercept) * x**slope.value
    label = f"measured slope {slope.value:.2f}".replace("-", "−")
    axes.plot(x, y, color="#C1121F", lw=6, alpha=0.35, solid_capstyle="round", zorder=2, label=label)


def plot_sizes(population: Population, species_colours: Mapping[str, str], path: Path) -> None:
    """Histograms of the living plants' mass, and of its logarithm with a fitted normal curve, as a PNG."""
    colours = colours_of(species_colours, population.species_names)
    mass, unit = plant_mass(population)
    shown = (population.status != Status.DEAD) & (mass > 0)
    by_species = {
        name: mass[shown & (population.species == index)] for index, name in enumerate(population.species_names)
    }
    by_species = {name: one for name, one in by_species.items() if len(one)}
    rows = max(1, min(len(by_species), _MOST_ROWS))
    label = "mass (kg)" if unit == "kg" else "mass, as radius³ (m³)"
    figure = new_figure(10.0, max(4.2, 1.0 + 1.4 * rows))
    figure.suptitle(f"{population.time_yr:g} years, {int(shown.sum()):,} plants", fontsize=12)
    grid = figure.add_gridspec(rows, 2)
    plain = figure.add_subplot(grid[:, 0])
    tidy(plain, "y")
    plain.set(xlabel=label, ylabel="plants")
    if by_species:
        _draw_plain(plain, by_species, colours)
    common, shown_there = _log_edges(by_species.values()), list(by_species.items())[:rows]
    own = [_log_edges([mass]) for _, mass in shown_there]
    is_common = all(np.ptp(one) >= _OWN_SHARE * np.ptp(common) for one in own)
    for row in range(rows):
        axes = figure.add_subplot(grid[row, 1], xscale="log")
        tidy(axes, "y")
        for name, mass in shown_there[row : row + 1]:
            edges = common if is_common else own[row]
            _draw_logarithmic(axes, name, mass, edges, colours[name])
            _few_ticks(axes, edges)
        if is_common and row < rows - 1:
            axes.tick_params(labelbottom=False)
    axes.set_xlabel(label + ", logarithmic")
    save_figure(figure, path)


def _draw_plain(axes: Axes, by_species: Mapping[str, Floats], colours: Mapping[str, str]) -> None:
    """Species upon each other; small plants may be many times more than all others, which the axis must still show."""
    largest = max(float(one.max()) for one in by_species.values())
    edges = np.linspace(0, largest, _BINS + 1)
    _, _, bars = axes.hist(
        list(by_species.values()), bins=list(edges), stacked=True, color=[colours[name] for name in by_species]
    )
    each = cast("Sequence[BarContainer]", bars if len(by_species) > 1 else [bars])
    for name, drawn in zip(by_species, each, strict=True):
        for one in drawn:
            one.set_edgecolor(darker(colours[name]))
            one.set_linewidth(_OUTLINE_PT if one.get_height() > 0 else 0.0)
    counts = np.histogram(np.concatenate(list(by_species.values())), edges)[0]
    if counts.max() > _FEW * np.median(counts[counts > 0]):
        axes.set_yscale("symlog", linthresh=1)
        axes.yaxis.set_major_formatter("{x:,.0f}")
    axes.set_xlim(0, largest * _SPARE)
    axes.set_ylim(bottom=0)


def _few_ticks(axes: Axes, edges: Floats) -> None:
    """Within a decade the library's labels would run into each other."""
    span = float(np.ptp(edges))
    if span >= 1:
        axes.xaxis.set_minor_formatter("")
        return
    at = edges[0] + span * np.array([0.1, 0.5, 0.9])
    axes.set_xticks([], minor=True)
    axes.set_xticks(list(10.0**at), [f"{one:.3g}" for one in 10.0**at])


def _log_edges(masses: Collection[Floats]) -> Floats:
    """Edges of the bins as decimal logarithms, for plants of these masses."""
    if not masses:
        return np.linspace(-1, 0, _BINS + 1)
    low = min(float(np.log10(one.min())) for one in masses)
    high = max(float(np.log10(one.max())) for one in masses)
    spare = max(0.02 * (high - low), (_LEAST_DECADES - (high - low)) / 2)
    return np.linspace(low - spare, high + spare, _BINS + 1)


def _draw_logarithmic(axes: Axes, name: str, mass: Floats, edges: Floats, colour: str) -> None:
    dark = darker(colour)
    axes.hist(
        mass, bins=list(10.0**edges), facecolor=(colour, 0.55), edgecolor=dark, linewidth=_OUTLINE_PT,
        histtype="stepfilled",
    )  # fmt: skip
    axes.set_xlim(10.0 ** edges[0], 10.0 ** edges[-1])
    axes.set_ylabel(name)
    fit = fit_log_normal(mass)
    if fit is None:
        return
    x = np.linspace(edges[0], edges[-1], 300)
    z = (x * np.log(10) - fit.mu) / fit.sigma
    width = (edges[1] - edges[0]) * np.log(10) / fit.sigma
    axes.plot(10.0**x, fit.n * width * np.exp(-z * z / 2) / np.sqrt(2 * np.pi), color=dark, lw=2)
    axes.set_title(f"normal in the logarithm: μ = {fit.mu:.2f}, σ = {fit.sigma:.2g}".replace("-", "−"), fontsize=9)


@dataclass(frozen=True)
class WaterSeries:
    """Where the water went by snapshot, (T,) each: sums since the beginning, means over the site, mm."""

    time_yr: Floats
    stored_mm: Floats  # on the ground and in the soil
    rain_mm: Floats
    uptake_mm: Floats
    loss_mm: Floats

    @classmethod
    def of(cls, snapshots: Sequence[tuple[float, Mapping[str, Any]]]) -> Self:
        """Of times and states' ``water``, as `Population.state` has it."""
        names = ("stored_mm", "rain_mm", "uptake_mm", "loss_mm")
        values = (np.array([float(water[name]) for _, water in snapshots]) for name in names)
        return cls(np.array([time for time, _ in snapshots]), *values)

    def periods_yr(self) -> Floats:
        """Ends of periods: of whole years, at most some hundred, or the snapshots' own where the years are fewer."""
        first, last = self.time_yr[0], self.time_yr[-1]
        years = math.floor(last - first + 1e-6)
        if years < 3:
            return self.time_yr
        stride = math.ceil(years / _MOST_POINTS)
        return np.asarray(first + np.arange(0, years + 1, stride))

    def rates_mm_per_yr(self, ends_yr: Floats) -> dict[str, Floats]:
        """(T - 1,) rain, uptake and loss between times."""
        sums = {"rain": self.rain_mm, "uptake": self.uptake_mm, "loss": self.loss_mm}
        years = np.diff(ends_yr)
        return {name: np.diff(np.interp(ends_yr, self.time_yr, one)) / years for name, one in sums.items()}


def plot_water(
    series: WaterSeries, last: Population, site: Site, species_colours: Mapping[str, str], path: Path
) -> None:
    """Flows and store of water in time, beside the last map of soil water with the crowns above it, as a PNG.

    Flows are those of whole years, where there are three at least; the store is that of every snapshot. It changes by
    rain less uptake less loss.
    """
    width, height = site.size_m
    longest = max(width, height)
    map_in = 1.6 + _SOIL_IN * max(width / longest, 0.35), 1.5 + _SOIL_IN * max(height / longest, 0.4)
    figure = new_figure(_CURVES_IN + map_in[0], max(map_in[1], 5.6))
    halves: Any = figure.subfigures(1, 2, width_ratios=(_CURVES_IN, map_in[0]))
    left, right = halves
    above, below = left.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    _draw_flows(above, series)
    below.plot(series.time_yr, series.stored_mm, color=_STORED, lw=1.0 if len(series.time_yr) > 200 else 1.6)
    below.set(ylabel="stored in soil and\non the ground (mm)", xlabel="time (years)", ylim=(0, None))
    tidy(below)
    _draw_soil(right, last, site, colours_of(species_colours, last.species_names))
    save_figure(figure, path)


def _draw_flows(axes: Axes, series: WaterSeries) -> None:
    ends = series.periods_yr()
    for name, values in series.rates_mm_per_yr(ends).items():
        colour, style = _FLOWS[name]
        axes.stairs(values, ends, color=colour, ls=style, lw=1.8, label=name, baseline=None)
    axes.set(ylabel="mm a year", ylim=(0, None), xlim=(series.time_yr[0], series.time_yr[-1]))
    title = "means between snapshots"
    if ends is not series.time_yr:
        years = round(ends[1] - ends[0])
        title = "sums of each year" if years == 1 else f"means of {years} years"
    axes.set_title(title, fontsize=10, loc="left")
    axes.legend(frameon=False, fontsize=10, ncols=3, loc="lower right", bbox_to_anchor=(1.02, 0.99))
    tidy(axes)


def _draw_soil(figure: Any, last: Population, site: Site, colours: Mapping[str, str]) -> None:
    from matplotlib.colors import LinearSegmentedColormap
    from matplotlib.lines import Line2D

    width, height = site.size_m
    soil = last.maps[SOIL]
    low, high = float(soil.min()), float(np.quantile(soil, _WETTEST))
    if high - low < 1e-3 * high or high == 0:  # the same everywhere: a scale of its rounding would show noise
        low, high = 0.0, max(2.0 * high, 1.0)
    axes = figure.add_subplot(aspect="equal")
    image = axes.imshow(
        soil, origin="lower", extent=(0, width, 0, height), interpolation="nearest", vmin=low, vmax=high,
        cmap=LinearSegmentedColormap.from_list("soil", _WETNESS),
    )  # fmt: skip
    _draw_crowns(axes, last, colours)
    axes.set(xlim=(0, width), ylim=(0, height), xlabel="x, east (m)", ylabel="y, north (m)")
    axes.set_title(f"soil water after {last.time_yr:.4g} years", fontsize=11)
    extend = "max" if soil.max() > high else "neither"
    if height < 0.5 * width:
        figure.colorbar(image, ax=axes, label="mm", location="bottom", extend=extend, aspect=40)
    else:  # as high as the map
        figure.colorbar(image, cax=axes.inset_axes((1.03, 0, 0.035, 1)), label="mm", extend=extend)
    found = np.bincount(last.species, minlength=len(last.species_names))
    handles = [
        Line2D([], [], ls="", marker="o", ms=9, mfc="none", mew=1.6, mec=darker(colours[name]), label=name)
        for name, count in zip(last.species_names, found, strict=True)
        if count
    ][:_MOST_IN_LEGEND]
    if handles:
        figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False, fontsize=10)


def _draw_crowns(axes: Axes, last: Population, colours: Mapping[str, str]) -> None:
    """Outlines, through which the ground shows; they thin out where plants are many."""
    alive = np.flatnonzero(last.status != Status.DEAD)
    edges = np.array([darker(colours[name]) for name in last.species_names]).reshape(-1, 3)[last.species[alive]]
    thick = float(np.clip(30 / math.sqrt(max(len(alive), 1)), 0.25, 1.4))
    outline = {"facecolors": "none", "edgecolors": edges, "linewidths": thick}
    draw_discs(axes, last.position_m[alive, :2], last.radius_m[alive], **outline)


class WeatherPicture:
    """A PNG, a row for each state: from the side, cut through the middle, and from below."""

    def __init__(self, rows: int) -> None:
        self._figure = new_figure(2 * _WIDE_IN, 4.2 * rows)
        self._axes = self._figure.subplots(rows, 3, squeeze=False, width_ratios=(1.4, 1.4, 1.0))

    def draw(self, row: int, report: WeatherReport) -> None:
        """Draw a row; the state itself is not kept."""
        _draw_report(self._axes[row], report)

    def content(self) -> bytes:
        return figure_png(self._figure)


def _draw_report(axes: Sequence[Axes], report: WeatherReport) -> None:
    weather = report.weather
    width, depth, _ = weather.grid.size_m
    extinction = droplet_extinction(weather.cloud_water_kg_per_m3, report.droplet_radius_um)
    rain = rain_extinction(weather.rain_water_kg_per_m3)
    cell_m, up_m = weather.grid.cell_m[1], weather.grid.cell_m[2]
    row = int(np.argmax((extinction + rain).sum(axis=(0, 2))))
    across, low_km = (0.0, width / 1000), weather.grid.low_m[2] / 1000
    extent = (*across, low_km, low_km + weather.grid.size_m[2] / 1000)
    side = _tinted(extinction.sum(axis=1) * cell_m, rain.sum(axis=1) * cell_m)
    cut = _tinted(extinction[:, row] * 4 * cell_m, rain[:, row] * 4 * cell_m)
    below = _tinted(extinction.sum(axis=0) * up_m, rain.sum(axis=0) * up_m)
    title = f"{report.kind}, {weather.time_s:,.0f} s"
    for one, picture, text in ((axes[0], side, f"{title}, from the south"), (axes[1], cut, "cut through the thickest")):
        one.imshow(picture, origin="lower", extent=extent, aspect="auto", interpolation="nearest")
        one.set(title=text, xlabel="x, east (km)", ylabel="height (km)")
    axes[2].imshow(below, origin="lower", extent=(*across, 0.0, depth / 1000), interpolation="nearest")
    axes[2].set(title="from below", xlabel="x, east (km)", ylabel="y, north (km)")


def _tinted(cloud: NDArray[np.float32], rain: NDArray[np.float32]) -> Floats:
    """(rows, columns, 3): white clouds and grey rain before a blue sky, by their optical depths."""
    through = np.exp(-(cloud + rain))[..., None]
    share = (cloud / np.maximum(cloud + rain, 1e-12))[..., None]
    tinted: Floats = np.clip(through * _SKY + (1 - through) * (share + (1 - share) * _RAIN), 0.0, 1.0)
    return tinted
