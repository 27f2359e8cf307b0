"""The command line: parse, call the pipeline, print. Heavy imports wait inside the commands."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Optional

import typer

from forestgen import __version__
from forestgen.cli.arguments import Overrides, RecipePath
from forestgen.cli.batch import batch
from forestgen.cli.calibrate import calibrate
from forestgen.cli.completion import add_completion, complete_names
from forestgen.cli.console import Bars, errors_for_people
from forestgen.cli.fit_kernel import fit_kernel
from forestgen.cli.help_pages import show_plainly
from forestgen.cli.labels import app as labels
from forestgen.cli.light import PointsCommand, light
from forestgen.cli.merge import merge
from forestgen.cli.pack import pack
from forestgen.cli.report import report
from forestgen.cli.suggestions import options_suggested
from forestgen.cli.variadic import RadiiCommand
from forestgen.cli.verify import verify
from forestgen.cli.weather import weather


class _Commands(typer.core.TyperGroup):
    """Runs commands inside our own error handling: typer's would meet Ctrl-C and a closed pipe first."""

    def __init__(self, **arguments: Any) -> None:
        super().__init__(**arguments)
        show_plainly(self)
        complete_names(self)

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        with options_suggested():
            return super().parse_args(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        with errors_for_people(), options_suggested():
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
    allowed: Annotated[
        Optional[list[Path]],  # noqa: UP045
        typer.Option(
            "--allow-folder",
            metavar="DIR",
            help="Let recipes read from this folder too, not only from their own. Before the command's name; may be "
            "repeated.",
            show_default=False,
        ),
    ] = None,
) -> None:
    if allowed:
        from forestgen.recipe.paths import allow_folders

        allow_folders(allowed)


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


app.command("batch", epilog="Example: forestgen batch recipes/training_set.yaml --count 1000 --out outputs/forests")(
    batch
)

app.command("report", epilog="Example: forestgen report outputs/forests")(report)

app.command("verify", epilog="Example: forestgen verify outputs/forests --rerender 3")(verify)

app.command("merge", epilog="Example: forestgen merge outputs/part-1 outputs/part-2 --out outputs/forests")(merge)

app.command("pack", epilog="Example: forestgen pack outputs/forests --format webdataset --out outputs/shards")(pack)


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
) -> None:
    """Simulate a recipe's community only: history, statistics, maps."""
    from forestgen.cli import commands

    commands.simulate(
        recipe, overrides or [], map_steps or [], resume, from_step, graphs or [], output, overwrite, Bars()
    )


@app.command(epilog="Example: forestgen plant spruce --height-m 12 --seed 3 --out tree.glb --out tree.png")
def plant(
    species: Annotated[
        Optional[str],  # noqa: UP045
        typer.Argument(metavar="SPECIES", help="A species' name, see --list, or its YAML file.", show_default=False),
    ] = None,
    list_species: Annotated[bool, typer.Option("--list", help="List the species that come with forestgen.")] = False,
    height_m: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option("--height-m", metavar="METRES", help="By default that of a mature plant.", show_default=False),
    ] = None,
    seed: Annotated[int, typer.Option("--seed", metavar="N", help="Another seed is another plant.")] = 0,
    outputs: Annotated[
        Optional[list[Path]],  # noqa: UP045
        typer.Option(
            "--out",
            "-o",
            metavar="FILE",
            help="A mesh: .glb, .ply, .obj (with its .mtl), .usd, .usda, .usdc, .usdz; or a picture: .png. May be "
            "repeated; by default outputs/SPECIES.glb and .png.",
            show_default=False,
        ),
    ] = None,
    count: Annotated[
        int, typer.Option("--count", metavar="N", help="So many plants, of seeds from --seed on: tree-0001.glb, ...")
    ] = 1,
    frames: Annotated[
        Optional[int],  # noqa: UP045
        typer.Option(
            "--frames",
            metavar="N",
            help="So many poses in the wind, of a species of the generator strands: tree-0001.glb, ...",
            show_default=False,
        ),
    ] = None,
    frames_per_s: Annotated[float, typer.Option("--frames-per-s", metavar="N", help="Pace of the frames.")] = 12.0,
    detail: Annotated[
        Optional[int],  # noqa: UP045
        typer.Option(
            "--detail",
            metavar="0..2",
            min=0,
            max=2,
            help="How finely leaves and flowers are drawn: 2 for close views; by default as the species' file says.",
            show_default=False,
        ),
    ] = None,
    wood_triangles: Annotated[
        Optional[int],  # noqa: UP045
        typer.Option(
            "--wood-triangles",
            metavar="N",
            help="In mesh files, wood of about N triangles with one baked texture, for real-time programs.",
            show_default=False,
        ),
    ] = None,
    size_px: Annotated[
        tuple[int, int], typer.Option("--size-px", metavar="W H", help="Size of the picture.", show_default="540 720")
    ] = (
        540,
        720,
    ),
    samples: Annotated[
        int, typer.Option("--samples", metavar="N", min=1, max=65536, help="Light paths a pixel of the picture.")
    ] = 32,
    distance_m: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option(
            "--distance-m",
            metavar="METRES",
            help="How far the camera stands from the plant; by default as far as a normal lens asks for.",
            show_default=False,
        ),
    ] = None,
    look_at_m: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option(
            "--look-at-m",
            metavar="METRES",
            help="Look at this height through a normal lens, not at the whole plant.",
            show_default=False,
        ),
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace existing files.")] = False,
) -> None:
    """Grow one plant: mesh, picture, numbers."""
    from forestgen.cli import plants

    if list_species:
        plants.library()
        return
    if species is None:
        raise typer.BadParameter("name a species, or give --list", param_hint="SPECIES")
    plants.plant(
        species,
        outputs or [],
        Bars(),
        overwrite=overwrite,
        growth={
            "height_m": height_m,
            "seed": seed,
            "count": count,
            "frames": frames,
            "frames_per_s": frames_per_s,
            "detail": detail,
            "wood_triangles": wood_triangles,
        },
        view={"size_px": size_px, "samples": samples, "distance_m": distance_m, "look_at_m": look_at_m},
    )


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


app.command("fit-kernel", epilog="Example: forestgen fit-kernel trees.csv --species poplar -o outputs/trees.yaml")(
    fit_kernel
)


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


app.add_typer(labels)

app.command("calibrate", cls=PointsCommand, epilog="Example: forestgen calibrate recipes/quickstart.yaml")(calibrate)

app.command("light", cls=PointsCommand, epilog="Example: forestgen light recipes/quickstart.yaml --at 60 40 1.5")(light)

app.command("weather", epilog="Example: forestgen weather recipes/weather_cumulus.yaml --picture sky.png")(weather)


add_completion(app)


@app.command("doctor", epilog="Example: forestgen doctor")
def check_machine() -> None:
    """Check this machine, and say what to mend."""
    from forestgen.cli import doctor

    raise typer.Exit(doctor.report())


def main() -> None:
    """Entry point."""
    app(prog_name="forestgen")
