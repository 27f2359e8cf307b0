"""`forestgen fit-kernel`: kernels of a measured stand, as a recipe that places new ones."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.text import Text

from forestgen.cli.console import Bars, count, output, seconds
from forestgen.community.fitting.envelopes import RADII, STANDS, Envelope
from forestgen.community.fitting.fit import Fit, Settings, fit_stand
from forestgen.community.fitting.recipe_text import document, recipe_text, species_sources
from forestgen.community.fitting.stand import measured_stand
from forestgen.community.point_table import read_points
from forestgen.core.errors import RecipeError
from forestgen.recipe.assets import list_assets
from forestgen.stages.plant_files import FileSet, check_writable

if TYPE_CHECKING:
    from forestgen.community.fitting.stand import MeasuredStand

_RECIPES = (".yaml", ".yml")
_UNEVEN = 0.05
_SPECIES = "poplar"  # what plants look like of which nothing is said
_HEAD, _WIDEST = 8, 110  # lines of the recipe that are shown, and characters of a line
_FUNCTIONS = (("K", "pairs"), ("g", "pair correlation"), ("G", "nearest neighbours"))


def fit_kernel(
    points: Path,
    window: tuple[float, float, float, float] | None,
    species: str | None,
    target: Path | None,
    settings: Mapping[str, Any],
    bars: Bars,
    *,
    overwrite: bool,
) -> None:
    """Fit, test, print, write; `settings` hold fields of `Settings`."""
    library = set(list_assets("species"))
    if species is not None and species not in library:
        raise RecipeError(
            "no such species",
            where="--species",
            expected=", ".join(sorted(library)),
            got=repr(species[:60]),
            hint="a fit says where plants stand; --species, what they look like",
        )
    files = _files(target, points)
    check_writable(files, overwrite=overwrite)
    table = read_points(points, window, marks=True)
    stand, notes = measured_stand(table, str(points))
    notes = [*table.notes, *notes, *_on_species(stand, library, species)]
    _say_notes(notes)  # before the fit: who reads that the window is wrong need not wait for it
    with bars.running():
        fit = fit_stand(stand, Settings(**settings), bars)
    known = len(notes)
    if fit.trend < _UNEVEN:
        notes.append(
            f"the stand is more uneven than new ones (p = {fit.trend:.2g} by counts in squares): its density may "
            "change from place to place, and the fit takes it as constant"
        )
    if fit.nursery.founders:
        notes.append(
            f"one kernel leaves the nearest neighbours far off (loss {fit.plain.losses[-1]:.3g}); "
            f"{fit.nursery.founders} founders that come first leave {fit.matched.losses[-1]:.3g}"
        )
    text = recipe_text(fit, species_sources(stand, library, species or _SPECIES), points.name)
    _write(files, text, fit, points, notes, overwrite=overwrite)
    _print(fit, text, files, notes[known:])


def _on_species(stand: MeasuredStand, library: set[str], species: str | None) -> list[str]:
    """A note if plants get a look that nobody asked for."""
    strange = [name for name in stand.names if name not in library]
    if species is not None or not strange:
        return []
    who = ", ".join(strange) if any(strange) else "new plants"
    return [f"{who}: drawn as {_SPECIES}, since no --species says what they look like; places do not depend on it"]


def _files(target: Path | None, points: Path) -> tuple[Path, Path, Path]:
    """Recipe, picture and numbers: in a folder, or of the name of a recipe."""
    if target is None:
        target = Path("outputs") / f"{points.stem}-kernel.yaml"
    if target.suffix.lower() in _RECIPES:
        return target, target.with_suffix(".png"), target.with_suffix(".json")
    return target / "kernel.yaml", target / "fit.png", target / "fit.json"


def _write(
    files: tuple[Path, Path, Path], text: str, fit: Fit, points: Path, notes: list[str], *, overwrite: bool
) -> None:
    from forestgen.community.fitting.plot_fit import fit_picture

    recipe, picture, numbers = files
    content = json.dumps(document(fit, points.name, notes), indent=1, allow_nan=False) + "\n"
    image = fit_picture(fit, points.stem)
    with FileSet(overwrite=overwrite) as written:
        written.write(recipe, text.encode())
        written.write(picture, image)
        written.write(numbers, content.encode())


def _say(out: Console, text: str) -> None:
    out.print(Text(text))  # names may hold brackets, which are no markup


def _say_notes(notes: list[str]) -> None:
    for note in notes:
        _say(output(), f"note: {note}")


def _print(fit: Fit, text: str, files: tuple[Path, Path, Path], notes: list[str]) -> None:
    out, stand = output(), fit.stand
    size = f"{stand.size_m[0]:g} x {stand.size_m[1]:g} m"
    _say(out, f"{count(stand.n, 'plant')} in {size}; {count(fit.placed, 'new stand')} placed for the fit, "
              f"{seconds(fit.took_s)}")  # fmt: skip
    _say(out, "")
    lines = text.rstrip().splitlines()
    for line in lines[:_HEAD]:
        _say(out, line if len(line) <= _WIDEST else line[: _WIDEST - 4] + " ...")
    if len(lines) > _HEAD:
        _say(out, f"... and {count(len(lines) - _HEAD, 'more line')} in {files[0]}")
    _say(out, "")
    for one in fit.checks[0]:
        _say(out, _verdict(one, stand))
    if len(fit.checks) > 1:
        for name, what in _FUNCTIONS:
            _say(
                out,
                f"{name}, {what}: within at all radii in {fit.held(name)} of {len(fit.checks)} such checks; "
                f"a fortieth new stand in {fit.own_held(name)}",
            )
    _say_notes(notes)
    _say(out, f"files: {', '.join(str(path) for path in files)}")
    _say(out, f"place one: forestgen simulate {files[0]} --set seed=1")
    _say(out, _in_words(fit))


def _in_words(fit: Fit) -> str:
    """Whether new stands agree with the measured one.

    A function agrees if it stays within its envelope at all distances in half of the sets, or as often as that of one
    more new stand does: at 50 distances even such a one leaves its envelope now and then.
    """
    sets = len(fit.checks)
    enough = {name: sets / 2 if sets == 1 else min(sets / 2, fit.own_held(name)) for name, _ in _FUNCTIONS}
    off = [what for name, what in _FUNCTIONS if fit.held(name) < enough[name]]
    inside = ", ".join(f"{name} ({what}) in {fit.held(name)} of {sets}" for name, what in _FUNCTIONS)
    verdict = f"differ from the measured one in {' and '.join(off)}" if off else "agree with the measured one"
    more = "; a single set is severe: --checks 20 tells more" if off and sets == 1 else ""
    sort = "fresh set" if sets == 1 else "fresh sets"
    return f"new stands {verdict}: inside the envelope at all {RADII} distances are {inside} {sort}{more}"


def _verdict(one: Envelope, stand: MeasuredStand) -> str:
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
