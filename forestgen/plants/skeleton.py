"""The contract between a plant generator and the mesher; and how large a plant may be, that memory holds it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.errors import RecipeError
from forestgen.core.processes import free_bytes
from forestgen.geometry.mesh import Ints

_LEAST_SINE = 0.3  # of the angle between a branch and its bearer: a narrower fork leaves it no deeper than this
_THREAD_M = 2e-5  # axes no thicker than this join pieces that do not touch, and are not wood
_THREAD_SHARE = 1e-4  # the same as a share of the plant's greatest radius
LARGEST_PLANT = 50_000_000  # nodes or organs: no plant needs more, whatever the machine has
_SHARE_OF_FREE = 0.5
_OF_A_SMALL_PLANT, _OF_A_SLENDER_PLANT_PER_M3, _OF_A_WIDE_PLANT_PER_M3 = 20_000, 800, 60_000  # triangles
_OF_A_LARGE_PLANT, _OF_A_LARGE_PLANT_PER_M2, _OF_A_LARGE_SLENDER_PLANT_PER_M2 = 240_000, 900, 2400


@dataclass(frozen=True)
class Twigs:
    """Straight pieces of the thin wood between organs of one shape: where needles stand near a camera too."""

    ends_m: NDArray[np.float32]  # (S, 2, 3) lower and upper end, plant frame
    radius_m: NDArray[np.float32]  # (S,)
    organ: NDArray[np.int32]  # (S,) the organ above, whose needles a piece bears


@dataclass(frozen=True)
class OrganPlacements:
    """Leaves, needles or flowers of one shape, placed on a skeleton."""

    shape: str  # name of an organ shape in the species' file
    frame: NDArray[np.float32]  # (M, 3, 4) organ frame -> plant frame: y along the blade, z its upper side, metres
    node: NDArray[np.int32]  # (M,) the node that bears it
    twigs: Twigs | None = None  # that bear its needles; None: none do


@dataclass(frozen=True)
class Skeleton:
    """A plant as polylines with thickness: node i ends the segment from parent[i] to i. Parents precede children."""

    parent: NDArray[np.int32]  # (N,) index, -1 for the root
    position_m: NDArray[np.float32]  # (N, 3) metres, plant frame: origin at the stem base, z up
    radius_m: NDArray[np.float32]  # (N,)
    order: NDArray[np.uint8]  # (N,) 0 trunk, 1 its branches, ...
    axis: NDArray[np.int32]  # (N,) nodes of one axis share its number; consecutive nodes of an axis are chained
    organs: tuple[OrganPlacements, ...] = ()
    mark: NDArray[np.uint32] | None = None  # (N,) what each node's segment belongs to; meshes carry it to their faces

    def __post_init__(self) -> None:
        n = len(self.parent)
        for name in ("position_m", "radius_m", "order", "axis", "mark"):
            column, shape = getattr(self, name), (n, 3) if name == "position_m" else (n,)
            if column is not None and column.shape != shape:
                raise ValueError(f"{name} must have shape {shape}, got {column.shape}")
        if n and (self.parent[0] != -1 or np.any(self.parent >= np.arange(n))):
            raise ValueError("parents must precede children, and node 0 must be the root")

    @classmethod
    def of(
        cls,
        parent: NDArray[Any] | Sequence[int],
        position_m: NDArray[Any],
        radius_m: NDArray[Any],
        order: NDArray[Any],
        axis: NDArray[Any],
        *,
        organs: tuple[OrganPlacements, ...] = (),
        mark: NDArray[np.uint32] | None = None,
    ) -> Skeleton:
        """The skeleton of arrays of any number type; higher orders than 255 become 255."""
        return cls(
            np.asarray(parent, dtype=np.int32),
            np.asarray(position_m, dtype=np.float32),
            np.asarray(radius_m, dtype=np.float32),
            np.minimum(order, 255).astype(np.uint8),
            np.asarray(axis, dtype=np.int32),
            organs,
            mark,
        )

    def axes(self) -> tuple[Ints, Ints]:
        """(A,) first node of each axis, and (A,) one beyond its last."""
        first = np.flatnonzero(np.diff(self.axis, prepend=self.axis[:1] - 1))
        return first, np.append(first[1:], len(self.axis))

    def is_thread(self) -> NDArray[np.bool_]:
        """(A,) which axes only join pieces that do not touch: nothing grows there, and nothing is to be seen."""
        thickest = np.maximum.reduceat(self.radius_m.astype(np.float64), self.axes()[0])
        return np.asarray(thickest <= max(_THREAD_M, _THREAD_SHARE * float(thickest.max())), dtype=np.bool_)

    def volume_m3(self) -> float:
        """Volume of the wood: sum of the segments' frusta above the ground.

        An axis' first segment counts from the surface of the axis that bears it: its centre line leaves a round bearer
        of radius R at R / sin(angle) from the bearer's middle. It is as thick there as at its own first node. Not
        counted are the stem's foot below the ground, flare, bark and collars, which the mesh adds.
        """
        child = np.flatnonzero(self.parent >= 0)
        bearer = self.parent[child]
        position = self.position_m.astype(np.float64)
        way = position[child] - position[bearer]
        length = np.linalg.norm(way, axis=1)
        tip, base = self.radius_m[child].astype(np.float64), self.radius_m[bearer].astype(np.float64)
        begins = self.axis[child] != self.axis[bearer]
        along = position[bearer] - position[np.maximum(self.parent[bearer], 0)]  # zero at the root: no angle is known
        product = length * np.linalg.norm(along, axis=1)
        sine = np.linalg.norm(np.cross(way, along), axis=1) / np.where(product > 0.0, product, 1.0)
        sine = np.where(product > 0.0, np.maximum(sine, _LEAST_SINE), 1.0)
        length[begins] = np.maximum(length[begins] - (base / sine)[begins], 0.0)
        base[begins] = np.minimum(base, tip)[begins]
        return float(np.sum(length * (base * base + base * tip + tip * tip)) * np.pi / 3.0)


def check_budget(what: str, count: float, bytes_each: int, hint: str) -> None:
    """Refuse a plant of `count` things, before they are made.

    `what`: plural name of the things, such as "leaves". `count`: may be infinite. `bytes_each`: memory that one takes
    while it is made and meshed. `hint`: which keys to change.

    Raises `RecipeError`: more than `LARGEST_PLANT`, or more than half of the memory that is free.
    """
    room = min(float(LARGEST_PLANT), _SHARE_OF_FREE * free_bytes() / bytes_each)
    if not count <= room:
        expected = f"at most {room:,.0f} {what}"
        if room < LARGEST_PLANT:
            expected += " (half of the memory that is free)"
        raise RecipeError(f"the plant would have {count:,.0f} {what}", where="plant", expected=expected, hint=hint)


def most_triangles(height_m: float, width_m: float) -> float:
    """Upper estimate of a plant's triangles at full detail, from its height and the width of its crown, if it has one.

    It holds for all shipped species (docs/species.md; a birch's seeds differ by a tenth). Slender plants have up to 630
    triangles a cubic metre, `height_m` times the square of `width_m`: birch. Low and wide ones have up to 50,000:
    bracken and bramble, whose leaves are divided. Of either kind large ones have fewer: beech 100.
    """
    slender = width_m < 0.5 * height_m
    per_m3 = _OF_A_SLENDER_PLANT_PER_M3 if slender else _OF_A_WIDE_PLANT_PER_M3
    per_m2 = _OF_A_LARGE_SLENDER_PLANT_PER_M2 if slender else _OF_A_LARGE_PLANT_PER_M2
    small = _OF_A_SMALL_PLANT + per_m3 * height_m * width_m**2
    return min(small, _OF_A_LARGE_PLANT + per_m2 * height_m * width_m)
