"""A community in time: counts and cover of its species, and the self-thinning line (Lane 2002, Figures 2.1 and 4.4)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from forestgen.community.plots import colours_of, new_figure, save_figure, tidy
from forestgen.community.size_statistics import Slope
from forestgen.community.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_STYLES = ("-", "--", "-.", ":")  # a second cue beside colour
_LINE = "#222222"


def _draw_curves(
    axes: Axes, time_yr: NDArray[np.float64], values: NDArray[np.float64], colours: Mapping[str, str]
) -> None:
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

    Parameters
    ----------
    slope : that of the community, to be drawn too; see `trajectory.thinning_slope`.
    """
    colours = colours_of(species_colours, trajectory.species_names)
    figure = new_figure(6.4, 6.0)
    axes = figure.add_subplot(xscale="log", yscale="log")
    axes.set(xlabel="plants per hectare", ylabel=f"mean mass of a plant ({_unit(trajectory)})")
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


def _unit(trajectory: Trajectory) -> str:
    return "kg" if trajectory.mass_unit == "kg" else "radius³, m³"


def _draw_line(axes: Axes, points: NDArray[np.float64]) -> None:
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
