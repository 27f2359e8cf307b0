"""Masks of plants as if nothing stood in front of them. Pure NumPy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.core.compiled import compiled
from forestgen.render.frame import Amodal


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
    return AmodalMasks(
        plant_id=amodal.plant_id,
        box_px=box,
        first=first,
        inside=inside,
        pixels=pixels,
        area_px=area / amodal.samples,
        full_box_px=amodal.full_box_px,
    )


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
            row = _row(plant_id, instance[y, x], row)
            if row >= 0:
                _reach(low, high, row, x, y)
    box = np.zeros((count, 4), dtype=np.int32)
    for plant in range(count):
        if high[plant, 0] >= 0:
            box[plant, :2] = low[plant]
            box[plant, 2:] = high[plant] - low[plant] + 1
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
                row = _row(plant_id, pixel[start], row)
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
            row = _row(plant_id, instance[y, x], row)
            if row >= 0:
                inside[start[row] + np.int64(y - box[row, 1]) * box[row, 2] + x - box[row, 0]] = True
    pixels = np.zeros(len(window), dtype=np.int64)
    for plant in range(len(window)):
        pixels[plant] = inside[start[plant] : start[plant + 1]].sum()
    return inside, pixels


@compiled
def _row(plant_id, wanted, last):  # type: ignore[no-untyped-def]
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
