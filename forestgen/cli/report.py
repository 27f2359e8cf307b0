"""`forestgen report`: a data set on one page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Optional

import typer

from forestgen.cli.console import output


def report(
    folder: Annotated[
        Path,
        typer.Argument(metavar="DIR", help="A folder that batch, merge or render wrote.", show_default=False),
    ],
    target: Annotated[
        Optional[Path],  # noqa: UP045 - typer reads annotations at run time
        typer.Option(
            "--out", "-o", metavar="FILE", help="The page; by default report.html in DIR.", show_default=False
        ),
    ] = None,
) -> None:
    """Show a data set on one HTML page: gallery, balance, coverage, failures, timings.

    The page holds all it needs: it can be sent by mail and opened without a network.
    """
    from forestgen.dataset.report.page import REPORT_NAME, write_report

    page = target if target is not None else folder / REPORT_NAME
    write_report(folder, page)
    output().print(f"file: {page}", markup=False)
