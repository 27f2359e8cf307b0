"""Masks against a brute-force oracle that counts sample by sample."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from forestgen.core.parts import Part
from forestgen.labels import masks
from forestgen.labels.masks import coverage_ranks, instance_mask, part_mask, pixel_labels, rows_of, semantic_mask
from forestgen.recipe.classes import ClassMap

IDS = st.sampled_from([0, 1, 2, 3, 2**24 + 1, 2**31 + 5, 2**32 - 1])


@st.composite
def sample_arrays(draw):
    shape = draw(hnp.array_shapes(min_dims=3, max_dims=3, min_side=1, max_side=6))
    ids = draw(hnp.arrays(np.uint32, shape, elements=IDS))
    part = draw(hnp.arrays(np.uint8, shape, elements=st.sampled_from([0, 1, 4, 10, 255])))
    return ids, part


def ranks_of_pixel(samples, k):
    ranked = sorted(Counter(samples.tolist()).items(), key=lambda item: (-item[1], item[0]))[:k]
    ranked += [(0, 0)] * (k - len(ranked))
    return [one for one, _ in ranked], [count / len(samples) for _, count in ranked]


@settings(max_examples=300, deadline=None)
@given(sample_arrays(), st.integers(1, 9), st.integers(1, 40))
def test_ranks_and_masks_equal_counting(arrays, k, block):
    ids, part = arrays
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(masks, "_BLOCK_SAMPLES", block)
        ranks = coverage_ranks(ids, k)
        instance = instance_mask(ids)
        parts = part_mask(ids, part, instance)
    assert ranks.plant_id.dtype == np.uint32
    for y, x in np.ndindex(ids.shape[:2]):
        expected_ids, expected_coverage = ranks_of_pixel(ids[y, x], k)
        assert ranks.plant_id[y, x].tolist() == expected_ids
        np.testing.assert_array_equal(ranks.coverage[y, x], np.array(expected_coverage, np.float32))
        assert instance[y, x] == expected_ids[0]
        mine = Counter(part[y, x][ids[y, x] == instance[y, x]].tolist())
        assert parts[y, x] == min(mine, key=lambda value: (-mine[value], value))


def test_sample_order_does_not_matter():
    rng = np.random.default_rng(1)
    ids = rng.integers(0, 5, (7, 9, 16)).astype(np.uint32)
    part = rng.integers(0, 5, ids.shape).astype(np.uint8)
    order = rng.permutation(16)
    first, second = coverage_ranks(ids), coverage_ranks(ids[..., order])
    np.testing.assert_array_equal(first.plant_id, second.plant_id)
    instance = instance_mask(ids)
    np.testing.assert_array_equal(
        part_mask(ids, part, instance), part_mask(ids[..., order], part[..., order], instance)
    )


def test_background_competes_and_wins_ties():
    ids = np.array([[[0, 0, 7, 7], [0, 7, 7, 7], [9, 9, 7, 7], [0, 0, 3, 4]]], np.uint32)
    assert instance_mask(ids).tolist() == [[0, 7, 7, 0]]


def test_more_samples_than_a_byte_counts():
    ids = np.full((1, 1, 700), 5, np.uint32)
    part = np.full((1, 1, 700), 4, np.uint8)
    part[..., :300] = 2
    assert coverage_ranks(ids).coverage[0, 0, 0] == 1.0
    assert part_mask(ids, part, instance_mask(ids))[0, 0] == 4


def test_full_coverage_sums_to_one():
    ids = np.random.default_rng(0).integers(0, 6, (20, 20, 16)).astype(np.uint32)
    np.testing.assert_allclose(coverage_ranks(ids, 8).coverage.sum(-1), 1.0)


def test_the_semantic_mask_looks_up_species_and_part():
    instance = np.array([[0, 0, 0, 10, 4_000_000_000]], np.uint32)
    part = np.array([[Part.NOTHING, Part.GROUND, Part.ROCK, Part.LEAF, Part.TRUNK]], np.uint8)
    plant_id = np.array([10, 4_000_000_000], np.uint32)
    table = np.arange(3 * len(Part), dtype=np.uint8).reshape(3, -1)
    semantic = semantic_mask(instance, part, plant_id, np.array([1, 0], np.uint16), table)
    assert semantic.dtype == np.uint8
    nothing = 2 * len(Part)
    expected = [nothing, nothing + Part.GROUND, nothing + Part.ROCK, len(Part) + Part.LEAF, Part.TRUNK]
    assert semantic.tolist() == [expected]


@pytest.mark.parametrize("population", [[], [5], [5, 9]])
def test_an_unknown_plant_is_refused(population):
    with pytest.raises(ValueError, match=r"\[7\]"):
        rows_of(np.array([7], np.uint32), np.array(population, np.uint32))


def test_empty_population_and_sky():
    ids = np.zeros((3, 4, 2), np.uint32)
    labels = pixel_labels(
        ids, np.zeros((3, 4, 2), np.uint8), np.zeros(0, np.uint32), np.zeros(0, np.uint16), ClassMap(())
    )
    assert not labels.instance.any()
    assert not labels.semantic.any()
    assert labels.ranks.coverage[..., 0].min() == 1.0
