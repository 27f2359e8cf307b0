"""Weighted overlap: a plant suffers from each neighbour by the area they share, and more from the taller.

Reference: J. Lepš and P. Kindlmann, Models of the development of spatial pattern of an even-aged plant population over
time, Ecological Modelling 39 (1987) 45-57, as in B. Lane, Models of Plant Communities for Image Synthesis, University
of Calgary, 2002, section 3.1. ::

    f_i = max(0, 1 - sum_{j != i} l_ij (h_j / h_i) / (Q q_i))       q_i = pi r_i^2

l_ij is the area of overlap of circles i and j (exact: two circular segments), h the height, q the ecological
neighbourhood. f_i = 1 is a plant without neighbours, f_i = 0 one that does not grow.

Parameters: see below; Q is tolerance.

Decided where the thesis is silent: Q = 1, with which a plant whose neighbourhood is covered once by equals gets
nothing. Overlaps are summed neighbour by neighbour: ground that three plants share counts twice for each, as printed.
On a torus that is small against the circles every image of another plant counts, a plant's own images do not.
"""

from __future__ import annotations

from math import acos, pi, sqrt

import numpy as np
from pydantic import Field

from forestgen.community.competition import grid
from forestgen.community.competition.contract import Circles
from forestgen.community.population import Floats
from forestgen.core.compiled import compiled
from forestgen.core.threads import parallel_for
from forestgen.recipe.fields import Section


class LepsKindlmannParameters(Section):
    """How much overlap a plant bears."""

    tolerance: float = Field(1.0, gt=0, description="Q: the larger, the less neighbours matter")


@compiled
def lens_area(d, r, s):  # type: ignore[no-untyped-def]
    """Area that two circles of radii `r` and `s` share whose centres are `d` apart."""
    if d >= r + s:
        return 0.0
    if d <= abs(r - s):
        return pi * min(r, s) ** 2
    at = (d * d + (r - s) * (r + s)) / (2 * d)  # the chord's distance from the centre of r, towards s
    first, second = acos(min(max(at / r, -1.0), 1.0)), acos(min(max((d - at) / s, -1.0), 1.0))
    return r * r * first + s * s * second - d * sqrt(max(r * r - at * at, 0.0))


@compiled
def shared_area(i, j, circle, size_m, periodic):  # type: ignore[no-untyped-def]
    """Area that circle `i` shares with circle `j` and its images."""
    r, s = circle[i, 2], circle[j, 2]
    dx, dy = circle[j, 0] - circle[i, 0], circle[j, 1] - circle[i, 1]
    x0, x1 = grid.images(dx, r + s, size_m[0], periodic)
    y0, y1 = grid.images(dy, r + s, size_m[1], periodic)
    total = 0.0
    for b in range(y0, y1 + 1):
        for a in range(x0, x1 + 1):
            ex, ey = dx + a * size_m[0], dy + b * size_m[1]
            total += lens_area(sqrt(ex * ex + ey * ey), r, s)
    return total


@compiled
def _factors(first, end, g, height, tolerance, out):  # type: ignore[no-untyped-def]
    """Set f of circles `first` to `end` of the grid."""
    circle, entry, start, n, per_m, size_m, periodic = g
    for i in range(first, end):
        x, y, r = circle[i, 0], circle[i, 1], circle[i, 2]
        x0, across, y0, along = grid.box(x, y, r, n, per_m, periodic)
        total = 0.0
        for b in range(along):
            line = grid.wrapped(y0 + b, n[1]) * n[0]
            for a in range(across):
                cell = line + grid.wrapped(x0 + a, n[0])
                for k in range(start[cell], start[cell + 1]):
                    j = entry[k]
                    s = circle[j, 2]
                    if j == i or not grid.near(x, y, circle[j, 0], circle[j, 1], r + s, size_m, periodic):
                        continue
                    if grid.first_shared(a, b, x0, y0, circle[j, 0], circle[j, 1], s, n, per_m, periodic):
                        total += shared_area(i, j, circle, size_m, periodic) * height[int(circle[j, 3])]
        row = int(circle[i, 3])
        out[row] = max(0.0, 1.0 - total / (height[row] * tolerance * pi * r * r))


class LepsKindlmann:
    Parameters = LepsKindlmannParameters
    needs_heights = True

    def answer(
        self, parameters: LepsKindlmannParameters, circles: Circles, size_m: tuple[float, float], *, periodic: bool
    ) -> Floats:
        """f."""
        out = np.ones(len(circles))
        if len(circles) > 1:
            cells = grid.build(circles.position_m, circles.radius_m, size_m, periodic=periodic)
            height_m, q = circles.height_m, parameters.tolerance
            parallel_for(len(out), lambda first, end: _factors(first, end, cells, height_m, q, out))
        return out


MODEL = LepsKindlmann()
