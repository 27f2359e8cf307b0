"""Bent axes: a root or a shoot that auxin bends towards, or away from, gravity as it grows.

Reference
---------
Streit, L., Federl, P., Sousa, M. C. (2005). Modelling plant variation through growth. Computer Graphics Forum 24 (3),
497-506. Section 3, Figs. 3 and 4; after Barlow, P. W., Brain, P., Adam, J. S. (1989). Differential growth and plant
tropisms. Environmental and Experimental Botany 29, 71-83.

Equations
---------
The root is a row of segments. Each has S sides: two, the upper and the lower, for the model in a plane; more for the
model in space. A side has a length L and an amount of auxin A. In every time step, ::

    1. A' = v/L A (of the next segment towards the tip) - v/L A - decay A
       at the tip: supply / S (1 + sensitivity n . g);      n: the side's outward normal, g: the target's direction
    2. L' = L M exp(-(x - mu)^2 / (2 sigma^2)) max(0, 1 - inhibition S A / L);             x: distance from the tip
       a segment longer than `segment_mm` is halved
    3. theta = (L_u - L_l) / d: the turn of a segment (Eq. 1 of the paper); the root is put together from its base

More auxin on the side that faces the target means less growth there: the tip bends towards it until all sides get the
same. From the tip to the growth zone auxin needs mu / v hours. With that delay the bend overshoots.

Parameters: see below.

Recipe
------
::

    plant:
      generator: auxin_root
      gravitropism: negative          # a sapling that was laid down and rose
      transport_mm_per_h: 4
      supply_per_h: 4
      tilt_deg: 70
      taper: [[0, 1], [1, 0.3]]
      wood: {material: bark}
      shapes: {leaf: {form: simple, material: leaf, length_m: 0.08, width_m: 0.02}}
      foliage: [{shape: leaf, orders: [0], spacing_m: 0.03, zone: [0.4, 1]}]

Decisions
---------
- Numbers are those of a maize root, millimetres and hours. The fit scales the finished axis to the plant's height.
- x is measured along the centre line: measured along each side, the sides of a segment would leave the growth zone at
  different times and a bent zone would straighten. Barlow's RELELs belong to points of a flank and are measured along
  it; so Eq. 1 holds exactly (`AuxinModel.on_flank`).
- g . n is the sine of the tip's angle from the target. A tip that points exactly away from it does not bend.
- Shoots bend by the same inhibition with the target above; in nature auxin promotes their lower side's growth.
- The last segment is the cap: it senses, and does not grow.
- Transport is solved upwind and implicitly: stable for every time step, and auxin is conserved.
- A root hangs from its base, its lowest point on the ground.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import numpy as np
from pydantic import Field

from forestgen.core.compiled import assign, compiled
from forestgen.core.errors import RecipeError
from forestgen.geometry.mesh import Floats
from forestgen.plants.parameters import PlantParameters
from forestgen.plants.skeleton import Skeleton
from forestgen.recipe.curves import FallingCurve, evaluate

_THREAD = 1e-6  # radius, as a share of the plant's height, of what a root hangs from
_SUPPLIED, _OUT, _DECAYED = range(3)  # sums of auxin, in their order
_REACH = 6.0  # widths of the growth zone beyond which nothing grows
MOST_STEPS = 500_000
MOST_SIDES = 4_000_000  # sides of all segments together
MOST_WORK = 1e9  # sides times time steps; ten seconds


@dataclass(frozen=True)
class Zone:
    """Where one side grows: a RELEL of its distance x from the tip."""

    peak_per_h: float = 0.4  # M; RELEL is the relative elemental rate of elongation
    centre_mm: float = 3.0  # mu
    width_mm: float = 1.0  # sigma, where RELEL = 0.607 M


class AuxinModel(NamedTuple):
    """Parameters of the simulation, as compiled loops read them too; those of `Parameters` of these names.

    A segment's surface has sides at even azimuths; two sides are the plane model.
    """

    sectors: int = 2
    diameter_mm: float = 1.0
    supply_per_h: float = 10.0  # auxin units through the centre to the tip
    transport_mm_per_h: float = 10.0
    decay_per_h: float = 0.0
    inhibition_mm: float = 0.5
    sensitivity: float = 0.8
    tilt_deg: float = 90.0  # of the young root from its target
    azimuth_deg: float = 0.0  # of the tilt's plane
    is_shoot: bool = False  # target: up, not down
    young_mm: float = 8.0
    on_flank: bool = False  # x along the side itself, as Barlow's flanks have it; else along the centre line
    segment_mm: float = 0.25
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

    def points_mm(self) -> Floats:
        """(N + 1, 3) centres of the segments' faces, base in the origin, z up."""
        angle, points = self.model.azimuth_rad, np.zeros((len(self.side_mm) + 1, 3))
        frame = self.model.first_frame()
        _assemble(self.side_mm, np.cos(angle), np.sin(angle), self.model.diameter_mm, frame, points)
        return points


def simulate(
    model: AuxinModel, length_mm: float, zones: tuple[Zone, ...] = (Zone(),), duration_h: float | None = None
) -> Root:
    """Grow a root to a length or for a time, whichever is first. `zones`: one for all sides, or one for each.

    Raises `RecipeError`: too many segments or time steps, or a root that stops growing before it is long enough.
    """
    steps = MOST_STEPS if duration_h is None else min(round(duration_h / model.step_h), MOST_STEPS)
    zones = zones if len(zones) == model.sectors else zones * model.sectors
    young, longest = max(2, int(np.ceil(model.young_mm / (0.75 * model.segment_mm)))), max(length_mm, model.young_mm)
    room = young + int(min(4.0 * longest / model.segment_mm, 1e12)) + 16
    if room * model.sectors > MOST_SIDES:
        expected, got = f"at most {MOST_SIDES:,} sides of segments", f"{room * model.sectors:,}"
        hint = "a longer segment_mm, or a shorter root"
        raise RecipeError("the root would have too many segments", where="plant", expected=expected, got=got, hint=hint)
    side, auxin = np.zeros((room, model.sectors)), np.zeros((room, model.sectors))
    side[:young] = model.young_mm / young
    angle = model.azimuth_rad
    tip, sums = np.zeros((steps + 1, 3)), np.zeros(3)
    numbers = np.array([(zone.peak_per_h, zone.centre_mm, zone.width_mm) for zone in zones])
    done, n = _grow(
        side, auxin, young, model, numbers, length_mm, MOST_WORK, model.first_frame(), model.target, np.cos(angle),
        np.sin(angle), tip, sums,
    )  # fmt: skip
    if n < 0 or (duration_h is None and done == steps):
        expected = f"{longest:g} mm within {MOST_STEPS:,} time steps, and {MOST_WORK:g} steps of sides"
        got = "more segments than its length has" if n == -1 else f"less after {done:,} time steps"
        hint = "less inhibition or supply, a longer step_h or segment_mm"
        raise RecipeError("the root does not grow to its length", where="plant", expected=expected, got=got, hint=hint)
    return Root(model, side[:n].copy(), auxin[:n].copy(), tip[: done + 1].copy(), *sums)


@compiled
def _bend(side: Floats, cosine: Floats, sine: Floats, diameter: float) -> Any:
    """Angle by which a segment turns away from azimuth 0 and away from azimuth 90 degrees, radians.

    The plane that fits the ends of the sides best; of two sides, Eq. 1 of Streit et al.
    """
    x = y = norm = 0.0
    for k in range(len(side)):
        x += side[k] * cosine[k]
        y += side[k] * sine[k]
        norm += cosine[k] * cosine[k]
    scale = 2.0 / (diameter * norm)
    return x * scale, y * scale


@compiled
def _turn(frame: Floats, x: float, y: float) -> None:
    """Turn the frame (rows: azimuth 0, azimuth 90, tangent) away from azimuth 0 by x and from azimuth 90 by y."""
    angle = math.sqrt(x * x + y * y)
    if angle < 1e-15:
        return
    cosine, sine = math.cos(angle), math.sin(angle)
    x /= angle
    y /= angle
    for c in range(3):
        out = x * frame[0, c] + y * frame[1, c]
        forth = frame[2, c]
        new = cosine * out + sine * forth - out
        frame[0, c] += x * new
        frame[1, c] += y * new
        frame[2, c] = cosine * forth - sine * out


@compiled
def _assemble(side: Floats, cosine: Floats, sine: Floats, diameter: float, frame: Floats, point: Floats) -> None:
    """Centres of the segments' faces, base to tip; each segment is an arc. `frame` becomes the tip's."""
    for i in range(len(side)):
        x, y = _bend(side[i], cosine, sine, diameter)
        half = 0.5 * math.sqrt(x * x + y * y)
        chord = np.mean(side[i]) * (math.sin(half) / half if half > 1e-8 else 1.0)
        _turn(frame, 0.5 * x, 0.5 * y)
        for c in range(3):
            point[i + 1, c] = point[i, c] + chord * frame[2, c]
        _turn(frame, 0.5 * x, 0.5 * y)


@compiled
def _along(side: Floats, cosine: Floats, sine: Floats, diameter: float, frame: Floats, length_mm: float) -> float:
    """Turn the frame as the segments do; returns the length, theirs added."""
    for i in range(len(side)):
        x, y = _bend(side[i], cosine, sine, diameter)
        _turn(frame, x, y)
        length_mm += np.mean(side[i])
    return length_mm


@compiled
def _transport(side: Floats, auxin: Floats, model: AuxinModel, share: Floats, sums: Floats) -> None:
    """One step of polar transport from the tip back, upwind and implicit: stable and exactly conserving."""
    step, speed, decay = model.step_h, model.transport_mm_per_h, model.decay_per_h
    sums[_SUPPLIED] += step * model.supply_per_h
    for k in range(side.shape[1]):
        flow = model.supply_per_h * share[k]
        for i in range(len(side) - 1, -1, -1):
            rate = speed / side[i, k]
            auxin[i, k] = (auxin[i, k] + step * flow) / (1.0 + step * (rate + decay))
            flow = rate * auxin[i, k]
            sums[_DECAYED] += step * decay * auxin[i, k]
        sums[_OUT] += step * flow


@compiled
def _elongate(side: Floats, auxin: Floats, model: AuxinModel, zones: Floats, first: int) -> Any:
    """One step of growth of all sides from segment `first` on, the tip's segment excepted.

    Returns the first segment that may still grow; those before it lie behind the growth zone for good.
    """
    n, sectors = side.shape
    step, inhibition, on_flank = model.step_h, model.inhibition_mm, model.on_flank
    growing = n - 1
    centre_line = np.empty(n - first)
    for i in range(first, n):
        centre_line[i - first] = np.mean(side[i])
    for k in range(sectors):
        peak, centre, width = zones[k, 0], zones[k, 1], zones[k, 2]
        away = side[n - 1, k] if on_flank else centre_line[n - 1 - first]
        root2 = math.sqrt(2.0) * width
        whole = peak * width * math.sqrt(0.5 * math.pi)
        before = math.erf((away - centre) / root2)
        for i in range(n - 2, first - 1, -1):
            if away > centre + _REACH * width:
                break
            growing = min(growing, i)
            length = side[i, k]
            passed = length if on_flank else centre_line[i - first]
            away += passed
            after = math.erf((away - centre) / root2)
            held = max(0.0, 1.0 - inhibition * sectors * auxin[i, k] / length)
            side[i, k] = length * math.exp(step * held * whole * (after - before) / passed)
            before = after
    return growing


@compiled
def _split(side: Floats, auxin: Floats, n: int, first: int, segment: float) -> Any:
    """Halve every segment from `first` on, but the tip's, that is longer than `segment`; the new number of segments."""
    i = first
    while i < n - 1:
        if np.mean(side[i]) > segment:
            if n == len(side):
                return -1
            for j in range(n, i + 1, -1):
                assign(side[j], side[j - 1])
                assign(auxin[j], auxin[j - 1])
            side[i] *= 0.5
            auxin[i] *= 0.5
            assign(side[i + 1], side[i])
            assign(auxin[i + 1], auxin[i])
            n += 1
            i += 1
        i += 1
    return n


@compiled
def _grow(  # type: ignore[no-untyped-def]
    side, auxin, n, model, zones, until_mm, most_work, frame, target, cosine, sine, tip, sums
):
    """Time steps until the root is as long as it should be, or the steps are used up.

    `zones` (S, 3) of each side: M, mu, sigma. Returns steps done, number of segments (-1: there is no room for more,
    -2: it takes too long).
    """
    sectors, diameter, work = side.shape[1], model.diameter_mm, 0.0
    share, first, frozen_mm, end = np.empty(sectors), 0, 0.0, np.empty((3, 3))
    for step in range(len(tip) - 1):
        assign(end.ravel(), frame.ravel())
        length = _along(side[first:n], cosine, sine, diameter, end, frozen_mm)
        assign(tip[step], end[2])
        if length >= until_mm:
            return step, n
        work += n * sectors
        if work > most_work:
            return step, -2
        for k in range(sectors):
            towards = 0.0
            for c in range(3):
                towards += (cosine[k] * end[0, c] + sine[k] * end[1, c]) * target[c]
            share[k] = (1.0 + model.sensitivity * towards) / sectors
        _transport(side[:n], auxin[:n], model, share, sums)
        growing = _elongate(side[:n], auxin[:n], model, zones, first)
        frozen_mm = _along(side[first:growing], cosine, sine, diameter, frame, frozen_mm)
        first = growing
        n = _split(side, auxin, n, first, model.segment_mm)
        if n < 0:
            return step, n
    assign(end.ravel(), frame.ravel())
    _along(side[first:n], cosine, sine, diameter, end, frozen_mm)
    assign(tip[len(tip) - 1], end[2])
    return len(tip) - 1, n


class Parameters(PlantParameters):
    """The `plant:` block of a species' file."""

    generator: Literal["auxin_root"] = "auxin_root"
    gravitropism: Literal["positive", "negative"] = Field(
        "positive", description="positive: a root that bends to the ground; negative: a shoot that rises"
    )
    sectors: int = Field(8, ge=2, le=64, description="S: sides of a segment; 2: the model in a plane")
    length_mm: float = Field(60.0, gt=0, le=500, description="length to which it grows, millimetres")
    young_mm: float = Field(8.0, gt=0, le=10_000, description="straight length at the start, millimetres")
    tilt_deg: float = Field(90.0, ge=0, le=180, description="theta(0): the young axis' angle from its target, degrees")
    tilt_jitter_deg: float = Field(0.0, ge=0, le=90, description="standard deviation of that angle, degrees")
    tilt_azimuth_deg: float | None = Field(
        None, ge=-360, le=360, description="side of the tilt, clockwise from +y as of a compass; null: drawn by plant"
    )
    zone_centre_mm: float = Field(3.0, ge=0, le=1000, description="mu: growth zone's centre from the tip, millimetres")
    zone_width_mm: float = Field(1.0, gt=0, le=1000, description="sigma: from there to 0.607 of the most, millimetres")
    rate_per_h: float = Field(0.4, gt=0, le=10, description="M: relative rate of elongation at the centre, per hour")
    transport_mm_per_h: float = Field(10.0, gt=0, le=1000, description="v: speed of polar transport, mm per hour")
    supply_per_h: float = Field(10.0, ge=0, le=1e6, description="auxin that reaches the tip, units per hour")
    decay_per_h: float = Field(0.0, ge=0, le=100, description="share of auxin lost in an hour")
    inhibition_mm: float = Field(0.5, ge=0, le=1e6, description="share of growth lost by a unit of auxin a millimetre")
    sensitivity: float = Field(0.8, ge=0, le=1, description="excess of auxin on a horizontal tip's lower side, a share")
    diameter_mm: float = Field(1.0, gt=0, le=1000, description="d: thickness, millimetres")
    taper: FallingCurve = Field(((0.0, 1.0),), description="share of the thickness over the axis, 0 base, 1 tip")
    segment_mm: float = Field(0.25, gt=0, le=1000, description="longest segment, millimetres")
    step_h: float = Field(0.02, gt=0, le=0.2, description="Delta t: time step, hours")

    def model(self, tilt_deg: float, azimuth_deg: float) -> AuxinModel:
        """The simulation's parameters for an axis that starts in this direction."""
        shared = {name: getattr(self, name) for name in AuxinModel._fields if name in type(self).model_fields}
        is_shoot = self.gravitropism == "negative"
        return AuxinModel(**(shared | {"tilt_deg": tilt_deg, "azimuth_deg": azimuth_deg, "is_shoot": is_shoot}))


_Parameters = Parameters  # the generator's attribute hides the name


class AuxinRootGenerator:
    """Grows one axis, which auxin bends."""

    Parameters = Parameters  # the class that a recipe's `plant` block is checked against
    has_crown = False

    def grow(self, parameters: _Parameters, height_m: float, width_m: float, rng: np.random.Generator) -> Skeleton:
        """One axis, of the trunk's order; a root's of order 1, on a thread that cannot be seen."""
        del width_m  # follows from the height
        tilt_deg = parameters.tilt_deg + parameters.tilt_jitter_deg * rng.normal()
        drawn = float(rng.uniform(0.0, 360.0))
        compass_deg = drawn if parameters.tilt_azimuth_deg is None else parameters.tilt_azimuth_deg
        model = parameters.model(abs(tilt_deg), 90.0 - compass_deg)
        zone = Zone(parameters.rate_per_h, parameters.zone_centre_mm, parameters.zone_width_mm)
        root = simulate(model, parameters.length_mm, (zone,))
        points = root.points_mm()
        if not model.is_shoot:
            points[:, 2] -= points[:, 2].min()
        size = height_m / max(float(points[:, 2].max()), 1e-3 * parameters.length_mm)
        radius = 0.5 * parameters.diameter_mm * evaluate(parameters.taper, np.linspace(0.0, 1.0, len(points)))
        points, radius = points * size, radius * size
        if not model.is_shoot:  # hangs on a thread that cannot be seen
            x, y, z = points[0]
            points = np.concatenate([[[x, y, min(0.0, z - 1e-3 * height_m)]], points])
            radius = np.concatenate([np.full(2, _THREAD * height_m), radius[1:]])
        count = len(points)
        order = np.zeros(count) if model.is_shoot else np.arange(count) > 1
        return Skeleton.of(np.arange(-1, count - 1), points, radius, order, order)


GENERATOR = AuxinRootGenerator()
