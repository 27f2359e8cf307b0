"""What stands at the box's six sides, and on the terrain (seeds section 4.6).

Fields have two ghost cells on each side, which are filled here. Nothing passes ground and ceiling. The ceiling slips:
the wind is mirrored. The ground does not: viscosity sees the wind there with its sign turned (see `momentum`; the
fluxes do not, since they would take the jump for a wind). The sides are joined (periodic), or the wind of the air
at rest stands there: it blows in and out, and nothing rises at them. Faces of terrain are shut.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.weather import AirGrid
from forestgen.core.threads import at_once

Field = NDArray[np.float32]
Velocity = tuple[Field, Field, Field]


class Boundaries:
    """The sides of one grid.

    Parameters
    ----------
    wind_m_per_s : (Z, 2) at the sides, east and north.
    solid : (Z, Y, X) cells inside the terrain, or None.
    """

    def __init__(self, grid: AirGrid, wind_m_per_s: NDArray[np.float64], solid: NDArray[np.bool_] | None) -> None:
        self.periodic = grid.periodic
        self.wind = wind_m_per_s.astype(np.float32)
        self.openness = None if solid is None else _openness(solid, grid.periodic)
        self._normal = None if grid.periodic else _wind_through(grid, wind_m_per_s, self.openness)

    def apply(self, velocity: Velocity) -> None:
        """Sets the velocity at the sides and its ghosts."""
        u, v, w = velocity
        if self.openness is not None:
            for field, opened in zip(velocity, self.openness, strict=True):
                field *= opened
        w[2] = w[-2] = 0
        if self.periodic:
            at_once([partial(_joined, field) for field in velocity])
        else:
            self._open_sides(u, v, w)
        for field in (u, v):
            field[1], field[0] = field[2], field[3]
            field[-2], field[-1] = field[-3], field[-4]
        w[1], w[0], w[-1] = -w[3], -w[4], -w[-3]

    def _open_sides(self, u: Field, v: Field, w: Field) -> None:
        east, north = self.wind[:, 0, None, None], self.wind[:, 1, None, None]
        for field, wind in ((u, east), (v, north)):
            inner = field[2:-2]
            inner[:, :, :2], inner[:, :, -2:], inner[:, :2], inner[:, -2:] = wind, wind, wind, wind
        assert self._normal is not None
        u[2:-2, 2:-2, 2], u[2:-2, 2:-2, -2], v[2:-2, 2, 2:-2], v[2:-2, -2, 2:-2] = self._normal
        w[:, :, 1], w[:, :, 0], w[:, :, -2], w[:, :, -1] = -w[:, :, 2], -w[:, :, 3], -w[:, :, -3], -w[:, :, -4]
        w[:, 1], w[:, 0], w[:, -2], w[:, -1] = -w[:, 2], -w[:, 3], -w[:, -3], -w[:, -4]


def _joined(field: Field) -> None:
    field[:, :, :2], field[:, :, -2:] = field[:, :, -4:-2], field[:, :, 2:4]
    field[:, :2], field[:, -2:] = field[:, -4:-2], field[:, 2:4]


def _wind_through(
    grid: AirGrid, wind_m_per_s: NDArray[np.float64], openness: Velocity | None
) -> tuple[Field, Field, Field, Field]:
    """Wind through the west, east (Z, Y), south and north (Z, X) sides; as much air leaves as comes.

    Where terrain shuts more of one side than of its opposite, the rest flows in or out evenly through all that is open.
    """
    z, y, x = grid.shape
    u, v, _ = (np.ones((z + 4, y + 4, x + 4), np.float32),) * 3 if openness is None else openness
    opened = [u[2:-2, 2:-2, 2], u[2:-2, 2:-2, -2], v[2:-2, 2, 2:-2], v[2:-2, -2, 2:-2]]
    outwards = (-1, 1, -1, 1)
    area = [grid.cell_m[1], grid.cell_m[1], grid.cell_m[0], grid.cell_m[0]]  # times the layer's thickness
    wind = [wind_m_per_s[:, side // 2, None] * part for side, part in enumerate(opened)]
    surplus = sum(sign * a * part.sum() for sign, a, part in zip(outwards, area, wind, strict=True))
    whole = max(sum(a * part.sum(dtype=np.float64) for a, part in zip(area, opened, strict=True)), 1e-9)
    sides = [
        (part - sign * surplus / whole * o).astype(np.float32)
        for sign, part, o in zip(outwards, wind, opened, strict=True)
    ]
    return sides[0], sides[1], sides[2], sides[3]


def _openness(solid: NDArray[np.bool_], periodic: bool) -> Velocity:
    """1 at faces between two cells of air, 0 at others; with ghosts."""
    layers, rows, columns = solid.shape
    around = np.ones((layers + 4, rows + 4, columns + 4), dtype=bool)
    around[2:, 2:-2, 2:-2][:layers] = solid
    around[-2:] = False
    sides = ((0, 0), (2, 2), (2, 2))
    around[2:-2] = np.pad(solid, sides, mode="wrap") if periodic else np.pad(solid, sides, mode="edge")
    faces = []
    for axis in (2, 1, 0):
        shut = around | np.roll(around, 1, axis)
        shut[(slice(None),) * axis + (slice(0, 1),)] = np.take(around, [0], axis)
        faces.append((~shut).astype(np.float32))
    return faces[0], faces[1], faces[2]


def solid_cells(grid: AirGrid, height_m: NDArray[np.floating] | None) -> NDArray[np.bool_] | None:
    """(Z, Y, X) cells whose centre lies below the terrain (Y, X); None where there is none."""
    if height_m is None:
        return None
    solid = grid.layer_heights_m[:, None, None] < np.asarray(height_m)[None]
    return solid if solid.any() else None
