"""What a turtle drew, as a skeleton that the mesher takes."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from forestgen.core.errors import LsystemError
from forestgen.geometry.mesh import unit
from forestgen.lsystem.compiler import Program
from forestgen.lsystem.derivation import MOST_MODULES, derive, interpret
from forestgen.lsystem.turtle import Drawing, Polygons, draw_word
from forestgen.lsystem.turtle_options import options_from
from forestgen.plants.skeleton import OrganPlacements, Skeleton

_THREAD_M = 1e-6  # radius of what joins pieces between which the turtle moved without drawing
_COLLAR = 0.02  # share of a segment in which it becomes wider than the node that bears it
_WIDER = 1.01  # what is less than this times wider than its node needs no collar


def skeleton_of(drawing: Drawing, shapes: Mapping[str, str] | None = None, polygons: str | None = None) -> Skeleton:
    """The drawing's axes with their thickness, and its surfaces as organs.

    A skeleton's thickness runs evenly from node to node. A segment that begins wider than the node that bears it, on
    the same axis, gets a node of its own near its foot; pieces between which the turtle moved are joined by a thread
    of a micrometre. Where all of a plant begins with branches, the first becomes its trunk, the others further stems; a
    plant that has no wood there gets a trunk that cannot be seen.

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

    Parameters
    ----------
    unit_m : metres a unit; None: the program's.
    surfaces : names that may follow ~; None: all.

    Raises
    ------
    LsystemError : the program is wrong, or its word has died out.
    TooManyModulesError : its words grow longer than `most_modules`.
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
