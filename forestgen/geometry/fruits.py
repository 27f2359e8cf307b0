"""Buds, fruits and cut faces: closed bodies, foot of the stalk in the origin, y along them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from forestgen.geometry.leaves import Blade, blade
from forestgen.geometry.outlines import Entire
from forestgen.geometry.patches import Patch, attitude, copies, join, revolve

Floats = NDArray[np.float64]

_GOLDEN_RAD = np.pi * (3.0 - np.sqrt(5.0))


def bud(length_m: float, width_m: float, detail: int) -> Patch:
    """A closed bud or a pod: a spindle of 6 triangles at detail 0, thickest at 45% of its length."""
    if detail == 0:
        profile = np.array([[0.0, 0.0], [0.5, 0.45], [0.0, 1.0]])
    elif detail == 1:
        profile = np.array([[0.0, 0.0], [0.36, 0.15], [0.5, 0.45], [0.3, 0.78], [0.0, 1.0]])
    else:
        profile = np.array(
            [[0.0, 0.0], [0.24, 0.05], [0.42, 0.2], [0.5, 0.42], [0.43, 0.62], [0.25, 0.83], [0.1, 0.95], [0.0, 1.0]]
        )
    return revolve(profile * [width_m, length_m], (3, 5, 9)[detail])


def berry(diameter_m: float, length_m: float, drupelets: int, detail: int) -> Patch:
    """A cluster of round drupelets on an egg, as a bramble's; one drupelet is a plain berry."""
    if drupelets == 1 or detail == 0:
        sides, rows = ((5, 4), (8, 6), (14, 9))[detail]
        angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, rows)
        profile = np.column_stack([0.5 * diameter_m * np.cos(angle), 0.5 * length_m * (1.0 + np.sin(angle))])
        profile[[0, -1], 0] = 0.0
        return revolve(profile, sides)
    k = np.arange(drupelets)
    z = 1.0 - 2.0 * (k + 0.5) / drupelets
    turn = k * _GOLDEN_RAD
    ring = np.sqrt(1.0 - z * z)
    outward = np.column_stack([ring * np.cos(turn), z, ring * np.sin(turn)])
    size = 0.5 * min(diameter_m, length_m)
    grain = size * 2.0 / np.sqrt(drupelets) * 0.95
    reach = np.array([0.5 * diameter_m - grain, 0.5 * length_m - grain, 0.5 * diameter_m - grain])
    sides, rows = ((4, 3), (5, 4), (7, 6))[detail]
    angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, rows)
    profile = grain * np.column_stack([np.cos(angle), np.sin(angle)])
    profile[[0, -1], 0] = 0.0
    helper = np.tile([0.31, 0.27, 0.91], (drupelets, 1))
    feet = outward * reach + [0.0, 0.5 * length_m, 0.0]
    return copies(revolve(profile, sides), attitude(outward, helper), feet)


def acorn(length_m: float, diameter_m: float, detail: int) -> tuple[Patch, Patch]:
    """The nut and its cup."""
    sides = (5, 8, 14)[detail]
    y = np.linspace(0.0, 1.0, (4, 6, 10)[detail])
    nut = np.column_stack([0.5 * (1.0 - np.abs(2.0 * y - 1.0) ** 2.6) ** 0.5, 0.12 + 0.82 * y])
    nut = np.concatenate([nut[:-1], [[0.07, 0.945], [0.0, 1.0]]]) * [diameter_m, length_m]
    cup = np.array([[0.0, 0.0], [0.30, 0.03], [0.52, 0.14], [0.60, 0.28], [0.57, 0.37], [0.48, 0.38]])
    cup *= [diameter_m, length_m]
    return revolve(nut, sides), revolve(cup, sides)


def cone(length_m: float, diameter_m: float, scales: int, opening_deg: float, detail: int) -> Patch:
    """A conifer's cone: scales in spirals about a spindle; a plain spindle at detail 0."""
    profile = np.array([[0.0, 0.0], [0.36, 0.08], [0.5, 0.35], [0.42, 0.7], [0.2, 0.94], [0.0, 1.0]])
    if detail == 0:
        return revolve(profile * [diameter_m, length_m], 5)
    core = revolve(profile * [0.72 * diameter_m, length_m], 6)
    k = np.arange(scales)
    share = (k + 0.5) / scales
    turn = k * _GOLDEN_RAD
    outward = np.column_stack([np.cos(turn), np.zeros(scales), np.sin(turn)])
    angle = np.radians(opening_deg) * (1.1 - 0.6 * share)
    along = np.sin(angle)[:, None] * outward + np.cos(angle)[:, None] * [0.0, 1.0, 0.0]
    upper = np.sin(angle)[:, None] * [0.0, 1.0, 0.0] - np.cos(angle)[:, None] * outward
    radius = np.interp(share, profile[:, 1], profile[:, 0]) * 0.62 * diameter_m
    size = 1.6 * np.sqrt(np.pi * diameter_m * length_m / scales)
    scale = blade(Blade(Entire(0.62, 0.6, 0.5), size, 0.85 * size, fold_deg=10.0, curl_deg=-18.0, detail=detail - 1))
    grow = np.clip(radius / (0.31 * diameter_m), 0.45, 1.0)
    feet = np.column_stack([np.zeros(scales), 0.92 * share * length_m, np.zeros(scales)]) + radius[:, None] * outward
    return join([core, copies(scale, attitude(along, upper) * grow[:, None, None], feet)])


def disc(diameter_m: float, sides: int) -> Patch:
    """A flat regular polygon in the plane z = 0 about the origin; texture coordinates are its square's."""
    turn = np.arange(sides) * (2.0 * np.pi / sides)
    rim = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(sides)])
    points = 0.5 * diameter_m * np.concatenate([np.zeros((1, 3)), rim])
    k = np.arange(sides)
    faces = np.column_stack([np.zeros(sides, np.int64), 1 + k, 1 + (k + 1) % sides])
    return Patch(points, faces, 0.5 + points[:, :2] / diameter_m)
