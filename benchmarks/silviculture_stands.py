"""Stands of branch modules for benchmarks/silviculture.py: recipes by figure, grown, with what their plants measure."""

from __future__ import annotations

import json
import tempfile
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.community.population import Population, Site, Status
from forestgen.community.simulation import snapshots
from forestgen.core.progress import Silent
from forestgen.recipe.load import load_recipe
from forestgen.scene.plan import check_plan

WOOD_KG_PER_M3 = 500.0  # homogeneous, as the paper assumes
LEAF_KG_PER_M2 = 0.2  # dry mass of foliage over its area


class Report:
    """What was found, line by line, and how many bounds were missed."""

    def __init__(self) -> None:
        self.missed = 0

    def check(self, name: str, value: str, held: bool, bound: str) -> None:
        self.missed += not held
        print(f"  {'kept  ' if held else 'MISSED'} {name:<46} {value:>24}   {bound}", flush=True)

    def line(self, text: str) -> None:
        print(f"  {text}", flush=True)


@dataclass(frozen=True)
class Plants:
    """The living plants of one moment."""

    time_yr: float
    plant_id: NDArray[np.uint32]  # (N,)
    species: NDArray[np.int64]  # (N,) index of the course's names
    position_m: NDArray[np.float64]  # (N, 3)
    age_yr: NDArray[np.float64]  # (N,)
    height_m: NDArray[np.float64]  # (N,)
    diameter_m: NDArray[np.float64]  # (N,) of the trunk at 1.3 m, of lower plants at the foot
    foot_m: NDArray[np.float64]  # (N,) diameter at the foot
    wood_kg: NDArray[np.float64]  # (N,)
    leaf_kg: NDArray[np.float64]  # (N,)
    modules: NDArray[np.int64]  # (N,)

    def __len__(self) -> int:
        return len(self.species)


@dataclass(frozen=True)
class Course:
    """A stand from step 0 to its last."""

    names: tuple[str, ...]
    site: Site
    moments: tuple[Plants, ...]
    seconds: float

    @cached_property
    def time_yr(self) -> NDArray[np.float64]:
        return np.array([one.time_yr for one in self.moments])

    def sums(self, name: str) -> NDArray[np.float64]:
        """(T, S) sum of a measure over the plants of each species."""
        return np.array(
            [np.bincount(m.species, weights=getattr(m, name), minlength=len(self.names)) for m in self.moments]
        )

    def counts(self) -> NDArray[np.int64]:
        """(T, S) living plants."""
        return np.array([np.bincount(m.species, minlength=len(self.names)) for m in self.moments])

    def at(self, year: float) -> Plants:
        """The moment nearest to a year."""
        return self.moments[int(np.argmin(np.abs(self.time_yr - year)))]


def plants_of(population: Population) -> Plants:
    """What the figures need of a snapshot; its modules are let go."""
    alive = population.status != Status.DEAD
    column = population.columns
    return Plants(
        time_yr=population.time_yr,
        plant_id=population.plant_id[alive],
        species=population.species[alive].astype(np.int64),
        position_m=population.position_m[alive],
        age_yr=population.age_yr[alive],
        height_m=population.height_m[alive],
        diameter_m=np.asarray(column["trunk_diameter_m"][alive], dtype=np.float64),
        foot_m=np.asarray(column["foot_diameter_m"][alive], dtype=np.float64),
        wood_kg=WOOD_KG_PER_M3 * np.asarray(column["wood_volume_m3"][alive], dtype=np.float64),
        leaf_kg=LEAF_KG_PER_M2 * np.asarray(column["leaf_area_m2"][alive], dtype=np.float64),
        modules=np.asarray(column["modules"][alive], dtype=np.int64),
    )


def grow_recipe(path: Path, settings: list[str], *, every: int = 1) -> Course:
    """The stand of a recipe with some keys overridden; every so-manieth snapshot is kept, and the last."""
    start = perf_counter()
    plan = check_plan(load_recipe(path, settings), simulate_only=True)
    kept: list[Plants] = []
    names: tuple[str, ...] = ()
    for population in snapshots(plan.community, Silent()):
        names = population.species_names
        if population.step % every == 0 or population.step == plan.community.steps:
            kept.append(plants_of(population))
    return Course(names, plan.community.site, tuple(kept), perf_counter() - start)


def grow(
    types: dict[str, dict[str, Any]],
    community: dict[str, Any],
    size_m: tuple[float, float],
    *,
    seed: int = 1,
    terrain: dict[str, Any] | None = None,
    every: int = 1,
) -> Course:
    """A stand of plant types given here.

    Parameters
    ----------
    types : keys of the `modules` section by species name; a species' geometry plays no part, all are pines.
    community : keys of the model.
    """
    site: dict[str, Any] = {"size_m": list(size_m)}
    if terrain is not None:
        site["terrain"] = terrain
    recipe = {
        "forestgen": 1,
        "seed": seed,
        "site": site,
        "species": {name: {"from": "pine", "modules": keys} for name, keys in types.items()},
        "community": {"model": "branch_modules", **community},
        "cameras": [{"position_m": [0, -10, 2]}],
    }
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "stand.yaml"
        path.write_text(json.dumps(recipe), encoding="utf-8")  # JSON is YAML
        return grow_recipe(path, [], every=every)


def only(plants: Plants, pick: NDArray[np.bool_]) -> Plants:
    """Some of the plants."""
    names = [name for name in Plants.__dataclass_fields__ if name != "time_yr"]
    return replace(plants, **{name: getattr(plants, name)[pick] for name in names})
