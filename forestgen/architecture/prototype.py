"""Module prototypes: the branching patterns that branch modules repeat (Makowski 2023, section 2.5.2).

A prototype is a tree of nodes. Node 0 is its root, at the module's origin; every other node ends a branch segment. The
nodes without children are its terminals, where other modules may grow. Of several children of a node the first is the
continuation of the axis (main), the others are lateral.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

MOST_NODES = 32


@dataclass(frozen=True)
class Prototype:
    """One prototype, with its place in the morphospace of apical control and determinacy."""

    name: str
    apical_control: float  # lambda, 0 to 1
    determinacy: float  # D, 0 to 1
    parent: NDArray[np.int16]  # (N,) -1 for node 0; parents precede children
    direction: NDArray[np.float32]  # (N, 3) unit vector of the segment that the node ends; module's frame, z its axis
    length: NDArray[np.float32]  # (N,) of that segment, as a factor on the plant type's lengths; 0 for node 0
    birth: NDArray[
        np.float32
    ]  # (N,) a_n over the mature age, 0 to 1: when the segment begins to grow; not below its parent's
    thickness: NDArray[np.float32]  # (N,) factor on the plant type's thickening, for terminals

    def __len__(self) -> int:
        return len(self.parent)

    @property
    def terminals(self) -> NDArray[np.int64]:
        """(K,) nodes without children."""
        return np.setdiff1d(np.arange(len(self.parent)), self.parent[1:])
