from __future__ import annotations

from fractions import Fraction
from itertools import product

import numpy as np
import pytest
from format_shots import awkward_masks
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from rasterisers import opencv_fill, overlap, pillow_fill
from scipy.ndimage import label

from forestgen.dataset.check.yolo import _differences
from forestgen.dataset.formats import contours
from forestgen.dataset.formats.contours import polygons

NEIGHBOURS = np.ones((3, 3))
INSTANCES = hnp.arrays(
    np.uint32,
    hnp.array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=12),
    elements=st.sampled_from([0, 0, 1, 1, 2**32 - 1]),
)


def scattered(seed, shape=(60, 80), share=0.3):
    """A crown of single leaves: many pieces and holes."""
    rng = np.random.default_rng(seed)
    y, x = np.indices(shape)
    inside = ((x - shape[1] / 2) / shape[1]) ** 2 + ((y - shape[0] / 2) / shape[0]) ** 2 < 0.2
    return np.where(inside & (rng.random(shape) < share), 9, 0).astype(np.uint32)


def padded(corners):
    return corners if len(corners) > 2 else np.concatenate([corners, np.repeat(corners[-1:], 3 - len(corners), 0)])


def check(instance):
    found = polygons(instance)
    assert list(found) == [plant for plant in np.unique(instance).tolist() if plant]
    for plant, corners in found.items():
        mask = instance == plant
        pieces, number = label(mask, NEIGHBOURS)
        drawn = opencv_fill(corners, mask.shape)
        if number == 1:
            np.testing.assert_array_equal(drawn, mask)
        assert corners.min() >= 0
        assert (corners < mask.shape[::-1]).all()
        largest = 1 + np.bincount(pieces[mask])[1:].argmax()
        assert drawn[pieces == largest].all()
        y, x = np.nonzero(mask)
        corner = np.array([x.min(), y.min()])
        box = mask[y.min() : y.max() + 1, x.min() : x.max() + 1]
        added, missing = _differences(corners - corner, box)  # the checker's definition
        assert not added.any()
        assert not missing.any()


@settings(max_examples=150, deadline=None)
@given(INSTANCES)
@example(np.array([[1, 0, 1], [0, 0, 0], [1, 0, 1]], np.uint32))
@example(np.array([[1, 0, 0, 0, 0, 1]], np.uint32))
def test_opencv_fills_a_polygon_to_whole_pieces_and_bridges(instance):
    check(instance)


@settings(max_examples=150, deadline=None)
@given(INSTANCES)
def test_one_piece_is_exact_whoever_fills_it(instance):
    pieces, number = label(instance, NEIGHBOURS)
    for piece in range(1, number + 1):
        mask = pieces == piece
        corners = padded(polygons(mask.astype(np.uint32))[1])
        np.testing.assert_array_equal(opencv_fill(corners, mask.shape), mask)
        np.testing.assert_array_equal(pillow_fill(corners, mask.shape) & mask, mask)


@pytest.mark.parametrize("number", range(len(awkward_masks())))
def test_awkward_masks(number):
    check(awkward_masks()[number])


@pytest.mark.parametrize(
    ("rows", "corners"),
    [
        (["#"], 1),
        (["##"], 2),
        (["#######"], 2),
        (["#", "#", "#"], 2),
        (["#...", ".#..", "..#.", "...#"], 2),
        (["#####", "#####", "#####"], 4),
        (["#####", "#...#", "#...#", "#####"], 13),  # the octagon around the hole, and the rectangle
        ([".#.", "###", ".#."], 4),
        (["#.#"], 2),  # three pixels, one of them not the plant's
        (["#..........#"], 1),  # the bridge would add ten pixels
    ],
)
def test_thin_and_small_masks(rows, corners):
    instance = np.array([[4 * (pixel == "#") for pixel in row] for row in rows], np.uint32)
    assert len(polygons(instance)[4]) == corners
    check(instance)


@pytest.mark.parametrize("seed", range(4))
def test_scattered_leaves(seed):
    instance = scattered(seed)
    check(instance)
    mask = instance > 0
    corners = polygons(instance)[9]
    pieces, _ = label(mask, NEIGHBOURS)
    alone = np.bincount(pieces[mask])[1:].max() / mask.sum()
    for fill in (opencv_fill, pillow_fill):
        assert overlap(fill(corners, mask.shape), mask) > max(alone, 0.75)


def test_a_disc_has_few_corners():
    y, x = np.indices((101, 101))
    instance = ((x - 50) ** 2 + (y - 50) ** 2 <= 48**2).astype(np.uint32)
    check(instance)
    turns = 8 * 48  # of a line along the edges of pixels: two a row and two a column, in each quarter
    assert len(polygons(instance)[1]) < turns / 2


def test_a_polygon_is_equal_whatever_lies_around():
    instance = scattered(1, share=0.6)
    more = np.zeros((100, 130), np.uint32)
    more[20:80, 30:110] = instance
    more[0, 0] = 4
    np.testing.assert_array_equal(polygons(more)[9], polygons(instance)[9] + [30, 20])


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.tuples(st.integers(1, 9), st.integers(0, 6), st.integers(1, 40)), min_size=2, max_size=8),
    st.randoms(use_true_random=False),
)
def test_the_best_subtree_is_that_of_all(pieces, random):
    """Each piece after the first hangs on an earlier one; all sets of pieces are tried."""
    area = np.array([one[0] for one in pieces])
    parent = [0, *(one[1] % k for k, one in enumerate(pieces[1:], 1))]
    cost = np.array([one[2] for one in pieces])
    names = list(range(len(pieces)))
    random.shuffle(names)
    best = Fraction(0)
    for kept in product([False, True], repeat=len(pieces)):
        if kept[0] and all(kept[parent[k]] for k in range(1, len(pieces)) if kept[k]):
            above = sum(cost[k] for k in range(1, len(pieces)) if kept[k])
            best = max(best, Fraction(int(6 * area[list(kept)].sum()), int(6 * area.sum() + above)))
    order, above = np.argsort(names), np.argsort(names) - 1
    parents = np.array([names[parent[k]] for k in order])
    kept, used = contours._best_subtree(area[order], cost[1:], np.array(names), parents, above)
    assert kept[names[0]]
    assert used.sum() == kept.sum() - 1
    found = Fraction(int(6 * area[order][kept].sum()), int(6 * area.sum() + cost[1:][used].sum()))
    assert found == best


@settings(max_examples=60, deadline=None)
@given(hnp.arrays(bool, hnp.array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=9)), st.integers(0, 9))
def test_nearest_pixels_are_those_of_a_search(mask, reach):
    nearest = contours._voronoi(mask.astype(np.int32), reach)
    own = np.argwhere(mask)
    for (y, x), found in np.ndenumerate(nearest):
        down, across = np.abs(own - [y, x]).T if len(own) else (np.empty(0), np.empty(0))
        distance = np.maximum(down, across) + down
        least = distance.min(initial=1000)
        if found < 0:
            assert least > reach
        else:
            assert mask.ravel()[found]
            assert distance[np.flatnonzero((own == divmod(found, mask.shape[1])).all(axis=1))[0]] == least


def test_pieces_form_one_tree_where_no_bridge_costs_too_much():
    mask = scattered(3, share=0.5) > 0
    pieces, number = label(mask, NEIGHBOURS)
    edges, order, parent = contours._spanning_tree(contours._candidates(pieces.astype(np.int32), 10**6), number, 0)
    assert len(edges.one) == number - 1
    pairs = set(zip(edges.one.tolist(), edges.other.tolist(), strict=True))
    assert all((min(k, up), max(k, up)) in pairs for k, up in enumerate(parent.tolist()) if k)
    assert sorted(order) == list(range(number))
