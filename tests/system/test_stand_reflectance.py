"""Closed stands are as bright as measured forests seen from above, in bands of Sentinel-2A, and as open from below."""

import pytest

from support.stand_reflectance import BANDS, MEASURED, measure
from support.stand_structure import STANDS, grown, misses, structure


@pytest.mark.slow
@pytest.mark.parametrize("name", STANDS)
def test_stands_reflect_as_forests_do(name):
    """Within the range of measured forests, as tests/support/stand_reflectance.py has it, and its own noise."""
    found = measure(name, samples=24)
    for band in BANDS:
        low, high = MEASURED[name][band]
        assert found.error[band] < 0.03 * high
        assert low - 2.0 * found.error[band] < found.factor[band] < high + 2.0 * found.error[band], band


@pytest.mark.slow
@pytest.mark.parametrize("name", STANDS)
def test_stands_are_as_open_as_forests(name):
    """Clumping, density and profile of leaves within measured ranges: tests/support/stand_structure.py."""
    found = structure(grown(STANDS[name]))
    assert found.leaf_area_index == pytest.approx(STANDS[name].leaf_area_index, rel=0.08)
    assert misses(name, found) == []
