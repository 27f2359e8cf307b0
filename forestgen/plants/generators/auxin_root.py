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

Parameters: see `Parameters`.

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

from typing import Literal

import numpy as np
from pydantic import Field

from forestgen.plants.auxin import AuxinModel, Zone, simulate
from forestgen.plants.parameters import PlantParameters
from forestgen.plants.skeleton import Skeleton
from forestgen.recipe.curves import FallingCurve, evaluate

_THREAD = 1e-6  # radius, as a share of the plant's height, of what a root hangs from


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
        root = simulate(model, (zone,), length_mm=parameters.length_mm)
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
