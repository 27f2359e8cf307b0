"""Numbers for people."""

from __future__ import annotations

import pytest

from forestgen.core.figures import show_bytes, three_digits


@pytest.mark.parametrize(
    ("value", "text"),
    [(0, "0"), (0.1234, "0.123"), (9.996, "10"), (41.06, "41.1"), (1216.0, "1,220"), (1_216_000, "1,220,000")],
)
def test_three_digits_without_an_exponent(value: float, text: str) -> None:
    assert three_digits(value) == text


@pytest.mark.parametrize(
    ("count", "text"), [(0, "0 kB"), (125_000, "125 kB"), (999_700_000, "1,000 MB"), (1.234e12, "1.23 TB")]
)
def test_bytes(count: float, text: str) -> None:
    assert show_bytes(count) == text
