"""Amodal masks follow their rule pixel by pixel."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from forestgen.labels.masks import AmodalMasks, amodal_masks
from forestgen.render.frame import Amodal


def packed(images: dict[int, np.ndarray], samples: int) -> Amodal:
    """From (H, W) counts of each plant, in windows that are looser than need be or none."""
    ids = sorted(images)
    windows, hits = [], []
    for plant in ids:
        y, x = np.nonzero(images[plant])
        if len(x) == 0:
            windows.append((0, 0, 0, 0))
            continue
        left, top, right, bottom = x.min(), y.min(), x.max() + 1, y.max() + 1
        windows.append((left, top, right - left, bottom - top))
        hits.append(images[plant][top:bottom, left:right].ravel())
    window = np.array(windows, dtype=np.int32).reshape(-1, 4)
    return Amodal(
        plant_id=np.array(ids, dtype=np.uint32),
        samples=samples,
        window_px=window,
        first=np.concatenate([[0], np.cumsum(window[:, 2] * window[:, 3])]).astype(np.int64),
        hits=np.concatenate([*hits, np.zeros(0)]).astype(np.uint16),
        full_box_px=np.arange(4.0 * len(ids)).reshape(-1, 4),
    )


def nothing(shape: tuple[int, int], samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Samples and an instance mask without plants."""
    return np.zeros((*shape, samples), dtype=np.uint32), np.zeros(shape, dtype=np.uint32)


def by_the_rule(counts: np.ndarray, samples: int, instance: np.ndarray, plant: int) -> np.ndarray:
    return (counts > samples / 2) | (instance == plant)


def unpacked(masks: AmodalMasks, row: int, shape: tuple[int, int]) -> np.ndarray:
    image = np.zeros(shape, dtype=bool)
    x, y, width, height = masks.box_px[row]
    image[y : y + height, x : x + width] = masks.mask_of(row)
    return image


@settings(max_examples=60)
@given(seed=st.integers(0, 2**32), samples=st.sampled_from([1, 4, 9, 16, 1024]), plants=st.integers(0, 5))
def test_masks_follow_the_rule(seed, samples, plants):
    rng = np.random.default_rng(seed)
    shape = tuple(int(n) for n in rng.integers(1, 9, 2))
    ids = np.sort(rng.choice([1, 2, 3, 65_536, 2**31, 2**32 - 1, 2**32 - 2], plants, replace=False))
    images = {int(i): rng.integers(0, samples + 1, shape) * (rng.random(shape) < rng.random()) for i in ids}
    instance = rng.choice([0, 7, *ids], shape).astype(np.uint32)
    seen = rng.choice([0, 7, *ids], (*shape, samples)).astype(np.uint32)
    seen[rng.random(shape) < 0.5] = rng.choice([0, 7, *ids])
    amodal = packed(images, samples)
    masks = amodal_masks(amodal, seen, instance)
    assert masks.first[-1] == len(masks.inside)
    np.testing.assert_array_equal(masks.plant_id, ids)
    for row, plant in enumerate(ids.tolist()):
        expected = by_the_rule(images[plant], samples, instance, plant)
        np.testing.assert_array_equal(unpacked(masks, row, shape), expected)
        assert masks.pixels[row] == expected.sum()
        visible = (seen == plant).sum(axis=2)
        assert masks.area_px[row] == pytest.approx(np.maximum(images[plant], visible).sum() / samples)
        y, x = np.nonzero(expected)
        box = (x.min(), y.min(), np.ptp(x) + 1, np.ptp(y) + 1) if len(x) else (0, 0, 0, 0)
        assert tuple(masks.box_px[row]) == box
    np.testing.assert_array_equal(masks.full_box_px, amodal.full_box_px)


@pytest.mark.parametrize(("hits", "samples", "inside"), [(8, 16, False), (9, 16, True), (0, 1, False), (1, 1, True)])
def test_half_of_the_samples_are_not_enough(hits, samples, inside):
    counts = np.array([[0, hits]])
    masks = amodal_masks(packed({5: counts}, samples), *nothing((1, 2), samples))
    assert bool(masks.pixels[0]) == inside


def test_a_won_pixel_is_in_the_mask_with_however_few_samples():
    instance = np.array([[0, 5, 0]], dtype=np.uint32)
    masks = amodal_masks(packed({5: np.array([[0, 3, 16]])}, 16), np.zeros((1, 3, 16), dtype=np.uint32), instance)
    assert masks.box_px.tolist() == [[1, 0, 2, 1]]
    assert masks.area_px[0] == pytest.approx(19 / 16)


def test_seventy_thousand_plants():
    side, count = 300, 70_000
    instance = np.zeros((side, side), dtype=np.uint32)
    instance.ravel()[:count] = np.arange(count) + 2**31
    window = np.ones((count, 4), dtype=np.int32)
    window[:, 0], window[:, 1] = np.arange(count) % side, np.arange(count) // side
    amodal = Amodal(
        plant_id=(np.arange(count) + 2**31).astype(np.uint32),
        samples=16,
        window_px=window,
        first=np.arange(count + 1),
        hits=np.full(count, 7, dtype=np.uint16),
        full_box_px=np.zeros((count, 4)),
    )
    masks = amodal_masks(amodal, instance[..., None], instance)
    np.testing.assert_array_equal(masks.box_px, window)
    assert masks.inside.all()


def test_windows_beyond_the_image_are_refused():
    with pytest.raises(ValueError, match="beyond the image"):
        amodal_masks(packed({5: np.ones((3, 4))}, 4), *nothing((3, 3), 4))
