"""Bands in figures, and which of them make a picture for people."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.core.spectrum import Band

# nm: where a band is best, and where it must lie. Satellites have two blues, of which the shorter is for haze.
_RED, _GREEN, _BLUE = (610.0, 580.0, 700.0), (550.0, 500.0, 580.0), (475.0, 400.0, 500.0)
_INFRARED = (840.0, 750.0, 1000.0)  # leaves are brightest here
_CHLOROPHYLL = (660.0, 600.0, 700.0)  # and darkest here


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
