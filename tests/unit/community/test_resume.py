"""Which recipe continues which history."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from forestgen.community.history import open_history, write_history
from forestgen.community.resume import differences, note_of_other_code, origin, shown, snapshot_to_resume
from forestgen.community.simulation import final_population, snapshots
from forestgen.core.errors import AssetError, RecipeError
from forestgen.core.progress import Silent
from forestgen.recipe.load import load_recipe
from forestgen.scene.plan import Plan, check_plan
from support.error_messages import raises_error

QUICKSTART = Path(__file__).parents[3] / "recipes" / "quickstart.yaml"
STAND = (
    "site.size_m=[20,20]",
    "community.model=forest_footprints",
    "community.disturbances=[{at_step: 3, fell: {share: 0.5}}, {at_step: 8, burn: {survival: 0.2}}]",
)
BASE = ("community={model: forest_footprints, steps: 12}", *STAND)

ANOTHER = ("community.health_loss_per_yr=0.1", "community.step_yr=2", "community.disturbances=[]")


def planned(*overrides: str) -> Plan:
    return check_plan(load_recipe(QUICKSTART, [*BASE, *overrides]), simulate_only=True)


@pytest.fixture(scope="module")
def history(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path, plan = tmp_path_factory.mktemp("history") / "history.parquet", planned()
    write_history(path, snapshots(plan.community, Silent()), origin(plan.community))
    return path


def test_the_future_is_the_same_to_the_byte(history: Path) -> None:
    longer = planned("community.steps=15")
    whole = final_population(longer.community, Silent())
    for step in (0, 2, 3, 7, 8, 12, None):
        *_, last = snapshots(longer.community, Silent(), snapshot_to_resume(longer.community, history, step))
        assert last.step == 15
        assert last.plant_id.tobytes() == whole.plant_id.tobytes()
        assert last.radius_m.tobytes() == whole.radius_m.tobytes()


@pytest.mark.parametrize(
    ("overrides", "step"),
    [
        (("seed=8",), 3),
        (("first_image=2",), 3),
        (("site.size_m=[20,30]",), 3),
        (("species={poplar: , fireweed: , spruce: }",), 3),
        (("species.poplar={from: poplar, height_m: 9}",), 3),
        (("community.model=multiset_lsystem",), 3),
        (("community.step_yr=0.25",), 3),
        ((*ANOTHER, "seed=9", "first_image=3", "site.size_m=[9,9]"), 3),
        (("community.disturbances.0.fell.share=0.6",), 3),
        (("community.disturbances=[]",), 10),
        (("community.disturbances.1.at_step=2",), 3),
        ((), None),
        ((), 13),
        ((), -1),
    ],
)
def test_another_recipe_is_refused(history: Path, overrides: tuple[str, ...], step: int | None) -> None:
    with raises_error(RecipeError):
        snapshot_to_resume(planned(*overrides).community, history, step)


@pytest.mark.parametrize(
    ("override", "step"),
    [
        ("community.steps=40", 12),
        ("community.steps=9", 8),
        ("community.disturbances=[]", 2),
        ("community.disturbances.1.burn.survival=1", 7),
        ("sky.turbidity=5", 3),
        ("render.samples=1", 3),
    ],
)
def test_what_is_still_to_come_may_change(history: Path, override: str, step: int) -> None:
    start = snapshot_to_resume(planned(override).community, history, step)
    assert start.step == step
    *_, last = snapshots(planned(override).community, Silent(), start)
    assert last.step == planned(override).community.steps


def test_a_stand_left_alone_has_more_plants_than_one_that_burns(history: Path) -> None:
    alone, burnt = (
        planned(*more) for more in ((f"community.disturbances=[{'{at_step: 3, fell: {share: 0.5}}'}]",), ())
    )
    ends = [
        list(snapshots(one.community, Silent(), snapshot_to_resume(one.community, history, 7)))[1]
        for one in (alone, burnt)
    ]
    assert len(ends[0]) > 2 * len(ends[1])
    assert np.isin(ends[1].plant_id, ends[0].plant_id).all()


def test_other_code_is_told(history: Path, tmp_path: Path) -> None:
    assert note_of_other_code(history) is None
    for code, said in (("0123456789", "other code (01234567, now "), (None, "does not say which code")):
        path = tmp_path / "other.parquet"
        write_history(path, open_history(history), {**origin(planned().community), "code": code})
        assert said in (note_of_other_code(path) or "")
        assert snapshot_to_resume(planned().community, path, 3).step == 3


def test_differences_are_told_key_by_key() -> None:
    before = {"a": {"b": 1, "c": [1, 2], "same": 0}, "list": [{"x": 1, "y": 2}], "gone": {"k": None, "v": 3}}
    now = {"a": {"b": 2, "c": [1, 3], "same": 0}, "list": [{"x": 1, "y": 5}]}
    told = {one.key: (one.before, one.now) for one in differences(before, now)}
    assert told == {"a.b": (1, 2), "a.c": ([1, 2], [1, 3]), "list.0.y": (2, 5), "gone": ({"k": None, "v": 3}, None)}
    assert [one.key for one in differences({"a": {1: 2}}, {"a": {1: 3}})] == ["a.1"]  # YAML knows numbers as keys
    assert shown(told["gone"][0]) == "{v: 3}"
    assert shown(None) == "(none)"


def test_no_history(history: Path, tmp_path: Path) -> None:
    for path in (tmp_path / "none.parquet", QUICKSTART, tmp_path):
        with raises_error(AssetError):
            snapshot_to_resume(planned().community, path, None)
    nameless = tmp_path / "nameless.parquet"
    write_history(nameless, open_history(history))
    with raises_error(RecipeError, place="resume"):
        snapshot_to_resume(planned().community, nameless, 3)
    (tmp_path / "cut.parquet").write_bytes(history.read_bytes()[:-100])
    with pytest.raises(AssetError):
        snapshot_to_resume(planned().community, tmp_path / "cut.parquet", 3)
