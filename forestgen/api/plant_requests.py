"""What a call for one plant asks for: its species alone in a recipe, its size, its seed."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np

from forestgen.core.arguments import shown
from forestgen.core.errors import RecipeError
from forestgen.plants.build import tree_size
from forestgen.plants.growing import ExemplarRequest
from forestgen.plants.parameters import with_detail
from forestgen.plants.plan import PlantPlan, plan_plants
from forestgen.recipe.assets import SUFFIXES, find_asset
from forestgen.recipe.load import DrawnRecipe, load_recipe_data
from forestgen.recipe.schema import NO_PLANTS
from forestgen.recipe.species import TALLEST_M, Species
from forestgen.recipe.tree_sizes import Grown, own_normals

_SHORTEST_M = 0.02
_TALLEST = 2.0  # of a mature plant's height


def name_of(species: str) -> str:
    """Name of a shipped species or of a species file: ``my oak.yaml`` is my-oak."""
    return re.sub(r"[^A-Za-z0-9_-]", "-", Path(species).stem).lstrip("-_")[:64] or "plant"


def drawn_of(species: str, seed: int) -> DrawnRecipe:
    """A recipe that has this species alone; the generator's own keys are not yet checked."""
    path = Path(species)
    is_file = path.suffix in SUFFIXES["species"]
    source = f"./{path.name}" if is_file else species  # a file of the user's own may lie anywhere
    if not is_file:
        find_asset("species", species, parameter="species")
    alone = {"species": {name_of(species): {"from": source}}, "community": NO_PLANTS}
    folder = path.parent if is_file else Path()
    return load_recipe_data({"forestgen": 1, "seed": seed, **alone}, "forestgen plant", folder).draw(0)


def plan_of(species: str, seed: int, detail: int | None = None) -> PlantPlan:
    """PlantPlan of `drawn_of`, its organs at a level of detail."""
    plan = plan_plants(drawn_of(species, seed))
    if detail is None:
        return plan
    finer = {name: with_detail(one, detail) for name, one in plan.generators.items()}
    return replace(plan, generators=finer)


def request_of(
    plan: PlantPlan, name: str, height_m: float | None, seed: int, grown: Grown = "stand"
) -> ExemplarRequest:
    """The plant of a species, a height and a seed; a tree also of how it grew."""
    species, parameters = plan.drawn.species[name], plan.generators[name]
    radius_m, law, tree = radius_of_m(species, height_m), species.tree, None
    if grown not in get_args(Grown):
        expected = "stand, open or suppressed"
        raise RecipeError("no such way to grow", parameter="grown", expected=expected, got=shown(grown))
    if law is not None:
        tall = np.array([species.mature_height_m if height_m is None else height_m])
        own = own_normals(seed, np.ones(1, dtype=np.uint64))
        tree = tree_size(species, float(tall[0]), law.sizes(tall, own, law.shift(grown)))
    elif grown != "stand":
        problem, hint = "this species has no sizes of trees, which depend on how they grow", "leave `grown` out"
        raise RecipeError(problem, parameter="grown", expected="a species with a `tree` section", got=name, hint=hint)
    return ExemplarRequest(name, species, parameters, radius_m, seed, ("exemplar", name), tree=tree)


def radius_of_m(species: Species, height_m: float | None) -> float:
    """Community radius of a plant of that height: the allometry's inverse."""
    mature_m = species.ecology.max_radius_m
    if height_m is None:
        return mature_m
    tallest_m = min(_TALLEST * species.mature_height_m, TALLEST_M)  # a slip of the pen makes gigabytes of leaves
    if not (math.isfinite(height_m) and _SHORTEST_M <= height_m <= tallest_m):
        expected = f"{_SHORTEST_M:g} to {tallest_m:.3g} m; a mature plant has {species.mature_height_m:.3g} m"
        raise RecipeError("no such plant", parameter="height_m", expected=expected, got=f"{height_m:g}")
    law = species.allometry.height_m
    if law.exponent:
        return law.inverse(height_m)
    if not math.isclose(height_m, law.scale, rel_tol=0.01):
        problem, hint = "plants of this species are all of one height", "leave `height_m` out"
        raise RecipeError(problem, parameter="height_m", expected=f"{law.scale:g} m", got=f"{height_m:g} m", hint=hint)
    return mature_m
