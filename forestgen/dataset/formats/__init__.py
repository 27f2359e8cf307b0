"""Formats for those who train and measure: a module each, with the two functions of `Format`.

``write_frame`` writes the frame's own share into its folder, the shard. ``merge`` reads the shards of all frames, in
the order of their names, and writes the data set's files once. So many workers may write frames, and nobody rewrites a
file as images come.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Protocol

from forestgen.dataset.settings import DatasetSettings
from forestgen.labels.labelled import LabelledFrame


class Format(Protocol):
    """What a module of this package offers."""

    def write_frame(self, folder: Path, labelled: LabelledFrame, settings: DatasetSettings) -> None:
        """Write the frame's share into its folder; what cannot be written raises `OutputError`."""

    def merge(self, root: Path, folders: Iterable[Path | str], settings: DatasetSettings) -> None:
        """Write the files over all frames; a share that is missing or damaged raises `OutputError`.

        Parameters
        ----------
        root : the data set's folder.
        folders : the frames' folders or their names, in any order.
        """
