"""Strand trees of Zamuda et al. (2007): who divides into what, where it then stands, and its leaves.

Branch segments are numbered as a skeleton's nodes: node 0 is the foot, node 1 the trunk's base segment; the nodes of
an axis follow one another, and every segment comes after the one that bears it. Formulas and decisions are in
`generators/strands.py`.

Leaves sit on branches of one strand. The paper names the arrangements and does not draw them. Here they are:

========== ====================================================================================================
spiral     one after the other along the branch, each turned by 137.5 degrees
stacked    pairs, left and right at one place, all in the same, level plane
staggered  one after the other, by turns left and right, in the same, level plane
bunched    all in a tuft at the branch's end, on a spiral, the outer ones spread wider
coniferous close together along the whole branch on a spiral, leaning forward, upper sides along the branch
========== ====================================================================================================

The density of leaves is their number on a branch of one strand.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from forestgen.core.compiled import assign, compiled
from forestgen.geometry.mesh import UP, Floats, Ints, Mesh, unit
from forestgen.plants.branching import around
from forestgen.plants.foliage import droop, organ_frames
from forestgen.plants.skeleton import OrganPlacements, check_budget
from forestgen.recipe.curves import PositiveCurve, evaluate_one
from forestgen.recipe.fields import Section

ORDERS = 256  # entries of a table of local parameters; orders beyond take the last one
SPLIT, ANGLE, SHORTEST, LONGEST, LENGTH, GRAVIMORPHISM = range(6)  # rows of the tables
JITTERS = 5  # split, turn, tilt, azimuth, length
_GOLDEN_DEG = 137.5
_LEAF_BYTES = 1500  # a leaf's draws, frame and some ten triangles with their normals


class Wind(Section):
    """The wind that a plant stands in."""

    speed_directed: float = Field(default=0.0, ge=0, le=10, description="w_g: greatest bend of one segment, degrees")
    speed_undirected: float = Field(
        default=0.0, ge=0, le=10, description="w_s: sway past a 1 m segment, stiffness 0, degrees"
    )
    axis: tuple[float, float, float] = Field(
        default=(0.0, 1.0, 0.0),
        description="w: the axis that segments turn about, plant frame; [0, 1, 0] is a wind towards +x, [-1, 0, 0] "
        "one towards +y, [0, 0, 1] turns without bending",
    )
    bends: Literal["thin", "thick"] = Field(
        default="thin", description="alpha_w = (1 - S_0/S) w_g: twigs give way; or as printed, alpha_w = S_0/S w_g"
    )
    time_s: float = Field(
        default=0.0, ge=-1e6, le=1e6, description="t: time of the pose, seconds; a sway takes 2 pi seconds"
    )

    @model_validator(mode="after")
    def _has_axis(self) -> Self:
        if not np.linalg.norm(self.axis) > 1e-9:
            raise ValueError("the wind's axis must not be zero")
        return self


class Leaves(Section):
    """Leaves of the branches that carry one strand, or few."""

    shape: str = Field(description="name of an organ shape")
    arrangement: Literal["spiral", "stacked", "staggered", "bunched", "coniferous"] = Field(
        "spiral", description="l_type: spiral, stacked, staggered, bunched or coniferous"
    )
    density: PositiveCurve = Field(
        ((0.0, 5.0),), description="rho_l: leaves a strand, by height in metres; at most 200"
    )
    up_to_strands: int = Field(1, ge=1, le=100, description="branches of so many strands or fewer bear leaves")
    size_m: float | None = Field(
        None, gt=0, le=2, description="l_l: leaf's length with its stalk, in proportion; null: the shape's own"
    )
    size_by_height: PositiveCurve = Field(((0.0, 1.0),), description="factor on size over height in metres")
    size_jitter: float = Field(0.0, ge=0, lt=0.5, description="standard deviation of the size, as a share")
    zone: tuple[float, float] = Field((0.1, 1.0), description="part of the branch that bears leaves: 0 base, 1 tip")
    angle_deg: float = Field(55.0, ge=0, le=180, description="angle from the branch, degrees")
    angle_jitter_deg: float = Field(0.0, ge=0, description="standard deviation of that angle, degrees")
    turn_jitter_deg: float = Field(0.0, ge=0, description="standard deviation of the turn about the branch, degrees")
    droop_deg: float = Field(0.0, description="turn towards the ground, of a level leaf, degrees")
    roll_jitter_deg: float = Field(0.0, ge=0, description="standard deviation of the turn about the midrib, degrees")


@dataclass(frozen=True)
class Branching:
    """Who divides into what: N - 1 segments and the foot, node 0. It does not change in the wind."""

    parent: Ints  # (N,) -1 for the foot
    axis: Ints  # (N,) a major sub-branch continues its axis, a minor one begins the next
    strands: Ints  # (N,) S_0
    gravelius: Ints  # (N,) g
    weibull: Ints  # (N,) w
    length_m: Floats  # (N,) l_0, metres; 0 at the foot
    turn_rad: Floats  # (N,) alpha_1 of a major segment, -alpha_2 of a minor one, about its bearer's z
    tilt_rad: Floats  # (N,) the individual's own angle about x
    azimuth_rad: Floats  # (N,) alpha_p about its bearer's y
    lift_rad: Floats  # (N,) alpha_m of its bearer
    scale: float = 1.0  # what the lengths were multiplied by, and diameters are to be


@dataclass(frozen=True)
class Pose:
    """Where the segments of a `Branching` stand."""

    position_m: Floats  # (N, 3) ends of the segments, metres, plant frame
    rotation: Floats  # (N, 3, 3) segment frame -> plant frame; y along the segment


def pose(branching: Branching, wind: Wind, stiffness: float, phases_rad: Floats) -> Pose:
    """The branching in a wind, its segments placed one after the other.

    `stiffness`: k_f, 0 to 1. `phases_rad`: (N, 2) R_x and R_z of each segment.
    """
    bearer = np.maximum(branching.parent, 0)
    amplitude = np.radians(wind.speed_undirected) * (1.0 - stiffness) * branching.length_m[bearer]
    sway = np.sin(wind.time_s + phases_rad) * amplitude[:, None]
    share = branching.strands[bearer] / branching.strands[0]
    bend = np.radians(wind.speed_directed) * (share if wind.bends == "thick" else 1.0 - share)
    axis = unit(np.array(wind.axis, dtype=np.float64))
    b = branching
    return Pose(*_stand(b.parent, b.length_m, b.turn_rad, b.tilt_rad, b.azimuth_rad, b.lift_rad, sway, bend, axis))


@compiled
def product(row: int, by_order: Floats, by_depth: Floats, g: int, w: int) -> Any:
    """Local parameter of an order (g, w): Eqs. 1 to 6."""
    value = by_order[row, min(g, by_order.shape[1] - 1)] * by_depth[row, min(w, by_depth.shape[1] - 1)]
    if row == SPLIT:
        return max(min(value, 1.0), 0.5)
    if row == ANGLE:
        return min(value, np.pi)
    if row == GRAVIMORPHISM:
        return max(min(value, np.pi), -np.pi)
    return value


@compiled
def divide(  # type: ignore[no-untyped-def]
    strands, least, trunk_m, gravicentralism, phyllotaxis, by_order, by_depth, jitter, normals
):
    """Divide the strands until every branch has `least` of them or fewer.

    Returns the columns of `Branching`: (N, 5) whole numbers from `parent` on, (N, 5) others from `length_m` on.

    Parameters
    ----------
    trunk_m : length of the base segment, metres; phyllotaxis : alpha_p, radians.
    by_order, by_depth : (6, ORDERS) auxiliary parameters over the Gravelius and the Weibull order; angles in radians.
    jitter : (JITTERS,) standard deviations of k_s, alpha (twice), alpha_p (radians) and of the logarithm of l.
    normals : (3 strands, JITTERS) standard normal numbers, or (1, JITTERS) zeros.
    """
    size = 2 * strands
    tree, shape = np.zeros((size, 5), np.int64), np.zeros((size, 5))
    assign(tree[0], (-1, 0, strands, 0, 0))
    # Axes that wait for their turn: a minor sub-branch is written here, and copied to its place when that is known.
    waiting = np.zeros((strands, 4), np.int64)  # bearer, strands, g, w
    forms = np.zeros((strands, 6))  # relative and actual length, turn, tilt, azimuth, lift
    assign(waiting[0], (0, strands, 0, 0))
    assign(forms[0], (1.0, trunk_m, 0.0, 0.0, 0.0, 0.0))
    queued, done, node = 1, 0, 1
    last = len(normals) - 1
    while done < queued:
        bearer, s, g, w = waiting[done]
        ratio, actual, turned, tilted, turned_about, lifted = forms[done]
        while True:
            assign(tree[node], (bearer, done, s, g, w))
            assign(shape[node], (actual, turned, tilted, turned_about, lifted))
            if s <= least:
                break
            split = product(SPLIT, by_order, by_depth, g, w)
            split = max(min(split + jitter[0] * normals[min(node, last), 0], 1.0), 0.5)
            # The smallest of shares must not make a whole number one more than it is.
            major = max(1, min(s - 1, int(np.ceil(1.0 + split * (s - 2) - 1e-9))))
            minor = s - major
            alpha = product(ANGLE, by_order, by_depth, g, w)
            first = gravicentralism * np.sqrt(minor / s) * alpha
            lifted = product(GRAVIMORPHISM, by_order, by_depth, g, w)
            longest = product(LONGEST, by_order, by_depth, g, w)
            shortest = product(SHORTEST, by_order, by_depth, g, w)
            scale = product(LENGTH, by_order, by_depth, g, w)
            minor_ratio = max(min(np.sqrt(minor / s), longest), shortest) * ratio
            ratio *= max(min(np.sqrt(major / s), longest), shortest)
            # The heavier sub-branch strays less from its angle, as Algorithm 1 has it turn less.
            draw = normals[min(size + queued, last)]
            sway = np.sqrt(major / s)
            assign(waiting[queued], (node, minor, g + 1, w + 1))
            child = (
                minor_ratio,
                scale * minor_ratio * np.exp(jitter[4] * draw[4]),
                first - alpha + jitter[1] * sway * draw[1],
                jitter[2] * sway * draw[2],
                phyllotaxis + jitter[3] * normals[min(node, last), 3],
                lifted,
            )
            assign(forms[queued], child)
            queued += 1
            draw = normals[min(node, last)]
            sway = np.sqrt(minor / s)
            actual = scale * ratio * np.exp(jitter[4] * draw[4])
            turned, tilted = first + jitter[1] * sway * draw[1], jitter[2] * sway * draw[2]
            turned_about = phyllotaxis + jitter[3] * draw[3]
            bearer, s, w = node, major, w + 1
            node += 1
        node += 1
        done += 1
    return tree[:node], shape[:node]


@compiled
def _turned(frame: Floats, axis: Floats, angle: float) -> Floats:
    """The (3, 3) frame times a rotation about a unit axis of its own."""
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = axis
    rest = 1.0 - c
    turn = np.empty((3, 3))
    assign(turn[0], (c + x * x * rest, x * y * rest - z * s, x * z * rest + y * s))
    assign(turn[1], (y * x * rest + z * s, c + y * y * rest, y * z * rest - x * s))
    assign(turn[2], (z * x * rest - y * s, z * y * rest + x * s, c + z * z * rest))
    out = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            out[i, j] = frame[i, 0] * turn[0, j] + frame[i, 1] * turn[1, j] + frame[i, 2] * turn[2, j]
    return out


@compiled
def _stand(  # type: ignore[no-untyped-def]
    parent, length, turn, tilt, azimuth, lift, sway, bend, axis
) -> Any:
    n = len(parent)
    position = np.zeros((n, 3))
    rotation = np.zeros((n, 3, 3))
    still = np.zeros((n, 3, 3))  # the same without directed wind: gravimorphism asks where down would be at rest
    ex, ey, ez = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
    # The paper's y, along the trunk, is up: the plant frame's z.
    rotation[0, 0, 0], rotation[0, 2, 1], rotation[0, 1, 2] = 1.0, 1.0, -1.0
    still[0, 0, 0], still[0, 2, 1], still[0, 1, 2] = 1.0, 1.0, -1.0
    local = np.empty(3)
    for i in range(1, n):
        bearer = parent[i]
        frame, calm = rotation[bearer], still[bearer]
        if bearer > 0:
            # y_m = down seen from the bearer; y x y_m in the bearer's frame is (z of y_m, 0, -x of y_m).
            x, y, z = -calm[2, 0], -calm[2, 1], -calm[2, 2]
            sine = np.sqrt(x * x + z * z)
            if lift[i] != 0.0 and sine > 1e-9:
                local[0], local[1], local[2] = z / sine, 0.0, -x / sine
                away = np.arctan2(sine, y)
                angle = max(min(lift[i], away), away - np.pi)
                frame, calm = _turned(frame, local, angle), _turned(calm, local, angle)
            for about, angle in ((ey, azimuth[i]), (ex, tilt[i] + sway[i, 0]), (ez, turn[i] + sway[i, 1])):
                if angle != 0.0:
                    frame, calm = _turned(frame, about, angle), _turned(calm, about, angle)
            if bend[i] != 0.0:
                for k in range(3):  # the wind's axis seen from the segment
                    local[k] = frame[0, k] * axis[0] + frame[1, k] * axis[1] + frame[2, k] * axis[2]
                frame = _turned(frame, local, bend[i])
        for k in range(3):
            assign(rotation[i, k], frame[k])
            assign(still[i, k], calm[k])
            position[i, k] = position[bearer, k] + length[i] * frame[k, 1]
    return position, rotation


def leaf_places(
    leaves: Leaves, template: Mesh, branching: Branching, rest: Pose, height_m: float, rng: np.random.Generator
) -> OrganPlacements:
    """Frames of all leaves on the branches that do not divide, in the plant at rest.

    Where a level of detail cut a branch of several strands short, its leaves are larger by the root of their number,
    so that the area stays.

    Raises `RecipeError`: more leaves than memory holds.
    """
    density = min(round(evaluate_one(leaves.density, height_m)), 200)
    ends = np.ones(len(branching.parent), bool)
    ends[branching.parent[1:]] = False
    bearer = ends | (branching.strands <= leaves.up_to_strands)
    bearer[0] = False
    node = np.flatnonzero(bearer)
    check_budget("leaves", float(len(node)) * density, _LEAF_BYTES, "fewer strands, or a smaller leaves.density")
    rank = np.tile(np.arange(density), len(node))
    node = np.repeat(node, density)
    tangent = rest.rotation[node, :, 1]
    share, azimuth, angle = _arranged(leaves, rank, density)
    phase = rng.uniform(0.0, 2.0 * np.pi, len(branching.parent))[node]
    if leaves.arrangement in ("stacked", "staggered"):
        phase = np.where(phase > np.pi, np.pi, 0.0)
    azimuth = azimuth + phase + np.radians(leaves.turn_jitter_deg) * rng.normal(size=len(node))
    angle = angle + np.radians(leaves.angle_jitter_deg) * rng.normal(size=len(node))
    along = droop(around(tangent, azimuth, angle), np.radians(leaves.droop_deg))
    foot = rest.position_m[node] - ((1.0 - share) * branching.length_m[node])[:, None] * tangent
    size = np.clip(1.0 + leaves.size_jitter * rng.normal(size=len(node)), 0.4, 1.6)
    own_size = 1.0 if leaves.size_m is None else leaves.size_m / float(np.ptp(template.vertices_m[:, 1]))
    own_size *= evaluate_one(leaves.size_by_height, height_m)
    size = size * own_size * np.sqrt(np.where(ends, branching.strands, 1)[node])
    roll = np.radians(leaves.roll_jitter_deg) * rng.normal(size=len(node))
    upper = tangent if leaves.arrangement == "coniferous" else np.broadcast_to(UP, tangent.shape)
    frame = organ_frames(foot, along, upper, roll, size)
    return OrganPlacements(leaves.shape, frame.astype(np.float32), node.astype(np.int32))


def _arranged(leaves: Leaves, rank: Ints, density: int) -> tuple[Floats, Floats, Floats]:
    """Position on the branch (0 base, 1 tip), turn about it, and angle from it, radians."""
    foot, tip = leaves.zone
    angle = np.full(len(rank), np.radians(leaves.angle_deg))
    place = (rank + 0.5) / max(density, 1)
    turn = np.radians(_GOLDEN_DEG) * rank
    if leaves.arrangement in ("stacked", "staggered"):
        turn = np.pi * (rank % 2)
    if leaves.arrangement == "stacked":
        place = (rank // 2 + 0.5) / max((density + 1) // 2, 1)
    elif leaves.arrangement == "bunched":
        angle, place = angle * np.sqrt(place), np.ones(len(rank))
    return foot + (tip - foot) * place, turn, angle


def carried(organs: OrganPlacements, rest: Pose, pose: Pose) -> OrganPlacements:
    """The organs of a plant at rest, moved with the segments that bear them; an organ keeps its seat on its branch."""
    node = organs.node
    turn = pose.rotation[node] @ rest.rotation[node].transpose(0, 2, 1)
    seat = organs.frame[:, :, 3] - rest.position_m[node]
    frame = np.empty_like(organs.frame)
    frame[:, :, :3] = turn @ organs.frame[:, :, :3]
    frame[:, :, 3] = pose.position_m[node] + np.einsum("nij,nj->ni", turn, seat)
    return replace(organs, frame=frame)
