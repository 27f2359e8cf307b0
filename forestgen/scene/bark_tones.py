"""How bright the wood of each plant is, over its species' mean: stems of a stand differ, whatever their exemplar.

Tones are even over all wavelengths. Reflectances of bark differ within a species, less in the visible than in the near
infrared (Juola, Hovi and Rautiainen 2020, Silva Fennica 54(4), 10331); the number is ours. Mitsuba's own surfaces have
the mean.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.core.randomness import SPLIT_MIX_STEP, mixed

SPREAD = 0.17  # standard deviation of wood's reflectance between plants, over the mean
WOOD = (Part.TRUNK, Part.BRANCH, Part.DEAD_WOOD)
_DRAWS = 3  # evenly distributed numbers, whose sum makes a tone: none is beyond 3 standard deviations


def bark_tones(plant_id: NDArray[np.uint32], spread: float) -> NDArray[np.float32]:
    """(N,) factors on the reflectance, of mean 1, by (N,) ids of plants; those without one differ by their row."""
    own = plant_id.astype(np.uint64) << np.uint64(32)
    own = np.where(plant_id > 0, own, np.arange(len(own), dtype=np.uint64))
    with np.errstate(over="ignore"):
        bits = [mixed(own + np.uint64(k) * SPLIT_MIX_STEP) for k in range(1, 1 + _DRAWS)]
    draws = [(one >> np.uint64(11)).astype(np.float64) * 2.0**-53 - 0.5 for one in bits]
    normal = np.sum(draws, axis=0) * np.sqrt(12.0 / _DRAWS)
    return np.asarray(1.0 + spread * normal, dtype=np.float32)
