"""Modules of a history: written beside it, read back as they were, refused where they are another's."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from forestgen.architecture.modules import Modules
from forestgen.community.history import open_history, write_history
from forestgen.community.history_tables import MODULES_NAME as NAME
from forestgen.community.population import Population
from forestgen.core.errors import AssetError
from support.error_messages import raises_error


def stand(step: int, counts: list[int]) -> Population:
    """Plants with so many modules each, of random content."""
    rng, n, m = np.random.default_rng(step), len(counts), sum(counts)
    first = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    number = np.arange(m) - np.repeat(first[:-1], counts)
    values = {name: rng.random(m).astype(np.float32) for name in ("age", "age_yr", "vigour", "light", "disused_m2")}
    modules = Modules(
        first=first,
        number=number.astype(np.uint32),
        parent=(number - 1).astype(np.int32),
        node=rng.integers(-1, 30, m).astype(np.int16),
        prototype=rng.integers(0, 9, m).astype(np.uint8),
        base_m=rng.random((m, 3)).astype(np.float32),
        rotation=rng.random((m, 4)).astype(np.float32),
        **values,
    )
    return Population(
        time_yr=float(step),
        species_names=("pine",),
        plant_id=np.arange(n, dtype=np.uint32) * 2 + 1,
        species=np.zeros(n, dtype=np.uint16),
        position_m=rng.random((n, 3)),
        radius_m=np.ones(n),
        height_m=np.ones(n),
        age_yr=np.ones(n),
        status=np.zeros(n, dtype=np.uint8),
        step=step,
        modules=modules,
    )


SNAPSHOTS = [stand(0, [0, 2, 0, 1]), stand(1, [0, 0]), stand(2, []), stand(3, [5, 0, 1, 0])]


def test_modules_come_back_to_the_bit(tmp_path: Path) -> None:
    write_history(tmp_path / "history.parquet", SNAPSHOTS, modules=True)
    history = open_history(tmp_path / "history.parquet")
    assert history.grows_by_modules
    assert history.has_modules
    for before in SNAPSHOTS:
        after = history.whole(before.step).modules
        assert after is not None
        assert before.modules is not None
        for name, values in vars(before.modules).items():
            found = getattr(after, name)
            assert (found.dtype, found.shape) == (values.dtype, values.shape)
            assert found.tobytes() == values.tobytes()


def test_plants_are_the_same_with_and_without(tmp_path: Path) -> None:
    (tmp_path / "with").mkdir()
    write_history(tmp_path / "history.parquet", SNAPSHOTS)
    write_history(tmp_path / "with" / "history.parquet", SNAPSHOTS, modules=True)
    assert not (tmp_path / NAME).exists()
    history = open_history(tmp_path / "history.parquet")
    assert history.grows_by_modules
    assert not history.has_modules
    for one, other in zip(history, open_history(tmp_path / "with" / "history.parquet"), strict=True):
        assert one.modules is None
        np.testing.assert_array_equal(one.plant_id, other.plant_id)
        np.testing.assert_array_equal(one.position_m, other.position_m)


def test_plants_without_modules_of_their_own_have_no_such_table(tmp_path: Path) -> None:
    write_history(tmp_path / "history.parquet", [replace(one, modules=None) for one in SNAPSHOTS])
    assert not open_history(tmp_path / "history.parquet").grows_by_modules


def test_the_modules_of_another_history_are_refused(tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    write_history(tmp_path / "history.parquet", SNAPSHOTS, modules=True)
    write_history(tmp_path / "other" / "history.parquet", SNAPSHOTS[:2], modules=True)
    history = open_history(tmp_path / "history.parquet")
    (tmp_path / NAME).write_bytes((tmp_path / "other" / NAME).read_bytes())
    with raises_error(AssetError, place="modules.parquet"):
        history.whole(0)
    (tmp_path / NAME).unlink()
    with raises_error(AssetError, place="modules.parquet"):
        history.whole(0)


def test_a_simulation_that_fails_leaves_nothing(tmp_path: Path) -> None:
    def failing():
        yield SNAPSHOTS[0]
        raise RuntimeError("stop")

    with pytest.raises(RuntimeError, match="stop"):
        write_history(tmp_path / "history.parquet", failing(), modules=True)
    assert list(tmp_path.iterdir()) == []
