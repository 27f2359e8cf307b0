"""Exemplars kept on disk, by the hash of all that they depend on.

An exemplar depends on the generator's parameters, the allometry, the names of the materials, the radius, the level of
detail and the seed; and on the code that grows it, whose hash counts too, so that a change of a generator never shows
an old plant. What comes from disk is the same as what would be grown, to the last bit.
"""

from __future__ import annotations

import hashlib
import json
import platform
from dataclasses import asdict, dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import forestgen
from forestgen.core.disk_cache import DiskCache, cache_root
from forestgen.core.packed import UnreadableError, pack, unpack
from forestgen.core.parts import Part
from forestgen.geometry.mesh import Mesh
from forestgen.plants.build import Species
from forestgen.plants.exemplar import Exemplar, OrganMesh
from forestgen.plants.grown.wood import ModuleWood, wood_key
from forestgen.plants.levels import FULL, Level

MOST_BYTES = 4_000_000_000
_SOURCES = ("core", "geometry", "lsystem", "plants")  # layers whose code shapes a plant
_SUFFIXES = (".py", ".lark")
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
            **({} if self.box_m is None else {"box_m": [repr(float(side)) for side in self.box_m]}),
            "code": code_hash(),
        }
        text = json.dumps(content, sort_keys=True, separators=(",", ":"))
        return hashlib.blake2b(text.encode(), digest_size=20).hexdigest()


@cache
def code_hash() -> str:
    """Hash of forestgen's version, of the files that shape a plant, and of the versions that they compute with."""
    root = Path(forestgen.__file__).parent
    digest = hashlib.blake2b(digest_size=20)
    packages = [version(name) for name in _COMPUTE_WITH]
    digest.update(repr((forestgen.__version__, platform.machine(), platform.python_version(), packages)).encode())
    for layer in _SOURCES:
        for path in sorted(one for one in (root / layer).rglob("*") if one.suffix in _SUFFIXES):
            digest.update(f"\n{path.relative_to(root).as_posix()}\n".encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()


def exemplar_store() -> DiskCache | None:
    """Where exemplars are kept; None if there is no place for them."""
    root = cache_root()
    return None if root is None else DiskCache(root / "exemplars", MOST_BYTES)


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
