"""Dead wood: standing trunks without leaves, stumps and logs.

Reference
---------
None of the source documents models dead wood. The forms follow common forest-inventory classes (a snag is a dead
standing tree, a stump its sawn or broken foot, a log a lying stem); decay is in the branches that are left and in the
bark, which the species' material gives.

Equations
---------
::

    snag   radius(s) = R (1 - (1 - t) s)                     s in [0, 1] from the foot to the break, t the top's share
    stump  the same, and roots that leave the collar at even turns and dive under the ground
    log    the same lying down, its height H above the ground; its length is 2 W - D, as W is the mean extent in x and y
    stubs  a Poisson number per metre of stem, length exponential, cut at `longest_stub_m`

Parameters: see below.

Recipe
------
::

    plant:
      generator: deadwood
      form: stump
      diameter_ratio: 1.1
      ending: sawn
      cut_shape: cut
      roots: 5
      wood: {material: bark, flare: 0.3}
      shapes: {cut: {form: disc, material: end_grain, diameter_m: 1}}

Decisions
---------
- A splinter is a thin spike of wood on the rim of the break, an axis of order 1.
- The fit to size is "none" for logs and stumps, whose form already has it, and for snags, whose splinters end at H.
"""

from __future__ import annotations

from typing import Literal, Self

import numpy as np
from pydantic import Field, model_validator

from forestgen.geometry.mesh import Floats, any_perpendicular, unit
from forestgen.plants.branching import around
from forestgen.plants.parameters import Fit, PlantParameters
from forestgen.plants.skeleton import OrganPlacements, Skeleton
from forestgen.plants.splinters import splinters
from forestgen.recipe.curves import PositiveCurve, evaluate_one

_STEP_M = 0.12  # between nodes of a stem
_MOST_STEPS = 400
_MOST_SPLINTERS = 22
_MOST_STUBS = 400


class Parameters(PlantParameters):
    """The `plant:` block of a species' file."""

    generator: Literal["deadwood"] = "deadwood"
    form: Literal["snag", "stump", "log"] = Field(description="standing trunk, its foot, or a lying stem")
    diameter_ratio: PositiveCurve = Field(
        ((0.0, 0.05),), description="foot diameter over height, by the height in metres; a log's diameter is its height"
    )
    top_share: float = Field(0.6, gt=0, le=1, description="diameter at the upper end over that at the foot")
    ending: Literal["broken", "sawn"] = Field("broken", description="how the upper end looks; a log's both ends")
    cut_shape: str | None = Field(None, description="organ shape of a sawn face; scaled by the face's diameter")
    stubs_per_m: float = Field(1.5, ge=0, le=20, description="broken branches per metre of stem")
    stub_length_m: float = Field(0.25, gt=0, le=5, description="their mean length, metres")
    longest_stub_m: float = Field(1.2, gt=0, le=10, description="their greatest length, metres")
    roots: int = Field(0, ge=0, le=16, description="main roots of a stump")
    bow_deg_per_m: float = Field(1.5, ge=0, le=45, description="random bend of the stem, degrees per metre")
    lean_deg: float = Field(2.0, ge=0, le=45, description="standard deviation of the lean, degrees")
    sunk: float = Field(0.12, ge=0, lt=1, description="share of a log's diameter that lies in the ground")
    fit: Fit = Field("none", description="as for every generator; dead wood is grown to its size")

    @model_validator(mode="after")
    def _cut_is_a_shape(self) -> Self:
        if self.cut_shape is not None and self.cut_shape not in self.shapes:
            raise ValueError(f"cut_shape names the shape {self.cut_shape!r}; there are: {', '.join(self.shapes)}")
        return self


_Parameters = Parameters  # the generator's attribute hides the name


class _Axes:
    """Nodes of a skeleton, collected axis by axis; node 0 is the root."""

    def __init__(self, root: Floats, radius_m: float) -> None:
        self.parent, self.position, self.radius = [-1], [root], [radius_m]
        self.order, self.axis = [0], [0]

    def add(self, points: Floats, radius_m: Floats, order: int, bearer: int) -> None:
        """A chain of (K, 3) points that hangs on node `bearer`; on the root, order 0 goes on along its axis."""
        start, number = len(self.parent), self.axis[-1] + (order > 0)
        self.parent += [bearer, *range(start, start + len(points) - 1)]
        self.position += list(points)
        self.radius += list(radius_m)
        self.order += [order] * len(points)
        self.axis += [number] * len(points)

    def skeleton(self, organs: tuple[OrganPlacements, ...]) -> Skeleton:
        position, radius = np.array(self.position), np.array(self.radius)
        return Skeleton.of(self.parent, position, radius, np.array(self.order), np.array(self.axis), organs=organs)


class DeadwoodGenerator:
    """Makes snags, stumps and logs."""

    Parameters = Parameters  # the class that a recipe's `plant` block is checked against
    has_crown = False
    instead = "community.standing_dead_yr keeps dead trees standing; community.disturbances kill some"

    def grow(self, parameters: _Parameters, height_m: float, width_m: float, rng: np.random.Generator) -> Skeleton:
        """One piece of dead wood."""
        stem_rng, end_rng, stub_rng, root_rng = rng.spawn(4)
        lying = parameters.form == "log"
        broken = parameters.ending == "broken"
        ratio = 1.0 / (1.0 - parameters.sunk) if lying else evaluate_one(parameters.diameter_ratio, height_m)
        diameter = ratio * height_m
        tip_m = 0.0 if lying or not broken else min(0.12 * height_m, 1.2 * diameter)  # of the longest splinter
        length = max(2.0 * width_m - diameter, diameter) if lying else height_m - tip_m
        points, radius = _stem(parameters, length, 0.5 * diameter, stem_rng)
        if not lying:
            points *= (height_m - tip_m) / points[-1, 2]
        else:
            slope = np.interp(points[:, 0], points[[0, -1], 0], points[[0, -1], 2])
            points[:, 2] += diameter * (0.5 - parameters.sunk) - slope
        axes = _Axes(points[0], radius[0])
        axes.add(points[1:], radius[1:], 0, 0)
        if broken:
            for end in (0, -1) if lying else (-1,):
                _splinters(axes, points, radius, end, tip_m if not lying else 0.5 * diameter, end_rng)
        _stubs(axes, parameters, points, radius, stub_rng)
        if parameters.roots and not lying:
            _roots(axes, parameters.roots, radius[0], root_rng)
        return axes.skeleton(_cuts(parameters, points, radius, lying))


def _stem(parameters: Parameters, length_m: float, radius_m: float, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """(K, 3) points of the stem from the origin, and their radii: upright, or along x."""
    count = int(np.clip(np.ceil(length_m / _STEP_M), 4, _MOST_STEPS)) + 1
    step = length_m / (count - 1)
    lying = parameters.form == "log"
    lean = 0.0 if lying else np.radians(parameters.lean_deg) * abs(rng.normal())
    azimuth = rng.uniform(0.0, 2.0 * np.pi)
    upright = np.array([np.sin(lean) * np.cos(azimuth), np.sin(lean) * np.sin(azimuth), np.cos(lean)])
    direction = np.array([1.0, 0.0, 0.0]) if lying else upright
    side = np.cumsum(rng.normal(size=(count, 3)), axis=0) * np.radians(parameters.bow_deg_per_m) * np.sqrt(step)
    heading = unit(direction + side - side[0])
    points = np.concatenate([np.zeros((1, 3)), np.cumsum(heading[1:] * step, axis=0)])
    if lying:
        points[:, 0] -= 0.5 * points[-1, 0]
    share = np.linspace(0.0, 1.0, count)
    return points, radius_m * (1.0 - (1.0 - parameters.top_share) * share)


def _splinters(axes: _Axes, points: Floats, radius: Floats, end: int, tip_m: float, rng: np.random.Generator) -> None:
    """Spikes on the rim of a break."""
    along = unit(points[end] - points[1 if end == 0 else -2])
    bearer = 0 if end == 0 else len(points) - 1
    for line, thick in splinters(points[end], along, float(radius[end]), tip_m, _MOST_SPLINTERS, rng):
        axes.add(line, thick, 1, bearer)


def _stubs(axes: _Axes, parameters: Parameters, points: Floats, radius: Floats, rng: np.random.Generator) -> None:
    """What broken branches left: most near the top of a snag, none on its lowest fifth; round a log."""
    length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    count = min(int(rng.poisson(parameters.stubs_per_m * length)), _MOST_STUBS)
    low = 0.02 if parameters.form == "log" else 0.2
    for place in np.sort(rng.uniform(low, 0.97, count)):
        node = 1 + int(place * (len(points) - 2))
        along = unit(points[node] - points[node - 1])
        out = around(along[None], rng.uniform(0.0, 2.0 * np.pi, 1), np.radians(rng.normal(72.0, 12.0, 1)))[0]
        if parameters.form == "log" and not -0.2 < out[2] < 0.3:
            continue  # pressed into the ground, or above the height that the log has
        reach = min(0.05 + rng.exponential(parameters.stub_length_m), parameters.longest_stub_m) + radius[node]
        thick = min(radius[node] * rng.uniform(0.08, 0.22), 0.2 * reach)
        droop = np.array([0.0, 0.0, -0.12 * reach * rng.uniform(0.0, 1.0)])
        share = np.linspace(0.25, 1.0, 4)[:, None]
        line = points[node] + reach * share * out + droop * share**2
        axes.add(line, thick * np.array([1.0, 0.85, 0.7, 0.45]), 1, node)


def _roots(axes: _Axes, count: int, radius_m: float, rng: np.random.Generator) -> None:
    """Main roots that leave the collar and dive into the ground."""
    start = rng.uniform(0.0, 2.0 * np.pi)
    for k in range(count):
        turn = start + 2.0 * np.pi * (k + 0.25 * rng.normal()) / count
        outward = np.array([np.cos(turn), np.sin(turn), 0.0])
        reach = radius_m * rng.uniform(2.0, 3.2)
        thick = radius_m * rng.uniform(0.28, 0.42)
        share = np.array([0.3, 0.55, 0.8, 1.0])
        height = thick * np.array([0.9, 0.35, -0.5, -1.4])
        line = share[:, None] * reach * outward + height[:, None] * np.array([0.0, 0.0, 1.0])
        axes.add(line, thick * np.array([1.2, 0.85, 0.6, 0.4]), 1, 0)


def _cuts(parameters: Parameters, points: Floats, radius: Floats, lying: bool) -> tuple[OrganPlacements, ...]:
    """Faces of a sawn end: the shape's z looks out of the wood."""
    if parameters.cut_shape is None or parameters.ending != "sawn":
        return ()
    frames, nodes = [], []
    for end, inner in ((-1, -2), (0, 1)) if lying else ((-1, -2),):
        out = unit(points[end] - points[inner])
        side = any_perpendicular(out[None])[0]
        linear = np.stack([side, np.cross(out, side), out], axis=1) * 2.0 * radius[end]
        frames.append(np.concatenate([linear, (points[end] + 0.002 * out)[:, None]], axis=1))
        nodes.append(len(points) - 1 if end == -1 else 0)
    return (OrganPlacements(parameters.cut_shape, np.array(frames, dtype=np.float32), np.array(nodes, dtype=np.int32)),)


GENERATOR = DeadwoodGenerator()
