"""A kernel for a wanted clustering: a family of kernels, and the search for the one that gives a Hopkins index.

The family has one parameter t; distances are in spacings, the root of the area that a plant has where plants stand.

- t < 0, apart: κ is 0 to the distance -t, and 1 from there to 2.5 times that.
- t = 0: κ is 1, plants stand at random.
- t > 0, clusters: κ rises from 0 at the plant, where another one stands already, to e^t from 0.08 to 0.4 spacings, and
  falls to 1 at 0.65. It reaches to 1.5 spacings and, beyond t = 1.2, by 0.6 more with each unit of t.

All of them are balanced: they move probability about within their reach, so that plants keep to the map.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.community.placement.field import DensityField, place
from forestgen.community.placement.kernels import SAMPLES, KernelTable
from forestgen.community.point_patterns import hopkins_index
from forestgen.community.population import Floats, Site
from forestgen.community.trajectory import reported_hopkins
from forestgen.core.randomness import child_rng

MOST_TRIAL_PLANTS = 2000  # of more plants, a regular share is placed on a site that is smaller by as much
FEWEST = 10  # plants that have a Hopkins index worth aiming at
CELLS_PER_SPACING = 12  # the family's finest detail is 0.08 spacings
_LEAST, _MOST = -0.85, 6.2  # t
_ROUNDS = 14
_CLOSE = 0.005  # of the logarithm of H: nearer is not looked for
TOLERANCE = 0.1  # of H or, above 1, of its ratio to the target: what counts as reached
TOLD = 0.05  # the same, of the placed plants: a note reports what is farther off
_CORE, _RISEN, _TOP, _FALLEN = 0.06, 0.08, 0.4, 0.65  # knots of a kernel that makes clusters, in spacings


def family(t: float, spacing_m: float) -> KernelTable:
    """The kernel of parameter t; see the module's page."""
    knots = _knots(t) if t >= 0 else []
    reach = knots[-1][0] if knots else 2.5 * -t
    distance = np.linspace(0.0, reach, SAMPLES + 1)
    values = np.interp(distance, *np.array(knots).T) if knots else np.where(distance < -t, 0.0, 1.0)
    return KernelTable(values, reach * spacing_m, in_radii=False, balanced=True)


def _knots(t: float) -> list[tuple[float, float]]:
    """Distances in spacings and κ of a kernel that makes clusters; neutral at t = 0, without a jump."""
    core, top, reach = max(0.0, 1.0 - 2.0 * t), math.exp(t), 1.5 + 0.6 * max(0.0, t - 1.2)
    return [(0.0, core), (_CORE, core), (_RISEN, top), (_TOP, top), (_FALLEN, 1.0), (reach, 1.0)]


def as_section(t: float, spacing_m: float) -> dict[str, Any]:
    """The kernel of parameter t as a recipe says it, to six digits: a `KernelSection` with the same table."""
    knots = _knots(t)
    if t < 0:
        reach, edge = 2.5 * -t, 0.5 / SAMPLES  # the step lies between two samples of the table, as in `family`
        knots = [(0.0, 0.0), (reach * (0.4 - edge / 2), 0.0), (reach * (0.4 + edge / 2), 1.0), (reach, 1.0)]
    curve = [[float(f"{one * spacing_m:.6g}"), float(f"{value:.6g}")] for one, value in knots]
    return {"curve": curve, "distance": "metres", "balanced": True}


def spacing(densities: Sequence[Floats], counts: NDArray[np.integer], area_m2: float) -> float:
    """Root of the area that a plant has, metres, at the mean density where plants stand.

    `densities` are grids of each species in any unit, `counts` (S,) its plants.
    """
    summed = np.zeros(densities[0].shape)
    for density, count in zip(densities, counts, strict=True):
        if (total := float(density.sum())) > 0:
            summed += density * (float(count) / total)
    cell_m2 = area_m2 / summed.size
    return math.sqrt(float(summed.sum()) / float(np.sum(summed**2) / cell_m2))


@dataclass(frozen=True)
class TrialPlacement:
    """What is placed again and again while a kernel is looked for, each time with the same numbers."""

    densities: Sequence[Floats]  # (rows, cols) of each field
    size_m: tuple[float, float]
    periodic: bool
    field: NDArray[np.intp]  # (N,) index of each plant's field, in the order of placement
    uniform: Floats  # (N, 2) in [0, 1)
    spacing_m: float
    seed: int  # of the community

    def positions(self, kernel: KernelTable) -> Floats:
        """(N, 2) places, metres; nan for a plant that found none."""
        fields = [DensityField(one, self.size_m, periodic=self.periodic) for one in self.densities]
        kernels = [[kernel] * len(fields)] * len(fields)
        return place(fields, self.field, np.full(len(self.field), self.spacing_m), kernels, self.uniform).position_m

    def hopkins(self, t: float) -> float:
        """Hopkins index of the plants under the kernel of parameter t; 0 where not all of them find a place."""
        position_m = self.positions(family(t, self.spacing_m))
        if np.isnan(position_m).any():
            return 0.0
        return hopkins_index(position_m, self.size_m, child_rng(self.seed, "community", "trial placement"))


@dataclass(frozen=True)
class Found:
    """The kernel nearest to a target."""

    kernel: KernelTable
    t: float
    hopkins: float  # in the trial
    section: dict[str, Any]  # the kernel as a recipe says it


def kernel_for(target: float, trial: TrialPlacement) -> Found:
    """The kernel of the family under which plants come nearest to a Hopkins index.

    By bisection: H rises with t. Because every trial has the same random numbers, H is a function of t alone; plants
    that move from one cluster to another make it rough, so the best of all trials counts.
    """
    tried: dict[float, float] = {}

    def off(t: float) -> float:
        tried[t] = trial.hopkins(t)
        return math.log(max(tried[t], 1e-9) / target)

    low, high = (_LEAST, 0.0) if off(0.0) > 0 else (0.0, _MOST)
    for _ in range(_ROUNDS):
        middle = (low + high) / 2
        error = off(middle)
        if abs(error) < _CLOSE:
            break
        low, high = (low, middle) if error > 0 else (middle, high)
    t = min(tried, key=lambda one: abs(math.log(max(tried[one], 1e-9) / target)))
    return Found(family(t, trial.spacing_m), t, tried[t], as_section(t, trial.spacing_m))


def describe(
    target: float, found: Found | None, position_m: Floats, site: Site, seed: int, cells: int
) -> dict[str, Any]:
    """What became of a target, plain as in JSON; nothing was `found` where there were too few plants.

    `position_m` (N, 2) are the plants that found a place. With as many `cells` along the site's longer side, the kernel
    makes the same pattern again.
    """
    if found is None:
        return {"asked_hopkins": target}
    measured = reported_hopkins(position_m, site, seed)
    return {
        "asked_hopkins": target,
        "hopkins": measured if math.isfinite(measured) else None,
        "reached": abs(found.hopkins - target) <= TOLERANCE * max(1.0, target),
        "kernels": found.section,
        "cells": cells,
    }


def notes_on(report: Mapping[str, Any]) -> list[str]:
    """A note if there were too few plants for the target that was asked for, or the plants have another index."""
    target = report["asked_hopkins"]
    asked = f"a Hopkins index of {target:g} was asked for"
    if "kernels" not in report:
        return [f"{asked}: there are too few plants for one"]
    measured = math.nan if report["hopkins"] is None else report["hopkins"]
    if report["reached"] and abs(measured - target) <= TOLD * max(1.0, target):
        return []
    nearest = "" if report["reached"] else ", as near as it comes"
    points = ", ".join(f"[{one:g}, {value:g}]" for one, value in report["kernels"]["curve"])
    kernel = f"{{distance: metres, balanced: true, curve: [{points}]}}"
    return [f"{asked}, and that of the plants is {measured:.3g}{nearest}; the kernel found is {kernel}"]
