"""Shards of WebDataset: tar files in which files of one stem are a sample.

A frame's files are named FRAME.EXTENSION: a file a channel, and FRAME.json with what is known of the frame::

    {"frame": ..., "camera": camera.json, "classes": {"0": "nothing", ...}, "index": its row of index.parquet,
     "depth_unit_m": metres of a step of FRAME.depth.png}

Beside the shards SPLIT.json lists them, with frames and bytes, in the form that WebDataset's indexed reader takes.
The files do not say when, where and by whom they were made.
"""

from __future__ import annotations

import io
import re
import tarfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from forestgen.dataset.files import write_json
from forestgen.dataset.formats.format import json_text
from forestgen.dataset.pack.pack import Contents, Pack, Shard
from forestgen.dataset.pack.source import Channel, Sample

_BLOCK, _END = tarfile.BLOCKSIZE, 2 * tarfile.BLOCKSIZE


class WebDataset(Pack):
    """Tar files for WebDataset, in which files of one stem are a frame."""

    title = "WebDataset"
    frame_bytes = 8192  # the .json
    channel_bytes = 2 * _BLOCK  # header, rest of a block

    def write_split(self, folder: Path, split: str, samples: Iterator[Sample], contents: Contents) -> list[Shard]:
        """Write a split's shards, and their list."""
        shards: list[Shard] = []
        held = next(samples, None)
        while held is not None:
            name = f"{split}-{len(shards):06d}.tar"
            frames = 0
            with tarfile.open(folder / name, "w", format=tarfile.PAX_FORMAT) as tar:
                while held is not None:
                    members = _members(held, contents.channels, contents.source.classes["semantic"])
                    if frames and _file_bytes(tar.offset, members) > contents.shard_bytes:
                        break
                    for member, content in members:
                        tar.addfile(member, io.BytesIO(content))
                    frames += 1
                    held = next(samples, None)
            shards.append(Shard(name, frames, (folder / name).stat().st_size))
        listed = [{"url": one.name, "nsamples": one.frames, "filesize": one.size_bytes} for one in shards]
        index = {"__kind__": "wids-shard-index-v1", "wids_version": 1, "name": split, "shardlist": listed}
        write_json(folder / f"{split}.json", index)
        return shards

    def opening_code(self, target: str, split: str, shards: Sequence[Shard]) -> tuple[str, str]:
        decoder = 'handle_extension("png", lambda png: numpy.asarray(PIL.Image.open(io.BytesIO(png))))'
        name, last = shards[0].name, shards[-1].name
        if name != last:  # all in one name: train-{000000..000012}.tar
            name = re.sub(r"(\d{6})(?=\.tar$)", lambda digits: f"{{{digits[1]}..{last[-10:-4]}}}", name)
        return (
            "import io, numpy, PIL.Image, webdataset",
            f'{split} = webdataset.WebDataset("{target}/{name}", shardshuffle=False).decode(webdataset.{decoder})',
        )


PACK = WebDataset()


def _members(
    sample: Sample, channels: Sequence[Channel], class_names: Mapping[str, str]
) -> list[tuple[tarfile.TarInfo, bytes]]:
    files = {channel.extension: sample.contents[channel.name] for channel in channels}
    about = {
        "frame": sample.name,
        "camera": sample.camera,
        "classes": class_names,
        "index": sample.row,
        **({} if sample.depth_unit_m is None else {"depth_unit_m": sample.depth_unit_m}),
    }
    files["json"] = json_text(about).encode()
    members = []
    for extension, content in files.items():
        member = tarfile.TarInfo(f"{sample.name}.{extension}")  # of 1970, root's, and readable by all
        member.size = len(content)
        members.append((member, content))
    return members


def _file_bytes(offset: int, members: Sequence[tuple[tarfile.TarInfo, bytes]]) -> int:
    """Size of the file if the members were added to what ends at `offset`."""
    for member, content in members:
        offset += len(member.tobuf(tarfile.PAX_FORMAT)) + -(-len(content) // _BLOCK) * _BLOCK
    return -(-(offset + _END) // tarfile.RECORDSIZE) * tarfile.RECORDSIZE
