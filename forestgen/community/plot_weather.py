"""A picture of simulated weather."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.clouds.source import WeatherReport
from forestgen.atmosphere.extinction import droplet_extinction, rain_extinction

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_SKY, _RAIN = np.array([0.27, 0.45, 0.72]), np.array([0.35, 0.40, 0.50])
_WIDE_IN = 9.0


def plot_weather(reports: Sequence[WeatherReport], path: Path) -> None:
    """A row for each state: from the side, cut through the middle, and from below; as a PNG."""
    from forestgen.community.plots import new_figure, save_figure

    figure = new_figure(2 * _WIDE_IN, 4.2 * len(reports))
    axes = figure.subplots(len(reports), 3, squeeze=False, width_ratios=(1.4, 1.4, 1.0))
    for row, report in zip(axes, reports, strict=True):
        _draw(row, report)
    save_figure(figure, path)


def _draw(axes: Sequence[Axes], report: WeatherReport) -> None:
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


def _tinted(cloud: NDArray[np.float32], rain: NDArray[np.float32]) -> NDArray[np.float64]:
    """(rows, columns, 3): white clouds and grey rain before a blue sky, by their optical depths."""
    through = np.exp(-(cloud + rain))[..., None]
    share = (cloud / np.maximum(cloud + rain, 1e-12))[..., None]
    tinted: NDArray[np.float64] = np.clip(through * _SKY + (1 - through) * (share + (1 - share) * _RAIN), 0.0, 1.0)
    return tinted
