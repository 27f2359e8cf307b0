"""Maps between the ground's cells and the air's: by the areas that cells have in common, so that means stay."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.grid import AirGrid
from forestgen.community.soil_water.ground import Floats, Ground


@dataclass(frozen=True)
class Between:
    """Shares of area, along each axis, of a ground that lies inside the air's box."""

    to_air: tuple[Floats, Floats]  # (air rows, rows), (air cols, cols): share of an air cell that a ground cell takes
    to_ground: tuple[Floats, Floats]  # (rows, air rows), (cols, air cols): share of a ground cell in an air cell
    beyond: tuple[Floats, Floats]  # as `to_air`, of a ground whose outermost cells reach to the edges of the box

    def for_air(self, values: Floats) -> NDArray[np.float32]:
        """(Y, X) means over the air's cells of a (rows, cols) map; around the ground it is as in its mean."""
        down, across = self.to_air
        covered = np.outer(down.sum(axis=1), across.sum(axis=1))
        inside = _product(down, values, across)
        return np.asarray(inside + (1.0 - covered) * values.mean(), dtype=np.float32)

    def heights_for_air(self, height_m: Floats) -> Floats:
        """(Y, X) of a (rows, cols) map of heights; around the ground they are those of its edge: no cliffs."""
        down, across = self.beyond
        return _product(down, height_m, across)

    def for_ground(self, values: NDArray[np.floating]) -> Floats:
        """(rows, cols) means over the ground's cells of a (Y, X) map of the air."""
        down, across = self.to_ground
        return _product(down, np.asarray(values, dtype=np.float64), across)


def between(ground: Ground, air: AirGrid) -> Between:
    """How a ground, whose middle is that of the air's box, and the air see each other.

    Raises
    ------
    ValueError : the ground is larger than the box.
    """
    shares: list[list[Floats]] = [[], [], []]
    for axis in (1, 0):
        length, box = ground.size_m[axis], air.size_m[axis]
        if length > box * (1 + 1e-9):
            raise ValueError(f"a ground of {length:g} m does not lie in a box of {box:g} m")
        start = 0.5 * (box - length)
        edges = start + np.linspace(0.0, length, ground.shape[1 - axis] + 1)
        of_air = np.linspace(0.0, box, air.cells[axis] + 1)
        common = _overlap(of_air, edges)
        shares[0].append(common / air.cell_m[axis])
        shares[1].append(common.T / ground.cell_m[axis])
        shares[2].append(_overlap(of_air, np.concatenate([[0.0], edges[1:-1], [box]])) / air.cell_m[axis])
    return Between(*((down, across) for down, across in shares))


def _overlap(ours: Floats, theirs: Floats) -> Floats:
    """(N, M) length that intervals between edges (N + 1,) and (M + 1,) have in common."""
    low = np.maximum(ours[:-1, None], theirs[None, :-1])
    high = np.minimum(ours[1:, None], theirs[None, 1:])
    return np.asarray(np.maximum(high - low, 0.0))


def _product(down: Floats, values: Floats, across: Floats) -> Floats:
    """`down @ values @ across.T`; no BLAS, since the last digits of its sums depend on its threads."""
    return np.asarray(np.einsum("ac,bc->ab", np.einsum("ab,bc->ac", down, values), across))
