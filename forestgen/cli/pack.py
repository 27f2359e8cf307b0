"""The command `pack`."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Optional

import typer

from forestgen.cli.console import Bars, count, output

if TYPE_CHECKING:
    from forestgen.dataset.pack.run import Packed

_UNITS = {"": 1, "K": 1000, "M": 1000**2, "G": 1000**3, "T": 1000**4}
_BINARY_UNITS = {"K": 1 << 10, "M": 1 << 20, "G": 1 << 30, "T": 1 << 40}


def pack(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="DIR", help="A folder that forestgen batch or forestgen render made.", show_default=False
        ),
    ],
    form: Annotated[
        str,
        typer.Option("--format", metavar="webdataset|huggingface", help="What the loader reads.", show_default=False),
    ],
    target: Annotated[
        Path, typer.Option("--out", "-o", metavar="OUT", help="Folder for the pack.", show_default=False)
    ],
    shard_size: Annotated[
        str, typer.Option("--shard-size", metavar="SIZE", help="No file is larger: 500MB, 1.5GB, 256MiB.")
    ] = "500MB",
    channels: Annotated[
        Optional[str],  # noqa: UP045 - typer reads annotations at run time
        typer.Option(
            "--channels",
            metavar="A,B,...",
            help="Of preview, semantic, instance, depth, overlay, raw, annotations, plants, exr, and of arrays out of "
            "frame.exr: depth_m, normal, albedo, motion, radiance. By default preview, semantic, instance, and depth "
            "and annotations if the data set has them.",
            show_default=False,
        ),
    ] = None,
    splits: Annotated[
        Optional[list[str]],  # noqa: UP045
        typer.Option(
            "--split",
            metavar="NAME",
            help="Pack this split alone; may be repeated. Of a folder of forestgen render: the name of its one split, "
            "by default train.",
            show_default=False,
        ),
    ] = None,
    seed: Annotated[
        int, typer.Option("--seed", metavar="N", help="Of the random order of the frames: another seed, another order.")
    ] = 0,
    by_name: Annotated[
        bool, typer.Option("--by-name", help="Frames in the order of their names, not shuffled.")
    ] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace a previous pack in that folder.")] = False,
) -> None:
    """Pack a data set for a training program's own loader.

    webdataset: tar files, in each of which the files of a stem are a frame. huggingface: Parquet files that
    datasets.load_dataset(OUT) opens. Pictures and tables go in byte for byte. The folder appears whole or not at all.
    """
    from forestgen.core.errors import RecipeError
    from forestgen.dataset.pack.run import FORMATS, Packing
    from forestgen.dataset.pack.run import pack as pack_data_set

    chosen = next((one for one in FORMATS if one == form), None)
    if chosen is None:
        raise RecipeError("there is no such format", where="--format", expected=" or ".join(FORMATS), got=form)
    packing = Packing(
        format=chosen,
        shard_bytes=size_bytes(shard_size),
        channels=None if channels is None else tuple(one.strip() for one in channels.split(",") if one.strip()),
        splits=tuple(splits or ()),
        seed=None if by_name else seed,
    )
    with Bars().running() as bars:
        packed = pack_data_set(folder, target, packing, overwrite=overwrite, progress=bars)
    _print(packed)


def size_bytes(text: str) -> int:
    """Bytes of a size such as 500MB (decimal), 256MiB (binary) or 1000000; anything else raises `RecipeError`."""
    from forestgen.core.errors import RecipeError

    found = re.fullmatch(r"(\d+(?:\.\d+)?)\s*(?:([KMGT])(I?))?B?", text.strip().upper(), re.ASCII)
    if found:
        number, unit, binary = found.groups(default="")
        size = int(float(number) * (_BINARY_UNITS if binary else _UNITS)[unit]) if len(number) < 20 else 0
        if size > 0:
            return size
    raise RecipeError("this is no size", where="--shard-size", expected="such as 500MB, 1.5GB or 256MiB", got=text)


def _print(packed: Packed) -> None:
    out = output()
    width = max(len(name) for name in packed.splits)
    for name, shards in packed.splits.items():
        frames, size = sum(one.frames for one in shards), sum(one.size_bytes for one in shards)
        text = f"{name:<{width}}  {count(frames, 'frame')} in {count(len(shards), 'file')}, {size / 1e6:,.1f} MB"
        out.print(text, markup=False)
    out.print(f"channels: {', '.join(packed.channels)}", markup=False)
    out.print(f"files: {packed.folder}/", markup=False)
    out.print("load it with", markup=False)
    for line in packed.code:
        out.print(f"  {line}", markup=False)
