"""All per-pixel labels of one image, made together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.labels.classes import ClassMap
from forestgen.labels.masks import CoverageRanks, coverage_ranks, part_mask, semantic_mask


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
    k: int = 8,
) -> PixelLabels:
    """Label an image.

    Parameters
    ----------
    samples, part : (H, W, S) uint32 and uint8, plant and part that each sample of the identity pass hit.
    plant_id : (N,) uint32, sorted: the population.
    species : (N,) index of each plant's species in the recipe's order.
    classes : what the semantic mask tells apart.
    k : number of coverage ranks to keep.
    """
    ranks = coverage_ranks(samples, k)
    instance = ranks.plant_id[..., 0].copy()
    parts = part_mask(samples, part, instance)
    semantic = semantic_mask(instance, parts, plant_id, species, classes.class_of)
    return PixelLabels(instance, parts, semantic, ranks)
