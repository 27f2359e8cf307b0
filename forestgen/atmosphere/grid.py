"""The contract between an atmosphere and the scene."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Phase:
    """How a cloud scatters light: two Henyey-Greenstein lobes, the second usually weak and backwards."""

    forward: float = 0.85  # g of the first lobe, in (-1, 1)
    backward: float = -0.2  # g of the second
    forward_share: float = 1.0  # of the light that is scattered, [0, 1]

    @property
    def asymmetry(self) -> float:
        """Mean cosine of the scattering angle."""
        return self.forward_share * self.forward + (1.0 - self.forward_share) * self.backward


@dataclass(frozen=True)
class CloudGrid:
    """Extinction on a regular grid of cell values over a box; nothing outside it. Grey: the same at all wavelengths."""

    extinction_per_m: NDArray[np.float32]  # (Z, Y, X)
    low_m: tuple[float, float, float]  # world corner of the first cell
    high_m: tuple[float, float, float]  # world corner after the last cell
    albedo: float = 0.999
    phase: Phase = Phase()

    @property
    def cell_m(self) -> tuple[float, float, float]:
        """Size of a cell along x, y and z."""
        x, y, z = (
            float(high - low) / count
            for low, high, count in zip(self.low_m, self.high_m, self.extinction_per_m.shape[::-1], strict=True)
        )
        return x, y, z
