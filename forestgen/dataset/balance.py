"""How much of each class a data set shows, split by split."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

RARE = 0.001  # share of a split's pixels, or of its instances, below which a class is hard to learn


@dataclass(frozen=True)
class Balance:
    """Counts of what has a name (pixels of classes, instances of categories), by split."""

    names: tuple[str, ...]  # in the legend's order; what the legend lacks comes last
    splits: tuple[str, ...]
    counts: NDArray[np.int64]  # (names, splits)
    frames: NDArray[np.int64]  # (names, splits) that show any

    @property
    def shares(self) -> NDArray[np.float64]:
        """(names, splits) of 1; 0 in a split that counts nothing."""
        total = self.counts.sum(axis=0, keepdims=True)
        return np.asarray(self.counts / np.maximum(total, 1), dtype=np.float64)

    def lacking(self) -> list[tuple[str, str]]:
        """(name, split) of all that a split lacks."""
        return self._where(self.counts == 0)

    def rare(self) -> list[tuple[str, str]]:
        """(name, split) of all that a split shows, but less than `RARE` of."""
        return self._where((self.counts > 0) & (self.shares < RARE))

    def _where(self, chosen: NDArray[np.bool_]) -> list[tuple[str, str]]:
        return [(self.names[i], self.splits[j]) for i, j in np.argwhere(chosen)]


def balance(
    counted: Sequence[Mapping[str, int] | None], split: Sequence[str], names: Sequence[str], splits: Sequence[str]
) -> Balance:
    """Sum counts by name and split.

    Parameters
    ----------
    counted : name -> count for each frame; None where nothing is known of a frame.
    split : of each frame.
    names : all that can occur, such as the legend's classes; others that do are added.
    splits : all splits, in the order to show them.
    """
    occurring = {name for one in counted if one for name in one}
    known = tuple(dict.fromkeys([*names, *sorted(occurring)]))
    row_of = {name: row for row, name in enumerate(known)}
    column_of = {name: column for column, name in enumerate(splits)}
    counts = np.zeros((len(known), len(splits)), dtype=np.int64)
    frames = np.zeros_like(counts)
    for one, part in zip(counted, split, strict=True):
        for name, count in (one or {}).items():
            counts[row_of[name], column_of[part]] += count
            frames[row_of[name], column_of[part]] += count > 0
    return Balance(known, tuple(splits), counts, frames)
