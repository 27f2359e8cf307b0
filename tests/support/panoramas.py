"""Figures of equirectangular pictures of radiance, by bands of elevation, and their comparison.

Row 0 is the zenith, the last row the nadir; columns are azimuths, the last one neighbours the first. Pictures are
(H, 2 H, 3), linear Rec. 709, in any unit. Every pixel counts by its solid angle.

- Luminance below a tenth of the picture's median is raised to it before logarithms are taken: a measured panorama has
  values below zero at plants against the sky, from the negative lobes of the filter that made it smaller.
- Gaps: sky and plants are told apart by blue radiance, as in hemispherical photographs. Otsu's threshold (1979, IEEE
  Trans. SMC 9, 62-66) of its square root above the horizon, without the brightest hundredth, makes two classes; sky is
  what is brighter than half way between their medians, so that pixels of sky and plants count as often on either side.
- Sunlit to shaded ground: Otsu's threshold of log luminance parts the pixels below -10 degrees; the ratio is that of
  the geometric means of both classes. Bright and dark ground is part of it.
- Power spectrum: of log luminance along each row, over cycles per degree of arc, which a row at elevation e has
  1 / (360 cos e) of. The slope is that of log power over log frequency between 0.03 and 0.35 cycles per degree.
"""

from __future__ import annotations

import base64
import re
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from forestgen.core.spectrum import LUMINANCE
from forestgen.dataset.exr import read_exr
from forestgen.scene.colour import rec709_from_xyz

Floats = NDArray[np.float64]

BANDS_DEG = ((-90, -60), (-60, -30), (-30, -10), (-10, 10), (10, 30), (30, 60), (60, 90))
_GROUND_BELOW_DEG, GAPS_ABOVE_DEG = -10.0, -10.0
_FLOOR = 0.1  # of the median luminance
_SLOPE_PER_DEG = (0.03, 0.35)  # cycles per degree; pixels are 0.7 degrees
_SLOPE_BINS = 8
_OTSU_BINS = 512
_EDGE_PX = 16


@dataclass(frozen=True)
class Band:
    """Figures of a band of elevation."""

    log_luminance: float  # mean of the natural logarithm
    spread: float  # its standard deviation
    uv: tuple[float, float]  # CIE 1976 u'v' of the mean radiance
    slope: float  # of the power spectrum of log luminance
    gaps: float  # share of sky


@dataclass(frozen=True)
class Panorama:
    """Figures of a picture."""

    bands: tuple[Band, ...]  # of BANDS_DEG
    sunlit_over_shaded: float


def elevation_deg(rows: int) -> Floats:
    """(H,) of the rows' middles."""
    return 90.0 - (np.arange(rows) + 0.5) * 180.0 / rows


def solid_angles(rows: int) -> Floats:
    """(H, 2 H), any unit."""
    return np.repeat(np.cos(np.radians(elevation_deg(rows)))[:, None], 2 * rows, axis=1)


def luminance(picture: Floats) -> Floats:
    """(H, W), at least a tenth of its median."""
    found = picture @ np.array(LUMINANCE)
    return np.asarray(np.maximum(found, _FLOOR * np.median(found)))


def mean_log(picture: Floats) -> float:
    """Mean of log luminance over the sphere."""
    return float(np.average(np.log(luminance(picture)), weights=solid_angles(len(picture))))


def chromaticity(rgb: Floats) -> tuple[float, float]:
    """CIE 1976 u'v' of a colour."""
    x, y, z = np.linalg.solve(rec709_from_xyz(), rgb)
    total = x + 15.0 * y + 3.0 * z
    return float(4.0 * x / total), float(9.0 * y / total)


def otsu(values: Floats) -> float:
    """The threshold that parts values into two classes, the variance between them being largest."""
    counts, edges = np.histogram(values, _OTSU_BINS)
    middles = 0.5 * (edges[1:] + edges[:-1])
    below, total = np.cumsum(counts)[:-1], np.cumsum(counts * middles)
    above = counts.sum() - below
    with np.errstate(invalid="ignore", divide="ignore"):
        between = below * above * (total[:-1] / below - (total[-1] - total[:-1]) / above) ** 2
    return float(edges[1 + np.nanargmax(between)])


def is_sky(picture: Floats) -> NDArray[np.bool_]:
    """(H, W) where the sky takes more than half of a pixel."""
    blue = np.maximum(picture[..., 2], 0.0)
    above = blue[elevation_deg(len(picture)) > 0.0]
    threshold = otsu(np.sqrt(np.minimum(above, np.percentile(above, 99)))) ** 2
    middle = 0.5 * (np.median(above[above > threshold]) + np.median(above[above <= threshold]))
    return np.asarray(blue > middle)


def sunlit_over_shaded(picture: Floats) -> float:
    """Ratio of the ground's geometric mean luminances in sun and shade."""
    ground = elevation_deg(len(picture)) < _GROUND_BELOW_DEG
    logs, weights = np.log(luminance(picture))[ground], solid_angles(len(picture))[ground]
    sunlit = logs > otsu(logs)
    sun, shade = (np.average(logs[where], weights=weights[where]) for where in (sunlit, ~sunlit))
    return float(np.exp(sun - shade))


def slope(logs: Floats, elevations_deg: Floats) -> float:
    """Slope of the power spectrum of (R, W) rows at (R,) elevations; power is per cycle per degree of arc."""
    width = logs.shape[1]
    power = np.abs(np.fft.rfft(logs, axis=1)[:, 1:]) ** 2
    arc_deg = 360.0 * np.cos(np.radians(elevations_deg))[:, None]
    frequency = np.arange(1, width // 2 + 1)[None, :] / arc_deg
    density = power * arc_deg
    edges = np.geomspace(*_SLOPE_PER_DEG, _SLOPE_BINS + 1)
    x, y = [], []
    for low, high in pairwise(edges):
        inside = (frequency >= low) & (frequency < high)
        x.append(0.5 * np.log(low * high))
        y.append(np.log(density[inside].mean()))
    return float(np.polyfit(x, y, 1)[0])


def measure(picture: Floats) -> Panorama:
    """All figures of a (H, 2 H, 3) picture."""
    rows = len(picture)
    elevations, weights = elevation_deg(rows), solid_angles(rows)
    logs, sky = np.log(luminance(picture)), is_sky(picture)
    bands = []
    for low, high in BANDS_DEG:
        inside = (elevations >= low) & (elevations < high)
        mean = float(np.average(logs[inside], weights=weights[inside]))
        bands.append(
            Band(
                mean,
                float(np.sqrt(np.average((logs[inside] - mean) ** 2, weights=weights[inside]))),
                chromaticity(np.average(picture[inside], axis=(0, 1), weights=weights[inside])),
                slope(logs[inside], elevations[inside]),
                float(np.average(sky[inside], weights=weights[inside])),
            )
        )
    return Panorama(tuple(bands), sunlit_over_shaded(picture))


@dataclass(frozen=True)
class Figure:
    """One figure of both pictures."""

    band: str
    name: str
    real: str
    ours: str
    difference: float  # of ratios the larger over the smaller, less 1
    bound: float

    @property
    def kept(self) -> bool:
        return self.difference <= self.bound


def exact_gaps(is_nothing: NDArray[np.bool_]) -> list[float]:
    """Share of the sky in each band by a mask of it, (H, 2 H)."""
    rows = len(is_nothing)
    elevations, weights = elevation_deg(rows), solid_angles(rows)
    bands = [(elevations >= low) & (elevations < high) for low, high in BANDS_DEG]
    return [float(np.average(is_nothing[band], weights=weights[band])) for band in bands]


def halved(picture: Floats) -> Floats:
    """A panorama of half as many pixels each way, by Lanczos' filter of three lobes."""
    width, rows = picture.shape[1], len(picture)
    around = np.pad(picture, ((0, 0), (_EDGE_PX, _EDGE_PX), (0, 0)), mode="wrap").astype(np.float32)
    size = (width // 2 + _EDGE_PX, rows // 2)
    channels = [Image.fromarray(around[..., k]).resize(size, Image.Resampling.LANCZOS) for k in range(3)]
    smaller = np.stack([np.asarray(one) for one in channels], axis=-1)
    return smaller[:, _EDGE_PX // 2 : -_EDGE_PX // 2].astype(np.float64)


def compare(real: Floats, ours: Floats) -> list[Figure]:
    """All figures of two pictures whose mean log luminance is the same."""
    found = []
    there, here = measure(real), measure(ours)
    for (low, high), one, other in zip(BANDS_DEG, there.bands, here.bands, strict=True):
        band = f"{low} to {high}"
        found += [
            _ratio(band, "luminance", np.exp(one.log_luminance), np.exp(other.log_luminance)),
            _ratio(band, "spread", one.spread, other.spread),
            Figure(band, "u'v'", _pair(one.uv), _pair(other.uv), float(np.hypot(*np.subtract(one.uv, other.uv))), 0.02),
            _difference(band, "slope", one.slope, other.slope, 0.15),
        ]
        if low >= GAPS_ABOVE_DEG:
            found.append(_difference(band, "gap fraction", one.gaps, other.gaps, 0.1))
    return [*found, _ratio("ground", "sunlit / shaded", there.sunlit_over_shaded, here.sunlit_over_shaded)]


def _ratio(band: str, name: str, real: float, ours: float) -> Figure:
    return Figure(band, name, f"{real:.3f}", f"{ours:.3f}", max(ours / real, real / ours) - 1.0, 0.25)


def _difference(band: str, name: str, real: float, ours: float, bound: float) -> Figure:
    return Figure(band, name, f"{real:.3f}", f"{ours:.3f}", abs(ours - real), bound)


def _pair(uv: tuple[float, float]) -> str:
    return f"{uv[0]:.3f} {uv[1]:.3f}"


def read_panorama(path: Path) -> Floats:
    """(H, 2 H, 3) radiance of an OpenEXR file, or of a JavaScript module that holds one as base64."""
    if path.suffix != ".js":
        return _read_exr(path)
    _, _, text = path.read_text().partition("base64,")
    with TemporaryDirectory() as folder:
        inner = Path(folder) / "panorama.exr"
        inner.write_bytes(base64.b64decode(re.split("['\"`]", text)[0]))
        return _read_exr(inner)


def _read_exr(path: Path) -> Floats:
    part = next(iter(read_exr(path).values()))
    return np.stack([part[name] for name in "RGB"], axis=-1).astype(np.float64)
