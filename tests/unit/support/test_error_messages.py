"""Texts of errors are in the golden file, and no test has them besides."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from forestgen.core import errors
from forestgen.core.errors import AssetError, ForestgenError, RecipeError, RecipeErrors
from support import error_messages
from support.error_messages import GOLDEN, ROOT, compare, normalized, parsed, raises_error, updated, written

OURS = {name for name, one in vars(errors).items() if isinstance(one, type) and issubclass(one, ForestgenError)}
# Tests that look for words of a message, and why its text is not in the golden file.
WORDS_ALLOWED = {
    "tests/system/test_dask.py::test_a_cluster_of_strangers_is_refused": "workers in the order of ports",
    "tests/system/test_dask.py::test_what_no_worker_has_is_refused_at_once": "workers in the order of ports",
    "tests/unit/recipe/test_broken_parts.py::test_who_names_it_is_told": "or a ValueError",
    "tests/unit/runs/test_records.py::test_a_record_with_one_wrong_bit_is_none": "of examples that Hypothesis draws",
    "tests/unit/runs/test_records.py::test_half_a_record_is_none": "of examples that Hypothesis draws",
}
MATCHED = re.compile(r"pytest\.raises\(\s*\(?([\w.,\s]+?)\)?,\s*match=")
FUNCTION = re.compile(r"^def (\w+)", re.MULTILINE)
MANY = RecipeErrors([RecipeError("bad value", where="a.yaml:3: seed", got="x"), AssetError("no such file")])
MESSAGES = {"tests/a.py::test_b": ["asset: gone"], "tests/a.py::test_b[#1 x]": [f"recipe: {MANY}", "lsystem: c\n  d"]}


@cache
def sources() -> dict[str, str]:
    """Text of each file of tests, by its path below the repository."""
    return {str(path.relative_to(ROOT)): path.read_text("utf-8") for path in sorted((ROOT / "tests").rglob("*.py"))}


def matches_of_words() -> Iterator[str]:
    """Functions that look for words in a message of ours."""
    for file, text in sources().items():
        for found in MATCHED.finditer(text):
            if any(name.strip().rpartition(".")[2] in OURS for name in found[1].split(",")):
                yield f"{file}::{FUNCTION.findall(text[: found.start()])[-1]}"


def test_words_of_messages_are_in_the_golden_file_alone() -> None:
    found = set(matches_of_words())
    assert not found - set(WORDS_ALLOWED), "use raises_error of tests/support/error_messages.py"
    assert not set(WORDS_ALLOWED) - found, "these need no exception any more"


def test_every_message_belongs_to_a_test() -> None:
    for test in parsed(GOLDEN.read_text("utf-8")):
        file, *_, name = test.partition("[")[0].split("::")
        assert f"def {name}(" in sources().get(file, ""), f"{test} is gone: pytest --update-messages {file}"


def test_a_golden_file_gives_back_its_messages() -> None:
    assert parsed(written(MESSAGES)) == MESSAGES


def test_an_update_replaces_what_ran_and_drops_what_is_gone() -> None:
    stored = {"a.py::x": ["asset: 1"], "a.py::gone": ["asset: 2"], "b.py::y": ["asset: 3"], "lost.py::z": ["asset: 4"]}
    assert updated(stored, {}, [], exists=lambda file: file != "lost.py") == {
        key: stored[key] for key in ("a.py::x", "a.py::gone", "b.py::y")
    }
    seen = {"a.py::x": ["asset: new"], "c.py::w": ["asset: 5"], "b.py::none": []}
    assert updated(stored, seen, ["a.py::x", "c.py::w"], exists=lambda _: True) == {
        "a.py::x": ["asset: new"],
        "b.py::y": ["asset: 3"],
        "lost.py::z": ["asset: 4"],
        "c.py::w": ["asset: 5"],
    }
    assert "b.py::y" not in updated(stored, {"b.py::y": []}, [], exists=lambda _: True)


@pytest.fixture
def own_golden(monkeypatch: pytest.MonkeyPatch) -> None:
    """One message of a test in the golden file."""
    monkeypatch.setattr(error_messages._Run, "test", "t.py::a")
    monkeypatch.setattr(error_messages._Run, "seen", [])
    monkeypatch.setattr(error_messages._Run, "updates", False)
    monkeypatch.setattr(error_messages, "_golden", lambda: {"t.py::a": ["recipe: r.yaml:1: site.size_m: too large"]})


def fail(problem: str, kind: type[ForestgenError] = RecipeError) -> None:
    raise kind(problem, where="r.yaml:1: site.size_m")


@pytest.mark.usefixtures("own_golden")
def test_an_error_is_compared_by_class_place_and_text() -> None:
    with raises_error(RecipeError, place="site.size_m") as caught:
        fail("too large")
    assert caught.value.got is None
    with pytest.raises(pytest.fail.Exception, match="message 2 of this test differs"), raises_error(RecipeError):
        fail("too large")


@pytest.mark.usefixtures("own_golden")
@pytest.mark.parametrize(
    ("problem", "kind", "place", "said"),
    [
        ("too small", RecipeError, None, r"- recipe: .*: too large\n\+ recipe: .*: too small"),
        ("too large", AssetError, None, r"- recipe: .*\n\+ asset: "),
        ("too large", RecipeError, "site", "not at site, but at r.yaml:1: site.size_m"),
        ("too large", RecipeError, "ize_m", "not at ize_m"),
    ],
)
def test_a_difference_is_shown(problem: str, kind: type[ForestgenError], place: str | None, said: str) -> None:
    with pytest.raises(pytest.fail.Exception, match=said), raises_error(RecipeError, AssetError, place=place):
        fail(problem, kind)


@pytest.mark.usefixtures("own_golden")
def test_another_class_passes_through() -> None:
    with pytest.raises(AssetError), raises_error(RecipeError):
        fail("too large", AssetError)


@pytest.mark.usefixtures("own_golden")
def test_a_message_of_a_command_that_has_changed() -> None:
    with pytest.raises(pytest.fail.Exception, match=r"pytest --update-messages t\.py::a"):
        compare("2", "error: no")


def test_folders_of_this_machine_have_names(tmp_path: Path) -> None:
    assert normalized(f"{tmp_path / 'a.png'}:3 and {tmp_path}, {ROOT / 'recipes'}") == (
        "<tmp>/a.png:3 and <tmp>, <root>/recipes"
    )
