"""`forestgen simulate --resume`, and disturbances, as a user meets them."""

from __future__ import annotations

from pathlib import Path

import pytest
from command_line import run, tiny

from forestgen.community.history import open_history

DISTURBED = (
    "steps: 12, disturbances: [{at_step: 4, fell: {share: 0.5}}, {at_step: 9, plant: {species: fireweed, count: 5}}]"
)


@pytest.fixture
def recipe(tmp_path: Path) -> Path:
    return tiny(tmp_path, ("steps: 12", DISTURBED), ("[6, 5]", "[20, 20]"))


@pytest.mark.slow
def test_a_resumed_history_is_the_end_of_the_whole_one(recipe: Path, tmp_path: Path) -> None:
    assert run("simulate", recipe, "-o", tmp_path / "whole").code == 0
    whole = tmp_path / "whole" / "history.parquet"
    answer = run("simulate", recipe, "-o", tmp_path / "end", "--resume", whole, "--from-step", "5", "--map-step", "7")
    assert answer.code == 0, answer.err
    assert (tmp_path / "end" / "map-000007.png").exists()
    end = tmp_path / "end" / "history.parquet"
    assert [
        (p.step, p.plant_id.tobytes(), p.radius_m.tobytes(), p.status.tobytes()) for p in list(open_history(end))
    ] == [
        (p.step, p.plant_id.tobytes(), p.radius_m.tobytes(), p.status.tobytes()) for p in list(open_history(whole))[5:]
    ]
    # A resumed history is resumed as well, in its own place too.
    more = ("--set", "community.steps=14")
    assert run("simulate", recipe, "-o", tmp_path / "end", "--resume", end, "--overwrite", *more).code == 0
    assert [p.step for p in open_history(end)] == [12, 13, 14]


def test_what_cannot_be_resumed(recipe: Path, tmp_path: Path) -> None:
    assert run("simulate", recipe, "-o", tmp_path / "whole").code == 0
    whole, out = tmp_path / "whole" / "history.parquet", tmp_path / "out"
    simulate = ("simulate", recipe, "-o", out)
    run(*simulate, "--from-step", "3").refused(2)
    run(*simulate, "--resume", whole).refused(2)
    run(*simulate, "--resume", whole, "--from-step", "13").refused(2)
    run(*simulate, "--resume", whole, "--from-step", "3", "--set", "seed=4").refused(2)
    run(*simulate, "--resume", recipe).refused(2)
    run(*simulate, "--resume", tmp_path / "no").refused(2)
    run(*simulate, "--resume", whole, "--from-step", "8", "--map-step", "7").refused(2)
    assert not out.exists()


def test_a_disturbance_is_refused_with_its_line(recipe: Path, tmp_path: Path) -> None:
    simulate = ("simulate", recipe, "-o", tmp_path / "out", "--set")
    run(*simulate, "community.steps=8").refused(2)
    run(*simulate, "community.disturbances.0.at_yr=3").refused(2)
    run("validate", recipe, "--set", "site.size_m=[5,5]")
