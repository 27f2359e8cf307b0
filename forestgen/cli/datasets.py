"""The commands on data sets: `verify`, `merge`, `pack`, `report`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from forestgen.cli.arguments import DatasetPath, Json, Overwrite, Quiet, Seed, Workers, argument, option, progress_of
from forestgen.cli.console import Printer
from forestgen.core.figures import count


def verify(
    folder: DatasetPath,
    rerender: Annotated[int, option("--rerender K", "Render K images again, and compare all bytes.", min=0)] = 0,
    seed: Seed = 0,
    workers: Workers = None,
    hashes: Annotated[bool, option("--hashes/--no-hashes", "Read all files and compare them with SHA256SUMS.")] = True,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Check a data set: its files, its index, its splits, its labels.

    Every file has its SHA-256, nothing else lies there, the index tells what the frames show, no plant community is in
    two splits, and all labels are true to each other. With --rerender, images are rendered again.

    Every finding is named, up to 1,000 of each check. Files that other tools leave in the folder are a note.

    Exit code 0 if all is right, 6 if not, 2 if the folder is no data set.
    """
    from forestgen import verify as check
    from forestgen.core.errors import DatasetError

    report = check(
        folder, rerender=rerender, seed=seed, workers=workers, hashes=hashes, progress=progress_of(quiet or as_json)
    )
    if as_json:
        Printer().json(report.as_dict())
    else:
        Printer(quiet)(str(report))
    if not report.ok:
        first, total = report.findings[0], len(report.findings) + report.not_named
        raise DatasetError(
            f"{first.problem} (check {first.check!r}; {count(total, 'finding')} in all)",
            where=str(folder / first.file),
            expected=first.expected or None,
            got=first.got or None,
            hint="the command that made the data set, with --resume, makes damaged images again",
        )


def merge(
    sources: Annotated[list[Path], argument("DIR...", "Data sets of render or batch.", show_default=False)],
    out: Annotated[Path, option("--out -o DIR", "The merged data set's folder.", show_default=False)],
    link: Annotated[
        bool, option("--link", "Hard links instead of copies: quick, and no disk space; files are then shared.")
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
    form: Annotated[str, option("--format NAME", "webdataset, huggingface, or another pack.", show_default=False)],
    out: Annotated[Path, option("--out -o DIR", "Folder for the pack.", show_default=False)],
    shard_size: Annotated[str, option("--shard-size SIZE", "No file is larger: 500MB, 1.5GB, 256MiB.")] = "500MB",
    channels: Annotated[
        str | None,
        option(
            "--channels A,B,...",
            "Of preview, semantic, instance, depth, overlay, raw, annotations, plants, exr, and of arrays out of "
            "frame.exr: depth_m, normal, albedo, motion, radiance. By default preview, semantic, instance, and depth "
            "and annotations if the data set has them.",
        ),
    ] = None,
    splits: Annotated[list[str] | None, option("--split NAME", "Pack this split alone; may be repeated.")] = None,
    seed: Seed = 0,
    by_name: Annotated[bool, option("--by-name", "Frames in the order of their names, not shuffled.")] = False,
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
    say, width = Printer(quiet), max(len(name) for name in packed.splits)
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
    out: Annotated[Path | None, option("--out -o FILE", "The page; by default report.html in DIR.")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Show a data set on one HTML page: gallery, balance, coverage, failures, timings.

    The page holds all it needs: it can be sent by mail and opened without a network. A run that has not ended can be
    shown too.
    """
    from forestgen.api.datasets import write_report

    Printer()(f"file: {write_report(folder, out, overwrite=overwrite)}")
