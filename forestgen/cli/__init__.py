"""The command line: parse, call the pipeline, print. Heavy imports wait inside the commands."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Optional

import typer

from forestgen import __version__
from forestgen.cli.console import Bars, errors_for_people

app = typer.Typer(
    name="forestgen",
    help="Labelled, physically based images of forests and meadows, from a recipe.\n\n"
    "Example: forestgen render recipes/quickstart.yaml",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)

RecipePath = Annotated[Path, typer.Argument(metavar="RECIPE", help="The recipe, a YAML file.", show_default=False)]
Overrides = Annotated[
    Optional[list[str]],  # noqa: UP045 - typer reads annotations at run time
    typer.Option("--set", metavar="KEY=VALUE", help="Override a value of the recipe: --set sky.turbidity=5"),
]
Output = Annotated[
    Optional[Path],  # noqa: UP045
    typer.Option("--output", "-o", help="Folder for the results; by default outputs/NAME, NAME-2, ...", show_default=False),
]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace a previous forestgen output in that folder.")]


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"forestgen {__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")] = False,
) -> None:
    pass


@app.command(epilog="Example: forestgen render recipes/quickstart.yaml --set render.samples=64 --images 3")
def render(
    recipe: RecipePath,
    output: Output = None,
    overrides: Overrides = None,
    images: Annotated[
        Optional[int],  # noqa: UP045
        typer.Option("--images", min=1, help="How many images, each drawn anew; like --set images=N.", show_default=False),
    ] = None,
    threads: Annotated[
        Optional[int],  # noqa: UP045
        typer.Option(
            "--threads",
            min=1,
            max=4096,
            help="Worker threads; by default all cores. Results do not depend on it.",
            show_default=False,
        ),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Render a recipe: images, masks, tables."""
    from forestgen.cli import commands

    extra = [f"images={images}"] if images is not None else []
    commands.render(recipe, [*(overrides or []), *extra], output, overwrite, threads, Bars())


@app.command(epilog="Example: forestgen simulate recipes/quickstart.yaml --map-step 20 --map-step 300")
def simulate(
    recipe: RecipePath,
    output: Output = None,
    overrides: Overrides = None,
    map_steps: Annotated[
        Optional[list[int]],  # noqa: UP045
        typer.Option("--map-step", help="Draw a map of this step; by default of the last. May be repeated."),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Simulate a recipe's community only."""
    from forestgen.cli import commands

    commands.simulate(recipe, overrides or [], map_steps or [], output, overwrite, Bars())


@app.command(epilog="Example: forestgen plant spruce --height 12 --seed 3 -o spruce.glb")
def plant(
    species: Annotated[str, typer.Argument(help="A species' name (see `forestgen models`) or its YAML file.")],
    height_m: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option("--height", help="Height in metres; by default that of a mature plant.", show_default=False),
    ] = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Another seed is another plant.")] = 0,
    output: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option("--output", "-o", help="Mesh file: .glb, .ply or .obj; a picture is put beside it.", show_default=False),
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace existing files.")] = False,
) -> None:
    """Grow one plant: mesh, picture, numbers."""
    from forestgen.cli import commands

    commands.plant(species, height_m, seed, output, overwrite, Bars())


@app.command(epilog="Example: forestgen validate recipes/quickstart.yaml --set seed=3")
def validate(recipe: RecipePath, overrides: Overrides = None) -> None:
    """Check a recipe without making anything."""
    from forestgen.cli import commands

    commands.validate(recipe, overrides or [])


@app.command(epilog="Example: forestgen schema > recipe.schema.json")
def schema() -> None:
    """Print the JSON Schema of recipes, for editors."""
    from forestgen.cli import commands

    commands.schema()


@app.command(epilog="Example: forestgen models multiset_lsystem")
def models(
    name: Annotated[
        Optional[str],  # noqa: UP045
        typer.Argument(help="Show the manual page of this model or generator.", show_default=False),
    ] = None,
) -> None:
    """List models, generators, species and recipes."""
    from forestgen.cli import commands

    commands.models(name)


@app.command(epilog="Example: forestgen doctor")
def doctor() -> None:
    """Check this machine, and say what to mend."""
    from forestgen.cli import doctor as doctor_module

    raise typer.Exit(doctor_module.report())


def main() -> None:
    """Entry point."""
    with errors_for_people():
        app(prog_name="forestgen")
    sys.exit(0)
