"""Histories of ecoclimates: what goes on from one is what would have gone on."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5netcdf
import numpy as np
import pytest
from ecoclimate_cases import HILLY, ecology, parameters

from forestgen.community.ecoclimate.parameters import ClimateChange, GlobalSeeding, MonthlyClimate, month_at
from forestgen.community.history import open_history, write_history
from forestgen.community.history_tables import MAPS_NAME as NAME
from forestgen.community.model import simulate
from forestgen.community.models.ecoclimate import MODEL
from forestgen.community.population import Population
from forestgen.community.resume import origin, snapshot_to_resume
from forestgen.core.errors import RecipeError
from forestgen.recipe.load import load_recipe_data
from forestgen.scene.plan import Plan, make_plan
from support.error_messages import raises_error

STEPS = 11
NORMALS = MonthlyClimate((5.0,) * 12, (60.0,) * 12)
RICH: dict[str, Any] = {
    "steps": STEPS,
    "step_yr": 0.25,
    "history_modules": True,
    "climate_changes": [{"from_yr": 1, "to_yr": 3, "precipitation": 0.5}],
    "global_seeding": [{"seeds_per_ha": 800, "every_yr": 0.5}],
    "changes": [{"at_yr": 1.5, "set": {"shade_cooling_k": 1.0, "soil_water": {"kind": "dryland", "cell_m": 3.0}}}],
    "disturbances": [{"at_yr": 2, "fell": {"circle": {"center_m": [5, 5], "radius_m": 3}}}],
}


def run(start: Population | None = None, **keys: Any) -> list[Population]:
    chosen = parameters(**{**RICH, **keys})
    return list(simulate(MODEL, chosen, HILLY, [ecology()], 6, steps=STEPS, start=start))


@pytest.fixture(scope="module")
def whole() -> list[Population]:
    return run()


def write(folder: Path, snapshots: list[Population]) -> Path:
    folder.mkdir()
    path = folder / "history.parquet"
    write_history(path, snapshots, {"seed": 6}, modules=True, size_m=HILLY.size_m)
    return path


@pytest.mark.parametrize("periodic", [False, True])
def test_a_resumed_simulation_writes_the_same_bytes(periodic: bool, tmp_path: Path) -> None:
    """From a step within a change of climate, before another of parameters and a felling, and from one after them."""
    whole = run(periodic=periodic)
    history = open_history(write(tmp_path / "whole", whole))
    assert history.has_modules
    for step in (5, 8):
        again = run(history.whole(step), periodic=periodic)
        write(tmp_path / f"again-{step}", again)
        write(tmp_path / f"tail-{step}", whole[step:])
        for name in ("history.parquet", "modules.parquet", NAME):
            assert (tmp_path / f"again-{step}" / name).read_bytes() == (tmp_path / f"tail-{step}" / name).read_bytes()


def test_the_maps_and_books_of_a_history_are_those_of_the_water(whole: list[Population], tmp_path: Path) -> None:
    write(tmp_path / "a", whole)
    with h5netcdf.File(tmp_path / "a" / NAME, "r") as file:
        assert {"soil_water_mm", "surface_water_mm", "soil_mean_mm"} < set(file.variables)
        assert all(file[name].attrs["units"] == "mm" for name in ("soil_water_mm", "surface_water_mm", "soil_mean_mm"))
        assert file["time_yr"][:] == pytest.approx(0.25 * np.arange(STEPS + 1))
        stored = file["soil_water_mm"][:].mean(axis=(1, 2)) + file["surface_water_mm"][:].mean(axis=(1, 2))
    books = [one.state["water"] for one in whole]
    assert stored == pytest.approx([one["stored_mm"] for one in books], rel=1e-12)
    for one in books:
        gone = one["stored_mm"] + one["uptake_mm"] + one["loss_mm"]
        assert gone == pytest.approx(one["start_mm"] + one["rain_mm"], rel=1e-12)
    assert np.all(np.diff([one["rain_mm"] for one in books]) > 0)


def test_a_snapshot_without_its_maps_or_modules_cannot_go_on(whole: list[Population]) -> None:
    last = whole[3]
    bare = Population(**{**vars(last), "maps": {"soil_water_mm": last.maps["soil_water_mm"]}})
    with raises_error(RecipeError, place="community.model"):
        run(bare)
    with raises_error(RecipeError, place="community.history_modules"):
        run(Population(**{**vars(last), "modules": None}))


def test_the_same_seed_gives_the_same_history_and_another_another(whole: list[Population]) -> None:
    first, again = whole[-1], run()[-1]
    assert all(first.maps[name].tobytes() == again.maps[name].tobytes() for name in first.maps)
    assert first.state == again.state
    chosen = parameters(**RICH)
    *_, other = simulate(MODEL, chosen, HILLY, [ecology()], 7, steps=STEPS)
    assert other.maps["soil_water_mm"].tobytes() != first.maps["soil_water_mm"].tobytes()


@pytest.mark.parametrize("months", [1, 3, 12])
@pytest.mark.parametrize("from_yr", [0.0, 0.05, 0.25, 1.0, 2.3, 50.0])
def test_what_is_still_to_come_has_done_nothing_yet(months: int, from_yr: float) -> None:
    """The step by which a change or seeds count as begun, from which a history of another future cannot go on."""
    change = ClimateChange(from_yr=from_yr, to_yr=from_yr, precipitation=0.5)
    seeds = GlobalSeeding(from_yr=from_yr)
    begun = change.step(months / 12)
    assert begun == seeds.step(months / 12) >= 1
    before, end = (begun - 1) * months, begun * months
    assert all(month_at(NORMALS, [change], k) == month_at(NORMALS, [], k) for k in range(before))
    assert seeds.times_before(before) == 0
    assert seeds.times_before(end) == 1


def test_one_history_has_several_climates_to_come(tmp_path: Path) -> None:
    """As `--resume` checks it: changes that have begun must be the same, later ones may not."""

    def planned(*changes: dict[str, Any], steps: int = 30) -> Plan:
        community = {
            "model": "ecoclimate", "steps": steps, "climate": {"place": "Juneau"}, "climate_changes": list(changes),
            "history_modules": True, "soil_water": {"cell_m": 5}, "initial_plants": 3,
        }  # fmt: skip
        data = {"forestgen": 1, "site": {"size_m": [10, 10]}, "species": {"shrub": None}, "community": community}
        return make_plan(load_recipe_data(data, "test").draw(0))

    early = {"from_yr": 0, "to_yr": 1, "precipitation": 0.9}
    slow, fast = ({"from_yr": 1, "to_yr": 1 + years, "precipitation": 0.2} for years in (10, 1))
    first = planned(early, slow, steps=14)
    plan = first.community
    snapshots = simulate(plan.model, plan.parameters, plan.site, plan.ecologies, 1, steps=14)
    write_history(tmp_path / "history.parquet", snapshots, origin(plan), modules=True, size_m=plan.site.size_m)
    for later in (planned(early, fast), planned(early)):
        assert snapshot_to_resume(later.community, tmp_path / "history.parquet", 12).step == 12
    for later, step in ((planned(early, fast), 13), (planned({**early, "precipitation": 0.8}, slow), 12)):
        with raises_error(RecipeError, place="resume"):
            snapshot_to_resume(later.community, tmp_path / "history.parquet", step)
