"""Exemplars kept on disk, by the hash of all that they depend on.

An exemplar depends on the generator's parameters, the allometry, the names of the materials, the radius, the level of
detail and the seed; and on the code that grows it, whose hash counts too, so that a change of a generator never shows
an old plant. What comes from disk is the same as what would be grown, to the last bit.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from typing import Any

from forestgen.core.cache import DiskCache, cache_root, code_hash
from forestgen.core.packed import UnreadableError, pack, unpack
from forestgen.core.parts import Part
from forestgen.geometry.mesh import Mesh
from forestgen.plants.exemplar import Exemplar, OrganMesh
from forestgen.plants.grown.wood import ModuleWood, wood_key
from forestgen.plants.levels import FULL, Level
from forestgen.plants.registry import clothes_modules
from forestgen.recipe.assets import scenes_dir
from forestgen.recipe.species import Species

MOST_BYTES = 4_000_000_000
LIBRARY_BYTES = 12_000_000_000  # where images share a library: a thousand plants and more
_SOURCES = ("architecture", "core", "geometry", "lsystem", "plants", "recipe")  # layers whose code shapes a plant
_COMPUTE_WITH = ("numpy", "numba", "scipy", "pymeshlab")
_CLASSES = (Exemplar, OrganMesh, Mesh, Part)


@dataclass(frozen=True)
class ExemplarRequest:
    """A plant to grow, complete: the same request gives the same plant."""

    species_name: str
    species: Species
    parameters: Any  # of the generator
    radius_m: float  # community radius
    seed: int  # root seed
    identity: tuple[str | int, ...]  # of its randomness, see `core.randomness.child_rng`
    level: Level = FULL
    wood: ModuleWood | None = None  # branches that its community grew; None: the generator grows it by the radius
    box_m: tuple[float, float, float] | None = None  # width, depth, height of what is built, as a house
    is_kept: bool = True  # on disk: other runs may ask for the same
    is_shared: bool = False  # in memory: this process' next images may ask for the same

    @property
    def grows_alone(self) -> bool:
        """Whether its branches grow by the species' modules, without a community."""
        return self.wood is None and self.box_m is None and clothes_modules(self.parameters.generator)

    def key(self) -> str:
        """Hash of everything that the exemplar depends on, hexadecimal."""
        height, width = self.species.allometry.height_m, self.species.allometry.width_m
        content = {
            "species": self.species_name,
            "parameters": self.parameters.model_dump(mode="json", serialize_as_any=True),
            "generator": f"{type(self.parameters).__module__}.{type(self.parameters).__qualname__}",
            "allometry": [repr(float(x)) for x in (height.scale, height.exponent, width.scale, width.exponent)],
            "materials": sorted(self.species.materials),
            "radius_m": repr(float(self.radius_m)),
            "seed": [int(self.seed), *self.identity],
            "level": asdict(self.level),
            **({} if self.wood is None else {"wood": wood_key(self.wood)}),
            **(_modules_key(self.species) if self.grows_alone else {}),
            **({} if self.box_m is None else {"box_m": [repr(float(side)) for side in self.box_m]}),
            "code": _code_hash(),
        }
        text = json.dumps(content, sort_keys=True, separators=(",", ":"))
        return hashlib.blake2b(text.encode(), digest_size=20).hexdigest()


def _modules_key(species: Species) -> dict[str, Any]:
    """What branches that grow alone depend on besides."""
    code = code_hash(("community",), _COMPUTE_WITH, (scenes_dir() / "modules",))
    return {"modules": species.modules and species.modules.model_dump(mode="json"), "growth": code}


def _code_hash() -> str:
    return code_hash(_SOURCES, _COMPUTE_WITH)


def exemplar_store(most_bytes: int = MOST_BYTES) -> DiskCache | None:
    """Where exemplars are kept; None if there is no place for them."""
    root = cache_root()
    return None if root is None else DiskCache(root / "exemplars", most_bytes)


def load_exemplar(store: DiskCache, request: ExemplarRequest) -> Exemplar | None:
    """The exemplar from disk, None if it is not there or unreadable, which removes it."""
    key = request.key()
    data = store.read(key)
    if data is None:
        return None
    try:
        found = unpack(data, _CLASSES)
    except UnreadableError:
        found = None
    if isinstance(found, Exemplar):
        return found
    store.drop(key)
    return None


def keep_exemplar(store: DiskCache, request: ExemplarRequest, exemplar: Exemplar) -> bool:
    """Write the exemplar to disk; False if that is not possible."""
    return store.write(request.key(), pack(exemplar))
