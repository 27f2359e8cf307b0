"""Stands of recipes of coupled ecoclimates, kept every few years: for valleys and edges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.community.ecoclimate.months import worth_mm_per_yr
from forestgen.community.ecoclimate.parameters import EcoclimateParameters
from forestgen.community.population import Population
from forestgen.community.simulation import snapshots
from forestgen.core.progress import Silent
from forestgen.recipe.load import load_recipe
from forestgen.scene.plan import Plan, check_plan

Floats = NDArray[np.float64]
Places = NDArray[np.float64]  # (N, 2) world x and y, metres
RECIPES = Path(__file__).resolve().parents[1] / "recipes" / "ecoclimates"
COLOURS = {
    "shrub": "#D6409F",
    "oak": "#F08C00",
    "birch": "#0072B2",
    "beech": "#14532D",
    "pine": "#7A5195",
    "poplar": "#14532D",
    "meranti": "#14532D",
    "kapok": "#4D9221",
    "cecropia": "#0072B2",
    "eucalyptus": "#F08C00",
    "acacia": "#7A5195",
}
STEP_YR = 5  # between the moments that are kept


@dataclass(frozen=True)
class Stand:
    """A recipe's stand: a population every few years, and the last."""

    plan: Plan
    moments: tuple[Population, ...]
    seconds: float

    def at(self, year: float) -> Population:
        return min(self.moments, key=lambda one: abs(one.time_yr - year))

    def leaf_m2(self) -> dict[str, Floats]:
        """(T,) of each species."""
        return {
            name: np.array([leaves(one)[one.species == index].sum() for one in self.moments])
            for index, name in enumerate(self.moments[0].species_names)
        }


def grown(recipe: str, seed: int, settings: Sequence[str] = ()) -> Stand:
    start = perf_counter()
    plan = check_plan(load_recipe(RECIPES / recipe, [f"seed={seed}", *settings]), simulate_only=True)
    kept = [
        one
        for one in snapshots(plan.community, Silent())
        if one.time_yr % STEP_YR == 0 or one.step == plan.community.steps
    ]
    return Stand(plan, tuple(kept), perf_counter() - start)


def leaves(population: Population) -> Floats:
    return np.asarray(population.columns["leaf_area_m2"], dtype=np.float64)


def parameters_of(plan: Plan) -> EcoclimateParameters:
    assert isinstance(plan.community.parameters, EcoclimateParameters)
    return plan.community.parameters


def wetness(plan: Plan, population: Population) -> Floats:
    """(rows, cols) soil water as plants are told it, mm a year."""
    section = parameters_of(plan).soil_water
    return worth_mm_per_yr(population.maps["soil_mean_mm"], section.water(), section.reference_g_per_m2)


def at_feet(values: Floats, plan: Plan, place: Places) -> Floats:
    """(N,) of a map over the site."""
    shape = values.shape[::-1]
    cell = np.minimum((place / plan.community.site.size_m * shape).astype(np.int64), np.array(shape) - 1)
    return np.asarray(values[cell[:, 1], cell[:, 0]])


def middles(size_m: tuple[float, float], shape: tuple[int, int]) -> Places:
    """(rows, cols, 2) of the cells of a map."""
    x, y = ((np.arange(n) + 0.5) / n * side for n, side in zip(shape[::-1], size_m, strict=True))
    return np.stack(np.meshgrid(x, y), axis=-1)


def draw_stand(axes: Any, stand: Stand, population: Population, title: str, *, wettest: float) -> Any:
    """Crowns over the soil's water; large ones below."""
    from matplotlib.collections import EllipseCollection

    width, depth = stand.plan.community.site.size_m
    shown = axes.imshow(
        wetness(stand.plan, population), origin="lower", extent=(0, width, 0, depth), cmap="Blues", vmin=0, vmax=wettest
    )
    order = np.argsort(-population.radius_m, kind="stable")
    across = 2 * population.radius_m[order]
    faces = [COLOURS[population.species_names[k]] for k in population.species[order]]
    axes.add_collection(
        EllipseCollection(
            across, across, np.zeros(len(across)), units="xy", offsets=population.position_m[order, :2],
            offset_transform=axes.transData, facecolors=faces, edgecolors="none", alpha=0.6,
        )
    )  # fmt: skip
    axes.set(title=title, xlim=(0, width), ylim=(0, depth), aspect="equal", xticks=[], yticks=[])
    return shown


def spread(values: Sequence[float]) -> str:
    return f"{min(values):.3g} to {max(values):.3g}"
