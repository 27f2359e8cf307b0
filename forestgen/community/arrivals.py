"""New plants: how many, where, how large, under which numbers. Shared by the models."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from forestgen.community.ecology import SpeciesEcology
from forestgen.community.model import Site
from forestgen.core.errors import ResourceError

_LARGEST_ID = 2**32 - 1


def of_species(species: Sequence[SpeciesEcology], name: str) -> NDArray[np.float64]:
    """One number of every species; (number of species,)."""
    return np.array([getattr(one, name) for one in species], dtype=np.float64)


def seedlings_per_step(species: Sequence[SpeciesEcology], site: Site, step_yr: float) -> NDArray[np.float64]:
    """Mean number of seedlings of each species; (number of species,)."""
    with np.errstate(over="ignore"):  # inf is refused like any other absurd number
        return of_species(species, "seedlings_per_ha_per_yr") * site.area_ha * step_yr


def seedlings(
    sp: NDArray[np.uint16], site: Site, species: Sequence[SpeciesEcology], rng: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Places, uniform on the site, and radii of seedlings of given species.

    Radii are uniform between 0.5 and 1.5 times the species' seedling_radius_m, and at most its max_radius_m.

    Returns
    -------
    (N, 2) and (N,) float64, metres
    """
    x_m = rng.random((len(sp), 2)) * site.size_m
    r_m = of_species(species, "seedling_radius_m")[sp] * rng.uniform(0.5, 1.5, len(sp))
    return x_m, np.minimum(r_m, of_species(species, "max_radius_m")[sp])


def new_ids(first: int, count: int) -> NDArray[np.uint32]:
    """Ids from `first` on; see `refuse_overflow`."""
    refuse_overflow(first, count)
    return np.arange(first, first + count, dtype=np.uint32)


def refuse_overflow(first_id: int, expected: float) -> None:
    """Raise `ResourceError` if about so many plants, numbered from `first_id`, are more than there are ids."""
    if first_id - 1 + expected > _LARGEST_ID:
        raise ResourceError(
            "plant ids are used up",
            expected=f"at most {_LARGEST_ID} plants in the history of a community",
            got=f"{first_id - 1} plants so far and about {expected:.3g} more",
            hint="lower seedlings_per_ha_per_yr (or initial_plants_per_ha), steps or site.size_m",
        )
