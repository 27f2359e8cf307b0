from __future__ import annotations

import dataclasses

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from forestgen.community.history import open_history, write_history
from forestgen.community.model import simulate
from forestgen.community.models.multiset_lsystem import MODEL
from forestgen.core.errors import AssetError, OutputError
from support.error_messages import raises_error


@pytest.fixture
def history(tree, site):
    snapshots = list(simulate(MODEL, MODEL.Parameters(), site, [tree(), tree(name="Πεύκη")], 3, steps=12))
    own = {"next_id": 7, "phase": "dry", "sum": 0.1 + 0.2}
    return [
        dataclasses.replace(p, columns={"vigour": np.arange(len(p), dtype=np.float32)}, state=own) for p in snapshots
    ]


def test_round_trip(history, tmp_path, columns_equal):
    write_history(tmp_path / "a.parquet", iter(history))
    again = list(open_history(tmp_path / "a.parquet"))
    assert len(again) == 13
    assert len(again[0]) == 0
    for one, other in zip(history, again, strict=True):
        assert columns_equal(dataclasses.replace(one, columns={}), dataclasses.replace(other, columns={}))
        assert one.columns["vigour"].tobytes() == other.columns["vigour"].tobytes()
        assert all(getattr(one, f).dtype == getattr(other, f).dtype for f in ("plant_id", "species", "status"))


def test_same_snapshots_same_bytes(history, tmp_path):
    write_history(tmp_path / "a.parquet", history)
    write_history(tmp_path / "b.parquet", history)
    assert (tmp_path / "a.parquet").read_bytes() == (tmp_path / "b.parquet").read_bytes()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.parquet", "b.parquet"]


def test_a_row_says_its_step_and_its_species(history, tmp_path):
    path = tmp_path / "a.parquet"
    write_history(path, history)
    table = pq.read_table(path)
    names = np.array(history[0].species_names)
    assert isinstance(table.schema.field("species_name").type, pa.DictionaryType)
    assert table["species_name"].to_pylist() == names[table["species"].to_numpy()].tolist()
    assert set(table["species_name"].to_pylist()) == set(names)
    assert table["step"].to_pylist() == [one.step for one in history for _ in range(len(one))]


def test_histories_without_these_columns_are_read(history, tmp_path):
    """As forestgen wrote them before: their snapshots, written again, are those of today."""
    path, older = tmp_path / "a.parquet", tmp_path / "older.parquet"
    write_history(path, history)
    with pq.ParquetFile(path) as file:
        kept = [name for name in file.schema_arrow.names if name not in ("step", "species_name")]
        about = file.metadata.metadata[b"forestgen.community"]
        with pq.ParquetWriter(older, pa.schema([file.schema_arrow.field(name) for name in kept])) as writer:
            for group in range(file.num_row_groups):
                writer.write_table(file.read_row_group(group, columns=kept))
            writer.add_key_value_metadata({b"forestgen.community": about})
    write_history(tmp_path / "b.parquet", list(open_history(older)))
    assert (tmp_path / "b.parquet").read_bytes() == path.read_bytes()


def test_only_empty_snapshots(history, tmp_path):
    write_history(tmp_path / "a.parquet", history[:1])
    assert [len(p) for p in list(open_history(tmp_path / "a.parquet"))] == [0]


def test_snapshots_of_different_communities_are_refused(history, tmp_path):
    strange = dataclasses.replace(history[3], species_names=("a", "b"))
    with pytest.raises(ValueError, match="same species"):
        write_history(tmp_path / "a.parquet", [history[2], strange])
    with pytest.raises(ValueError, match="at least one"):
        write_history(tmp_path / "a.parquet", [])
    assert list(tmp_path.iterdir()) == []


def test_files_that_cannot_be(history, tmp_path):
    with raises_error(OutputError, place="a.parquet"):
        write_history(tmp_path / "nowhere" / "a.parquet", history)
    with raises_error(AssetError, place="b.parquet"):
        list(open_history(tmp_path / "b.parquet"))
    (tmp_path / "c.parquet").write_bytes(b"not a table")
    with raises_error(AssetError, place="c.parquet"):
        list(open_history(tmp_path / "c.parquet"))


def test_snapshots_are_read_one_by_one(history, tmp_path):
    holes = [
        *history[:2],
        dataclasses.replace(history[0], step=7),
        history[9],
        dataclasses.replace(history[0], step=11),
    ]
    write_history(tmp_path / "a.parquet", holes, {"seed": 2**62 + 1})
    opened = open_history(tmp_path / "a.parquet")
    assert opened.steps == [0, 1, 7, 9, 11]
    assert opened.origin == {"seed": 2**62 + 1}
    for one in holes:
        again = opened.snapshot(one.step)
        assert (again.step, again.time_yr, again.state) == (one.step, one.time_yr, one.state)
        assert again.plant_id.tobytes() == one.plant_id.tobytes()
        assert again.columns["vigour"].dtype == np.float32
    (tmp_path / "a.parquet").unlink()
    with raises_error(AssetError, place="a.parquet"):
        opened.snapshot(9)


def test_a_file_of_another_version_is_refused(history, tmp_path, monkeypatch):
    monkeypatch.setattr("forestgen.community.history._VERSION", 1)
    write_history(tmp_path / "a.parquet", history)
    monkeypatch.undo()
    with raises_error(AssetError, place="a.parquet"):
        open_history(tmp_path / "a.parquet")
