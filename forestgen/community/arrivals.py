"""Shared by the models: tables of plants and their snapshots; new plants: how many, where, how large, their ids."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from forestgen.community.population import Ecologies, Floats, Population, Site, Status
from forestgen.core.errors import ResourceError

_LARGEST_ID = 2**32 - 1


@dataclass(frozen=True)
class Rows:
    """A table: each field is an array with one row a plant."""

    def __len__(self) -> int:
        return len(next(iter(vars(self).values())))

    def where(self, keep: NDArray[np.bool_] | NDArray[np.int64]) -> Self:
        """Of these rows, or those that are kept."""
        return replace(self, **{name: values[keep] for name, values in vars(self).items()})

    def and_then(self, others: Self) -> Self:
        return replace(self, **{name: np.concatenate([a, getattr(others, name)]) for name, a in vars(self).items()})


@dataclass(frozen=True)
class CirclePlants(Rows):
    """Circles that grow and age, in order of plant_id; their models add columns."""

    x_m: Floats  # (N, 2) metres, world x and y
    r_m: Floats  # (N,) metres
    sp: NDArray[np.uint16]  # (N,) index of species
    plant_id: NDArray[np.uint32]  # (N,)
    born: NDArray[np.int32]  # (N,) step of arrival

    def population(
        self,
        species: Ecologies,
        step: int,
        step_yr: float,
        next_id: int,
        dominated: NDArray[np.bool_] | None,
        columns: Mapping[str, NDArray[Any]],
        height_m: Floats | None = None,
    ) -> Population:
        """Snapshot; z is 0. `columns` are the model's own, and `next_id` is that of the next plant to arrive.

        Heights are by default those of the species' allometry.
        """
        mature = self.r_m >= of_species(species, "max_radius_m")[self.sp]
        status = np.where(mature, np.uint8(Status.MATURE), np.uint8(Status.GROWING))
        if dominated is not None:
            status[dominated] = Status.DOMINATED
        return Population(
            time_yr=step * step_yr,
            species_names=tuple(one.name for one in species),
            plant_id=self.plant_id,
            species=self.sp,
            position_m=on_the_ground(self.x_m),
            radius_m=self.r_m,
            height_m=heights_m(species, self.sp, self.r_m) if height_m is None else height_m,
            age_yr=(step - self.born).astype(np.float64) * step_yr,
            status=status,
            columns=columns,
            step=step,
            state={"next_id": next_id},
        )

    @staticmethod
    def columns_of(population: Population, step_yr: float) -> dict[str, NDArray[Any]]:
        """The circles of a snapshot: the step of arrival is in the age."""
        return {
            "x_m": np.ascontiguousarray(population.position_m[:, :2]),
            "r_m": population.radius_m,
            "sp": population.species,
            "plant_id": population.plant_id,
            "born": np.int32(population.step) - np.rint(population.age_yr / step_yr).astype(np.int32),
        }


def on_the_ground(x_m: Floats) -> Floats:
    """(N, 3) of (N, 2) places, z 0."""
    position_m = np.zeros((len(x_m), 3))
    position_m[:, :2] = x_m
    return position_m


def heights_m(species: Ecologies, sp: NDArray[np.integer], radius_m: Floats) -> Floats:
    """(N,) heights of plants by their species' allometry, metres."""
    scale, exponent = (of_species(species, name)[sp] for name in ("height_scale", "height_exponent"))
    return np.asarray(scale * radius_m**exponent)


def radii_m(species: Ecologies, sp: NDArray[np.integer], height_m: Floats) -> Floats:
    """(N,) radii of plants by their species' allometry of heights, metres; at most the largest."""
    scale, exponent, most = (
        of_species(species, one)[sp] for one in ("height_scale", "height_exponent", "max_radius_m")
    )
    power = np.divide(1.0, exponent, out=np.zeros(len(sp)), where=exponent > 0)
    radius = np.where(exponent > 0, np.exp(np.minimum(np.log(height_m / scale) * power, 20.0)), most)
    return np.asarray(np.clip(radius, 1e-6, most))


def of_species(species: Ecologies, name: str) -> Floats:
    """One number of every species; (number of species,)."""
    return np.array([getattr(one, name) for one in species], dtype=np.float64)


def seedlings_per_step(species: Ecologies, site: Site, step_yr: float) -> Floats:
    """Mean number of seedlings of each species; (number of species,)."""
    with np.errstate(over="ignore"):  # inf is refused like any other absurd number
        return of_species(species, "seedlings_per_ha_per_yr") * site.area_ha * step_yr


def seedlings(
    sp: NDArray[np.uint16], site: Site, species: Ecologies, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """(N, 2) places, uniform on the site, and (N,) radii of seedlings of given species, metres.

    Radii are uniform between 0.5 and 1.5 times the species' seedling_radius_m, and at most its max_radius_m.
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
        most = f"at most {_LARGEST_ID} plants in the history of a community"
        got = f"{first_id - 1} plants so far and about {expected:.3g} more"
        hint = "lower seedlings_per_ha_per_yr (or initial_plants_per_ha), steps or site.size_m"
        raise ResourceError("plant ids are used up", expected=most, got=got, hint=hint)


def upper_number(mean: float) -> float:
    """A mean number of plants and six standard deviations of a Poisson number more, at most 1e30."""
    return min(mean + 6 * math.sqrt(mean), 1e30)
