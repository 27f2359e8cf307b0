"""Arguments that are no path, no number, or too deep are told at once, by the parameter's name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from forestgen.core.arguments import (
    address_of,
    flag_of,
    listed,
    number_of,
    path_of,
    paths_of,
    plain_copy,
    shown,
    texts_of,
    whole_of,
)
from forestgen.core.errors import OutputError, RecipeError
from support.error_messages import raises_error

LONG = "a" * 300


@pytest.mark.parametrize("value", [None, 5, b"a", 1.5, object(), [], LONG, f"x/{LONG}/y", "a\0", "/tmp/\ud800", ""])
def test_what_is_no_path(value: Any) -> None:
    with pytest.raises(RecipeError) as caught:
        path_of(value, "folder")
    assert caught.value.where == "folder"


@pytest.mark.parametrize("value", [LONG, "a\0", "a\nb.obj", "a\udcff", "/tmp/\ud800", "a\x1b", ""])
def test_what_is_no_output(value: str) -> None:
    for check in (address_of, lambda one, where: path_of(one, where, output=True)):
        with pytest.raises(OutputError) as caught:
            check(value, "out")
        assert caught.value.where == "out"
        str(caught.value).encode()


def test_what_is_a_path() -> None:
    assert path_of("a/b", "x") == path_of(Path("a/b"), "x") == Path("a/b")
    assert path_of("a\udcff", "x") == Path("a\udcff")  # a file that is read may have such a name
    assert address_of(f"s3://bucket/{LONG}", "out") == f"s3://bucket/{LONG}"
    assert paths_of("ab", "x") == paths_of(["ab"], "x") == [Path("ab")]
    assert texts_of("ab", "x") == ["ab"]


@pytest.mark.parametrize("value", [None, "3", 1.0, float("nan"), True, 0, 11])
def test_what_is_no_whole_number(value: Any) -> None:
    with raises_error(RecipeError, place="count"):
        whole_of(value, "count", 1, 10)


@pytest.mark.parametrize("value", [3, None, {"a": 1}, np.array(3), object()])
def test_what_is_no_list(value: Any) -> None:
    with raises_error(RecipeError, place="x"):
        listed(value, "x", "steps")


@pytest.mark.parametrize("value", ["no", 0, 1, None, np.True_])
def test_what_is_no_flag(value: Any) -> None:
    with raises_error(RecipeError, place="resume"):
        flag_of(value, "resume")


def test_a_huge_number_is_told() -> None:
    with raises_error(RecipeError, place="count"):
        whole_of(10**5000, "count", 1, 10)


def test_numbers_may_be_those_of_numpy() -> None:
    assert whole_of(np.int64(3), "n", 1, 10) == 3
    assert number_of(np.float32(0.5), "x") == 0.5
    assert number_of(2, "x") == 2.0
    assert np.isnan(number_of(float("nan"), "x"))  # left to a check of its own
    for value in ("1 m", None, False, 10**400):
        with raises_error(RecipeError, place="x"):
            number_of(value, "x")


def test_a_copy_is_plain_and_bounded() -> None:
    inner = {"a": [1, (2, 3)]}
    copy = plain_copy(inner, "x")
    assert copy == inner
    assert copy["a"] is not inner["a"]
    deep: list[Any] = []
    for _ in range(5000):
        deep = [deep]
    circle: dict[str, Any] = {}
    circle["a"] = circle
    for value in (deep, circle):
        with raises_error(RecipeError, place="x"):
            plain_copy(value, "x")
        shown(value)
    wide: list[Any] = [0]
    for _ in range(35):
        wide = [wide, wide]
    with raises_error(RecipeError, place="x"):
        plain_copy(wide, "x")
