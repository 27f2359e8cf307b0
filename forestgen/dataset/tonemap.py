"""From linear radiance to a picture for people: exposure, then a named view transform.

One machine always makes the same picture; on another machine a few values may differ by 1.

Exposure brings the picture's key to middle grey (0.18). The key is the geometric mean of luminance clipped at
its 5th and 95th percentile: black gaps and the sun's disc hardly count. Exposure is up to a stop less where the 95th
percentile would be brighter than a camera's saturation, 1.42, where middle grey is 0.18 (ISO 12232: a metered mean is
12.7% of saturation): cameras hold highlights so; the stop is ours. Pictures of the eye's channels whose key is
below 10 cd/m², as at dusk and by night, are darker, as people see them: by the key a(Y) = 1.03 - 2 / (2 + log10(Y + 1))
of Krawczyk et al. (2005, Perceptual effects in real-time tone mapping, eq. 11; from memory) over that of 10 cd/m², but
not below 0.3, as photographs of moonlight are readable (the number is ours). Then follows one of the views:

- ``filmic``: first, at a key of Y cd/m², by the share 0.04 / (0.04 + Y) that rods see (Krawczyk et al.), light is that
  of a picture of the night: white is that of 3200 K, to which film of type B and cameras' setting for lamps are
  balanced, so that moonlight of 4100 K is blue, and colours are less by two fifths (ours). The largest and the smallest
  channel follow

      y = x^n (1 + (c/w)^n) / (x^n + c^n),        n = 1.5

  which is steep around middle grey, bends highlights over as film does and reaches 1 at w, the exposed luminance of
  the 99.7th percentile (at least 4: a dull picture is not stretched). c is such that middle grey maps to itself. The
  middle channel keeps its place between the two, so that the hue stays; the channels are those of linear ProPhoto RGB
  (ISO 22028-2), so that bright colours become pale. Raw converters do so (DNG SDK 1.7.1, RefBaselineRGBTone): curves
  of each channel of Rec. 709 turn sunlit leaves yellow. One rule is ours and no converter's: where r >= g >= b, from
  red to yellow, the middle channel goes half of the way, `_OWN_CURVE`, to the curve's own value, else bright browns
  turn pink; so the hue of dry beech leaves up to three stops above grey, as of OKLab (Ottosson 2020), stays within 3
  degrees. Then the sRGB encoding. n is that of photographs: with
  w = 1.91 the curve is within 5% of the default one of Adobe's raw converters (the SDK's dng_tone_curve_acr3_default)
  from a seventh of middle grey to saturation, 2.5% on average.
- ``srgb``: the sRGB encoding alone (IEC 61966-2-1); what is brighter than 1 is white. Values below white can be undone
  to radiance.
- ``acescct``: the logarithmic encoding of Academy S-2016-001, on AP1's primaries: flat to look at, made to be graded.
  Its 8 bits hold 16 stops.

ACEScct and its primaries are colour-science's own; the sRGB table is equal to colour-science's.

Bands: three that lie in red, green and blue make a picture in true colour; else near infrared, red and green one in
false colour, as infrared film did; else the longest, middle and shortest; a sensor of one or two bands a grey one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from forestgen.core.spectrum import LUMINANCE, Band
from forestgen.recipe.dataset import View
from forestgen.render.frame import Radiance
from forestgen.scene.colour import colour_science

MIDDLE_GREY = 0.18
KEY_PERCENTILES = (5.0, 95.0)
WHITE_PERCENTILE = 99.7
_BRIGHT_CD_PER_M2 = 10.0  # of a key: pictures of brighter scenes are equally bright
_DIMMEST = 0.3
_SATURATION, _LEAST_HELD = MIDDLE_GREY / 0.127, 0.5
LEAST_WHITE = 4.0
# From linear Rec. 709, adapted from D65 to D50 by Bradford's matrix: colour-science's, with rows that sum to 1.
_PROPHOTO = np.array(
    [[0.529269, 0.330158, 0.140573], [0.098372, 0.873481, 0.028146], [0.016875, 0.117659, 0.865465]],
    dtype=np.float32,
)
_REC709 = np.linalg.inv(_PROPHOTO)
_RODS_CD_PER_M2, _NIGHT_COLOURS = 0.04, np.float32(0.6)
_NIGHT_GAINS = np.array([0.517, 1.0, 2.66], dtype=np.float32)  # on Rec. 709: Planck's radiator of 3200 K is neutral
CONTRAST = 1.5
_OWN_CURVE = np.float32(0.5)  # share of the way of colours from red to yellow
_STEPS = 1 << 12
_RED_WEIGHT, _GREEN_WEIGHT, _BLUE_WEIGHT = (np.float32(weight) for weight in LUMINANCE)
_DARKEST, _INFINITE = 1e-20, 1e30
# nm: where a band is best, and where it must lie. Satellites have two blues, of which the shorter is for haze.
_RED, _GREEN, _BLUE = (610.0, 580.0, 700.0), (550.0, 500.0, 580.0), (475.0, 400.0, 500.0)
_INFRARED = (840.0, 750.0, 1000.0)  # leaves are brightest here
_CHLOROPHYLL = (660.0, 600.0, 700.0)  # and darkest here


@dataclass(frozen=True)
class Preview:
    """A picture and how it was made."""

    picture: NDArray[np.uint8]  # (H, W, 3)
    texts: Mapping[str, str]  # for the PNG's text chunks: view, colours, exposure


def preview_of(radiance: Radiance, view: View = "filmic") -> Preview:
    """A frame's picture, of the denoised radiance where there is one."""
    light, colours = picture_light(radiance)
    light = _cleaned(light)
    exposure, white, key = _metered(light)
    if not radiance.bands and key < _BRIGHT_CD_PER_M2:
        exposure = np.float32(exposure * _dim(key))
        light = _at_night(light, key) if view == "filmic" else light
    texts = {"view": view, "colours": colours, "exposure": f"{exposure:.6g}"}
    return Preview(_developed(light * exposure, white, view), texts)


def _dim(key_cd_per_m2: float) -> float:
    """How much darker than middle grey the key of a dim picture is: 0.43 at 1 cd/m², 0.3 below 0.5."""
    key, bright = (1.03 - 2.0 / (2.0 + np.log10(one + 1.0)) for one in (key_cd_per_m2, _BRIGHT_CD_PER_M2))
    return float(max(key / bright, _DIMMEST))


def _at_night(light: NDArray[np.float32], key_cd_per_m2: float) -> NDArray[np.float32]:
    """(H, W, 3) light, of linear Rec. 709 in cd/m², as a picture of the night has it at this key; in the same unit."""
    share = np.float32(_RODS_CD_PER_M2 / (_RODS_CD_PER_M2 + key_cd_per_m2))
    night = light * _NIGHT_GAINS
    grey = _luminance(night)[..., None]
    return np.asarray((1 - share) * light + share * (grey + _NIGHT_COLOURS * (night - grey)))


def picture_light(radiance: Radiance) -> tuple[NDArray[np.float32], str]:
    """(H, W, 3) light to show as red, green and blue, and which it is, for people."""
    light = radiance.mean if radiance.denoised is None else radiance.denoised
    if not radiance.bands:
        return light, "linear Rec. 709"
    chosen = picture_bands(radiance.bands)
    names = ", ".join(radiance.channels[channel] for channel in chosen.channels)
    shown = light[..., list(chosen.channels)]
    if radiance.open_irradiance:  # a white surface in the open is white
        white = np.array([radiance.open_irradiance[channel] for channel in chosen.channels], dtype=np.float32)
        shown = np.asarray(shown / white, dtype=np.float32)
    return shown, f"{chosen.kind}: {names} as red, green, blue"


def tone_map(radiance: NDArray[np.float32], exposure: float | None = None, view: View = "filmic") -> NDArray[np.uint8]:
    """(H, W, 3) picture, in the view's encoding, of linear Rec. 709 radiance (H, W, 3) in any unit.

    NaN and negative values count as 0, infinite ones as white. `exposure` is a factor on radiance, for pictures that
    are compared; by default the one that the picture's key asks for.
    """
    light = _cleaned(radiance)
    factor, white = _metered(light)[:2] if exposure is None else (np.float32(exposure), LEAST_WHITE)
    return _developed(light * factor, white, view)


def filmic(exposed: NDArray[np.float32], white: float, contrast: float = CONTRAST) -> NDArray[np.uint8]:
    """(H, W, 3) picture of light whose middle grey is 0.18; `white` and what is brighter becomes white."""
    red, green, blue = np.moveaxis(np.clip(exposed @ _PROPHOTO.T, 0.0, np.float32(white)), -1, 0)
    low, high = np.minimum(np.minimum(red, green), blue), np.maximum(np.maximum(red, green), blue)
    lowest, highest = _curve(low, white, contrast), _curve(high, white, contrast)
    slope = (highest - lowest) / np.maximum(high - low, np.float32(_DARKEST))
    shown = np.stack([lowest + (one - low) * slope for one in (red, green, blue)], axis=-1)
    warm = (red >= green) & (green >= blue)
    shown[warm, 1] += _OWN_CURVE * (_curve(green[warm], white, contrast) - shown[warm, 1])
    return _encode(shown @ _REC709.T)


def _developed(exposed: NDArray[np.float32], white: float, view: View) -> NDArray[np.uint8]:
    if view == "acescct":
        return _acescct(exposed)
    return filmic(exposed, white) if view == "filmic" else _encode(exposed)


def _metered(light: NDArray[np.float32]) -> tuple[np.float32, float, float]:
    """Factor on (H, W, 3) light, the exposed luminance that becomes white, and the key, of the light."""
    luminance = _luminance(light)
    lit = luminance[luminance > _DARKEST]
    if lit.size == 0:
        return np.float32(1.0), LEAST_WHITE, _BRIGHT_CD_PER_M2
    low, high, top = np.percentile(lit, [*KEY_PERCENTILES, WHITE_PERCENTILE])
    key = float(np.exp(np.mean(np.log(lit.clip(low, high)), dtype=np.float64)))
    exposure = MIDDLE_GREY / key
    exposure *= float(np.clip(_SATURATION / (exposure * high), _LEAST_HELD, 1.0))
    return np.float32(exposure), max(LEAST_WHITE, float(top) * exposure), key


def _luminance(light: NDArray[np.float32]) -> NDArray[np.float32]:
    """(H, W) luminance of (H, W, 3) linear Rec. 709, in the light's unit."""
    red, green, blue = np.moveaxis(light, -1, 0)
    return np.asarray(_RED_WEIGHT * red + _GREEN_WEIGHT * green + _BLUE_WEIGHT * blue)


def _cleaned(radiance: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.asarray(np.nan_to_num(radiance, nan=0.0, posinf=_INFINITE, neginf=0.0).clip(0.0), dtype=np.float32)


def _curve(x: NDArray[np.float32], white: float, n: float) -> NDArray[np.float32]:
    # Middle grey g maps to itself: g (g^n + c^n) = g^n (1 + c^n / w^n), solved for c^n.
    grey = MIDDLE_GREY**n
    c_n = grey * (1.0 - MIDDLE_GREY) / (MIDDLE_GREY - grey / white**n)
    power = np.minimum(x, np.float32(white)) ** np.float32(n)
    scale = np.float32(1.0 + c_n / white**n)
    return np.asarray(power * scale / (power + np.float32(c_n)), dtype=np.float32)


def _encode(linear: NDArray[np.float32]) -> NDArray[np.uint8]:
    """The sRGB encoding through a table of 4096 steps of the square root: exact to under one step of 255."""
    step = np.sqrt(linear.clip(0.0, 1.0)) * np.float32(_STEPS - 1) + np.float32(0.5)
    return np.asarray(_srgb_table()[step.astype(np.uint16)], dtype=np.uint8)


@cache
def _srgb_table() -> NDArray[np.uint8]:
    """In code, since importing colour-science takes longer than all pictures of a run; tests compare the two."""
    linear = (np.arange(_STEPS) / (_STEPS - 1)) ** 2
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.floor(encoded * 255.0 + 0.5).astype(np.uint8)


def _acescct(linear: NDArray[np.float32]) -> NDArray[np.uint8]:
    """In bands of rows: the encoding is computed in float64."""
    colour = colour_science()

    matrix = colour.matrix_RGB_to_RGB("ITU-R BT.709", "ACEScct", "Bradford").T
    picture = np.empty(linear.shape, dtype=np.uint8)
    for first in range(0, len(linear), 64):
        rows = slice(first, first + 64)
        lit = (linear[rows].astype(np.float64) @ matrix).clip(_DARKEST)  # both pieces of the encoding are computed
        encoded = colour.cctf_encoding(lit, function="ACEScct")
        picture[rows] = np.floor(np.clip(encoded, 0.0, 1.0) * 255.0 + 0.5)
    return picture


@dataclass(frozen=True)
class PictureBands:
    """Channels that stand for red, green and blue in a preview."""

    channels: tuple[int, int, int]
    kind: str  # "true colour", "false colour infrared", "false colour", "grey"


def centre_nm(band: Band) -> float:
    """Mean wavelength, weighted by the response."""
    wavelength_nm, response = band.response.wavelength_nm, band.response.value
    if len(wavelength_nm) == 1:
        return float(wavelength_nm[0])
    return float(np.trapezoid(wavelength_nm * response, wavelength_nm) / np.trapezoid(response, wavelength_nm))


def width_nm(band: Band) -> float:
    """Of a rectangle as high as the response's peak and of its area."""
    response = band.response
    return float(np.trapezoid(response.value, response.wavelength_nm) / response.value.max())


def band_figures(channels: Sequence[str], bands: Sequence[Band]) -> list[dict[str, str | float]]:
    """A row a channel, for JSON."""
    return [
        {
            "channel": channel,
            "response": band.name,
            "centre_nm": round(centre_nm(band), 3),
            "width_nm": round(width_nm(band), 3),
            "from_nm": float(band.response.wavelength_nm[0]),
            "to_nm": float(band.response.wavelength_nm[-1]),
        }
        for channel, band in zip(channels, bands, strict=True)
    ]


def picture_bands(bands: Sequence[Band]) -> PictureBands:
    """Three bands in red, green and blue; else near infrared, red and green; else the longest, middle, shortest.

    One or two bands make a grey picture of the one nearest to green.
    """
    centres = np.array([centre_nm(band) for band in bands])
    for kind, wanted in (
        ("true colour", (_RED, _GREEN, _BLUE)),
        ("false colour infrared", (_INFRARED, _CHLOROPHYLL, _GREEN)),
    ):
        red, green, blue = (_nearest(centres, *one) for one in wanted)
        if red is not None and green is not None and blue is not None:
            return PictureBands((red, green, blue), kind)
    order = np.argsort(-centres, kind="stable")
    if len(order) >= 3:
        return PictureBands((int(order[0]), int(order[len(order) // 2]), int(order[-1])), "false colour")
    one = int(np.argmin(np.abs(centres - _GREEN[0])))
    return PictureBands((one, one, one), "grey")


def _nearest(centres: NDArray[np.float64], best_nm: float, low_nm: float, high_nm: float) -> int | None:
    """The channel nearest to a wavelength among those that lie in its range; None if none does."""
    away = np.where((centres >= low_nm) & (centres <= high_nm), np.abs(centres - best_nm), np.inf)
    return int(np.argmin(away)) if np.isfinite(away).any() else None
