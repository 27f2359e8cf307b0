"""The command line: parse, call the pipeline, print. Heavy imports wait inside the commands."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Optional

import typer

from forestgen import __version__
from forestgen.cli.console import Bars, errors_for_people
from forestgen.cli.variadic import RadiiCommand


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
    overwrite: Overwrite = False,
) -> None:
    """Simulate a recipe's community only: history, statistics, maps."""
    from forestgen.cli import commands

    commands.simulate(recipe, overrides or [], map_steps or [], resume, from_step, output, overwrite, Bars())


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


@app.command("stats", cls=RadiiCommand, epilog="Example: forestgen stats trees.csv --window 0 50 0 20 --radii 1 2 4")
def point_statistics(
    points: Annotated[
        Path,
        typer.Argument(
            metavar="FILE", help="A CSV file with columns x,y in metres; # begins a comment.", show_default=False
        ),
    ],
    window: Annotated[
        Optional[tuple[float, float, float, float]],  # noqa: UP045
        typer.Option(
            "--window",
            metavar="X0 X1 Y0 Y1",
            help="Where points were looked for; by default what a comment `window X0 X1 Y0 Y1` in the file says.",
            show_default=False,
        ),
    ] = None,
    radii: Annotated[
        Optional[list[str]],  # noqa: UP045
        typer.Option("--radii", metavar="R...", help="Radii of Ripley's K, metres: --radii 1 2 4.", show_default=False),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """How points lie: clustered, random, regular."""
    from forestgen.cli import stats

    stats.stats(points, window, radii or [], as_json)


@app.command("lsystem", epilog="Example: forestgen lsystem koch --steps 2 --format count")
def derive_lsystem(
    file: Annotated[
        Path,
        typer.Argument(metavar="FILE", help="An L-system program: a .lsys or .sys file, or a shipped one's name."),
    ],
    steps: Annotated[
        Optional[int],  # noqa: UP045
        typer.Option(
            "--steps",
            metavar="N",
            help="Derivation steps; by default the file's derivation length.",
            show_default=False,
        ),
    ] = None,
    seed: Annotated[int, typer.Option("--seed", metavar="N", help="Another seed draws other random numbers.")] = 0,
    form: Annotated[
        str,
        typer.Option("--format", metavar="string|json|count", help="Words, their modules as JSON, or their number."),
    ] = "string",
    settings: Annotated[
        Optional[list[str]],  # noqa: UP045
        typer.Option("--set", metavar="NAME=VALUE", help="Another value of a #define, or of an array: A=1,2,3."),
    ] = None,
    most_modules: Annotated[
        int,
        typer.Option(
            "--max-modules", metavar="N", min=1, max=10**9, help="Stop where the words grow longer than this."
        ),
    ] = 50_000_000,
) -> None:
    """Derive an L-system and print the string, or the words of the multiset."""
    from forestgen.cli import lsystem

    lsystem.lsystem(file, steps, seed, form, settings or [], most_modules)


@app.command("doctor", epilog="Example: forestgen doctor")
def check_machine() -> None:
    """Check this machine, and say what to mend."""
    from forestgen.cli import doctor

    raise typer.Exit(doctor.report())


def main() -> None:
    """Entry point."""
    app(prog_name="forestgen")
