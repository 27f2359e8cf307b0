"""Growth of modules (Makowski 2023, Eqs. 7 and 8), and the rows of those that are shed and those that begin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.architecture.geometry import over_plants
from forestgen.architecture.modules import Modules
from forestgen.architecture.prototype import MOST_NODES
from forestgen.community.branch_modules.traits import Traits
from forestgen.core.compiled import compiled


@compiled
def _grow(start, end, first, species, vigour, numbers, step_yr, age):  # type: ignore[no-untyped-def]
    mature_age, vigour_min, vigour_max, rate = numbers
    for p in range(start, end):
        sp = species[p]
        span = vigour_max[sp] - vigour_min[sp]
        for i in range(first[p], first[p + 1]):
            x = min(1.0, max(0.0, (vigour[i] - vigour_min[sp]) / span))
            grown = age[i] + (3.0 - 2.0 * x) * x * x * rate[sp] * step_yr
            age[i] = min(grown, mature_age[sp])


def grow(
    modules: Modules, vigour: NDArray[np.float32], species: NDArray[np.uint16], traits: Traits, step_yr: float
) -> NDArray[np.float32]:
    """(M,) physiological ages one step later: the growth rate rises smoothly from 0 at vigour_min to that of the type.

    Parameters
    ----------
    vigour : (M,) of each module, over its size.
    species : (P,) of each plant.
    """
    age = modules.age.copy()
    numbers = traits.mature_age, traits.vigour_min, traits.vigour_max, traits.growth_rate_per_yr
    over_plants(modules, lambda start, end: _grow(start, end, modules.first, species, vigour, numbers, step_yr, age))
    return age


@dataclass(frozen=True)
class Rows:
    """Rows of the modules after shedding and sprouting: of each plant those that stay, then those that begin."""

    first: NDArray[np.int64]  # (P + 1,) as in Modules
    source: NDArray[np.int64]  # (N,) former row of a module; of a new one that of the module that bears it
    new: NDArray[np.bool_]  # (N,)
    parent: NDArray[np.int32]  # (N,) as in Modules
    node: NDArray[np.int16]  # (N,) as in Modules
    number: NDArray[np.uint32]  # (N,) as in Modules
    next_number: NDArray[np.uint32]  # (P,) of the next module of each plant


@compiled
def _count(start, end, first, keep, sprouts, rows):  # type: ignore[no-untyped-def]
    for p in range(start, end):
        count = 0
        for i in range(first[p], first[p + 1]):
            if keep[i]:
                count += 1
                left = sprouts[i]
                while left:
                    left &= left - np.uint32(1)
                    count += 1
        rows[p + 1] = count


@compiled
def _fill(start, end, modules, keep, sprouts, next_number, most_nodes, out):  # type: ignore[no-untyped-def]
    first, parent, node, number = modules
    out_first, source, new, out_parent, out_node, out_number = out
    longest = 0
    for p in range(start, end):
        longest = max(longest, first[p + 1] - first[p])
    moved = np.empty(longest, np.int32)
    for p in range(start, end):
        a, n, b = first[p], first[p + 1] - first[p], out_first[p]
        row = 0
        for i in range(n):
            if keep[a + i]:
                moved[i] = row
                source[b + row], new[b + row] = a + i, False
                out_parent[b + row] = moved[parent[a + i]] if parent[a + i] >= 0 else -1
                out_node[b + row], out_number[b + row] = node[a + i], number[a + i]
                row += 1
        for i in range(n):
            if keep[a + i] and sprouts[a + i]:
                for k in range(most_nodes):
                    if sprouts[a + i] >> np.uint32(k) & np.uint32(1):
                        source[b + row], new[b + row] = a + i, True
                        out_parent[b + row], out_node[b + row] = moved[i], k
                        out_number[b + row] = next_number[p]
                        next_number[p] += np.uint32(1)
                        row += 1


def rows_after(
    modules: Modules,
    keep: NDArray[np.bool_],
    sprouts: NDArray[np.uint32],
    next_number: NDArray[np.uint32],
) -> Rows:
    """Rows of the modules that stay and of those that begin; plants that keep nothing have none.

    Parameters
    ----------
    keep : (M,) which stay; whoever stays has a bearer that stays.
    sprouts : (M,) bit k: a module begins at terminal node k, if this module stays.
    next_number : (P,) number of each plant's next module.
    """
    first = np.zeros(modules.plants + 1, dtype=np.int64)
    over_plants(modules, lambda start, end: _count(start, end, modules.first, keep, sprouts, first))
    np.cumsum(first, out=first)
    n, following = int(first[-1]), next_number.copy()
    out = (
        first,
        np.empty(n, np.int64),
        np.empty(n, np.bool_),
        np.empty(n, np.int32),
        np.empty(n, np.int16),
        np.empty(n, np.uint32),
    )
    columns = modules.first, modules.parent, modules.node, modules.number
    over_plants(modules, lambda start, end: _fill(start, end, columns, keep, sprouts, following, MOST_NODES, out))
    return Rows(*out, next_number=following)


@compiled
def _on_axis(start, end, first, parent, node, prototype, is_main, out):  # type: ignore[no-untyped-def]
    for p in range(start, end):
        a = first[p]
        for i in range(a, first[p + 1]):
            bearer = a + parent[i]
            out[i] = parent[i] < 0 or (out[bearer] and is_main[prototype[bearer], node[i]])


def on_axis(modules: Modules, is_main: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(M,) whether a module continues the plant's main axis: from the root by main children only."""
    out = np.empty(len(modules), dtype=np.bool_)
    columns = modules.first, modules.parent, modules.node, modules.prototype
    over_plants(modules, lambda start, end: _on_axis(start, end, *columns, is_main, out))
    return out
