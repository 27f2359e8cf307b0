"""The contract between a community model and everything after it, and what there is of each species."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.architecture.modules import Modules
from forestgen.core.frames import BREAST_HEIGHT_M

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Mask = NDArray[np.bool_]
Indices = NDArray[np.int64]
SpeciesIndex = NDArray[np.uint16]  # of plants: index in the recipe's species


class Status(IntEnum):
    """State of a plant in its community. The numbers are written to files: never renumber."""

    GROWING = 0
    DOMINATED = 1
    MATURE = 2
    DEAD = 3


@dataclass(frozen=True)
class Population:
    """A snapshot of a community: one row a plant, sorted by plant_id.

    A plant_id is stable for the plant's life, never reused, never 0. Together with what the simulation was started
    with, a snapshot holds everything that the future depends on (`CommunityModel.resume`).
    """

    time_yr: float
    species_names: tuple[str, ...]  # species index -> name in the recipe
    plant_id: NDArray[np.uint32]  # (N,)
    species: NDArray[np.uint16]  # (N,) index into species_names
    position_m: Floats  # (N, 3) metres, world; z is 0 until the scene puts plants on its terrain
    radius_m: Floats  # (N,) radius of the ecological neighbourhood
    height_m: Floats  # (N,)
    age_yr: Floats  # (N,)
    status: NDArray[np.uint8]  # (N,) Status
    columns: Mapping[str, NDArray[Any]] = field(default_factory=dict)  # (N,) each, a model's own
    step: int = 0  # of the simulation
    state: Mapping[str, Any] = field(default_factory=dict)  # what a model knows besides its plants, plain as in JSON
    maps: Mapping[str, Floats] = field(default_factory=dict)  # of the ground: (rows, cols), row 0 at y = 0
    modules: Modules | None = None  # of plants that grow by branch modules; None: a model of whole plants

    def __post_init__(self) -> None:
        n = len(self.plant_id)
        for name in ("species", "position_m", "radius_m", "height_m", "age_yr", "status"):
            shape = (n, 3) if name == "position_m" else (n,)
            if getattr(self, name).shape != shape:
                raise ValueError(f"{name} must have shape {shape}, got {getattr(self, name).shape}")
        before = np.concatenate([[0], self.plant_id[:-1].astype(np.int64)])
        unsorted = np.flatnonzero(self.plant_id <= before[:n])
        if len(unsorted):
            row = int(unsorted[0])
            got = f"{self.plant_id[row]} in row {row}" + (f" after {before[row]}" if row else "")
            raise ValueError(f"plant_id must be positive, unique and sorted, got {got}")
        if self.modules is not None and self.modules.plants != n:
            raise ValueError(f"modules must be those of {n} plants, got {self.modules.plants}")

    def __len__(self) -> int:
        return len(self.plant_id)

    @property
    def notes(self) -> tuple[str, ...]:
        """What the model reports to users, such as that not all plants found a place."""
        return tuple(self.state.get("notes", ()))


def count_by_species(population: Population, above_m: float = -math.inf) -> dict[str, int]:
    """Number of living plants of each species that are higher than `above_m`, dominated ones included."""
    counted = population.species[(population.status != Status.DEAD) & (population.height_m > above_m)]
    counts = np.bincount(counted, minlength=len(population.species_names))
    return {name: int(n) for name, n in zip(population.species_names, counts, strict=True)}


def stems_by_species(population: Population) -> dict[str, int]:
    """Number of living plants of each species that are higher than `BREAST_HEIGHT_M`: what a forester counts."""
    return count_by_species(population, BREAST_HEIGHT_M)


def shares(counts: Mapping[str, float]) -> dict[str, float]:
    """Each species' share of a sum, such as that of all plants; zeros where there is nothing to share."""
    total = sum(counts.values())
    return {name: n / total if total else 0.0 for name, n in counts.items()}


def cover_by_species(population: Population, area_m2: float) -> dict[str, float]:
    """Share of the site's area under the circles of each species' living, undominated plants.

    Under the competition model of domination undominated circles never intersect, so these shares are areas of ground
    and their sum stays below 1 on a periodic site. Under others circles overlap, and shared ground counts for each: the
    sum may exceed 1. On a bounded site the part of a circle outside counts too. Dominated plants are left out.
    """
    holds = (population.status != Status.DEAD) & (population.status != Status.DOMINATED)
    circle_m2 = np.pi * population.radius_m[holds] ** 2
    sums = np.bincount(population.species[holds], weights=circle_m2, minlength=len(population.species_names))
    return {name: float(a) / area_m2 for name, a in zip(population.species_names, sums, strict=True)}


def plant_mass(population: Population) -> tuple[Floats, str]:
    """(N,) mass of each plant, and its unit.

    The model's own column ``mass_kg`` where it has one, else r^3 in cubic metres: plants of one shape have masses in
    proportion to the cube of their radius (Lane 2002, section 4.3).
    """
    if "mass_kg" in population.columns:
        return np.asarray(population.columns["mass_kg"], dtype=np.float64), "kg"
    return population.radius_m**3, "m³"
