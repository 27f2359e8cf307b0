from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from forestgen.labels.labelled import visible_plants
from forestgen.labels.masks import instance_mask

POPULATION = np.array([2, 3, 70_000, 2**31 + 5, 2**32 - 1], np.uint32)


@settings(max_examples=200, deadline=None)
@given(
    hnp.arrays(
        np.uint32,
        hnp.array_shapes(min_dims=3, max_dims=3, min_side=1, max_side=7),
        elements=st.sampled_from([0, *POPULATION.tolist()[1:]]),
    )
)
def test_equals_counting_plant_by_plant(samples):
    instance = instance_mask(samples)
    seen = visible_plants(POPULATION, samples, instance)
    height, width = instance.shape
    for row, plant in enumerate(POPULATION):
        mask = instance == plant
        assert seen.visible_pixels[row] == mask.sum()
        assert seen.visible_area_px[row] == pytest.approx((samples == plant).mean(axis=-1).sum())
        if not mask.any():
            assert seen.box_px[row].tolist() == [0, 0, 0, 0]
            assert not seen.truncated[row]
            assert not seen.has_box[row]
            continue
        y, x = np.nonzero(mask)
        assert seen.box_px[row].tolist() == [x.min(), y.min(), x.max() - x.min() + 1, y.max() - y.min() + 1]
        assert seen.truncated[row] == (x.min() == 0 or y.min() == 0 or x.max() == width - 1 or y.max() == height - 1)


def test_a_plant_can_have_area_and_no_pixel():
    samples = np.array([[[3, 0, 0, 0]]], np.uint32)
    seen = visible_plants(POPULATION, samples, instance_mask(samples))
    assert seen.visible_area_px[1] == 0.25
    assert seen.visible_pixels[1] == 0


def test_a_stranger_is_refused():
    samples = np.full((2, 2, 2), 9, np.uint32)
    with pytest.raises(ValueError, match="9"):
        visible_plants(POPULATION, samples, instance_mask(samples))
