"""Ghosts of the sun in a raw image: its light, thrown back by one surface of the lens and forth by another.

Paraxial rays (Lee and Eisemann 2013, section 4): a ray that enters at the height y with the slope s passes the stop at
A_a y + B_a s and meets the sensor at A_s y + B_s s; the sun's own image is at f s. So a ghost is an image of the stop:

    middle     (B_s - A_s B_a / A_a) / f     of the way from the image's middle to the sun
    radius     r_a |A_s / A_a|               r_a = A_a0 f / (2 N), A_a0 of light that is not thrown back
    light      E = E_sun R_i R_j / A_s²      on the sensor; as luminance 4 N² E / pi, as dataset/raw.py has it

cut by the front lens, whose rim maps to a disc about B_s s / f of radius |A_s| r_front, and blurred by the sun's width.
Both surfaces lie on one side of the stop: other ghosts pass it three times and are mostly cut off.

R is that of a quarter wave of magnesium fluoride (n = 1.38) at 550 nm between air and glass, by wavelength (Born and
Wolf 1999, section 1.6.4), and Fresnel's between cemented glasses. Losses at other surfaces are left out.

The lens is a double Gauss of f/2 (Tronnier, US patent 2,673,491, in Smith, Modern lens design, 1992, p. 312), scaled to
the camera's focal length: `exposure: {ghosts: coated}`, or `uncoated`, where R is Fresnel's at all surfaces.

References
----------
Lee, S., Eisemann, E. (2013). Practical real-time lens-flare rendering. Computer Graphics Forum 32(4), 1-6.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
# Radius, mm (0: the stop), distance to the next surface, mm, and refractive index up to there.
_DOUBLE_GAUSS = (
    (29.475, 3.76, 1.67), (84.83, 0.12, 1.0), (19.275, 4.025, 1.67), (40.77, 3.275, 1.699), (12.75, 5.705, 1.0),
    (0.0, 4.5, 1.0),
    (-14.495, 1.18, 1.603), (40.77, 6.065, 1.658), (-20.385, 0.19, 1.0), (437.065, 3.22, 1.717), (-39.73, 0.0, 1.0),
)  # fmt: skip
_FRONT_MM = 12.6  # half of the front lens' diameter
_COATING_INDEX, _COATED_FOR_NM = 1.38, 550.0
COLOURS_NM = {"R": 610.0, "G": 550.0, "B": 465.0}  # of channels without bands
_SUN_RADIUS = 0.00465  # radians


@dataclass(frozen=True)
class Ghost:
    """Lengths in focal lengths."""

    surfaces: tuple[int, int]
    middle: float  # by the sun's image
    radius: float  # times the f-number's inverse
    rim_middle: float  # of the front lens' rim, by the sun's image
    rim_radius: float
    spread: float  # A_s: the inverse root of the light's concentration


def _trace(y: float, slope: float, back: tuple[int, int] | None) -> tuple[float, float, float]:
    """Heights at the stop, where it is met last, and at the last surface, and the slope behind it.

    `back`: the surfaces that throw light forth again and back, the earlier one first; None: none do.
    """
    order, turns = list(range(len(_DOUBLE_GAUSS))), set()
    if back is not None:
        first, last = back
        order = [*range(last + 1), *range(last - 1, first, -1), *range(first, len(_DOUBLE_GAUSS))]
        turns = {last, 2 * last - first}  # steps
    index, way, at_stop = 1.0, 1, 0.0
    for step, surface in enumerate(order):
        curve = 0.0 if _DOUBLE_GAUSS[surface][0] == 0 else way / _DOUBLE_GAUSS[surface][0]
        at_stop = y if _DOUBLE_GAUSS[surface][0] == 0 else at_stop
        if step in turns:
            slope, way = slope + 2.0 * y * curve, -way
        else:
            other = _index_behind(surface if way > 0 else surface - 1)
            slope, index = (index * slope - y * (other - index) * curve) / other, other
        if step + 1 < len(order):
            y += slope * _DOUBLE_GAUSS[surface if way > 0 else surface - 1][1]
    return at_stop, y, slope


def _index_behind(surface: int) -> float:
    return _DOUBLE_GAUSS[surface][2] if surface >= 0 else 1.0


@cache
def ghosts() -> tuple[Ghost, ...]:
    """All of the lens."""
    free_stop, y, slope = _trace(1.0, 0.0, None)
    focal, to_sensor = -1.0 / slope, -y / slope
    stop = next(k for k, (radius, _, _) in enumerate(_DOUBLE_GAUSS) if radius == 0)
    found = []
    for side in (range(stop), range(stop + 1, len(_DOUBLE_GAUSS))):
        for back in combinations(side, 2):
            of_height, of_slope = (_trace(*ray, back) for ray in ((1.0, 0.0), (0.0, 1.0)))
            (a_stop, a), (b_stop, b) = ((one[0], one[1] + one[2] * to_sensor) for one in (of_height, of_slope))
            middle, radius = (b - a * b_stop / a_stop) / focal, abs(a / a_stop * free_stop) / 2.0
            found.append(Ghost(back, middle, radius, b / focal, abs(a) * _FRONT_MM / focal, abs(a)))
    return tuple(found)


def reflectance(surface: int, wavelength_nm: float, *, coated: bool = True) -> float:
    """Of light that falls straight on a surface of the lens."""
    before, behind = _index_behind(surface - 1), _index_behind(surface)
    if not coated or min(before, behind) > 1.0:
        return float(((before - behind) / (before + behind)) ** 2)
    glass, phase = max(before, behind), np.cos(np.pi * _COATED_FOR_NM / wavelength_nm)
    outer, inner = (1.0 - _COATING_INDEX) / (1.0 + _COATING_INDEX), (_COATING_INDEX - glass) / (_COATING_INDEX + glass)
    both = 2.0 * outer * inner * phase
    return float((outer**2 + inner**2 + both) / (1.0 + (outer * inner) ** 2 + both))


def ghosts_of(about: Mapping[str, Any], size_px: tuple[int, int]) -> Floats:
    """(H, W, C) radiance that the ghosts look like, by channel.

    Parameters
    ----------
    about : of raw.json: `sun_px`, the sun's image from the image's middle, right and down, which may lie beyond the
        image; `focal_px`; `f_number`; and by channel `irradiance` of the sun on a surface that faces it, as much as
        reaches the lens, and `wavelength_nm`; `surfaces`: coated or uncoated.
    """
    width, height = size_px
    irradiance, nm = np.array(about["irradiance"], dtype=np.float64), about["wavelength_nm"]
    coated = about["surfaces"] == "coated"
    image = np.zeros((height, width, len(nm)))
    sun, focal_px, f_number = np.array(about["sun_px"], dtype=np.float64), about["focal_px"], about["f_number"]
    light = irradiance * focal_px / np.hypot(focal_px, np.hypot(*sun)) * (4.0 * f_number**2 / np.pi)
    for ghost in ghosts():
        found = _disc(ghost, size_px, focal_px, f_number, sun)
        if found is not None:
            rows, columns, share = found
            back = np.prod(
                [[reflectance(one, length, coated=coated) for length in nm] for one in ghost.surfaces], axis=0
            )
            image[rows, columns] += share[..., None] * (light * back)
    return image


def _disc(
    ghost: Ghost, size_px: tuple[int, int], focal_px: float, f_number: float, sun: Floats
) -> tuple[slice, slice, Floats] | None:
    """Where in the image a ghost lies, and its light there by that of the sun; None: beyond it."""
    size, middle = np.array(size_px), ghost.middle * sun + np.array(size_px) / 2.0
    radius = ghost.radius / f_number * focal_px
    soft = max(0.5, abs(ghost.middle) * _SUN_RADIUS * focal_px)
    reach = max(radius, soft)
    low = np.clip(np.floor(middle - reach - soft), 0, size).astype(int)
    high = np.clip(np.ceil(middle + reach + soft) + 1, 0, size).astype(int)
    if (high <= low).any():
        return None
    x, y = np.arange(low[0], high[0]) + 0.5, (np.arange(low[1], high[1]) + 0.5)[:, None]
    share = np.clip((reach - np.hypot(x - middle[0], y - middle[1])) / (2.0 * soft) + 0.5, 0.0, 1.0)
    # All of the stop's light, over the area that the soft disc has.
    share *= (radius / ghost.spread) ** 2 / (reach**2 + soft**2 / 3.0)
    rim = ghost.rim_middle * sun + size / 2.0
    share *= np.clip((ghost.rim_radius * focal_px - np.hypot(x - rim[0], y - rim[1])) / (2.0 * soft) + 0.5, 0.0, 1.0)
    return slice(low[1], high[1]), slice(low[0], high[0]), share
