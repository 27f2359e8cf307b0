"""Light down to the root, vigour up from it: the extended Borchert-Honda model (Makowski 2023, 2.5.1.1, Eq. 2).

One pass over each plant's modules towards the root sums their light, one pass away from it hands the vigour out. At a
fork with a main child m and lateral children l1, l2, ... of light Q, where Q_l is the sum of theirs::

    v(m)  = v λ Q_m / (λ Q_m + (1 - λ) Q_l)
    v(lk) = (v - v(m)) Q_lk / Q_l

The same rule holds at the forks inside of a module and where modules meet: a module's own light is shared by its
terminals, and a terminal that bears a module adds that module's whole light. So the children's vigour sums to what
reached their fork. Before its first fork a module keeps a share, `upkeep`; see the model's page.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.architecture.geometry import over_plants
from forestgen.architecture.modules import Modules
from forestgen.community.branch_modules.state import StepParameters
from forestgen.community.population import Floats, Floats32, Indices, SpeciesIndex
from forestgen.core.compiled import compiled


@dataclass(frozen=True)
class Flow:
    """What one step's passes say of each module."""

    flux: Floats  # (M,) light of the module and of all that it bears
    vigour: Floats32  # (M,)
    sprouts: NDArray[np.uint32]  # (M,) bit k: terminal node k is free and vigorous enough to bear a new module


@compiled
def _share(k, main, beside, light, apical_control, vigour):  # type: ignore[no-untyped-def]
    """Hand the vigour of node `k` on to its children; arrays over the nodes of one module."""
    m = main[k]
    lateral = 0.0
    child = beside[m]
    while child >= 0:
        lateral += light[child]
        child = beside[child]
    weight = apical_control * light[m]
    total = weight + (1.0 - apical_control) * lateral
    if lateral <= 0.0 or total <= 0.0:
        vigour[m] = vigour[k]
        child = beside[m]
        while child >= 0:
            vigour[child] = 0.0
            child = beside[child]
        return
    vigour[m] = vigour[k] * weight / total
    rest = vigour[k] - vigour[m]
    child = beside[m]
    while child >= 0:
        vigour[child] = rest * light[child] / lateral
        child = beside[child]


@compiled
def _distribute(start, end, modules, species, most, control, forks, traits, flow):  # type: ignore[no-untyped-def]
    """Both passes over plants `start` to `end`."""
    first, parent, node, prototype, age, gain, grown, leaves = modules
    count, terminals, fork_parent, main, beside = forks
    mature_age, upkeep, reach, axis, sprouting = traits
    flux, vigour, sprouts = flow
    longest = 0
    for p in range(start, end):
        longest = max(longest, first[p + 1] - first[p])
    head, following, way = np.empty(longest, np.int32), np.empty(longest, np.int32), np.zeros(longest)
    q, v = np.empty(main.shape[1]), np.empty(main.shape[1])
    for p in range(start, end):
        a, n = first[p], first[p + 1] - first[p]
        if n == 0:
            continue
        sp = species[p]
        for i in range(n):
            flux[a + i] = gain[a + i] * leaves[a + i]
            head[i] = -1
            u = parent[a + i]
            way[i] = way[u] + axis[sp, prototype[a + u]] if u >= 0 else 0.0
        for i in range(n - 1, 0, -1):
            bearer = parent[a + i]
            flux[a + bearer] += flux[a + i]
            following[i] = head[bearer]
            head[bearer] = i
        vigour[a] = max(0.0, min(flux[a], most[p]))
        for i in range(n):
            sprouts[a + i] = 0
            if age[a + i] < mature_age[sp]:
                continue
            s = prototype[a + i]
            own = max(0.0, gain[a + i]) / terminals[s]
            for k in range(count[s]):
                q[k] = own if main[s, k] < 0 else 0.0
            bearing = np.uint32(0)
            j = head[i]
            while j >= 0:
                q[node[a + j]] = own * (1.0 - grown[a + j]) + max(0.0, flux[a + j])
                bearing |= np.uint32(1) << np.uint32(node[a + j])
                j = following[j]
            for k in range(count[s] - 1, 0, -1):
                q[fork_parent[s, k]] += q[k]
            v[0] = _kept(way[i], axis[sp, s], upkeep[sp], reach[sp]) * vigour[a + i]
            least = sprouting[sp] / terminals[s]
            found = np.uint32(0)
            for k in range(count[s]):
                if main[s, k] >= 0:
                    _share(k, main[s], beside[s], q, control[p], v)
                elif v[k] > least:
                    found |= np.uint32(1) << np.uint32(k)
            j = head[i]
            while j >= 0:
                vigour[a + j] = v[node[a + j]]
                j = following[j]
            sprouts[a + i] = found & ~bearing


def axis_lengths_m(now: StepParameters) -> Floats:
    """(T, S) length of a grown module's main axis, metres."""
    tables = now.tables
    spans_m = np.minimum(
        tables.longest_segment_m[:, None, None],
        tables.length_per_age_m[:, None, None] * now.traits.mature_age[:, None, None] * (1 - tables.birth),
    )
    return np.asarray(np.sum(tables.length * spans_m * now.main_path, axis=-1))


@compiled
def _kept(way, axis, upkeep, reach):  # type: ignore[no-untyped-def]
    """Share of the vigour at the foot of a module, `way` metres from the root, that is left at its end."""
    return (1.0 - upkeep) ** axis * np.exp((way / reach) ** 3 - ((way + axis) / reach) ** 3)


@dataclass(frozen=True)
class Stature:
    """How much of itself each module is, as light and vigour count it."""

    grown: Floats32  # (M,) share of the mature age, 0 to 1
    leaves: Floats32  # (M,) of a grown module's that bears no other, 0 to 1
    size: Floats32  # (M,) leaves of the module with those left on the terminal that bears it


def stature_of(modules: Modules, species: SpeciesIndex, now: StepParameters) -> Stature:
    """Leaves sit on the last shoots: a terminal loses its own as the module that it bears grows, which gets more.

    A seed has the reserves of a bare terminal.
    """
    kind = np.repeat(species, np.diff(modules.first))
    grown = np.minimum(modules.age / now.traits.mature_age[kind], 1.0).astype(np.float32)
    bearer, terminals = modules.parent_row(), now.tables.terminals[modules.prototype].astype(np.float32)
    borne = bearer >= 0
    share = 1 / np.where(borne, terminals[np.maximum(bearer, 0)], terminals)  # of a module, that a terminal is
    size = grown + (1 - grown) * share
    taken = np.bincount(bearer[borne], weights=grown[borne], minlength=len(modules)).astype(np.float32)
    leaves = np.where(borne, grown, size) * (1 - taken / terminals)
    return Stature(grown, leaves.astype(np.float32), size.astype(np.float32))


def net_gain(light: Floats32, species: SpeciesIndex, first: Indices, now: StepParameters) -> Floats32:
    """(M,) 1 in full light, 0 at the type's compensation point, and less below it: then others must feed the module."""
    point = np.repeat(now.traits.compensation[species].astype(np.float32), np.diff(first))
    return np.asarray((light - point) / (1 - point))


def distribute(
    modules: Modules,
    gain: Floats32,
    stature: Stature,
    species: SpeciesIndex,
    root_vigour_max: Floats,
    apical_control: Floats,
    now: StepParameters,
) -> Flow:
    """Light towards the root and vigour away from it.

    `gain` (M,) is the light that each module takes in beyond what it needs itself, of all its leaves; see `net_gain`.
    `root_vigour_max` (P,) is the most vigour of the root module, by climate and senescence; `apical_control` (P,) is
    lambda of each plant, by whether it flowers.
    """
    m, tables, traits = len(modules), now.tables, now.traits
    flow = np.empty(m), np.empty(m, np.float32), np.empty(m, np.uint32)
    columns = modules.first, modules.parent, modules.node, modules.prototype, modules.age, gain
    whole = *columns, stature.grown, stature.leaves
    forks = tables.nodes, tables.terminals, tables.parent, tables.first_child, tables.next_sibling
    axis_m, sprouting = axis_lengths_m(now), traits.sprouting * traits.vigour_min
    numbers = traits.mature_age, traits.upkeep, traits.reach_m, axis_m, sprouting
    arguments = whole, species, root_vigour_max, apical_control, forks, numbers, flow
    over_plants(modules, lambda start, end: _distribute(start, end, *arguments))
    return Flow(*flow)
