"""Trees of an inventory: a list with places, or the trees of sample plots, as a file beside the recipe.

A line of the list is a tree. What it does not say follows from the allometries of its species (`tree` of the species):
the height from the diameter, the diameter from the height, crown and leaves from both, with numbers of the tree's own
and by its neighbours. What it says is what is built. A step of Δt years makes trees older, and nothing else.

========================  ==========================================================================================
column                    what it is
========================  ==========================================================================================
species                   as the recipe, or `species_map`, names it
x_m, y_m                  where it stands, metres; without both columns trees are placed at random
dbh_cm or dbh_m           diameter at 1.3 m; this or a height is needed
height_m                  height
crown_radius_m            or crown_width_m, its double
crown_base_m              height of the crown's base
status                    alive; dead, lying_dead (uprooted) or snapped; empty: alive
decay_class               of a dead tree, 1 to 5
age_yr, azimuth_deg       age, turn about the vertical clockwise from above
stems_per_ha or count     how many trees a line stands for, where there are no places; count is that of the plot
========================  ==========================================================================================

Parameters: see below.

Recipe::

    community:                           # a mapped plot
      model: inventory
      file: trees.csv
      origin_m: [412300, 5612800]
      species_map: {Picea abies: spruce, Fagus sylvatica: beech}

    community:                           # trees of a plot of 500 m², on the whole site, somewhat regular
      model: inventory
      plot_area_m2: 500
      clark_evans: 1.15
      table: |
        species, dbh_cm, height_m, count
        spruce,  31.5,   24.1,     6
        spruce,  18,     ,         11
        birch,   22.4,   23,       2

    community:                           # a file with other names of columns
      model: inventory
      file: Probefläche 7.csv
      columns: {Baumart: species, BHD: dbh_cm, Höhe: height_m, X: x_m, Y: y_m}

Decisions
---------
- The file is known by its content: the recipe's hash has its SHA-256, and a stored recipe has a copy beside it.
- Cells are separated by commas, semicolons or tabs; with the latter two, decimals may have a comma. Text is UTF-8,
  UTF-16 or Windows-1252. An empty cell, or NA, is a value that is not known; NaN is refused.
- Heights that are not known lie on the curve of the species' allometry through those that are, where at least five
  living trees of the species have both: all heights above 1.3 m are multiplied by one factor (Mehtätalo et al. 2015,
  Canadian Journal of Forest Research 45, 826).
- Sizes that no tree has are refused: they are slips of the pen, or of units, and the generators do not build them. A
  diameter is at most a tenth of the height (of a dead tree, which may be broken, half; a fifth where it gives the
  height) and at least 1/300 of the height above 1.3 m; a crown is 0.04 to 2.5 heights wide and begins below 0.95 of the
  height. The extremes of 3,336 measured trees, 1,221 of them with crowns, are 1/16, 1/268, 0.048 and 1.22 (Falster et
  al. 2015, Ecology 96, 1445: BAAD).
- Five and more lines of a species without heights whose median diameter no stand has are refused: they are in
  millimetres. The limit is 1.5 times the diameter of a tree of 0.85 of the species' tallest height, or a diameter of
  1/25 of the tallest height, whichever is less: 1.2 m of spruce, 2 m of beech, 5.6 m of giant sequoias.
- Columns of other names mean nothing, and a note says so; a name that is nearly one of these is refused.
- plant_id counts the lines from 1. Of a list without places each line becomes as many trees as it stands for on this
  site, rounded so that the sum is right; the thickest are placed first, as `stand` places trees.
- Dead trees have no leaves, and no living neighbour counts them; they themselves grew among all trees. A height_m is
  that of what stands, or the length of what lies. A dead tree's decay class is 2 if nothing is said; where its height
  is less than 0.72 of that by its diameter it has broken, and its class is 4 or 5.
- Two trees of one species on one spot are refused; stems may overlap otherwise.
- Plants of species without `tree` need a height_m, which their species' largest plant bounds.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self

import numpy as np
from pydantic import BeforeValidator, Field, PrivateAttr, ValidationInfo, model_validator

from forestgen.community.arrivals import radii_m
from forestgen.community.placement.densities import grid_shape, tree_density
from forestgen.community.placement.density_map import DensityMap
from forestgen.community.population import Ecologies, Floats, Indices, Site, ecology_of
from forestgen.community.stand import spacing
from forestgen.community.stand.build import by_species, heights_of
from forestgen.community.stand.dead_list import decayed
from forestgen.community.stand.tree_checks import are_trees, check_proportions, check_sizes, refuse, species_index
from forestgen.community.stand.tree_list import COLUMNS as KNOWN
from forestgen.community.stand.tree_list import MOST_ROWS, TreeList, read_trees
from forestgen.community.static_model import Placement, StaticModel, StaticParameters
from forestgen.community.tree_columns import COLUMNS, HIGHEST_BASE, competition_shifts
from forestgen.core.cache import BoundedCache
from forestgen.core.errors import AssetError, RecipeError
from forestgen.core.frames import BREAST_HEIGHT_M
from forestgen.core.randomness import child_rng
from forestgen.recipe.fields import Flag, Name, Number, Positive, Section, Text, violation
from forestgen.recipe.map_files import Sha256, known_file
from forestgen.recipe.sources import Keys
from forestgen.recipe.tree_sizes import NUMBERS

if TYPE_CHECKING:
    from forestgen.recipe.load import DrawnRecipe

_BYTES_PER_TREE = 400
_CELLS = 1024
_FEWEST_MEASURED = 5  # heights of a species that make its curve the list's own
_MOST_RAISED = 1.5  # a height by diameter is raised at most so many times for a high crown base
_lists: BoundedCache[TreeList] = BoundedCache(300_000_000, lambda one: one.nbytes)


class TreeFile(Section):
    """The file of a list of trees."""

    file: Text = Field(min_length=1, exclude=True, description="Path, relative to the recipe's folder.")
    sha256: Sha256 | None = Field(None, description="SHA-256 of the file; no file of other content is taken.")

    _content: bytes = PrivateAttr()

    @model_validator(mode="after")
    def _read(self, info: ValidationInfo) -> Self:
        if not hasattr(self, "_content"):  # else part of other parameters now, without its recipe's folder
            folder: Path | None = (info.context or {}).get("folder")
            try:
                path = known_file(folder or Path(), self.file, self.sha256) if folder else Path(self.file)
                self._content = path.read_bytes()
            except AssetError as cause:
                raise violation(cause.expected or "", problem=cause.problem, got=cause.got, hint=cause.hint) from cause
            except OSError as cause:
                raise violation("a file", problem="the file cannot be read", got=str(cause.strerror)) from cause
        return self

    @property
    def content(self) -> bytes:
        return self._content


def _as_file(value: Any) -> Any:
    return {"file": value} if isinstance(value, str) else value


def _texts(value: Any) -> Any:
    """A mapping whose keys may be numbers, such as codes of species; null: an empty one."""
    value = {} if value is None else value
    return {str(key): one for key, one in value.items()} if isinstance(value, dict) else value


class InventoryParameters(StaticParameters):
    """What a recipe says about the list."""

    memory_hint: ClassVar[str] = "list fewer trees"

    file: Annotated[TreeFile | None, BeforeValidator(_as_file)] = Field(
        None, description="the list: a file's name, relative to the recipe's folder"
    )
    table: str | None = Field(None, max_length=1_000_000, description="instead of a file: the list itself")
    species_map: Annotated[dict[str, Name], BeforeValidator(_texts)] = Field(
        {}, description="the recipe's species for the list's names or codes"
    )
    columns: Annotated[dict[str, str], BeforeValidator(_texts)] = Field(
        {}, description="this model's names for the list's columns"
    )
    origin_m: tuple[Number, Number] = Field((0.0, 0.0), description="x and y of the list at the site's corner, metres")
    plot_area_m2: Positive | None = Field(
        None, le=1e8, description="area of the plots together whose trees are listed without places, each `count` times"
    )
    clark_evans: Number = Field(
        1.0,
        ge=spacing.LEAST_R,
        le=spacing.MOST_R,
        description="pattern of trees without places: below 1 clumped, 1 random, above 1 regular",
    )
    map: DensityMap | None = Field(None, description="relative density of trees without places")
    keep_out: DensityMap | None = Field(None, description="where no tree without place stands: any value above 0 bars")
    periodic: Flag = Field(True, description="the site is a torus, without edges; false: a bounded site")

    @model_validator(mode="after")
    def _is_one_list(self) -> Self:
        if self.file is not None and self.table is not None:
            raise violation("file or table, not both", problem="two lists of trees", at="table")
        unknown = [one for one in self.columns.values() if one not in KNOWN]
        if unknown:
            raise violation(f"one of {', '.join(KNOWN)}", problem="no such column", got=unknown[0], at="columns")
        return self

    def for_trial(self) -> Self:
        """Without trees, which may stand anywhere on the whole site."""
        return self.model_copy(update={"file": None, "table": None})

    def named_species(self) -> Iterator[tuple[Keys, str]]:
        yield from super().named_species()
        yield from ((("species_map", name), one) for name, one in self.species_map.items())

    def trees(self) -> TreeList | None:
        """The list; None: the recipe has none. Raises `RecipeError` for what is no list of trees."""
        if self.file is None and self.table is None:
            return None
        name = "community.table" if self.file is None else self.file.file
        content = (self.table or "").encode() if self.file is None else self.file.content
        key = (hashlib.blake2b(content).hexdigest(), name, tuple(self.columns.items()))
        return _lists.get(key, lambda: read_trees(content, name, self.columns))


class Inventory(StaticModel[InventoryParameters]):
    Parameters = InventoryParameters
    knows_trees: ClassVar[bool] = True

    def place(
        self, parameters: InventoryParameters, site: Site, species: Ecologies, rng: np.random.Generator
    ) -> Placement:
        """The trees of the list; raises `RecipeError` for one that cannot stand there."""
        trees = parameters.trees()
        if trees is None:
            return Placement(np.zeros(0, dtype=np.int64), np.zeros((0, 2)), np.zeros(0))
        _check_keys(trees, parameters)
        sp = species_index(trees, parameters.species_map, species)
        check_sizes(trees, sp, species)
        own_rng, place_rng = rng.spawn(2)
        if "x_m" in trees.numbers:
            rows, position_m = np.arange(len(trees)), _positions(trees, sp, parameters, site)
        else:
            rows = _copies(trees, parameters, site, place_rng)
            position_m = _placed(trees, sp, rows, parameters, site, species, place_rng)
        normals = own_rng.standard_normal((len(rows), NUMBERS))
        height_m = _heights(trees, rows, sp[rows], normals, position_m, parameters, site, species)
        check_proportions(trees, rows, height_m)
        form = trees.form[rows]
        height_m, decay = decayed(trees, rows, sp[rows], species, height_m)
        is_tree = are_trees(species, sp[rows])
        sizes = {name: np.where(is_tree, trees.number(name)[rows], np.nan) for name in COLUMNS[:3]}
        return Placement(
            sp[rows],
            position_m,
            radii_m(species, sp[rows], height_m),
            height_m,
            tree_sizes=sizes,
            dead=form > 0,
            dead_form=form,
            decay_class=decay,
            age_yr=np.nan_to_num(trees.number("age_yr")[rows]),
            azimuth_deg=trees.number("azimuth_deg")[rows],
            notes=tuple(_notes(trees, sp, species)),
        )

    def most_plants(self, parameters: InventoryParameters, site: Site, species: Ecologies) -> float:
        """The trees of the list, each line as many as it stands for."""
        trees = parameters.trees()
        if trees is None:
            return 0.0
        return float(
            len(trees) if "x_m" in trees.numbers else round(float(_numbers_here(trees, parameters, site).sum()))
        )

    def empty_reason(self, parameters: InventoryParameters, site: Site, species: Ecologies) -> str | None:
        if self.expected_plants(parameters, site, species) > 0:
            return None
        if parameters.trees() is None:
            return "no tree is placed: there is neither community.file nor community.table"
        return "no tree is placed: the list has less than one tree for this site"

    def estimate_bytes(self, parameters: InventoryParameters, site: Site, species: Ecologies) -> int:
        """Bytes for all trees, and the cells of their list."""
        trees = parameters.trees()
        listed = 0 if trees is None else 300 * len(trees)
        more = int(_BYTES_PER_TREE * self.expected_plants(parameters, site, species))
        return super().estimate_bytes(parameters, site, species) + listed + more

    def check_recipe(self, drawn: DrawnRecipe, parameters: InventoryParameters) -> None:
        """Read and place all trees, so that every line is checked before anything is made."""
        if {name for _, name in parameters.named_species()} - {*drawn.species}:
            return  # refused already
        species = [ecology_of(name, one) for name, one in drawn.species.items()]
        rng = child_rng(drawn.image_seed, "community", 0)
        self.place(parameters, Site(drawn.recipe.site.size_m), species, rng)


_KEYS: tuple[str, ...] = ("origin_m", "plot_area_m2", "map", "keep_out", "clark_evans")


def _check_keys(trees: TreeList, parameters: InventoryParameters) -> None:
    """Raise `RecipeError` for a key that means nothing for this list."""
    named, keys = {*trees.numbers}, _KEYS
    if "x_m" in named:
        keys, why = keys[1:], "trees without places; it has x_m and y_m"
    elif "stems_per_ha" in named:
        keys, why = keys[:2], "trees with places, or of plots; it has stems_per_ha"
    else:
        keys, why = keys[:1], "trees with places; it has no x_m and y_m"
    for name in keys:
        if getattr(parameters, name) != InventoryParameters.model_fields[name].default:
            problem, hint = f"{name} means nothing for this list", f"leave {name} out"
            raise RecipeError(
                problem, where=f"community.{name}", expected=f"a list of {why}", got=trees.head, hint=hint
            )


def _notes(trees: TreeList, sp: Indices, species: Ecologies) -> Iterator[str]:
    """What of the list means nothing here."""
    if trees.ignored:
        yield f"columns of {trees.name} without meaning here: {', '.join(trees.ignored)}"
    sized = ~np.isnan([trees.number(name) for name in COLUMNS[:3]]).all(axis=0) & ~are_trees(species, sp)
    if sized.any():
        names = ", ".join(sorted({species[index].name for index in sp[sized]}))
        yield f"diameters and crowns of {int(sized.sum()):,} lines are left out: no trees, but {names}"


def _positions(trees: TreeList, sp: Indices, parameters: InventoryParameters, site: Site) -> Floats:
    """(N, 2) places on the site."""
    position_m = np.stack([trees.number("x_m"), trees.number("y_m")], axis=1) - np.array(parameters.origin_m)
    places, (width, depth) = ("x_m", "y_m"), site.size_m
    refuse(trees, np.isnan(position_m).any(axis=1), "a tree without a place", "an x_m and a y_m", places)
    if {"stems_per_ha", "count"} & {*trees.numbers}:
        problem, expected = "trees with places stand for themselves", "no column stems_per_ha or count beside x_m, y_m"
        raise RecipeError(problem, where=trees.head, expected=expected, got="both")
    x, y = parameters.origin_m
    expected = f"x_m from {x:.10g} to {x + width:.10g} and y_m from {y:.10g} to {y + depth:.10g}"
    outside = ((position_m < 0) | (position_m > np.array(site.size_m))).any(axis=1)
    hint = "origin_m: [x, y] is the list's place of the site's south-western corner; or enlarge site.size_m"
    refuse(trees, outside, "the tree does not stand on the site", expected, places, hint)
    order = np.lexsort((np.arange(len(trees)), sp, position_m[:, 1], position_m[:, 0]))
    same = (np.diff(position_m[order], axis=0) == 0).all(axis=1) & (np.diff(sp[order]) == 0)
    if same.any():
        again = np.zeros(len(trees), dtype=np.bool_)
        again[order[1:][same]] = True
        twin = order[np.flatnonzero(order == np.argmax(again))[0] - 1]
        expected = f"trees of one species at different places; line {trees.line[twin]} has this one"
        refuse(trees, again, "the tree is there twice", expected, places, "remove the line, or correct its place")
    return np.asarray(position_m)


def _numbers_here(trees: TreeList, parameters: InventoryParameters, site: Site) -> Floats:
    """(N,) how many trees of the site each line of a list without places stands for."""
    if "stems_per_ha" in trees.numbers:
        number = trees.number("stems_per_ha") * site.area_ha
    else:
        plot_m2 = parameters.plot_area_m2 or site.area_m2
        number = (trees.number("count") if "count" in trees.numbers else np.ones(len(trees))) * (site.area_m2 / plot_m2)
        if parameters.plot_area_m2 is None and "count" not in trees.numbers:
            problem, got = "neither places nor numbers of trees", ", ".join(trees.names)[:200]
            expected = "columns x_m and y_m, stems_per_ha or count; or community.plot_area_m2"
            hint = "`columns: {X: x_m, Y: y_m}` says what columns are; plot_area_m2 is that of all plots together"
            raise RecipeError(problem, where=trees.head, expected=expected, got=got, hint=hint)
    what = "a number of trees"
    name = "stems_per_ha" if "stems_per_ha" in trees.numbers else "count"
    refuse(trees, np.isnan(number), "a line without a number of trees", what, (name,))
    if number.sum() > MOST_ROWS:
        expected, got = f"at most {MOST_ROWS:,} on the site", f"{number.sum():,.0f}"
        raise RecipeError("too many trees", where=trees.name, expected=expected, got=got)
    return np.asarray(number, dtype=np.float64)


def _copies(trees: TreeList, parameters: InventoryParameters, site: Site, rng: np.random.Generator) -> Indices:
    """The row of each tree that is placed: rows in order, each about as often as it stands for trees of the site."""
    ends = np.cumsum(_numbers_here(trees, parameters, site))
    marks = np.arange(round(float(ends[-1]))) + 0.999 * rng.random()
    return np.asarray(np.searchsorted(ends, marks, side="right").clip(max=len(trees) - 1))


def _placed(
    trees: TreeList,
    sp: Indices,
    rows: Indices,
    parameters: InventoryParameters,
    site: Site,
    species: Ecologies,
    rng: np.random.Generator,
) -> Floats:
    """(M,) random places of trees, the thickest first."""
    dbh = trees.number("dbh_m")[rows]
    unknown = np.flatnonzero(np.isnan(dbh))
    some = unknown[are_trees(species, sp[rows[unknown]])]
    height_m = trees.number("height_m")[rows]
    dbh[some] = by_species(species, sp[rows[some]], height_m[some], np.zeros((len(some), NUMBERS))).dbh_m
    dbh = np.nan_to_num(dbh, nan=0.005)
    order = np.argsort(-dbh, kind="stable")
    own = spacing.own_distance_m(dbh[order], site.area_m2, parameters.clark_evans)
    widest = max(2 * float(dbh.max(initial=0.01)), float(own.max(initial=0.0)))
    grid = spacing.empty_grid(len(rows), widest, site.size_m, periodic=parameters.periodic)
    density = tree_density(parameters.map, parameters.keep_out, site, grid_shape(site, _CELLS))
    ground = (density, np.zeros(density.shape))
    placed = spacing.place_storey(grid, 0, dbh[order], np.ones(len(rows)), parameters.clark_evans, ground, rng)
    if placed < len(rows):
        problem, got = "so many trees have no room", f"{len(rows):,} on the site"
        expected = f"at most about {placed:,} trees of these diameters, where trees may stand"
        hint = "a larger plot_area_m2, or a map and keep_out that leave more ground"
        raise RecipeError(problem, where=trees.name, expected=expected, got=got, hint=hint)
    position_m = np.empty((len(rows), 2))
    position_m[order] = np.stack([grid.x, grid.y], axis=1)
    return position_m


def _by_diameters(
    species: Ecologies, sp: Indices, dbh_m: Floats, normals: Floats, shift: Floats, measured_m: Floats
) -> Floats:
    """(M,) heights, on the curve of each species' allometry that goes through the trees that are measured."""
    height_m = heights_of(species, sp, dbh_m, normals, shift)
    above = measured_m - BREAST_HEIGHT_M
    for index in np.unique(sp).tolist():
        mine = sp == index
        known = mine & (above > 0.0)
        if np.count_nonzero(known) >= _FEWEST_MEASURED:
            usual = heights_of(species, sp[known], dbh_m[known], np.zeros((int(known.sum()), NUMBERS)), shift[known])
            factor = np.exp(np.mean(np.log(above[known] / (usual - BREAST_HEIGHT_M))))
            height_m[mine] = BREAST_HEIGHT_M + factor * (height_m[mine] - BREAST_HEIGHT_M)
    return height_m


def _heights(
    trees: TreeList,
    rows: Indices,
    sp: Indices,
    normals: Floats,
    position_m: Floats,
    parameters: InventoryParameters,
    site: Site,
    species: Ecologies,
) -> Floats:
    """(M,) heights: those of the list, others by diameters and neighbours."""
    height_m, dbh_m = trees.number("height_m")[rows], trees.number("dbh_m")[rows]
    missing = np.flatnonzero(np.isnan(height_m))
    if not len(missing):
        return height_m
    laws = [one.tree for one in species]
    sized, shift = np.flatnonzero(are_trees(species, sp) & ~np.isnan(dbh_m)), np.zeros(len(rows))
    all_trees, dead = np.flatnonzero(are_trees(species, sp)), trees.dead[rows]
    measured_m = np.where(dead, np.nan, height_m)[sized]
    for _ in range(2):  # the second time with neighbours
        own = species, sp[sized], dbh_m[sized], normals[sized], shift[sized]
        height_m[missing] = _by_diameters(*own, measured_m)[np.searchsorted(sized, missing)]
        among = position_m[all_trees], sp[all_trees], height_m[all_trees]
        shift[all_trees] = competition_shifts(*among, laws, site, periodic=parameters.periodic, dead=dead[all_trees])
    least_m = np.nan_to_num(trees.number("crown_base_m")[rows[missing]]) / HIGHEST_BASE
    given_m = height_m[missing]  # a crown may begin high on a tall tree of its diameter
    usual_m = _medians(rows[missing], given_m)
    height_m[missing] = np.where(least_m <= _MOST_RAISED * usual_m, np.maximum(given_m, least_m), given_m)
    return height_m


def _medians(line: Indices, values: Floats) -> Floats:
    """(M,) the median of each value's line; `line` ascends."""
    ascending = values[np.lexsort((values, line))]
    _, first, count = np.unique(line, return_index=True, return_counts=True)
    return np.repeat(0.5 * (ascending[first + (count - 1) // 2] + ascending[first + count // 2]), count)


MODEL = Inventory()
