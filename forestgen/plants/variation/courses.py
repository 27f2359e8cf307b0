"""Running the loop of `loop.py` on a skeleton."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.plants.skeleton import OrganPlacements, Skeleton
from forestgen.plants.variation.loop import carry, walk
from forestgen.plants.variation.model import Variation
from forestgen.plants.variation.tables import Axes, axes_of, tables

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Courses:
    """What N nodes of a base skeleton became: M nodes, those inserted among them."""

    axes: Axes
    base_m: Floats  # (N, 3) metres, the base skeleton
    new_of: Ints  # (N,) new index of each node of the base
    piece_of: Ints  # (N,) new index of the first piece of its segment
    point_m: Floats  # (M, 3) the new node's place on the base
    shift_m: Floats  # (M, 3) its way from there
    quaternion: Floats  # (M, 4) rotation of the piece that ends in it, w x y z
    source: Ints  # (M,) node of the base on whose segment it lies
    share: Floats  # (M,) where on that segment, 1 at the node itself

    @property
    def position_m(self) -> Floats:
        """(M, 3) metres, plant frame."""
        return self.point_m + self.shift_m

    def skeleton(self, base: Skeleton) -> Skeleton:
        """The varied skeleton, with the base's thickness and organs."""
        parent = np.arange(-1, len(self.source) - 1)
        begins = self.axes.bearer >= 0
        bearer = self.axes.bearer[begins]
        parent[self.piece_of[self.axes.first[begins]]] = self.new_of[bearer]
        return Skeleton(
            parent=parent.astype(np.int32),
            position_m=self.position_m.astype(np.float32),
            radius_m=self._radius(base),
            order=base.order[self.source],
            axis=base.axis[self.source],
            organs=tuple(self._organs(base, placement) for placement in base.organs),
        )

    def _radius(self, base: Skeleton) -> NDArray[np.float32]:
        """Thickness, even between the base's nodes; an axis begins as thick as its own first node."""
        end = base.radius_m.astype(np.float64)
        start = end[np.maximum(base.parent, 0)]
        foot = self.axes.first
        start[foot] = end[foot]
        radius = start[self.source] + self.share * (end - start)[self.source]
        radius = np.where(self.share == 1.0, end[self.source], radius)
        return radius.astype(np.float32)

    def _organs(self, base: Skeleton, placement: OrganPlacements) -> OrganPlacements:
        frame = placement.frame.astype(np.float64)
        out, node = np.empty_like(frame), np.empty(len(frame), np.int64)
        start = self.base_m[np.maximum(base.parent, 0)]
        carry(
            frame, placement.node.astype(np.int64), start, self.base_m, self.new_of, self.piece_of,
            self.shift_m, self.quaternion, self.point_m, self.share, out, node,
        )  # fmt: skip
        return replace(placement, frame=out.astype(np.float32), node=node.astype(np.int32))


def courses(skeleton: Skeleton, variation: Variation, rng: np.random.Generator) -> Courses:
    """Where the loop takes every node, in double precision; see `vary`."""
    base = skeleton.position_m.astype(np.float64)
    axes = axes_of(skeleton, base)
    t = tables(axes, variation, rng)
    most = len(base) + int(t.steps.sum())
    pull = variation.target_pull
    out: dict[str, NDArray[Any]] = {
        "new_of": np.zeros(len(base), np.int64),
        "piece_of": np.zeros(len(base), np.int64),
        "shift": np.empty((most, 3)),
        "quaternion": np.empty((most, 4)),
        "point": np.empty((most, 3)),
        "source": np.empty(most, np.int64),
        "share": np.empty(most),
    }
    made = walk(
        base, axes.arc_m, axes.first, axes.last, axes.bearer, axes.hidden_m, t.steps, t.begin, t.life, t.kappa,
        (variation.derivative_gain, variation.integral_gain), variation.reference == "local",
        t.age, t.sensor, t.disturbance, t.turn, t.target, t.weight,
        pull.direction() if pull else (0.0, 0.0, 1.0), t.whole, t.until,
        *out.values(), np.empty((int(t.steps.max(initial=1)), 3)),
    )  # fmt: skip
    return Courses(
        axes=axes,
        base_m=base,
        new_of=out["new_of"],
        piece_of=out["piece_of"],
        point_m=out["point"][:made],
        shift_m=out["shift"][:made],
        quaternion=out["quaternion"][:made],
        source=out["source"][:made],
        share=out["share"][:made],
    )


def vary(skeleton: Skeleton, variation: Variation, rng: np.random.Generator) -> Skeleton:
    """The plant as it would have grown under the influences of `variation`.

    Lengths, and the base's own bends, are as they were; axes may have more nodes. Without influences the skeleton
    comes back unchanged.

    Raises
    ------
    RecipeError : more growth steps than memory holds.
    """
    return courses(skeleton, variation, rng).skeleton(skeleton)
