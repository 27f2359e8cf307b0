"""Houses: what plants grow around and not into. Walls with windows and a door under a gable roof, with a chimney.

Geometry
--------
The origin is in the middle of the ground plan, z up. The ridge runs along x; the door is in the front, towards -y.
Everything but the chimney lies within the box of width (x), depth (y) and height (z, to the ridge) that the community
keeps its plants out of: the walls stand an overhang inside of it. Walls reach 1 m into the ground, which may slope.

The roof rises with the slope's tangent times half the depth, but over no more than half of the height. It has courses
of tiles, each of which lies on the next lower one. Windows stand in rows, a row a storey, as many as fit; they are
recessed, with a frame, a cross of bars and a sill. A wall too small for one has none.

Example
-------
    site: {buildings: [{kind: house, position_m: [30, 40], azimuth_deg: 20, size_m: [12, 9, 8], roof_slope_deg: 35}]}

Parameters: see below. Materials are those of its parts: wall, plinth, roof, glass, frame, door, chimney.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator

from forestgen.geometry.mesh import Mesh
from forestgen.recipe.fields import violation
from forestgen.recipe.species import Building, Material
from forestgen.scene.building import BuildingKind

Floats = NDArray[np.float64]
Box = tuple[float, float, float, float]  # of an opening in a wall: left, bottom, right, top, metres

_FOUNDATION_M, _PLINTH_M, _PLINTH_OUT_M = 1.0, 0.4, 0.03
_RECESS_M, _FRAME_M, _BAR_M = 0.14, 0.06, 0.04
_ROOF_THICK_M, _TILE_UP_M = 0.16, 0.035
_MARGIN_M = 0.5  # of wall beside a window, at least


class House(Building):
    """Keys of a building of kind house."""

    roof_slope_deg: float = Field(40.0, ge=10, le=60, description="Slope of the roof, degrees.")
    overhang_m: float = Field(
        0.4, ge=0, le=2, description="Of the roof beyond the walls, metres; at most a tenth of the house."
    )
    storey_m: float = Field(2.7, ge=2, le=6, description="From one row of windows to the next, metres.")
    window_m: tuple[float, float] = Field((0.9, 1.2), description="Width and height of a window, metres.")
    window_spacing_m: float = Field(2.6, ge=0.5, le=20, description="From one window to the next, metres.")
    door_m: tuple[float, float] = Field((1.0, 2.1), description="Width and height of the door, metres.")
    course_m: float = Field(0.33, ge=0.05, le=2, description="Of tiles, along the slope, metres.")
    chimney: bool = Field(True, description="Whether there is a chimney.")

    @field_validator("materials")
    @classmethod
    def _of_its_parts(cls, materials: dict[str, Material]) -> dict[str, Material]:
        for part in materials:
            if part not in _MATERIALS:
                expected = "one of " + ", ".join(_MATERIALS)
                raise violation(expected, problem="a house has no such part", got=part, at=(part,))
        return materials


_COLOURS = {
    "wall": (0.62, 0.58, 0.50),
    "plinth": (0.25, 0.24, 0.22),
    "roof": (0.24, 0.085, 0.05),
    "glass": (0.035, 0.042, 0.05),
    "frame": (0.55, 0.53, 0.48),
    "door": (0.05, 0.11, 0.07),
    "chimney": (0.21, 0.09, 0.06),
}
_MATERIALS = {part: Material.model_validate({"reflectance": colour}) for part, colour in _COLOURS.items()}


@dataclass
class _Builder:
    """Flat polygons by material."""

    corners: dict[str, list[Floats]] = field(default_factory=dict)

    def quad(self, material: str, corners: Sequence[Sequence[float]] | Sequence[Floats]) -> None:
        """(4, 3) or (3, 3) corners, counter-clockwise seen from outside."""
        self.corners.setdefault(material, []).append(np.asarray(corners, dtype=np.float64))

    def box(self, material: str, low: Sequence[float], high: Sequence[float]) -> None:
        """A box along the axes, with all six faces."""
        (a, b, c), (d, e, f) = low, high
        for face in (
            [(a, b, c), (d, b, c), (d, b, f), (a, b, f)],
            [(d, e, c), (a, e, c), (a, e, f), (d, e, f)],
            [(d, b, c), (d, e, c), (d, e, f), (d, b, f)],
            [(a, e, c), (a, b, c), (a, b, f), (a, e, f)],
            [(a, b, f), (d, b, f), (d, e, f), (a, e, f)],
            [(a, e, c), (d, e, c), (d, b, c), (a, b, c)],
        ):
            self.quad(material, face)

    def meshes(self) -> dict[str, Mesh]:
        """A mesh with flat facets of each material."""
        found = {}
        for material, polygons in self.corners.items():
            vertices = np.concatenate(polygons).astype(np.float32)
            faces, start = [], 0
            for polygon in polygons:
                faces += [(start, start + k, start + k + 1) for k in range(1, len(polygon) - 1)]
                start += len(polygon)
            found[material] = Mesh(vertices, np.asarray(faces, dtype=np.uint32))
        return found


@dataclass(frozen=True)
class _Wall:
    """A wall's plane: a point of it at the ground, the way along it seen from outside, the way out; metres."""

    origin: Floats  # (3,)
    along: Floats  # (3,) unit
    out: Floats  # (3,) unit
    length_m: float
    height_m: float

    def at(self, x: float, z: float, out: float = 0.0) -> Floats:
        return np.asarray(self.origin + x * self.along + out * self.out + np.array([0.0, 0.0, z]))

    def rectangle(self, box: Box, out: float = 0.0) -> list[Floats]:
        left, bottom, right, top = box
        return [self.at(x, z, out) for x, z in ((left, bottom), (right, bottom), (right, top), (left, top))]


@dataclass(frozen=True)
class _Form:
    """A house's main measures, metres."""

    wall_x: float  # half of the walls' width
    wall_y: float  # half of their depth
    reach_x: float  # half of the roof's width
    reach_y: float  # half of its depth
    ridge: float
    slope: float  # tangent
    thick: float  # of the roof, upwards

    @property
    def eaves(self) -> float:
        """Height of the walls: where they meet the roof from below."""
        return self.under(self.wall_y)

    def over(self, y: float) -> float:
        """Height of the roof."""
        return self.ridge - self.slope * abs(y)

    def under(self, y: float) -> float:
        """Height of its lower side."""
        return self.over(y) - self.thick


def _form(keys: House) -> _Form:
    width, depth, height = keys.size_m
    overhang = min(keys.overhang_m, 0.1 * min(width, depth))
    reach_x, reach_y = 0.5 * width, 0.5 * depth
    slope = min(math.tan(math.radians(keys.roof_slope_deg)), 0.5 * height / reach_y)
    thick = min(_ROOF_THICK_M, 0.05 * height)
    return _Form(reach_x - overhang, reach_y - overhang, reach_x, reach_y, height, slope, thick)


class HouseKind(BuildingKind[House]):
    """A detached house."""

    Parameters = House
    materials = _MATERIALS

    def meshes(self, keys: House) -> dict[str, Mesh]:
        """O(windows + courses of tiles)."""
        form, builder = _form(keys), _Builder()
        for index, wall in enumerate(_walls(form)):
            _add_wall(builder, wall, _openings(keys, wall), _door(keys, wall) if index == 0 else None)
        for sign in (-1.0, 1.0):
            _add_gable(builder, form, sign)
            _add_roof(builder, form, sign, keys.course_m)
        if keys.chimney:
            _add_chimney(builder, form)
        return builder.meshes()


def _walls(form: _Form) -> list[_Wall]:
    """Front, right, back, left."""
    found = []
    for direction, half, away in (
        ((1.0, 0.0), form.wall_x, form.wall_y),
        ((0.0, 1.0), form.wall_y, form.wall_x),
        ((-1.0, 0.0), form.wall_x, form.wall_y),
        ((0.0, -1.0), form.wall_y, form.wall_x),
    ):
        along = np.array([*direction, 0.0])
        out = np.array([direction[1], -direction[0], 0.0])
        found.append(_Wall(away * out - half * along, along, out, 2 * half, form.eaves))
    return found


def _door(keys: House, wall: _Wall) -> Box | None:
    """The door near the wall's middle, if it fits."""
    width, height = keys.door_m
    if wall.height_m < height + 0.2 or wall.length_m < width + 2 * _MARGIN_M:
        return None
    middle = 0.5 * wall.length_m
    return middle - 0.5 * width, 0.05, middle + 0.5 * width, height


def _openings(keys: House, wall: _Wall) -> list[Box]:
    """Windows in rows, evenly spaced; as many as fit."""
    width, height = keys.window_m
    storeys = int((wall.height_m - 0.2) // keys.storey_m)
    room = wall.length_m - 2 * _MARGIN_M - width
    if room < 0 or storeys < 1:
        return []
    count = 1 + int(room / max(keys.window_spacing_m, width + 0.3))
    gap = wall.length_m / count
    found = []
    for storey in range(storeys):
        bottom = storey * keys.storey_m + 0.95
        for k in range(count):
            left = (k + 0.5) * gap - 0.5 * width
            found.append((left, bottom, left + width, bottom + height))
    return [box for box in found if box[3] < wall.height_m - 0.1]


def _apart(box: Box, other: Box) -> bool:
    gap = 0.25
    return box[2] + gap < other[0] or other[2] + gap < box[0] or box[3] + gap < other[1] or other[3] + gap < box[1]


def _add_wall(builder: _Builder, wall: _Wall, windows: list[Box], door: Box | None) -> None:
    """The wall around its openings, what stands in them, and its foot."""
    if door is not None:
        windows = [box for box in windows if _apart(box, door)]
    openings = [*windows, *([door] if door is not None else [])]
    xs = np.unique([0.0, wall.length_m, *(x for box in openings for x in (box[0], box[2]))])
    zs = np.unique([-_FOUNDATION_M, wall.height_m, *(z for box in openings for z in (box[1], box[3]))])
    for left, right in pairwise(xs):
        for bottom, top in pairwise(zs):
            x, z = 0.5 * (left + right), 0.5 * (bottom + top)
            if not any(box[0] < x < box[2] and box[1] < z < box[3] for box in openings):
                builder.quad("wall", wall.rectangle((left, bottom, right, top)))
    for box in windows:
        _add_sides(builder, "frame", wall.rectangle(box), wall.rectangle(box, -_RECESS_M))
        _add_window(builder, wall, box)
    if door is not None:
        _add_sides(builder, "frame", wall.rectangle(door), wall.rectangle(door, -_RECESS_M))
        builder.quad("door", wall.rectangle(door, -_RECESS_M))
    plinth = min(_PLINTH_M, 0.2 * wall.height_m)
    parts = [(0.0, wall.length_m)] if door is None else [(0.0, door[0]), (door[2], wall.length_m)]
    for left, right in parts:
        _add_slab(builder, "plinth", wall, (left, -_FOUNDATION_M, right, plinth), _PLINTH_OUT_M)


def _add_sides(builder: _Builder, material: str, first: list[Floats], second: list[Floats]) -> None:
    """The four sides between two rectangles, seen from outside where the second lies farther out."""
    for k in range(4):
        n = (k + 1) % 4
        builder.quad(material, [first[k], first[n], second[n], second[k]])


def _add_window(builder: _Builder, wall: _Wall, box: Box) -> None:
    """A pane, a frame around it, a cross of bars, and a sill below."""
    left, bottom, right, top = box
    builder.quad("glass", wall.rectangle(box, -_RECESS_M))
    x, z = 0.5 * (left + right), bottom + 0.62 * (top - bottom)
    front, half = -_RECESS_M + 0.03, 0.5 * _BAR_M
    for bar in (
        (left, bottom, right, bottom + _FRAME_M),
        (left, top - _FRAME_M, right, top),
        (left, bottom, left + _FRAME_M, top),
        (right - _FRAME_M, bottom, right, top),
        (x - half, bottom, x + half, top),
        (left, z - half, right, z + half),
    ):
        builder.quad("frame", wall.rectangle(bar, front))
    _add_slab(builder, "frame", wall, (left - 0.06, bottom - 0.06, right + 0.06, bottom), 0.07)


def _add_slab(builder: _Builder, material: str, wall: _Wall, box: Box, outer: float) -> None:
    """A slab on a wall: its face and four edges."""
    face = wall.rectangle(box, outer)
    builder.quad(material, face)
    _add_sides(builder, material, wall.rectangle(box), face)


def _add_gable(builder: _Builder, form: _Form, sign: float) -> None:
    """The triangle above the eaves on one end."""
    x, y = sign * form.wall_x, form.wall_y
    triangle = [(x, -sign * y, form.eaves), (x, sign * y, form.eaves), (x, 0.0, form.under(0.0))]
    builder.quad("wall", triangle)


def _add_roof(builder: _Builder, form: _Form, sign: float, course_m: float) -> None:
    """One side of the roof: courses of tiles above, boards below and at the edges."""
    x, y = form.reach_x, form.reach_y

    def strip(material: str, first: tuple[float, float], last: tuple[float, float]) -> None:
        """Along the whole roof, between two points of its section; seen from outside where the first is the lower."""
        (y0, z0), (y1, z1) = first, last
        corners = [(-x, sign * y0, z0), (x, sign * y0, z0), (x, sign * y1, z1), (-x, sign * y1, z1)]
        builder.quad(material, corners if sign < 0 else corners[::-1])

    courses = max(1, round(y * math.hypot(1.0, form.slope) / course_m))
    ys = np.linspace(y, 0.0, courses + 1)
    up = min(_TILE_UP_M, 0.2 * form.thick)
    for lower, upper in pairwise(ys):
        # A course's lower edge stands up over the one below; the ridge stays the highest line.
        strip("roof", (lower, form.over(lower) - up), (lower, form.over(lower)))
        strip("roof", (lower, form.over(lower)), (upper, form.over(upper) - up * (upper > 0)))
    strip("frame", (y, form.under(y)), (y, form.over(y) - up))
    strip("frame", (0.0, form.under(0.0)), (y, form.under(y)))
    section = [(sign * y, form.under(y)), (sign * y, form.over(y)), (0.0, form.over(0.0)), (0.0, form.under(0.0))]
    for end in (-1.0, 1.0):
        corners = [(end * x, at, z) for at, z in section]
        builder.quad("frame", corners if end * sign < 0 else corners[::-1])


def _add_chimney(builder: _Builder, form: _Form) -> None:
    """A chimney through one side of the roof, with a cap; up to 0.7 m above the ridge."""
    side = min(0.3, 0.08 * form.wall_x + 0.05)
    x, y = 0.45 * form.wall_x, min(0.8, 0.3 * form.wall_y)
    top = form.ridge + min(0.7, 0.1 * form.ridge)
    builder.box("chimney", (x - side, y - side, form.under(y + side) - 0.1), (x + side, y + side, top))
    rim = side + 0.05
    builder.box("plinth", (x - rim, y - rim, top), (x + rim, y + rim, top + 0.06))


BUILDING = HouseKind()
