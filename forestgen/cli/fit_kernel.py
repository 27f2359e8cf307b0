"""The command `fit-kernel`: kernels of a measured stand, as a recipe that places new ones."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Optional

import typer

from forestgen.cli.arguments import Overwrite, Quiet, Seed, progress_of
from forestgen.cli.console import Printer, count, seconds

if TYPE_CHECKING:
    from forestgen.api.points import FittedKernel
    from forestgen.community.fitting.envelopes import Envelope
    from forestgen.community.fitting.fit import Fit
    from forestgen.community.fitting.stand import MeasuredStand

_HEAD, _WIDEST = 8, 110  # lines of the recipe that are shown, and characters of a line
_FUNCTIONS = (("K", "pairs"), ("g", "pair correlation"), ("G", "nearest neighbours"))


def fit_kernel(
    points: Annotated[
        Path,
        typer.Argument(
            metavar="FILE",
            help="A CSV file with columns x,y in metres, and perhaps species and radius_m; # begins a comment.",
            show_default=False,
        ),
    ],
    window: Annotated[
        Optional[tuple[float, float, float, float]],  # noqa: UP045
        typer.Option(
            "--window",
            metavar="X0 X1 Y0 Y1",
            help="Where plants were looked for; by default what a comment `window X0 X1 Y0 Y1` in the file says.",
            show_default=False,
        ),
    ] = None,
    species: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            "--species",
            metavar="NAME",
            help="What new plants look like: a species of the library; by default poplar, where the library does not "
            "know the names in the file.",
            show_default=False,
        ),
    ] = None,
    out: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(
            "--out",
            "-o",
            metavar="PATH",
            help="A recipe, NAME.yaml, beside which NAME.png and NAME.json are written; or a folder for all three.",
            show_default=False,
        ),
    ] = None,
    seed: Seed = 0,
    reach_m: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option(
            "--reach-m",
            metavar="METRES",
            help="How far a plant acts; by default a quarter of the window, or six spacings if less.",
            show_default=False,
        ),
    ] = None,
    checks: Annotated[
        int, typer.Option("--checks", metavar="N", min=1, max=1000, help="Test against N sets of 39 new stands.")
    ] = 1,
    founders: Annotated[
        bool,
        typer.Option(
            "--founders/--no-founders",
            help="Where one kernel leaves nearest neighbours far off, let some plants come first and draw the others.",
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
    _print(fitted, Printer(quiet))


def _print(fitted: FittedKernel, say: Printer) -> None:
    fit, stand, files = fitted.fit, fitted.fit.stand, fitted.files
    assert files is not None
    size = f"{stand.size_m[0]:g} x {stand.size_m[1]:g} m"
    placed = count(fit.placed, "new stand")
    say(f"{count(stand.n, 'plant')} in {size}; {placed} placed for the fit, {seconds(fit.took_s)}")
    say()
    lines = fitted.recipe.rstrip().splitlines()
    for line in lines[:_HEAD]:
        say(line if len(line) <= _WIDEST else line[: _WIDEST - 4] + " ...")
    if len(lines) > _HEAD:
        say(f"... and {count(len(lines) - _HEAD, 'more line')} in {files[0]}")
    say()
    for one in fit.checks[0]:
        say(_verdict(one, stand))
    if len(fit.checks) > 1:
        for name, what in _FUNCTIONS:
            say(
                f"{name}, {what}: within at all radii in {fit.held(name)} of {len(fit.checks)} such checks; "
                f"a fortieth new stand in {fit.own_held(name)}"
            )
    for note in fitted.notes:
        say(f"note: {note}")
    say(f"files: {', '.join(str(path) for path in files)}")
    say(f"place one: forestgen simulate {files[0]} --set seed=1")
    say(_in_words(fit))


def _in_words(fit: Fit) -> str:
    """Whether new stands agree with the measured one.

    A function agrees if it stays within its envelope at all distances in half of the sets, or as often as that of one
    more new stand does: at 50 distances even such a one leaves its envelope now and then.
    """
    from forestgen.community.fitting.envelopes import RADII

    sets = len(fit.checks)
    enough = {name: sets / 2 if sets == 1 else min(sets / 2, fit.own_held(name)) for name, _ in _FUNCTIONS}
    off = [what for name, what in _FUNCTIONS if fit.held(name) < enough[name]]
    inside = ", ".join(f"{name} ({what}) in {fit.held(name)} of {sets}" for name, what in _FUNCTIONS)
    verdict = f"differ from the measured one in {' and '.join(off)}" if off else "agree with the measured one"
    more = "; a single set is severe: --checks 20 tells more" if off and sets == 1 else ""
    sort = "fresh set" if sets == 1 else "fresh sets"
    return f"new stands {verdict}: inside the envelope at all {RADII} distances are {inside} {sort}{more}"


def _verdict(one: Envelope, stand: MeasuredStand) -> str:
    from forestgen.community.fitting.envelopes import RADII, STANDS

    whose = "the stand" if len(stand.names) == 1 else _between(one, stand)
    left = one.left
    if not left.any():
        return f"{one.name}(r) of {whose} lies within the envelope of {STANDS} new stands at all {RADII} radii"
    where = ", ".join(f"{r:.3g}" for r in one.radii_m[left][:6]) + (", ..." if left.sum() > 6 else "")
    inside = RADII - int(left.sum())
    return (
        f"{one.name}(r) of {whose} lies within the envelope of {STANDS} new stands at {inside} of {RADII} radii; "
        f"not at r = {where} m"
    )


def _between(one: Envelope, stand: MeasuredStand) -> str:
    i, j = one.species
    return stand.names[i] if i == j else f"{stand.names[i]} to {stand.names[j]}"
