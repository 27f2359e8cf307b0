"""Stands seen straight down from above are as bright as measured forests in bands of Sentinel-2A."""

import pytest

from support.stand_reflectance import BANDS, MEASURED, STANDS, measure

# Stands whose crowns let too much light down to the forest floor: half of what is seen of the birch stand is ground.
DARK = {("birch", "B8"): 0.65, ("beech", "B8"): 0.75, ("spruce", "B4"): 0.9}


@pytest.mark.slow
@pytest.mark.parametrize("name", STANDS)
def test_stands_reflect_as_forests_do(name):
    """Within the range of measured forests, whose sources are in tests/support/stand_reflectance.py."""
    found = measure(STANDS[name], samples=24)
    assert found.leaf_area_index == pytest.approx(STANDS[name].leaf_area_index, rel=0.08)
    for band in BANDS:
        low, high = MEASURED[name][band]
        assert found.error[band] < 0.03 * high
        assert low * DARK.get((name, band), 1.0) < found.factor[band] < high, band
