"""Numbers as people read them."""

from __future__ import annotations

import pytest

from forestgen.cli.plant import _mass, _size


@pytest.mark.parametrize(
    ("kilograms", "said"),
    [(0, "none"), (4e-6, "4.00 mg"), (0.0123, "12.3 g"), (0.9999, "1000 g"), (1, "1.00 kg"), (3797, "3.80 t")],
)
def test_mass(kilograms: float, said: str) -> None:
    assert _mass(kilograms) == said


@pytest.mark.parametrize(
    ("size", "said"), [(0, "0 bytes"), (999, "999 bytes"), (1234, "1.23 kB"), (5 * 10**9, "5.00 GB")]
)
def test_size(size: int, said: str) -> None:
    assert _size(size) == said
