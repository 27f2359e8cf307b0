"""Plants that lean and sway in the wind, each as a whole about its stem's base.

A plant turns rigidly about the horizontal axis across the wind, so that its exemplar stays shared: only its transform
changes from one time to the next. A plant of height H, stem diameter D, mass m and frontal area A is taken as a mass on
an elastic stem, at half its height h = H / 2:

    natural frequency   f = 0.0948 + 3.4317 D / H^2          D in cm, H in m, f in Hz
    drag                F = 1/2 rho C U^2 A                  U is the mean speed at the plant's own top
    mean lean           theta = F h / (m h^2 (2 pi f)^2) = 1/2 rho C U^2 (A / m) / (h (2 pi f)^2)
    lean at time t      theta (1 + g (0.7 sin(2 pi f t + p) + 0.3 sin(2 pi f' t + p')))

g is the gustiness; gusts come at f' = U / (4 H), as eddies over a canopy are a few of its heights apart. The mean is
bounded smoothly, theta_m tanh(theta / theta_m) with theta_m of 12.5 degrees, and so the lean by 25 degrees, downwind.
Each plant has phases of its own and up to 10% more or less of f and theta, by its plant_id. Dead wood and houses stay
still, and the drag's fall by streamlining is left to the bound.

D comes from the exemplar's wood as if half of the cylinder D x H were full of it, within a factor of two of the stem
that elastic similarity gives a plant of its height, H = 35 D^(2/3) in metres: bushes have many stems, herbs little
wood. A spruce of 17 m and 23 cm sways at 0.36 Hz and leans by 3 degrees at 10 m/s; fireweed of 1.2 m at 1.7 to 3 Hz.

References
----------
J. R. Moore, D. A. Maguire (2004), Natural sway frequencies and damping ratios of trees: concepts, review and synthesis
of previous studies, Trees 18: the frequency. T. A. McMahon, R. E. Kronauer (1976), Tree structures: deducing the
principle of mechanical design, J. Theor. Biol. 59: elastic similarity. M. R. Raupach, J. J. Finnigan, Y. Brunet (1996),
Coherent eddies and turbulence in vegetation canopies, Boundary-Layer Meteorol. 78: the spacing of gusts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from forestgen.core.parts import Part
from forestgen.core.randomness import child_rng
from forestgen.plants.exemplar import Exemplar
from forestgen.scene.spec import Instances, SceneSpec

LARGEST_LEAN_RAD = np.radians(25.0)
_AIR_KG_PER_M3 = 1.2
_DRAG_COEFFICIENT = 0.25  # of a crown that gives way, by its frontal area
_WOOD_KG_PER_M3 = 900.0  # green
_LEAF_KG_PER_M2 = 0.2  # fresh
_FRONTAL_SHARE = 0.5  # of the leaves' area, for leaves turned every way
_STEM_FORM = 0.5  # volume of wood over that of the cylinder of the plant's height and diameter
_SPREAD = 0.1


@dataclass(frozen=True)
class Sway:
    """How each plant of a scene moves in the wind: one row an instance."""

    toward: tuple[float, float]  # unit, horizontal, where the wind blows to: east, north
    gustiness: float
    mean_rad: NDArray[np.float64]  # (N,) lean downwind
    frequency_hz: NDArray[np.float64]  # (N, 2) natural, of gusts
    phase_rad: NDArray[np.float64]  # (N, 2)

    def lean_rad(self, time_s: float) -> NDArray[np.float64]:
        """(N,) lean downwind at a time, in [0, `LARGEST_LEAN_RAD`]."""
        wave = np.sin(2.0 * np.pi * self.frequency_hz * time_s + self.phase_rad) @ np.array([0.7, 0.3])
        return np.asarray(self.mean_rad * (1.0 + self.gustiness * wave))


def natural_frequency_hz(height_m: NDArray[np.float64], diameter_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of trees by height and stem diameter, Moore and Maguire (2004)."""
    return 0.0948 + 3.4317 * (100.0 * diameter_m) / height_m**2


def sway_in(
    instances: Instances,
    exemplars: Sequence[Exemplar],
    *,
    speed_m_per_s: float,
    gustiness: float,
    from_deg: float,
    seed: int,
) -> Sway:
    """The movement of a scene's plants; O(plants).

    `from_deg`: where the wind comes from, degrees clockwise from north. `seed`: the image's.
    """
    height, area_per_kg, diameter = _mechanics(instances, exemplars)
    unit = np.array([child_rng(seed, "wind", int(i)).random(4) for i in instances.plant_id]).reshape(-1, 4)
    spread = 1.0 + _SPREAD * (2.0 * unit[:, :2] - 1.0)
    natural = natural_frequency_hz(height, diameter) * spread[:, 0]
    pressure = 0.5 * _AIR_KG_PER_M3 * _DRAG_COEFFICIENT * speed_m_per_s**2
    mean = pressure * area_per_kg / (0.5 * height * (2.0 * np.pi * natural) ** 2) * spread[:, 1]
    most = 0.5 * LARGEST_LEAN_RAD
    angle = np.radians(from_deg)
    return Sway(
        toward=(-float(np.sin(angle)), -float(np.cos(angle))),
        gustiness=gustiness,
        mean_rad=most * np.tanh(mean / most),
        frequency_hz=np.stack([natural, speed_m_per_s / (4.0 * height)], axis=1),
        phase_rad=2.0 * np.pi * unit[:, 2:],
    )


def _mechanics(
    instances: Instances, exemplars: Sequence[Exemplar]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """(N,) each: height in m, frontal area by mass in m^2/kg (0 for dead wood, houses), stem diameter in m."""
    which = instances.exemplar
    across, along = (np.linalg.norm(instances.transform[:, :, k], axis=1) for k in (0, 2))
    height = np.array([one.height_m for one in exemplars])[which] * along
    leaf_m2 = np.array([one.leaf_area_m2 for one in exemplars])[which] * across * along
    wood_m3 = np.array([one.wood_volume_m3 for one in exemplars])[which] * across**2 * along
    stiff = (Part.DEAD_WOOD, Part.STRUCTURE)
    living = np.array([any(organ.part not in stiff for organ in one.organs) for one in exemplars], dtype=bool)
    similar = (height / 35.0) ** 1.5
    diameter = np.clip(np.sqrt(4.0 * wood_m3 / (np.pi * _STEM_FORM * height)), 0.5 * similar, 2.0 * similar)
    area = _FRONTAL_SHARE * leaf_m2 + 0.5 * diameter * height
    # No less than the stem's own: a generator may give its wood as leaves, or none.
    stem_m3 = 0.25 * np.pi * _STEM_FORM * diameter**2 * height
    mass = _WOOD_KG_PER_M3 * np.maximum(wood_m3, stem_m3) + _LEAF_KG_PER_M2 * leaf_m2
    return height, np.where(living[which], area / mass, 0.0), diameter


def posed(instances: Instances, sway: Sway, time_s: float) -> Instances:
    """The plants as the wind holds them at a time, from `instances` as they stand in still air."""
    lean = sway.lean_rad(time_s)
    x, y = sway.toward
    # Rodrigues' formula about the axis (-y, x, 0), which turns the zenith towards (x, y, 0).
    sin, cos = np.sin(lean), np.cos(lean)
    rest = 1.0 - cos
    turn = np.array(
        [
            [cos + y * y * rest, -x * y * rest, x * sin],
            [-x * y * rest, cos + x * x * rest, y * sin],
            [-x * sin, -y * sin, cos],
        ]
    )
    transform, rows = instances.transform.copy(), slice(0, len(lean))  # the ground cover, which comes last, is still
    transform[rows, :, :3] = np.einsum("rkn,nkc->nrc", turn, instances.transform[rows, :, :3])
    return replace(instances, transform=transform)


def spec_at(spec: SceneSpec, sway: Sway | None, time_s: float) -> SceneSpec:
    """The scene at a time, from the scene in still air: without wind the very same object, at any time."""
    return spec if sway is None else replace(spec, instances=posed(spec.instances, sway, time_s))
