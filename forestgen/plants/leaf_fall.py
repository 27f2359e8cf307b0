"""Leaves that a plant does not have at a time of the year: fewer in autumn, smaller in spring; recipe/phenology.py."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from forestgen.plants.parameters import OrganShape
from forestgen.plants.skeleton import OrganPlacements, Skeleton
from forestgen.recipe.phenology import LeafState


def with_leaves(
    skeleton: Skeleton, shapes: Mapping[str, OrganShape], leaves: LeafState, rng: np.random.Generator
) -> Skeleton:
    """The plant in full leaf with the leaves, flowers and fruits of a time.

    `rng`: decides which leaves remain; from the same state fewer leaves are some of more.
    """
    kept = []
    for organs, own in zip(skeleton.organs, rng.spawn(len(skeleton.organs)), strict=True):
        part = shapes[organs.shape].part
        if part in ("flower", "fruit") and not leaves.flowers:
            continue
        if part == "leaf":
            there = own.random(len(organs.node)) < leaves.share
            frame = organs.frame[there]
            frame[:, :, :3] *= np.float32(np.sqrt(leaves.size))
            organs = OrganPlacements(organs.shape, frame, organs.node[there])
        if len(organs.node):
            kept.append(organs)
    return replace(skeleton, organs=tuple(kept))
