"""The contract of branch modules: the module graphs of all plants of a community, as arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Modules:
    """One row a module. The rows of a plant lie together, plants in the population's order, parents before children.

    A module's number is its own within its plant for life, and never given again; the root's is 0.
    """

    first: NDArray[np.int64]  # (P + 1,) rows of plant p are first[p] to first[p + 1]
    number: NDArray[np.uint32]  # (M,)
    parent: NDArray[np.int32]  # (M,) row of the module that bears it, counted from the plant's first row; -1: the root
    node: NDArray[np.int16]  # (M,) terminal node of the parent's prototype that it grows from; -1: the root
    prototype: NDArray[np.uint8]  # (M,) index into the prototypes, in the order of their names
    age: NDArray[np.float32]  # (M,) physiological age a_u, 0 to the type's mature_age
    age_yr: NDArray[np.float32]  # (M,) since the module began
    base_m: NDArray[np.float32]  # (M, 3) its root node, metres from the plant's foot along the world's axes
    rotation: NDArray[np.float32]  # (M, 4) unit quaternion w, x, y, z: module's frame -> world's axes
    vigour: NDArray[np.float32]  # (M,) that the last step gave it
    light: NDArray[np.float32]  # (M,) effective light exposure Q_eff in the last step, 0 to 1
    disused_m2: NDArray[np.float32]  # (M,) squared diameter of the pipes of what it has shed, at its root node

    def __len__(self) -> int:
        return len(self.number)

    @property
    def plants(self) -> int:
        return len(self.first) - 1

    def plant(self) -> NDArray[np.int64]:
        """(M,) row of the plant that each module belongs to."""
        return np.repeat(np.arange(self.plants), np.diff(self.first))

    def parent_row(self) -> NDArray[np.int64]:
        """(M,) row of the module that bears each module, -1 for roots."""
        start = np.repeat(self.first[:-1], np.diff(self.first))
        return np.where(self.parent < 0, -1, start + self.parent)

    def rows(self, plants: NDArray[np.integer] | NDArray[np.bool_]) -> NDArray[np.int64]:
        """(M',) rows of the modules of plants, one plant's after another's; (K,) rows of plants, or a mask (P,)."""
        chosen = np.arange(self.plants)[plants]
        counts = self.first[chosen + 1] - self.first[chosen]
        begins = np.cumsum(counts) - counts
        return np.asarray(np.arange(counts.sum()) + np.repeat(self.first[chosen] - begins, counts))

    def of_plants(self, plants: NDArray[np.integer] | NDArray[np.bool_]) -> Modules:
        """The modules of these plants, in this order; `plants` as in `rows`."""
        rows, counts = self.rows(plants), np.diff(self.first)[plants]
        columns = {name: values[rows] for name, values in vars(self).items() if name != "first"}
        return Modules(first=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64), **columns)

    def and_then(self, others: Modules) -> Modules:
        """The modules of these plants, and of further ones behind them."""
        parts = {name: np.concatenate([values, getattr(others, name)]) for name, values in vars(self).items()}
        parts["first"] = np.concatenate([self.first, self.first[-1] + others.first[1:]])
        return Modules(**parts)
