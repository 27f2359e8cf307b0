"""The command `simulate`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from forestgen.cli.arguments import Overrides, Overwrite, Quiet, RecipePath, Verbose, progress_of
from forestgen.cli.console import Printer


def simulate(
    recipe: RecipePath,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", "-o", metavar="DIR", help="Folder for the results; by default outputs/NAME-community, ...-2, ..."
        ),
    ] = None,
    overrides: Overrides = None,
    map_steps: Annotated[
        list[int] | None,
        typer.Option(
            "--map-step", metavar="N", help="Draw a map of this step; by default of the last. May be repeated."
        ),
    ] = None,
    resume: Annotated[
        Path | None,
        typer.Option(
            "--resume",
            metavar="HISTORY",
            help="Go on from a snapshot of this history.parquet, which the recipe made with fewer steps.",
        ),
    ] = None,
    from_step: Annotated[
        int | None, typer.Option("--from-step", metavar="N", help="Resume from this step; by default from the last.")
    ] = None,
    graphs: Annotated[
        list[Path] | None,
        typer.Option(
            "--graph",
            metavar="FILE",
            help="Export the last step's branches, of a model whose plants have some: .parquet, .csv, .gltf, .glb, "
            ".obj, .usda, .usdc. May be repeated.",
        ),
    ] = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Simulate a recipe's plant community only: history, statistics, maps."""
    from forestgen import load
    from forestgen.api.rendering import free_folder

    loaded = load(recipe, set=overrides or ())
    stand = loaded.simulate(
        out or free_folder(Path("outputs") / f"{recipe.stem}-community"),
        map_steps=map_steps or (),
        resume=resume,
        from_step=from_step,
        graphs=graphs or (),
        overwrite=overwrite,
        progress=progress_of(quiet),
    )
    say, folder = Printer(quiet), stand.folder
    say("\n".join(stand.summary.lines(verbose=verbose)))
    if folder is not None:
        say(f"files: {folder}/ ({', '.join(sorted(path.name for path in folder.iterdir()))})")
