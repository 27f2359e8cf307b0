"""All labels of pixels: identity samples become masks. Pure NumPy.

A pixel's S samples each hit a plant (its id) or no plant (0: sky and ground together). The share of samples that
hit an id is its coverage. Ids rank by coverage, the largest first; **ties go to the smaller id**, and 0 competes like
any other id, so a pixel that a plant and the background share equally is background. The instance mask is rank 0.
The part mask is the commonest part among the winner's samples; ties go to the smaller part number.
Amodal masks are of plants as if nothing stood in front of them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.core.compiled import compiled
from forestgen.recipe.classes import ClassMap
from forestgen.render.frame import Amodal

_BLOCK_SAMPLES = 1 << 18  # samples worked on at a time: scratch memory stays near 10 MB and in cache
_ID_MASK = np.uint64(0xFFFFFFFF)
_SHIFT = np.uint64(32)


@dataclass(frozen=True)
class CoverageRanks:
    """The K ids that cover most of each pixel, largest coverage first."""

    plant_id: NDArray[np.uint32]  # (H, W, K); 0 is sky or ground, and also fills ranks that nothing takes
    coverage: NDArray[np.float32]  # (H, W, K) share of samples in [0, 1]; 0 where nothing takes the rank


def coverage_ranks(plant_id: NDArray[np.uint32], k: int = 8) -> CoverageRanks:
    """The `k` ids that cover most of each pixel of (H, W, S) samples; beyond the ids present, 0 with coverage 0."""
    height, width, samples = plant_id.shape
    ids = np.zeros((height, width, k), dtype=np.uint32)
    coverage = np.zeros((height, width, k), dtype=np.float32)
    kept = min(k, samples)
    for rows in _row_blocks(plant_id.shape):
        best = _rank_keys(plant_id[rows].reshape(-1, samples))[:, : -kept - 1 : -1]
        count = best >> _SHIFT
        found = np.where(count > 0, _ID_MASK - (best & _ID_MASK), np.uint64(0))
        ids[rows, :, :kept] = found.reshape(-1, width, kept)
        coverage[rows, :, :kept] = (count / np.float64(samples)).reshape(-1, width, kept)
    return CoverageRanks(ids, coverage)


def instance_mask(plant_id: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """(H, W) uint32: the id of the largest coverage of (H, W, S) samples; ties go to the smaller id."""
    return coverage_ranks(plant_id, k=1).plant_id[..., 0]


def part_mask(plant_id: NDArray[np.uint32], part: NDArray[np.uint8], instance: NDArray[np.uint32]) -> NDArray[np.uint8]:
    """(H, W) the commonest part among the (H, W, S) samples of a pixel that hit its instance (H, W).

    Ties go to the smaller number of `forestgen.core.parts.Part`.
    """
    winner = np.zeros(instance.shape, dtype=np.uint8)
    counter = np.min_scalar_type(plant_id.shape[2])
    for rows in _row_blocks(plant_id.shape):
        # Samples first: sums along the first axis run over whole rows of pixels.
        mine = np.moveaxis(plant_id[rows], -1, 0) == instance[rows]
        block = np.ascontiguousarray(np.moveaxis(part[rows], -1, 0))
        most = np.zeros(block.shape[1:], dtype=counter)
        for value in np.flatnonzero(np.bincount(block.ravel(), minlength=256)):
            count = np.add.reduce((mine & (block == value)).view(np.uint8), axis=0, dtype=counter)
            better = count > most  # strict, and values rise: the smaller number keeps a tie
            winner[rows][better] = value
            most = np.maximum(most, count)
    return winner


def semantic_mask(
    instance: NDArray[np.uint32],
    part: NDArray[np.uint8],
    plant_id: NDArray[np.uint32],
    species: NDArray[np.integer],
    class_of: NDArray[np.uint8],
) -> NDArray[np.uint8]:
    """(H, W) class of each pixel, by the species of its instance and its part.

    `class_of` is that of a `ClassMap`, `species` (N,) the numbers of the plants of `plant_id`, sorted. An instance that
    is not among them raises `ValueError`.
    """
    kind = np.full(instance.shape, len(class_of) - 1, dtype=np.intp)
    is_plant = instance != 0
    kind[is_plant] = species[rows_of(instance[is_plant], plant_id)]
    return class_of[kind, part]


def rows_of(ids: NDArray[np.uint32], plant_id: NDArray[np.uint32]) -> NDArray[np.intp]:
    """Row in the sorted `plant_id` of each of `ids`; an id that is not there raises `ValueError`."""
    row = np.searchsorted(plant_id, ids)
    known = row < len(plant_id)
    known[known] = plant_id[row[known]] == ids[known]
    if not known.all():
        strangers = np.unique(ids[~known])[:5].tolist()
        raise ValueError(f"the image shows plants that have no row, such as {strangers}")
    return row


def _row_blocks(shape: tuple[int, ...]) -> Iterator[slice]:
    height, width, samples = shape
    step = max(1, _BLOCK_SAMPLES // max(1, width * samples))
    return (slice(start, min(start + step, height)) for start in range(0, height, step))


def _rank_keys(samples: NDArray[np.uint32]) -> NDArray[np.uint64]:
    """(P, S) keys, sorted along S: per distinct id count << 32 | (2^32 - 1 - id), and 0 elsewhere.

    The largest key is thus the largest count and, among equals, the smallest id.
    """
    ids = np.sort(samples, axis=1)
    pixels, total = ids.shape
    change = ids[:, 1:] != ids[:, :-1]
    position = np.arange(total, dtype=np.uint32)
    start = np.zeros((pixels, total), dtype=np.uint32)
    np.multiply(change, position[1:], out=start[:, 1:], dtype=np.uint32)
    for column in range(2, total):  # a running maximum; faster than maximum.accumulate on short rows
        np.maximum(start[:, column], start[:, column - 1], out=start[:, column])
    keys = ((position - start + np.uint32(1)).astype(np.uint64) << _SHIFT) | (_ID_MASK - ids)
    keys[:, :-1] *= change  # a run's last sample alone carries its count
    keys.sort(axis=1)
    return keys


@dataclass(frozen=True)
class PixelLabels:
    """Labels of one image of H x W pixels."""

    instance: NDArray[np.uint32]  # (H, W) plant_id of the largest coverage; 0 where that is no plant
    part: NDArray[np.uint8]  # (H, W) forestgen.core.parts.Part
    semantic: NDArray[np.uint8]  # (H, W) class of a ClassMap
    ranks: CoverageRanks


def pixel_labels(
    samples: NDArray[np.uint32],
    part: NDArray[np.uint8],
    plant_id: NDArray[np.uint32],
    species: NDArray[np.integer],
    classes: ClassMap,
) -> PixelLabels:
    """Label an image of samples (H, W, S) of plants and parts; plants (N,), ids sorted, and their species' numbers."""
    ranks = coverage_ranks(samples)
    instance = ranks.plant_id[..., 0].copy()
    parts = part_mask(samples, part, instance)
    return PixelLabels(instance, parts, semantic_mask(instance, parts, plant_id, species, classes.class_of), ranks)


@dataclass(frozen=True)
class AmodalMasks:
    """One row a plant that the identity pass saw, by rising plant_id.

    A pixel is in a plant's amodal mask if more than half of its samples hit the plant when it stands alone (a tie goes
    to the background, as in the instance mask), or if the plant wins it in the instance mask. So whatever device traced
    the two, and however it rounds at an edge, what is visible lies within what is amodal, in pixels and in area.
    """

    plant_id: NDArray[np.uint32]  # (M,)
    box_px: NDArray[np.int32]  # (M, 4) x, y, width, height: tight around the mask, within the image; 0 where empty
    first: NDArray[np.int64]  # (M + 1,) where each box' pixels begin, row by row
    inside: NDArray[np.bool_]  # (first[M],) pixel of the box is in the mask
    pixels: NDArray[np.int64]  # (M,) in the mask
    area_px: NDArray[np.float64]  # (M,) sum of the plant's coverage alone, or in the scene where that is more
    full_box_px: NDArray[np.float64]  # (M, 4) left, top, right, bottom of the projected plant, beyond the image too

    def mask_of(self, row: int) -> NDArray[np.bool_]:
        """(h, w) mask inside the box of a row."""
        _, _, width, height = self.box_px[row]
        return self.inside[self.first[row] : self.first[row + 1]].reshape(height, width)


def amodal_masks(amodal: Amodal, plant_id: NDArray[np.uint32], instance: NDArray[np.uint32]) -> AmodalMasks:
    """Masks of the plants of `amodal`, of the samples (H, W, S) of the same view and their instance mask (H, W).

    Plants that `amodal` does not hold are left out. O(pixels of its windows + samples of the image x log plants).
    """
    height, width = instance.shape
    far = amodal.window_px[:, :2] + amodal.window_px[:, 2:]
    if len(far) and (far.max(axis=0) > (width, height)).any():
        raise ValueError(f"windows reach to {far.max(axis=0).tolist()}, beyond the image of {width} x {height} px")
    args = (amodal.window_px, amodal.first, amodal.hits, amodal.samples, amodal.plant_id, instance)
    box, area = _measure(*args)
    area += _more_in_the_scene(*args[:3], amodal.plant_id, plant_id)
    first = np.concatenate([[0], np.cumsum(box[:, 2].astype(np.int64) * box[:, 3])]).astype(np.int64)
    inside, pixels = _fill(*args, box, first)
    return AmodalMasks(amodal.plant_id, box, first, inside, pixels, area / amodal.samples, amodal.full_box_px)


@compiled
def _measure(window, first, hits, samples, plant_id, instance):  # type: ignore[no-untyped-def]
    """(M, 4) boxes of the masks and (M,) sums of hits."""
    count = len(window)
    low = np.full((count, 2), np.iinfo(np.int32).max, dtype=np.int32)
    high = np.full((count, 2), -1, dtype=np.int32)
    total = np.zeros(count, dtype=np.int64)
    for plant in range(count):
        width = window[plant, 2]
        for y in range(window[plant, 3]):
            for x in range(width):
                number = np.int64(hits[first[plant] + np.int64(y) * width + x])
                total[plant] += number
                if 2 * number > samples:
                    _reach(low, high, plant, window[plant, 0] + x, window[plant, 1] + y)
    row = -1
    for y in range(instance.shape[0]):
        for x in range(instance.shape[1]):
            row = _row_near(plant_id, instance[y, x], row)
            if row >= 0:
                _reach(low, high, row, x, y)
    box = np.zeros((count, 4), dtype=np.int32)
    for plant in range(count):
        if high[plant, 0] >= 0:
            for axis in range(2):
                box[plant, axis] = low[plant, axis]
                box[plant, 2 + axis] = high[plant, axis] - low[plant, axis] + 1
    return box, total


@compiled
def _more_in_the_scene(window, first, hits, plant_id, seen):  # type: ignore[no-untyped-def]
    """(M,) samples by which a plant has more in a pixel of the scene than alone, summed: rays along an edge."""
    more = np.zeros(len(window), dtype=np.int64)
    samples, row = seen.shape[2], -1
    for y in range(seen.shape[0]):
        for x in range(seen.shape[1]):
            pixel = np.sort(seen[y, x]) if (seen[y, x] != seen[y, x, 0]).any() else seen[y, x]
            start = 0
            for end in range(1, samples + 1):
                if end < samples and pixel[end] == pixel[start]:
                    continue
                row = _row_near(plant_id, pixel[start], row)
                if row >= 0:
                    more[row] += max(0, end - start - _hits_at(window, first, hits, row, x, y))
                start = end
    return more


@compiled
def _hits_at(window, first, hits, plant, x, y):  # type: ignore[no-untyped-def]
    across, down = x - window[plant, 0], y - window[plant, 1]
    if across < 0 or down < 0 or across >= window[plant, 2] or down >= window[plant, 3]:
        return 0
    return np.int64(hits[first[plant] + np.int64(down) * window[plant, 2] + across])


@compiled
def _fill(window, first, hits, samples, plant_id, instance, box, start):  # type: ignore[no-untyped-def]
    """(start[M],) masks inside their boxes and (M,) pixels of each."""
    inside = np.zeros(start[-1], dtype=np.bool_)
    for plant in range(len(window)):
        width = window[plant, 2]
        x0, y0 = window[plant, 0] - box[plant, 0], window[plant, 1] - box[plant, 1]
        for y in range(window[plant, 3]):
            for x in range(width):
                if 2 * np.int64(hits[first[plant] + np.int64(y) * width + x]) > samples:
                    inside[start[plant] + np.int64(y0 + y) * box[plant, 2] + x0 + x] = True
    row = -1
    for y in range(instance.shape[0]):
        for x in range(instance.shape[1]):
            row = _row_near(plant_id, instance[y, x], row)
            if row >= 0:
                inside[start[row] + np.int64(y - box[row, 1]) * box[row, 2] + x - box[row, 0]] = True
    pixels = np.zeros(len(window), dtype=np.int64)
    for plant in range(len(window)):
        pixels[plant] = inside[start[plant] : start[plant + 1]].sum()
    return inside, pixels


@compiled
def _row_near(plant_id, wanted, last):  # type: ignore[no-untyped-def]
    """Row of a plant, -1 if there is none; `last` is tried first, since neighbours are mostly of one plant."""
    if last >= 0 and plant_id[last] == wanted:
        return last
    if wanted == 0:
        return -1
    row = np.searchsorted(plant_id, wanted)
    return row if row < len(plant_id) and plant_id[row] == wanted else -1


@compiled
def _reach(low, high, plant, x, y):  # type: ignore[no-untyped-def]
    """Let the box of a plant reach to a pixel."""
    low[plant, 0], low[plant, 1] = min(low[plant, 0], x), min(low[plant, 1], y)
    high[plant, 0], high[plant, 1] = max(high[plant, 0], x), max(high[plant, 1], y)
