"""The picture of a fit: the stand beside a new one, the kernels, and the functions with their envelopes."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from forestgen.community.fitting.envelopes import STANDS, Envelope
from forestgen.community.fitting.fit import Fit
from forestgen.community.fitting.stand import MeasuredStand
from forestgen.community.plots import new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLOURS = ("#14532D", "#D95F02", "#4C5FB0")
_ENVELOPE, _MEAN, _STAND = "#CBD8C4", "#6B8F5E", "#B3261E"
_DPI = 160


def fit_picture(fit: Fit, title: str) -> bytes:
    """A PNG."""
    pairs = len(fit.stand.names) * (len(fit.stand.names) + 1) // 2
    columns = max(3, pairs)
    rows = 2 if pairs == 1 else 3
    figure = new_figure(4.1 * columns, 3.9 * rows)
    grid = figure.add_gridspec(rows, columns)
    _draw_stand(figure.add_subplot(grid[0, 0]), fit.stand, fit.stand.position_m, fit.stand.species, title)
    shown = fit.example.placed_m if fit.stand.step_m == 0 else fit.example.measured_m
    _draw_stand(figure.add_subplot(grid[0, 1]), fit.stand, shown, fit.example.species, "a new stand")
    _draw_kernels(figure.add_subplot(grid[0, 2]), fit)
    check = fit.checks[0]
    by_k = [one for one in check if one.name == "K"]
    if pairs == 1:
        _draw_l(figure.add_subplot(grid[1, 0]), by_k[0], fit.stand)
        _draw_correlation(figure.add_subplot(grid[1, 1]), next(one for one in check if one.name == "g"))
        _draw_nearest(figure.add_subplot(grid[1, 2]), check[-1], fit.stand)
    else:
        by_near = [one for one in check if one.name == "G" and one.species[0] <= one.species[1]]
        for column, (one, near) in enumerate(zip(by_k, by_near, strict=True)):
            _draw_l(figure.add_subplot(grid[1, column]), one, fit.stand)
            _draw_nearest(figure.add_subplot(grid[2, column]), near, fit.stand)
    _legend(figure)
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=_DPI, metadata={"Software": None})
    return content.getvalue()


def _legend(figure: Figure) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles = [
        Line2D([], [], color=_STAND, lw=1.8, label="measured stand"),
        Line2D([], [], color=_MEAN, lw=1.4, ls="--", label=f"mean of {STANDS} new stands"),
        Patch(color=_ENVELOPE, label="their envelope"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False, fontsize=11)


def _draw_stand(
    axes: Axes, stand: MeasuredStand, position_m: NDArray[np.float64], species: NDArray[np.int64], title: str
) -> None:
    size = float(np.clip(2600 / max(len(position_m), 1), 2.0, 42.0))
    for k, name in enumerate(stand.names):
        mine = position_m[species == k]
        axes.scatter(mine[:, 0], mine[:, 1], s=size, color=_COLOURS[k], alpha=0.85, lw=0, label=name)
    axes.set(aspect="equal", xlim=(0, stand.size_m[0]), ylim=(0, stand.size_m[1]), facecolor="#FAF8F3")
    axes.set_xlabel("x (m)")
    axes.set_title(f"{title}: {len(position_m)} plants", fontsize=12)
    if len(stand.names) > 1:
        axes.legend(loc="upper right", fontsize=9, framealpha=0.9)


def _draw_kernels(axes: Axes, fit: Fit) -> None:
    """κ on a scale of octaves: a factor of two up is as far as one down."""
    least = 1 / 16
    axes.axhline(1.0, color="#999999", lw=0.8)
    styles = ("-", "--", ":")
    for k, (points, (i, j)) in enumerate(
        zip(fit.shapes.control_points(fit.matched.log_kappa), fit.shapes.pairs, strict=True)
    ):
        r, kappa = np.array(points).T
        names = fit.kinds
        label = names[j] if i == j else f"{names[j]} {'→' if fit.directed else '↔'} {names[i]}"
        colour = _COLOURS[i] if i == j else "#555555"
        axes.plot(r, np.maximum(kappa, least), color=colour, lw=2, ls=styles[0 if i == j else 1 + k % 2], label=label)
    axes.set_yscale("log", base=2)
    axes.set_ylim(bottom=least)
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}" if value > least else "0")
    axes.set(xlabel="distance (m)", xlim=(0, fit.shapes.reach_m))
    axes.set_title("fitted kernel κ" if len(fit.shapes.pairs) == 1 else "fitted kernels κ", fontsize=12)
    if len(fit.shapes.pairs) > 1:
        axes.legend(fontsize=9, framealpha=0.9)


def _band(axes: Axes, radii: NDArray[np.float64], low: NDArray[np.float64], mean: NDArray[np.float64],
          high: NDArray[np.float64], stand: NDArray[np.float64]) -> None:  # fmt: skip
    axes.fill_between(radii, low, high, color=_ENVELOPE, lw=0)
    axes.plot(radii, mean, color=_MEAN, lw=1.4, ls="--")
    axes.plot(radii, stand, color=_STAND, lw=1.8)
    axes.set_xlim(0, radii[-1])
    axes.set_xlabel("r (m)")


def _of(one: Envelope, stand: MeasuredStand, arrow: str) -> str:
    if len(stand.names) == 1:
        return ""
    i, j = one.species
    return f" of {stand.names[i]}" if i == j else f": {stand.names[i]} {arrow} {stand.names[j]}"


def _draw_l(axes: Axes, one: Envelope, stand: MeasuredStand) -> None:
    excess = [np.sqrt(k / np.pi) - one.radii_m for k in (one.low, one.mean, one.high, one.stand)]
    axes.axhline(0.0, color="#999999", lw=0.8)
    _band(axes, one.radii_m, *excess)
    axes.set_title(f"L(r) - r (m){_of(one, stand, '↔')}", fontsize=12)


def _draw_nearest(axes: Axes, one: Envelope, stand: MeasuredStand) -> None:
    _band(axes, one.radii_m, one.low, one.mean, one.high, one.stand)
    axes.set_ylim(0, 1.02)
    axes.set_title(f"G(r), nearest neighbours{_of(one, stand, '→')}", fontsize=12)


def _draw_correlation(axes: Axes, one: Envelope) -> None:
    axes.axhline(1.0, color="#999999", lw=0.8)
    _band(axes, one.radii_m, one.low, one.mean, one.high, one.stand)
    axes.set_title("pair correlation g(r)", fontsize=12)
