"""Parts of another package, as a user would write them: a data set format, a label channel and a pack."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from forestgen.dataset.check.files import Finding, finding, read_json
from forestgen.dataset.check.frame_data import FrameCheck, FrameData, frame_check
from forestgen.dataset.check.merged import DatasetCheck, Merged
from forestgen.dataset.formats.format import DatasetFormat, in_order, json_text, read_shard, whole_file, write_shard
from forestgen.dataset.pack.pack import Contents, Pack, Shard
from forestgen.dataset.pack.source import Sample
from forestgen.dataset.settings import DatasetSettings
from forestgen.labels.channels.channel import ChannelView, LabelChannel, Layers, layer
from forestgen.labels.labelled import LabelledFrame
from forestgen.render.frame import Frame
from forestgen.scene.projection import Projection

SHARD, WHOLE = "size.json", "sizes.json"


class Sizes(DatasetFormat):
    """Width and height of each frame."""

    name = "sizes"
    bytes_per_plant = 1
    split_file_names = ("sizes.txt", "sizes_of_test.txt")

    def holds(self, projection: Projection) -> bool:
        return projection.is_pinhole

    def write_frame(self, folder: Path, labelled: LabelledFrame, settings: DatasetSettings) -> None:
        write_shard(folder / SHARD, {"size_px": list(labelled.frame.camera.size_px)})

    def merge(self, root: Path, folders: Iterable[Path | str], settings: DatasetSettings) -> None:
        sizes = {name: read_shard(root / name / SHARD, {"size_px": list})["size_px"] for name in in_order(folders)}
        with whole_file(root / WHOLE) as stream:
            stream.write(json_text(sizes))

    def split_files(self, splits: Sequence[str], settings: DatasetSettings) -> dict[str, bytes]:
        return {"sizes.txt": "".join(f"{split}/{WHOLE}\n" for split in splits).encode()}

    def frame_checks(self) -> tuple[FrameCheck, ...]:
        return (FrameCheck("size", SHARD, lambda frame: frame.has(SHARD), _size), _whole_size)

    def frame_shares(self, merged: Merged) -> Mapping[str, Any]:
        sizes: dict[str, Any] = read_json(merged.root, WHOLE)
        return sizes

    def dataset_checks(self) -> tuple[DatasetCheck, ...]:
        return (DatasetCheck("sizes", WHOLE, lambda merged: merged.has(WHOLE), _sizes),)

    def card(self) -> str:
        return "`SPLIT/sizes.json` has the sizes of frames."


def _size(frame: FrameData) -> Iterator[Finding]:
    said = read_json(frame.root, frame.file(SHARD))["size_px"]
    if tuple(said) != frame.camera.size_px:
        yield finding("another size", frame.camera.size_px, said)


@frame_check("whole size", WHOLE, share="sizes", shared=True)
def _whole_size(frame: FrameData) -> Iterator[Finding]:
    said = frame.shared["sizes"]
    if tuple(said) != frame.camera.size_px:
        yield finding("another size", frame.camera.size_px, said)


def _sizes(merged: Merged) -> Iterator[Finding]:
    if list(read_json(merged.root, WHOLE)) != list(merged.frames):
        yield finding("other frames")


class Triangles(LabelChannel):
    """How many triangles the exemplar at each pixel's centre has."""

    name = "triangles"
    units: Mapping[str, str] = {"triangles": "triangles"}

    def add(self, frame: Frame, view: ChannelView) -> Frame:
        count = np.array([0, *(one.triangles for one in view.tracer.spec.exemplars)], dtype=np.uint32)
        return replace(frame, own={**frame.own, self.name: count[frame.surface.exemplar]})

    def parts(self, labelled: LabelledFrame) -> dict[str, Layers]:
        return {"triangles": layer("count", labelled.frame.own[self.name])}


class Names(Pack):
    """Lists of frames."""

    title, frame_bytes = "readers of lists", 100

    def write_split(self, folder: Path, split: str, samples: Iterator[Sample], contents: Contents) -> list[Shard]:
        text = "".join(f"{one.name} {','.join(one.contents)}\n" for one in samples)
        (folder / f"{split}.txt").write_text(text)
        return [Shard(f"{split}.txt", text.count("\n"), len(text))]

    def opening_code(self, target: str, split: str, shards: Sequence[Shard]) -> tuple[str, str]:
        return "from pathlib import Path", f'{split} = Path("{target}/{shards[0].name}").read_text()'


FORMAT = Sizes()
CHANNEL, PACK = Triangles(), Names()
NO_FORMAT = object()
