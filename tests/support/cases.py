"""Which cases of a parametrised test run by default: each behaviour keeps one, the others are slow."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def few(values: Iterable[Any], number: int = 1) -> list[Any]:
    """The cases of `parametrize`, all but the first `number` marked slow; a tuple is the arguments of one case."""
    cases = [value if isinstance(value, tuple) else (value,) for value in values]
    return [pytest.param(*case, marks=() if i < number else pytest.mark.slow) for i, case in enumerate(cases)]
