"""The water of a community in time, and where it is at the end: rain, uptake, loss, stored; soil water under plants."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from forestgen.community.model import Site
from forestgen.community.plots import colours_of, darker, new_figure, save_figure, tidy
from forestgen.community.population import Population, Status

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SOIL = "soil_water_mm"  # the map
_FLOWS = {
    "rain": ("#0072B2", "-"),
    "uptake": ("#14803C", "-"),
    "loss": ("#D55E00", "--"),
}  # name -> colour and style: by both
_STORED = "#3B3B3B"
_COLOURS = ("#F4E9CD", "#CFE0C3", "#8FC1C4", "#4A90B8", "#1F5A96", "#12305F")  # dry ... wet
_WETTEST = 0.98  # share of the ground that the scale ends above: hollows hold many times what slopes do
_MOST_POINTS = 300
_MAP_IN, _CURVES_IN = 6.0, 6.2
_MOST_NAMED = 12


@dataclass(frozen=True)
class WaterSeries:
    """Where the water went by snapshot, (T,) each: sums since the beginning, means over the site, mm."""

    time_yr: NDArray[np.float64]
    stored_mm: NDArray[np.float64]  # on the ground and in the soil
    rain_mm: NDArray[np.float64]
    uptake_mm: NDArray[np.float64]
    loss_mm: NDArray[np.float64]

    @classmethod
    def of(cls, told: Sequence[tuple[float, Mapping[str, Any]]]) -> Self:
        """Of times and states' ``water``, as `Population.state` has it."""
        names = ("stored_mm", "rain_mm", "uptake_mm", "loss_mm")
        values = ([float(water[name]) for _, water in told] for name in names)
        return cls(np.array([time for time, _ in told]), *(np.array(one) for one in values))

    def periods_yr(self) -> NDArray[np.float64]:
        """Ends of periods: of whole years, at most some hundred, or the snapshots' own where the years are fewer."""
        first, last = self.time_yr[0], self.time_yr[-1]
        years = math.floor(last - first + 1e-6)
        if years < 3:
            return self.time_yr
        stride = math.ceil(years / _MOST_POINTS)
        return np.asarray(first + np.arange(0, years + 1, stride))

    def rates_mm_per_yr(self, ends_yr: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
        """(T - 1,) rain, uptake and loss between times."""
        sums = {"rain": self.rain_mm, "uptake": self.uptake_mm, "loss": self.loss_mm}
        apart = np.diff(ends_yr)
        return {name: np.diff(np.interp(ends_yr, self.time_yr, one)) / apart for name, one in sums.items()}


def plot_water(
    series: WaterSeries, last: Population, site: Site, species_colours: Mapping[str, str], path: Path
) -> None:
    """Flows and store of water in time, beside the last map of soil water with the crowns above it, as a PNG.

    Flows are those of whole years, where there are three at least; the store is that of every snapshot. It changes by
    rain less uptake less loss.
    """
    width, height = site.size_m
    longest = max(width, height)
    map_in = 1.6 + _MAP_IN * max(width / longest, 0.35), 1.5 + _MAP_IN * max(height / longest, 0.4)
    figure = new_figure(_CURVES_IN + map_in[0], max(map_in[1], 5.6))
    halves: Any = figure.subfigures(1, 2, width_ratios=(_CURVES_IN, map_in[0]))
    left, right = halves
    above, below = left.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    _draw_flows(above, series)
    _draw_store(below, series)
    _draw_soil(right, last, site, colours_of(species_colours, last.species_names))
    save_figure(figure, path)


def _draw_flows(axes: Axes, series: WaterSeries) -> None:
    ends = series.periods_yr()
    for name, values in series.rates_mm_per_yr(ends).items():
        colour, style = _FLOWS[name]
        axes.stairs(values, ends, color=colour, ls=style, lw=1.8, label=name, baseline=None)
    axes.set(ylabel="mm a year", ylim=(0, None), xlim=(series.time_yr[0], series.time_yr[-1]))
    axes.set_title(
        "means between snapshots" if ends is series.time_yr else _years(ends[1] - ends[0]), fontsize=10, loc="left"
    )
    axes.legend(frameon=False, fontsize=10, ncols=3, loc="lower right", bbox_to_anchor=(1.02, 0.99))
    tidy(axes)


def _years(count: float) -> str:
    return "sums of each year" if round(count) == 1 else f"means of {round(count)} years"


def _draw_store(axes: Axes, series: WaterSeries) -> None:
    axes.plot(series.time_yr, series.stored_mm, color=_STORED, lw=1.0 if len(series.time_yr) > 200 else 1.6)
    axes.set(ylabel="stored in soil and\non the ground (mm)", xlabel="time (years)", ylim=(0, None))
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
        cmap=LinearSegmentedColormap.from_list("soil", _COLOURS),
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
    ][:_MOST_NAMED]
    if handles:
        figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False, fontsize=10)


def _draw_crowns(axes: Axes, last: Population, colours: Mapping[str, str]) -> None:
    """Outlines, through which the ground shows; they thin out where plants are many."""
    from matplotlib.collections import EllipseCollection

    alive = np.flatnonzero(last.status != Status.DEAD)
    edges = np.array([darker(colours[name]) for name in last.species_names]).reshape(-1, 3)
    across = 2 * last.radius_m[alive]
    axes.add_collection(
        EllipseCollection(
            across, across, np.zeros(len(alive)), units="xy", offsets=last.position_m[alive, :2],
            offset_transform=axes.transData, facecolors="none", edgecolors=edges[last.species[alive]],
            linewidths=float(np.clip(30 / math.sqrt(max(len(alive), 1)), 0.25, 1.4)),
        )
    )  # fmt: skip
