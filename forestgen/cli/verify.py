"""The command `verify`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from forestgen.cli.arguments import DatasetPath, Json, Quiet, Seed, Workers, progress_of
from forestgen.cli.console import Printer
from forestgen.core.figures import count

if TYPE_CHECKING:
    from forestgen.runs.verify_report import VerificationReport


def verify(
    folder: DatasetPath,
    rerender: Annotated[
        int, typer.Option("--rerender", metavar="K", min=0, help="Render K images again, and compare all bytes.")
    ] = 0,
    seed: Seed = 0,
    workers: Workers = None,
    hashes: Annotated[
        bool, typer.Option("--hashes/--no-hashes", help="Read all files and compare them with SHA256SUMS.")
    ] = True,
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

    report = check(
        folder, rerender=rerender, seed=seed, workers=workers, hashes=hashes, progress=progress_of(quiet or as_json)
    )
    if as_json:
        Printer().json(report.as_dict())
    else:
        Printer(quiet)(str(report))
    if not report.ok:
        _fail(report, folder)


def _fail(report: VerificationReport, folder: Path) -> None:
    """Raise the first finding."""
    from forestgen.core.errors import DatasetError

    first, total = report.findings[0], len(report.findings) + report.not_named
    raise DatasetError(
        f"{first.problem} (check {first.check!r}; {count(total, 'finding')} in all)",
        where=str(folder / first.file),
        expected=first.expected or None,
        got=first.got or None,
        hint="the command that made the data set, with --resume, makes damaged images again",
    )
