"""Skeletal graphs by hand, for tests of plants of branch modules."""

from __future__ import annotations

import numpy as np

from forestgen.plants.generators.branch_modules import Parameters
from forestgen.plants.grown import ModuleWood

THICK_M, FINE_M = 0.2, 0.01

KEYS = {
    "wood": {"material": "bark", "branch_material": "twig"},
    "bearing": {"thinner_than_m": 0.05, "spacing_m": 0.25, "missing": 0.0},
    "twigs": [
        {"longest_m": 0.5, "internode_m": 0.1, "diameter_m": [[0, 0.006], [1, 0.002]], "branch_angle_deg": 50,
         "branch_length": 0.5},
        {"longest_m": 0.2, "internode_m": 0.1, "diameter_m": 0.002},
    ],
    "shapes": {"leaf": {"form": "simple", "material": "leaf", "length_m": 0.1, "width_m": 0.06, "detail": 0}},
    "foliage": [{"shape": "leaf", "orders": [8, 9], "spacing_m": 0.1}],
}  # fmt: skip


def parameters(**changes: object) -> Parameters:
    return Parameters.model_validate({**KEYS, **changes})


def wood(scale: float = 1.0) -> ModuleWood:
    """A stem of two nodes, one of which forks in two branches that fork again; a terminal of no length."""
    parent = np.array([-1, 0, 1, 1, 2, 2, 3, 3, 4])
    place = np.array(
        [
            [0, 0, 0], [0.1, 0, 2], [0.3, 0.2, 3.5], [1.4, 0, 2.6], [0.2, 0.1, 5], [0.2, 1.5, 4], [2.6, 0.3, 2.8],
            [2.0, -1.0, 3.5], [0.2, 0.1, 5],
        ],
        dtype=np.float64,
    )  # fmt: skip
    diameter = np.array([0.2, 0.2, 0.14, 0.1, 0.03, 0.02, 0.03, FINE_M, FINE_M])
    main = np.array([False, True, True, False, True, False, True, False, True])
    return ModuleWood(
        parent=parent,
        position_m=place * scale,
        diameter_m=diameter * scale,
        age_share=np.array([1, 1, 1, 1, 1, 0.5, 1, 0.2, 0.0]),
        age_yr=np.full(9, 5.0),
        light=np.full(9, 0.9),
        main=main,
        mark=np.arange(9, dtype=np.uint32) + 64,
    )
