"""The commands about where plants stand: `simulate`, `stats`, `fit-kernel`; and `lsystem`."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

from forestgen.cli.arguments import (
    Json,
    Overrides,
    Overwrite,
    Quiet,
    RecipePath,
    Seed,
    Verbose,
    Window,
    argument,
    option,
    progress_of,
)
from forestgen.cli.console import Printer


def simulate(
    recipe: RecipePath,
    out: Annotated[
        Path | None,
        option("--out -o DIR", "Folder for the results; by default outputs/NAME-community, ...-2, ..."),
    ] = None,
    overrides: Overrides = None,
    map_steps: Annotated[
        list[int] | None,
        option("--map-step N", "Draw a map of this step; by default of the last. May be repeated."),
    ] = None,
    resume: Annotated[
        Path | None,
        option(
            "--resume HISTORY",
            "Go on from a snapshot of this history.parquet, which the recipe made with fewer steps.",
        ),
    ] = None,
    from_step: Annotated[
        int | None, option("--from-step N", "Resume from this step; by default from the last.")
    ] = None,
    graphs: Annotated[
        list[Path] | None,
        option(
            "--graph FILE",
            "Export the last step's branches, of a model whose plants have some: .parquet, .csv, .gltf, .glb, "
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

    stand = load(recipe, set=overrides).simulate(
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


def stats(
    points: Annotated[
        Path, argument("FILE", "A CSV file with columns x,y in metres; # begins a comment.", show_default=False)
    ],
    window: Window = None,
    radii: Annotated[list[str] | None, option("--radii R...", "Radii of Ripley's K, metres: --radii 1 2 4.")] = None,
    as_json: Json = False,
) -> None:
    """How points lie: clustered, random, regular."""
    from forestgen import stats as measure

    measured, say = measure(points, window=window, radii=radii or ()), Printer()
    if as_json:
        say.json(measured.as_dict())
    else:
        say(f"{points}: {measured}")


def fit_kernel(
    points: Annotated[
        Path,
        argument(
            "FILE",
            "A CSV file with columns x,y in metres, and perhaps species and radius_m; # begins a comment.",
            show_default=False,
        ),
    ],
    window: Window = None,
    species: Annotated[
        str | None,
        option(
            "--species NAME",
            "What new plants look like: a species of the library; by default poplar, where the library does not "
            "know the names in the file.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        option(
            "--out -o PATH",
            "A recipe, NAME.yaml, beside which NAME.png and NAME.json are written; or a folder for all three.",
        ),
    ] = None,
    seed: Seed = 0,
    reach_m: Annotated[
        float | None,
        option(
            "--reach-m METRES", "How far a plant acts; by default a quarter of the window, or six spacings if less."
        ),
    ] = None,
    checks: Annotated[int, option("--checks N", "Test against N sets of 39 new stands.", min=1, max=1000)] = 1,
    founders: Annotated[
        bool,
        option(
            "--founders/--no-founders",
            "Where one kernel leaves nearest neighbours far off, let some plants come first and draw the others.",
        ),
    ] = True,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Fit deformation kernels to a measured stand: a recipe that places new stands like it."""
    import forestgen

    fitted = forestgen.fit_kernel(
        points,
        window=window,
        species=species,
        out=out or Path("outputs") / f"{points.stem}-kernel.yaml",
        seed=seed,
        reach_m=reach_m,
        checks=checks,
        founders=founders,
        overwrite=overwrite,
        progress=progress_of(quiet),
    )
    Printer(quiet)(str(fitted))


def lsystem(
    file: Annotated[Path, argument("FILE", "An L-system program: a .lsys or .sys file, or a shipped one's name.")],
    steps: Annotated[
        int | None, option("--steps N", "Derivation steps; by default the file's derivation length.")
    ] = None,
    seed: Seed = 0,
    form: Annotated[
        str, option("--format string|json|count", "Words, their modules as JSON, or their number.")
    ] = "string",
    settings: Annotated[
        list[str] | None, option("--set NAME=VALUE", "Another value of a #define, or of an array: A=1,2,3.")
    ] = None,
    max_modules: Annotated[
        int, option("--max-modules N", "Stop where the words grow longer than this.", min=1, max=10**9)
    ] = 50_000_000,
) -> None:
    """Derive an L-system and print the string, or the words of the multiset."""
    from forestgen import derive
    from forestgen.core.errors import RecipeError

    if form not in ("string", "json", "count"):
        raise RecipeError("no such format", where="--format", expected="string, json, count", got=form)
    words = derive(file, steps, seed=seed, set=settings, max_modules=max_modules)
    if form == "count":
        sys.stdout.write(f"{words.modules}\n")
    elif form == "json":
        sys.stdout.write(json.dumps(words.as_dict()) + "\n")
    else:
        sys.stdout.writelines(word + "\n" for word in words.text)
