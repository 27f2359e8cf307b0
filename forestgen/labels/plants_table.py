"""What a camera sees of each plant: pixels, area, box. Pure NumPy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.labels.masks import rows_of


@dataclass(frozen=True)
class VisiblePlants:
    """One row a plant of the population, seen or not, in the population's order."""

    plant_id: NDArray[np.uint32]  # (N,)
    visible_pixels: NDArray[np.int64]  # (N,) pixels that the plant wins in the instance mask
    visible_area_px: NDArray[np.float64]  # (N,) pixels: sum of its coverage over all pixels, won or lost
    box_px: NDArray[np.int32]  # (N, 4) x, y, width, height of the won pixels, COCO's convention; 0 where none
    truncated: NDArray[np.bool_]  # (N,) a won pixel touches the image's border

    @property
    def has_box(self) -> NDArray[np.bool_]:
        """(N,) the plant wins at least one pixel."""
        return self.visible_pixels > 0


def visible_plants(
    plant_id: NDArray[np.uint32], samples: NDArray[np.uint32], instance: NDArray[np.uint32]
) -> VisiblePlants:
    """Measure what is visible of each plant.

    Parameters
    ----------
    plant_id : (N,) uint32, sorted: the population.
    samples : (H, W, S) uint32, what each sample of the identity pass hit.
    instance : (H, W) uint32, from `forestgen.labels.masks.instance_mask`.

    Raises
    ------
    ValueError
        When an id in the image is not in the population.
    """
    pixels, box = _boxes(plant_id, instance)
    height, width = instance.shape
    far = box[:, :2] + box[:, 2:]
    touches = (box[:, 0] == 0) | (box[:, 1] == 0) | (far[:, 0] == width) | (far[:, 1] == height)
    return VisiblePlants(
        plant_id=plant_id,
        visible_pixels=pixels,
        visible_area_px=_areas(plant_id, samples),
        box_px=box,
        truncated=touches & (pixels > 0),
    )


def _areas(plant_id: NDArray[np.uint32], samples: NDArray[np.uint32]) -> NDArray[np.float64]:
    ids, count = np.unique(samples, return_counts=True)
    plants = ids != 0
    area = np.zeros(len(plant_id))
    area[rows_of(ids[plants], plant_id)] = count[plants] / samples.shape[2]
    return area


def _boxes(plant_id: NDArray[np.uint32], instance: NDArray[np.uint32]) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Pixel counts (N,) and boxes (N, 4) of the mask, by sorting its pixels by plant."""
    pixels = np.zeros(len(plant_id), dtype=np.int64)
    box = np.zeros((len(plant_id), 4), dtype=np.int32)
    y, x = np.nonzero(instance)
    if len(x) == 0:
        return pixels, box
    row = rows_of(instance[y, x], plant_id)
    order = np.argsort(row, kind="stable")
    present, first, count = np.unique(row[order], return_index=True, return_counts=True)
    pixels[present] = count
    low = np.stack([np.minimum.reduceat(axis[order], first) for axis in (x, y)], axis=1)
    high = np.stack([np.maximum.reduceat(axis[order], first) for axis in (x, y)], axis=1)
    box[present, :2] = low
    box[present, 2:] = high - low + 1
    return pixels, box
