"""The dew point: what tests of saturation are held against."""

from __future__ import annotations

import numpy as np

from forestgen.atmosphere.sounding import Floats


def dew_point_k(vapour: Floats | float, pressure_pa: Floats | float) -> Floats:
    """Temperature at which air with a mass ratio of vapour is saturated: Eq. 29 solved for T. 0 vapour: 0 K."""
    with np.errstate(divide="ignore"):
        log = np.log(np.asarray(vapour, dtype=np.float64) * pressure_pa / 380.16)
    # As log runs to -inf the formula tends to its own pole of -243.5 °C, below all weather.
    some = np.where(np.isneginf(log), -1.0, log)
    celsius = np.where(np.isneginf(log), -273.15, 243.5 * some / (17.67 - some))
    return np.asarray(celsius + 273.15)
