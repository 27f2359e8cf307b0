"""Where the cameras of a rig stand and what they look at; recipe/rigs.py says what the rigs are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.core.errors import RecipeError
from forestgen.recipe.camera_keys import DIRECTIONS
from forestgen.recipe.cameras import Camera
from forestgen.recipe.rigs import DroneGrid, Orbit, Walk
from forestgen.scene.terrain import HeightField
from forestgen.scene.trunks import Trunks
from forestgen.scene.walking import BlockedError, at_lengths, length_m, way_around

Floats = NDArray[np.float64]

_AHEAD_M = 4.0  # a walker looks at a point of the way so far ahead
_HEADROOM_M = 0.3  # trunks count up to so far above the eye


@dataclass(frozen=True)
class Poses:
    """Cameras of one entry, world."""

    position_m: Floats  # (F, 3)
    target_m: Floats  # (F, 3) in each image's middle
    time_s: Floats  # (F,)


def poses_of(section: Camera, height: HeightField, trunks: Trunks | None) -> Poses:
    """Of all frames; of a stereo rig the middle between its cameras."""
    lifted = section.height_above_ground
    rig = section.rig
    if isinstance(rig, Orbit):
        return _orbit(section, rig, height)
    if isinstance(rig, Walk):
        return _walk(section, rig, height, trunks)
    if isinstance(rig, DroneGrid):
        there = np.array(section.rig_middles_m)
        position = np.column_stack([there, np.full(len(there), rig.altitude_m)])
        position = _lifted(position, height) if lifted else position
        return Poses(position, position + DIRECTIONS["down"], np.zeros(len(there)))
    position = np.array(section.positions_m, dtype=np.float64)
    position = _lifted(position, height) if lifted else position
    pace = 0.0 if section.path is None else 1.0 / section.path.frames_per_s
    if section.look is not None:
        target = position + DIRECTIONS[section.look]
    else:
        target = np.array(section.looks_at_m, dtype=np.float64)
        target = _lifted(target, height) if lifted else target
    return Poses(position, target, np.arange(len(position), dtype=np.float64) * pace)


def _lifted(points_m: Floats, height: HeightField) -> Floats:
    return np.column_stack([points_m[:, :2], points_m[:, 2] + height(points_m[:, 0], points_m[:, 1])])


def _looked_at(section: Camera, height: HeightField) -> Floats:
    """(1, 3) the entry's look_at_m."""
    target = np.array([section.look_at_m], dtype=np.float64)
    return _lifted(target, height) if section.height_above_ground else target


def _orbit(section: Camera, rig: Orbit, height: HeightField) -> Poses:
    angle = np.radians(rig.first_deg) + np.arange(rig.count) / rig.count * 2 * np.pi  # clockwise from north
    target = np.repeat(_looked_at(section, height), rig.count, axis=0)
    position = target + rig.radius_m * np.column_stack([np.sin(angle), np.cos(angle), np.zeros(rig.count)])
    position[:, 2] = rig.height_m
    position = _lifted(position, height) if section.height_above_ground else position
    pace = 0.0 if rig.frames_per_s is None else 1.0 / rig.frames_per_s
    return Poses(position, target, np.arange(rig.count, dtype=np.float64) * pace)


def _walk(section: Camera, rig: Walk, height: HeightField, trunks: Trunks | None) -> Poses:
    """At an even pace, looking ahead along the way unless the recipe says where to."""
    way = np.array(rig.waypoints_m, dtype=np.float64)
    if trunks is not None:
        middles, radii = trunks.circles_m(rig.eye_height_m + _HEADROOM_M)
        try:
            way = way_around(way, middles, radii, rig.clearance_m)
        except BlockedError as cause:
            first, second = rig.waypoints_m[cause.piece], rig.waypoints_m[cause.piece + 1]
            raise RecipeError(
                f"trunks block the walk of camera {section.name}",
                where=f"rig.waypoints_m.{cause.piece}",
                expected="a way between two waypoints, 10 cm from all trunks",
                got=f"none from {list(first)} to {list(second)}",
                hint="move these waypoints, or add one in between",
            ) from cause
    walked = np.linspace(0.0, length_m(way), rig.frames)
    eye = np.full((rig.frames, 1), rig.eye_height_m)
    position = _lifted(np.hstack([at_lengths(way, walked), eye]), height)
    if section.look is not None:
        target = position + DIRECTIONS[section.look]
    elif section.look_at_m is not None:
        target = np.repeat(_looked_at(section, height), rig.frames, axis=0)
    else:
        target = _lifted(np.hstack([at_lengths(way, walked + _AHEAD_M), eye]), height)
    return Poses(position, target, np.arange(rig.frames) / rig.frames_per_s)
