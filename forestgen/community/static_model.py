"""A base class for community models that place all plants in step 0; afterwards plants only become older.

A model says where plants stand (`place`) and how many it places at most (`most_plants`). The class has the rest of
`CommunityModel`: steps, snapshots, resuming, disturbances, memory. docs/tutorials/plugin.md writes one.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from forestgen.community.arrivals import heights_m, of_species
from forestgen.community.disturbance import planted
from forestgen.community.ecology import SpeciesEcology
from forestgen.community.model import CommunityParameters, Site
from forestgen.community.standing import FixedPopulation, State, first_state
from forestgen.core.randomness import child_rng
from forestgen.recipe.fields import Whole

_BYTES_PER_PLANT = 400  # a state, its successor, a snapshot, what a placement holds meanwhile
_BYTES_AT_LEAST = 4 * 1024 * 1024


class StaticParameters(CommunityParameters):
    """Keys of a static model; a model adds its own in a subclass."""

    steps: Whole = Field(0, ge=0, le=100_000, description="number of steps, in which plants only age")
    step_yr: float = Field(1.0, gt=0, description="duration of a step, years")


P = TypeVar("P", bound=StaticParameters)


@dataclass(frozen=True)
class Placement:
    """Plants that a static model places, one row a plant."""

    species: NDArray[np.integer]  # (N,) index of species
    position_m: NDArray[np.float64]  # (N, 2) world x and y, on the site
    radius_m: NDArray[np.float64]  # (N,) 0 < r <= the species' max_radius_m
    height_m: NDArray[np.float64] | None = None  # (N,) None: by the species' allometry

    def __post_init__(self) -> None:
        n = len(self.species)
        heights = (n,) if self.height_m is None else self.height_m.shape
        found = (self.species.shape, self.position_m.shape, self.radius_m.shape, heights)
        if found != ((n,), (n, 2), (n,), (n,)):
            raise ValueError(f"species, position_m, radius_m and height_m must be of {n} plants, got shapes {found}")


class StaticModel(FixedPopulation, ABC, Generic[P]):
    """A `CommunityModel` whose plants are placed in step 0.

    A subclass sets `Parameters` and has the methods `place` and `most_plants`.
    """

    Parameters: type[P]

    @abstractmethod
    def place(
        self, parameters: P, site: Site, species: Sequence[SpeciesEcology], rng: np.random.Generator
    ) -> Placement:
        """The plants of step 0. All randomness comes from `rng`, which the recipe's seed decides."""

    @abstractmethod
    def most_plants(self, parameters: P, site: Site, species: Sequence[SpeciesEcology]) -> float:
        """Upper bound of the mean number of plants that `place` returns; 0: none. It places nothing."""

    def init(self, parameters: P, site: Site, species: Sequence[SpeciesEcology], seed: int) -> State:
        """The plants at their places.

        Raises
        ------
        ValueError : `place` returned a plant beyond the site, or of a size that its species cannot have.
        """
        placed = self.place(parameters, site, species, child_rng(seed, "community", 0))
        _check(placed, site, species)
        height_m = placed.height_m
        if height_m is None:
            height_m = heights_m(species, placed.species, placed.radius_m)
        return first_state(
            parameters,
            species,
            seed,
            sp=placed.species.astype(np.uint16),
            x_m=placed.position_m,
            r_m=placed.radius_m,
            height_m=height_m,
        )

    def expected_plants(self, parameters: P, site: Site, species: Sequence[SpeciesEcology]) -> float:
        """Who is placed, and who will be planted."""
        return float(self.most_plants(parameters, site, species) + planted(parameters.disturbances))

    def empty_reason(self, parameters: P, site: Site, species: Sequence[SpeciesEcology]) -> str | None:
        """Why no plant will ever stand there, or None if some may."""
        return None if self.expected_plants(parameters, site, species) > 0 else "the model places no plant"

    def estimate_bytes(self, parameters: P, site: Site, species: Sequence[SpeciesEcology]) -> int:
        """Bytes for all plants at once."""
        return _BYTES_AT_LEAST + math.ceil(self.expected_plants(parameters, site, species) * _BYTES_PER_PLANT)


def _check(placed: Placement, site: Site, species: Sequence[SpeciesEcology]) -> None:
    """Refuse what no later stage could use, and name the first plant of it."""
    if not len(placed.species):
        return
    if not np.all((placed.species >= 0) & (placed.species < len(species))):
        raise ValueError(f"species must be indices below {len(species)}, got {placed.species.max()}")
    beyond = ~np.all((placed.position_m >= 0) & (placed.position_m <= np.asarray(site.size_m)), axis=1)
    if beyond.any():
        raise ValueError(f"position_m must lie on the site, got {placed.position_m[beyond][0]}")
    largest = of_species(species, "max_radius_m")[placed.species]
    sized = (placed.radius_m > 0) & (placed.radius_m <= largest)
    if not sized.all():
        worst = int(np.flatnonzero(~sized)[0])
        raise ValueError(f"radius_m must lie in (0, {largest[worst]:g}], got {placed.radius_m[worst]:g}")
    if placed.height_m is not None and not np.all(np.isfinite(placed.height_m) & (placed.height_m > 0)):
        raise ValueError("height_m must be positive")
