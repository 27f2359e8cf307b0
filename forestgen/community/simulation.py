"""Recipe -> population, and a summary of it; communities are kept on disk, by the hash of all that they depend on.

A simulation is a function of the model, its parameters, the site with its ground, how each species lives, the seed, and
the code. Images of one stand, cameras added later, a batch that is done again: they take the community from the folder
`communities` of the cache (core/cache.py). What comes from disk is what would be simulated, to the last bit. What
takes less time to simulate than `WORTHWHILE_S` is not kept.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any, TypeVar

import numpy as np
from pydantic import BaseModel

from forestgen.architecture.modules import Modules
from forestgen.community.model import simulate
from forestgen.community.plan import CommunityPlan
from forestgen.community.population import Population, Status
from forestgen.core.array_serialization import UnreadableError, pack, unpack
from forestgen.core.cache import DiskCache, cache_root, code_hash
from forestgen.core.progress import Progress
from forestgen.recipe.assets import scenes_dir

WORTHWHILE_S = 0.5
MOST_BYTES = 2_000_000_000
_SOURCES = ("architecture", "atmosphere", "community", "core", "geometry", "lsystem", "recipe", "scene")
_COMPUTE_WITH = ("numpy", "scipy", "numba", "pillow", "OpenEXR")

Kept = TypeVar("Kept")


class _UnknownError(TypeError):
    """A value whose content cannot be hashed."""


def snapshots(plan: CommunityPlan, progress: Progress, start: Population | None = None) -> Iterator[Population]:
    """The community at step 0, 1, ..., as the recipe asks; or from `start` on, a snapshot of the same simulation."""
    seed, first = plan.drawn.image_seed, 0 if start is None else start.step
    with progress.stage("community", plan.steps + 1 - first) as advance:
        history = simulate(plan.model, plan.parameters, plan.site, plan.ecologies, seed, steps=plan.steps, start=start)
        for population in history:
            advance(1)
            yield population


def final_population(plan: CommunityPlan, progress: Progress) -> Population:
    """The community at the recipe's last step, from the cache if it was simulated before."""
    store = community_store()
    key = None if store is None else community_key(plan)
    kept = None if store is None or key is None else load_community(store, key)
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
    try:
        content = (
            type(plan.model).__module__,
            type(plan.model).__qualname__,
            _content(plan.parameters),
            _content(plan.site),
            _content(plan.ecologies),
            plan.steps,
            plan.drawn.image_seed,
        )
    except _UnknownError:
        return None
    return hashlib.blake2b(repr((simulation_code(), content)).encode(), digest_size=20).hexdigest()


def simulation_code() -> str:
    """Hash, hexadecimal, of the code and tables that a simulated community depends on."""
    return code_hash(_SOURCES, _COMPUTE_WITH, (scenes_dir() / "modules", scenes_dir() / "climate"))


def load_community(store: DiskCache, key: str) -> Population | None:
    """The community from disk, None if it is not there or unreadable, which removes it."""
    data = store.read(key)
    if data is None:
        return None
    try:
        found = unpack(data, (Population, Modules))
    except UnreadableError:
        found = None
    if isinstance(found, Population):
        return found
    store.drop(key)
    return None


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
        return np.ascontiguousarray(one)
    if isinstance(one, Mapping):
        return {name: as_kept(value) for name, value in one.items()}  # type: ignore[return-value]
    if isinstance(one, Population | Modules):
        return replace(one, **{field.name: as_kept(getattr(one, field.name)) for field in fields(one)})
    return one


def _content(value: Any) -> Any:
    """Plain and complete, for a hash: arrays and maps by their content.

    Raises
    ------
    _UnknownError : it is, or holds, something without a content to hash, such as a function or a file without a hash.
    """
    if isinstance(value, BaseModel):
        return _content_of_section(value)
    if is_dataclass(value) and not isinstance(value, type):
        content = [(field.name, _content(getattr(value, field.name))) for field in fields(value)]
        return type(value).__qualname__, *content
    if isinstance(value, np.ndarray):
        digest = hashlib.blake2b(np.ascontiguousarray(value).tobytes(), digest_size=20).hexdigest()
        return value.dtype.str, value.shape, digest
    if isinstance(value, Mapping):
        return "mapping", *((_content(key), _content(one)) for key, one in value.items())  # its order may count
    if isinstance(value, list | tuple):
        return "list", *(_content(one) for one in value)
    if value is None or isinstance(value, bool | int | float | str):
        return repr(value)
    raise _UnknownError(type(value).__name__)


def _content_of_section(section: BaseModel) -> Any:
    """A section's keys. A map's file is excluded from what is dumped, for its SHA-256 identifies it."""
    content = {}
    for name, field in type(section).model_fields.items():
        value = getattr(section, name)
        if field.exclude and value is not None and getattr(section, "sha256", None) is None:
            raise _UnknownError(name)
        if not field.exclude:
            content[name] = value
    return type(section).__qualname__, _content({**content, **(section.model_extra or {})})


def counts_of(population: Population) -> dict[str, int]:
    """Plants by species, the dead included."""
    return {name: int((population.species == index).sum()) for index, name in enumerate(population.species_names)}


def standing_dead(population: Population) -> int:
    """How many plants are dead."""
    return int((population.status == Status.DEAD).sum())


def lifeless_note(plan: CommunityPlan, plants: Population) -> str | None:
    """What people should know of a stand in which nothing lives; None: something does."""
    if not len(plants):
        return plan.empty_reason or f"no plant lives on the site at step {plan.steps}"
    if standing_dead(plants) == len(plants):
        return f"all plants at step {plan.steps} are standing dead trees: none lives"
    return None
