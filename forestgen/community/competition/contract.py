"""What every competition model offers, and what it knows of the circles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from forestgen.community.population import Floats

P = TypeVar("P", bound=BaseModel)


@dataclass(frozen=True)
class Circles:
    """The plants of a community as a competition model sees them. All numbers are finite; no two rows share a plant_id.

    References: B. Lane, Models of Plant Communities for Image Synthesis, University of Calgary, 2002, section 3.1: a
    plant's ecological neighbourhood is a circle.
    """

    position_m: Floats  # (N, 2) metres, world x and y
    radius_m: Floats  # (N,) metres, > 0
    height_m: Floats  # (N,) metres, > 0; the radius where heights are unknown
    plant_id: NDArray[np.uint32]  # (N,) the earlier born has the lower
    species: NDArray[Any]  # (N,) any integer type: index of species

    def __post_init__(self) -> None:
        n = len(self.radius_m)
        for name in ("position_m", "radius_m", "height_m", "plant_id", "species"):
            shape = (n, 2) if name == "position_m" else (n,)
            if getattr(self, name).shape != shape:
                raise ValueError(f"{name} must have shape {shape}, got {getattr(self, name).shape}")
        for name, least in (("position_m", -np.inf), ("radius_m", 0.0), ("height_m", 0.0)):
            values = getattr(self, name)
            # The two comparisons also refuse NaN: min and max pass it on.
            if n and not (values.min() > least and values.max() < np.inf):
                raise ValueError(f"{name} must be finite{' and positive' if least == 0 else ''}")

    def __len__(self) -> int:
        return len(self.radius_m)


class CompetitionModel(Protocol[P]):
    """A family of interchangeable models of competition, named in `forestgen.community.registry.COMPETITION_MODELS`.

    It has no state and draws no random numbers. Its answer depends neither on the order of rows (but for the rounding
    of sums) nor on the number of threads.
    """

    Parameters: type[P]
    needs_heights: bool  # whether its answer depends on `Circles.height_m`

    def answer(self, parameters: P, circles: Circles, size_m: tuple[float, float], *, periodic: bool) -> Floats:
        """(N,) c of every circle's ?E(c), in [0, 1]: 1 is a plant without rivals, 0 one that gets nothing.

        Parameters
        ----------
        size_m : width and height of the site.
        periodic : the site is a torus: its left edge continues at its right, its lower at its upper. Otherwise it lies
            in the plane, and a circle that reaches beyond the edge keeps what it has there.
        """
