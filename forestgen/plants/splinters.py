"""Spikes on the rim of a broken stem, longest on one side, as wood tears."""

from __future__ import annotations

import numpy as np

from forestgen.geometry.mesh import Floats, any_perpendicular

_THICK = 0.16 * 1.4  # of the break's radius


def splinters(
    place_m: Floats, along: Floats, radius_m: float, tip_m: float, most: int, rng: np.random.Generator
) -> list[tuple[Floats, Floats]]:
    """(3, 3) points and (3,) radii of each spike of a break.

    `place_m`: (3,) its middle. `along`: (3,) unit, out of the wood. `tip_m`: length of the longest. `most`: number.
    """
    side = any_perpendicular(along[None])[0]
    other = np.cross(along, side)
    count = int(np.clip(round(radius_m / 0.012), 7, most))
    worst = rng.uniform(0.0, 2.0 * np.pi)
    longest, spikes, made = 0.0, [], []
    for k in range(count):
        turn = 2.0 * np.pi * (k + 0.4 * rng.normal()) / count
        share = (0.25 + 0.75 * np.cos(0.5 * (turn - worst)) ** 2) * rng.uniform(0.35, 1.0)
        longest = max(longest, share)
        spikes.append((turn, share, rng.uniform(0.55, 0.9)))
    thick = _THICK * radius_m
    for turn, share, reach in spikes:
        outward = np.cos(turn) * side + np.sin(turn) * other
        foot = place_m + reach * (radius_m - thick) * outward - 0.5 * thick * along
        tip = foot + along * (tip_m * share / longest + 0.5 * thick)
        middle = 0.5 * (foot + tip) + 0.03 * tip_m * outward
        made.append((np.stack([foot, middle, tip]), thick * np.array([1.0, 0.7, 0.05])))
    return made
