"""The contract between an atmosphere and the scene."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class CloudGrid:
    """Extinction on a regular grid of cell values over a box; nothing outside it."""

    extinction_per_m: NDArray[np.float32]  # (Z, Y, X)
    low_m: tuple[float, float, float]  # world corner of the first cell
    high_m: tuple[float, float, float]  # world corner after the last cell
    albedo: float = 0.999
    asymmetry: float = 0.85  # g of the Henyey-Greenstein phase function
