"""Vigour, growth and shedding of modules, the rows of those that begin, and standing dead trees (Makowski 2023).

Light goes down to the root, vigour up from it, by the extended Borchert-Honda model (2.5.1.1, Eq. 2): one pass over a
plant's modules towards the root sums their light, one away from it hands the vigour out. At a fork with a main child m
and lateral children l1, l2, ... of light Q, where Q_l is the sum of theirs::

    v(m)  = v λ Q_m / (λ Q_m + (1 - λ) Q_l)
    v(lk) = (v - v(m)) Q_lk / Q_l

The same rule holds at the forks inside of a module and where modules meet: a module's own light is shared by its
terminals, and a terminal that bears a module adds that module's whole light. So the children's vigour sums to what
reached their fork. Before its first fork a module keeps a share, `upkeep`; see the model's page. Ages follow Eqs. 7
and 8.

A module falls whose vigour, over its size (`Stature`), is below vigour_min; and one that is stunted: that in twice
the time in which full vigour makes a module grow up has not come to a thirtieth of that.

By the pipe model (Makowski 2023, Eq. 10) squared diameters add at a fork. Without the pipes of shed modules a trunk
would shrink; so the module that bore one keeps them as `disused_m2`, as Shinozaki et al. (1964) found in stems. With
all of them kept for good, a trunk that bears the same crown for long would thicken without end. So of the pipes that
grow anew the share ``1 - disused_share`` takes the place of disused ones, in the first module below that has some on
its way, and only the rest thickens the wood: no node gets thinner, and in a crown that sheds as much as it grows the
share `disused_share` of what is shed stays.

A tree that dies back sheds its modules over years, the top of its stem too, and would be a stub before it dies of the
last one. `dieback_share` calls it dead once it has died back to less than this share of its greatest height. What
stands then, a snag, is the wood that it had before the step's shedding: a stem with the branches that were left to it.
A snag takes no light, water or place, casts no shade and bears no seeds. It falls after years t of its own, drawn by
its identity, of median `standing_dead_yr` and survival

    S(t) = 2^-(t / standing_dead_yr)^2

so that few fall at first and more later, as Keen (1955) found of pines. The form is ours: he gives no equation.

Reference: Keen, F. P. (1955). The rate of natural falling of beetle-killed ponderosa pine snags. J. Forestry 53.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from forestgen.architecture.geometry import diameters, over_plants, plant_sizes
from forestgen.architecture.modules import Modules
from forestgen.architecture.prototypes import MOST_NODES
from forestgen.community.branch_modules.state import Plants, Snags, State, StepParameters, uniform
from forestgen.community.population import Floats, Floats32, Indices, Mask, SpeciesIndex
from forestgen.core.compiled import compiled
from forestgen.core.frames import BREAST_HEIGHT_M


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


STUNTED = 1 / 30  # share of the mature age that a module must have reached
PATIENCE = 2.0  # within so many times the years that one of full vigour needs to grow up
_NO_MODULE = 2**32 - 1  # number of the draw: no plant has so many modules
_PACE = 2**32 - 2  # likewise


def grow(modules: Modules, vigour: Floats32, species: SpeciesIndex, pace: Floats, now: StepParameters) -> Floats32:
    """(M,) physiological ages one step later: the growth rate rises smoothly from 0 at vigour_min to that of the type.

    `vigour` (M,) is that of each module, over its size; `species` and `pace` (P,) that of each plant.
    """
    traits, counts = now.traits, np.diff(modules.first)
    kind = np.repeat(species, counts)
    span = traits.vigour_max - traits.vigour_min
    x = np.clip((vigour - traits.vigour_min[kind]) / span[kind], 0.0, 1.0)
    rate = np.repeat(pace * traits.growth_rate_per_yr[species], counts)
    if np.any(traits.slowing_per_m > 0):
        away_m = np.linalg.norm(modules.base_m, axis=1)
        rate = rate * np.maximum(1.0 - traits.slowing_per_m[kind] * away_m, 0.0)
    grown = modules.age + (3.0 - 2.0 * x) * x * x * rate * now.parameters.step_yr
    return np.minimum(grown, traits.mature_age[kind]).astype(np.float32)


def pace_of(seed: int, plant_id: NDArray[np.uint32], species: SpeciesIndex, now: StepParameters) -> Floats:
    """(P,) factor of each plant on its type's growth rate, uniform with mean 1, drawn once from its identity."""
    share = uniform(seed, plant_id, np.full(len(plant_id), _PACE, dtype=np.uint64))
    return np.asarray(1.0 + np.sqrt(12.0) * now.traits.growth_spread[species] * (share - 0.5))


@dataclass(frozen=True)
class NextRows:
    """Rows of the modules after shedding and sprouting: of each plant those that stay, then those that begin."""

    first: Indices  # (P + 1,) as in Modules
    source: Indices  # (N,) former row of a module; of a new one that of the module that bears it
    new: Mask  # (N,)
    parent: NDArray[np.int32]  # (N,) as in Modules
    node: NDArray[np.int16]  # (N,) as in Modules
    number: NDArray[np.uint32]  # (N,) as in Modules
    next_number: NDArray[np.uint32]  # (P,) of the next module of each plant


def rows_after(modules: Modules, keep: Mask, sprouts: NDArray[np.uint32], next_number: NDArray[np.uint32]) -> NextRows:
    """Rows of the modules that stay and of those that begin; plants that keep nothing have none.

    `keep` (M,) is of modules whose bearers stay too. Bit k of `sprouts` (M,): a module begins at terminal node k, if
    this module stays. `next_number` (P,) is the number of each plant's next module.
    """
    plant, old = modules.plant(), np.flatnonzero(keep)
    sprouting = np.flatnonzero(keep & (sprouts > 0))
    at, node = np.nonzero(sprouts[sprouting, None] >> np.arange(MOST_NODES, dtype=np.uint32) & np.uint32(1))
    bearer = sprouting[at]
    source, owner = np.concatenate([old, bearer]), np.concatenate([plant[old], plant[bearer]])
    order = np.argsort(owner, kind="stable")  # of each plant those that stay come first
    born = np.bincount(plant[bearer], minlength=modules.plants)
    rank = np.arange(len(bearer)) - (np.cumsum(born) - born)[plant[bearer]]  # among the new ones of a plant
    stay = np.concatenate([[0], np.cumsum(keep)])
    row = stay[:-1] - stay[modules.first[:-1]][plant]  # of a module that stays, in its plant
    parent = np.where(modules.parent[old] < 0, -1, row[modules.parent_row()[old]])
    number = np.concatenate([modules.number[old], next_number[plant[bearer]] + rank])
    return NextRows(
        first=np.concatenate([[0], np.cumsum(np.bincount(owner, minlength=modules.plants))]),
        source=source[order],
        new=order >= len(old),
        parent=np.concatenate([parent, row[bearer]])[order].astype(np.int32),
        node=np.concatenate([modules.node[old], node])[order].astype(np.int16),
        number=number[order].astype(np.uint32),
        next_number=(next_number + born).astype(np.uint32),
    )


@compiled
def _on_axis(start, end, first, parent, node, prototype, is_main, out):  # type: ignore[no-untyped-def]
    for p in range(start, end):
        a = first[p]
        for i in range(a, first[p + 1]):
            bearer = a + parent[i]
            out[i] = parent[i] < 0 or (out[bearer] and is_main[prototype[bearer], node[i]])


def on_axis(modules: Modules, is_main: Mask) -> Mask:
    """(M,) whether a module continues the plant's main axis: from the root by main children only."""
    out = np.empty(len(modules), dtype=np.bool_)
    columns = modules.first, modules.parent, modules.node, modules.prototype
    over_plants(modules, lambda start, end: _on_axis(start, end, *columns, is_main, out))
    return out


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


def overgrown(before: Modules, after: Modules, species: SpeciesIndex, now: StepParameters) -> tuple[Modules, Floats32]:
    """`after`, where new pipes have taken the place of disused ones; and (M,) diameters of root nodes, metres.

    `before` and `after` are the same modules before and after they grew, with the same disused pipes.
    """
    tables = now.tables
    was = diameters(tables, before, species).astype(np.float64) ** 2
    squared = diameters(tables, after, species).astype(np.float64) ** 2
    disused = after.disused_m2.copy()
    columns = after.first, after.parent, after.node, after.prototype
    shapes = tables.parent, tables.disused_node, tables.thickness
    numbers = tables.thickening_m, now.traits.disused_share
    arguments = columns, species, was, shapes, numbers, squared, disused
    over_plants(after, lambda start, end: _overgrow(start, end, *arguments))
    return replace(after, disused_m2=disused), np.sqrt(squared).astype(np.float32)


def shed(
    modules: Modules, vigour: Floats32, diameter_m: Floats32, species: SpeciesIndex, now: StepParameters
) -> tuple[Mask, Floats32]:
    """(M,) which modules stay, and (M,) their disused pipes, m2, with those of the modules that do not.

    Those stay of at least vigour_min that have begun to grow in time, and whose bearers stay too. `vigour` (M,) is that
    of each module over its size, `diameter_m` (M,) that of its root node.
    """
    keep, disused, traits = np.empty(len(modules), dtype=np.bool_), modules.disused_m2.copy(), now.traits
    tables, bearer, kind = now.tables, np.maximum(modules.parent_row(), 0), np.repeat(species, np.diff(modules.first))
    bare_m = tables.thickening_m[kind] * tables.thickness[modules.prototype[bearer], np.maximum(modules.node, 0)]
    # What a module adds to the one that bears it, m2: its own squared diameter less that of the bare terminal.
    pipes = np.maximum(diameter_m.astype(np.float64) ** 2 - bare_m**2, 0.0).astype(np.float32)
    columns = modules.first, modules.parent, modules.age, modules.age_yr
    patience_yr = PATIENCE * traits.mature_age / traits.growth_rate_per_yr + now.parameters.step_yr
    numbers = traits.vigour_min, STUNTED * traits.mature_age, patience_yr
    over_plants(modules, lambda start, end: _shed(start, end, columns, species, vigour, numbers, pipes, keep, disused))
    return keep, disused


def died_back(plants: Plants, modules: Modules, now: StepParameters) -> tuple[Mask, Floats32]:
    """(P,) which plants are dead of having died back, and (P,) the greatest height of each so far, metres.

    None, and the heights as they were, where no dieback is asked for. Plants that never were over 1.3 m sprout again.
    """
    share = now.parameters.dieback_share
    if share == 0:
        return np.zeros(len(plants), dtype=np.bool_), plants.tallest_m
    height_m = plant_sizes(now.tables, modules, plants.species).height_m
    tallest_m = np.maximum(plants.tallest_m, height_m)
    return (tallest_m > BREAST_HEIGHT_M) & (height_m < np.float32(share) * tallest_m), tallest_m


def snags_after(state: State, now: StepParameters, plants: Plants, wood: Modules, alive: Mask) -> Snags:
    """The snags one step later: those of before and the dead over 1.3 m, without those that have fallen.

    `plants` and `wood` are all that lived, and their modules before the step's shedding; `alive` (P,) says which still
    live.
    """
    parameters, snags, step = now.parameters, state.snags, state.step + 1
    if parameters.standing_dead_yr == 0:
        return snags
    if not alive.all():
        dead, remains = plants.where(~alive), wood.of_plants(~alive)
        tall = plant_sizes(now.tables, remains, dead.species).height_m > BREAST_HEIGHT_M
        snags = Snags(
            plants=snags.plants.and_then(dead.where(tall)),
            modules=snags.modules.and_then(remains.of_plants(tall)),
            died=np.concatenate([snags.died, np.full(tall.sum(), step, dtype=np.int32)]),
        )
    dead_yr = (step - snags.died) * parameters.step_yr
    return snags.where(dead_yr < stands_yr(state.seed, snags.plants.plant_id, parameters.standing_dead_yr))


def stands_yr(seed: int, plant_id: NDArray[np.uint32], median_yr: float) -> Floats:
    """(N,) years after its death in which each snag falls."""
    share = uniform(seed, plant_id, np.full(len(plant_id), _NO_MODULE, dtype=np.uint64))
    return np.asarray(median_yr * np.sqrt(-np.log2(1.0 - share)))
