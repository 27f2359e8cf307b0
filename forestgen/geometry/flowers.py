"""Flower heads, and the closed bodies of buds, fruits and cut faces, in the frame of the stalk's foot; y is the axis.

A flower head is several patches, one a material.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from forestgen.geometry.leaves import Blade, Entire, blade
from forestgen.geometry.patches import (
    Patch,
    attitude,
    bend,
    bent,
    copies,
    join,
    on_axis,
    outwards,
    placed,
    revolve,
    strip,
    tube,
    whorl,
)  # fmt: skip

Floats = NDArray[np.float64]

_GOLDEN_RAD = np.pi * (3.0 - np.sqrt(5.0))


def lifted(patch: Patch, height_m: float) -> Patch:
    """The patch moved along y."""
    return placed(patch, np.eye(3), np.array([0.0, height_m, 0.0]))


def daisy(
    diameter_m: float, disc_m: float, petals: int, petal_width_m: float, opening_deg: float, detail: int
) -> tuple[Patch, Patch, Patch]:
    """Rays in two whorls, the domed disc, and the green involucre below; the flower's foot is in the origin."""
    reach = 0.5 * (diameter_m - 0.8 * disc_m)
    ray = blade(Blade(Entire(0.6, 0.8, 0.35), reach, petal_width_m, fold_deg=6.0, curl_deg=14.0, detail=min(detail, 1)))
    rays = []
    for k, count in enumerate((petals - petals // 2, petals // 2)):
        turn = k * np.pi / max(count, 1)
        opening = np.radians(opening_deg - 7.0 * k)
        rays.append(lifted(whorl(ray, count, opening, 0.4 * disc_m, turn), 0.02 * disc_m * k))
    sides, rows = ((6, 3), (10, 4), (20, 7))[detail]
    angle = np.linspace(0.0, 0.5 * np.pi, rows)
    dome = np.column_stack([0.5 * disc_m * np.cos(angle), 0.30 * disc_m * np.sin(angle)])
    dome[-1, 0] = 0.0
    disc = revolve(dome, sides)
    if detail == 2:  # florets
        bump = 1.0 + 0.05 * np.cos(np.arange(len(disc.points)) * 2.4)
        disc = disc._replace(points=disc.points * bump[:, None])
    cup = np.column_stack([[0.0, 0.22, 0.46, 0.52], [-0.30, -0.26, -0.12, 0.02]]) * disc_m
    return join(rays), disc, revolve(cup, sides)


def four_petals(length_m: float, width_m: float, opening_deg: float, detail: int) -> tuple[Patch, Patch, Patch]:
    """Petals, sepals between them, and stamens with the style: a fireweed's flower, foot in the origin."""
    form = Entire(0.66, 0.9, 0.45)
    wavy = Blade(form, length_m, width_m, fold_deg=5.0, curl_deg=20.0, waves=1.0, wave_height=0.12, detail=detail)
    petal = blade(wavy if detail else Blade(form, length_m, width_m, detail=0))
    opening = np.radians(opening_deg)
    petals = whorl(petal, 4, opening, 0.04 * length_m, np.pi / 4.0)
    sepal = strip(0.9 * length_m, 0.17 * width_m * np.array([0.8, 1.0, 0.0]), folded=False)
    sepals = whorl(sepal, 4, opening + 0.15, 0.03 * length_m)
    count = (0, 4, 8)[detail]
    parts = [tube(_line(0.85 * length_m, 0.5, 3), 0.022 * length_m * np.array([1.0, 0.8, 0.0]), 3)]
    if count:
        thread = strip(0.7 * length_m, 0.035 * length_m * np.array([1.0, 0.8]), folded=False)
        anther = lifted(revolve(np.array([[0.0, 0.0], [0.035, 0.05], [0.0, 0.12]]) * length_m, 3), 0.68 * length_m)
        parts.append(whorl(join([thread, anther]), count, 0.5 * opening, 0.02 * length_m, 0.2))
    return petals, sepals, join(parts)


def lily(
    length_m: float, tepal_width_m: float, opening_deg: float, recurve_deg: float, detail: int
) -> tuple[Patch, Patch, Patch]:
    """Six recurved tepals that form a trumpet; filaments and style; anthers."""
    form = Entire(0.55, 0.75, 0.9)
    tepals = []
    for k, share in enumerate((1.0, 0.78)):  # the outer three are narrower
        width_m, fine = tepal_width_m * share, max(detail, 1)
        flat = Blade(form, length_m, width_m, fold_deg=12.0, waves=1.5, wave_height=0.1, detail=fine)
        petal = bent(blade(flat), length_m, np.radians(recurve_deg), 2.5)
        tepals.append(whorl(petal, 3, np.radians(opening_deg), 0.05 * length_m, k * np.pi / 3.0))
    curve = 0.35
    thread = tube(_line(0.72 * length_m, curve, 4), 0.010 * length_m * np.ones(4), 3)
    threads = whorl(thread, 6, np.radians(0.55 * opening_deg), 0.02 * length_m, np.pi / 6.0)
    style = tube(_line(0.85 * length_m, 0.15, 4), length_m * np.array([0.014, 0.012, 0.012, 0.0]), 3)
    end = _line(0.72 * length_m, curve, 4)[-1]
    anther = revolve(np.array([[0.0, -0.06], [0.022, -0.03], [0.022, 0.03], [0.0, 0.06]]) * length_m, (3, 4, 6)[detail])
    across = placed(anther, np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), end)
    anthers = whorl(across, 6, np.radians(0.55 * opening_deg), 0.02 * length_m, np.pi / 6.0)
    return join(tepals), join([threads, style]), anthers


def _line(length_m: float, bend_rad: float, stops: int) -> Floats:
    return bend(on_axis(np.linspace(0.0, length_m, stops)), length_m, bend_rad, 1.5)


def catkin(length_m: float, diameter_m: float, scales: int, detail: int) -> Patch:
    """A hanging spike of scales about an axis."""
    if detail == 0:
        return _spindle(length_m, diameter_m, 4)
    core = _spindle(length_m, 0.75 * diameter_m, 6)
    size = 1.5 * np.sqrt(np.pi * diameter_m * length_m / scales)
    scale = blade(Blade(Entire(0.5, 0.6, 0.8), size, 0.9 * size, fold_deg=15.0, curl_deg=-20.0, detail=detail - 1))
    share = (np.arange(scales) + 0.5) / scales
    radius = 0.30 * diameter_m * np.sin(np.pi * (0.12 + 0.8 * share)) ** 0.5
    grow = np.clip(np.sin(np.pi * (0.15 + 0.75 * share)) ** 0.4, 0.4, 1.0)
    return _set_with(core, scale, np.radians(34.0), radius, share * length_m * 0.97, grow)


def _set_with(core: Patch, scale: Patch, angle_rad: Floats, radius_m: Floats, height_m: Floats, size: Floats) -> Patch:
    """The core and scales in a golden spiral about it, at (N, 1) angles, or one for all, from the axis.

    The other arrays are (N,): where the scales' feet are, and the scales' sizes.
    """
    outward = outwards(np.arange(len(size)) * _GOLDEN_RAD)
    along = np.sin(angle_rad) * outward + np.cos(angle_rad) * np.array([0.0, 1.0, 0.0])
    upper = np.sin(angle_rad) * np.array([0.0, 1.0, 0.0]) - np.cos(angle_rad) * outward
    feet = on_axis(height_m) + radius_m[:, None] * outward
    return join([core, copies(scale, attitude(along, upper) * size[:, None, None], feet)])


def _spindle(length_m: float, diameter_m: float, sides: int) -> Patch:
    profile = np.array([[0.0, 0.0], [0.42, 0.1], [0.5, 0.4], [0.4, 0.8], [0.0, 1.0]]) * [diameter_m, length_m]
    return revolve(profile, sides)


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
    share = (np.arange(scales) + 0.5) / scales
    angle = np.radians(opening_deg) * (1.1 - 0.6 * share)
    radius = np.interp(share, profile[:, 1], profile[:, 0]) * 0.62 * diameter_m
    size = 1.6 * np.sqrt(np.pi * diameter_m * length_m / scales)
    scale = blade(Blade(Entire(0.62, 0.6, 0.5), size, 0.85 * size, fold_deg=10.0, curl_deg=-18.0, detail=detail - 1))
    grow = np.clip(radius / (0.31 * diameter_m), 0.45, 1.0)
    return _set_with(core, scale, angle[:, None], radius, 0.92 * share * length_m, grow)


def disc(diameter_m: float, sides: int) -> Patch:
    """A flat regular polygon in the plane z = 0 about the origin; texture coordinates are its square's."""
    turn = np.arange(sides) * (2.0 * np.pi / sides)
    rim = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(sides)])
    points = 0.5 * diameter_m * np.concatenate([np.zeros((1, 3)), rim])
    k = np.arange(sides)
    faces = np.column_stack([np.zeros(sides, np.int64), 1 + k, 1 + (k + 1) % sides])
    return Patch(points, faces, 0.5 + points[:, :2] / diameter_m)
