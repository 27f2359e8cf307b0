"""The command line: parse, call the API (`import forestgen`), print. Heavy imports wait inside the commands."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from forestgen.cli.communities import fit_kernel, lsystem, simulate, stats
from forestgen.cli.console import errors_for_people, names_of
from forestgen.cli.datasets import doctor, merge, models, pack, report, schema, validate, verify
from forestgen.cli.instruments import calibrate, light, measure, stand, weather
from forestgen.cli.parsing import NumbersCommand, add_completion, options_suggested, show_plainly, with_options
from forestgen.cli.plant import plant
from forestgen.cli.render import batch, render
from forestgen.core import __version__


class _Commands(typer.core.TyperGroup):
    """Runs commands inside our own error handling: typer's would meet Ctrl-C and a closed pipe first."""

    def __init__(self, **arguments: Any) -> None:
        super().__init__(**arguments)
        show_plainly(self)

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        with options_suggested():
            return super().parse_args(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        with errors_for_people(lambda: self._names(ctx)), options_suggested():
            return super().invoke(ctx)

    def _names(self, ctx: Any) -> dict[str, str]:
        """Options of the command that is running, by their parameters."""
        command = self.commands.get(ctx.invoked_subcommand or "")
        return {} if command is None else names_of(command)


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


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"forestgen {__version__}")
        raise typer.Exit


_ALLOW = "Let recipes read from this folder too, not only from their own. Before the command's name; may be repeated."


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", help="Show the version.", callback=_version, is_eager=True)
    ] = False,
    allowed: Annotated[list[Path] | None, typer.Option("--allow-folder", metavar="DIR", help=_ALLOW)] = None,
) -> None:
    if allowed:
        from forestgen.recipe.assets import allow_folders

        allow_folders(allowed)


_COMMANDS: tuple[tuple[Callable[..., None], str], ...] = (
    (render, "render recipes/quickstart.yaml --set render.samples=64 --count 3"),
    (batch, "batch recipes/training_set.yaml --count 1000 --out outputs/forests"),
    (verify, "verify outputs/forests --rerender 3"),
    (report, "report outputs/forests"),
    (pack, "pack outputs/forests --format webdataset --out outputs/shards"),
    (merge, "merge outputs/part-1 outputs/part-2 --out outputs/forests"),
    (simulate, "simulate recipes/quickstart.yaml --map-step 20 --map-step 150"),
    (stand, "stand recipes/mixed_stand.yaml --out outputs/mixed_stand-table"),
    (plant, "plant spruce --height-m 12 --seed 3 --out tree.glb --out tree.png"),
    (validate, "validate recipes/quickstart.yaml --set seed=3"),
    (models, "models multiset_lsystem"),
    (schema, "schema > recipe.schema.json"),
    (stats, "stats trees.csv --window 0 50 0 20 --radii 1 2 4"),
    (fit_kernel, "fit-kernel trees.csv --species poplar --out outputs/trees.yaml"),
    (lsystem, "lsystem koch --steps 2 --format count"),
    (light, "light recipes/quickstart.yaml --at 60 40 1.5"),
    (weather, "weather recipes/weather_cumulus.yaml --picture sky.png"),
    (calibrate, "calibrate recipes/quickstart.yaml"),
    (measure, 'measure light_meter recipes/quickstart.yaml --key "at=[[60, 40, 1.5]]"'),
    (doctor, "doctor"),
)
for _function, _example in _COMMANDS:
    _name, _epilog = _function.__name__.replace("_", "-"), f"Example: forestgen {_example}"
    app.command(_name, cls=NumbersCommand, epilog=_epilog)(with_options(_function))
add_completion(app)


def main() -> None:
    """Entry point."""
    with errors_for_people():  # those of help pages, which are written before a command begins
        app(prog_name="forestgen")
