"""How well a climate suits a species (Makowski 2023, Eq. 13): a Gaussian of temperature times one of precipitation."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from forestgen.community.branch_modules.parameters import BranchModulesParameters
    from forestgen.community.branch_modules.traits import Traits


def temperature_at(parameters: BranchModulesParameters, elevation_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N,) mean temperature, deg C, at ground of these elevations above z = 0, metres; a climate must be given."""
    if parameters.temperature_c is None:
        raise ValueError("no climate is given")
    return np.asarray(parameters.temperature_c + parameters.lapse_rate_k_per_km * elevation_m / 1000.0)


def adaptation(
    parameters: BranchModulesParameters,
    traits: Traits,
    species: NDArray[np.integer],
    elevation_m: NDArray[np.float64],
) -> NDArray[np.float64]:
    """(N,) o of Eq. 13 for plants of these species at these elevations, metres; 1 where no climate is given.

    The ratio of the densities at the climate and at the optimum: 1 at the optimum, whatever the widths.
    """
    if parameters.temperature_c is None or parameters.precipitation_mm_per_yr is None:
        return np.ones(len(species))
    warm = temperature_at(parameters, elevation_m) - traits.temperature_c[species]
    wet = parameters.precipitation_mm_per_yr - traits.precipitation_mm_per_yr[species]
    warm /= traits.temperature_width_c[species]
    wet = wet / traits.precipitation_width_mm_per_yr[species]
    return np.asarray(np.exp(-0.5 * (warm**2 + wet**2)))
