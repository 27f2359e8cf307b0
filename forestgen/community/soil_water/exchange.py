"""What happens to water within a cell: rain falls, sinks in, is taken up by plants, evaporates and drains.

Surface water O decays exactly: dO/dt = R - f O, with f the rate of infiltration at the plants that stand there. Soil
water W decays by the rate g B / (W + k1) + r, which is held at its value in the middle of the time (an exponential
midpoint rule: second order, exact without plants, and at rest where the equations are). What leaves is what was there
and came, less what is left: so water balances, and no time is too long.
"""

from __future__ import annotations

import math

from forestgen.core.compiled import compiled


@compiled
def exchange(soil, surface, plants, rain, sinks, uptake, loss, most, half, lost, days, first, end):  # type: ignore[no-untyped-def]
    """Cells [first, end) of flat arrays, in place; `uptake` and `loss`, mm, are added to.

    `rain` mm/d, `sinks` f 1/d; `most`, `half` and `lost` are g_max, k1 and r_w.
    """
    for i in range(first, end):
        falls = rain[i] * days
        there = surface[i] + falls
        stays, mean = _decay(sinks[i] * days)
        left = surface[i] * stays + falls * mean
        left = left if left < there else there
        surface[i] = left
        comes, before = there - left, soil[i]
        drink = most * plants[i] / (before + half)
        middle = (before + 0.5 * comes) / (1.0 + 0.5 * days * (drink + lost))
        drink = most * plants[i] / (middle + half)
        rate = drink + lost
        there = before + comes
        stays, mean = _decay(rate * days)
        left = before * stays + comes * mean
        left = left if left < there else there
        soil[i] = left
        goes = there - left
        drunk = goes * (drink / rate) if rate > 0.0 else 0.0
        uptake[i] += drunk
        loss[i] += goes - drunk


@compiled
def _decay(x):  # type: ignore[no-untyped-def]
    """What is left after x of what was there, exp(-x), and on the mean of what comes meanwhile, (1 - exp(-x)) / x."""
    stays = math.exp(-x)
    if x < 1e-3:  # where the difference would be rounding
        return stays, 1.0 - x * (0.5 - x * (1.0 / 6.0 - x / 24.0))
    return stays, (1.0 - stays) / x
