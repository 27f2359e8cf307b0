"""The state of a simulation: its plants, their modules, and everything else that the future depends on."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from forestgen.architecture.modules import Modules
from forestgen.architecture.plant_type import PlantType
from forestgen.architecture.prototype import Prototype
from forestgen.community.arrivals import Rows
from forestgen.community.branch_modules.parameters import BranchModulesParameters
from forestgen.community.ecology import SpeciesEcology
from forestgen.community.model import Site
from forestgen.core.errors import ResourceError

MOST_SEEDS = 20_000_000  # of one step: a gigabyte


@dataclass(frozen=True)
class Plants(Rows):
    """One row a plant, in order of plant_id; an obstacle is a row without modules."""

    plant_id: NDArray[np.uint32]  # (P,)
    species: NDArray[np.uint16]  # (P,) index of species
    position_m: NDArray[np.float64]  # (P, 2) metres, world x and y
    ground_m: NDArray[np.float64]  # (P,) height of the ground at the foot, metres, world
    born: NDArray[np.int32]  # (P,) step of arrival
    flowering: NDArray[np.bool_]  # (P,)
    next_number: NDArray[np.uint32]  # (P,) of the next module
    adaptation: NDArray[np.float32]  # (P,) o of Eq. 13 as felt in the last step; 1 before the first, and of obstacles
    tallest_m: NDArray[np.float32]  # (P,) greatest height so far, where the recipe has a dieback_share; else 0


@dataclass(frozen=True)
class Snags:
    """Standing dead trees, one row a tree: what they were when they died."""

    plants: Plants
    modules: Modules
    died: NDArray[np.int32]  # (P,) step of death

    def where(self, keep: NDArray[np.bool_]) -> Snags:
        if keep.all():
            return self
        return Snags(self.plants.where(keep), rows_of_plants(self.modules, keep), self.died[keep])


@dataclass(frozen=True)
class State:
    """Everything that the future of a simulation depends on."""

    parameters: BranchModulesParameters  # as the recipe gives them, before any change
    site: Site
    species: tuple[SpeciesEcology, ...]
    seed: int
    step: int
    next_id: int  # the id of the next plant to arrive
    prototypes: tuple[Prototype, ...]
    plants: Plants  # those that live
    modules: Modules
    snags: Snags
    notes: tuple[str, ...] = ()  # for people, as that not all plants found a place

    @property
    def types(self) -> dict[str, PlantType]:
        """The plant types at the start, by the names of the species that grow."""
        return {one.name: one.modules for one in self.species if one.modules is not None}


def rows_of_plants(modules: Modules, keep: NDArray[np.bool_]) -> Modules:
    """The modules of those plants that are kept, (P,) each."""
    counts = np.diff(modules.first)
    rows = np.repeat(keep, counts)
    first = np.concatenate([[0], np.cumsum(counts[keep])]).astype(np.int64)
    columns = {name: values[rows] for name, values in vars(modules).items() if name != "first"}
    return Modules(first=first, **columns)


def reordered(modules: Modules, plant: NDArray[np.int64]) -> Modules:
    """The modules of plants in another order: `plant` (Q,) is the row of each."""
    counts = np.diff(modules.first)[plant]
    first = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    rows = np.arange(first[-1]) + np.repeat(modules.first[plant] - first[:-1], counts)
    columns = {name: values[rows] for name, values in vars(modules).items() if name != "first"}
    return Modules(first=first, **columns)


def appended(modules: Modules, others: Modules) -> Modules:
    """The modules of plants and of further plants behind them."""
    first = np.concatenate([modules.first, modules.first[-1] + others.first[1:]])
    columns = {
        name: np.concatenate([values, getattr(others, name)])
        for name, values in vars(modules).items()
        if name != "first"
    }
    return Modules(first=first, **columns)


def seedling_modules(prototype: NDArray[np.uint8], rotation: NDArray[np.float32]) -> Modules:
    """The root modules of plants that begin; (P,) and (P, 4)."""
    n = len(prototype)
    zeros = np.zeros(n, dtype=np.float32)
    return Modules(
        first=np.arange(n + 1, dtype=np.int64),
        number=np.zeros(n, dtype=np.uint32),
        parent=np.full(n, -1, dtype=np.int32),
        node=np.full(n, -1, dtype=np.int16),
        prototype=prototype,
        age=zeros,
        age_yr=zeros,
        base_m=np.zeros((n, 3), dtype=np.float32),
        rotation=rotation,
        vigour=zeros,
        light=zeros,
        disused_m2=zeros,
    )


def without_modules(modules: Modules, plants: int) -> Modules:
    """The same with so many plants that have no module behind."""
    return replace(modules, first=np.concatenate([modules.first, np.full(plants, modules.first[-1])]))


def no_modules() -> Modules:
    """Of no plant at all."""
    return seedling_modules(np.zeros(0, dtype=np.uint8), np.zeros((0, 4), dtype=np.float32))


def no_snags(plants: Plants) -> Snags:
    """None, with the columns of any plants."""
    return Snags(plants.where(np.zeros(len(plants), dtype=np.bool_)), no_modules(), np.zeros(0, dtype=np.int32))


def refuse_more_modules(modules: int, most: int) -> None:
    """Raise `ResourceError` for more modules than `community.most_modules`."""
    if modules > most:
        raise ResourceError(
            "the community has too many branch modules",
            where="community.most_modules",
            expected=f"at most {most:,}",
            got=f"{modules:,}",
            hint="make the site smaller, or raise most_modules",
        )


def refuse_more_seeds(seeds: float, where: str = "community.step_yr") -> None:
    """Raise `ResourceError` for more seeds in a step than can be drawn; `where` is the key that asks for them."""
    if seeds > MOST_SEEDS:
        raise ResourceError(
            "more seeds would fall in one step than can be drawn",
            where=where,
            expected=f"at most {MOST_SEEDS:,}",
            got=f"about {seeds:,.0f}",
            hint="lower species' modules.seeds_per_yr, or seeds_per_ha of global_seeding; make steps shorter, or the "
            "site smaller",
        )
