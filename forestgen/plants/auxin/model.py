"""Bending by auxin: how a root's sides grow, and how its segments are put together; and Barlow's root as its check.

Streit et al. 2005, section 3; Barlow, Brain and Adam 1989 as given there in section 2.2. Lengths in millimetres, time
in hours, auxin in a unit of its own. generators/auxin_root.py is the manual page.

The root is a row of segments, base to tip. A segment's surface has S sides at even azimuths (two sides: the plane
model), each with a length L and an amount of auxin A. With x the distance from the tip along the side,

::

    dA/dt = (v/L A) of the next segment to the tip - (v/L) A - decay A,     the tip's: + supply share(azimuth)
    dL/dt = L RELEL(x) max(0, 1 - inhibition S A / L),                      RELEL(x) = M exp(-(x - mu)^2 / (2 sigma^2))
    share = (1 + sensitivity n . g) / S

where n is the outward normal of the side at the tip, g the direction of gravity (of its opposite, for shoots). The last
segment is the cap, which senses and does not grow.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from forestgen.core.errors import RecipeError

Floats = NDArray[np.float64]

MOST_STEPS = 500_000
MOST_SIDES = 4_000_000  # sides of all segments together
MOST_WORK = 1e9  # sides times time steps; ten seconds


@dataclass(frozen=True)
class Zone:
    """Where one side grows: a RELEL of its distance x from the tip."""

    peak_per_h: float = 0.4  # M; RELEL is the relative elemental rate of elongation
    centre_mm: float = 3.0  # mu
    width_mm: float = 1.0  # sigma, where RELEL = 0.607 M

    @property
    def elongation_mm_per_h(self) -> float:
        """alpha M: the integral of RELEL over a flank that is longer than the zone, from the tip on."""
        before_tip = 0.5 * (1.0 + math.erf(-self.centre_mm / (math.sqrt(2.0) * self.width_mm)))
        return self.peak_per_h * self.width_mm * math.sqrt(2.0 * math.pi) * (1.0 - before_tip)


@dataclass(frozen=True)
class AuxinModel:
    """Parameters of the simulation."""

    zones: tuple[Zone, ...] = (Zone(),)  # one for all sides, or one for each
    sectors: int = 2
    diameter_mm: float = 1.0
    supply_per_h: float = 10.0  # auxin units through the centre to the tip
    transport_mm_per_h: float = 10.0  # v
    decay_per_h: float = 0.0
    inhibition_mm: float = 0.5  # loss of growth, as a share, for a unit of auxin a millimetre of root
    sensitivity: float = 0.8  # of a horizontal tip: excess of auxin on the lower side, as a share
    tilt_deg: float = 90.0  # of the young root from its target
    azimuth_deg: float = 0.0  # of the tilt's plane
    is_shoot: bool = False  # target: up, not down
    young_mm: float = 8.0  # length at the start
    on_flank: bool = False  # x along the side itself, as Barlow's flanks have it; else along the centre line
    segment_mm: float = 0.25  # longer ones are split
    step_h: float = 0.02

    @property
    def target(self) -> Floats:
        """(3,) unit direction that the tip grows towards."""
        return np.array([0.0, 0.0, 1.0 if self.is_shoot else -1.0])

    @property
    def azimuth_rad(self) -> Floats:
        """(S,) of the sides about the tangent; 0 is the side that faces the target when the root is tilted."""
        return np.arange(self.sectors, dtype=np.float64) * (2.0 * np.pi / self.sectors)

    def first_frame(self) -> Floats:
        """(3, 3) rows: outward normal at azimuth 0, at azimuth 90 degrees, tangent, at the root's base."""
        tilt, around = np.radians(self.tilt_deg), np.radians(self.azimuth_deg)
        out = np.array([np.cos(around), np.sin(around), 0.0])
        tangent = np.cos(tilt) * self.target + np.sin(tilt) * out
        facing = np.sin(tilt) * self.target - np.cos(tilt) * out
        return np.stack([facing, np.cross(tangent, facing), tangent])


@dataclass(frozen=True)
class Root:
    """What grew."""

    model: AuxinModel = field(repr=False)
    side_mm: Floats  # (N, S) lengths of the segments' sides, base to tip
    auxin: Floats  # (N, S) amounts
    tip: Floats  # (T + 1, 3) unit, the tip's direction at every time step
    supplied: float  # auxin, all until now
    out: float  # through the base
    decayed: float

    @property
    def length_mm(self) -> float:
        """Length along the centre line."""
        return float(self.side_mm.mean(axis=1).sum())

    def points_mm(self) -> Floats:
        """(N + 1, 3) centres of the segments' faces, base in the origin, z up."""
        from forestgen.plants.auxin import kernel

        angle, points = self.model.azimuth_rad, np.zeros((len(self.side_mm) + 1, 3))
        frame = self.model.first_frame()
        kernel.assemble(self.side_mm, np.cos(angle), np.sin(angle), self.model.diameter_mm, frame, points)
        return points


def simulate(model: AuxinModel, *, length_mm: float | None = None, duration_h: float | None = None) -> Root:
    """Grow a root to a length or for a time, whichever is first.

    Raises
    ------
    RecipeError : too many segments or time steps, or a root that stops growing before it is long enough.
    """
    from forestgen.plants.auxin import kernel

    steps = MOST_STEPS if duration_h is None else round(duration_h / model.step_h)
    zones = model.zones if len(model.zones) == model.sectors else model.zones * model.sectors
    fastest = sum(zone.elongation_mm_per_h for zone in zones) / len(zones)
    if length_mm is not None:
        steps = min(steps, MOST_STEPS)
    elif steps > MOST_STEPS:
        raise RecipeError("too many time steps", where="plant", expected=f"at most {MOST_STEPS:,}", got=f"{steps:,}")
    young = max(2, int(np.ceil(model.young_mm / (0.75 * model.segment_mm))))
    longest = model.young_mm + fastest * steps * model.step_h if length_mm is None else max(length_mm, model.young_mm)
    room = young + int(min(4.0 * longest / model.segment_mm, 1e12)) + 16
    if room * model.sectors > MOST_SIDES:
        raise RecipeError(
            "the root would have too many segments",
            where="plant",
            expected=f"at most {MOST_SIDES:,} sides of segments",
            got=f"{room * model.sectors:,}",
            hint="a longer segment_mm, or a shorter root",
        )
    side, auxin = np.zeros((room, model.sectors)), np.zeros((room, model.sectors))
    side[:young] = model.young_mm / young
    angle = model.azimuth_rad
    number = np.array([
        model.supply_per_h, model.transport_mm_per_h, model.decay_per_h, model.inhibition_mm, model.sensitivity,
        model.diameter_mm, model.segment_mm, model.step_h, np.inf if length_mm is None else length_mm,
        float(model.on_flank), MOST_WORK,
    ])  # fmt: skip
    tip, ledger = np.zeros((steps + 1, 3)), np.zeros(3)
    columns = np.array([(zone.peak_per_h, zone.centre_mm, zone.width_mm) for zone in zones]).T.copy()
    done, n = kernel.grow(
        side, auxin, young, model.first_frame(), model.target, np.cos(angle), np.sin(angle), number, *columns, tip,
        ledger,
    )  # fmt: skip
    unfinished = length_mm is not None and duration_h is None and done == steps
    if n < 0 or unfinished:
        raise RecipeError(
            "the root does not grow to its length",
            where="plant",
            expected=f"{longest:g} mm within {MOST_STEPS:,} time steps, and {MOST_WORK:g} steps of sides",
            got="more segments than its length has" if n == -1 else f"less after {done:,} time steps",
            hint="less inhibition or supply, a longer step_h or segment_mm",
        )
    return Root(model, side[:n].copy(), auxin[:n].copy(), tip[: done + 1].copy(), *ledger)
