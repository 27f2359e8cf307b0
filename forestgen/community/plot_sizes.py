"""The size hierarchy of a community: how many plants there are of each mass (Lane 2002, Figure 2.2)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from forestgen.community.plots import colours_of, new_figure, save_figure
from forestgen.community.population import Population, Status
from forestgen.community.size_statistics import fit_log_normal
from forestgen.community.statistics import plant_mass

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_BINS = 40
_MOST_ROWS = 6  # of species, the first of them
_FEW = 10  # times the median of a bin fit on a plain axis
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
    _tidy(plain)
    plain.set(xlabel=label, ylabel="plants")
    if by_species:
        _draw_plain(plain, by_species, colours)
    edges = _log_edges(by_species)
    for row in range(rows):
        axes = figure.add_subplot(grid[row, 1], xscale="log")
        _tidy(axes)
        if row < rows - 1:
            axes.tick_params(labelbottom=False)
        for name in list(by_species)[row : row + 1]:
            _draw_logarithmic(axes, name, by_species[name], edges, colours[name])
    axes.set_xlabel(label + ", logarithmic")
    save_figure(figure, path)


def _tidy(axes: Axes) -> None:
    axes.grid(axis="y", color="#DDDDDD", lw=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def _draw_plain(axes: Axes, by_species: Mapping[str, NDArray[np.float64]], colours: Mapping[str, str]) -> None:
    """Species upon each other; small plants may be many times more than all others, which the axis must still show."""
    largest = max(float(one.max()) for one in by_species.values())
    edges = np.linspace(0, largest, _BINS + 1)
    axes.hist(list(by_species.values()), bins=list(edges), stacked=True, color=[colours[name] for name in by_species])
    counts = np.histogram(np.concatenate(list(by_species.values())), edges)[0]
    if counts.max() > _FEW * np.median(counts[counts > 0]):
        axes.set_yscale("symlog", linthresh=1)
        axes.yaxis.set_major_formatter("{x:,.0f}")
    axes.set_xlim(0, largest)
    axes.set_ylim(bottom=0)


def _log_edges(by_species: Mapping[str, NDArray[np.float64]]) -> NDArray[np.float64]:
    """Edges of the bins as decimal logarithms, the same for all species."""
    if not by_species:
        return np.linspace(-1, 0, _BINS + 1)
    low = min(float(np.log10(one.min())) for one in by_species.values())
    high = max(float(np.log10(one.max())) for one in by_species.values())
    spare = max(0.02 * (high - low), (_LEAST_DECADES - (high - low)) / 2)
    return np.linspace(low - spare, high + spare, _BINS + 1)


def _draw_logarithmic(
    axes: Axes, name: str, mass: NDArray[np.float64], edges: NDArray[np.float64], colour: str
) -> None:
    axes.hist(mass, bins=list(10.0**edges), color=colour, alpha=0.55)
    axes.set_xlim(10.0 ** edges[0], 10.0 ** edges[-1])
    axes.set_ylabel(name)
    fit = fit_log_normal(mass)
    if fit is None:
        return
    x = np.linspace(edges[0], edges[-1], 300)
    z = (x * np.log(10) - fit.mu) / fit.sigma
    width = (edges[1] - edges[0]) * np.log(10) / fit.sigma
    axes.plot(10.0**x, fit.n * width * np.exp(-z * z / 2) / np.sqrt(2 * np.pi), color=colour, lw=2)
    axes.set_title(f"normal in the logarithm: μ = {fit.mu:.2f}, σ = {fit.sigma:.2g}".replace("-", "−"), fontsize=9)
