"""Leaves on branches of one strand: the five arrangements of Zamuda et al. (2007).

The paper names the arrangements and does not draw them. Here they are:

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

from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from forestgen.geometry.mesh import Mesh
from forestgen.plants.branching import around
from forestgen.plants.budget import check_budget
from forestgen.plants.foliage import droop, organ_frames
from forestgen.plants.skeleton import OrganPlacements
from forestgen.plants.strands.kernel import Branching, Pose
from forestgen.recipe.curves import PositiveCurve, evaluate_one
from forestgen.recipe.fields import Section

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_GOLDEN_DEG = 137.5
_UP = np.array([0.0, 0.0, 1.0])
_LEAF_BYTES = 1500  # a leaf's draws, frame and some ten triangles with their normals


class Leaves(Section):
    """Leaves of the branches that carry one strand, or few."""

    shape: str = Field(description="name of an organ shape")
    arrangement: Literal["spiral", "stacked", "staggered", "bunched", "coniferous"] = Field(
        "spiral", description="l_type: spiral, stacked, staggered, bunched or coniferous"
    )
    density: PositiveCurve = Field(
        ((0.0, 5.0),),
        description="rho_l: leaves on a branch of one strand, by the plant's height in metres; at most 200",
    )
    up_to_strands: int = Field(1, ge=1, le=100, description="branches of so many strands or fewer bear leaves")
    size_m: float | None = Field(
        None,
        gt=0,
        le=2,
        description="l_l: length of the leaf with its stalk; its proportions are the shape's. None: the shape's own",
    )
    size_by_height: PositiveCurve = Field(
        ((0.0, 1.0),), description="factor on the size over the plant's height in metres"
    )
    size_jitter: float = Field(0.0, ge=0, lt=0.5, description="standard deviation of the size, as a share")
    zone: tuple[float, float] = Field((0.1, 1.0), description="part of the branch that bears leaves: 0 base, 1 tip")
    angle_deg: float = Field(55.0, ge=0, le=180, description="angle from the branch, degrees")
    angle_jitter_deg: float = Field(0.0, ge=0, description="standard deviation of that angle, degrees")
    turn_jitter_deg: float = Field(0.0, ge=0, description="standard deviation of the turn about the branch, degrees")
    droop_deg: float = Field(0.0, description="turn towards the ground, of a level leaf, degrees")
    roll_jitter_deg: float = Field(0.0, ge=0, description="standard deviation of the turn about the midrib, degrees")


def leaf_places(
    leaves: Leaves, template: Mesh, branching: Branching, rest: Pose, height_m: float, rng: np.random.Generator
) -> OrganPlacements:
    """Frames of all leaves on the branches that do not divide, in the plant at rest.

    Where a level of detail cut a branch of several strands short, its leaves are larger by the root of their number,
    so that the area stays.

    Raises
    ------
    RecipeError : more leaves than memory holds.
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
    upper = tangent if leaves.arrangement == "coniferous" else np.broadcast_to(_UP, tangent.shape)
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
