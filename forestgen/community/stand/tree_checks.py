"""Checks of a list of trees against a recipe's species, and of a tree's sizes against one another."""

from __future__ import annotations

import difflib
import json
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from forestgen.community.arrivals import heights_m, of_species
from forestgen.community.population import Ecologies, Floats, Indices, Mask
from forestgen.community.stand.tree_list import TALLEST_M, TreeList
from forestgen.community.tree_columns import HIGHEST_BASE
from forestgen.core.errors import RecipeError
from forestgen.core.frames import BREAST_HEIGHT_M

_STOUTEST, _STOUTEST_DEAD = 10.0, 2.0  # least height over diameter; dead trees may be broken
_STOUTEST_DERIVED = 5.0  # where the height follows from the diameter: of the oldest trees
_FEWEST_UNMEASURED = 5  # lines of a species
_TALL, _STOUT, _STOUTEST_OF_STANDS = 0.85, 1.5, 25.0  # of the tallest height; of that tree's diameter; height over it
_SLENDEREST = 300.0  # most height above breast height over diameter
_WIDTHS = (0.04, 2.5)  # crown width over height


def species_index(trees: TreeList, species_map: Mapping[str, str], species: Ecologies) -> Indices:
    """(N,) index of each tree's species in the recipe."""
    index = {one.name: i for i, one in enumerate(species)}
    found = [index.get(species_map.get(name, name), -1) for name in trees.species_names]
    sp = np.array(found, dtype=np.int64)[trees.species]
    unknown = np.flatnonzero(sp < 0)
    if len(unknown):
        name = trees.species_names[trees.species[unknown[0]]]
        others = sum(one < 0 for one in found) - 1
        count = int(np.count_nonzero(trees.species == trees.species[unknown[0]]))
        got = repr(name) + (f", in {count:,} lines" if count > 1 else "")
        got += f"; and {others} more unknown names" if others else ""
        like = difflib.get_close_matches(name.lower(), [*index], 1, 0.0) or ["spruce"]
        hint = f"species_map: {{{json.dumps(name, ensure_ascii=False)}: {like[0]}}}"
        expected = f"one of {', '.join(index)}, as it is written here, or a name of community.species_map"
        raise RecipeError("unknown species", where=trees.place(unknown[0]), expected=expected, got=got, hint=hint)
    return sp


def refuse(trees: TreeList, wrong: Mask, problem: str, expected: str, columns: tuple[str, ...], hint: str = "") -> None:
    """Raise `RecipeError` for the first of the wrong trees, if there are any."""
    rows = np.flatnonzero(wrong)
    if not len(rows):
        return
    values = {name: trees.number(name)[rows[0]] for name in columns}
    got = ", ".join(f"{name} {'not known' if np.isnan(one) else f'{one:.9g}'}" for name, one in values.items())
    got += f"; {len(rows):,} such lines" if len(rows) > 1 else ""
    raise RecipeError(problem, where=trees.place(rows[0]), expected=expected, got=got, hint=hint or None)


def check_sizes(trees: TreeList, sp: Indices, species: Ecologies) -> None:
    """Raise `RecipeError` for a plant whose sizes in the list are too few, or not its species'."""
    dbh, height, is_tree = trees.number("dbh_m"), trees.number("height_m"), are_trees(species, sp)
    most = heights_m(species, sp, of_species(species, "max_radius_m")[sp]) * (1 + 1e-9)
    sizes = ("dbh_m", "height_m")
    refuse(trees, np.isnan(dbh) & np.isnan(height), "a tree without a size", "a diameter or a height", sizes)
    what = "a height_m: its species has no section `tree`, by which diameters give heights"
    refuse(trees, ~is_tree & np.isnan(height), "a plant without a height", what, sizes)
    what = "a height_m that its species' largest plant has; see ecology.max_radius_m"
    refuse(trees, ~is_tree & (height > most), "no plant of the species is so tall", what, ("height_m",))
    what = f"no diameter of a tree below {BREAST_HEIGHT_M} m, where diameters are measured"
    refuse(trees, (dbh > 0) & (height <= BREAST_HEIGHT_M), "the diameter and the height contradict", what, sizes)
    _check_units(trees, sp, species)


def _check_units(trees: TreeList, sp: Indices, species: Ecologies) -> None:
    """Raise `RecipeError` for a species whose diameters are not those of any stand, and whose heights are not known."""
    dbh, derived = trees.number("dbh_m"), np.isnan(trees.number("height_m"))
    for index, one in enumerate(species):
        mine = derived & (sp == index)
        if one.tree is None or np.count_nonzero(mine) < _FEWEST_UNMEASURED:
            continue
        tall = float(np.exp(one.tree.log_dbh(np.array([_TALL * one.tree.tallest_m]))[0]))
        most = min(_STOUT * tall, one.tree.tallest_m / _STOUTEST_OF_STANDS)
        median = float(np.median(dbh[mine]))
        if median > most:
            what = f"a median of at most {most:.3g} m where heights are not known; of {one.name} it is {median:.3g} m"
            hint = "dbh_cm is in centimetres, dbh_m in metres: divide millimetres by 10; or give these trees' heights"
            refuse(trees, mine & (dbh > most), "no stand of the species is so thick", what, ("dbh_m",), hint)


def are_trees(species: Ecologies, sp: Indices) -> Mask:
    """(N,) whether a plant's species has allometries of trees."""
    return np.array([one.tree is not None for one in species], dtype=np.bool_)[sp]


def check_proportions(trees: TreeList, rows: Indices, height_m: Floats) -> None:
    """Raise `RecipeError` for sizes that contradict the heights, of the list or by its diameters."""
    listed, all_m = trees.number("height_m"), np.full(len(trees), np.nan)
    np.fmin.at(all_m, rows, height_m)  # a line's trees each have a height; the least
    trees = replace(trees, numbers={**trees.numbers, "height_m": all_m})
    dbh, height, sizes = trees.number("dbh_m"), trees.number("height_m"), ("dbh_m", "height_m")
    what = "a diameter of at most a tenth of the height, of a dead tree at most half of it"
    hint = "check the units; leave the height of a living tree with a broken top empty"
    stoutest = np.where(trees.dead, _STOUTEST_DEAD, _STOUTEST)
    refuse(trees, dbh * stoutest > listed, "no tree is so thick for its height", what, sizes, hint)
    what, hint = "a diameter of at most a fifth of the height that it gives", "check the units"
    thick = np.isnan(listed) & (dbh * _STOUTEST_DERIVED > height)
    refuse(trees, thick, "no tree of the species is so thick", what, sizes, hint)
    what = f"a diameter of at least 1/{_SLENDEREST:g} of the height above {BREAST_HEIGHT_M} m"
    thin = dbh * _SLENDEREST < listed - BREAST_HEIGHT_M
    refuse(trees, thin, "no tree is so thin for its height", what, sizes, hint)
    what = f"at most {TALLEST_M:g} m; a height that is not in the list follows from the diameter"
    refuse(trees, height > TALLEST_M, "no tree is so tall", what, sizes, hint)
    width, sizes = 2.0 * trees.number("crown_radius_m"), ("crown_radius_m", "height_m")
    what = "a crown's radius of {:g} to {:g} of the height".format(*(0.5 * one for one in _WIDTHS))
    wrong = (width < _WIDTHS[0] * height) | (width > _WIDTHS[1] * height)
    refuse(trees, wrong, "the crown and the height contradict", what, sizes, hint)
    what, sizes = f"a crown base of at most {HIGHEST_BASE:g} of the height", ("crown_base_m", "height_m")
    wrong = trees.number("crown_base_m") > HIGHEST_BASE * height * (1.0 + 1e-9)
    refuse(trees, wrong, "the crown and the height contradict", what, sizes, hint)
