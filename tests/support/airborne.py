"""Airborne pictures of forests compared: light of crowns, ground and shadows, gradients and local contrast.

A picture is linear Rec. 709 of any exposure, north at the top, `PIXEL_M` a pixel. All figures are ratios,
chromaticities or of the logarithm of luminance: they do not depend on exposure.

- Shadow: luminance below Otsu's threshold of its logarithm, over the whole picture.
- Crowns by boxes: the sunlit part of the ellipses in boxes around trees; the ground is sunlit and in no box.
- Crowns by split: two clusters of the sunlit pixels' log(red / green) and log(blue / green), smoothed by 0.2 m; which
  of the two is crowns depends on the place, where needles are greener than sand, or less green than herbs.
- Gradient: length of the difference of log luminance to the next pixels, per pixel. Local contrast: standard deviation
  of log luminance within 0.9 m.

Otsu, N. 1979, IEEE Transactions on Systems, Man, and Cybernetics 9, 62-66.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, stats
from sklearn.cluster import KMeans

from forestgen.core.spectrum import LUMINANCE
from support import panoramas

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
Box = tuple[float, float, float, float]  # left, top, right, bottom, pixels

PIXEL_M = 0.1
WINDOW_PX, STRIDE_PX = 200, 100
_DARKEST = 1e-3  # added before logarithms: less than a third of a level of the darkest shadows
_CONTRAST_PX = 9
_SMOOTH_PX = 2.0
_QUANTILES = 512  # that stand for a distribution
_LEAST_PX = 200  # of crowns, of ground or of shadow, for a window to count
HISTOGRAMS = ("gradient", "contrast")


@dataclass(frozen=True)
class Picture:
    """An airborne picture."""

    rgb: Floats  # (H, W, 3) linear
    crowns: Mask | None = None  # (H, W) in the ellipse of a tree's box; None: no boxes are known
    ground: Mask | None = None  # (H, W) in no box
    seen: Mask | None = None  # (H, W) what counts: a road is left out; None: all
    greener: bool = True  # whether crowns are the greener cluster of the split

    @property
    def counts(self) -> Mask:
        return np.ones(self.rgb.shape[:2], dtype=bool) if self.seen is None else self.seen


def linear(srgb: NDArray[np.uint8]) -> Floats:
    """Light of an sRGB picture: IEC 61966-2-1."""
    value = srgb.astype(np.float64) / 255.0
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def encoded(rgb: Floats) -> NDArray[np.uint8]:
    """(H, W, 3) sRGB of light; clipped."""
    value = np.clip(rgb, 0.0, 1.0)
    srgb = np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)
    return np.round(255.0 * srgb).astype(np.uint8)


def log_luminance(rgb: Floats) -> Floats:
    return np.asarray(np.log(rgb @ LUMINANCE + _DARKEST))


def chromaticity(rgb: Floats) -> Floats:
    """(2,) u'v' of the mean of (N, 3) light: CIE 1976."""
    return np.array(panoramas.chromaticity(rgb.mean(axis=0)))


def otsu(values: Floats) -> float:
    """The threshold that leaves the least variance within what is below and above it."""
    count, edges = np.histogram(values, 256)
    middle = 0.5 * (edges[1:] + edges[:-1])
    below = np.cumsum(count) / count.sum()
    mean = np.cumsum(count * middle) / count.sum()
    between = (mean[-1] * below - mean) ** 2 / np.maximum(below * (1.0 - below), 1e-12)
    return float(middle[between.argmax()])


def boxes_of(path: Path) -> list[Box]:
    """Boxes of a Pascal VOC file."""
    sides = ("xmin", "ymin", "xmax", "ymax")
    found = []
    for box in ET.parse(path).iter("bndbox"):
        left, top, right, bottom = (float(box.findtext(side, "nan")) for side in sides)
        found.append((left, top, right, bottom))
    return found


def crowns_and_ground(boxes: list[Box], shape: tuple[int, int]) -> tuple[Mask, Mask]:
    """(H, W) what lies in the ellipses of boxes, and what lies in no box."""
    crowns, ground = np.zeros(shape, dtype=bool), np.ones(shape, dtype=bool)
    row, column = np.ogrid[: shape[0], : shape[1]]
    for left, top, right, bottom in boxes:
        across = (column + 0.5 - (left + right) / 2) / max((right - left) / 2, 0.5)
        down = (row + 0.5 - (top + bottom) / 2) / max((bottom - top) / 2, 0.5)
        crowns |= across**2 + down**2 < 1.0
        ground &= (np.abs(across) > 1.0) | (np.abs(down) > 1.0)
    return crowns, ground


def sunlit(picture: Picture) -> Mask:
    """(H, W) what counts and is no shadow."""
    light = log_luminance(picture.rgb)
    return np.asarray((light > otsu(light[picture.counts])) & picture.counts)


def split(picture: Picture, lit: Mask) -> tuple[Mask, Mask]:
    """(H, W) sunlit crowns and sunlit ground, by colour alone."""
    weight = lit.astype(np.float64)
    total = np.maximum(ndimage.gaussian_filter(weight, _SMOOTH_PX), 1e-6)
    logs = np.log(picture.rgb + 0.01)
    ratios = (logs[..., 0] - logs[..., 1], logs[..., 2] - logs[..., 1])
    smooth = [ndimage.gaussian_filter(ratio * weight, _SMOOTH_PX) / total for ratio in ratios]
    points = np.stack([one[lit] for one in smooth], axis=-1)
    points = (points - points.mean(axis=0)) / np.maximum(points.std(axis=0), 1e-9)
    label = KMeans(2, n_init=3, random_state=0).fit_predict(points)
    green = [-points[label == k].sum(axis=1).mean() for k in (0, 1)]
    crown = int(np.argmax(green) if picture.greener else np.argmin(green))
    crowns, ground = np.zeros_like(lit), np.zeros_like(lit)
    crowns[lit], ground[lit] = label == crown, label != crown
    return crowns, ground


def windows(picture: Picture) -> Iterator[tuple[slice, slice]]:
    """Squares of 20 m, 10 m apart, of which at least nine tenths count."""
    height, width = picture.rgb.shape[:2]
    for top in range(0, height - WINDOW_PX + 1, STRIDE_PX):
        for left in range(0, width - WINDOW_PX + 1, STRIDE_PX):
            at = (slice(top, top + WINDOW_PX), slice(left, left + WINDOW_PX))
            if picture.counts[at].mean() >= 0.9:
                yield at


def figures(picture: Picture) -> list[dict[str, float]]:
    """Of each window; NaN where it has too few crowns, ground or shadow to say, or the picture has no boxes."""
    lit = sunlit(picture)
    by_split = split(picture, lit)
    known = picture.crowns is not None and picture.ground is not None
    nothing = np.zeros_like(lit)
    by_boxes = (picture.crowns & lit, picture.ground & lit) if known else (nothing, nothing)  # type: ignore[operator]
    shaded = picture.counts & ~lit
    return [_of_window(picture.rgb, lit, shaded, by_boxes, by_split, at) for at in windows(picture)]


def _of_window(
    rgb: Floats,
    lit: Mask,
    shaded: Mask,
    by_boxes: tuple[Mask, Mask],
    by_split: tuple[Mask, Mask],
    at: tuple[slice, slice],
) -> dict[str, float]:
    def light(mask: Mask) -> Floats:
        chosen = rgb[at][mask[at]]
        return chosen if len(chosen) >= _LEAST_PX else np.full((1, 3), np.nan)

    found = {"shadow share": float(shaded[at].mean())}
    found["shadow / sunlit"] = float(np.divide(*(light(mask).mean(axis=0) @ LUMINANCE for mask in (shaded, lit))))
    for name, (crowns, ground) in (("boxes", by_boxes), ("split", by_split)):
        crown, floor = light(crowns), light(ground)
        found[f"crown / ground, {name}"] = float(crown.mean(axis=0) @ LUMINANCE / (floor.mean(axis=0) @ LUMINANCE))
        for what, chosen in (("crown", crown), ("ground", floor)):
            u, v = chromaticity(chosen)
            found |= {f"{what} u', {name}": float(u), f"{what} v', {name}": float(v)}
    u, v = chromaticity(light(shaded))
    return found | {"shadow u'": float(u), "shadow v'": float(v)}


def textures(picture: Picture) -> dict[str, list[Floats]]:
    """Of each window, by name of the histogram: quantiles of the pixels that count."""
    light = log_luminance(picture.rgb)
    down, across = np.zeros_like(light), np.zeros_like(light)
    down[:-1], across[:, :-1] = np.diff(light, axis=0), np.diff(light, axis=1)
    mean = ndimage.uniform_filter(light, _CONTRAST_PX)
    variance = ndimage.uniform_filter(light**2, _CONTRAST_PX) - mean**2
    maps = {"gradient": np.hypot(down, across), "contrast": np.sqrt(np.maximum(variance, 0.0))}
    places = list(windows(picture))
    return {name: [quantiles(maps[name][at][picture.counts[at]]) for at in places] for name in HISTOGRAMS}


def quantiles(values: Floats) -> Floats:
    """(512,) at equal steps of probability: a distribution in short."""
    return np.asarray(np.quantile(values, (np.arange(_QUANTILES) + 0.5) / _QUANTILES))


def distance(one: Floats, other: Floats) -> float:
    """Of two distributions: the mean by which sorted values differ (Wasserstein's, of the first order)."""
    return float(stats.wasserstein_distance(one, other))


def spread(values: list[float]) -> tuple[float, float]:
    """5th and 95th percentile; NaN of nothing."""
    known = np.array(values)[np.isfinite(values)]
    low, high = np.percentile(known, [5, 95]) if known.size else (np.nan, np.nan)
    return float(low), float(high)


def distances(ours: list[Floats], real: list[Floats]) -> tuple[list[float], list[float]]:
    """Of each of our windows to all real ones together; and of each real one to the others together: the yardstick."""
    whole = np.concatenate(real)
    between = [distance(one, np.concatenate(real[:k] + real[k + 1 :])) for k, one in enumerate(real)]
    return [distance(one, whole) for one in ours], between


def compare(
    real: list[dict[str, float]], ours: list[dict[str, float]]
) -> Mapping[str, tuple[float, float, float, float]]:
    """By figure: low and high of the real windows' spread, the median of the real ones, and of ours."""
    found = {}
    for name in real[0]:
        low, high = spread([window[name] for window in real])
        medians = [_median([window[name] for window in some]) for some in (real, ours)]
        found[name] = (low, high, medians[0], medians[1])
    return found


def _median(values: list[float]) -> float:
    known = np.array(values)[np.isfinite(values)]
    return float(np.median(known)) if known.size else float("nan")
