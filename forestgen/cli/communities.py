"""The commands about where plants stand: `simulate`, `stats`, `fit-kernel`; and `lsystem`."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from forestgen.cli.console import Printer

Window = tuple[float, float, float, float]


def simulate(
    recipe: Path,
    out: Path | None = None,
    set_: list[str] | None = None,
    map_steps: list[int] | None = None,
    resume: Path | None = None,
    from_step: int | None = None,
    graphs: list[Path] | None = None,
    overwrite: bool = False,
    quiet: bool = False,
    verbose: bool = False,
) -> None:
    """Simulate a recipe's plant community only: history, statistics, maps.

    --out -o DIR  Folder for the results; by default outputs/NAME-community, ...-2, ...
    --map-step N  Draw a map of this step; by default of the last. May be repeated.
    --resume HISTORY  Go on from a snapshot of this history.parquet, which the recipe made with fewer steps.
    --from-step N  Resume from this step; by default from the last.
    --graph FILE  Export the last step's branches, of a model whose plants have some: .parquet, .csv, .gltf, .glb,
        .obj, .usda, .usdc. May be repeated.
    """
    from forestgen import load
    from forestgen.api.rendering import free_folder

    stand = load(recipe, set=set_).simulate(
        out or free_folder(Path("outputs") / f"{recipe.stem}-community"),
        map_steps=map_steps or (),
        resume=resume,
        from_step=from_step,
        graphs=graphs or (),
        overwrite=overwrite,
        progress=not quiet,
    )
    say, folder = Printer(quiet), stand.folder
    say("\n".join(stand.summary.lines(verbose=verbose)))
    if folder is not None:
        say(f"files: {folder}/ ({', '.join(sorted(path.name for path in folder.iterdir()))})")


def stats(points: Path, window: Window | None = None, radii: list[str] | None = None, json_: bool = False) -> None:
    """How points lie: clustered, random, regular.

    FILE  A CSV file with columns x,y in metres; # begins a comment.
    --radii R...  Radii of Ripley's K, metres: --radii 1 2 4.
    """
    from forestgen import stats as measure

    measured, say = measure(points, window=window, radii=radii or ()), Printer()
    if json_:
        say.json(measured.as_dict())
    else:
        say(f"{points}: {measured}")


def fit_kernel(
    points: Path,
    window: Window | None = None,
    species: str | None = None,
    out: Path | None = None,
    seed: int = 0,
    reach_m: float | None = None,
    checks: int = 1,
    founders: bool = True,
    overwrite: bool = False,
    quiet: bool = False,
) -> None:
    """Fit deformation kernels to a measured stand: a recipe that places new stands like it.

    FILE  A CSV file with columns x,y in metres, and perhaps species and radius_m; # begins a comment.
    --species NAME  What new plants look like: a species of the library; by default poplar, where the library does not
        know the names in the file.
    --out -o PATH  A recipe, NAME.yaml, beside which NAME.png and NAME.json are written; or a folder for all three.
    --reach-m METRES  How far a plant acts; by default a quarter of the window, or six spacings if less.
    --checks N  Test against N sets of 39 new stands. [1 to 1000]
    --founders/--no-founders  Where one kernel leaves nearest neighbours far off, let some plants come first and draw
        the others.
    """
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
        progress=not quiet,
    )
    Printer(quiet)(str(fitted))


def lsystem(
    file: Path,
    steps: int | None = None,
    seed: int = 0,
    format_: str = "string",
    set_: list[str] | None = None,
    max_modules: int = 50_000_000,
) -> None:
    """Derive an L-system and print the string, or the words of the multiset.

    FILE  An L-system program: a .lsys or .sys file, or a shipped one's name.
    --steps N  Derivation steps; by default the file's derivation length.
    --format string|json|count  Words, their modules as JSON, or their number.
    --set NAME=VALUE  Another value of a #define, or of an array: A=1,2,3.
    --max-modules N  Stop where the words grow longer than this. [1 to 1000000000]
    """
    from forestgen import derive
    from forestgen.core.errors import RecipeError

    if format_ not in ("string", "json", "count"):
        raise RecipeError("no such format", where="--format", expected="string, json, count", got=format_)
    words = derive(file, steps, seed=seed, set=set_, max_modules=max_modules)
    if format_ == "count":
        sys.stdout.write(f"{words.modules}\n")
    elif format_ == "json":
        sys.stdout.write(json.dumps(words.as_dict()) + "\n")
    else:
        sys.stdout.writelines(word + "\n" for word in words.text)
