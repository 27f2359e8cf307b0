"""The sixteen plant types of Makowski 2023, Table 1, each grown alone: the sheet plant_types.png (its Figure 6).

Stems and branches only, seen from the south, each in a window of its own; run by `docs/pictures.py plant_types`.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from forestgen.architecture.geometry import node_diameters, node_positions
from forestgen.architecture.tables import tables_of
from forestgen.community.branch_modules.parameters import BranchModulesParameters
from forestgen.community.branch_modules.state import State
from forestgen.community.model import Site, SpeciesEcology
from forestgen.community.models.branch_modules import BranchModules
from forestgen.recipe.biome import shipped_plant_types
from forestgen.recipe.plant_type import PlantType

PICTURES = Path(__file__).parent / "pictures"
SEED = 2
COLUMNS = 4
# Row of Table 1 -> species, and the age at which it is shown, years.
TYPES: dict[str, tuple[str, int]] = {
    "a": ("shrub", 18),
    "b": ("juniper", 80),
    "c": ("palm", 50),
    "d": ("cholla", 14),
    "e": ("kapok", 150),
    "f": ("cypress", 90),
    "g": ("eucalyptus", 140),
    "h": ("pine", 120),
    "i": ("oak", 200),
    "j": ("larch", 120),
    "k": ("hemlock", 120),
    "l": ("sequoia", 180),
    "m": ("acacia", 100),
    "n": ("willow", 40),
    "o": ("spruce", 110),
    "p": ("baobab", 350),
}


def grown(name: str, years: int) -> tuple[State, PlantType]:
    """One plant of a shipped species, alone on its site under the climate that it likes best, without seedlings."""
    plant_type = shipped_plant_types()[name].model_copy(update={"seeds_per_yr": 0.0})
    ecology = SpeciesEcology(name, 0.1, 1.0, 0.5, 0.5, 0.0, 0.05, 5.0, 0.9, modules=plant_type)
    model = BranchModules()
    parameters = BranchModulesParameters.model_validate({"steps": years, "initial_plants": 1})
    state = model.init(parameters, Site((100.0, 100.0)), [ecology], SEED)
    for _ in range(years):
        state = model.step(state)
    return state, plant_type


def segments(state: State, plant_type: PlantType) -> tuple[np.ndarray, np.ndarray]:
    """(K, 2, 3) ends of the branch segments, metres from the foot, and (K,) their diameters, metres."""
    tables = tables_of(state.prototypes, [plant_type])
    types = np.zeros(len(state.plants), dtype=np.uint16)
    nodes = node_positions(tables, state.modules, types)
    prototype = np.repeat(state.modules.prototype, np.diff(nodes.start))
    begin = np.repeat(nodes.start[:-1], np.diff(nodes.start))
    parent = tables.parent[prototype, np.arange(len(begin)) - begin]
    drawn = nodes.length_m > 0
    ends = np.stack([nodes.position_m[(begin + np.maximum(parent, 0))[drawn]], nodes.position_m[drawn]], axis=1)
    return ends, node_diameters(tables, state.modules, types)[drawn]


def plant_types(_scratch: Path | None = None) -> None:
    """Draw the sheet."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    rows = -(-len(TYPES) // COLUMNS)
    figure, axes = plt.subplots(rows, COLUMNS, figsize=(COLUMNS * 2.4, rows * 2.6), dpi=100)
    figure.subplots_adjust(0.01, 0.01, 0.99, 0.96, 0.02, 0.16)
    for place, (row, (name, years)) in zip(axes.flat, TYPES.items(), strict=True):
        _draw(place, f"{row}  {name}, {years} years", *segments(*grown(name, years)))
    PICTURES.mkdir(exist_ok=True)
    figure.savefig(PICTURES / "plant_types.png")
    plt.close(figure)
    sys.stdout.write(f"{PICTURES / 'plant_types.png'}\n")


def _draw(place, title: str, ends: np.ndarray, diameter_m: np.ndarray) -> None:  # type: ignore[no-untyped-def]
    from matplotlib.collections import LineCollection

    height_m = float(ends[..., 2].max())
    left, right = float(ends[..., 0].min()), float(ends[..., 0].max())
    side = 1.05 * max(height_m, right - left)
    place.set_xlim((left + right - side) / 2, (left + right + side) / 2)
    place.set_ylim(0, side)
    place.set_aspect("equal")
    place.axis("off")
    points_per_m = 2.3 * 72 / side
    widths = np.maximum(diameter_m * points_per_m, 0.25)
    place.add_collection(LineCollection(list(ends[..., [0, 2]]), linewidths=widths, colors="#3a2c20", capstyle="round"))
    place.set_title(f"{title}: {height_m:.1f} m", fontsize=7)


if __name__ == "__main__":
    plant_types()
