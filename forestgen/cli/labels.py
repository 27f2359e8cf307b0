"""forestgen labels: are a data set's labels true?"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Optional

import typer

from forestgen.cli.console import Bars, count, output, seconds

if TYPE_CHECKING:
    from forestgen.dataset.check import Offence, Report

_MOST = 100  # offenders that --all names

app = typer.Typer(
    name="labels",
    help="Look into the labels of a data set.",
    no_args_is_help=True,
    rich_markup_mode=None,
)


@app.callback()
def _group() -> None:
    pass


@app.command("check", epilog="Example: forestgen labels check outputs/quickstart")
def check(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="A folder that forestgen render made.", show_default=False)
    ],
    jobs: Annotated[
        Optional[int],  # noqa: UP045 - typer reads annotations at run time
        typer.Option(
            "--jobs",
            "-j",
            metavar="N",
            min=1,
            max=1024,
            help="Worker processes; by default one a core. Results do not depend on it.",
            show_default=False,
        ),
    ] = None,
    every: Annotated[
        bool, typer.Option("--all", help=f"Go on after the first offender, and name up to {_MOST} of them.")
    ] = False,
    hashes: Annotated[
        bool, typer.Option("--hashes/--no-hashes", help="Compare files with the SHA-256 of manifest.json.")
    ] = True,
) -> None:
    """Check that all labels of a data set are true to each other.

    Masks, boxes, coverage, depth, positions, keypoints, tables and the files of all formats must tell the same. The
    first that does not is named by file, image, plant and pixel, with what was expected and what was found.

    Exit code 0 if all is right, 6 if not, 2 if the folder is no data set.
    """
    from forestgen.dataset.check import check_dataset

    with Bars().running() as bars:
        report = check_dataset(folder, jobs=jobs, hashes=hashes, most=_MOST if every else 1, progress=bars)
    _print(report)
    if report.offences:
        _fail(report, folder, every)


def _print(report: Report) -> None:
    """The table of checks, and how fast they went."""
    out = output()
    width = max(len(tally.name) for tally in report.tallies)
    out.print(f"{'check':<{width}}  images     ok", markup=False)
    for tally in report.tallies:
        what = tally.holds if tally.good == tally.images else "FAILED: " + tally.holds
        if tally.images:
            out.print(f"{tally.name:<{width}}  {tally.images:>6,} {tally.good:>6,}  {what}", markup=False)
        elif not report.offences:
            out.print(f"{tally.name:<{width}}       -      -  not in this data set", markup=False)
    speed = report.checked / max(report.seconds, 1e-9)
    done = count(report.checked, "image")
    if report.checked < report.frames:
        done += f" of {report.frames:,}"
    out.print(f"{done} in {seconds(report.seconds)}, {speed:.1f} a second", markup=False)


def _fail(report: Report, folder: Path, every: bool) -> None:
    """Raise the first offender as an error, with the others before it if they were asked for."""
    from forestgen.core.errors import DatasetError

    first = report.offences[0]
    if every and len(report.offences) > 1:
        out = output()
        for offence in report.offences:
            out.print(f"{offence.check}: {_line(offence)}", markup=False)
        more = " or more" if len(report.offences) == _MOST else ""
        raise DatasetError(
            f"{len(report.offences)}{more} offenders, the first: {first.where}: {first.problem}",
            where=str(folder),
            expected=first.expected or None,
            got=first.got or None,
        )
    raise DatasetError(
        f"{first.problem} (check {first.check!r})",
        where=str(folder / first.where),
        expected=first.expected or None,
        got=first.got or None,
        hint=None if every else "--all names further offenders",
    )


def _line(offence: Offence) -> str:
    values = [f"{word} {text}" for word, text in (("expected", offence.expected), ("got", offence.got)) if text]
    return f"{offence.where}: {offence.problem}" + (f" ({'; '.join(values)})" if values else "")
