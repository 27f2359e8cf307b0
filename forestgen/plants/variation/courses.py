"""Running the loop of `loop.py` on a skeleton."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from forestgen.plants.skeleton import OrganPlacements, Skeleton
from forestgen.plants.variation.loop import NewNodes, carry, walk
from forestgen.plants.variation.model import Variation
from forestgen.plants.variation.tables import Axes, axes_of, tables

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Courses:
    """Where a base skeleton's nodes went."""

    axes: Axes
    base_m: Floats  # (N, 3) metres, the base skeleton
    new: NewNodes

    @property
    def position_m(self) -> Floats:
        """(M, 3) metres, plant frame."""
        return self.new.point_m + self.new.shift_m

    def skeleton(self, base: Skeleton) -> Skeleton:
        """The varied skeleton, with the base's thickness and organs."""
        parent = np.arange(-1, len(self.new.source) - 1)
        begins = self.axes.bearer >= 0
        bearer = self.axes.bearer[begins]
        parent[self.new.piece_of[self.axes.first[begins]]] = self.new.new_of[bearer]
        return Skeleton(
            parent=parent.astype(np.int32),
            position_m=self.position_m.astype(np.float32),
            radius_m=self._radius(base),
            order=base.order[self.new.source],
            axis=base.axis[self.new.source],
            organs=tuple(self._organs(base, placement) for placement in base.organs),
        )

    def _radius(self, base: Skeleton) -> NDArray[np.float32]:
        """Thickness, even between the base's nodes; an axis begins as thick as its own first node."""
        end = base.radius_m.astype(np.float64)
        start = end[np.maximum(base.parent, 0)]
        foot = self.axes.first
        start[foot] = end[foot]
        radius = start[self.new.source] + self.new.share * (end - start)[self.new.source]
        radius = np.where(self.new.share == 1.0, end[self.new.source], radius)
        return radius.astype(np.float32)

    def _organs(self, base: Skeleton, placement: OrganPlacements) -> OrganPlacements:
        frame = placement.frame.astype(np.float64)
        out, node = np.empty_like(frame), np.empty(len(frame), np.int64)
        start = self.base_m[np.maximum(base.parent, 0)]
        carry(frame, placement.node.astype(np.int64), start, self.base_m, self.new, out, node)
        return replace(placement, frame=out.astype(np.float32), node=node.astype(np.int32))


def courses(skeleton: Skeleton, variation: Variation, rng: np.random.Generator) -> Courses:
    """Where the loop takes every node, in double precision; see `vary`."""
    base = skeleton.position_m.astype(np.float64)
    axes = axes_of(skeleton, base)
    t = tables(axes, variation, rng)
    most = len(base) + int(t.steps.sum())
    pull = variation.target_pull
    new = NewNodes(
        new_of=np.zeros(len(base), np.int64),
        piece_of=np.zeros(len(base), np.int64),
        point_m=np.empty((most, 3)),
        shift_m=np.empty((most, 3)),
        quaternion=np.empty((most, 4)),
        source=np.empty(most, np.int64),
        share=np.empty(most),
    )
    gains = (variation.derivative_gain, variation.integral_gain)
    toward = pull.direction() if pull else (0.0, 0.0, 1.0)
    signal = np.empty((int(t.steps.max(initial=1)), 3))
    made = walk(base, axes, t, gains, variation.reference == "local", toward, new, signal)
    new = new._replace(
        point_m=new.point_m[:made],
        shift_m=new.shift_m[:made],
        quaternion=new.quaternion[:made],
        source=new.source[:made],
        share=new.share[:made],
    )
    return Courses(axes, base, new)


def vary(skeleton: Skeleton, variation: Variation, rng: np.random.Generator) -> Skeleton:
    """The plant as it would have grown under the influences of `variation`.

    Lengths, and the base's own bends, are as they were; axes may have more nodes. Without influences the skeleton
    comes back unchanged.

    Raises
    ------
    RecipeError : more growth steps than memory holds.
    """
    return courses(skeleton, variation, rng).skeleton(skeleton)
