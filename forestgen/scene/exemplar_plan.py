"""The contract between the choice of exemplars and their growing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class ExemplarPlan:
    """Which exemplars to grow, and which plant uses which. Every exemplar has plants."""

    species: NDArray[np.uint16]  # (E,) index into the population's species_names
    radius_m: Floats  # (E,) size of each exemplar
    rank: Ints  # (E,) of its cluster among the species', by radius: 0, 1, ...; of a library, its rung
    variant: Ints  # (E,) which of the plants of that size
    level: Ints  # (E,) index of its level of detail, see plants/levels.py: 0 is all detail
    exemplar_of_plant: NDArray[np.uint32]  # (N,) index into the exemplars
    plant: Ints  # (E,) row of the plant whose own branches it has; -1: its species' generator grows it by its radius
    is_unique: NDArray[np.bool_]  # (E,) of that plant alone, which keeps its place, size and attitude

    def __len__(self) -> int:
        return len(self.radius_m)
