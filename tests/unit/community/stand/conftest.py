from __future__ import annotations

import re
import textwrap

import pytest

from forestgen.community.population import ecology_of
from forestgen.recipe.load import load_recipe_data

NAMES = ("spruce", "pine", "birch", "oak", "beech", "bracken")


@pytest.fixture(scope="session")
def species():
    """Ecologies of shipped species: trees with allometries, and a fern."""
    recipe = {"forestgen": 1, "site": {"size_m": [9, 9]}, "community": {"model": "uniform"}}
    recipe["species"] = {name: {"from": name} for name in NAMES}
    drawn = next(iter(load_recipe_data(recipe, "test").probes()))
    return [ecology_of(name, one) for name, one in drawn.species.items()]


@pytest.fixture
def examples():
    """The recipes of a manual page, as text: whole ones, with a site and the species above."""

    def found(module):
        text = module.__doc__.split("Recipe::")[1].split("Decisions\n")[0]
        parts = [one for one in re.split(r"(?m)^(?=community:)", textwrap.dedent(text)) if one.strip()]
        listed = "".join(f"  {name}: {{from: {name}}}\n" for name in NAMES)
        head = f"forestgen: 1\nsite: {{size_m: [50, 40], terrain: rolling}}\nspecies:\n{listed}"
        return [head + one for one in parts]

    return found
