"""Several exemplars at once: from disk where they are kept, otherwise grown, on all cores.

Threads, not processes: most of the time goes to NumPy and to compiled loops, which release Python's lock, and a process
would first spend seconds on imports. What grows depends on the requests alone, never on the number of threads.

On disk an exemplar is kept by the hash of all that it depends on: `ExemplarRequest.key`, with the code that grows it,
so that a change of a generator never shows an old plant. What comes from disk is what would be grown, to the last bit.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import astuple, dataclass
from typing import Any

from forestgen.core.array_serialization import pack, read_packed
from forestgen.core.cache import BoundedCache, DiskCache, cache_root, code_hash
from forestgen.core.dead_wood import DeadTree
from forestgen.core.parts import Part
from forestgen.core.randomness import child_rng, child_seed
from forestgen.core.threads import cores
from forestgen.geometry.mesh import Mesh
from forestgen.plants.build import build_exemplar, size_m
from forestgen.plants.dead_exemplar import build_dead
from forestgen.plants.exemplar import Exemplar, OrganMesh
from forestgen.plants.grown import ModuleWood, wood_key
from forestgen.plants.registry import GENERATORS, clothes_modules
from forestgen.plants.skeleton import OrganPlacements, Twigs
from forestgen.plants.tree_size import TreeSize
from forestgen.recipe.assets import scenes_dir
from forestgen.recipe.phenology import SUMMER, LeafState
from forestgen.recipe.species import Species

SHARED_BYTES = 400_000_000  # of shared exemplars in memory, at most
MOST_BYTES = 4_000_000_000  # on disk
LIBRARY_BYTES = 12_000_000_000  # where images share a library: a thousand plants and more
_SOURCES = ("architecture", "core", "geometry", "lsystem", "plants", "recipe")  # layers whose code shapes a plant
_COMPUTE_WITH = ("numpy", "numba", "scipy", "pymeshlab")
_shared: BoundedCache[Exemplar] = BoundedCache(SHARED_BYTES, lambda exemplar: exemplar.nbytes)


@dataclass(frozen=True)
class ExemplarRequest:
    """A plant to grow, complete: the same request gives the same plant."""

    species_name: str
    species: Species
    parameters: Any  # of the generator
    radius_m: float  # community radius
    seed: int  # root seed
    identity: tuple[str | int, ...]  # of its randomness, see `core.randomness.child_rng`
    pixel_m: float = 0.0  # what a pixel covers of the plant where it is seen closest, metres; 0: all detail
    wood: ModuleWood | None = None  # branches that its community grew; None: the generator grows it by the radius
    tree: TreeSize | None = None  # its sizes; None: height and width by the radius
    leaves: LeafState = SUMMER  # that it has; their colour is its materials'
    dead: DeadTree | None = None  # what is left of the tree, whose sizes are those of when it lived; None: it lives
    is_kept: bool = True  # on disk: other runs may ask for the same
    is_shared: bool = False  # in memory: this process' next images may ask for the same

    @property
    def grows_alone(self) -> bool:
        """Whether its branches grow by the species' modules, without a community."""
        return self.wood is None and clothes_modules(self.parameters.generator)

    def key(self) -> str:
        """Hash of everything that the exemplar depends on, hexadecimal."""
        height, width = self.species.allometry.height_m, self.species.allometry.width_m
        content: dict[str, Any] = {
            "species": self.species_name,
            "parameters": self.parameters.model_dump(mode="json", serialize_as_any=True),
            "generator": f"{type(self.parameters).__module__}.{type(self.parameters).__qualname__}",
            "allometry": [repr(float(x)) for x in (height.scale, height.exponent, width.scale, width.exponent)],
            "materials": sorted(self.species.materials),
            "radius_m": repr(float(self.radius_m)),
            "seed": [int(self.seed), *self.identity],
            "level": {"pixel_m": self.pixel_m},
            "wood": None if self.wood is None else wood_key(self.wood),
            "tree": None if self.tree is None else [repr(one) for one in astuple(self.tree)],
            "dead": None if self.dead is None else [int(self.dead.form), self.dead.decay],
            "leaves": [self.leaves.share, self.leaves.size, self.leaves.flowers],
            "code": code_hash(_SOURCES, _COMPUTE_WITH),
        }
        if self.grows_alone:
            content["modules"] = self.species.modules and self.species.modules.model_dump(mode="json")
            content["growth"] = code_hash(("community",), _COMPUTE_WITH, (scenes_dir() / "modules",))
        text = json.dumps(content, sort_keys=True, separators=(",", ":"))
        return hashlib.blake2b(text.encode(), digest_size=20).hexdigest()


def exemplar_store(most_bytes: int = MOST_BYTES) -> DiskCache | None:
    """Where exemplars are kept; None if there is no place for them."""
    root = cache_root()
    return None if root is None else DiskCache(root / "exemplars", most_bytes)


def load_exemplar(store: DiskCache, request: ExemplarRequest) -> Exemplar | None:
    """The exemplar from disk, None if it is not there or unreadable, which removes it."""
    classes = (Exemplar, OrganMesh, Mesh, Part, OrganPlacements, Twigs)
    found: Exemplar | None = read_packed(store, request.key(), classes)
    return found


def forget_shared() -> None:
    """Keep no exemplar in memory any longer."""
    _shared.clear()


def grow_exemplar(request: ExemplarRequest) -> Exemplar:
    """The plant of a request, grown and meshed."""
    name, species, plant, wood = request.species_name, request.species, request.parameters, request.wood
    if request.grows_alone:
        tree, seed = request.tree, child_seed(request.seed, *request.identity, "wood")
        size = size_m(species, request.radius_m) if tree is None else (tree.height_m, tree.crown_width_m)
        wood = GENERATORS.load(plant.generator).wood_alone(name, species, size, seed)
        plant = plant.model_copy(update={"fit": "scale_all"})  # leaves reach beyond the wood
    rng = child_rng(request.seed, *request.identity)
    if request.dead is not None and request.tree is not None:
        own: dict[str, Any] = {"radius_m": request.radius_m, "pixel_m": request.pixel_m, "wood": wood}
        return build_dead(name, species, plant, request.dead, request.tree, rng, **own)
    how: dict[str, Any] = {"pixel_m": request.pixel_m, "wood": wood, "leaves": request.leaves, "tree": request.tree}
    return build_exemplar(name, species, plant, request.radius_m, rng, **how)


def grow_exemplars(
    requests: Sequence[ExemplarRequest],
    *,
    store: DiskCache | None = None,
    workers: int | None = None,
    advance: Callable[[int], None] = lambda done: None,
) -> tuple[Exemplar, ...]:
    """All exemplars, in the order of the requests.

    `store`: where exemplars are kept from run to run; None: nowhere. `workers`: threads; None: as many as there are
    cores. `advance` is called, in the calling thread, with how many more are done.

    Raises `RecipeError`: a plant that cannot be grown: of several, the one that is asked for first.
    """
    threads = max(1, min(workers or cores(), len(requests)))
    written: list[bool] = []  # whether each exemplar that grew is on disk now

    def made(request: ExemplarRequest) -> Exemplar:
        own = store if request.is_kept else None
        found = load_exemplar(own, request) if own is not None else None
        if found is not None:
            return found
        grown = grow_exemplar(request)
        written.append(own is not None and own.write(request.key(), pack(grown)))
        return grown

    def one(request: ExemplarRequest) -> Exemplar:
        return _shared.get(request.key(), lambda: made(request)) if request.is_shared else made(request)

    results = []
    with ThreadPoolExecutor(threads) as pool:
        futures = [pool.submit(one, request) for request in requests]
        try:
            for future in futures:
                results.append(future.result())
                advance(1)
        except BaseException:  # Ctrl-C too: only the plants that are being grown are waited for
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    if store is not None and any(written):
        store.trim()
    return tuple(results)
