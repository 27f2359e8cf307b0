"""Numbers as people read them."""

from __future__ import annotations

import pytest

from forestgen.cli.plant import _mass


@pytest.mark.parametrize(
    ("kilograms", "said"),
    [(0, "none"), (4e-6, "4 mg"), (0.0123, "12.3 g"), (0.9999, "1,000 g"), (1, "1 kg"), (3797, "3.8 t")],
)
def test_mass(kilograms: float, said: str) -> None:
    assert _mass(kilograms) == said
