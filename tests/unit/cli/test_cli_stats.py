"""`forestgen stats`, through the command line's own parser."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from forestgen.cli import app
from forestgen.cli.parsing import join_numbers
from forestgen.community import point_statistics
from forestgen.community.point_patterns import Window, measure_distances
from forestgen.community.point_statistics import read_points
from forestgen.core.randomness import child_rng

DATA = Path(__file__).parents[1] / "community" / "data"
KEYS = {
    "n", "density", "hopkins", "hopkins_skellam", "clark_evans", "clark_evans_donnelly", "radii",
    "ripley_k_isotropic", "ripley_k_translation",
}  # fmt: skip


def run(*arguments):
    return CliRunner().invoke(app, ["stats", *map(str, arguments)])


def numbers(*arguments):
    result = run(*arguments, "--json")
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


def test_the_numbers_of_the_redwoods():
    found = numbers(DATA / "redwood.csv", "--window", 0, 1, -1, 0, "--radii", 0.05, 0.1)
    assert set(found) >= KEYS
    assert (found["n"], found["density"], found["radii"]) == (62, 62.0, [0.05, 0.1])
    assert found["clark_evans"] == pytest.approx(0.618650, abs=5.1e-7)
    assert found["clark_evans_donnelly"] == pytest.approx(0.584991, abs=5.1e-7)
    assert found["ripley_k_isotropic"][1] == pytest.approx(0.066721886, abs=5.1e-10)
    assert found["ripley_k_translation"][1] == pytest.approx(0.072104016, abs=5.1e-10)
    assert found["hopkins_skellam"] == pytest.approx(0.186, rel=0.01)
    assert found["hopkins"] > 2


@pytest.mark.parametrize(
    "radii",
    [
        ["--radii", "0.05", "0.1", "0.2"],
        ["--radii", "0.05,0.1,0.2"],
        ["--radii", "0.05", "--radii", "0.1", "--radii=0.2"],
        ["--radii=0.05,0.1", "--radii", ".2"],
        ["--radii", "0.05, 0.1", "2e-1"],
    ],
)
@pytest.mark.parametrize("first", [True, False])
def test_ways_to_give_radii(radii, first):
    path = DATA / "cells.csv"
    found = numbers(*([path, *radii] if first else [*radii, path]))
    assert found["radii"] == [0.05, 0.1, 0.2]


def test_what_follows_an_option_is_taken_as_far_as_it_looks_like_a_number():
    assert join_numbers(["--radii", "1", "2", "a.csv", "3"], "--radii") == ["--radii=1,2", "a.csv", "3"]
    assert join_numbers(["--", "--radii", "1", "2"], "--radii") == ["--", "--radii", "1", "2"]
    assert join_numbers(["a.csv", "--radii"], "--radii") == ["a.csv", "--radii"]
    assert join_numbers(["--radii", "1", "-2", "--json"], "--radii") == ["--radii=1,-2", "--json"]


def test_radii_by_default_stay_well_inside_the_window():
    found = numbers(DATA / "cells.csv")
    assert found["radii"] == pytest.approx(np.arange(1, 11) * 0.025)
    assert len(found["ripley_k_isotropic"]) == len(found["ripley_k_translation"]) == 10


def test_the_same_file_gives_the_same_bytes():
    assert run(DATA / "cells.csv", "--json").stdout == run(DATA / "cells.csv", "--json").stdout


@pytest.mark.parametrize(
    ("name", "word"), [("redwood", "clustered"), ("cells", "regular"), ("japanesepines", "random")]
)
def test_one_word_for_each_index(name, word):
    result = run(DATA / f"{name}.csv", "--radii", "0.08")
    assert result.exit_code == 0
    rows = [line.split() for line in result.stdout.splitlines() if line]
    assert [row[-1] for row in rows if row[0].startswith(("Hopkins", "Clark", "0.08"))] == [word] * 5
    assert all(len(line) <= 80 for line in result.stdout.splitlines()[1:])


def test_a_window_that_was_assumed_is_told(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("x,y\n" + "".join(f"{x},{y}\n" for x, y in np.random.default_rng(0).random((30, 2))))
    assert "bounding box" in run(path).stdout
    assert "bounding box" in numbers(path)["notes"][0]
    assert "bounding box" not in run(path, "--window", 0, 1, 0, 1).stdout


def share_inside(centre, radius, window):
    """Share of a circle in the window, by walking around it."""
    angle = (np.arange(20_000) + 0.5) * (2 * np.pi / 20_000)
    return 1 - window.outside(centre + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)).mean()


def test_points_at_one_place_against_brute_force(tmp_path):
    """Redwoods on a lattice of 0.05 m: copies, some in threes."""
    points = np.round(read_points(DATA / "redwood.csv").points_m / 0.05) * 0.05
    n, window = len(points), Window(0.0, 1.0, -1.0, 0.0)
    path = tmp_path / "rounded.csv"
    path.write_text("x,y\n" + "".join(f"{x!r},{y!r}\n" for x, y in points.tolist()))
    edges, radii = ("--window", 0, 1, -1, 0), [0.0, 0.02, 0.12, 0.3]
    found = numbers(path, *edges, "--radii", *radii)

    distance = np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1))
    np.fill_diagonal(distance, np.inf)
    copies = n - len(np.unique(points, axis=0))
    assert found["duplicates"] == copies > 5
    assert found["n"] == n
    assert f"{copies} of {n} points lie at the place of an earlier one" in found["notes"][0]
    shown = run(path, *edges).stdout.replace("\n", " ")
    assert f"note: {found['notes'][0]}" in shown
    nearest = distance.min(axis=1)
    assert (nearest == 0).sum() > copies
    assert found["clark_evans"] == pytest.approx(nearest.mean() * 2 * np.sqrt(n))
    donnelly = 0.5 / np.sqrt(n) + (0.0514 + 0.0412 / np.sqrt(n)) * 4 / n
    assert found["clark_evans_donnelly"] == pytest.approx(nearest.mean() / donnelly)

    # Copies do not change the distance from a place of the window to the nearest point.
    spread = measure_distances(np.unique(points, axis=0), window, child_rng(0, "stats")).from_window_m
    assert found["hopkins"] == pytest.approx(spread.mean() / nearest.mean())
    assert found["hopkins_skellam"] == pytest.approx((nearest**2).mean() / (spread**2).mean(), rel=0.05)

    pairs = [(i, j) for i in range(n) for j in range(n) if distance[i, j] <= max(radii)]
    d = np.array([distance[pair] for pair in pairs])
    step = np.abs([points[i] - points[j] for i, j in pairs])
    translation = 1 / np.prod(1 - step, axis=1)
    isotropic = np.array([1 / max(share_inside(points[i], distance[i, j], window), 0.01) for i, j in pairs])
    for weights, key in ((translation, "ripley_k_translation"), (isotropic, "ripley_k_isotropic")):
        expected = [weights[d <= r].sum() / (n * (n - 1)) for r in radii]
        assert expected[0] > 0
        assert found[key] == pytest.approx(expected, rel=1e-3)


def test_all_points_at_one_place_have_numbers(tmp_path):
    path = tmp_path / "one.csv"
    path.write_text("0.5,0.5\n" * 12)
    found = numbers(path, "--window", 0, 1, 0, 1, "--radii", 0.1)
    assert (found["duplicates"], found["clark_evans"], found["hopkins"]) == (11, 0.0, None)
    assert found["ripley_k_translation"] == pytest.approx([1.0])
    assert run(path, "--window", 0, 1, 0, 1).exit_code == 0


def test_two_points_have_numbers_where_they_can(tmp_path):
    path = tmp_path / "two.csv"
    path.write_text("0.25,0.5\n0.75,0.5\n")
    found = numbers(path, "--window", 0, 1, 0, 1)
    assert found["hopkins_error"] is None
    assert found["hopkins"] < 1
    assert "unclear" in run(path, "--window", 0, 1, 0, 1).stdout


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["--radii", "-0.1"], 2, ["--radii", "0 to 0.707107", "-0.1"]),
        (["--radii", "0.1", "5"], 2, ["too large", "0 to 0.707107", "5"]),
        (["--radii", "nan"], 2, ["no radius", "nan"]),
        (["--radii", "a"], 2, ["no radius", "a"]),
        (["--radii", ","], 2, ["1 to 1000"]),
        (["--radii"], 2, ["requires an argument"]),
        (["--window", "1", "0", "0", "1"], 2, ["--window", "x0 < x1", "1 0 0 1"]),
        (["--window", "0", "nan", "0", "1"], 2, ["--window"]),
        (["--window", "0", "1", "0"], 2, ["requires 4 arguments"]),
        (["--window", "0", "0.5", "0", "1"], 2, ["outside", "cells.csv:"]),
    ],
)
def test_bad_arguments(arguments, code, words):
    result = run(DATA / "cells.csv", *arguments)
    assert result.exit_code == code
    for word in words:
        assert word in result.output
    assert "Traceback" not in result.output


def test_too_many_pairs_are_refused_before_they_are_made(monkeypatch):
    monkeypatch.setattr(point_statistics, "_MOST_PAIRS", 10)
    result = run(DATA / "cells.csv", "--radii", "0.5")
    assert result.exit_code == 3
    assert "lower the greatest radius" in result.output


def test_help_waits_for_no_library():
    code = (
        "import sys, typer.testing as t, forestgen.cli as c; r = t.CliRunner().invoke(c.app, ['stats', '--help']);"
        "assert 'clustered' in r.output; assert not {'numpy', 'scipy', 'gudhi', 'rich.table'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
