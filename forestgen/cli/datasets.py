"""The commands on data sets: `merge`, `pack`, `report`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Optional

import typer

from forestgen.cli.arguments import DatasetPath, Overwrite, Quiet, Seed, progress_of
from forestgen.cli.console import Printer
from forestgen.core.figures import count

if TYPE_CHECKING:
    from forestgen.dataset.pack.pack import Packed


def merge(
    sources: Annotated[
        list[Path], typer.Argument(metavar="DIR...", help="Data sets of render or batch.", show_default=False)
    ],
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="DIR", help="The merged data set's folder.", show_default=False)
    ],
    link: Annotated[
        bool,
        typer.Option("--link", help="Hard links instead of copies: quick, and no disk space; files are then shared."),
    ] = False,
    quiet: Quiet = False,
) -> None:
    """Make one data set of several.

    Pieces of one recipe, made on several machines with --first, become what one run would have made, to the last byte.
    Data sets of different recipes can be merged if species, classes and the dataset section agree and their images have
    different numbers (--set first_image=N).
    """
    import forestgen

    merged, say = forestgen.merge(sources, out, link=link, progress=progress_of(quiet)), Printer(quiet)
    for note in merged.notes:
        say(f"note: {note}")
    pieces, size = count(len(sources), "data set"), f"{merged.bytes / 1e6:,.1f} MB"
    say(f"{out}: {count(merged.frames, 'frame')} of {pieces}, {size}")


def pack(
    folder: DatasetPath,
    form: Annotated[
        str,
        typer.Option("--format", metavar="NAME", help="webdataset, huggingface, or another pack.", show_default=False),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="DIR", help="Folder for the pack.", show_default=False)],
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
        typer.Option("--split", metavar="NAME", help="Pack this split alone; may be repeated.", show_default=False),
    ] = None,
    seed: Seed = 0,
    by_name: Annotated[
        bool, typer.Option("--by-name", help="Frames in the order of their names, not shuffled.")
    ] = False,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Pack a data set for a training program's own loader.

    webdataset: tar files, in each of which the files of a stem are a frame. huggingface: Parquet files that
    datasets.load_dataset(DIR) opens. Pictures and tables go in byte for byte. The folder appears whole or not at all.
    """
    from forestgen import Dataset

    packed = Dataset(folder).pack(
        out,
        form,
        shard_size=shard_size,
        channels=None if channels is None else [one.strip() for one in channels.split(",") if one.strip()],
        splits=splits or (),
        seed=seed,
        by_name=by_name,
        overwrite=overwrite,
        progress=progress_of(quiet),
    )
    _print_pack(packed, Printer(quiet))


def _print_pack(packed: Packed, say: Printer) -> None:
    width = max(len(name) for name in packed.splits)
    for name, shards in packed.splits.items():
        frames, size = sum(one.frames for one in shards), sum(one.size_bytes for one in shards)
        say(f"{name:<{width}}  {count(frames, 'frame')} in {count(len(shards), 'file')}, {size / 1e6:,.1f} MB")
    say(f"channels: {', '.join(packed.channels)}")
    say(f"files: {packed.folder}/")
    say("load it with")
    for line in packed.code:
        say(f"  {line}")


def report(
    folder: DatasetPath,
    out: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(
            "--out", "-o", metavar="FILE", help="The page; by default report.html in DIR.", show_default=False
        ),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Show a data set on one HTML page: gallery, balance, coverage, failures, timings.

    The page holds all it needs: it can be sent by mail and opened without a network. A run that has not ended can be
    shown too.
    """
    from forestgen.api.datasets import write_report

    Printer()(f"file: {write_report(folder, out, overwrite=overwrite)}")
