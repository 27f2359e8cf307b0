"""Variation by growth responses: any skeleton, grown again with errors of direction and their correction.

Reference
---------
Streit, L., Federl, P., Sousa, M. C. (2005). Modelling plant variation through growth. Computer Graphics Forum 24(3),
497-506, section 4 and appendix A.

Equations
---------
::

    H_sense(n) = H_curr(n), off by a radial Gaussian error v             # the sensor
    theta(n) = acos(H_sense . H_tar)                                     # about the axis H_sense x H_tar
    u(n) = kappa theta(n) [+ kappa_d (theta(n) - theta(n-1)) + kappa_i sum theta]   # D(s), a signal of lifetime lag
    H_curr(n) = w(n) u(n - 1 - lag) H_curr(n-1)                          # G(s): response to the expired, disturbance
    H_tar(n) = T_M b(n), bent by a function, or (1 - weight) T_M b(n) + weight up

b(n) is the base skeleton's own direction at growth step n; T_M is the identity (`reference: global`) or the rotation
of the axis' bearer where it begins (`local`). One displacement alone decays as E(n) = E(n-1) - kappa E(n-1-lag), which
with a lag of l steps is stable for kappa < 2 sin(pi / (2 (2 l + 1))). For long lags that is kappa l < pi/2, a
compensation ratio (kappa l)^-1 above 0.64; above 1.0 for one step, 0.81 for two, 0.75 for three, 0.72 for four, 0.70
for five. So the ratio 0.7 that the paper found by experiment is stable from six steps on.

Parameters: see `Variation`.

Positions run along an axis from 0, its base, to 1, its tip.

Recipe
------
::

    plant:
      variation: {lag: 0.1, compensation_ratio: 1.0, disturbance_deg: 4, sensor_error_deg: 3}  # wilder: more degrees

    variation:                                             # a pot turned over when a fifth has grown (Fig. 9)
      {growth_steps: 100, lag: 0.08, displacements: [{at: 0.2, turn_deg: 90, plane: 90, turns: plant}]}
    variation: {target_pull: {weight: [[0, 0], [1, 0.9]], orders: [1]}, disturbance_deg: 5}                # Fig. 13

Decisions
---------
- The loop works on the rotation between the base's course and the varied one: bends and kinks of the base stay where
  they are, lengths too, and where nothing disturbs an axis the skeleton comes back to the bit. Nodes are inserted where
  a growth step turns, with thickness interpolated. Organs follow their node stiffly.
- An axis begins at its bearer's new place and in its rotated frame; it then keeps its direction in that frame (local),
  or corrects its direction in space as it grows (global).
- Lifetime counts growth steps: the form depends on how much has grown between sensing and response. The growth zone is
  at a fixed distance behind the tip. In a step the tip goes up by one step and the signal down by `transmission` steps,
  and the signal loses `decay`; so it ages by decay (1 + transmission) / 2 steps: for Fig. 7, of equal rates, its
  lifetime is the lag. Where rates vary, signals catch up with one another and several may act in one step. The response
  turns what grows from then on, not what has grown.
- The lag is rounded to whole steps, to one at least if kappa comes from a compensation ratio. The default ratio of
  1.1 is stable for every lag.
- A signal runs down a flank of the stem. So its turn is kept in the frame of the tip, which turns along.
- Only a direction is sensed: errors are at most 180 degrees and wrap beyond. Straight backwards, the shoot turns about
  an arbitrary axis.
- Radial: the angle is Gaussian (uniform), its azimuth uniform. Random disturbances are per growth step, as in the
  paper, and depend on their number; an `Influence` is per length of axis, and does not.
- What lies within the bearer's thickness does not grow: steps and positions begin at its surface.
- Axes thinner than 20 micrometres are joints between parts that do not touch, and stay straight.
- `Displacement.turns: plant` turns a potted plant: what has grown by then lies turned, and grew towards a target
  turned with it. It is meant for plants of one axis: branches begin on what was turned.
- Signals and errors of one axis do not reach another. Light comes from a direction of the plant's own frame.
"""

from __future__ import annotations

from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from forestgen.recipe.curves import Curve, PositiveCurve
from forestgen.recipe.fields import Section

#: Where a positive angle turns to. up: to the sky; side: to the left (an upright axis: to +x and to -y, east and
#: south); random: any side, drawn for each axis; a number: an azimuth in degrees clockwise from +y, as of a compass.
Plane = Literal["up", "side", "random"] | Annotated[float, Field(ge=-360, le=360)]
_Vector = tuple[float, float, float]
_DEFAULT_LAG, _DEFAULT_RATIO = 0.1, 1.1


class Influence(Section):
    """A disturbance that is a function of the position on the axis (Fig. 8, upper curve)."""

    turn_deg: Curve = Field(description="turn over the position, degrees per length of the axis")
    plane: Plane = Field("up", description="up, side, random, or an azimuth in degrees clockwise from +y")
    orders: tuple[int, ...] | None = Field(None, description="orders that feel it; all if not given")


class Displacement(Section):
    """A single turn (Figs. 2, 9 and 10)."""

    at: float = Field(ge=0, lt=1, description="when, as the share of the axis that has grown")
    turn_deg: float = Field(ge=-180, le=180, description="by how much, degrees")
    plane: Plane = Field("up", description="up, side, random, or an azimuth in degrees clockwise from +y")
    turns: Literal["tip", "plant"] = Field("tip", description="the tip, or all that has grown, as of a pot turned over")
    orders: tuple[int, ...] | None = Field((0,), description="orders of the axes that are turned; null: all")


class Bend(Section):
    """A target that leaves the base's course by a function of the position (Fig. 8, lower curve)."""

    turn_deg: Curve = Field(description="angle between target and base over the position, degrees")
    plane: Plane = Field("up", description="up, side, random, or an azimuth in degrees clockwise from +y")
    orders: tuple[int, ...] | None = Field(None, description="orders with this target; all if not given")


class Pull(Section):
    """A target between the base's own direction and one in space (Fig. 13)."""

    weight: Curve = Field(description="weight of the direction in space over the position, 0 to 1")
    toward: Literal["up"] | _Vector = Field("up", description="up, or a vector in the plant's frame, to a light say")
    orders: tuple[int, ...] | None = Field(None, description="orders with this target; all if not given")

    @model_validator(mode="after")
    def _points_somewhere(self) -> Self:
        if not isinstance(self.toward, str) and not 1e-6 < np.linalg.norm(self.toward) < 1e6:
            raise ValueError("toward must be a vector of some length")
        return self

    def direction(self) -> _Vector:
        """Unit vector."""
        if isinstance(self.toward, str):
            return 0.0, 0.0, 1.0
        x, y, z = np.array(self.toward) / np.linalg.norm(self.toward)
        return float(x), float(y), float(z)


class Variation(Section):
    """How a plant grows away from its base model; this module's page has the equations."""

    growth_steps: PositiveCurve = Field(((0.0, 32.0), (3.0, 4.0)), description="growth steps of an axis over its order")
    step_m: float | None = Field(None, gt=0, description="length of a growth step, metres; instead of growth_steps")
    orders: tuple[int, ...] | None = Field(None, description="orders that vary, others are carried along; all if null")
    reference: Literal["global", "local"] = Field(
        "global", description="T_M: whether base directions are relative to gravity or to the bearing axis"
    )
    lag: float | None = Field(None, ge=0, le=1, description="a signal's lifetime, as a share of the growth steps")
    kappa: float | None = Field(None, gt=0, le=100, description="share of the error that one signal corrects")
    compensation_ratio: float | None = Field(None, gt=0, le=1e4, description="1 / (kappa x lag in steps); 0.5 to 1.2")
    derivative_gain: float = Field(0.0, ge=-100, le=100, description="kappa_d: response to the error's change a step")
    integral_gain: float = Field(0.0, ge=-100, le=100, description="kappa_i: response to the sum of errors")
    decay: PositiveCurve = Field(((0.0, 1.0),), description="loss of lifetime a growth step, over the position")
    transmission: PositiveCurve = Field(((0.0, 1.0),), description="speed of signals over that of growth")
    sensor_error_deg: PositiveCurve = Field(((0.0, 0.0),), description="v: error of sensing, degrees, over the order")
    disturbance_deg: PositiveCurve = Field(((0.0, 0.0),), description="w: disturbance of a step, degrees, by the order")
    distribution: Literal["gaussian", "uniform"] = Field(
        "gaussian", description="disturbance_deg is the standard deviation, or the largest angle"
    )
    influences: tuple[Influence, ...] = Field((), description="disturbances that are functions of the position")
    displacements: tuple[Displacement, ...] = Field((), description="single turns")
    target_bend: Bend | None = Field(None, description="H_tar: a target that leaves the base's course")
    target_pull: Pull | None = Field(None, description="H_tar: a target drawn upward, or to a light")

    @model_validator(mode="before")
    @classmethod
    def _two_of_three(cls, data: object) -> object:
        """Of lag, kappa and the compensation ratio two set the third."""
        if not isinstance(data, dict):
            return data
        given = [key for key in ("lag", "kappa", "compensation_ratio") if data.get(key) is not None]
        if len(given) == 3:
            raise ValueError("compensation_ratio is 1 / (kappa lag): give two of lag, kappa, compensation_ratio")
        if len(given) < 2 and "lag" not in given:
            data = {**data, "lag": _DEFAULT_LAG}
        if len(given) < 2 and "kappa" not in given and "compensation_ratio" not in given:
            data = {**data, "compensation_ratio": _DEFAULT_RATIO}
        return data

    @model_validator(mode="after")
    def _makes_sense(self) -> Self:
        if self.lag == 0 and self.kappa is None:
            raise ValueError("without lag there is no compensation ratio: give kappa")
        if self.step_m is not None and "growth_steps" in self.model_fields_set:
            raise ValueError("give growth_steps or step_m, not both")
        if sum(one.turns == "plant" for one in self.displacements) > 1:
            raise ValueError("a plant is turned over once: at most one displacement with turns: plant")
        return self
