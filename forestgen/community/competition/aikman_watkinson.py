"""Competition by mean size: every plant competes with the mean of all, wherever they stand.

Reference: D. P. Aikman and A. R. Watkinson, A model for growth and self-thinning in even-aged monocultures of plants,
Annals of Botany 45 (1980) 419-427, as in B. Lane, Models of Plant Communities for Image Synthesis, University of
Calgary, 2002, section 3.1: dm_i/dt = a_i q_i f(q_i) - b_i m_i^2, where f depends "only on the average size of all
plants in comparison to the area of the plot".

What is published is that sentence; Lane prints no f. What is decided here is this f, not that of the paper::

    q_i = pi r_i^2        S = sum_i q_i        C = S / A
    u_i = q_i^a S / sum_j q_j^(1 + a)
    f_i = (1 + (C / u_i)^s)^(-1/s)

A is the area of the plot, C its crowding, u_i the share of a square metre of plant i in terms of the mean one's (their
mean, weighted by q, is 1). In an empty plot f = 1. On a crowded one f_i goes to u_i / C, so that the plants together
get all of the plot, and at any crowding sum_i q_i f_i <= min(S, A): no ground is given away twice. Larger plants get
more of it for a square metre of their own if a > 0; a = 0 divides in proportion to area. f falls with C.

Parameters: see below; a is asymmetry, s is sharpness.

A sharp onset (large s) leaves plants alone until their share of the plot is less than their area. The site's edges and
whether it is periodic do not matter, nor do heights.
"""

from __future__ import annotations

import numpy as np
from pydantic import Field

from forestgen.community.competition.contract import Circles
from forestgen.community.population import Floats
from forestgen.recipe.fields import Section


class AikmanWatkinsonParameters(Section):
    """How unequal the shares are, and how suddenly they shrink."""

    asymmetry: float = Field(1.0, ge=0, le=10, description="a: 0 divides the plot in proportion to area")
    sharpness: float = Field(2.0, ge=0.1, le=100, description="s: how suddenly competition sets in as the plot fills")


class AikmanWatkinson:
    Parameters = AikmanWatkinsonParameters
    needs_heights = False

    def answer(
        self, parameters: AikmanWatkinsonParameters, circles: Circles, size_m: tuple[float, float], *, periodic: bool
    ) -> Floats:
        """f."""
        if not len(circles):
            return np.ones(0)
        a, s = parameters.asymmetry, parameters.sharpness
        relative = circles.radius_m / circles.radius_m.max()  # keeps powers within float64
        q = relative**2
        total = float(q.sum())
        scale = float(circles.radius_m.max())
        # Logarithms: (C / u)^s may overflow where f is merely 0.
        log_crowding = np.log(np.pi * total) + 2 * np.log(scale) - np.log(size_m[0]) - np.log(size_m[1])
        log_mean = np.log(float((q ** (1 + a)).sum()) / total)
        log_ratio = np.log(relative)
        log_ratio *= -2 * a * s
        log_ratio += (log_crowding + log_mean) * s
        answer: Floats = np.exp(np.logaddexp(0.0, log_ratio) / -s)
        return answer


MODEL = AikmanWatkinson()
