"""What a pack is: a form of data sets that training programs' own loaders read."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from forestgen.dataset.pack.channels import Channel
from forestgen.dataset.pack.samples import Sample, Shard
from forestgen.dataset.pack.source import Source


@dataclass(frozen=True)
class Contents:
    """What goes into a pack."""

    source: Source
    channels: Sequence[Channel]
    shard_bytes: int  # no shard is larger, unless it holds one frame alone


class Pack:
    """A form of packs, without a state: one file in this folder, one line in recipe/registries.py."""

    title: str  # of the loader, for people
    frame_bytes: int  # upper estimate of what a frame takes on the disk beside its channels
    channel_bytes: int = 0  # and beside each channel's own bytes

    def split_name(self, name: str) -> str:
        """A split's name in the pack."""
        return name

    def write_split(self, folder: Path, split: str, samples: Iterator[Sample], contents: Contents) -> list[Shard]:
        """Write a split's shards into the pack's folder; `split` is its name in the pack."""
        raise NotImplementedError

    def opening_code(self, target: str, split: str, shards: Sequence[Shard]) -> tuple[str, str]:
        """Two lines of Python that open a split of the pack at `target`."""
        raise NotImplementedError

    def front_matter(
        self, contents: Contents, splits: Mapping[str, Sequence[Shard]], of_card: Mapping[str, Any]
    ) -> str:
        """What README.md begins with, before what people read; `of_card` is the same of the data set's card."""
        return ""
