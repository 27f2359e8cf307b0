"""Heat and vapour from the ground into the lowest cell of air of each column."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.fluid.background import HEAT_CAPACITY_J_PER_KG_K, Background
from forestgen.atmosphere.fluid.parameters import Surface
from forestgen.atmosphere.weather import AirGrid

Field = NDArray[np.float32]


class Ground:
    """The lowest air of each column, and what it receives.

    Parameters
    ----------
    solid : (Z, Y, X) cells inside the terrain, or None.
    """

    def __init__(
        self, grid: AirGrid, surface: Surface | None, solid: NDArray[np.bool_] | None, air: Background
    ) -> None:
        z, y, x = grid.shape
        self.lowest = np.zeros((y, x), np.int64) if solid is None else solid.sum(axis=0)
        self._at = (np.minimum(self.lowest, z - 1) + 2, *np.indices((y, x)) + 2)
        self._warming, self._wetting = (np.zeros((y, x), np.float32),) * 2
        if surface is not None:
            mass = air.flow_density_kg_per_m3 * grid.cell_m[2]
            exner = air.temperature_ratio[np.minimum(self.lowest, z - 1)]
            self._warming = (surface.heat_w_per_m2 / (mass * HEAT_CAPACITY_J_PER_KG_K * exner)).astype(np.float32)
            self._wetting = (surface.vapour_kg_per_m2_s / mass).astype(np.float32)
        self._gives = bool(self._warming.any() or self._wetting.any())

    def give(self, heat: Field, vapour: Field, step_s: float) -> None:
        """Adds a step's emission to fields (Z + 4, Y + 4, X + 4). Dew takes no more vapour than there is."""
        if self._gives:
            heat[self._at] += np.float32(step_s) * self._warming
            vapour[self._at] = np.maximum(vapour[self._at] + np.float32(step_s) * self._wetting, 0)
