"""Point patterns: how measured plants stand, and kernels that place new ones like them."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from forestgen.api.display import display_of
from forestgen.core.arguments import MOST_SEEDS, PathLike, listed, number_of, path_of, text_of, whole_of
from forestgen.core.errors import RecipeError
from forestgen.core.figures import count
from forestgen.core.progress import Progress
from forestgen.dataset.files import FileSet, check_writable
from forestgen.recipe.assets import list_assets

if TYPE_CHECKING:
    from forestgen.community.fitting.fit import Fit
    from forestgen.community.point_statistics import PointStatistics

Bounds = tuple[float, float, float, float]
_RECIPES = (".yaml", ".yml")
_UNEVEN = 0.05
_HEAD, _WIDEST = 8, 110  # lines of a recipe that are shown, and characters of a line
_SPECIES = "poplar"  # what plants look like of which nothing is said


def stats(
    points: PathLike, *, window: Bounds | None = None, radii: str | Sequence[float | str] = ()
) -> PointStatistics:
    """Measure whether points are clustered, random or regular.

    Parameters
    ----------
    points : a CSV file with columns x,y in metres; # begins a comment.
    window : x0, x1, y0, y1 where points were looked for; by default what a comment in the file says.
    radii : of Ripley's K, metres; by default ten.

    Raises
    ------
    RecipeError, ResourceError
    """
    from forestgen.community.point_statistics import measure_file

    return measure_file(path_of(points, "points"), window, listed(radii, "radii", "numbers"))


@dataclass(frozen=True, repr=False)
class FittedKernel:
    """Kernels of a measured stand."""

    fit: Fit
    recipe: str  # YAML, which places new stands
    files: tuple[Path, Path, Path] | None  # recipe, picture, numbers
    notes_before: tuple[str, ...]  # on the measured stand
    notes_after: tuple[str, ...]  # on the fit

    @property
    def notes(self) -> tuple[str, ...]:
        return (*self.notes_before, *self.notes_after)

    def __str__(self) -> str:
        return "\n".join(self.lines())

    def __repr__(self) -> str:
        where = "" if self.files is None else f", {self.files[0]}"
        return f"<FittedKernel: {count(self.fit.stand.n, 'plant')}{where}>"

    def lines(self) -> Iterator[str]:
        """For people: the recipe's first lines, how new stands compare with the measured one, notes, files."""
        from forestgen.community.fitting import report

        yield report.head(self.fit)
        yield ""
        lines = self.recipe.rstrip().splitlines()
        for line in lines[:_HEAD]:
            yield line if len(line) <= _WIDEST else line[: _WIDEST - 4] + " ..."
        if len(lines) > _HEAD:
            where = "recipe" if self.files is None else self.files[0]
            yield f"... and {count(len(lines) - _HEAD, 'more line')} in {where}"
        yield ""
        yield from report.check_lines(self.fit)
        for note in self.notes:
            yield f"note: {note}"
        if self.files is not None:
            yield f"files: {', '.join(str(path) for path in self.files)}"
            yield f"place one: forestgen simulate {self.files[0]} --set seed=1"
        yield report.in_words(self.fit)


def fit_kernel(
    points: PathLike,
    *,
    window: Bounds | None = None,
    species: str | None = None,
    out: PathLike | None = None,
    seed: int = 0,
    reach_m: float | None = None,
    checks: int = 1,
    founders: bool = True,
    overwrite: bool = False,
    progress: bool | Progress | None = None,
) -> FittedKernel:
    """Fit deformation kernels to a measured stand: a recipe that places new stands like it.

    Parameters
    ----------
    points : a CSV file with columns x,y in metres, and perhaps species and radius_m.
    window : x0, x1, y0, y1 where plants were looked for; by default what a comment in the file says.
    species : what new plants look like; by default poplar where the library does not know the names in the file.
    out : a recipe NAME.yaml, beside which NAME.png and NAME.json are written, or a folder; None: nothing is written.
    seed : another seed fits by other new stands.
    reach_m : how far a plant acts; by default a quarter of the window, or six spacings if less.
    checks : test against so many sets of 39 new stands.
    founders : where one kernel leaves nearest neighbours far off, let some plants come first.
    overwrite : replace existing files.

    Raises
    ------
    RecipeError, OutputError
    """
    from forestgen.community.fitting.fit import fit_stand
    from forestgen.community.fitting.report import recipe_text, species_sources
    from forestgen.community.fitting.stand import measured_stand
    from forestgen.community.point_statistics import read_points

    source = path_of(points, "points")
    files = None if out is None else fit_files(path_of(out, "out", output=True))
    checks, seed = whole_of(checks, "checks", 1, 1000), whole_of(seed, "seed", 0, MOST_SEEDS)
    reach_m = None if reach_m is None else number_of(reach_m, "reach_m")
    library = set(list_assets("species"))
    _check_species(species, library)
    if files is not None:
        check_writable(files, overwrite=overwrite)
    table = read_points(source, window, marks=True)
    stand, notes = measured_stand(table, str(source))
    before = [*table.notes, *notes]
    strange = [name for name in stand.names if name not in library]
    if species is None and strange:
        who, why = ", ".join(strange) if any(strange) else "new plants", "since no `species` says what they look like"
        before.append(f"{who}: drawn as {_SPECIES}, {why}; places do not depend on it")
    with (display := display_of(progress)).running():
        for note in before:  # who reads that the window is wrong need not wait for the fit
            display.say(f"note: {note}")
        fit = fit_stand(stand, display, seed=seed, checks=checks, reach_m=reach_m, founders=founders)
    text = recipe_text(fit, species_sources(stand, library, species or _SPECIES), source.name)
    fitted = FittedKernel(fit, text, files, tuple(before), tuple(_on_fit(fit)))
    if files is not None:
        _write(files, fitted, source, overwrite=overwrite)
    return fitted


def _check_species(species: str | None, library: set[str]) -> None:
    if species is not None and text_of(species, "species") not in library:
        expected, hint = ", ".join(sorted(library)), "a fit says where plants stand; `species`, what they look like"
        raise RecipeError("no such species", parameter="species", expected=expected, got=repr(species[:60]), hint=hint)


def fit_files(target: Path) -> tuple[Path, Path, Path]:
    """Recipe, picture and numbers: in a folder, or of the name of a recipe."""
    if target.suffix.lower() in _RECIPES:
        return target, target.with_suffix(".png"), target.with_suffix(".json")
    return target / "kernel.yaml", target / "fit.png", target / "fit.json"


def _on_fit(fit: Fit) -> list[str]:
    notes = []
    if fit.trend < _UNEVEN:
        notes.append(
            f"the stand is more uneven than new ones (p = {fit.trend:.2g} by counts in squares): its density may "
            "change from place to place, and the fit takes it as constant"
        )
    if fit.nursery.founders:
        notes.append(
            f"one kernel leaves the nearest neighbours far off (loss {fit.plain.loss:.3g}); "
            f"{fit.nursery.founders} founders that come first leave {fit.matched.loss:.3g}"
        )
    return notes


def _write(files: tuple[Path, Path, Path], fitted: FittedKernel, points: Path, *, overwrite: bool) -> None:
    from forestgen.community.fitting.report import document, fit_picture

    recipe, picture, numbers = files
    content = json.dumps(document(fitted.fit, points.name, list(fitted.notes)), indent=1, allow_nan=False) + "\n"
    image = fit_picture(fitted.fit, points.stem)
    with FileSet(overwrite=overwrite) as written:
        written.write(recipe, fitted.recipe.encode())
        written.write(picture, image)
        written.write(numbers, content.encode())
