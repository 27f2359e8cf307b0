"""What pictures of a community share; its map, circles to scale; and pictures of the densities that a recipe asks for.

References: Lane 2002, Figure 4.5, left (the map), and Figures 5.3, 5.6 and 5.8 (densities).
"""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from forestgen.community.population import Floats, Population, Site, Status, count_by_species
from forestgen.community.simulation import NO_OBSTACLES, Obstacles
from forestgen.core.errors import writing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import PathCollection
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage
    from matplotlib.lines import Line2D

    from forestgen.community.placement.model import Densities

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
_MOST_ROWS = 6  # of species, the first of them
_MOST_SHOWN = 640  # cells along a picture's longer side
_MOST_DOTS = 100_000  # of a species; more would be a blot
_PANEL_IN = 4.6
_WIDE, _DECADES = 100, 4  # a top so many times a tenth's density has a logarithmic scale, of so many decades
_DENSITY_COLOURS = ("#FDFCF9", "#F6EDCB", "#E4E2A8", "#BFD695", "#93C492", "#6BB09A")  # none ... most
_BARRED = "#5B5B5B"


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


def figure_png(figure: Figure) -> bytes:
    """A figure as a PNG."""
    stream = io.BytesIO()
    # Without the name of the library's version the same picture has the same bytes.
    figure.savefig(stream, format="png", dpi=_DPI, metadata={"Software": None})
    return stream.getvalue()


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure as a PNG, or raise `OutputError`."""
    with writing(path, "the picture cannot be written"):
        path.write_bytes(figure_png(figure))


def tidy(axes: Axes, grid: Literal["both", "y"] = "both") -> None:
    """A faint grid behind what is drawn, and no frame above and at the right."""
    axes.grid(axis=grid, color="#DDDDDD", lw=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def _draw_circles(axes: Axes, population: Population, site: Site, colours: Mapping[str, str], repeat: bool) -> None:
    """Small circles above large ones, so that none is hidden; with `repeat`, also those that reach over an edge."""
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
    thick = np.minimum(_EDGE_PT, _EDGE_SHARE * shown[pick] * _points_per_m(site))
    draw_discs(axes, where, shown[pick], facecolors=fill[pick], edgecolors=edge[pick], linewidths=thick)


def draw_discs(axes: Axes, centre_m: Floats, radius_m: Floats, **style: Any) -> None:
    """Circles to scale, (N, 2) centres and (N,) radii in metres."""
    from matplotlib.collections import EllipseCollection

    across, level = 2 * radius_m, np.zeros(len(radius_m))
    places: dict[str, Any] = {"units": "xy", "offsets": centre_m, "offset_transform": axes.transData}
    axes.add_collection(EllipseCollection(across, across, level, **places, **style))


def _points_per_m(site: Site) -> float:
    return 72 * _MAP_IN / max(site.size_m)


def _least_radius_m(plants: int, site: Site) -> float:
    """Radius of the smallest circle that is drawn, metres: a dot, but so small that all plants leave paper between."""
    crowded_m = math.sqrt(_MOST_SHARE * site.area_m2 / (math.pi * max(plants, 1)))
    return min(_LEAST_RADIUS_PT / _points_per_m(site), crowded_m)


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


def plot_densities(
    densities: Densities, placed: Population, site: Site, species_colours: Mapping[str, str], path: Path
) -> None:
    """A row for each species, as a PNG: the density asked for under the plants, and beside it the field that is left.

    Ground that the recipe bars is hatched. Only a model with kernels leaves a field. At most six species are shown. The
    scale is logarithmic where a tenth of the ground that has any density has less than a hundredth of the largest.
    """
    colours = colours_of(species_colours, placed.species_names)
    points_m = {name: placed.position_m[placed.species == index, :2] for index, name in enumerate(placed.species_names)}
    names = [name for name in densities.asked if densities.asked[name] or len(points_m[name])][:_MOST_ROWS]
    left = densities.left_per_ha
    columns, rows = (2 if left is not None else 1), max(1, len(names))
    width, height = site.size_m
    longest = max(width, height)
    tall = 0.75 + _PANEL_IN * max(height / longest, 0.12)
    figure = new_figure(columns * (1.55 + _PANEL_IN * max(width / longest, 0.35)), rows * tall + 0.3)
    figure.set_layout_engine("compressed")  # colour bars as high as their pictures, whatever the site's shape
    axes = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    for row, name in enumerate(names):
        asked, n, stride = densities.asked_per_ha[name], len(points_m[name]), _stride(len(points_m[name]))
        shown = draw_field(axes[row, 0], asked, site, densities.barred, logarithmic=_is_wide(asked))
        draw_dots(axes[row, 0], points_m[name], site, colours[name])
        numbers = f"{n:,} plants" if n == densities.asked[name] else f"{n:,} of {densities.asked[name]:,} plants"
        title = f"{name}: {numbers}" + (f", one in {stride} shown" if stride > 1 else "")
        axes[row, 0].set_title(title, fontsize=11)
        _bar(shown, "asked for, plants per hectare")
        if left is not None:
            field = draw_field(
                axes[row, 1], left[name], site, densities.barred, float(asked.max()), logarithmic=_is_wide(left[name])
            )
            axes[row, 1].set_title(f"{name}: the field after all plants", fontsize=11)
            _bar(field, "plants per hectare, times κ", beyond=left[name].max() > (field.norm.vmax or 0))
        axes[row, 0].set_ylabel("y, north (m)")
    for one in axes[-1]:
        one.set_xlabel("x, east (m)")
    save_figure(figure, path)


def _is_wide(density: Floats) -> bool:
    some = density[density > 0]
    return len(some) > 0 and float(np.quantile(some, 0.995)) > _WIDE * float(np.quantile(some, 0.1))


def _bar(image: AxesImage, label: str, beyond: bool = False) -> None:
    """A colour bar beside the picture; `beyond`: some cells lie above its top."""
    figure = image.get_figure(root=True)
    assert figure is not None
    extend = "max" if beyond else "neither"
    logarithmic = image.norm.vmin != 0
    label += ", logarithmic" if logarithmic else ""
    bar = figure.colorbar(image, ax=image.axes, label=label, extend=extend, format=_number, aspect=28, pad=0.02)
    if logarithmic:
        bar.ax.yaxis.set_minor_formatter("")


def _number(value: float, _: object) -> str:
    """A tick's number, with commas from a thousand on."""
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.4g}"


def _stride(plants: int) -> int:
    return max(1, -(-plants // _MOST_DOTS))


def draw_field(
    axes: Axes,
    density: Floats,
    site: Site,
    barred: NDArray[np.bool_] | None = None,
    least_top: float = 0.0,
    *,
    logarithmic: bool = False,
) -> AxesImage:
    """A density over the site, paper where there is none; ground that is barred is hatched.

    The darkest colour is that of the largest cell, but for a few in a thousand, which clusters may lift far above all
    others; and of `least_top` at least. A logarithmic scale ends four decades below: what is less is paper.
    """
    from matplotlib.colors import LinearSegmentedColormap, LogNorm, Normalize

    width, height = site.size_m
    some = density[density > 0]
    top = max(least_top, float(np.quantile(some, 0.995)) if len(some) else 0.0) or 1.0
    colours = LinearSegmentedColormap.from_list("density", _DENSITY_COLOURS)
    palette = colours.with_extremes(bad=_DENSITY_COLOURS[0])  # 0 has no logarithm
    least = max(top / 10**_DECADES, float(some.min()) / 3 if len(some) else 0.0)  # what is least is not paper yet
    image = axes.imshow(
        _fewer(density), origin="lower", extent=(0, width, 0, height), cmap=palette,
        norm=LogNorm(least, top) if logarithmic else Normalize(0.0, top), interpolation="nearest", aspect="equal",
    )  # fmt: skip
    if barred is not None and barred.any():
        _hatch(axes, _fewer(barred.astype(np.float64)), site)
    return image


def _hatch(axes: Axes, barred: Floats, site: Site) -> None:
    """Lines over the ground that is barred, and its outline."""
    rows, cols = barred.shape
    width, height = site.size_m
    framed = np.pad(barred, 1)  # so that a region at the site's edge is closed
    x = (np.arange(-1, cols + 1) + 0.5) * (width / cols)
    y = (np.arange(-1, rows + 1) + 0.5) * (height / rows)
    style: dict[str, Any] = {"levels": [0.5, 1.5], "colors": "none", "hatches": ["////"]}
    drawn = axes.contourf(np.clip(x, 0, width), np.clip(y, 0, height), framed, **style)
    drawn.set_edgecolor(_BARRED)
    drawn.set_linewidth(0.0)
    axes.contour(np.clip(x, 0, width), np.clip(y, 0, height), framed, levels=[0.5], colors=_BARRED, linewidths=0.8)


def _fewer(cells: Floats) -> Floats:
    """Means of square blocks of cells, so that a picture has no more of them than pixels."""
    by = math.ceil(max(cells.shape) / _MOST_SHOWN)
    if by == 1:
        return cells
    rows, cols = (max(1, side // by) for side in cells.shape)
    starts = [np.arange(n) * side // n for n, side in zip((rows, cols), cells.shape, strict=True)]
    sums = np.add.reduceat(np.add.reduceat(cells, starts[0], axis=0), starts[1], axis=1)
    sizes = [np.diff([*start, side]) for start, side in zip(starts, cells.shape, strict=True)]
    return np.asarray(sums / (sizes[0][:, None] * sizes[1][None, :]))


def draw_dots(axes: Axes, points_m: Floats, site: Site, colour: str) -> PathCollection:
    """(N, 2) plants as dots, the smaller the more there are: ten thousand must not hide the density below them."""
    points_m = points_m[:: _stride(len(points_m))]
    longest = max(site.size_m)
    crowded = max(1.0, len(points_m) * longest**2 / site.area_m2)
    dots = axes.scatter(
        points_m[:, 0], points_m[:, 1], s=float(np.clip(6000 / crowded, 0.12, 22.0)), color=[darker(colour)],
        edgecolors="white" if crowded < 600 else "none", linewidths=0.35, zorder=3, clip_on=crowded >= 600,
    )  # fmt: skip
    axes.set(xlim=(0, site.size_m[0]), ylim=(0, site.size_m[1]))
    return dots
