"""Plants drawn by an L-system's turtle: any program, grown to the step that the plant's size asks for.

Reference
---------
Prusinkiewicz, P., Lindenmayer, A. (1990). The Algorithmic Beauty of Plants. Chapters 1 to 5. The language is described
in docs/lsystem.md.

Equations
---------
::

    word(0) = axiom,   word(n + 1) = word(n) rewritten,   n = round(steps(height))
    plant   = the turtle's drawing of the first word of word(n)

The curve `steps` maps a plant's height to derivation steps. Without it, every plant has the program's ``derivation
length``, and small plants are small copies of large ones. A program that defines ``height_m`` or ``width_m`` receives
the plant's value.

Parameters: see below; wood, shapes, foliage and so on as for every generator.

Recipe
------
::

    plant:
      generator: turtle
      program: lily                                 # scenes/lsystems/lily.lsys, or ./mine.lsys beside this file
      steps: [[0.1, 14], [0.35, 38], [0.75, 64], [0.9, 70]]
      values: {leaf_angle: 65, leaves: [[0.2, 20], [0.9, 52]]}
      surfaces: {K: leaf, B: flower, C: bud}
      wood: {material: stem}
      shapes:
        leaf: {form: simple, material: leaf, length_m: 0.12, width_m: 0.015}
        flower: {form: four_petals, material: petal, length_m: 0.08, width_m: 0.05}
        bud: {form: bud, material: leaf, length_m: 0.08, width_m: 0.015}

Around it stands a species' file like any other: see the page of every generator's keys.

Decisions
---------
- ``~K(s)`` is s times the shape's size in metres, whatever unit the program draws in. So the default fit is ``scale``:
  the wood as a whole until the height fits, organs as they are. ``fit: scale_all`` keeps the program's own proportions,
  ``fit: none`` its own size.
- A surface that `surfaces` does not name is the shape of that name; one that is neither is an error.
- A polygon is a fan of triangles around its first vertex, so it must be seen whole from there, as a leaf from its foot.
  It follows the wood's scale whatever the fit.
- The program's seed is drawn from the plant's stream: two exemplars of a stochastic program differ.
- ?E keeps its parameters: no environment answers a plant that grows by itself.
- Of a multiset the first word is drawn.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, TypeAdapter, ValidationError, WithJsonSchema, model_validator

from forestgen.core.errors import LsystemError, RecipeError
from forestgen.geometry.mesh import unit
from forestgen.geometry.patches import Patch
from forestgen.lsystem.compiler import Program, Value, compile_program, settable, with_values
from forestgen.lsystem.derivation import MOST_MODULES, TooManyModulesError, derive, interpret
from forestgen.lsystem.parsing import parse_sys_text, parse_text
from forestgen.lsystem.syntax import ProgramAST
from forestgen.lsystem.turtle import Drawing, Polygons, draw_word, options_from
from forestgen.plants.build import moved
from forestgen.plants.organs.base import OrganForm, OrganPatch
from forestgen.plants.parameters import PlantParameters
from forestgen.plants.skeleton import OrganPlacements, Skeleton, check_budget
from forestgen.recipe.curves import Curve, evaluate_one
from forestgen.recipe.fields import Section

MOST_STEPS = 10_000
POLYGON = "polygon"  # name of the shape that polygons have
_BYTES_PER_NODE = 3_000  # the drawing, the skeleton, and a tube of six sides around a segment
_TOLD = ("height_m", "width_m")

_curve: TypeAdapter[Any] = TypeAdapter(Curve)


class ProgramText(Section):
    """An L-system program. A recipe names it; reading the recipe puts its text here."""

    name: str = Field(description="the file's name, for messages; its suffix tells .sys from .lsys")
    text: str = Field(description="the program itself")


def _embedded(value: Any) -> Any:
    if isinstance(value, str):
        raise ValueError("a program is {name, text} here; only a recipe's or a species file's reader finds it by name")
    return value


_PROGRAM_SCHEMA: dict[str, Any] = {
    "anyOf": [{"type": "string"}, {"type": "object", "properties": {"name": {}, "text": {}}}],
    "description": "the L-system: a shipped program's name, or the path of a .lsys or .sys file",
}


class PolygonFace(OrganForm):
    """The surface of polygons, which the program gives their form."""

    form: Literal["polygon"] = "polygon"

    def patches(self) -> list[OrganPatch]:
        """The triangle that `skeleton_of` bends and moves to each of a polygon's own."""
        corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
        return [OrganPatch(self.material, Patch(corners, np.array([[0, 1, 2]]), corners[:, :2]))]


class Parameters(PlantParameters):
    """The `plant:` block of a species' file."""

    generator: Literal["turtle"] = "turtle"
    program: Annotated[ProgramText, BeforeValidator(_embedded), WithJsonSchema(_PROGRAM_SCHEMA)] = Field(
        description="the L-system: a shipped program's name, or the path of a .lsys or .sys file"
    )
    steps: Curve | None = Field(None, description="derivation steps over height in metres; null: the program's own")
    values: dict[str, Any] = Field(
        default_factory=dict,
        description="values of the program's #defines (numbers, or curves over the plant's height in metres), arrays "
        "(lists) and functions (control points)",
    )
    surfaces: dict[str, str] = Field(default_factory=dict, description="organ shape of each surface, ~K; else its name")
    polygons: PolygonFace | None = Field(None, description="part and material of polygons; null: they are not drawn")
    unit_m: float | None = Field(None, gt=0, le=1e4, description="metres a unit; null: the program's scale")
    most_modules: int = Field(2_000_000, ge=1, le=50_000_000, description="longest word that may be drawn")

    @model_validator(mode="after")
    def _fits_program(self) -> Self:
        listing = _compiled(self.program.name, self.program.text, ()).ast
        if self.steps is None and listing.derivation_length is None:
            raise ValueError(f"steps are missing: {self.program.name} has no derivation length")
        for shape in self.surfaces.values():
            if shape not in self.shapes:
                raise ValueError(f"there is no shape {shape!r}; there are: {', '.join(self.shapes)}")
        if self.polygons is not None:
            shapes: dict[str, Any] = self.shapes
            shapes[POLYGON] = self.polygons
        for name in self.values:
            self._check_value(listing, name)
        return self

    def _check_value(self, listing: ProgramAST, name: str) -> None:
        if name in _TOLD:
            raise ValueError(f"values: {name} is the plant's own")
        if name not in settable(listing):
            there_are = ", ".join(one for one in settable(listing) if one not in _TOLD) or "none"
            raise ValueError(f"values: {self.program.name} defines no {name}; there are: {there_are}")
        try:
            value = self._value(listing, name, 1.0)
            with_values(listing, {name: value})
        except (ValidationError, TypeError, RecipeError) as error:
            raise ValueError(f"values: {name} is no number and no curve over the height") from error
        except LsystemError as error:
            raise ValueError(f"values: {name} must be {error.expected}") from error

    def _value(self, listing: ProgramAST, name: str, height_m: float) -> Value:
        """A #define's number at a height; arrays and functions as they are."""
        written = self.values[name]
        if name not in listing.macros:
            listed: Value = _tuples(written)
            return listed
        return evaluate_one(_curve.validate_python(written), height_m)

    def program_for(self, height_m: float, width_m: float) -> Program:
        """The compiled program with the values of a plant of this size."""
        listing = _compiled(self.program.name, self.program.text, ()).ast
        values = {name: self._value(listing, name, height_m) for name in self.values}
        known = set(settable(listing))
        values |= {name: size for name, size in zip(_TOLD, (height_m, width_m), strict=True) if name in known}
        return _compiled(self.program.name, self.program.text, tuple(sorted(values.items())))

    def steps_at(self, height_m: float, program: Program) -> int:
        """Derivation steps of a plant of this height."""
        steps = float(program.derivation_length or 0) if self.steps is None else evaluate_one(self.steps, height_m)
        if not 0 <= steps <= MOST_STEPS:
            expected, got = f"0 to {MOST_STEPS:,} derivation steps", f"{steps:g} at a height of {height_m:g} m"
            raise RecipeError("the plant's age is out of range", where="plant.steps", expected=expected, got=got)
        return round(steps)


_Parameters = Parameters  # the generator's attribute hides the name


def _tuples(value: Any) -> Any:
    return tuple(_tuples(one) for one in value) if isinstance(value, list | tuple) else value


@lru_cache(maxsize=64)
def _compiled(name: str, text: str, values: tuple[tuple[str, Any], ...]) -> Program:
    listing = parse_sys_text(text, name) if name.endswith(".sys") else parse_text(text, name)
    return compile_program(with_values(listing, dict(values)) if values else listing)


class TurtleGenerator:
    """Draws the plants of L-systems."""

    Parameters = Parameters  # the class that a recipe's `plant` block is checked against
    has_crown = True

    def grow(self, parameters: _Parameters, height_m: float, width_m: float, rng: np.random.Generator) -> Skeleton:
        """The drawing of the program's word, with its surfaces and polygons as organs."""
        program = parameters.program_for(height_m, width_m)
        steps = parameters.steps_at(height_m, program)
        names = {name: name for name in parameters.shapes} | parameters.surfaces
        seed, where = int(rng.integers(0, 2**63)), f"plant.program {parameters.program.name}"
        try:
            drawing, scale = draw_program(
                program, steps, seed, unit_m=parameters.unit_m, surfaces=names, most_modules=parameters.most_modules
            )
        except TooManyModulesError as error:
            expected, got = f"at most {parameters.most_modules:,} modules", f"more of them within {steps} steps"
            hint = "fewer steps, or a higher plant.most_modules"
            problem = "the plant's word grows too long"
            raise RecipeError(problem, where=where, expected=expected, got=got, hint=hint) from error
        check_budget("segments", len(drawing.parent), _BYTES_PER_NODE, "fewer steps, or plant.steps by height")
        faces = parameters.polygons and len(drawing.polygons.offset) > 1
        if not np.any(drawing.is_drawn) and not len(drawing.surfaces.node) and not faces:
            got = f"a word without them after {steps} steps"
            raise RecipeError("the program draws nothing", where=where, expected="F, or a surface", got=got)
        skeleton = skeleton_of(drawing, names, POLYGON if parameters.polygons else None)
        placed = (one if one.shape == POLYGON else _unscaled(one, scale) for one in skeleton.organs)
        skeleton = replace(skeleton, organs=tuple(placed))
        return skeleton if parameters.fit in ("none", "scale_all") else _sized(skeleton, height_m)


def _unscaled(placement: OrganPlacements, scale: float) -> OrganPlacements:
    frame = placement.frame.copy()
    frame[:, :, :3] /= np.float32(scale)
    return replace(placement, frame=frame)


def _sized(skeleton: Skeleton, height_m: float) -> Skeleton:
    """Wood and polygons about as tall as the plant; the fit, which leaves organs as they are, does the rest."""
    fans = [one.frame for one in skeleton.organs if one.shape == POLYGON and len(one.frame)]
    corners = [(fan[:, 2, 3] + np.maximum(0.0, fan[:, 2, :2].max(axis=1))).max() for fan in fans]
    tops = [skeleton.position_m[:, 2].max(), *corners]
    factor = np.float32(height_m / max(float(max(tops)), 1e-9))
    stretch = np.full(3, factor)
    organs = (moved(one, stretch, float(factor) if one.shape == POLYGON else 1.0) for one in skeleton.organs)
    position, radius = skeleton.position_m * factor, skeleton.radius_m * factor
    return replace(skeleton, position_m=position, radius_m=radius, organs=tuple(organs))


_THREAD_M = 1e-6  # radius of what joins pieces between which the turtle moved without drawing
_COLLAR = 0.02  # share of a segment in which it becomes wider than the node that bears it
_WIDER = 1.01  # what is less than this times wider than its node needs no collar


def skeleton_of(drawing: Drawing, shapes: Mapping[str, str] | None = None, polygons: str | None = None) -> Skeleton:
    """The drawing's axes with their thickness, and its surfaces as organs.

    A segment that begins wider than the node that bears it, on the same axis, gets a node of its own near its foot;
    pieces between which the turtle moved are joined by a thread of a micrometre. Where all of a plant begins with
    branches, the first becomes its trunk, the others further stems; without wood there, a trunk that cannot be seen.

    `shapes`: name of the organ shape of each surface; None: the surface's own. `polygons`: name of the organ shape, the
    triangle (0, 0), (1, 0), (0, 1), that polygons are made of; None: left out.
    """
    d = _with_trunk(_first_branch_as_trunk(drawing))
    source, is_collar = _nodes_with_collars(d)
    last_row = np.empty(len(d.parent), dtype=np.int64)
    last_row[source] = np.arange(len(source))  # of a node and its collar, the node comes last
    parent = last_row[d.parent[source]]
    parent[0] = -1
    after_collar = np.flatnonzero(is_collar) + 1
    parent[after_collar] = after_collar - 1
    radius = np.where(is_collar, d.start_radius[source], d.radius[source])
    position = d.position[source]
    foot = d.position[d.parent[source]]
    position[is_collar] = (foot + _COLLAR * (position - foot))[is_collar]
    thread = ~d.is_drawn[source] & (parent >= 0)
    radius[thread] = _THREAD_M
    axis, order = _axes(d.axis[source], d.order[source], thread)
    organs = _organs(d, last_row, shapes or {})
    if polygons is not None and len(d.polygons.node):
        organs = (*organs, _triangles(d.polygons, last_row, polygons))
    return Skeleton.of(parent, position, radius, order, axis, organs=organs)


def draw_program(
    program: Program,
    steps: int,
    seed: int,
    *,
    unit_m: float | None = None,
    surfaces: Collection[str] | None = None,
    most_modules: int = MOST_MODULES,
) -> tuple[Drawing, float]:
    """What the turtle draws of a program's first word after some derivation steps, and metres a unit.

    `unit_m`: metres a unit; None: the program's. `surfaces`: names that may follow ~; None: all.

    Raises `LsystemError`: the program is wrong, or its word has died out; `TooManyModulesError`: its words grow longer
    than `most_modules`.
    """
    listing = program.ast
    *_, last = derive(program, steps, seed, most_modules=most_modules)
    words = interpret(program, last, seed, most_modules=most_modules)
    if not len(words):
        raise LsystemError("the plant has died out", where=listing.name, got=f"no word after {steps} steps")
    options = options_from(listing.turtle, listing.dialect, listing.name)
    options = options if unit_m is None else replace(options, scale=unit_m)
    return draw_word(words, 0, options, surfaces), options.scale


def _first_branch_as_trunk(d: Drawing) -> Drawing:
    """The same drawing, unless its trunk is nothing but the root while something grows from it."""
    if len(d.axis) < 2 or d.axis[1] == 0 or not d.is_drawn[1]:
        return d
    axis = np.maximum(d.axis - 1, 0).astype(np.int32)
    return replace(d, axis=axis, order=np.maximum(d.order - 1, 0).astype(np.int32))


def _with_trunk(d: Drawing) -> Drawing:
    """The same drawing, with a thread of a millimetre for a trunk if it has none."""
    if np.count_nonzero(d.axis == 0) > 1:
        return d
    columns = {name: np.insert(getattr(d, name), 1, getattr(d, name)[0], axis=0) for name in _COLUMNS}
    columns["position"][1, 2] += 1e-3
    columns["radius"][:2] = columns["start_radius"][:2] = _THREAD_M
    columns["parent"] = np.where(columns["parent"] > 0, columns["parent"] + 1, columns["parent"])
    columns["parent"][1] = 0
    columns["is_drawn"][1] = True
    node = d.surfaces.node + (d.surfaces.node > 0)
    polygons = replace(d.polygons, node=d.polygons.node + (d.polygons.node > 0))
    return replace(d, surfaces=replace(d.surfaces, node=node), polygons=polygons, **columns)


_COLUMNS = ("parent", "position", "start_radius", "radius", "order", "axis", "colour", "is_drawn", "module")


def _nodes_with_collars(d: Drawing) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Node of each row, and whether the row is the collar before it."""
    n = len(d.parent)
    chained = np.zeros(n, dtype=np.bool_)
    chained[1:] = (d.axis[1:] == d.axis[:-1]) & d.is_drawn[1:] & d.is_drawn[d.parent[1:]]
    collared = chained & (d.start_radius > _WIDER * d.radius[d.parent])
    source = np.repeat(np.arange(n), 1 + collared)
    is_collar = np.zeros(len(source), dtype=np.bool_)
    is_collar[:-1] = source[:-1] == source[1:]
    return source, is_collar


def _axes(
    axis: NDArray[np.int32], order: NDArray[np.int32], thread: NDArray[np.bool_]
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Numbers from 0 on; a thread is an axis by itself, and neither it nor what hangs on it is a trunk."""
    begins = np.zeros(len(axis), dtype=np.bool_)
    begins[1:] = (axis[1:] != axis[:-1]) | thread[1:] | thread[:-1]
    hangs = np.zeros(int(axis.max()) + 1, dtype=np.bool_)
    hangs[axis[thread]] = True
    raised = np.where(hangs[axis], np.maximum(order, 1), order)
    return np.cumsum(begins).astype(np.int32), raised.astype(np.int32)


def _organs(d: Drawing, row: NDArray[np.int64], shapes: Mapping[str, str]) -> tuple[OrganPlacements, ...]:
    placed = d.surfaces
    found = []
    for symbol in np.unique(placed.symbol):
        chosen = placed.symbol == symbol
        frame, node = placed.frame[chosen].astype(np.float32), row[placed.node[chosen]].astype(np.int32)
        found.append(OrganPlacements(shapes.get(str(symbol), str(symbol)), frame, node))
    return tuple(found)


def _triangles(polygons: Polygons, row: NDArray[np.int64], shape: str) -> OrganPlacements:
    """The polygons as fans of triangles: frames of the triangle (0, 0), (1, 0), (0, 1).

    A fan lies around the polygon's first vertex, as a leaf's does around its foot. Triangles without area are left out.
    The z column, along the triangle's normal, is sqrt(2 A) long, so that the cube root of the frame's determinant is
    that too, and scaled normals come out as unit vectors.
    """
    offset = polygons.offset
    count = np.maximum(np.diff(offset) - 2, 0)
    owner = np.repeat(np.arange(len(count)), count)
    rank = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    first = offset[:-1][owner]
    foot = polygons.vertex[first]
    one, other = polygons.vertex[first + rank + 1] - foot, polygons.vertex[first + rank + 2] - foot
    normal = np.cross(one, other)
    double_area = np.linalg.norm(normal, axis=1)
    kept = double_area > 1e-12 * np.maximum(np.sum(one * one, axis=1), np.sum(other * other, axis=1))
    upright = unit(normal[kept]) * np.sqrt(double_area[kept])[:, None]
    frame = np.stack([one[kept], other[kept], upright, foot[kept]], axis=-1)
    return OrganPlacements(shape, frame.astype(np.float32), row[polygons.node[owner[kept]]].astype(np.int32))


GENERATOR = TurtleGenerator()
