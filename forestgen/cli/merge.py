"""The command `merge`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from forestgen.cli.console import Bars, count, output


def merge(
    sources: Annotated[
        list[Path], typer.Argument(metavar="DIR...", help="Data sets that forestgen batch made.", show_default=False)
    ],
    target: Annotated[
        Path, typer.Option("--out", "-o", metavar="DIR", help="The merged data set's folder.", show_default=False)
    ],
    link: Annotated[
        bool,
        typer.Option("--link", help="Hard links instead of copies: quick, and no disk space; files are then shared."),
    ] = False,
) -> None:
    """Make one data set of several.

    Pieces of one recipe, made on several machines with `forestgen batch --first`, become what one run would have made,
    to the last byte. Data sets of different recipes can be merged if species, classes and the dataset section agree and
    their images have different numbers (--set first_image=N).
    """
    from forestgen.runs.merge import merge as merge_pieces

    with Bars().running() as bars:
        done = merge_pieces(sources, target, link=link, progress=bars)
    out = output()
    for note in done.notes:
        out.print(f"note: {note}", markup=False)
    pieces = count(len(sources), "data set")
    size = f"{done.bytes / 1e6:,.1f} MB"
    out.print(f"{target}: {count(done.frames, 'frame')} of {pieces}, {size}", markup=False)
