"""The command `simulate`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Optional

import typer

from forestgen.cli.arguments import Overrides, Overwrite, Quiet, RecipePath, Verbose, progress_of
from forestgen.cli.console import Printer, count, seconds

if TYPE_CHECKING:
    from forestgen.api.stands import Stand
    from forestgen.pipeline import Stems

_MOST_NOTES = 5


def simulate(
    recipe: RecipePath,
    out: Annotated[
        Optional[Path],  # noqa: UP045 - typer reads annotations at run time
        typer.Option(
            "--out",
            "-o",
            metavar="DIR",
            help="Folder for the results; by default outputs/NAME-community, ...-2, ...",
            show_default=False,
        ),
    ] = None,
    overrides: Overrides = None,
    map_steps: Annotated[
        Optional[list[int]],  # noqa: UP045
        typer.Option(
            "--map-step",
            metavar="N",
            help="Draw a map of this step; by default of the last. May be repeated.",
            show_default=False,
        ),
    ] = None,
    resume: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(
            "--resume",
            metavar="HISTORY",
            help="Go on from a snapshot of this history.parquet, which the recipe made with fewer steps.",
            show_default=False,
        ),
    ] = None,
    from_step: Annotated[
        Optional[int],  # noqa: UP045
        typer.Option(
            "--from-step", metavar="N", help="Resume from this step; by default from the last.", show_default=False
        ),
    ] = None,
    graphs: Annotated[
        Optional[list[Path]],  # noqa: UP045
        typer.Option(
            "--graph",
            metavar="FILE",
            help="Export the last step's branches, of the model branch_modules: .parquet, .csv, .gltf, .glb, .obj, "
            ".usda, .usdc. May be repeated.",
            show_default=False,
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
    _print(stand, Printer(quiet), verbose=verbose)


def _print(stand: Stand, say: Printer, *, verbose: bool) -> None:
    summary, folder = stand.summary, stand.folder
    kinds = ", ".join(f"{number:,} {name}" for name, number in summary.counts.items())
    dead = f", {summary.standing_dead:,} of them standing dead" if summary.standing_dead else ""
    say(f"{count(summary.plants, 'plant')} ({kinds}){dead}")
    _print_stems(summary.stems, say)
    if stand.biome:
        say(f"biome: {stand.biome}")
    shown = stand.notes if verbose else stand.notes[:_MOST_NOTES]
    for note in shown:
        say(f"note: {note}")
    if len(stand.notes) > len(shown):
        say(f"note: {len(stand.notes) - len(shown)} more notes are in manifest.json")
    say(f"simulated in {seconds(summary.timings_s['community'])}")
    if folder is not None:
        say(f"files: {folder}/ ({', '.join(sorted(path.name for path in folder.iterdir()))})")


def _print_stems(stems: Sequence[Stems], say: Printer) -> None:
    """What a forester counts, by species: living plants over breast height."""
    from forestgen.core.forestry import BREAST_HEIGHT_M

    if not any(one.plants for one in stems):
        return
    rows = [("living", "plants", f"stems over {BREAST_HEIGHT_M} m", "stems per ha")]
    rows += [(one.species, f"{one.plants:,}", f"{one.stems:,}", f"{one.per_ha:,.0f}") for one in stems]
    if len(stems) > 1:
        sums = (sum(one.plants for one in stems), sum(one.stems for one in stems), sum(one.per_ha for one in stems))
        rows.append(("all", *(f"{value:,.0f}" for value in sums)))  # type: ignore[arg-type]
    say.table(rows)
