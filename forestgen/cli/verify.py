"""The command `verify`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Optional

import typer

from forestgen.api.display import Bars
from forestgen.cli.console import count, output, seconds

if TYPE_CHECKING:
    from forestgen.runs.verify_report import VerificationReport


def verify(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="A data set that forestgen batch made.", show_default=False)
    ],
    rerender: Annotated[
        int, typer.Option("--rerender", metavar="K", min=0, help="Render K images again, and compare all bytes.")
    ] = 0,
    seed: Annotated[int, typer.Option("--seed", metavar="S", min=0, help="Draws the images to render again.")] = 0,
    workers: Annotated[
        Optional[int],  # noqa: UP045 - typer reads annotations at run time
        typer.Option(
            "--workers",
            "-w",
            metavar="N",
            min=1,
            max=1024,
            help="Processes and threads that check; by default one a core. Results do not depend on it.",
            show_default=False,
        ),
    ] = None,
    hashes: Annotated[
        bool, typer.Option("--hashes/--no-hashes", help="Read all files and compare them with SHA256SUMS.")
    ] = True,
    as_json: Annotated[bool, typer.Option("--json", help="Print the report as JSON.")] = False,
) -> None:
    """Check a data set: its files, its index, its splits, its labels.

    Every file has its SHA-256, nothing else lies there, the index tells what the frames show, no plant community is in
    two splits, and all labels are true to each other. With --rerender, images are rendered again.

    Every finding is named, up to 1,000 of each check. Files that other tools leave in the folder are a note.

    Exit code 0 if all is right, 6 if not, 2 if the folder is no data set.
    """
    from forestgen.runs.verify import verify as check

    with Bars().running() as bars:
        report = check(folder, rerender=rerender, seed=seed, workers=workers, hashes=hashes, progress=bars)
    if as_json:
        typer.echo(report.as_json())
    else:
        _print(report)
    if not report.ok:
        _fail(report, folder)


def _print(report: VerificationReport) -> None:
    """The table of checks, what was found, then what people should know."""
    out = output()
    width = max(len(check.name) for check in report.checks)
    out.print(f"{'check':<{width}}   looked at  ok", markup=False)
    for check in report.checks:
        what = f"FAILED: {check.holds} ({count(check.found, 'finding')})" if check.found else check.holds
        mark = "no " if check.found else "yes"
        out.print(f"{check.name:<{width}}  {check.images:>10,}  {mark} {what}", markup=False)
    for one in report.findings:
        values = [f"{word} {text}" for word, text in (("expected", one.expected), ("got", one.got)) if text]
        more = f" ({'; '.join(values)})" if values else ""
        out.print(f"{one.check}: {one.where}: {one.problem}{more}", markup=False)
    if report.not_named:
        out.print(f"... and {report.not_named:,} more", markup=False)
    for note in report.notes:
        out.print(f"note: {note}", markup=False)
    done = f"{count(report.images, 'image')}, {count(report.frames, 'frame')}, {count(report.files, 'file')}"
    out.print(f"{done} in {seconds(report.seconds)}", markup=False)


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
