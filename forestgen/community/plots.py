"""What pictures of a community share, and its map: circles to scale (Lane 2002, Figure 4.5, left)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal, cast

import numpy as np

from forestgen.community.model import Site
from forestgen.community.obstacles import NO_OBSTACLES, Obstacles
from forestgen.community.population import Population, Status
from forestgen.community.statistics import count_by_species
from forestgen.core.errors import OutputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

HERB, DECIDUOUS, CONIFER = "#D6409F", "#F08C00", "#14532D"  # apart in lightness too, for the colour-blind and in grey
_OTHERS = ("#0072B2", "#56B4E9", "#7A5195", "#8C564B", "#666666")
_DPI = 160
_MAP_IN = 6.3  # longer side of a map
_PAPER = "#FAF8F3"
OBSTACLE, _OBSTACLE_EDGE = "#9A9A9A", "#4D4D4D"  # grey, as no species is unless its file says so
_LEGEND_COLUMNS, _LEGEND_COLUMN_IN, _LEGEND_ROW_IN = 3, 2.0, 0.235
_MARGINS_IN = (0.75, 0.35, 0.6, 0.4)  # left, right, below without the legend, above
_LEAST_WIDTH_IN, _LEAST_HEIGHT_IN = 2.5, 0.6  # of what lies between: a narrow site has a title, too
_DARKER, _LIGHTEST = 0.7, 0.35  # edges and dots: times their fill's colour; and their lightness at most, 0 to 1
_EDGE_PT, _EDGE_SHARE = 0.4, 0.35  # thickness of edges at most, and of a small circle's in its radii
_MOST_NAMED = 29  # species below a map, or they would leave it no room
_LEAST_RADIUS_PT, _MOST_SHARE = 1.4, 0.12  # a plant too small to be seen is a dot; share of the map under all dots


def colours_of(species_colours: Mapping[str, str], names: Sequence[str]) -> dict[str, str]:
    """A colour for each species: the given one, else the next of a palette."""
    rest = iter(_OTHERS * (1 + len(names) // len(_OTHERS)))
    return {name: species_colours[name] if name in species_colours else next(rest) for name in names}


def darker(colour: str) -> tuple[float, float, float]:
    """Red, green and blue of a species' edges and dots: they show on paper even where petals are white."""
    from matplotlib.colors import to_rgb

    red, green, blue = to_rgb(colour)
    lightness = max(0.21 * red + 0.72 * green + 0.07 * blue, 1e-6)
    by = min(_DARKER, _LIGHTEST / lightness)
    return by * red, by * green, by * blue


def new_figure(width_in: float, height_in: float) -> Figure:
    """A figure of a size in inches."""
    # Late, for matplotlib takes half a second; a Figure without pyplot keeps no global state and draws with Agg.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure as a PNG, or raise `OutputError`."""
    try:
        # Without the name of the library's version the same picture has the same bytes.
        figure.savefig(path, format="png", dpi=_DPI, metadata={"Software": None})
    except OSError as error:
        raise OutputError("the picture cannot be written", where=str(path), got=str(error)) from error


def tidy(axes: Axes, grid: Literal["both", "y"] = "both") -> None:
    """A faint grid behind what is drawn, and no frame above and at the right."""
    axes.grid(axis=grid, color="#DDDDDD", lw=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def _draw_circles(axes: Axes, population: Population, site: Site, colours: Mapping[str, str], repeat: bool) -> None:
    """Small circles above large ones, so that none is hidden; with `repeat`, also those that reach over an edge."""
    from matplotlib.collections import EllipseCollection
    from matplotlib.colors import to_rgba

    alive = np.flatnonzero(population.status != Status.DEAD)
    order = alive[np.argsort(-population.radius_m[alive], kind="stable")]
    xy, r = population.position_m[order, :2], population.radius_m[order]
    names = population.species_names
    fill = np.array([to_rgba(colours[name], 0.55) for name in names]).reshape(-1, 4)[population.species[order]]
    edge = np.array([darker(colours[name]) for name in names]).reshape(-1, 3)[population.species[order]]
    shown = np.maximum(r, _least_radius_m(len(r), site))
    shifts = [(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1)] if repeat else [(0, 0)]
    width, height = site.size_m
    index, offsets = [], []
    for a, b in shifts:
        moved = xy + np.array([a * width, b * height])
        seen = np.all((moved + r[:, None] > 0) & (moved - r[:, None] < (width, height)), axis=1)
        index.append(np.flatnonzero(seen))
        offsets.append(moved[seen])
    pick, where = np.concatenate(index), np.concatenate(offsets)
    drawn = np.argsort(pick, kind="stable")
    pick, where = pick[drawn], where[drawn]
    axes.add_collection(
        EllipseCollection(
            2 * shown[pick], 2 * shown[pick], np.zeros(len(pick)), units="xy",
            offsets=where, offset_transform=axes.transData, facecolors=fill[pick], edgecolors=edge[pick],
            linewidths=np.minimum(_EDGE_PT, _EDGE_SHARE * shown[pick] * _points_per_m(site)),
        )
    )  # fmt: skip


def _points_per_m(site: Site) -> float:
    return 72 * _MAP_IN / max(site.size_m)


def _least_radius_m(plants: int, site: Site) -> float:
    """Radius of the smallest circle that is drawn, metres: a dot, but so small that all plants leave paper between."""
    crowded_m = math.sqrt(_MOST_SHARE * site.area_m2 / (math.pi * max(plants, 1)))
    return min(_LEAST_RADIUS_PT / _points_per_m(site), crowded_m)


def plot_map(
    population: Population,
    site: Site,
    species_colours: Mapping[str, str],
    path: Path,
    *,
    periodic: bool = True,
    obstacles: Obstacles = NO_OBSTACLES,
) -> None:
    """Write `map_figure` as a PNG."""
    save_figure(map_figure(population, site, species_colours, periodic=periodic, obstacles=obstacles), path)


def map_figure(
    population: Population,
    site: Site,
    species_colours: Mapping[str, str],
    *,
    periodic: bool = True,
    obstacles: Obstacles = NO_OBSTACLES,
    axes: Axes | None = None,
) -> Figure:
    """Circles of all living plants to scale; `periodic` repeats those that reach over an edge.

    A plant that would be smaller than a dot is drawn as a dot; an obstacle, which is no plant of the population
    (`Obstacles.left_out_of`), is its grey ground plan. With `axes` the map is drawn there.
    """
    colours, counts = colours_of(species_colours, population.species_names), count_by_species(population)
    handles = _map_legend(colours, counts, obstacles)
    if axes is None:
        figure, axes = _map_axes(site, handles)
    else:
        figure = cast("Figure", axes.get_figure(root=True))
        axes.set(xlim=(0, site.size_m[0]), ylim=(0, site.size_m[1]), aspect="equal", facecolor=_PAPER)
        axes.legend(handles=handles, loc="upper left", bbox_to_anchor=(1, 1), frameon=False)
    axes.set(xlabel="x, east (m)", ylabel="y, north (m)")
    axes.set_title(f"{population.time_yr:g} years, {sum(counts.values()):,} plants", fontsize=12)
    _draw_outlines(axes, obstacles)
    _draw_circles(axes, population, site, colours, periodic)
    return figure


def _map_axes(site: Site, handles: Sequence[Line2D]) -> tuple[Figure, Axes]:
    """A figure with room for the site to scale, a title above, and a legend below.

    All is placed in inches: matplotlib's own layout cuts the title off axes of a fixed aspect.
    """
    width, height = (_MAP_IN * side / max(site.size_m) for side in site.size_m)
    left, right, below, above = _MARGINS_IN
    wide, high = left + max(width, _LEAST_WIDTH_IN) + right, max(height, _LEAST_HEIGHT_IN)
    columns = max(1, min(_LEGEND_COLUMNS, int(wide / _LEGEND_COLUMN_IN)))
    foot = below + _LEGEND_ROW_IN * -(-len(handles) // columns)
    figure = new_figure(wide, foot + high + above)
    figure.set_layout_engine("none")
    tall = foot + high + above
    corner = (left + (wide - left - right - width) / 2) / wide, (foot + (high - height) / 2) / tall
    axes = figure.add_axes((*corner, width / wide, height / tall))
    axes.set(xlim=(0, site.size_m[0]), ylim=(0, site.size_m[1]), facecolor=_PAPER)
    figure.legend(
        handles=handles, loc="lower center", ncols=columns, frameon=False, fontsize=11, borderaxespad=0.2,
    )  # fmt: skip
    return figure, axes


def _draw_outlines(axes: Axes, obstacles: Obstacles) -> None:
    """Below the circles: crowns may hang over a roof."""
    from matplotlib.patches import Polygon

    for one in obstacles.entries:
        axes.add_patch(Polygon(one.corners_m(), closed=True, fc=OBSTACLE, ec=_OBSTACLE_EDGE, lw=1.0, zorder=0.5))


def _map_legend(colours: Mapping[str, str], counts: Mapping[str, int], obstacles: Obstacles) -> list[Line2D]:
    """A mark for each species and its number of plants, and for each kind of obstacle."""
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], ls="", marker="o", ms=9, mfc=(one, 0.55), mec=darker(one), label=f"{name} ({counts[name]:,})")
        for name, one in list(colours.items())[:_MOST_NAMED]
    ]
    if len(colours) > _MOST_NAMED:
        handles.append(Line2D([], [], ls="", label=f"and {len(colours) - _MOST_NAMED} more species"))
    for name, number in obstacles.counts.items():
        label = f"{name}, obstacle ({number:,})"
        handles.append(Line2D([], [], ls="", marker="s", ms=9, mfc=OBSTACLE, mec=_OBSTACLE_EDGE, label=label))
    return handles
