"""`forestgen fit-kernel`, through the command line's own parser."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

import forestgen as fg
from forestgen.cli import app
from forestgen.community.fitting import fit as fitting
from forestgen.community.fitting import likelihood
from forestgen.community.fitting.report import in_words
from forestgen.core.errors import RecipeError
from forestgen.recipe.load import load_recipe

DATA = Path(__file__).parents[1] / "community" / "data"


def run(*arguments):
    return CliRunner().invoke(app, ["fit-kernel", *map(str, arguments)])


@pytest.fixture
def points(tmp_path):
    """Write a file of points."""

    def write(rows, header="# window 0 10 0 10\nx,y", name="trees.csv"):
        path = tmp_path / name
        path.write_text("\n".join([header, *(",".join(map(str, row)) for row in rows)]) + "\n")
        return path

    return write


@pytest.fixture
def quick(monkeypatch):
    """Few new stands: the command is tested here, not the fit."""
    monkeypatch.setattr(fitting, "_MOST_STANDS", 8)
    monkeypatch.setattr(fitting, "_FEWEST_STANDS", 8)
    one = fitting.Round(1.0, 1, 2.0)
    monkeypatch.setattr(fitting, "ROUNDS", (one, one))
    monkeypatch.setattr(fitting, "_POOR", np.inf)
    monkeypatch.setattr(likelihood, "_PLANTS_IN_ALL", 100)


def scattered(n, seed=0):
    return np.random.default_rng(seed).random((n, 2)).round(4) * 10


def test_a_fit_leaves_a_recipe_a_picture_and_numbers(quick, tmp_path):
    target = tmp_path / "out" / "cells.yaml"
    result = run(DATA / "cells.csv", "-o", target, "--species", "spruce", "--checks", 2)
    assert result.exit_code == 0, result.output
    assert "at all 50 radii" in result.output or "of 50 radii; not at r =" in result.output
    assert "of 2 such checks" in result.output
    recipe = target.read_text()
    head = recipe.splitlines()[:3]
    assert "\n".join(head) in result.output
    assert f"more lines in {target}" in result.output
    assert recipe.splitlines()[-1] not in result.output  # of many numbers
    assert re.search(
        r"^new stands (agree with|differ from) the measured one.* in \d of 2 fresh sets", result.output.splitlines()[-1]
    )
    assert "drawn as" not in result.output
    assert target.with_suffix(".png").read_bytes().startswith(b"\x89PNG")
    numbers = json.loads(target.with_suffix(".json").read_text())
    assert numbers["n"] == 42
    assert numbers["species"][0]["plants_per_ha"] == 420_000
    assert [one["function"] for one in numbers["first_check"]] == ["K", "g", "G"]
    made = CliRunner().invoke(app, ["simulate", str(target), "-o", str(tmp_path / "new")])
    assert made.exit_code == 0, made.output
    assert "42 plants (42 spruce)" in made.output
    again = run(DATA / "cells.csv", "-o", target)
    assert again.exit_code == 4
    assert "--overwrite" in again.output


@pytest.mark.slow
def test_founders_are_a_species_of_the_recipe_that_comes_first(quick, tmp_path, monkeypatch):
    monkeypatch.setattr(fitting, "_POOR", 0.0)
    monkeypatch.setattr(fitting, "_BETTER", np.inf)
    monkeypatch.setattr(fitting, "_PLANTS_OF_A_FOUNDER", (4.5,))
    target = tmp_path / "redwood.yaml"
    result = run(DATA / "redwood.csv", "-o", target, "--species", "spruce")
    assert result.exit_code == 0, result.output
    assert "note: one kernel leaves the nearest neighbours far off" in result.output
    numbers = json.loads(target.with_suffix(".json").read_text())
    assert numbers["founders"] == 14
    assert [(one["affected"], one["acts"]) for one in numbers["kernels"]] == [
        ("founders", "founders"),
        ("followers", "founders"),
        ("followers", "followers"),
    ]
    acts_on = re.findall(r"^ {4,6}([a-z-]+):(?= \{distance|$)", target.read_text().split("kernels:")[1], re.M)
    assert acts_on == ["spruce-founder", "spruce-founder", "spruce", "spruce", "spruce"]
    made = CliRunner().invoke(app, ["simulate", str(target), "-o", str(tmp_path / "new")])
    assert made.exit_code == 0, made.output
    assert "62 plants (14 spruce-founder, 48 spruce)" in made.output


@pytest.mark.parametrize(("more", "next_step"), [([], "founders"), (["--no-founders"], "the test")])
def test_founders_are_tried_unless_they_are_not_wanted(quick, tmp_path, monkeypatch, more, next_step):
    def stop_at(step):
        def stop(*_):
            raise RecipeError(f"stopped at {step}")

        return stop

    monkeypatch.setattr(fitting, "_POOR", 0.0)
    monkeypatch.setattr(fitting, "match_founders", stop_at("founders"))
    monkeypatch.setattr(fitting.measured, "envelopes", stop_at("the test"))
    result = run(DATA / "redwood.csv", "-o", tmp_path / "fit", *more)
    assert f"stopped at {next_step}" in result.output


@pytest.mark.slow
def test_two_species_and_sizes_give_a_kernel_for_each_direction(quick, points, tmp_path):
    rng = np.random.default_rng(1)
    rows = [
        (x, y, radius, name)
        for (x, y), radius, name in zip(
            scattered(40), rng.uniform(0.1, 0.5, 40).round(3), ["oak", "fern tree"] * 20, strict=True
        )
    ]
    result = run(points(rows, "# window 0 10 0 10\nx,y,radius_m,species"), "-o", tmp_path / "two.yaml")
    assert result.exit_code == 0, result.output
    assert "K(r) of fern tree to oak" in result.output
    note = "note: fern tree: drawn as poplar, since no `species` says what they look like"
    assert result.output.index(note) < result.output.index("40 plants in 10 x 10 m")
    assert "G(r) of oak to fern tree" in result.output
    community = load_recipe(tmp_path / "two.yaml", []).draw(0)
    assert set(community.species) == {"oak", "fern-tree"}
    kernels = json.loads((tmp_path / "two.json").read_text())["kernels"]
    assert {(one["affected"], one["acts"]) for one in kernels} == {
        (a, b) for a in ("oak", "fern tree") for b in ("oak", "fern tree")
    }
    assert not kernels[0]["symmetric"]


def test_a_window_that_nobody_stated_is_told_before_the_fit(points, tmp_path, monkeypatch):
    def stop(*_, **__):
        raise RecipeError("stopped")

    monkeypatch.setattr(fitting, "fit_stand", stop)
    result = run(points(scattered(30), "x,y"), "-o", tmp_path / "fit")
    assert result.output.index("note: the window is the points' bounding box") < result.output.index("stopped")
    assert "note: new plants: drawn as poplar" in result.output


@pytest.mark.parametrize(
    ("held", "one_more", "says"),
    [
        ({"K": 19, "g": 12, "G": 20}, 20, "new stands agree with the measured one: "),
        ({"K": 7, "g": 6, "G": 20}, 6, "new stands agree with the measured one: "),
        ({"K": 19, "g": 12, "G": 2}, 15, "new stands differ from the measured one in nearest neighbours: "),
        ({"K": 0, "g": 12, "G": 2}, 15, "in pairs and nearest neighbours: "),
    ],
)
def test_the_verdict_in_words(held, one_more, says):
    fit = SimpleNamespace(checks=[()] * 20, held=lambda name, own=False: one_more if own else held[name])
    verdict = in_words(fit)
    assert says in verdict
    assert f"K (pairs) in {held['K']} of 20, " in verdict
    assert verdict.endswith(f"G (nearest neighbours) in {held['G']} of 20 fresh sets")


@pytest.mark.parametrize(
    ("rows", "header", "says"),
    [
        (scattered(19), "x,y", "too few plants for a fit"),
        ([(k, 2.0 * k) for k in range(30)], "# window 0 60 0 60\nx,y", "on one line"),
        ([*scattered(30), scattered(30)[3]], "# window 0 10 0 10\nx,y", "occurs twice"),
        (scattered(1501), "# window 0 10 0 10\nx,y", "too many plants for a fit"),
        ([(*one, "a" if k > 2 else "b") for k, one in enumerate(scattered(30))], "x,y,species", "3 of b"),
        ([(*one, k % 4) for k, one in enumerate(scattered(60))], "x,y,species", "too many species"),
        ([(*one, "") for one in scattered(30)], "x,y,species", "without a species"),
        ([(*one, -1) for one in scattered(30)], "x,y,radius_m", "no radius"),
        ([(*one, "nan") for one in scattered(30)], "x,y,radius_m", "no radius"),
        ([(*one, 1) for one in scattered(30)], "# none", "name the columns"),
        ([(*one, 1) for one in scattered(30)], "x,y,height", "name the columns"),
        (scattered(30) * 1000, "# window 0 10000 0 10000\nx,y", "window is too large"),
    ],
)  # fmt: skip
def test_stands_that_cannot_be_fitted(points, tmp_path, rows, header, says):
    result = run(points(rows, header), "-o", tmp_path / "fit")
    assert result.exit_code in (2, 3), result.output
    assert says in result.output
    assert "Traceback" not in result.output
    assert not (tmp_path / "fit").exists()


@pytest.mark.parametrize(
    ("more", "says"),
    [
        (["--species", "poplr"], "no such species"),
        (["--reach-m", "0.6"], "this reach does not suit"),
        (["--reach-m", "nan"], "this reach does not suit"),
        (["--window", "0", "0.5", "0", "1"], "outside the window"),
    ],
)
def test_arguments_that_cannot_be(tmp_path, more, says):
    result = run(DATA / "cells.csv", "-o", tmp_path / "fit", *more)
    assert result.exit_code == 2, result.output
    assert says in result.output


def test_bytes_that_are_no_text(tmp_path):
    path = tmp_path / "trees.csv"
    path.write_bytes(b"x,y\n1,2\n\xff,3\n")
    result = run(path)
    assert result.exit_code == 2
    assert "not UTF-8" in result.output


def test_help_loads_nothing_heavy():
    code = (
        "import sys\nfrom forestgen.cli import app\n"
        "try:\n    app(['fit-kernel', '--help'])\nexcept SystemExit:\n    pass\n"
        "print(sorted({'numpy', 'scipy', 'numba', 'matplotlib'} & set(sys.modules)))"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.splitlines()[-1] == "[]"


@pytest.mark.slow
def test_a_fit_prints_the_same_from_python(quick, tmp_path):
    target = tmp_path / "cells.yaml"
    result = run(DATA / "cells.csv", "-o", target, "--species", "spruce")
    fitted = fg.fit_kernel(DATA / "cells.csv", species="spruce", out=target, overwrite=True, progress=False)
    assert str(fitted).splitlines()[1:] == result.stdout.splitlines()[1:]  # the first has the time
    assert repr(fitted) == f"<FittedKernel: 42 plants, {target}>"
    loose = fg.fit_kernel(DATA / "cells.csv", species="spruce", progress=False)
    assert "more lines in recipe" in str(loose)
    assert "files:" not in str(loose)
