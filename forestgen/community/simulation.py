"""Recipe -> plan -> population; communities are kept on disk, by the hash of all that they depend on.

A simulation is a function of the model, its parameters, the site with its ground, how each species lives, the seed, and
the code. Images of one stand, cameras added later, a batch that is done again: they take the community from the folder
`communities` of the cache (core/cache.py). What comes from disk is what would be simulated, to the last bit. What
takes less time to simulate than `WORTHWHILE_S` is not kept.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any, TypeVar

import numpy as np
from pydantic import BaseModel

from forestgen.architecture.modules import Modules
from forestgen.community.model import CommunityParameters, simulate
from forestgen.community.population import Population, Site, SpeciesEcology, Status, ecology_of
from forestgen.community.tree_columns import with_tree_sizes
from forestgen.core.array_serialization import pack, read_packed
from forestgen.core.cache import DiskCache, cache_root, code_hash
from forestgen.core.errors import RecipeError, ResourceError
from forestgen.core.progress import Progress
from forestgen.recipe.assets import scenes_dir
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.species import Building

WORTHWHILE_S = 0.5
MOST_BYTES = 2_000_000_000
_SOURCES = ("architecture", "atmosphere", "community", "core", "geometry", "lsystem", "recipe", "scene")
_COMPUTE_WITH = ("numpy", "scipy", "numba", "pillow", "OpenEXR")

Kept = TypeVar("Kept")


@dataclass(frozen=True)
class Obstacles:
    """The buildings of a site, where its community knows of them."""

    entries: tuple[Building, ...] = ()  # a population has them in its first rows by plant_id, in this order

    @property
    def counts(self) -> dict[str, int]:
        """How many there are of each kind."""
        kinds = [one.kind for one in self.entries]
        return {kind: kinds.count(kind) for kind in dict.fromkeys(kinds)}

    def ecologies(self) -> list[SpeciesEcology]:
        """What stands for each kind among the species of a community: it neither grows nor spreads."""
        return [SpeciesEcology(kind, 0.0, 1.0, 1.0, 1.0, 0.0, 1.0, 1.0, 0.0) for kind in self.counts]

    def rows_of(self, population: Population) -> dict[int, Building]:
        """Row of the population -> the building that stands there."""
        rows = np.searchsorted(population.plant_id, np.arange(1, len(self.entries) + 1))
        return {int(row): one for row, one in zip(rows, self.entries, strict=True)}

    def left_out_of(self, population: Population) -> Population:
        """The plants of a snapshot: no row is a building, and no species' name; modules are left out, too."""
        if not self.entries:
            return population
        names = population.species_names
        stays = np.array([name not in self.counts for name in names], dtype=np.bool_)
        number = np.cumsum(stays) - 1  # of each species among those that stay
        rows = stays[population.species]
        arrays = ("plant_id", "position_m", "radius_m", "height_m", "age_yr", "status")
        return replace(
            population,
            species_names=tuple(name for name in names if name not in self.counts),
            species=number[population.species[rows]].astype(np.uint16),
            columns={name: values[rows] for name, values in population.columns.items()},
            modules=None,
            **{name: getattr(population, name)[rows] for name in arrays},
        )

    def turned(self, population: Population) -> Population:
        """The population with buildings' azimuths in the column `azimuth_deg`, which the scene places plants by."""
        if not self.entries:
            return population
        azimuth_deg = population.columns.get("azimuth_deg", np.full(len(population), np.nan)).astype(np.float64)
        for row, one in self.rows_of(population).items():
            azimuth_deg[row] = one.azimuth_deg
        return replace(population, columns={**population.columns, "azimuth_deg": azimuth_deg})


NO_OBSTACLES = Obstacles()


@dataclass(frozen=True)
class CommunityPlan:
    """A community model with its parameters, its site and its species."""

    drawn: DrawnRecipe
    model: Any  # a CommunityModel
    parameters: CommunityParameters
    site: Site
    ecologies: list[SpeciesEcology]  # of the species, then of kinds of buildings, which do not grow
    obstacles: Obstacles

    @classmethod
    def of(cls, drawn: DrawnRecipe, model: Any, parameters: CommunityParameters, site: Site) -> CommunityPlan:
        """The plan of a drawn recipe."""
        obstacles = Obstacles(site.buildings)
        ecologies = [ecology_of(name, species) for name, species in drawn.species.items()]
        return cls(drawn, model, parameters, site, ecologies + obstacles.ecologies(), obstacles)

    @property
    def steps(self) -> int:
        return self.parameters.steps

    def with_tree_sizes(self, population: Population) -> Population:
        """A snapshot with the columns of `tree_columns`."""
        seed, periodic = self.drawn.image_seed, self.parameters.periodic
        return with_tree_sizes(population, self.ecologies, self.site, seed, periodic=periodic)

    @property
    def empty_reason(self) -> str | None:
        """Why no plant can ever grow; None if some may. An empty site is no error."""
        reason: str | None = self.model.empty_reason(self.parameters, self.site, self.ecologies)
        return reason


def located(cause: RecipeError | ResourceError, drawn: DrawnRecipe) -> RecipeError | ResourceError:
    """A model's error with the file and line of the key that it names: models know keys only."""
    key, comma, line = (cause.where or "").partition(",")  # the line of a table in the recipe
    keys = tuple(int(one) if one.isdigit() else one for one in key.split("."))
    return cause.at(drawn.where(*keys) + comma + line) if keys[0] == "community" else cause


def snapshots(plan: CommunityPlan, progress: Progress, start: Population | None = None) -> Iterator[Population]:
    """The community at step 0, 1, ..., as the recipe asks; or from `start` on, a snapshot of the same simulation."""
    seed, first = plan.drawn.image_seed, 0 if start is None else start.step
    with progress.stage("community", plan.steps + 1 - first) as advance:
        history = simulate(plan.model, plan.parameters, plan.site, plan.ecologies, seed, steps=plan.steps, start=start)
        try:
            for population in history:
                advance(1)
                yield population
        except (RecipeError, ResourceError) as cause:
            raise located(cause, plan.drawn) from cause


def final_population(plan: CommunityPlan, progress: Progress) -> Population:
    """The community at the recipe's last step, from the cache if it was simulated before."""
    store = community_store()
    key = None if store is None else community_key(plan)
    if store is not None and key is not None:
        kept: Population | None = read_packed(store, key, (Population, Modules))
        if kept is not None:
            return kept
    began = time.monotonic()
    last: Population | None = None
    for population in snapshots(plan, progress):
        last = population
    assert last is not None  # step 0 is always there
    last = as_kept(last)
    if store is not None and key is not None and time.monotonic() - began >= WORTHWHILE_S:
        keep_community(store, key, last)
    return last


def community_store() -> DiskCache | None:
    """Where communities are kept; None if there is no place for them."""
    root = cache_root()
    return None if root is None else DiskCache(root / "communities", MOST_BYTES)


def community_key(plan: CommunityPlan) -> str | None:
    """Hash of everything that the community at the recipe's last step depends on; None if that cannot be hashed."""
    about = (plan.parameters, plan.site, plan.ecologies, plan.steps, plan.drawn.image_seed)
    try:
        content = pack(_plain((type(plan.model).__module__, type(plan.model).__qualname__, *about)))
    except TypeError:
        return None
    return hashlib.blake2b(simulation_code().encode() + content, digest_size=20).hexdigest()


def simulation_code() -> str:
    """Hash, hexadecimal, of the code and tables that a simulated community depends on."""
    return code_hash(_SOURCES, _COMPUTE_WITH, (scenes_dir() / "modules", scenes_dir() / "climate"))


def keep_community(store: DiskCache, key: str, population: Population) -> bool:
    """Write the community to disk; False if that is not possible."""
    try:
        data = pack(population)
    except TypeError:  # a model's own state of a kind that no bytes stand for
        return False
    kept = store.write(key, data)
    store.trim()
    return kept


def as_kept(one: Kept) -> Kept:
    """The same with its arrays laid out as they would come from disk: sums may depend on it."""
    if isinstance(one, np.ndarray):
        return np.ascontiguousarray(one)  # type: ignore[return-value]
    if isinstance(one, Mapping):
        return {name: as_kept(value) for name, value in one.items()}  # type: ignore[return-value]
    if isinstance(one, Population | Modules):
        return replace(one, **{field.name: as_kept(getattr(one, field.name)) for field in fields(one)})
    return one


def _plain(value: Any) -> Any:
    """What `pack` knows, complete, for a hash: sections as their keys, mappings as pairs, whose order may count.

    It, or `pack`, raises `TypeError` for what holds something without a content to hash, such as a function or a file
    without a hash.
    """
    if isinstance(value, BaseModel):
        return type(value).__qualname__, _plain({**_keys_of(value), **(value.model_extra or {})})
    if is_dataclass(value) and not isinstance(value, type):
        return type(value).__qualname__, [(one.name, _plain(getattr(value, one.name))) for one in fields(value)]
    if isinstance(value, Mapping):
        return "mapping", [(_plain(key), _plain(one)) for key, one in value.items()]
    return [_plain(one) for one in value] if isinstance(value, list | tuple) else value


def _keys_of(section: BaseModel) -> dict[str, Any]:
    """A section's keys. A map's file is excluded from what is dumped, for its SHA-256 identifies it."""
    left_out = [name for name, field in type(section).model_fields.items() if field.exclude]
    if getattr(section, "sha256", None) is None and any(getattr(section, name) is not None for name in left_out):
        raise TypeError(f"{', '.join(left_out)} without a hash")
    return {name: getattr(section, name) for name in type(section).model_fields if name not in left_out}


def counts_of(population: Population) -> dict[str, int]:
    """Plants by species, the dead included."""
    return {name: int((population.species == index).sum()) for index, name in enumerate(population.species_names)}


def dead_plants(population: Population) -> int:
    """How many plants are dead."""
    return int((population.status == Status.DEAD).sum())


def lifeless_note(plan: CommunityPlan, plants: Population) -> str | None:
    """What people should know of a stand in which nothing lives; None: something does."""
    if not len(plants):
        return plan.empty_reason or f"no plant lives on the site at step {plan.steps}"
    if dead_plants(plants) == len(plants):
        return f"all plants at step {plan.steps} are dead trees: none lives"
    return None
