"""What every community model offers, and what it is told about species and site."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from typing import Protocol, TypeVar

from pydantic import BaseModel

from forestgen.community.population import Population

P = TypeVar("P", bound=BaseModel)
S = TypeVar("S")


@dataclass(frozen=True)
class SpeciesEcology:
    """How a species lives, as far as a community model cares. All numbers are finite.

    References
    ----------
    B. Lane, Models of Plant Communities for Image Synthesis, University of Calgary, 2002, chapters 4 and 6.
    """

    name: str  # as in the recipe
    growth_m_per_yr: float  # radial growth of an undominated plant, m/yr, >= 0
    max_radius_m: float  # R, m, > 0: a plant that reaches it is mature
    shade_tolerance: float  # shaded[sp]: probability in [0, 1] that a dominated plant survives a step
    old_age_survival: float  # oldage[sp]: probability in [0, 1] that a mature plant survives a step
    seedlings_per_ha_per_yr: float  # mean number of seedlings that arrive, 1/(ha yr), >= 0
    seedling_radius_m: float  # mean radius of an arriving seedling, m, > 0
    height_scale: float  # A_H of H = A_H r^c_H, metres of height at r = 1 m, > 0
    height_exponent: float  # c_H of H = A_H r^c_H, >= 0

    def __post_init__(self) -> None:
        for name in (f.name for f in fields(self) if f.name != "name"):
            value = getattr(self, name)
            least_is_zero = name not in ("max_radius_m", "seedling_radius_m", "height_scale")
            most = 1.0 if name in ("shade_tolerance", "old_age_survival") else math.inf
            if not (math.isfinite(value) and value <= most and (value > 0 or (value == 0 and least_is_zero))):
                allowed = f"{'[' if least_is_zero else '('}0, {most:g}{']' if most == 1 else ')'}"
                raise ValueError(f"{self.name}: {name} must lie in {allowed}, got {value!r}")


@dataclass(frozen=True)
class Site:
    """The ground of a community: the rectangle [0, W] x [0, H] in world x and y, metres."""

    size_m: tuple[float, float]

    def __post_init__(self) -> None:
        if len(self.size_m) != 2 or not all(math.isfinite(side) and side > 0 for side in self.size_m):
            raise ValueError(f"size_m must be two positive lengths in metres, got {self.size_m!r}")

    @property
    def area_m2(self) -> float:
        return self.size_m[0] * self.size_m[1]

    @property
    def area_ha(self) -> float:
        return self.area_m2 / 1e4


class CommunityModel(Protocol[P, S]):
    """A family of interchangeable models. A model has no state of its own: everything is in `S`.

    Randomness of step k comes from ``child_rng(seed, "community", k)`` (k = 0: `init`), so that a state saved after
    any step resumes to the same future.
    """

    Parameters: type[P]

    def init(self, parameters: P, site: Site, species: Sequence[SpeciesEcology], seed: int) -> S:
        """State of step 0."""
        ...

    def step(self, state: S) -> S:
        """State one step later; `state` itself is left as it was."""
        ...

    def population(self, state: S) -> Population:
        """Snapshot of a state."""
        ...

    def estimate_bytes(self, parameters: P, site: Site, species: Sequence[SpeciesEcology]) -> int:
        """Upper estimate of the peak memory of one simulation, one snapshot included; cheap, simulates nothing.

        A caller that keeps a history holds its snapshots on top of this.
        """
        ...


def simulate(
    model: CommunityModel[P, S],
    parameters: P,
    site: Site,
    species: Sequence[SpeciesEcology],
    seed: int,
    *,
    steps: int,
) -> Iterator[Population]:
    """The population at step 0, 1, ..., `steps`, each made when it is asked for."""
    state = model.init(parameters, site, species, seed)
    yield model.population(state)
    for _ in range(steps):
        state = model.step(state)
        yield model.population(state)
