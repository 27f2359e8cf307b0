"""The command `verify`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from forestgen.api.display import display_of
from forestgen.cli.arguments import DatasetPath, Workers
from forestgen.cli.console import count, output, seconds

if TYPE_CHECKING:
    from forestgen.runs.verify import Verdict


def verify(
    folder: DatasetPath,
    rerender: Annotated[
        int, typer.Option("--rerender", metavar="K", min=0, help="Render K images again, and compare all bytes.")
    ] = 0,
    seed: Annotated[int, typer.Option("--seed", metavar="S", min=0, help="Draws the images to render again.")] = 0,
    workers: Workers = None,
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

    with display_of(None).running() as display:
        verdict = check(folder, rerender=rerender, seed=seed, jobs=workers, hashes=hashes, progress=display)
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
        hint="remove the folders of damaged frames: the batch that made them makes them again with --resume",
    )
