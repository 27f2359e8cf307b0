"""What community models get and make: the site, how its species live, the plants; and what there is of each species."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.architecture.modules import Modules
from forestgen.core.frames import BREAST_HEIGHT_M
from forestgen.recipe.species import Building, PlantType, Species
from forestgen.recipe.tree_sizes import TreeSizes

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Mask = NDArray[np.bool_]
Indices = NDArray[np.int64]
SpeciesIndex = NDArray[np.uint16]  # of plants: index in the recipe's species
GroundHeight = Callable[[Floats, Floats], Floats]


@dataclass(frozen=True)
class Site:
    """The ground of a community: the rectangle [0, W] x [0, H] in world x and y, metres."""

    size_m: tuple[float, float]
    height: GroundHeight | None = None  # of the ground at x and y of any shape, metres; None: flat
    altitude_m: float = 0.0  # of z = 0 above sea level
    latitude_deg: float = 50.0  # north is positive
    wind_from_deg: float = 270.0  # where the prevailing wind comes from, clockwise from north
    buildings: tuple[Building, ...] = field(default=(), hash=False)

    def __post_init__(self) -> None:
        if len(self.size_m) != 2 or not all(math.isfinite(side) and side > 0 for side in self.size_m):
            raise ValueError(f"size_m must be two positive lengths in metres, got {self.size_m!r}")

    @property
    def area_m2(self) -> float:
        return self.size_m[0] * self.size_m[1]

    @property
    def area_ha(self) -> float:
        return self.area_m2 / 1e4


@dataclass(frozen=True)
class SpeciesEcology:
    """How a species lives, as far as a community model cares; the recipe's section checks the numbers.

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
    modules: PlantType | None = None  # how it grows as a graph of branch modules; None: not at all
    tree: TreeSizes | None = None  # sizes of its trees by their height; None: it is no tree
    leaf_mass_per_area_kg_per_m2: float = 0.08  # dry leaf over one side's area


Ecologies = Sequence[SpeciesEcology]  # the recipe's species, in its order: a species index counts them


def ecology_of(name: str, species: Species) -> SpeciesEcology:
    """The ecology of a recipe's species."""
    law, own = species.allometry.height_m, species.ecology.model_dump()
    return SpeciesEcology(
        name,
        height_scale=law.scale,
        height_exponent=law.exponent,
        modules=species.modules,
        tree=species.tree,
        leaf_mass_per_area_kg_per_m2=species.tissue.leaf_mass_per_area_kg_per_m2,
        **own,
    )


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

    def at(self, rows: Indices | Mask, **changed: Any) -> Population:
        """The plants of some rows, without their modules, with other values of some fields."""
        arrays = {name: value[rows] for name, value in vars(self).items() if isinstance(value, np.ndarray)}
        columns = {name: value[rows] for name, value in self.columns.items()}
        return replace(self, **{**arrays, "columns": columns, "modules": None, **changed})

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
