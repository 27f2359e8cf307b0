"""Pictures of a stand table: heights over diameters, and the leaves' area by height."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from forestgen.community.plots import colours_of, darker, figure_png, new_figure, tidy
from forestgen.dataset.files import write_bytes
from forestgen.dataset.manifest import write_manifest
from forestgen.instruments.stand_table import StandTable
from forestgen.recipe.load import LoadedRecipe

_SIZE_IN = (6.4, 4.6)
_MARKERS = "o^sDvP"  # of species, whose colours may be alike


def write_stand(folder: Path, table: StandTable, loaded: LoadedRecipe) -> None:
    """Write stand.csv, stand.json, the pictures and manifest.json, or raise `OutputError`."""
    for ending in (".csv", ".json"):
        write_bytes(folder / f"stand{ending}", table.content(ending, loaded))
    write_bytes(folder / "height_diameter.png", height_diameter_png(table))
    write_bytes(folder / "leaf_area_profile.png", leaf_area_profile_png(table))
    seeds = [loaded.draw(0).image_seed]
    write_manifest(folder, recipe_hash=loaded.hash, root_seed=loaded.seed, image_seeds=seeds, timings_s={})


def height_diameter_png(table: StandTable) -> bytes:
    """Height over diameter at 1.3 m, a dot a living plant of 1 cm and more."""
    figure = new_figure(*_SIZE_IN)
    axes = figure.add_subplot()
    names = list(dict.fromkeys(table.species.tolist()))
    for number, (name, colour) in enumerate(colours_of(table.colours, names).items()):
        mine = table.species == name
        axes.scatter(
            100 * table.dbh_m[mine],
            table.height_m[mine],
            18,
            color=darker(colour),
            marker=_MARKERS[number % len(_MARKERS)],
            alpha=0.6,
            lw=0,
            label=f"{name} ({int(mine.sum()):,})",
        )
    axes.axvline(table.min_dbh_cm, color="#666666", lw=0.8, ls="--")
    axes.set(xlabel="diameter at 1.3 m (cm)", ylabel="height (m)", xlim=(0, None), ylim=(0, None))
    axes.set_title(f"{table.total.stems_per_ha:,.0f} stems/ha from {table.min_dbh_cm:g} cm on", fontsize=10)
    tidy(axes)
    if names:
        axes.legend(frameon=False, fontsize=8, loc="lower right")
    return figure_png(figure)


def leaf_area_profile_png(table: StandTable) -> bytes:
    """Leaf area density by height, the species one on the other."""
    figure = new_figure(_SIZE_IN[1], _SIZE_IN[0])
    axes = figure.add_subplot()
    edges_m, left = table.layer_edges_m, np.zeros(len(table.layer_edges_m) - 1)
    for name, colour in colours_of(table.colours, list(table.leaf_area_density)).items():
        density = table.leaf_area_density[name]
        index = float(np.sum(density * np.diff(edges_m)))
        axes.barh(
            edges_m[:-1], density, np.diff(edges_m), left, align="edge", color=colour, label=f"{name} {index:.2f}"
        )
        left = left + density
    axes.set(xlabel="leaf area density (m²/m³)", ylabel="height above the stem base (m)")
    axes.set(xlim=(0, None), ylim=(0, edges_m[-1]))
    axes.set_title(f"leaf area index {table.total.leaf_area_index:.2f}", fontsize=10)
    tidy(axes)
    if table.leaf_area_density:
        axes.legend(frameon=False, fontsize=8)
    return figure_png(figure)
