"""Shedding: modules of too little vigour fall with all that they bear, and their pipes stay in the wood below.

A module falls whose vigour, over its size (vigour.Stature), is below vigour_min; and one that is stunted: that in twice
the time in which full vigour makes a module grown has not come to a thirtieth of that.

By the pipe model (Makowski 2023, Eq. 10) squared diameters add at a fork. Were the pipes of a shed module forgotten, a
trunk would shrink; so the module that bore it keeps them as `disused_m2`, as Shinozaki et al. (1964) found in stems.
Were they all kept for good, a trunk that bears the same crown for long would thicken without end. So of the pipes that
grow anew the share ``1 - disused_share`` takes the place of disused ones, in the first module below that has some on
its way, and only the rest thickens the wood: no node gets thinner, and in a crown that sheds as much as it grows the
share `disused_share` of what is shed stays.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from forestgen.architecture.geometry import diameters, over_plants
from forestgen.architecture.modules import Modules
from forestgen.architecture.tables import Tables
from forestgen.community.branch_modules.traits import Traits
from forestgen.core.compiled import compiled

STUNTED = 1 / 30  # share of the mature age that a module must have reached
PATIENCE = 2.0  # within so many times the years that one of full vigour needs to grow up


@dataclass(frozen=True)
class Shed:
    """Which modules stay, and what they keep of those that do not."""

    keep: NDArray[np.bool_]  # (M,)
    disused_m2: NDArray[np.float32]  # (M,)


@compiled
def _shed(start, end, modules, species, vigour, numbers, pipes, keep, disused):  # type: ignore[no-untyped-def]
    first, parent, age, age_yr = modules
    vigour_min, stunted_age, patience_yr = numbers
    for p in range(start, end):
        a, sp = first[p], species[p]
        for i in range(a, first[p + 1]):
            borne = parent[i] < 0 or keep[a + parent[i]]
            stunted = age_yr[i] >= patience_yr[sp] and age[i] < stunted_age[sp]
            keep[i] = borne and vigour[i] >= vigour_min[sp] and not stunted
            if borne and not keep[i] and parent[i] >= 0:
                disused[a + parent[i]] += pipes[i]


@compiled
def _overgrow(start, end, modules, species, before, shapes, numbers, squared, disused):  # type: ignore[no-untyped-def]
    """Set `squared` (M,) from what it is by growth alone, and `disused`, to what they are by the rule of the page."""
    first, parent, node, prototype = modules
    fork_parent, disused_node, thickness = shapes
    thickening, disused_share = numbers
    longest = 0
    for p in range(start, end):
        longest = max(longest, first[p + 1] - first[p])
    # Of each module: new pipes that may take a place, by way of its main axis's end and by others; what its joints
    # grew by; and how much less than that they are thicker now.
    through, beside, joints, less = np.empty(longest), np.empty(longest), np.empty(longest), np.empty(longest)
    for p in range(start, end):
        a, n, sp = first[p], first[p + 1] - first[p], species[p]
        for i in range(n):
            through[i] = beside[i] = joints[i] = less[i] = 0.0
        for i in range(n - 1, -1, -1):
            row = a + i
            was, grown = np.float64(before[row]), squared[row]
            own = (1.0 - disused_share[sp]) * max(0.0, grown - was - joints[i])
            use = min(through[i], np.float64(disused[row]))
            disused[row] = max(0.0, disused[row] - use)
            squared[row] = grown - less[i] - use
            if parent[row] < 0:
                continue
            u, k = parent[row], node[row]
            s = prototype[a + u]
            bare = (thickening[sp] * thickness[s, k]) ** 2
            passed = max(bare, squared[row]) - max(bare, was)
            joints[u] += max(bare, grown) - max(bare, was)
            less[u] += max(bare, grown) - max(bare, squared[row])
            left = max(0.0, min(own + through[i] - use + beside[i], passed))
            while k > disused_node[s]:
                k = fork_parent[s, k]
            if k == disused_node[s]:
                through[u] += left
            else:
                beside[u] += left


def overgrown(
    before: Modules, after: Modules, species: NDArray[np.uint16], tables: Tables, traits: Traits
) -> tuple[Modules, NDArray[np.float32]]:
    """`after`, where new pipes have taken the place of disused ones; and (M,) diameters of root nodes, metres.

    Parameters
    ----------
    before, after : the same modules before and after they grew, with the same disused pipes.
    species : (P,) of each plant.
    """
    was = diameters(tables, before, species).astype(np.float64) ** 2
    squared = diameters(tables, after, species).astype(np.float64) ** 2
    disused = after.disused_m2.copy()
    columns = after.first, after.parent, after.node, after.prototype
    shapes = tables.parent, tables.disused_node, tables.thickness
    numbers = tables.thickening_m, traits.disused_share

    def work(start: int, end: int) -> None:
        _overgrow(start, end, columns, species, was, shapes, numbers, squared, disused)

    over_plants(after, work)
    return replace(after, disused_m2=disused), np.sqrt(squared).astype(np.float32)


def lost_pipes(
    modules: Modules, diameter_m: NDArray[np.float32], species: NDArray[np.uint16], tables: Tables
) -> NDArray[np.float32]:
    """(M,) squared diameter that a module adds to the one that bears it, m2: its own less that of the bare terminal."""
    bearer = np.maximum(modules.parent_row(), 0)
    kind = np.repeat(species, np.diff(modules.first))
    bare_m = tables.thickening_m[kind] * tables.thickness[modules.prototype[bearer], np.maximum(modules.node, 0)]
    return np.maximum(diameter_m.astype(np.float64) ** 2 - bare_m**2, 0.0).astype(np.float32)


def shed(
    modules: Modules,
    vigour: NDArray[np.float32],
    diameter_m: NDArray[np.float32],
    species: NDArray[np.uint16],
    tables: Tables,
    traits: Traits,
    step_yr: float,
) -> Shed:
    """Which modules stay: those of at least vigour_min that have begun to grow in time, and whose bearers stay too.

    Parameters
    ----------
    vigour : (M,) of each module, over its size.
    diameter_m : (M,) of each module's root node.
    species : (P,) of each plant.
    """
    keep, disused = np.empty(len(modules), dtype=np.bool_), modules.disused_m2.copy()
    pipes = lost_pipes(modules, diameter_m, species, tables)
    columns = modules.first, modules.parent, modules.age, modules.age_yr
    patience_yr = PATIENCE * traits.mature_age / traits.growth_rate_per_yr + step_yr
    numbers = traits.vigour_min, STUNTED * traits.mature_age, patience_yr

    def work(start: int, end: int) -> None:
        _shed(start, end, columns, species, vigour, numbers, pipes, keep, disused)

    over_plants(modules, work)
    return Shed(keep, disused)
