"""Histories with values changed by hand: a simulation does not go on from what no simulation gives."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from forestgen.community.history import write_history
from forestgen.community.resume import origin, snapshot_to_resume
from forestgen.community.simulation import snapshots
from forestgen.core.errors import AssetError
from forestgen.core.progress import Silent
from forestgen.recipe.load import load_recipe
from forestgen.scene.plan import Plan, check_plan

_KEY = b"forestgen.community"
_STEP = 3
_HEAD = "forestgen: 1\nseed: 4\ncameras: [{position_m: [0, -9, 2]}]\nsite: {size_m: [20, 12]%s}\n"
_MODULES = "species: {pine: , shrub: }\ncommunity: {model: %s, initial_plants: 9, history_modules: true, "
_BUILDING = ", buildings: [{kind: house, position_m: [5, 5], size_m: [3, 3, 3]}]"
_DEAD = "standing_dead_yr: 4, "
_RECIPES = {
    "branch_modules": _MODULES % "branch_modules" + _DEAD + "dieback_share: 0.3, ",
    "ecoclimate": _MODULES % "ecoclimate"
    + _DEAD
    + "soil_water: {cell_m: 4}, climate: {temperature_c: [10, 10, 10, 10, 10, 10, 10, 10, 10, 10, 10, 10], "
    "precipitation_mm: [60, 60, 60, 60, 60, 60, 60, 60, 60, 60, 60, 60]}, ",
    "forest_footprints": "species: {poplar: , spruce: }\ncommunity: {model: forest_footprints, "
    "initial_plants_per_ha: 900, ",
    "kernel_growth": "species: {poplar: , spruce: }\ncommunity: {model: kernel_growth, initial_plants_per_ha: 900, ",
    "multiset_lsystem": "species: {poplar: , spruce: }\ncommunity: {model: multiset_lsystem, ",
    "uniform": "species: {poplar: , spruce: }\ncommunity: {model: uniform, plants: {poplar: {count: 20}}, ",
}


def _head(model: str) -> str:
    return _HEAD % (_BUILDING if model in ("branch_modules", "ecoclimate") else "")


@dataclass(frozen=True)
class Written:
    """A recipe's plan and the history of its first steps."""

    plan: Plan
    path: Path


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    made: dict[str, Written] = {}

    def of(model: str) -> Written:
        if model not in made:
            folder = tmp_path_factory.mktemp(model)
            (folder / "stand.yaml").write_text(
                _HEAD % (_BUILDING if "modules" in _RECIPES[model] else "")
                + _RECIPES[model]
                + f"steps: {_STEP + 3}}}\n"
            )
            plan = check_plan(load_recipe(folder / "stand.yaml", []), simulate_only=True)
            beginning = (one for one in snapshots(plan.community, Silent()) if one.step <= _STEP)
            with_modules = model in ("branch_modules", "ecoclimate")
            write_history(
                folder / "history.parquet",
                beginning,
                origin(plan.community),
                modules=with_modules,
                size_m=plan.community.site.size_m,
            )
            made[model] = Written(plan, folder / "history.parquet")
        return made[model]

    return of


def rewritten(history: Path, folder: Path, table=None, about=None) -> Path:
    """A copy of a history with its files, the last snapshot's table and the metadata changed."""
    shutil.copytree(history.parent, folder, dirs_exist_ok=True)
    with pq.ParquetFile(history) as file:
        groups = [file.read_row_group(k) for k in range(file.num_row_groups)]
        told = json.loads(file.metadata.metadata[_KEY])
    groups[-1] = groups[-1] if table is None else table(groups[-1])
    told = told if about is None else about(told)
    schema = groups[-1].schema
    with pq.ParquetWriter(folder / "history.parquet", schema) as writer:
        for group in groups:
            same = group.select(schema.names).cast(schema)
            writer.write_table(same, row_group_size=max(1, len(group)))
        text = told if isinstance(told, str) else json.dumps(told)
        writer.add_key_value_metadata({_KEY: text.encode()})
    return folder / "history.parquet"


def index_of(table: pa.Table, column: str) -> int:
    names = table.column_names
    return names.index(column if column in names else f"model.{column}")


def with_value(column: str, value, row: int = -1):
    def change(table: pa.Table) -> pa.Table:
        index = index_of(table, column)
        field = table.schema.field(index)
        values = table.column(index).to_pylist()
        values[row] = value
        return table.set_column(index, field, pa.array(values, type=field.type))

    return change


def with_state(**changes):
    def change(told: dict) -> dict:
        state = told["snapshots"][-1][3]
        state.update(changes)
        for key in [key for key, value in changes.items() if value is ...]:
            del state[key]
        return told

    return change


def refused(written: Written, path: Path) -> str:
    with pytest.raises(AssetError) as caught:
        snapshot_to_resume(written.plan.community, path, None)
    message = str(caught.value)
    assert str(path.parent) in message
    assert "expected" in message
    return message


MODELS = tuple(_RECIPES)


@pytest.mark.parametrize("model", MODELS)
def test_a_copy_resumes(written, tmp_path, model):
    """What the other tests change is the value alone: the same file written again goes on."""
    one = written(model)
    start = snapshot_to_resume(one.plan.community, rewritten(one.path, tmp_path), None)
    *_, last = snapshots(one.plan.community, Silent(), start)
    assert last.step == _STEP + 3
    assert len(last) > 1


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(
    ("column", "value"),
    [
        ("species", 60_000),
        ("x_m", np.nan),
        ("x_m", -0.5),
        ("y_m", 12.5),
        ("x_m", 1e300),
        ("z_m", np.inf),
        ("radius_m", 0.0),
        ("radius_m", np.nan),
        ("radius_m", np.inf),
        ("height_m", np.inf),
        ("height_m", -1.0),
        ("age_yr", -1.0),
        ("age_yr", np.nan),
        ("status", 77),
    ],
)
def test_impossible_values_of_a_plant_are_refused(written, tmp_path, model, column, value):
    one = written(model)
    message = refused(one, rewritten(one.path, tmp_path, with_value(column, value)))
    assert re.search(rf"column {column} of plant \d+ of step {_STEP} ", message), message


OWN = [
    ("branch_modules", "age_yr", 1e12),
    ("branch_modules", "flowering", 9),
    ("branch_modules", "next_module", 0),
    ("branch_modules", "adaptation", np.nan),
    ("branch_modules", "adaptation", 1e30),
    ("branch_modules", "dead_yr", -5.0),
    ("branch_modules", "dead_yr", np.inf),
    ("branch_modules", "tallest_m", np.nan),
    ("branch_modules", "species", 2),  # a house among the plants
    ("ecoclimate", "next_module", 0),
    ("ecoclimate", "dead_yr", 1e9),
    ("forest_footprints", "age_yr", 1e12),
    ("forest_footprints", "status", 3),  # keeps no dead
    ("forest_footprints", "radius_m", 1e6),
    ("forest_footprints", "vigour", np.nan),
    ("forest_footprints", "health", 2.0),
    ("kernel_growth", "radius_m", 1e6),
    ("kernel_growth", "quality", np.nan),
    ("kernel_growth", "quality", -0.1),
    ("multiset_lsystem", "age_yr", 1e12),
    ("uniform", "azimuth_deg", np.nan),
    ("uniform", "first_age_yr", -1.0),
    ("uniform", "first_step", 2**31 - 1),
    ("uniform", "first_step", -7),
]


@pytest.mark.parametrize(("model", "column", "value"), OWN)
def test_impossible_values_of_a_models_own_columns_are_refused(written, tmp_path, model, column, value):
    one = written(model)
    message = refused(one, rewritten(one.path, tmp_path, with_value(column, value)))
    assert re.search(rf"column (model\.)?{column} of plant \d+ of step {_STEP} ", message), message


@pytest.mark.parametrize("model", ["branch_modules", "ecoclimate"])
@pytest.mark.parametrize(("column", "value"), [("species", 0), ("status", 3), ("plant_id", 0)])
def test_a_changed_obstacle_is_refused(written, tmp_path, model, column, value):
    one = written(model)
    message = refused(one, rewritten(one.path, tmp_path, with_value(column, value, row=0)))
    assert column in message


@pytest.mark.parametrize("model", MODELS)
def test_plants_of_one_id_are_refused(written, tmp_path, model):
    one = written(model)

    def twice(table):
        return with_value("plant_id", table.column("plant_id")[-2].as_py())(table)

    assert "plant_id must be positive, unique and sorted" in refused(one, rewritten(one.path, tmp_path, twice))


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("column", ["species", "x_m", "plant_id"])
def test_a_gap_is_refused(written, tmp_path, model, column):
    one = written(model)
    assert f"column {column} of step {_STEP} lacks" in refused(
        one, rewritten(one.path, tmp_path, with_value(column, None))
    )


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("column", ["species", "x_m", "status", "plant_id"])
def test_a_column_of_another_type_is_refused(written, tmp_path, model, column):
    one = written(model)

    def change(table):
        values = table.column(column).cast(pa.string())
        return table.set_column(table.column_names.index(column), column, values)

    assert f"column {column} of step {_STEP} is of type string" in refused(one, rewritten(one.path, tmp_path, change))


_COMMON = ("species", "status", "age_yr", "radius_m")


@pytest.mark.parametrize(("model", "column"), sorted({one[:2] for one in OWN if one[1] not in _COMMON}))
def test_an_own_column_of_another_type_or_none_is_refused(written, tmp_path, model, column):
    one = written(model)

    def change(table):
        index = index_of(table, column)
        return table.set_column(index, f"model.{column}", table.column(index).cast(pa.string()))

    for number, changed in enumerate((change, lambda table: table.drop_columns([f"model.{column}"]))):
        message = refused(one, rewritten(one.path, tmp_path / str(number), changed))
        assert f"column model.{column} of step {_STEP}" in message


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("value", [1, 0, -3, 2**70, "7", None, 8.5, True, ...])
def test_a_next_id_that_is_taken_or_no_number_is_refused(written, tmp_path, model, value):
    one = written(model)
    assert "next_id" in refused(one, rewritten(one.path, tmp_path, about=with_state(next_id=value)))


WORD = [0, 1, 0, [["S"]]]


@pytest.mark.parametrize(
    ("model", "changes"),
    [
        ("branch_modules", {"notes": 5}),
        ("branch_modules", {"notes": [None]}),
        ("ecoclimate", {"temperature_mean_c": float("nan")}),
        ("ecoclimate", {"temperature_mean_c": "warm"}),
        ("ecoclimate", {"water": 3}),
        ("ecoclimate", {"water": {"start_mm": float("inf")}}),
        ("multiset_lsystem", {"globals": []}),
        ("multiset_lsystem", {"globals": "0"}),
        ("multiset_lsystem", {"words": 7}),
        ("multiset_lsystem", {"words": [7]}),
        ("multiset_lsystem", {"words": [[0, 2**40, 0, [["["], ["]"]]]]}),
        ("multiset_lsystem", {"words": [[0, 1, 0, [["]"], ["["]]]]}),
        ("multiset_lsystem", {"words": [[0, 1, 0, [["["]]]]}),
        ("multiset_lsystem", {"words": [[0, 1, 0, [["nonsense", 3]]]]}),
        ("multiset_lsystem", {"words": [[0, 1, 0, []]]}),
        ("multiset_lsystem", {"words": [[0, 1, 0, [["["], ["]"]]], [1, 1, 0, [["["], ["]"]]]]}),
        ("multiset_lsystem", {"words": ...}),
        ("uniform", {"clustering": {"poplar": float("nan")}}),
        ("uniform", {"water": {"mm": 1}}),
    ],
)
def test_an_impossible_state_is_refused(written, tmp_path, model, changes):
    one = written(model)
    (key,) = changes
    assert key in refused(one, rewritten(one.path, tmp_path, about=with_state(**changes)))


def _last(index: int, value):
    def change(told: dict) -> dict:
        told["snapshots"][-1][index] = value
        return told

    return change


@pytest.mark.parametrize(
    "about",
    [
        lambda told: {**told, "snapshots": []},
        lambda told: {**told, "snapshots": told["snapshots"][::-1]},
        lambda told: {**told, "snapshots": [one[:3] for one in told["snapshots"]]},
        lambda told: {**told, "snapshots": 5},
        lambda told: {**told, "species_names": [1, 2, 3]},
        lambda told: {**told, "species_names": ["oak", "ash", "elm"]},
        lambda told: {**told, "modules": told["modules"][:-1]},
        lambda told: {**told, "modules": 7},
        lambda told: {**told, "modules": [["a", "b"] for _ in told["modules"]]},
        lambda told: {**told, "map_sums": [], "maps": ["soil_water_mm"]},
        lambda told: {**told, "origin": 3},
        lambda told: {**told, "origin": {"seed": 4}},
        lambda told: {**told, "origin": {**told["origin"], "site": 4}},
        lambda told: {**told, "origin": {**told["origin"], "species": [4]}},
        lambda told: {
            **told,
            "origin": {**told["origin"], "parameters": {**told["origin"]["parameters"], "changes": [{"x": 1}]}},
        },
        lambda told: [told],
        lambda told: "nonsense",
        lambda told: "[" * 200_000,
        _last(0, float("nan")),
        _last(0, None),
        _last(1, -1),
        _last(1, 10**12),
        _last(1, float("inf")),
        _last(2, -1),
        _last(2, "three"),
        _last(3, 5),
        _last(3, None),
    ],
)
def test_metadata_that_do_not_fit_are_refused(written, tmp_path, about):
    one = written("branch_modules")
    refused(one, rewritten(one.path, tmp_path, about=about))
