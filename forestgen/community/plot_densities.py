"""The densities that a recipe asks for, and the plants that came of them (Lane 2002, Figures 5.3, 5.6 and 5.8)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from forestgen.community.model import Site
from forestgen.community.placement.model import Densities
from forestgen.community.plots import colours_of, darker, new_figure, save_figure
from forestgen.community.population import Population

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import PathCollection
    from matplotlib.image import AxesImage

_MOST_ROWS = 6  # of species, the first of them
_MOST_SHOWN = 640  # cells along a picture's longer side
_MOST_DOTS = 100_000  # of a species; more would be a blot
_PANEL_IN = 4.6
_WIDE, _DECADES = 100, 4  # times a tenth's density: a top beyond needs a logarithmic scale, of at most so many decades
_COLOURS = ("#FDFCF9", "#F6EDCB", "#E4E2A8", "#BFD695", "#93C492", "#6BB09A")  # none ... most; dots are darker still
_BARRED = "#5B5B5B"


def plot_densities(
    densities: Densities, placed: Population, site: Site, species_colours: Mapping[str, str], path: Path
) -> None:
    """A row for each species, as a PNG: the density asked for under the plants, and beside it the field that is left.

    Ground that the recipe bars is hatched. Only a model with kernels leaves a field. At most six species are shown. The
    scale is logarithmic where a tenth of the ground that has any density has less than a hundredth of the largest.
    """
    colours = colours_of(species_colours, placed.species_names)
    names = [name for name in densities.asked if densities.asked[name] or _any_plant(placed, name)][:_MOST_ROWS]
    left = densities.left_per_ha
    columns, rows = (2 if left is not None else 1), max(1, len(names))
    width, height = site.size_m
    longest = max(width, height)
    tall = 0.75 + _PANEL_IN * max(height / longest, 0.12)
    figure = new_figure(columns * (1.55 + _PANEL_IN * max(width / longest, 0.35)), rows * tall + 0.3)
    figure.set_layout_engine("compressed")  # colour bars as high as their pictures, whatever the site's shape
    axes = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    for row, name in enumerate(names):
        asked = densities.asked_per_ha[name]
        shown = draw_field(axes[row, 0], asked, site, densities.barred, logarithmic=_is_wide(asked))
        points_m = _points(placed, name)
        draw_dots(axes[row, 0], points_m, site, colours[name])
        axes[row, 0].set_title(_title(name, densities.asked[name], len(points_m)), fontsize=11)
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


def _is_wide(density: NDArray[np.float64]) -> bool:
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


def _any_plant(placed: Population, name: str) -> bool:
    return len(_points(placed, name)) > 0


def _points(placed: Population, name: str) -> NDArray[np.float64]:
    return np.asarray(placed.position_m[placed.species == placed.species_names.index(name), :2])


def _title(name: str, asked: int, placed: int) -> str:
    numbers = f"{placed:,} plants" if placed == asked else f"{placed:,} of {asked:,} plants"
    stride = _stride(placed)
    return f"{name}: {numbers}" + (f", one in {stride} shown" if stride > 1 else "")


def _stride(plants: int) -> int:
    return max(1, -(-plants // _MOST_DOTS))


def draw_field(
    axes: Axes,
    density: NDArray[np.float64],
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
    palette = LinearSegmentedColormap.from_list("density", _COLOURS).with_extremes(
        bad=_COLOURS[0]
    )  # 0 has no logarithm
    least = max(top / 10**_DECADES, float(some.min()) / 3 if len(some) else 0.0)  # what is least is not paper yet
    image = axes.imshow(
        _fewer(density), origin="lower", extent=(0, width, 0, height), cmap=palette,
        norm=LogNorm(least, top) if logarithmic else Normalize(0.0, top), interpolation="nearest", aspect="equal",
    )  # fmt: skip
    if barred is not None and barred.any():
        _hatch(axes, _fewer(barred.astype(np.float64)), site)
    return image


def _hatch(axes: Axes, barred: NDArray[np.float64], site: Site) -> None:
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


def _fewer(cells: NDArray[np.float64]) -> NDArray[np.float64]:
    """Means of square blocks of cells, so that a picture has no more of them than pixels."""
    by = math.ceil(max(cells.shape) / _MOST_SHOWN)
    if by == 1:
        return cells
    rows, cols = (max(1, side // by) for side in cells.shape)
    starts = [np.arange(n) * side // n for n, side in zip((rows, cols), cells.shape, strict=True)]
    sums = np.add.reduceat(np.add.reduceat(cells, starts[0], axis=0), starts[1], axis=1)
    sizes = [np.diff([*start, side]) for start, side in zip(starts, cells.shape, strict=True)]
    return np.asarray(sums / (sizes[0][:, None] * sizes[1][None, :]))


def draw_dots(axes: Axes, points_m: NDArray[np.float64], site: Site, colour: str) -> PathCollection:
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
