"""Simulated stands as tables: columns, the Arrow table, the map; and what a folder gets."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from api_recipe import STAND

import forestgen as fg
from support.error_messages import raises_error


@pytest.fixture(scope="module")
def stand() -> fg.Stand:
    return fg.load(STAND).simulate(progress=False)


def test_columns_are_arrays_of_one_length(stand: fg.Stand) -> None:
    assert len(stand) == 42
    assert {name: len(values) for name, values in stand.columns.items()} == dict.fromkeys(stand.columns, 42)
    assert list(stand.columns)[:8] == [
        "plant_id", "species", "x_m", "y_m", "height_m", "radius_m", "age_yr", "status",
    ]  # fmt: skip
    assert {name: int((stand["species"] == name).sum()) for name in stand.species} == {"spruce": 12, "fireweed": 30}
    assert stand.summary.counts == {"spruce": 12, "fireweed": 30}
    assert len(set(stand["plant_id"].tolist())) == 42
    assert 0 <= stand["x_m"].min() < stand["x_m"].max() < 30
    assert 0 <= stand["y_m"].min() < stand["y_m"].max() < 20
    np.testing.assert_allclose(stand["radius_m"][stand["species"] == "spruce"], 0.4)
    assert set(stand["status"]) == {"growing"}
    np.testing.assert_array_equal(stand["x_m"], stand.population.position_m[:, 0])


def test_a_column_that_is_not_there_is_named_with_those_that_are(stand: fg.Stand) -> None:
    with raises_error(fg.RecipeError) as caught:
        stand["hight_m"]
    assert caught.value.got == "'hight_m'"


def test_a_column_of_the_history_file_is_led_to_its_name(stand: fg.Stand) -> None:
    with raises_error(fg.RecipeError):
        stand["species_name"]


def test_the_table_has_the_columns(stand: fg.Stand) -> None:
    table = stand.table
    assert table.column_names == list(stand.columns)
    assert table.num_rows == 42
    for name in ("plant_id", "species", "height_m", "status"):
        np.testing.assert_array_equal(np.asarray(table[name]), stand[name])


def test_columns_of_several_values_a_plant_are_lists(stand: fg.Stand, monkeypatch: pytest.MonkeyPatch) -> None:
    values = np.arange(84.0).reshape(42, 2)
    monkeypatch.setitem(stand.columns, "traits", values)
    assert stand.table["traits"].to_pylist() == values.tolist()


def test_nothing_is_written_unless_a_folder_is_named(
    stand: fg.Stand, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    recipe = fg.load(STAND)
    again = recipe.simulate(progress=False)
    assert again.folder is None
    assert not list(tmp_path.iterdir())
    written = recipe.simulate(tmp_path / "out", progress=False)
    assert written.folder == tmp_path / "out"
    history = pq.read_table(tmp_path / "out" / "history.parquet")
    for one in (again, written):
        np.testing.assert_array_equal(one["x_m"], stand["x_m"])
    np.testing.assert_allclose(np.asarray(history["x_m"]), stand["x_m"], rtol=1e-6)
    with pytest.raises(fg.OutputError):
        recipe.simulate(tmp_path / "out", progress=False)
    assert (
        recipe.set({"seed": 4}).simulate(tmp_path / "out", overwrite=True, progress=False)["x_m"][0] != stand["x_m"][0]
    )


def test_a_stand_is_drawn_and_described(stand: fg.Stand) -> None:
    assert repr(stand) == f"<Stand at year {stand.population.time_yr:g}: 12 spruce, 30 fireweed>"
    picture = stand._repr_png_()
    assert picture.startswith(b"\x89PNG")
    assert stand.plot().axes
    assert stand.notes == ()
    assert stand.biome is None


def test_an_empty_stand_has_its_columns() -> None:
    empty = fg.load(STAND, set={"community": {"model": "multiset_lsystem", "program": "succession", "steps": 0}})
    bare = empty.simulate(progress=False)
    assert len(bare) == bare.table.num_rows == 0
    assert repr(bare) == "<Stand at year 0: 0 spruce, 0 fireweed>"
    assert "community.steps is 0" in bare.notes[0]


def test_a_step_to_resume_from_needs_a_history() -> None:
    with raises_error(fg.RecipeError, place="from_step"):
        fg.load(STAND).simulate(from_step=3, progress=False)
