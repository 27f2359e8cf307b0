"""Which cases of a test run by default, and which with the slow ones."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def sampled(cases: Iterable[Any], every: int = 4) -> list[Any]:
    """The first of every so many cases by default, the others with the slow tests; they keep their order and ids."""
    return [one if number % every == 0 else _slow(one) for number, one in enumerate(cases)]


def few(cases: Iterable[Any], number: int = 1) -> list[Any]:
    """The first `number` cases by default, the others with the slow tests."""
    return [one if i < number else _slow(one) for i, one in enumerate(cases)]


def slow_but(cases: Iterable[Any], *kept: Any) -> list[Any]:
    """Some cases by default, the others with the slow tests."""
    return [one if one in kept else _slow(one) for one in cases]


def _slow(case: Any) -> Any:
    if hasattr(case, "marks"):  # it is a parameter set already
        return pytest.param(*case.values, marks=[*case.marks, pytest.mark.slow], id=case.id)
    values = case if isinstance(case, tuple) else (case,)
    return pytest.param(*values, marks=pytest.mark.slow)
