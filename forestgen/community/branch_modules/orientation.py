"""Orientation: young branch modules turn to where there is room and towards their angle with the vertical.

Reference: M. Makowski et al., Synthetic Silviculture, 2019, in the form of the book of 2023, Eqs. 3 to 6. ::

    f_distribution(u) = w1 f_collisions(u) + w2 |cos alpha_tropism - cos u_alpha|
    u^(i+1) = rot(u^(i), rho*),   rho* the best of P

f_collisions is the crowding of Eq. 1, over the module's own volume, for the sphere that the module will have when it is
grown, among the spheres of grown modules and those that other young ones will have. u_alpha is the angle of the
module's axis with the vertical. P is in the paper ± alpha in the first and the third Euler angle; which two axes these
turn about depends on the convention, which it does not give. Here they are small rotations about the module's two axes
across its own (x and y of its frame), and staying as it is. So a step never makes
it worse for a module whose neighbours stay.

Decided where the print is silent:

- Modules that turn in one step look at the last state. If all did so at once, neighbours that flee each other would
  meet again; so each step has two halves, modules of even rows turn, then those of odd rows see them turned. Siblings
  have rows one after another. The result depends neither on the number of threads nor on chance.
- The angle of step i is angle_rad x 0.7^i: first across a gap, then into it.
- The ground is an obstacle too, where it is given: the volume below the height of the ground at the plant counts.
- Modules that share a joint with the one that turns are left out, as in Eq. 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, floor, pi, sin, sqrt

import numpy as np
from numpy.typing import NDArray

from forestgen.community.branch_modules.crowding import (
    LEAST_RADIUS_M,
    NO_BOXES,
    Boxes,
    Cells,
    SphereGrid,
    cells_of,
    nearest_image,
    runs,
    volume_in_boxes,
    without,
)
from forestgen.core.compiled import compiled, unchecked, unowned_view
from forestgen.core.threads import parallel_for

SHRINKING = 0.7  # of the angle from step to step
_CHOICES = 5

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Turning:
    """Modules that may turn, one row each."""

    base_world_m: Floats  # (N, 3) root node, metres, world frame
    rotation: NDArray[np.floating]  # (N, 4) unit quaternion w, x, y, z: module's frame -> world's axes
    centre_m: NDArray[np.floating]  # (N, 3) of the sphere when grown, metres from the root node, module's frame
    radius_m: NDArray[np.floating]  # (N,) of the sphere when grown
    row: NDArray[np.integer]  # (N,) its row in the grid of all modules, where it is taken out; -1: not in it, just born
    parent_row: NDArray[np.integer]  # (N,) row in that grid of the module that bears it; -1: a root
    tropism_angle_rad: NDArray[np.floating]  # (N,) alpha_tropism, from the vertical
    tropism_weight: NDArray[np.floating]  # (N,) w2
    collision_weight: NDArray[np.floating]  # (N,) w1
    ground_m: Floats | None = None  # (N,) world z of the ground below; None: the ground is no obstacle

    def __len__(self) -> int:
        return len(self.radius_m)


# Columns of `_table`'s rows.
_X, _Y, _Z, _CX, _CY, _CZ, _R, _ARM, _COS, _TROPISM, _COLLISION, _GROUND = range(12)


@compiled
def _matrix(q):  # type: ignore[no-untyped-def]
    """The rotation of a unit quaternion w, x, y, z as a matrix, row by row."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    return (
        1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y),
        2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x),
        2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y),
    )  # fmt: skip


@compiled
def _tilted(choice, c, s, x, y, z):  # type: ignore[no-untyped-def]
    """Vector x, y, z after a turn by the angle of cosine c and sine s: 0 none, 1 and 2 about x, 3 and 4 about y."""
    if choice == 0:
        return x, y, z
    s = s if choice % 2 else -s
    if choice < 3:
        return x, y * c - z * s, z * c + y * s
    return x * c + z * s, y, z * c - x * s


@compiled
def _turned(q, choice, angle):  # type: ignore[no-untyped-def]
    """`q` after a turn in its own frame; see `_tilted`."""
    half = 0.5 * angle if choice % 2 else -0.5 * angle
    c, s = cos(half), sin(half)
    if choice < 3:
        w, x, y, z = q[0] * c - q[1] * s, q[1] * c + q[0] * s, q[2] * c + q[3] * s, q[3] * c - q[2] * s
    else:
        w, x, y, z = q[0] * c - q[2] * s, q[1] * c - q[3] * s, q[2] * c + q[0] * s, q[3] * c + q[1] * s
    size = sqrt(w * w + x * x + y * y + z * z)
    return w / size, x / size, y / size, z / size


@compiled
def _place(table, rotation, at, width, height):  # type: ignore[no-untyped-def]
    """Set `at` (N, 4) to the spheres' centres, world frame, and radii; on a torus put all between 0 and its sides."""
    for i in range(len(table)):
        m = _matrix((rotation[i, 0], rotation[i, 1], rotation[i, 2], rotation[i, 3]))
        x, y, z = table[i, _CX], table[i, _CY], table[i, _CZ]
        at[i, 0] = table[i, _X] + m[0] * x + m[1] * y + m[2] * z
        at[i, 1] = table[i, _Y] + m[3] * x + m[4] * y + m[5] * z
        at[i, 2] = table[i, _Z] + m[6] * x + m[7] * y + m[8] * z
        at[i, 3] = table[i, _R]
        if width > 0.0:
            across, along = floor(at[i, 0] / width) * width, floor(at[i, 1] / height) * height
            at[i, 0], table[i, _X] = at[i, 0] - across, table[i, _X] - across
            at[i, 1], table[i, _Y] = at[i, 1] - along, table[i, _Y] - along


@compiled
def _neighbours(i, own, reach, fixed, moving, at, rows, run, near):  # type: ignore[no-untyped-def]
    """Put into `near` (4, K) the spheres that meet one at `own` of radius `reach`, from there; their number.

    Negative where there is no room: -1 in `run`, -2 in `near`.
    """
    x, y, z, row, bearer = own[0], own[1], own[2], rows[i, 0], rows[i, 1]
    count, most, width, height = 0, near.shape[1], fixed.width, fixed.height
    found = runs(x, y, z, reach, fixed, run)
    for k in range(found):
        if run[k, 1] - run[k, 0] + count > most:
            return -2
        for j in range(run[k, 0], run[k, 1]):
            dx = nearest_image(fixed.sphere[j, 0] - x, width)
            dy = nearest_image(fixed.sphere[j, 1] - y, height)
            dz, sum_m = fixed.sphere[j, 2] - z, reach + fixed.sphere[j, 3]
            if dx * dx + dy * dy + dz * dz < sum_m * sum_m and fixed.row[j] != bearer:
                near[0, count], near[1, count], near[2, count], near[3, count] = dx, dy, dz, fixed.sphere[j, 3]
                count += 1
    if found < 0:
        return -1
    found = runs(x, y, z, reach, moving, run)
    for k in range(found):
        if run[k, 1] - run[k, 0] + count > most:
            return -2
        for place in range(run[k, 0], run[k, 1]):
            j = moving.row[place]
            dx, dy = nearest_image(at[j, 0] - x, width), nearest_image(at[j, 1] - y, height)
            dz, sum_m = at[j, 2] - z, reach + at[j, 3]
            if dx * dx + dy * dy + dz * dz < sum_m * sum_m and j != i:
                if (rows[j, 0] >= 0 and rows[j, 0] == bearer) or (row >= 0 and row == rows[j, 1]):
                    continue
                near[0, count], near[1, count], near[2, count], near[3, count] = dx, dy, dz, at[j, 3]
                count += 1
    return -1 if found < 0 else count


@unchecked
def _lenses(x, y, z, r, near, count, out):  # type: ignore[no-untyped-def]
    """Set `out` to the volumes that a sphere shares with the first `count` of `near`.

    The formula of `crowding.lens` without branches: a distance below |r - s| counts as that, and the small sphere
    lies in the large one.
    """
    for k in range(count):
        dx, dy, dz, s = near[0, k] - x, near[1, k] - y, near[2, k] - z, near[3, k]
        both, less = r + s, r - s
        d = min(max(sqrt(dx * dx + dy * dy + dz * dz), max(abs(less), 1e-9)), both)
        gap = both - d
        out[k] = gap * gap * (d * d + 2.0 * d * both - 3.0 * less * less) / d


@compiled
def _below(z, r, ground):  # type: ignore[no-untyped-def]
    """Volume of a sphere below a horizontal plane."""
    depth = min(max(ground - z + r, 0.0), 2.0 * r)
    return pi * depth * depth * (r - depth / 3.0)


@compiled
def _turn(first, end, parity, angle, table, rows, fixed, moving, boxes, at, rotation, new_at, new_rotation):  # type: ignore[no-untyped-def]
    """Best choice of each module at places `first` to `end` of `moving`, of that parity; all are `at`, `rotation`."""
    table, rows, at = unowned_view(table), unowned_view(rows), unowned_view(at)
    fixed, moving = unowned_view(fixed), unowned_view(moving)
    room, space, shared = np.empty((256, 2), dtype=np.int64), np.empty((4, 256)), np.empty(256)
    # The loop reads room, space and shared: they live.
    run, near, common = unowned_view(room), unowned_view(space), unowned_view(shared)
    c, s, width, height = cos(angle), sin(angle), fixed.width, fixed.height
    for place in range(first, end):
        i = moving.row[place]
        if rows[i, 2] != parity:
            continue
        x, y, z, r = at[i, 0], at[i, 1], at[i, 2], at[i, 3]
        count = _neighbours(i, (x, y, z), r + angle * table[i, _ARM], fixed, moving, at, rows, run, near)
        while count < 0:
            if count == -1:
                room = np.empty((2 * len(room), 2), dtype=np.int64)
                run = unowned_view(room)
            else:
                space, shared = np.empty((4, 2 * space.shape[1])), np.empty(2 * len(shared))
                near, common = unowned_view(space), unowned_view(shared)
            count = _neighbours(i, (x, y, z), r + angle * table[i, _ARM], fixed, moving, at, rows, run, near)
        start = (rotation[i, 0], rotation[i, 1], rotation[i, 2], rotation[i, 3])
        m = _matrix(start)
        base_x, base_y, base_z = table[i, _X] - x, table[i, _Y] - y, table[i, _Z] - z
        own, least, best = 4.0 / 3.0 * pi * r * r * r, np.inf, 0
        for choice in range(_CHOICES):
            a, b, d = _tilted(choice, c, s, table[i, _CX], table[i, _CY], table[i, _CZ])
            px = base_x + m[0] * a + m[1] * b + m[2] * d
            py = base_y + m[3] * a + m[4] * b + m[5] * d
            pz = base_z + m[6] * a + m[7] * b + m[8] * d
            _lenses(px, py, pz, r, near, count, common)
            volume = 0.0
            for k in range(count):
                volume += common[k]
            volume = pi / 12.0 * volume + _below(z + pz, r, table[i, _GROUND])
            if len(boxes) > 0:
                volume += volume_in_boxes(x + px, y + py, z + pz, r, boxes, width, height)
            a, b, d = _tilted(choice, c, s, 0.0, 0.0, 1.0)
            up = m[6] * a + m[7] * b + m[8] * d
            worth = table[i, _COLLISION] * volume / own + table[i, _TROPISM] * abs(table[i, _COS] - up)
            if worth < least - 1e-9:
                least, best = worth, choice
                new_at[i, 0], new_at[i, 1], new_at[i, 2] = x + px, y + py, z + pz
        if best:
            q = _turned(start, best, angle)
            for d in range(4):
                new_rotation[i, d] = q[d]


def orient(
    grid: SphereGrid, turning: Turning, *, steps: int = 3, angle_rad: float = 0.35, boxes: Boxes = NO_BOXES
) -> NDArray[np.float32]:
    """(N, 4) float32 unit quaternions of young modules after `steps` turns.

    `grid` holds the spheres of all modules. Those that turn are taken out by their rows; their spheres count as they
    will be when grown. They come in the order of rows, newborn ones too. `angle_rad` is alpha of the first step.
    """
    n = len(turning)
    rotation = np.array(turning.rotation, dtype=np.float64).reshape(n, 4)
    if n == 0 or steps < 1:
        return rotation.astype(np.float32)
    table, rows = _table(turning)
    at = np.empty((n, 4))
    _place(table, rotation, at, *(grid.period_m or (0.0, 0.0)))
    moving = cells_of(at[:, :3], table[:, _R] + angle_rad * table[:, _ARM], grid.period_m)
    # From here on in the order of the grid: neighbours lie together in memory.
    order = moving.row
    table, rows, rotation, at = table[order], rows[order], rotation[order], at[order]
    moving = moving._replace(row=np.arange(n, dtype=np.int32))
    turns = np.zeros(len(grid), dtype=np.bool_)
    turns[rows[rows[:, 0] >= 0, 0]] = True
    fixed, boxes_rows = without(grid.cells, turns), boxes.rows
    new_rotation, new_at = rotation.copy(), at.copy()

    def turn_half(parity: int, angle: float, moving: Cells) -> None:
        others = fixed, moving, boxes_rows
        places = at, rotation, new_at, new_rotation
        parallel_for(n, lambda first, end: _turn(first, end, parity, angle, table, rows, *others, *places))
        at[:], rotation[:] = new_at, new_rotation

    for step in range(steps):
        angle = angle_rad * SHRINKING**step
        if step:  # where they are now, with room for what they may turn in this step
            moving = cells_of(at[:, :3], table[:, _R] + angle * table[:, _ARM], grid.period_m)
        for parity in (0, 1):
            turn_half(parity, angle, moving)
    out = np.empty((n, 4), dtype=np.float32)
    out[order] = rotation
    return out


def _table(turning: Turning) -> tuple[Floats, NDArray[np.int64]]:
    """(N, 12) what `_turn` needs of each module; (N, 3) its row, that of its bearer, and which half it is in."""
    n, centre = len(turning), np.asarray(turning.centre_m, dtype=np.float64)
    radius, arm = np.maximum(turning.radius_m, LEAST_RADIUS_M), np.sqrt((centre**2).sum(axis=1))
    cosine = np.cos(np.asarray(turning.tropism_angle_rad, dtype=np.float64))
    ground = np.full(n, -np.inf) if turning.ground_m is None else turning.ground_m
    weights = turning.tropism_weight, turning.collision_weight
    table = np.column_stack([turning.base_world_m, centre, radius, arm, cosine, *weights, ground])
    rows = np.column_stack([turning.row, turning.parent_row, np.arange(n) % 2])
    return table.astype(np.float64), rows.astype(np.int64)
