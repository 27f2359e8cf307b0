"""The grid that water moves on: cells of a rectangle, their heights, and what its edges do."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.community.model import Site

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Ground:
    """Cells over [0, W] x [0, H], row 0 at y = 0, and how the ground lies there.

    Edges are closed: nothing passes them, and water slips along them. Or they are joined (`periodic`): heights then
    should meet there, since a jump is a cliff that water runs down. An endless hillside is a torus with a `gradient`.
    """

    size_m: tuple[float, float]  # W, H
    shape: tuple[int, int]  # rows, cols
    periodic: bool = False
    height_m: Floats | None = None  # (rows, cols) in the middles of the cells; None: a plane
    gradient: tuple[float, float] = (0.0, 0.0)  # of the plane to east and north, metres a metre; periodic grounds only

    def __post_init__(self) -> None:
        if len(self.size_m) != 2 or not all(math.isfinite(side) and side > 0 for side in self.size_m):
            raise ValueError(f"size_m: expected two positive lengths in metres, got {self.size_m!r}")
        if len(self.shape) != 2 or min(self.shape) < 1:
            raise ValueError(f"shape: expected rows and columns of 1 or more, got {self.shape!r}")
        if self.height_m is not None:
            object.__setattr__(self, "height_m", checked_map("height_m", self.height_m, self.shape, least=-math.inf))
        if len(self.gradient) != 2 or not all(math.isfinite(one) for one in self.gradient):
            raise ValueError(f"gradient: expected two finite numbers, got {self.gradient!r}")
        if self.gradient != (0.0, 0.0) and (not self.periodic or self.height_m is not None):
            raise ValueError(
                f"gradient: expected (0, 0) where edges are closed or heights are given, got {self.gradient!r}; "
                "give the hillside as height_m, or make the ground periodic and leave height_m out"
            )

    @classmethod
    def of_site(cls, site: Site, cell_m: float, *, periodic: bool) -> Ground:
        """The ground of a community's site, in cells as near to a width as fit it."""
        if not (math.isfinite(cell_m) and cell_m > 0):
            raise ValueError(f"cell_m: expected a positive length in metres, got {cell_m!r}")
        cols, rows = (max(1, round(side / cell_m)) for side in site.size_m)
        if site.height is None:
            return cls(site.size_m, (rows, cols), periodic)
        x, y = ((np.arange(n) + 0.5) / n * side for n, side in zip((cols, rows), site.size_m, strict=True))
        height_m = np.broadcast_to(site.height(*np.meshgrid(x, y)), (rows, cols))
        return cls(site.size_m, (rows, cols), periodic, np.array(height_m, dtype=np.float64))

    @property
    def cell_m(self) -> tuple[float, float]:
        """Width and depth of a cell."""
        return self.size_m[0] / self.shape[1], self.size_m[1] / self.shape[0]

    def steepness(self) -> Floats:
        """(rows, cols) size of the ground's gradient, metres a metre: centred differences."""
        if self.height_m is None:
            return np.full(self.shape, math.hypot(*self.gradient))
        wide = np.pad(self.height_m, 1, mode="wrap" if self.periodic else "edge")
        east = wide[1:-1, 2:] - wide[1:-1, :-2]
        north = wide[2:, 1:-1] - wide[:-2, 1:-1]
        apart_x, apart_y = np.full(self.shape[1], 2 * self.cell_m[0]), np.full(self.shape[0], 2 * self.cell_m[1])
        if not self.periodic:  # at an edge, the difference to the one neighbour
            for apart in (apart_x, apart_y):
                apart[[0, -1]] *= 0.5 if len(apart) > 1 else 1.0
        return np.asarray(np.hypot(east / apart_x, north / apart_y[:, None]))


def checked_map(
    name: str, values: NDArray[np.floating] | float, shape: tuple[int, int], *, least: float = 0.0
) -> Floats:
    """(rows, cols) of a map in double precision; one number holds everywhere.

    Raises
    ------
    ValueError : it has another shape, or a value that is not finite or less than the least.
    """
    given = np.asarray(values, dtype=np.float64)
    if given.shape not in ((), shape):
        raise ValueError(f"{name}: expected one number or a map of {shape[0]} x {shape[1]} cells, got {given.shape}")
    bad = ~(np.isfinite(given) & (given >= least))
    if bad.any():
        row, col = np.unravel_index(int(np.argmax(bad)), shape) if given.ndim else (0, 0)
        value = float(given[row, col]) if given.ndim else float(given)
        allowed = "finite" if least == -math.inf else f"finite and {least:g} or more"
        raise ValueError(
            f"{name}: expected values that are {allowed}; {int(bad.sum())} are not, the first in row {row}, "
            f"column {col}: {value:g}"
        )
    return np.array(np.broadcast_to(given, shape))
