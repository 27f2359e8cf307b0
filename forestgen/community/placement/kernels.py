"""Deformation kernels: how a plant changes the probability of finding another one at a distance.

κ(d) multiplies the probability field at a distance d from a plant: 0 bars, 1 leaves as it is, above 1 invites. Beyond
the kernel's reach κ is 1. In a recipe::

    kernels: inhibition                                       # a kernel by its name
    kernels: {curve: [[0, 0], [1, 0], [1.4, 1]]}              # control points, distances in radii of the plant
    kernels: {curve: {formula: "1 + 3 * exp(-x^2)"}, reach: 3}
    kernels: {curve: [[0, 0], [2.5, 1]], distance: metres}

References
----------
Lane 2002, section 5.1, Figures 5.1, 5.2, 5.4 and 5.7.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, model_validator

from forestgen.recipe.curves import Curve, Formula, Smooth, evaluate
from forestgen.recipe.fields import Flag, Positive, Section, mistake

SAMPLES = 1024  # of a kernel's table; κ is linear between them
GREATEST = 1e6  # of κ: beyond, the field would overflow after fifty plants

#: The kernels that a recipe may name; see `KernelSection`. Distances are in radii of the plant.
NAMED: dict[str, dict[str, Any]] = {
    "neutral": {"curve": 1.0, "reach": 1.0},
    "inhibition": {"curve": [[0, 0], [1, 0], [1.2, 1]]},
    "weak_clustering": {"curve": [[0, 0], [0.5, 0], [1, 1.5], [3, 1]]},
    "clustering": {"curve": [[0, 0], [0.3, 0], [0.6, 3], [3, 1]]},
}


class KernelSection(Section):
    """One kernel."""

    curve: Curve = Field(description="κ by distance: a number, points, {smooth: points} or {formula: text}; >= 0.")
    reach: Positive | None = Field(
        None, le=1e4, description="Distance beyond which κ is 1; null: that of the last point. A formula needs one."
    )
    distance: Literal["radii", "metres"] = Field(
        "radii", description="What distances count in: radii of the plant that deforms, or metres."
    )
    balanced: Flag = Field(
        False,
        description="Whether κ is scaled, plant by plant, so that the field's sum within reach stays: probability is "
        "moved about, none is made or taken, and numbers keep to the map on areas larger than the reach.",
    )

    @model_validator(mode="after")
    def _has_a_reach_and_no_negative_value(self) -> Self:
        if self.reach is None and (isinstance(self.curve, Formula) or len(_points(self.curve)) < 2):
            raise mistake("reach, the distance beyond which κ is 1", problem="this kernel does not end", at=("curve",))
        values = table(self).values
        if not np.all((values >= 0) & (values <= GREATEST)):
            bad = float(values[np.argmin(values)] if values.min() < 0 else values.max())
            raise mistake(
                f"values from 0 to {GREATEST:g}",
                problem="a kernel multiplies probabilities, which are never negative"
                if bad < 0
                else "this kernel is too strong",
                got=f"{bad:g}",
                hint="0 bars plants, 1 leaves the field as it is" if bad < 0 else None,
                at=("curve",),
            )
        return self


def _named(value: Any) -> Any:
    if not isinstance(value, str):
        return value
    if value not in NAMED:
        raise mistake(f"one of {', '.join(NAMED)}, or {{curve: ...}}", problem="no such kernel", got=repr(value[:60]))
    return NAMED[value]


#: A kernel in a recipe: its name, or a section.
Kernel = Annotated[KernelSection, BeforeValidator(_named)]


def _points(curve: Any) -> Any:
    return curve.points if isinstance(curve, Smooth) else curve


@dataclass(frozen=True)
class KernelTable:
    """A kernel as every algorithm reads it: κ at evenly spaced distances from 0 to its reach, linear between them."""

    values: NDArray[np.float64]  # (SAMPLES + 1,)
    reach: float  # in radii of the plant, or in metres
    in_radii: bool
    balanced: bool = False

    def reach_m(self, radius_m: NDArray[np.float64] | float) -> NDArray[np.float64]:
        """Distance beyond which a plant of this radius has no effect, metres, of the radius' shape."""
        radius = np.asarray(radius_m, dtype=np.float64)
        return self.reach * radius if self.in_radii else np.full(radius.shape, self.reach)

    def __call__(self, distance_m: NDArray[np.float64], radius_m: float) -> NDArray[np.float64]:
        """κ at distances of any shape from a plant of one radius; plain, for tests and plots."""
        reach_m = float(self.reach_m(radius_m))
        at = np.asarray(distance_m, dtype=np.float64) / reach_m
        inside = np.interp(at, np.linspace(0.0, 1.0, len(self.values)), self.values)
        return np.where(at <= 1.0, inside, 1.0)

    @property
    def is_neutral(self) -> bool:
        return bool(np.all(self.values == 1.0))


def table(kernel: KernelSection) -> KernelTable:
    """The kernel's table."""
    reach = kernel.reach if kernel.reach is not None else float(_points(kernel.curve)[-1][0])
    values = evaluate(kernel.curve, np.linspace(0.0, reach, SAMPLES + 1))
    return KernelTable(values, reach, kernel.distance == "radii", kernel.balanced)


NEUTRAL = KernelTable(np.ones(SAMPLES + 1), 1.0, in_radii=True)
