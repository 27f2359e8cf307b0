"""The commands on data sets, `verify`, `merge`, `pack` and `report`, and those that make nothing."""

from __future__ import annotations

import json
import sys
from itertools import groupby
from pathlib import Path

import typer

from forestgen.cli.console import Printer
from forestgen.core.figures import count


def verify(
    folder: Path,
    rerender: int = 0,
    seed: int = 0,
    workers: int | None = None,
    hashes: bool = True,
    json_: bool = False,
    quiet: bool = False,
) -> None:
    """Check a data set: its files, its index, its splits, its labels.

    Every file has its SHA-256, nothing else lies there, the index tells what the frames show, no plant community is in
    two splits, and all labels are true to each other. With --rerender, images are rendered again.

    Every finding is named, up to 1,000 of each check. Files that other tools leave in the folder are a note.

    Exit code 0 if all is right, 6 if not, 2 if the folder is no data set.

    DIR  A data set's folder, of render, batch or merge.
    --rerender K  Render K images again, and compare all bytes. [from 0]
    --hashes/--no-hashes  Read all files and compare them with SHA256SUMS.
    """
    from forestgen import verify as check
    from forestgen.core.errors import DatasetError

    report = check(folder, rerender=rerender, seed=seed, workers=workers, hashes=hashes, progress=not (quiet or json_))
    if json_:
        Printer().json(report.as_dict())
    else:
        Printer(quiet)(str(report))
    if not report.ok:
        first, total = report.findings[0], len(report.findings) + report.not_named
        problem, got = f"{first.problem} (check {first.check!r}; {count(total, 'finding')} in all)", first.got or None
        hint = "the command that made the data set, with --resume, makes damaged images again"
        raise DatasetError(problem, where=str(folder / first.file), expected=first.expected or None, got=got, hint=hint)


def merge(sources: list[Path], out: Path, link: bool = False, overwrite: bool = False, quiet: bool = False) -> None:
    """Make one data set of several.

    Pieces of one recipe, made on several machines with --first, become what one run would have made, to the last byte.
    Data sets of different recipes can be merged if species, classes and the dataset section agree and their images have
    different numbers (--set first_image=N).

    DIR...  Data sets of render or batch.
    --out -o DIR  The merged data set's folder.
    --link  Hard links instead of copies: quick, and no disk space; files are then shared.
    """
    import forestgen

    merged = forestgen.merge(sources, out, link=link, overwrite=overwrite, progress=not quiet)
    say = Printer(quiet)
    for note in merged.notes:
        say(f"note: {note}")
    pieces, size = count(len(sources), "data set"), f"{merged.bytes / 1e6:,.1f} MB"
    say(f"{out}: {count(merged.frames, 'frame')} of {pieces}, {size}")


def pack(
    folder: Path,
    format_: str,
    out: Path,
    shard_size: str = "500MB",
    channels: list[str] | None = None,
    splits: list[str] | None = None,
    seed: int = 0,
    by_name: bool = False,
    overwrite: bool = False,
    quiet: bool = False,
) -> None:
    """Pack a data set for a training program's own loader.

    webdataset: tar files, in each of which the files of a stem are a frame. huggingface: Parquet files that
    datasets.load_dataset(DIR) opens. Pictures and tables go in byte for byte. The folder appears whole or not at all.

    DIR  A data set's folder, of render, batch or merge.
    --format NAME  webdataset, huggingface, or another pack.
    --out -o DIR  Folder for the pack.
    --shard-size SIZE  No file is larger: 500MB, 1.5GB, 256MiB.
    --channels A,B,...  Of preview, semantic, instance, depth, overlay, raw, annotations, plants, exr, and of arrays out
        of frame.exr: depth_m, normal, albedo, motion, radiance. By default preview, semantic, instance, and depth and
        annotations if the data set has them. May be repeated.
    --split A,B,...  Pack these splits alone; may be repeated.
    --by-name  Frames in the order of their names, not shuffled.
    """
    from forestgen import Dataset

    packed = Dataset(folder).pack(
        out,
        format_,
        shard_size=shard_size,
        channels=_names(channels) if channels else None,
        splits=_names(splits),
        seed=seed,
        by_name=by_name,
        overwrite=overwrite,
        progress=not quiet,
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


def _names(values: list[str] | None) -> list[str]:
    """The names of an option that may be repeated, and takes several at a time: ``A,B``."""
    return [name for value in values or () for one in value.split(",") if (name := one.strip())]


def report(folder: Path, out: Path | None = None, overwrite: bool = False) -> None:
    """Show a data set on one HTML page: gallery, balance, coverage, failures, timings.

    The page holds all it needs: it can be sent by mail and opened without a network. A run that has not ended can be
    shown too.

    DIR  A data set's folder, of render, batch or merge.
    --out -o FILE  The page; by default report.html in DIR.
    """
    from forestgen.api.datasets import write_report

    Printer()(f"file: {write_report(folder, out, overwrite=overwrite)}")


def validate(recipe: Path, set_: list[str] | None = None, json_: bool = False) -> None:
    """Check a recipe without making anything, and say what it would make."""
    from forestgen import load

    found, say = load(recipe, set=set_).validate(), Printer()
    if json_:
        say.json(found.as_dict())
        return
    for line in str(found).splitlines():
        say(line)
    for note in found.notes:
        say(f"note: {note}")


def schema() -> None:
    """Print the JSON Schema of recipes, for editors."""
    from forestgen import schema as schema_of

    sys.stdout.write(json.dumps(schema_of(), indent=2) + "\n")


def models(name: str | None = None, kind: str | None = None, json_: bool = False) -> None:
    """List models, generators, data set formats and all other parts, species and recipes.

    NAME  Show this part's manual page, or this species' or recipe's file.
    --kind KIND  Only these, such as community_model or species; an unknown one lists the kinds.
    """
    from forestgen import models as list_models
    from forestgen.recipe.assets import recipes_dir, scenes_dir

    found, say = list_models(name, kind=kind), Printer()
    if json_:
        say.json([{**one.as_dict(), "page": one.page} if name is not None else one.as_dict() for one in found])
        return
    if name is not None:
        say("\n\n".join(one.page for one in found))
        return
    for each, entries in groupby(found, key=lambda one: one.kind):
        say(each if each == "species" else f"{each.replace('_', ' ')}s")
        listed = list(entries)
        width = max(len(one.name) for one in listed)
        for one in listed:
            say(f"  {one.name:<{width}}  {one.description}".rstrip())
    say(f"species and lsystems lie in {scenes_dir()}, recipes in {recipes_dir()}")


def doctor(json_: bool = False) -> None:
    """Check this machine, and say what to do about what is missing. Exit code 3 if it cannot render."""
    from forestgen import doctor as diagnose
    from forestgen.core.errors import ResourceError

    found, say = diagnose(), Printer()
    if json_:
        say.json(found.as_dict())
    else:
        for line in found.lines():
            say(line)
    if not found.ready:
        raise typer.Exit(ResourceError.exit_code)
