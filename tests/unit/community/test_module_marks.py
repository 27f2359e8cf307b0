"""A history's modules are those that were written with it: no others, and no other values."""

from __future__ import annotations

import shutil

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from forestgen.community.history import open_history
from forestgen.core.errors import AssetError
from forestgen.core.progress import Silent, Timings
from forestgen.pipeline import simulate
from forestgen.recipe.load import load_recipe
from support.error_messages import raises_error

STAND = """
forestgen: 1
seed: 1
site: {size_m: [12, 12]}
species: {pine: , shrub: }
community: {model: branch_modules, initial_plants: 8, steps: 4, history_modules: true}
cameras: [{position_m: [0, -10, 2]}]
"""


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    (folder / "stand.yaml").write_text(STAND)
    for seed in (1, 2):
        loaded = load_recipe(folder / "stand.yaml", [f"seed={seed}"])
        simulate(loaded, folder / str(seed), progress=Silent(), timings=Timings())
    return folder


def with_modules(runs, tmp_path, modules):
    shutil.copy(runs / "1" / "history.parquet", tmp_path)
    if callable(modules):
        with pq.ParquetFile(runs / "1" / "modules.parquet") as file:
            groups = [file.read_row_group(k) for k in range(file.num_row_groups)]
            metadata = file.metadata.metadata
        groups[-1] = modules(groups[-1])
        with pq.ParquetWriter(tmp_path / "modules.parquet", groups[0].schema) as writer:
            for group in groups:
                writer.write_table(group, row_group_size=max(1, len(group)))
            writer.add_key_value_metadata({b"forestgen.modules": metadata[b"forestgen.modules"]})
    else:
        shutil.copy(modules, tmp_path / "modules.parquet")
    return open_history(tmp_path / "history.parquet")


def test_the_modules_of_the_same_run_are_read(runs, tmp_path):
    history = with_modules(runs, tmp_path, lambda table: table)
    assert len(history.whole(4).modules) >= 8


def test_modules_of_another_seed_are_refused(runs, tmp_path):
    history = with_modules(runs, tmp_path, runs / "2" / "modules.parquet")
    with raises_error(AssetError, place="modules.parquet"):
        history.whole(4)


@pytest.mark.parametrize(
    ("column", "value"),
    [("parent", 2_000_000_000), ("prototype", 250), ("node", 30_000), ("base_x_m", np.inf), ("age", np.nan)],
)
def test_changed_values_are_refused(runs, tmp_path, column, value):
    def change(table):
        values = table.column(column).to_numpy().copy()
        values[-1] = value
        index = table.column_names.index(column)
        return table.set_column(index, table.schema.field(index), pa.array(values))

    with raises_error(AssetError, place="modules.parquet"):
        with_modules(runs, tmp_path, change).whole(4)


def test_a_missing_row_is_refused(runs, tmp_path):
    with raises_error(AssetError, place="modules.parquet"):
        with_modules(runs, tmp_path, lambda table: table.slice(0, len(table) - 1)).whole(4)
