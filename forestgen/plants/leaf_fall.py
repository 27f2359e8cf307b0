"""Leaves at a time of the year: fewer in autumn, smaller in spring; recipe/phenology.py.

Dead leaves that have a shape of their own, such as a `dead_frond` beside a `frond`, lie around the foot of their plant
once all are withered.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from forestgen.plants.foliage import organ_frames
from forestgen.plants.parameters import OrganShape
from forestgen.plants.skeleton import OrganPlacements, Skeleton
from forestgen.recipe.phenology import LeafState

DEAD = "dead_"
_TURN, _RISE, _ROLL = np.radians([35.0, 5.0, 15.0])  # standard deviations of where dead leaves fall, by estimate


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
            if leaves.spectra[3] == 1.0 and DEAD + organs.shape in shapes:
                organs = OrganPlacements(DEAD + organs.shape, _lying(frame, own), organs.node)
        if len(organs.node):
            kept.append(organs)
    return replace(skeleton, organs=tuple(kept))


def _lying(frame: NDArray[np.float32], rng: np.random.Generator) -> NDArray[np.float32]:
    """(M, 3, 4) frames of leaves that fell over where they stood."""
    count, along = len(frame), frame[:, :, 1].astype(np.float64)
    turn = np.arctan2(along[:, 1], along[:, 0]) + _TURN * rng.normal(size=count)
    rise, roll = np.abs(_RISE * rng.normal(size=count)), _ROLL * rng.normal(size=count)
    along = np.column_stack([np.cos(rise) * np.cos(turn), np.cos(rise) * np.sin(turn), np.sin(rise)])
    foot = frame[:, :, 3] * [1.0, 1.0, 0.0] + [0.0, 0.0, 0.02]
    upper = np.tile([0.0, 0.0, 1.0], (count, 1))
    size = np.linalg.norm(frame[:, :, 1], axis=1)
    return organ_frames(foot, along, upper, roll, size).astype(np.float32)
