from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from forestgen.community.population import Site, SpeciesEcology

_TREE = {
    "name": "tree",
    "growth_m_per_yr": 0.1,
    "max_radius_m": 2.0,
    "shade_tolerance": 0.5,
    "old_age_survival": 0.9,
    "seedlings_per_ha_per_yr": 400.0,
    "seedling_radius_m": 0.1,
    "height_scale": 8.0,
    "height_exponent": 0.75,
}


@pytest.fixture
def tree() -> Callable[..., SpeciesEcology]:
    """A species; keyword arguments replace its numbers."""
    return lambda **numbers: SpeciesEcology(**{**_TREE, **numbers})  # type: ignore[arg-type]


@pytest.fixture
def site() -> Site:
    return Site((60.0, 40.0))


@pytest.fixture
def columns_equal() -> Callable[[Any, Any], bool]:
    """Whether two dataclasses of arrays hold the same bytes."""

    def equal(a: Any, b: Any) -> bool:
        names = vars(a).keys()
        return all(
            getattr(a, n).tobytes() == getattr(b, n).tobytes()
            if hasattr(getattr(a, n), "tobytes")
            else getattr(a, n) == getattr(b, n)
            for n in names
        )

    return equal
