"""What the guide says of the columns of modules and graphs is what the code writes."""

from __future__ import annotations

import re
from itertools import dropwhile, takewhile
from pathlib import Path

import numpy as np
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq

from forestgen.community.history import write_history
from forestgen.community.history_files import write_graphs
from forestgen.community.resume import origin
from forestgen.community.simulation import snapshots
from forestgen.core.progress import Silent
from forestgen.recipe.load import load_recipe_data
from forestgen.scene.plan import make_plan

PAGE = Path(__file__).parents[3] / "docs" / "branch_modules.md"
RECIPE = {
    "forestgen": 1,
    "site": {
        "size_m": [20, 20], "terrain": {"kind": "rolling", "amplitude_m": 2, "wavelength_m": 15},
        "buildings": [{"kind": "house", "position_m": [10, 10], "size_m": [5, 5, 5]}],
    },
    "species": {"birch": None},
    "community": {
        "model": "branch_modules", "steps": 12, "initial_plants": {"birch": 4}, "history_modules": True,
    },
}  # fmt: skip


def _columns(title: str) -> list[str]:
    """Names in the first column of the table below a line."""
    lines = PAGE.read_text(encoding="utf-8").split(title, 1)[1].splitlines()
    table = takewhile(lambda line: line.startswith("|"), dropwhile(lambda line: not line.startswith("|"), lines))
    rows = [line.split("|")[1] for line in table][2:]
    return [name for row in rows for name in re.findall(r"`(\w+)`", row)]


def test_the_guide_has_every_column_and_tells_its_frame(tmp_path: Path) -> None:
    plan = make_plan(load_recipe_data(RECIPE, "test").draw(0))
    kept = list(snapshots(plan.community, Silent()))
    write_history(tmp_path / "history.parquet", kept, origin(plan.community), modules=True)
    write_graphs(plan.community, kept[-1], [tmp_path / "graph.csv"])
    graph = pa_csv.read_csv(tmp_path / "graph.csv").to_pydict()
    modules = pq.read_table(tmp_path / "modules.parquet", filters=[("step", "=", 12)]).to_pydict()
    plants = pq.read_table(tmp_path / "history.parquet", filters=[("step", "=", 12)]).to_pydict()
    assert _columns("the columns of `modules.parquet`") == list(modules)
    assert _columns("the columns of a graph's table") == list(graph)

    assert [plants["plant_id"][row] for row in graph["plant"]] == graph["plant_id"]
    assert [plants["species_name"][row] for row in graph["plant"]] == graph["species"]
    assert [modules["plant_id"][row] for row in graph["module"]] == graph["plant_id"]
    nodes = {key: row for row, key in enumerate(zip(graph["module"], graph["node"], strict=True))}
    place = {one: row for row, one in enumerate(plants["plant_id"])}
    compared = 0
    for row, parent in enumerate(modules["parent"]):
        if parent < 0:
            continue
        # The root node of a module is its bearer's terminal.
        bearer = modules["plant_id"].index(modules["plant_id"][row]) + parent
        seen = nodes[bearer, modules["node"][row]]
        plant = place[modules["plant_id"][row]]
        x, y = plants["x_m"][plant], plants["y_m"][plant]
        ground = float(plan.community.site.height(np.array([x]), np.array([y]))[0])  # type: ignore[misc]
        foot = (x, y, ground)
        for axis, at in zip("xyz", foot, strict=True):
            assert abs(graph[f"{axis}_m"][seen] - at - modules[f"base_{axis}_m"][row]) < 1e-4
        compared += 1
    assert compared > 10
