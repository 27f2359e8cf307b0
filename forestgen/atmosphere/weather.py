"""The contract between the simulation of air and whoever reads it: one state of the air, at one time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class AirGrid:
    """Equal cells over a box. Arrays are (Z, Y, X): layers from the ground up, rows along y, columns along x."""

    cells: tuple[int, int, int]  # along x, y, z
    cell_m: tuple[float, float, float]  # their size
    low_m: tuple[float, float, float] = (0.0, 0.0, 0.0)  # world corner of the first cell; z is the datum's height
    periodic: bool = True  # at the sides; otherwise wind blows in and out

    @property
    def shape(self) -> tuple[int, int, int]:
        """(Z, Y, X) of an array of cell values."""
        return self.cells[::-1]

    @property
    def size_m(self) -> tuple[float, float, float]:
        x, y, z = (count * side for count, side in zip(self.cells, self.cell_m, strict=True))
        return x, y, z

    @property
    def layer_heights_m(self) -> NDArray[np.float64]:
        """(Z,) height of the cells' centres above the datum."""
        return np.asarray(self.low_m[2] + (np.arange(self.cells[2]) + 0.5) * self.cell_m[2])


@dataclass(frozen=True)
class Weather:
    """A snapshot. Ratios are mass of water per mass of dry air."""

    grid: AirGrid
    time_s: float  # since the simulation began
    east_m_per_s: NDArray[
        np.float32
    ]  # (Z, Y, X + 1) at the cells' west and east faces; periodic: the last is the first
    north_m_per_s: NDArray[np.float32]  # (Z, Y + 1, X) at their south and north faces
    up_m_per_s: NDArray[np.float32]  # (Z + 1, Y, X) at their bottoms and tops
    potential_temperature_k: NDArray[np.float32]  # (Z, Y, X)
    vapour: NDArray[np.float32]  # (Z, Y, X) kg/kg
    cloud: NDArray[np.float32]  # (Z, Y, X) kg/kg of droplets that float
    rain: NDArray[np.float32]  # (Z, Y, X) kg/kg of drops that fall
    fallen_kg_per_m2: NDArray[np.float64]  # (Y, X) rain on the ground since the beginning: mm
    density_kg_per_m3: NDArray[np.float64]  # (Z,) of the air at rest, in each layer
    temperature_ratio: NDArray[np.float64]  # (Z,) of temperature to potential temperature: Exner's function
    solid: NDArray[np.bool_] | None = None  # (Z, Y, X) cells inside the terrain; None: flat

    @property
    def cloud_water_kg_per_m3(self) -> NDArray[np.float32]:
        """(Z, Y, X) liquid water content of droplets."""
        return self.cloud * self.density_kg_per_m3.astype(np.float32)[:, None, None]

    @property
    def rain_water_kg_per_m3(self) -> NDArray[np.float32]:
        """(Z, Y, X) liquid water content of drops."""
        return self.rain * self.density_kg_per_m3.astype(np.float32)[:, None, None]
