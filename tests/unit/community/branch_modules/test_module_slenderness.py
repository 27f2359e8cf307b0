"""Shipped trees are as thick as trees are: crowded ones, not yet old, at most 150 times as high as their breast height
diameter, as in unthinned stands, and none is a post."""

from __future__ import annotations

import numpy as np
import pytest

from forestgen.architecture.prototypes import pipe_diameter_m
from forestgen.community.models.branch_modules import MODEL
from forestgen.community.population import Site, SpeciesEcology
from forestgen.recipe.biome import shipped_plant_types

TREES = (
    "beech", "birch", "cecropia", "cypress", "eucalyptus", "hemlock", "kapok", "larch", "maple", "meranti", "oak",
    "pine", "poplar", "spruce", "sweetgum",
)  # fmt: skip
BY_DEFAULT = {"beech", "spruce"}


@pytest.mark.parametrize("name", [pytest.param(n, marks=() if n in BY_DEFAULT else pytest.mark.slow) for n in TREES])
def test_crowded_trees_are_no_rods_and_no_posts(name):
    kind = shipped_plant_types()[name].model_copy(update={"seeds_per_yr": 0.0})
    ecology = SpeciesEcology(name, 0.1, 5.0, 0.5, 0.9, 0.0, 0.1, 4.0, 0.75, modules=kind)
    climate = {
        "temperature_c": kind.temperature_c,
        "precipitation_mm_per_yr": kind.precipitation_mm_per_yr,
    }
    parameters = MODEL.Parameters(initial_plants=40, steps=min(60, int(0.6 * kind.life_span_yr)), **climate)
    state = MODEL.init(parameters, Site((20.0, 20.0)), [ecology], 1)
    for _ in range(parameters.steps):
        state = MODEL.step(state)
    population = MODEL.population(state)
    height, thick = population.height_m, population.columns["trunk_diameter_m"]
    tall = height >= np.quantile(height, 0.8)
    slenderness = float(np.median(height[tall] / thick[tall]))
    assert height[tall].min() > 4.0
    assert 40.0 < slenderness < 150.0


def test_a_terminal_stands_for_shoots_whose_squares_add():
    one = shipped_plant_types()["beech"]
    bare = one.model_copy(update={"shoots_per_terminal": 1.0})
    assert pipe_diameter_m(bare) == pytest.approx(one.thickening_cm / 100)
    assert pipe_diameter_m(one) ** 2 == pytest.approx(one.shoots_per_terminal * pipe_diameter_m(bare) ** 2)
