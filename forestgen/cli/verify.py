"""The command `verify`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Optional

import typer

from forestgen.cli.console import Bars, count, output, seconds

if TYPE_CHECKING:
    from forestgen.runs.verify import Verdict


def verify(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="A data set that forestgen batch made.", show_default=False)
    ],
    rerender: Annotated[
        int, typer.Option("--rerender", metavar="K", min=0, help="Render K images again, and compare all bytes.")
    ] = 0,
    seed: Annotated[int, typer.Option("--seed", metavar="S", min=0, help="Draws the images to render again.")] = 0,
    jobs: Annotated[
        Optional[int],  # noqa: UP045 - typer reads annotations at run time
        typer.Option(
            "--jobs",
            "-j",
            metavar="J",
            min=1,
            max=1024,
            help="Workers that check; by default one a core. Results do not depend on it.",
            show_default=False,
        ),
    ] = None,
    hashes: Annotated[
        bool, typer.Option("--hashes/--no-hashes", help="Read all files and compare them with SHA256SUMS.")
    ] = True,
) -> None:
    """Check a data set: its files, its index, its splits, its labels.

    Every file has its SHA-256, nothing else lies there, the index tells what the frames show, no plant community is in
    two splits, and all labels are true to each other. With --rerender, images are rendered again.

    Exit code 0 if all is right, 6 if not, 2 if the folder is no data set.
    """
    from forestgen.runs.verify import verify as check

    with Bars().running() as bars:
        verdict = check(folder, rerender=rerender, seed=seed, jobs=jobs, hashes=hashes, progress=bars)
    _print(verdict)
    if verdict.offences:
        _fail(verdict, folder)


def _print(verdict: Verdict) -> None:
    """The table of checks, then what people should know."""
    out = output()
    width = max(len(tally.name) for tally in verdict.tallies)
    out.print(f"{'check':<{width}}   looked at  ok", markup=False)
    wrong = {offence.check for offence in verdict.offences}
    for tally in verdict.tallies:
        what = f"FAILED: {tally.holds}" if tally.name in wrong else tally.holds
        mark = "no " if tally.name in wrong else "yes"
        out.print(f"{tally.name:<{width}}  {tally.images:>10,}  {mark} {what}", markup=False)
    for note in verdict.notes:
        out.print(f"note: {note}", markup=False)
    done = f"{count(verdict.images, 'image')}, {count(verdict.frames, 'frame')}, {count(verdict.files, 'file')}"
    out.print(f"{done} in {seconds(verdict.seconds)}", markup=False)


def _fail(verdict: Verdict, folder: Path) -> None:
    """Name all offenders that were found, and raise the first."""
    from forestgen.core.errors import DatasetError

    out = output()
    for offence in verdict.offences:
        values = [f"{word} {text}" for word, text in (("expected", offence.expected), ("got", offence.got)) if text]
        more = f" ({'; '.join(values)})" if values else ""
        out.print(f"{offence.check}: {offence.where}: {offence.problem}{more}", markup=False)
    first = verdict.offences[0]
    raise DatasetError(
        f"{first.problem} (check {first.check!r})",
        where=str(folder / first.file),
        expected=first.expected or None,
        got=first.got or None,
        hint="the command that made the data set, with --resume, makes damaged images again",
    )
