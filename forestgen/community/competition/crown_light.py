"""Light: crowns overlap, and each plant gets the light that the leaves above its crown leave it.

Reference: M. Monsi and T. Saeki, Über den Lichtfaktor in den Pflanzengesellschaften und seine Bedeutung für die
Stoffproduktion, Japanese Journal of Botany 14 (1953) 22-52 (Beer's law for leaves); asymmetric competition as in
S. W. Pacala et al., Forest models defined by field measurements: estimation, error analysis and dynamics, Ecological
Monographs 66 (1996) 1-43. ::

    c_i = exp(-k sum_{j != i} L a_ij / (pi r_i^2) f_ij)
    f_ij = (h_j - m h_i) / ((1 - b) h_j), within 0 and 1

a_ij is the area that the circles i and j share, L the leaf area over a circle's area, h the height. Leaves lie evenly
between b h and h; f is the share of j's that is above the middle of i's crown, at m h_i. c = 1 is full light. A small
plant takes next to nothing from a tall one, equals take some from each other: shade comes from above.

Parameters: see below; k is extinction, L leaf_area_index, b crown_base; m is (1 + b) / 2.

Decided here: all species have the same L; a plant's own leaves do not count. On a torus that is small against the
circles every image of another plant counts, a plant's own images do not.
"""

from __future__ import annotations

from math import exp, pi

import numpy as np
from pydantic import Field

from forestgen.community.competition import grid
from forestgen.community.competition.contract import Circles
from forestgen.community.competition.leps_kindlmann import shared_area
from forestgen.community.population import Floats
from forestgen.core.compiled import compiled
from forestgen.core.threads import parallel_for
from forestgen.recipe.fields import Section


class LightParameters(Section):
    """How leaves take light."""

    extinction: float = Field(0.5, gt=0, le=2, description="k: share of a thin layer's leaf area that light meets")
    leaf_area_index: float = Field(3.0, gt=0, le=20, description="L: leaf area over the area of a plant's circle")
    crown_base: float = Field(0.4, ge=0, le=0.95, description="b: height at which leaves begin, over the plant's")


@compiled
def _light(first, end, g, height, about, out):  # type: ignore[no-untyped-def]
    """Set c of circles `first` to `end` of the grid; `about`: k L, and b."""
    circle, entry, start, n, per_m, size_m, periodic = g
    strength, base = about
    for i in range(first, end):
        x, y, r = circle[i, 0], circle[i, 1], circle[i, 2]
        x0, across, y0, along = grid.box(x, y, r, n, per_m, periodic)
        row = int(circle[i, 3])
        middle, total = 0.5 * (1.0 + base) * height[row], 0.0
        for b in range(along):
            line = grid.wrapped(y0 + b, n[1]) * n[0]
            for a in range(across):
                cell = line + grid.wrapped(x0 + a, n[0])
                for k in range(start[cell], start[cell + 1]):
                    j = entry[k]
                    s, other = circle[j, 2], height[int(circle[j, 3])]
                    if j == i or other <= middle:
                        continue
                    if not grid.near(x, y, circle[j, 0], circle[j, 1], r + s, size_m, periodic):
                        continue
                    if grid.first_shared(a, b, x0, y0, circle[j, 0], circle[j, 1], s, n, per_m, periodic):
                        above = min((other - middle) / ((1.0 - base) * other), 1.0)
                        total += above * shared_area(i, j, circle, size_m, periodic)
        out[row] = exp(-strength * total / (pi * r * r))


class Light:
    Parameters = LightParameters
    needs_heights = True

    def answer(
        self, parameters: LightParameters, circles: Circles, size_m: tuple[float, float], *, periodic: bool
    ) -> Floats:
        """c: share of the light above the stand."""
        out = np.ones(len(circles))
        if len(circles) > 1:
            cells = grid.build(circles.position_m, circles.radius_m, size_m, periodic=periodic)
            about = parameters.extinction * parameters.leaf_area_index, parameters.crown_base
            parallel_for(len(out), lambda first, end: _light(first, end, cells, circles.height_m, about, out))
        return out


MODEL = Light()
