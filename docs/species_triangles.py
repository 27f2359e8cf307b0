"""Measures the triangles of the species' plants: `uv run python docs/species_triangles.py` (two minutes on two cores).

Writes the line `triangles` of the files in scenes/species: pairs of height and mean number, by which memory is
estimated before anything grows (`forestgen/scene/triangles.py`). Of species whose plants grow as branch modules it
writes none. With names behind it, `uv run python docs/species_triangles.py oak daisy`, it does these alone. Run it when
a species' form changes; `tests/unit/scene/test_triangles.py` says when the lines are out of date.
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from forestgen.core.errors import ForestgenError
from forestgen.core.randomness import child_rng
from forestgen.plants.build import build_exemplar, tree_size
from forestgen.plants.registry import clothes_modules
from forestgen.recipe.load import load_recipe_data
from forestgen.recipe.tree_sizes import TOP, own_normals
from forestgen.scene.plan import Plan, make_plan

SPECIES = Path(__file__).parents[1] / "scenes" / "species"
TREE_HEIGHTS_M = (1, 2, 2.9, 3.1, 5, 8, 12, 16, 20, 25, 30, 35, 40)
TALLEST = 1.6  # times the mature height: trees of stands
RADII = (0.15, 0.3, 0.5, 0.75, 1.0)  # of other plants, over the largest
PLANTS = 4  # of a size
SEED = 3


def planned(name: str) -> Plan:
    """A plan of a recipe with one species."""
    data = {"forestgen": 1, "site": {"size_m": [9, 9]}, "species": {name: {"from": name}}}
    loaded = load_recipe_data({**data, "community": {"model": "uniform"}}, name)
    return make_plan(next(iter(loaded.probes())))


def counted(name: str) -> Iterator[tuple[float, int]]:
    """Heights, metres, and mean numbers of triangles of plants of a species."""
    plan = planned(name)
    species, parameters = plan.drawn.species[name], plan.plants.generators[name]
    if species.tree is None:
        for share in RADII:
            radius_m = share * species.ecology.max_radius_m
            made = [
                build_exemplar(name, species, parameters, radius_m, child_rng(SEED, name, k)) for k in range(PLANTS)
            ]
            yield float(np.mean([one.height_m for one in made])), round(np.mean([one.triangles for one in made]))
        return
    normals = own_normals(SEED, np.arange(1, PLANTS + 1, dtype=np.uint64))
    tallest_m = min(TALLEST * species.mature_height_m, TOP * species.tree.tallest_m)
    for height_m in [one for one in TREE_HEIGHTS_M if one < 0.97 * tallest_m] + [tallest_m]:
        sizes = species.tree.sizes(np.full(PLANTS, float(height_m)), normals)
        trees = [tree_size(species, float(height_m), sizes, k) for k in range(PLANTS)]
        made = [
            build_exemplar(name, species, parameters, 1.0, child_rng(SEED, name, k), tree=one)
            for k, one in enumerate(trees)
        ]
        yield float(height_m), round(np.mean([one.triangles for one in made]))


def rounded(value: float, digits: int) -> str:
    return f"{round(value, digits - 1 - math.floor(math.log10(value))):.12g}"


def main(names: list[str]) -> None:
    for path in sorted(SPECIES.glob("*.yaml")):
        if names and path.stem not in names:
            continue
        try:
            if clothes_modules(planned(path.stem).drawn.species[path.stem].plant.generator):
                continue
            pairs = ", ".join(f"[{rounded(h, 3)}, {rounded(n, 3)}]" for h, n in counted(path.stem))
        except ForestgenError as cause:
            sys.stdout.write(f"{path.stem}: {cause}\n")
            continue
        line = f"triangles: [{pairs}]  # over height, by docs/species_triangles.py\n"
        text = re.sub(r"(?m)^triangles: .*\n", "", path.read_text(encoding="utf-8"))
        text = re.sub(r"(?m)^(?=plant:)", lambda _, line=line: line, text, count=1)
        path.write_text(text, encoding="utf-8")
        sys.stdout.write(f"{path.stem}: {line}")


if __name__ == "__main__":
    main(sys.argv[1:])
