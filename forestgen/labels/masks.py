"""All labels of pixels: identity samples become masks. Pure NumPy.

A pixel's S samples each hit a plant (its id) or no plant (0: sky and ground together). The share of samples that
hit an id is its coverage. Ids rank by coverage, the largest first; **ties go to the smaller id**, and 0 competes like
any other id, so a pixel that a plant and the background share equally is background. The instance mask is rank 0.
The part mask is the commonest part among the winner's samples; ties go to the smaller part number.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.labels.classes import ClassMap

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
    height, width, samples = _checked_shape(plant_id)
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
    _checked_shape(plant_id)
    if part.shape != plant_id.shape or instance.shape != plant_id.shape[:2]:
        raise ValueError(f"shapes disagree: {plant_id.shape}, {part.shape}, {instance.shape}")
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

    Parameters
    ----------
    instance, part : (H, W), from `instance_mask` and `part_mask`; an id that is not in `plant_id` raises `ValueError`.
    plant_id : (N,) uint32, sorted: the population.
    species : (N,) index of each plant's species in the recipe's order.
    class_of : (species + 1, parts) from `forestgen.labels.classes.ClassMap`; its last row is for what is no plant.
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


def _checked_shape(plant_id: NDArray[np.uint32]) -> tuple[int, int, int]:
    if plant_id.ndim != 3 or plant_id.shape[2] == 0 or plant_id.dtype != np.uint32:
        raise ValueError(f"expected (H, W, S) uint32 with S > 0, got {plant_id.shape} {plant_id.dtype}")
    height, width, samples = plant_id.shape
    return height, width, samples


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
    """Label an image.

    Parameters
    ----------
    samples, part : (H, W, S) plant and part that each sample of the identity pass hit.
    plant_id : (N,) uint32, sorted: the population.
    species : (N,) index of each plant's species in the recipe's order.
    """
    ranks = coverage_ranks(samples)
    instance = ranks.plant_id[..., 0].copy()
    parts = part_mask(samples, part, instance)
    return PixelLabels(instance, parts, semantic_mask(instance, parts, plant_id, species, classes.class_of), ranks)
