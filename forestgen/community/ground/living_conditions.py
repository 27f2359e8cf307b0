"""What a species asks of the ground: the five living conditions of Zamuda et al. 2007, section IV.

Each condition (docs/placement.md; moisture, wind and sun as in `relief`) has a response: a curve
(`forestgen.recipe.curves`) of its value that says which share of the species' density grows there, 1 all of it, 0 none.
The responses are multiplied, so any one can bar the species.

What lies around the site counts: 200 m of it for water, 1000 m for views. The ground is sampled at nodes that depend on
the site alone: 480 across the site with the 200 m around it, or one every 4 m if that is closer. A grid of any number
of cells reads its values between the nodes, so that its own fineness matters little.

References
----------
A. Zamuda, J. Brest, N. Guid and V. Žumer, Construction of virtual trees within ecosystems with EcoMod tool, University
of Maribor 2007, section IV: "height above sea level, slope, moisture, windiness and sunniness"; one can stop a tree.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cached_property
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field

from forestgen.community.ground import relief
from forestgen.community.population import GroundHeight, Site
from forestgen.core.cache import BoundedCache
from forestgen.recipe.curves import Curve, Formula, Function, Smooth, evaluate
from forestgen.recipe.fields import Section, violation

Floats = NDArray[np.float64]
_BLOCK_CELLS = 1 << 20  # of a grid at a time: a suitability takes little more memory than its own
_UNITS = {"elevation_m": " m", "slope_deg": " degrees"}


def ground_raster(site: Site, name: str, shape: tuple[int, int], rows: slice = slice(None)) -> Floats:
    """(rows, cols) of one living condition, or of some rows of the grid alone."""
    if (height := site.height) is not None:
        # The key has the height function's identity, since many cannot be compared; a kept ground keeps its function.
        key = (site.size_m, site.altitude_m, site.latitude_deg, site.wind_from_deg, id(height))
        return _grounds.get(key, lambda: _Ground(site, height)).on_cells(name, shape, rows)
    level = {"elevation_m": site.altitude_m, "slope_deg": 0.0, "moisture": 0.5, "wind": 0.5, "sun": 1.0}[name]
    return np.full((len(range(shape[0])[rows]), shape[1]), level)


class _Ground:
    """What is known of one site's ground; each part is computed when it is first asked for."""

    def __init__(self, site: Site, height: GroundHeight) -> None:
        self.site, self.height = site, height
        self._made: dict[str, tuple[relief.Nodes, Floats]] = {}

    def on_cells(self, name: str, shape: tuple[int, int], rows: slice) -> Floats:
        """(rows, cols) of one living condition on the cells of some rows of a grid."""
        if name not in self._made:
            self._made[name] = self._at_nodes(name)
        nodes, values = self._made[name]
        x, y = (
            np.linspace(0.0, side, n, endpoint=False) + side / (2 * n)
            for side, n in zip(self.site.size_m, shape[::-1], strict=True)
        )
        return nodes.between(values, x, y[rows])

    def _at_nodes(self, name: str) -> tuple[relief.Nodes, Floats]:
        """Nodes over the site, and (rows, cols) one living condition there."""
        near, site, over = self._near, self.site, self._near.over(self.site)
        along_x, along_y = (np.ascontiguousarray(one[over]) for one in near.slopes)
        nodes = relief.Nodes(near.nodes.x_m[over[1]], near.nodes.y_m[over[0]])
        match name:
            case "elevation_m":
                return nodes, site.altitude_m + near.z_m[over]
            case "slope_deg":
                return nodes, np.asarray(np.degrees(np.arctan(np.hypot(along_x, along_y))))
            case "moisture":
                return nodes, np.ascontiguousarray(relief.moisture(near)[over])
            case "wind":
                return self._views.nodes, relief.exposure(self._views, site.wind_from_deg)
        return nodes, relief.irradiation(along_x, along_y, nodes, self._views, site.latitude_deg)

    @cached_property
    def _near(self) -> relief.Relief:
        return relief.near_relief(self.height, self.site)

    @cached_property
    def _views(self) -> relief.Views:
        return relief.views(self._near, relief.far_relief(self.height, self.site), self.site)


#: The grounds asked for last, each of which counts as one; they take some tens of megabytes each.
_grounds: BoundedCache[_Ground] = BoundedCache(4, lambda ground: 1)


def _response(least: float, most: float, unit: str) -> Callable[[Function], Function]:
    """A check of a response's values, 0 to 1, and of the values of the condition that it is given for."""

    def check(curve: Function) -> Function:
        if isinstance(curve, Formula):
            values = evaluate(curve, np.linspace(least, most, 1001))
        else:
            points = np.array(curve.points if isinstance(curve, Smooth) else curve)
            values, at = points[:, 1], points[:, 0]
            if len(points) > 1 and not (least <= at[0] and at[-1] <= most):
                outside = at[0] if at[0] < least else at[-1]
                raise violation(f"values from {least:g} to {most:g} {unit}", problem="out of range", got=f"{outside:g}")
        if not (values.min() >= 0 and values.max() <= 1):
            wrong = values.min() if values.min() < 0 else values.max()
            got, hint = f"{wrong:g}", "cut a formula off: max(0, min(1, ...))" if isinstance(curve, Formula) else None
            raise violation("a response from 0 (bars the species) to 1 (all of its density)", got=got, hint=hint)
        return curve

    return check


Elevation = Annotated[Curve, AfterValidator(_response(-1000.0, 10_000.0, "metres above sea level"))]
Slope = Annotated[Curve, AfterValidator(_response(0.0, 90.0, "degrees"))]
Share = Annotated[Curve, AfterValidator(_response(0.0, 1.0, "(0.5 is level ground)"))]
Sunshine = Annotated[Curve, AfterValidator(_response(0.0, 5.0, "(1 is level ground)"))]


class Conditions(Section):
    """What a species asks of the ground: the share of its density that grows, 0 to 1, by each condition's value."""

    elevation_m: Elevation | None = Field(
        default=None, description="Response to height above sea level, metres: site.altitude_m and the ground's height."
    )
    slope_deg: Slope | None = Field(default=None, description="Response to the ground's slope, degrees; 0 is level.")
    moisture: Share | None = Field(
        default=None, description="Response to topographic wetness: 0 dry crest, 0.5 level ground, 1 valley floor."
    )
    wind: Share | None = Field(
        default=None, description="Response to exposure to wind: 0 sheltered hollow, 0.5 level ground, 1 crest."
    )
    sun: Sunshine | None = Field(
        default=None,
        description="Response to the year's direct sun: 0 none, 1 level open ground, above 1 sunny slopes.",
    )

    def responses(self) -> Iterator[tuple[str, Function]]:
        """Name and curve of every condition that counts."""
        return ((name, curve) for name in type(self).model_fields if (curve := getattr(self, name)) is not None)


def suitability(conditions: Conditions, site: Site, shape: tuple[int, int]) -> NDArray[np.float64]:
    """(rows, cols) float64 in [0, 1]: the product of a species' responses; row 0 at y = 0."""
    product = np.ones(shape)
    block = max(1, _BLOCK_CELLS // shape[1])
    for name, curve in conditions.responses():
        for start in range(0, shape[0], block):
            rows = slice(start, start + block)
            product[rows] *= _answer(curve, ground_raster(site, name, shape, rows))
    return product


def why_barred(conditions: Conditions, site: Site, shape: tuple[int, int]) -> str | None:
    """What bars a species on the whole site, as "elevation_m bars it on the whole site: ..."; None if nothing does."""
    if suitability(conditions, site, shape).any():
        return None
    bars: dict[str, NDArray[np.bool_]] = {}
    for name, curve in conditions.responses():
        value = ground_raster(site, name, shape)
        bars[name] = _answer(curve, value) == 0
        if bars[name].all():
            low, high = value.min(), value.max()
            there = f"{low:.3g}" if f"{low:.3g}" == f"{high:.3g}" else f"{low:.3g} to {high:.3g}"
            return f"{name} bars it on the whole site, where it is {there}{_UNITS.get(name, '')}"
    shares = ", ".join(f"{name} on {int(100 * where.mean())}%" for name, where in bars.items() if where.any())
    return f"its conditions bar it on the whole site together: {shares}"


def _answer(curve: Function, value: NDArray[np.float64]) -> NDArray[np.float64]:
    # A formula was checked at some values only.
    return np.asarray(np.clip(evaluate(curve, value), 0.0, 1.0))
