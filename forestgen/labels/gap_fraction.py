"""Gap fraction of hemispherical photographs, exactly: the share of sky by zenith ring, and leaf area index from it.

A camera that looks straight up sees the sky through gaps of the canopy. Foresters threshold photographs to find them;
here each sample of the identity pass has met a plant or not. What lies under the horizon, ground and rock above
it, and what lies outside of the circle take no part.

- gap fraction of a ring: P(theta) = sum of w (samples that met nothing) / sum of w (those and samples that met plants);
  w is the sample's solid angle, w = sin(theta) / theta f^-2 of an equidistant fisheye
- effective leaf area index (Miller 1967): L_e = 2 integral over theta from 0 to pi/2 of -ln P(theta) cos(theta)
  sin(theta), all plant matter counted, as if it stood at random. Rings beyond 75 degrees, where gaps are too few, and
  those of no sample are left out and the weights of the others raised to sum to 1, as by the LAI-2000, whose five
  rings end at 74 degrees (Welles and Norman 1991). A ring without any gap is taken to have half a sample of it: the
  index is a lower bound then
- at 57.5 degrees a canopy of any leaf angles has P = exp(-L / (2 cos theta)) to within 10% (Warren Wilson 1963): the
  ring that holds this angle gives `hinge_lai`

References
----------
Miller 1967, "A formula for average foliage density", Australian Journal of Botany 15.
Welles and Norman 1991, "Instrument for indirect measurement of canopy architecture", Agronomy Journal 83.
Warren Wilson 1963, "Estimation of foliage denseness and foliage angle by inclined point quadrats", Aust. J. Bot. 11.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.render.frame import Identity
from forestgen.render.identity import sample_offsets
from forestgen.scene.projection import projection_of
from forestgen.scene.spec import Camera

RINGS = 18  # of 5 degrees
_WIDEST_RAD = float(np.radians(75.0 + 1e-6))  # of the rings that give the leaf area
LEVEL_DEG = 1.0  # how far from straight up a camera may look
_HINGE_RAD = float(np.radians(57.5))


@dataclass(frozen=True)
class GapFraction:
    """Of one upward fisheye, rings from the zenith to the horizon."""

    edges_deg: NDArray[np.float64]  # (R + 1,) zenith angles
    gap_fraction: NDArray[np.float64]  # (R,) NaN where the image shows nothing of a ring
    samples: NDArray[np.int64]  # (R,) that met plants or nothing
    gaps: NDArray[np.int64]  # (R,) of these, those that met nothing
    effective_lai: float  # by Miller's integral, rings of the image alone; NaN where there are none
    hinge_lai: float  # of the ring that holds 57.5 degrees; NaN where the image does not show it
    openness: float  # share of the whole sky's solid angle that is seen, of what the image shows of it

    def as_dict(self) -> dict[str, Any]:
        """The fields of canopy.json, which instruments/gap_fraction.py explains."""
        return {
            "zenith_deg": [round(edge, 9) for edge in self.edges_deg.tolist()],
            "gap_fraction": [_known(share) for share in self.gap_fraction.tolist()],
            "samples": self.samples.tolist(),
            "gaps": self.gaps.tolist(),
            "effective_lai": _known(self.effective_lai),
            "hinge_lai": _known(self.hinge_lai),
            "openness": _known(self.openness),
        }


def _known(value: float) -> float | None:
    return None if math.isnan(value) else value


def looks_up(camera: Camera) -> bool:
    """Whether it is a fisheye that looks to the zenith, within a degree."""
    return projection_of(camera).is_equidistant and bool(
        camera.world_from_camera[2, 2] >= np.cos(np.radians(LEVEL_DEG))
    )


def gap_fraction_of(camera: Camera, identity: Identity) -> GapFraction:
    """Gap fraction by zenith ring of a fisheye that looks up, another one raises `ValueError`, by its identity pass."""
    if not looks_up(camera):
        raise ValueError("gap fractions are those of a fisheye that looks straight up")
    edges = np.linspace(0.0, np.pi / 2, RINGS + 1)
    seen, gaps = np.zeros(RINGS, dtype=np.int64), np.zeros(RINGS, dtype=np.int64)
    seen_weight, gap_weight = np.zeros(RINGS), np.zeros(RINGS)
    plant_id, part = identity.plant_id, identity.part
    for sample, offset in enumerate(sample_offsets(plant_id.shape[2])):
        theta, exists = _zenith(camera, plant_id.shape[:2], offset)
        is_gap = (part[..., sample] == Part.NOTHING) & exists
        is_plant = (plant_id[..., sample] != 0) | (part[..., sample] == Part.SURROUNDINGS)
        counts = (is_gap | is_plant) & (theta < np.pi / 2) & exists
        ring = np.minimum((theta / (np.pi / 2) * RINGS).astype(np.int64), RINGS - 1)
        weight = np.sinc(theta / np.pi)
        for total, weights, chosen in ((seen, seen_weight, counts), (gaps, gap_weight, counts & is_gap)):
            total += np.bincount(ring[chosen], minlength=RINGS)
            weights += np.bincount(ring[chosen], weights=weight[chosen], minlength=RINGS)
    share = np.divide(gap_weight, seen_weight, out=np.full(RINGS, np.nan), where=seen > 0)
    logs = -np.log(np.maximum(share, 0.5 / np.maximum(seen, 1)))
    hinge = int(np.searchsorted(edges, _HINGE_RAD)) - 1
    return GapFraction(
        edges_deg=np.degrees(edges),
        gap_fraction=share,
        samples=seen,
        gaps=gaps,
        effective_lai=_miller(edges, logs),
        hinge_lai=float(2 * np.cos(0.5 * (edges[hinge] + edges[hinge + 1])) * logs[hinge]),
        openness=float(gap_weight.sum() / seen_weight.sum()) if seen.any() else float("nan"),
    )


def _zenith(
    camera: Camera, shape: tuple[int, ...], offset: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """(H, W) zenith angles at a sub-pixel position, and whether it lies in the circle."""
    width, height = camera.size_px
    x, y = np.meshgrid(np.arange(width) + offset[0] - width / 2, np.arange(height) + offset[1] - height / 2)
    own = projection_of(camera).rays(camera, x, y)
    focal_px = width / float(np.radians(camera.hfov_deg))
    theta = np.hypot(x, y) / focal_px
    # The axis may lean by a degree: angles are from the zenith itself.
    sine = np.sinc(theta / np.pi) / focal_px
    up = camera.world_from_camera[2]
    cosine = x * sine * up[0] + y * sine * up[1] + np.cos(theta) * up[2]
    return np.arccos(np.clip(cosine, -1.0, 1.0)).reshape(shape), own.valid.reshape(shape)


def _miller(edges: NDArray[np.float64], logs: NDArray[np.float64]) -> float:
    """Twice the mean of -ln P cos(theta) over the rings, weighted by the integral of sin(theta) over each."""
    known = np.isfinite(logs) & (edges[1:] <= _WIDEST_RAD)
    if not known.any():
        return float("nan")
    middle = 0.5 * (edges[:-1] + edges[1:])
    weight = np.cos(edges[:-1]) - np.cos(edges[1:])  # 1 over the whole sky
    return float(2 * (logs * np.cos(middle) * weight)[known].sum() / weight[known].sum())
