"""The size hierarchy of a community: how many plants there are of each mass (Lane 2002, Figure 2.2)."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np
from numpy.typing import NDArray

from forestgen.community.plots import colours_of, darker, new_figure, save_figure, tidy
from forestgen.community.population import Population, Status
from forestgen.community.size_statistics import fit_log_normal
from forestgen.community.statistics import plant_mass

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.container import BarContainer

_BINS = 40
_MOST_ROWS = 6  # of species, the first of them
_FEW = 10  # times the median of a bin fit on a plain axis
_SPARE = 1.03  # of the plain axis: the largest plants' bar is not its frame
_OUTLINE_PT = 0.6
_OWN_SHARE = 1 / 3  # of the common axis: a species that fills less of it has an axis of its own
_LEAST_DECADES = 0.05  # of the axis, for plants all alike


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


def _draw_plain(axes: Axes, by_species: Mapping[str, NDArray[np.float64]], colours: Mapping[str, str]) -> None:
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


def _few_ticks(axes: Axes, edges: NDArray[np.float64]) -> None:
    """Within a decade the library's labels would run into each other."""
    span = float(np.ptp(edges))
    if span >= 1:
        axes.xaxis.set_minor_formatter("")
        return
    at = edges[0] + span * np.array([0.1, 0.5, 0.9])
    axes.set_xticks([], minor=True)
    axes.set_xticks(list(10.0**at), [f"{one:.3g}" for one in 10.0**at])


def _log_edges(masses: Collection[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Edges of the bins as decimal logarithms, for plants of these masses."""
    if not masses:
        return np.linspace(-1, 0, _BINS + 1)
    low = min(float(np.log10(one.min())) for one in masses)
    high = max(float(np.log10(one.max())) for one in masses)
    spare = max(0.02 * (high - low), (_LEAST_DECADES - (high - low)) / 2)
    return np.linspace(low - spare, high + spare, _BINS + 1)


def _draw_logarithmic(
    axes: Axes, name: str, mass: NDArray[np.float64], edges: NDArray[np.float64], colour: str
) -> None:
    dark = darker(colour)
    axes.hist(
        mass,
        bins=list(10.0**edges),
        facecolor=(colour, 0.55),
        edgecolor=dark,
        linewidth=_OUTLINE_PT,
        histtype="stepfilled",
    )
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
