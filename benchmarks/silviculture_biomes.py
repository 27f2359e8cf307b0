"""The biomes for benchmarks/silviculture.py: what grows at Table 4's climates, and in what order."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import spearmanr
from silviculture_stands import Course, Report, grow_recipe

from forestgen.community.plots import new_figure
from forestgen.core.frames import BREAST_HEIGHT_M

FOLDER = Path(__file__).parents[1] / "recipes" / "biomes"


@dataclass(frozen=True)
class Row:
    """A line of Table 4."""

    figure: str
    plants: int
    types: int
    modules_k: float
    forest: bool  # closed stands of trees: not in the table, but in Fig. 2
    biomass_kg_per_m2: float  # mean dry mass of plants in such biomes, Whittaker (1975): the table has none


TABLE_4 = {  # those of its scenes that the text names; where two show a biome, the one from the row of transitions
    "desert": Row("13 b", 168, 2, 2.6, False, 0.7),
    "tundra": Row("11 a", 147, 2, 2.9, False, 0.6),
    "savanna": Row("1 a", 218, 3, 4.6, False, 4),
    "grassland": Row("11 f", 330, 3, 4.2, False, 1.6),
    "shrubland": Row("11 g", 423, 4, 14.38, False, 6),
    "boreal": Row("11 e", 640, 5, 37.49, True, 20),
    "temperate_seasonal": Row("11 h", 776, 4, 19.8, True, 30),
    "temperate_rain": Row("13 c", 767, 5, 13.6, True, 35),
    "tropical_seasonal": Row("12 a", 938, 7, 8.4, True, 35),
    "tropical_rain": Row("1 d", 1248, 6, 18.9, True, 45),
}


def zones(quick: bool) -> dict[str, Course]:
    """Every biome's recipe as it is; quick: its first 80 years."""
    settings = ["community.steps=80"] if quick else []
    return {name: grow_recipe(FOLDER / f"{name}.yaml", settings, every=1_000_000) for name in TABLE_4}


def biomes(report: Report, courses: dict[str, Course]) -> Figure:
    """Table 4: stems, height, wood and species of the biomes, in its order."""
    rows = [_measure(courses[name]) for name in TABLE_4]
    stems, height, wood, leaf, species, modules = (np.array(column) for column in zip(*rows, strict=True))
    for name, row in zip(TABLE_4, rows, strict=True):
        report.line(
            f"{name:26s} {row[0]:8.0f} stems/ha  {row[1]:5.1f} m  {row[2]:9.2f} t/ha of wood, {row[3]:6.2f} of leaves  "
            f"{row[4]} species"
        )
    paper = list(TABLE_4.values())
    forest = np.array([one.forest for one in paper])
    for what, ours, theirs in (
        ("Table 4, stems with its plants", stems, [one.plants for one in paper]),
        ("Table 4, species with its types", species, [one.types for one in paper]),
        ("biomass with Whittaker's means", wood + leaf, [one.biomass_kg_per_m2 for one in paper]),
    ):
        rank = float(spearmanr(ours, theirs).statistic) if np.ptp(ours) > 0 else float("nan")
        report.check(f"rank correlation: {what}", f"{rank:.2f}", rank >= 0.6, "0.6 at least")
    rank = float(spearmanr(modules, [one.modules_k for one in paper]).statistic)
    report.line(
        f"rank correlation of modules a hectare with the table's modules of a scene of unknown size: {rank:.2f}"
    )
    for what, ours in (("height", height), ("wood", wood)):
        least, most = float(ours[forest].min()), float(ours[~forest].max())
        report.check(
            f"Fig. 2, {what}: least forest over most open", f"{least / max(most, 1e-9):.2f}", least > most, "over 1"
        )
    return _draw(stems, height, wood, species)


def _measure(course: Course) -> tuple[float, float, float, float, int, float]:
    """Stems per hectare, height of the tallest tenth in metres, wood and leaves in t/ha, species that live, modules/ha.

    Stems are what a forester counts: plants that reach breast height.
    """
    last, area_ha = course.moments[-1], course.site.area_ha
    tall = np.sort(last.height_m)[-max(1, len(last) // 10) :] if len(last) else np.zeros(1)
    wood_t, leaf_t = (float(mass.sum()) / 1e3 / area_ha for mass in (last.wood_kg, last.leaf_kg))
    stems = float(np.sum(last.height_m > BREAST_HEIGHT_M)) / area_ha
    return stems, float(tall.mean()), wood_t, leaf_t, len(np.unique(last.species)), last.modules.sum() / area_ha


def _draw(stems: np.ndarray, height: np.ndarray, wood: np.ndarray, species: np.ndarray) -> Figure:
    figure = new_figure(10, 7)
    panels = figure.subplots(2, 2, sharex=True).ravel()
    for axes, values, label in zip(
        panels,
        (stems, height, wood, species),
        ("stems per hectare, over 1.3 m", "height of the tallest tenth (m)", "wood (t/ha)", "species"),
        strict=True,
    ):
        axes.bar(
            np.arange(len(values)), values, color=["#14532D" if one.forest else "#F08C00" for one in TABLE_4.values()]
        )
        axes.set_ylabel(label)
        axes.set_xticks(np.arange(len(values)), [name.replace("_", " ") for name in TABLE_4], rotation=60, ha="right")
    return figure
