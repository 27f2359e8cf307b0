"""The command line: parse, call the pipeline, print. Heavy imports wait inside the commands."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Optional

import typer

from forestgen import __version__
from forestgen.cli.console import Bars, errors_for_people


class _Commands(typer.core.TyperGroup):
    """Runs commands inside our own error handling: typer's would meet Ctrl-C and a closed pipe first."""

    def invoke(self, ctx: Any) -> Any:
        with errors_for_people():
            return super().invoke(ctx)


app = typer.Typer(
    name="forestgen",
    cls=_Commands,
    help="Labelled, physically based images of forests and meadows, from a recipe.",
    epilog="Example: forestgen render recipes/quickstart.yaml",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)

RecipePath = Annotated[Path, typer.Argument(metavar="RECIPE", help="The recipe, a YAML file.", show_default=False)]
Overrides = Annotated[
    Optional[list[str]],  # noqa: UP045 - typer reads annotations at run time
    typer.Option(
        "--set", metavar="KEY=VALUE", help="Override a value of the recipe, such as sky.turbidity=5. May be repeated."
    ),
]
Output = Annotated[
    Optional[Path],  # noqa: UP045
    typer.Option(
        "--output",
        "-o",
        metavar="FOLDER",
        help="Folder for the results; by default outputs/NAME, outputs/NAME-2, ...",
        show_default=False,
    ),
]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace a previous forestgen output in that folder.")]


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"forestgen {__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    pass


@app.command(epilog="Example: forestgen render recipes/quickstart.yaml --set render.samples=64 --images 3")
def render(
    recipe: RecipePath,
    output: Output = None,
    overrides: Overrides = None,
    images: Annotated[
        Optional[int],  # noqa: UP045
        typer.Option(
            "--images",
            metavar="N",
            help="How many images, each drawn anew; short for --set images=N.",
            show_default=False,
        ),
    ] = None,
    threads: Annotated[
        Optional[int],  # noqa: UP045
        typer.Option(
            "--threads",
            metavar="N",
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


@app.command(epilog="Example: forestgen simulate recipes/quickstart.yaml --map-step 20 --map-step 150")
def simulate(
    recipe: RecipePath,
    output: Output = None,
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
    overwrite: Overwrite = False,
) -> None:
    """Simulate a recipe's community only: history, maps, curves."""
    from forestgen.cli import commands

    commands.simulate(recipe, overrides or [], map_steps or [], output, overwrite, Bars())


@app.command(epilog="Example: forestgen plant spruce --height 12 --seed 3 -o spruce.glb")
def plant(
    species: Annotated[
        str, typer.Argument(metavar="SPECIES", help="A species' name (`forestgen models` lists them) or its YAML file.")
    ],
    height_m: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option(
            "--height",
            metavar="METRES",
            help="Height in metres; by default that of a mature plant.",
            show_default=False,
        ),
    ] = None,
    seed: Annotated[int, typer.Option("--seed", metavar="N", help="Another seed is another plant.")] = 0,
    output: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(
            "--output",
            "-o",
            metavar="FILE",
            help="Mesh file: .glb, .ply or .obj; by default outputs/SPECIES.glb. A picture, .png, goes beside it.",
            show_default=False,
        ),
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
        typer.Argument(
            metavar="NAME",
            help="Show the manual page of this model or generator, or this species' or recipe's file.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """List models, generators, species and recipes."""
    from forestgen.cli import commands

    commands.models(name)


@app.command("doctor", epilog="Example: forestgen doctor")
def check_machine() -> None:
    """Check this machine, and say what to mend."""
    from forestgen.cli import doctor

    raise typer.Exit(doctor.report())


def main() -> None:
    """Entry point."""
    app(prog_name="forestgen")
