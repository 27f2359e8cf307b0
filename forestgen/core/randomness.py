"""Randomness derived from identity.

A stream of random numbers belongs to a thing (a simulation step, a plant, an image), not to a moment: it is derived
from the root seed and the thing's name, so the order of calls and the number of workers cannot change a result.
"""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np

SPLIT_MIX_STEP = np.uint64(0x9E3779B97F4A7C15)  # between the states of a stream


def _digest(root_seed: int, identity: tuple[str | int, ...]) -> bytes:
    plain = (part if isinstance(part, str) else int(part) for part in identity)  # NumPy integers count as Python's
    # repr() keeps 1 and "1", and ("a", "b") and ("ab",), apart.
    text = repr((int(root_seed), *plain))
    return hashlib.blake2b(text.encode(), digest_size=16).digest()


def child_rng(root_seed: int, *identity: str | int) -> np.random.Generator:
    """Generator of the thing named by `identity`, such as ``child_rng(7, "plant", 1234)``."""
    return np.random.Generator(np.random.PCG64(int.from_bytes(_digest(root_seed, identity), "little")))


def child_root(root_seed: int, *identity: str | int) -> int:
    """Root seed in [0, 2^63) of a thing that has things of its own, such as an image; a million do not collide."""
    return int.from_bytes(_digest(root_seed, identity)[:8], "little") >> 1


def child_seed(root_seed: int, *identity: str | int) -> int:
    """Seed in [0, 2^31) for a library that takes an integer (the renderer's samplers, k-means)."""
    return int.from_bytes(_digest(root_seed, identity)[:4], "little") >> 1


def mixed(bits: Any) -> Any:
    """NumPy's uint64, an array or a number, one to one well mixed: the finaliser of SplitMix64. Kernels compile it.

    References
    ----------
    G. L. Steele, D. Lea and C. H. Flood, Fast splittable pseudorandom number generators, OOPSLA 2014.
    """
    bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return bits ^ (bits >> np.uint64(31))
