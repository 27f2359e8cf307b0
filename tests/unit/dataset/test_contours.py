from __future__ import annotations

import numpy as np
import pytest
from format_shots import awkward_masks
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from forestgen.dataset.formats.contours import polygons


def windings(ring, height, width):
    """(H, W) winding number and count of crossings of each pixel's centre, in whole numbers: exact."""
    winding, crossings = np.zeros((height, width), int), np.zeros((height, width), int)
    centre = 2 * np.arange(width) + 1  # in half pixels
    for (x0, y0), (x1, y1) in zip(ring.tolist(), np.roll(ring, -1, axis=0).tolist(), strict=True):
        down = 1 if y1 > y0 else -1
        for row in range(min(y0, y1), max(y0, y1)):
            edge = down * (2 * x0 * (y1 - y0) + (x1 - x0) * (2 * row + 1 - 2 * y0))  # times the edge's height
            right = centre * abs(y1 - y0) > edge
            winding[row] -= down * right
            crossings[row] += right
    return winding, crossings


def check(instance):
    height, width = instance.shape
    found = polygons(instance)
    assert list(found) == [plant for plant in np.unique(instance).tolist() if plant]
    for plant, ring in found.items():
        winding, crossings = windings(ring, height, width)
        np.testing.assert_array_equal(crossings % 2 == 1, instance == plant)
        np.testing.assert_array_equal(winding, instance == plant)  # 1 inside, 0 in holes: walked with the plant right


@settings(max_examples=80, deadline=None)
@given(
    hnp.arrays(
        np.uint32,
        hnp.array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=8),
        elements=st.sampled_from([0, 0, 1, 1, 2**32 - 1]),
    )
)
def test_filling_a_polygon_gives_the_mask_holes_included(instance):
    check(instance)


@pytest.mark.parametrize("number", range(len(awkward_masks())))
def test_awkward_masks(number):
    check(awkward_masks()[number])


def test_a_rectangle_has_four_corners():
    instance = np.zeros((6, 9), np.uint32)
    instance[1:4, 2:7] = 5
    corners = {tuple(corner) for corner in polygons(instance)[5].tolist()}
    assert corners == {(2, 1), (7, 1), (7, 4), (2, 4)}
    assert len(polygons(instance)[5]) == 4


def test_matplotlib_agrees_on_a_crown_of_scattered_leaves():
    from matplotlib.path import Path

    rng = np.random.default_rng(3)
    y, x = np.mgrid[:40, :50]
    instance = np.where(((x - 25) ** 2 + (y - 20) ** 2 < 300) & (rng.random(x.shape) < 0.6), 9, 0).astype(np.uint32)
    ring = polygons(instance)[9].astype(float)
    centres = np.stack([x.ravel() + 0.5, y.ravel() + 0.4999], axis=1)  # not quite on the bridges
    inside = Path(np.vstack([ring, ring[:1]])).contains_points(centres).reshape(x.shape)
    np.testing.assert_array_equal(inside, instance == 9)
