"""Numbers that tell the patterns of a field apart: cover, waves, skewness, islands and lakes.

Spots are a few high values on low ground, so the field is skewed upwards and has islands; gaps are the reverse, with
lakes; a labyrinth is in between; stripes are a labyrinth whose waves agree on one direction. Bare ground and full cover
have no contrast.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from support.persistence import field_features

Floats = NDArray[np.float64]
_NOTHING = 1e-100


@dataclass(frozen=True)
class Waves:
    """The waves of a field, by their power."""

    wavelength_m: float  # of the ring of wave numbers with most power, refined by its neighbours; nan without waves
    sharpness: float  # share of the power within a factor of 1.5 of that, 0 to 1
    anisotropy: float  # 0: waves run in all directions alike; 1: all in one
    direction_rad: float  # in which they run, anticlockwise from east, above -pi/2 to pi/2: across the stripes


@dataclass(frozen=True)
class FieldMeasures:
    """What tells a field's pattern."""

    mean: float
    cover: float  # share of the cells above the threshold
    contrast: float  # standard deviation over the mean; 0 where the mean is
    skewness: float  # 0 where all cells are alike
    waves: Waves
    islands: int  # that live through at least half of the field's range
    lakes: int


def measure_field(
    field: NDArray[np.floating], size_m: tuple[float, float], *, threshold: float, periodic: bool
) -> FieldMeasures:
    """Measures of a field (rows, cols) over a site; row 0 at y = 0.

    Parameters
    ----------
    threshold : value above which a cell is covered.
    periodic : the site is a torus; else its spectrum is taken through a Hann window.
    """
    values = np.asarray(field, dtype=np.float64)
    mean, span = float(values.mean()), float(np.ptp(values))
    alike = _alike(values)
    many = [
        0 if alike else int(np.sum(-np.diff(field_features(values, degree, periodic=periodic)) >= 0.5 * span))
        for degree in (0, 1)
    ]
    return FieldMeasures(
        mean=mean,
        cover=float((values > threshold).mean()),
        contrast=0.0 if alike or mean == 0 else float(values.std()) / abs(mean),
        skewness=skewness(values),
        waves=waves(values, size_m, periodic=periodic),
        islands=many[0],
        lakes=many[1],
    )


def skewness(field: NDArray[np.floating]) -> float:
    """Third central moment over the cube of the standard deviation; 0 where all values are alike."""
    values = np.asarray(field, dtype=np.float64)
    if _alike(values):
        return 0.0
    scaled = (values - values.mean()) / values.std()
    return float(np.mean(scaled**3))


def power_spectrum(
    field: NDArray[np.floating], size_m: tuple[float, float], *, periodic: bool
) -> tuple[Floats, Floats, Floats]:
    """Wave numbers to east and north, cycles a metre, and the power of each: (rows, cols) each, 0 in the middle one."""
    values = np.asarray(field, dtype=np.float64)
    rows, cols = values.shape
    values = values - values.mean()
    if not periodic:
        window = np.hanning(rows + 2)[1:-1, None] * np.hanning(cols + 2)[1:-1]
        values = (values - np.average(values, weights=window)) * window
    power = np.abs(np.fft.fft2(values)) ** 2
    power[0, 0] = 0.0
    east, north = np.meshgrid(np.fft.fftfreq(cols, size_m[0] / cols), np.fft.fftfreq(rows, size_m[1] / rows))
    return east, north, power


def radial_spectrum(
    field: NDArray[np.floating], size_m: tuple[float, float], *, periodic: bool
) -> tuple[Floats, Floats]:
    """Wave numbers of rings, cycles a metre, as wide as the longer side's first, and the power in each."""
    east, north, power = power_spectrum(field, size_m, periodic=periodic)
    width = 1.0 / max(size_m)
    ring = np.rint(np.hypot(east, north) / width).astype(np.intp)
    sums = np.bincount(ring.ravel(), weights=power.ravel())
    return np.asarray(np.arange(1, len(sums)) * width), np.asarray(sums[1:], dtype=np.float64)


def waves(field: NDArray[np.floating], size_m: tuple[float, float], *, periodic: bool) -> Waves:
    """The waves that a field is made of."""
    if _alike(np.asarray(field, dtype=np.float64)):
        return Waves(math.nan, 0.0, 0.0, 0.0)
    number, power = radial_spectrum(field, size_m, periodic=periodic)
    most = int(np.argmax(power))
    near = slice(max(most - 1, 0), most + 2)
    peak = float(np.sum(number[near] * power[near]) / np.sum(power[near]))
    inside = (number >= peak / 1.5) & (number <= peak * 1.5)
    east, north, each = power_spectrum(field, size_m, periodic=periodic)
    turned = complex(np.sum(each * np.exp(2j * np.arctan2(north, east))) / each.sum())
    return Waves(
        1.0 / peak, float(power[inside].sum() / power.sum()), abs(turned), 0.5 * math.atan2(turned.imag, turned.real)
    )


def _alike(values: Floats) -> bool:
    """Whether a field is the same everywhere, but for rounding and for what is too small to be squared."""
    return bool(np.ptp(values) <= max(1e-9 * np.abs(values).max(), _NOTHING))
