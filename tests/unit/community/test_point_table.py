"""Point patterns from files: what is read, and what is said of the rest."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from forestgen.community import point_statistics
from forestgen.community.point_patterns import Window
from forestgen.community.point_statistics import read_points
from forestgen.core.errors import AssetError, ForestgenError, RecipeError, ResourceError
from support.error_messages import raises_error

DATA = Path(__file__).parent / "data"


@pytest.fixture
def table(tmp_path):
    """Write a file and read it."""

    def read(content, window=None):
        path = tmp_path / "trees.csv"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return read_points(path, window)

    return read


def test_a_file_with_its_window_in_a_comment():
    found = read_points(DATA / "redwood.csv")
    assert found.points_m.shape == (62, 2)
    assert found.points_m[0].tolist() == [0.36, -0.08]
    assert found.window == Window(0.0, 1.0, -1.0, 0.0)
    assert found.notes == ()


def test_points_at_one_place_are_counted_where_they_are_allowed(tmp_path):
    path = tmp_path / "trees.csv"
    path.write_text("# window 0 9 0 9\nx,y\n1,2\n3,4\n1.0,2\n5,6\n1,2\n3,4\n")
    table = read_points(path, allow_duplicates=True)
    assert table.duplicates == 3
    assert table.points_m.tolist() == [[1, 2], [3, 4], [1, 2], [5, 6], [1, 2], [3, 4]]
    assert [note.split(":")[0] for note in table.notes] == ["3 of 6 points lie at the place of an earlier one"]
    path.write_text("# window 0 9 0 9\nx,y\n1,2\n3,4\n")
    assert (read_points(path).duplicates, read_points(path).notes) == (0, ())


@pytest.mark.parametrize(
    "content",
    [
        "x,y\n1,2\n3,4.5\n",
        "1,2\n3,4.5",
        "\ufeffx,y\r\n1,2\r\n\r\n3,4.5\r\n",
        '# a\n"X", "Y"\n# b\n 1 , 2e0\n3.0,+4.5\n',
    ],
)
def test_ways_to_write_the_same_points(table, content):
    assert table(content, (0, 5, 0, 5)).points_m.tolist() == [[1.0, 2.0], [3.0, 4.5]]


@pytest.mark.parametrize(
    "comment",
    [
        "# window 0 5 1 6",
        "#Window: 0, 5, 1, 6",
        "# plot 7, window = 0 5e0 1.0 6 n 62",
        "# WINDOW 0 5 1 6\n# window 0 5 1 6",
    ],
)
def test_windows_that_comments_state(table, comment):
    found = table(f"{comment}\nx,y\n1,2\n3,4\n")
    assert found.window == Window(0.0, 5.0, 1.0, 6.0)
    assert not found.notes


@pytest.mark.parametrize(
    "comment",
    [
        "# trees",
        "# window 0 5",
        "# window 0 5 1 6 7",
        "# window 0 0 5 6",
        "# window 5 0 1 6",
        "# windows 0 5 1 6",
        "# window 0 5 1 6\n# window 0 9 1 6",
        "# window 0 5 1 6m",
    ],
)
def test_comments_that_state_no_window_or_two(table, comment):
    found = table(f"{comment}\nx,y\n1,2\n3,4\n")
    assert found.window == Window(1.0, 3.0, 2.0, 4.0)
    assert "bounding box" in found.notes[0]


def test_a_given_window_comes_before_that_of_the_file(table):
    found = table("# window 0 5 0 5\nx,y\n1,2\n3,4\n", (0, 9, 0, 9))
    assert found.window == Window(0.0, 9.0, 0.0, 9.0)
    assert not found.notes


@pytest.mark.parametrize(
    "content",
    [
        "",
        "x,y\n",
        "x,y\n1,2\n",
        "x,y\n1,2,3\n",
        "x,y\n1,2\n1;3\n",
        "a,b\n1,2\n",
        "x,y\n1,\n",
        "x,y\n1,2\nx,y\n",
        "x,y\n1_0,2\n",
        "x,y\n1,2\n\n# c\nnan,3\n",
        "x,y\n1,inf\n",
        "x,y\n1,1e300\n",
        "x,y\n1,2\n3,4\n1.0,2\n",
        "x,y\n1,2\n1,4\n",
        b"x,y\n1,2\n\x00\x01\n",
        b"x,y\n1,2\n\xff,3\n",
        b"\x89PNG\r\n\x1a\n\x00\x00",
        "1" * 20_000,
        "# window 0 2 0 9\nx,y\n1,2\n3,4\n5,6\n",
    ],
)
def test_files_that_hold_no_pattern(table, content):
    with raises_error(AssetError):
        table(content)


def test_files_that_cannot_be_read(tmp_path):
    with raises_error(AssetError, place="nowhere.csv"):
        read_points(tmp_path / "nowhere.csv")
    with raises_error(AssetError):
        read_points(tmp_path)


@pytest.mark.parametrize("window", [(1, 0, 0, 1), (0, 1, 3, 3), (0, float("nan"), 0, 1)])
def test_windows_that_are_refused_before_the_file_is_read(tmp_path, window):
    with raises_error(RecipeError, place="window"):
        read_points(tmp_path / "nowhere.csv", window)


def test_too_many_points(table, monkeypatch):
    monkeypatch.setattr(point_statistics, "MOST_POINTS", 100)
    rows = "\n".join(f"{k},{k}" for k in range(101))
    with raises_error(ResourceError, place="trees.csv"):
        table(rows)


def test_no_bytes_make_a_bug(table):
    rng = np.random.default_rng(0)
    pieces = [
        b"x,y\n",
        b"1,2\n",
        b"# window",
        b" 0 1 0 1",
        b"\n",
        b",",
        b"-",
        b"nan",
        b"\xff",
        b"\0",
        b"1e999,0\n",
        b"0.5",
    ]
    for _ in range(400):
        content = b"".join(pieces[k] for k in rng.integers(0, len(pieces), rng.integers(1, 12)))
        with suppress(ForestgenError):
            assert len(table(content).points_m) >= 2
