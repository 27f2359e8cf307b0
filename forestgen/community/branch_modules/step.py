"""One step of all plants and modules: light, vigour, growth, shedding, new modules, turning, seeds, death.

Plants begin at random places, then by seeds (Makowski 2023, 2.6.3, 2.6.4): how many fall, where, which germinate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import floor

import numpy as np

from forestgen.architecture.geometry import terminal_pose
from forestgen.architecture.modules import Modules
from forestgen.architecture.prototypes import choose_prototype, load_prototypes
from forestgen.community.arrivals import new_ids
from forestgen.community.branch_modules import growth
from forestgen.community.branch_modules.growth import Flow, NextRows, distribute, net_gain, stature_of
from forestgen.community.branch_modules.orientation import Turning, orient
from forestgen.community.branch_modules.parameters import BranchModulesParameters, is_blocked
from forestgen.community.branch_modules.state import (
    LocalClimate,
    Plants,
    State,
    StepParameters,
    Surroundings,
    adaptation,
    boxes_of,
    ground_at,
    no_modules,
    no_snags,
    orientation_along,
    refuse_more_modules,
    refuse_more_seeds,
    seedling_modules,
    step_parameters,
    surroundings_of,
    uniform,
)
from forestgen.community.population import Floats, Indices, Mask, Site, SpeciesEcology, SpeciesIndex
from forestgen.core.compiled import compiled
from forestgen.core.randomness import child_rng

_ROUNDS = 200  # of draws for places on open ground
_MOST_CELLS = 4_000_000
_LEAST_SPACING_M = 0.01  # no two plants stand at one place


def initial_state(
    parameters: BranchModulesParameters, site: Site, species: Sequence[SpeciesEcology], seed: int
) -> State:
    """State of step 0: buildings come first, then the plants at random places, species by species."""
    names = [one.name for one in species]
    kind = np.array([names.index(one.kind) for one in site.buildings], dtype=np.uint16)
    place = np.array([one.position_m for one in site.buildings], dtype=np.float64).reshape(len(kind), 2)
    plants = _new_plants(1, kind, place, site, step=0, modules=0)
    modules = no_modules(len(plants))
    state = State(parameters, site, tuple(species), seed, 0, 1 + len(plants), plants, modules, no_snags(plants))
    growing = [index for index, one in enumerate(species) if one.modules is not None]
    wanted = parameters.counts([names[index] for index in growing]) if growing else np.zeros(0, np.int64)
    refuse_more_modules(int(wanted.sum()), parameters.most_modules)
    sp = np.repeat(np.array(growing, dtype=np.uint16), wanted)
    place = _open_places(len(sp), parameters, site, child_rng(seed, "community", 0))
    notes = () if len(place) == len(sp) else (f"only {len(place)} of {len(sp)} plants found open ground",)
    new, roots = new_seedlings(place, sp[: len(place)], state, step_parameters(state), 0)
    plants, modules, next_id = plants.and_then(new), modules.and_then(roots), state.next_id + len(new)
    return replace(state, next_id=next_id, plants=plants, modules=modules, notes=notes)


def _open_places(count: int, parameters: BranchModulesParameters, site: Site, rng: np.random.Generator) -> Floats:
    """(N, 2) uniform places, metres, where nothing bars plants; fewer than `count` if hardly any ground is open."""
    found, missing = [np.empty((0, 2))], count
    for _ in range(_ROUNDS):
        if missing == 0:
            break
        place = rng.random((missing, 2)) * site.size_m
        found.append(place[_is_open(place, parameters, site)])
        missing -= len(found[-1])
    return np.concatenate(found)


def _is_open(place: Floats, parameters: BranchModulesParameters, site: Site) -> Mask:
    """(N,) whether neither soil nor buildings bar places on the site."""
    is_open = ~is_blocked(parameters.blocked_soil(), place, site.size_m)
    if site.buildings:
        is_open &= ~boxes_of(site).cover(place, site.size_m if parameters.periodic else None)
    return is_open


@dataclass(frozen=True)
class Arriving:
    """Seeds from elsewhere."""

    position_m: Floats  # (N, 2) on the site
    species: SpeciesIndex  # (N,)
    needed: Floats  # (N,) o (Eq. 38) from which on each germinates, 0 to 1


NO_SEEDS = Arriving(np.empty((0, 2)), np.empty(0, np.uint16), np.empty(0))


def _seedlings(
    state: State, now: StepParameters, around: Surroundings, plants: Plants, adapted: Floats, trunk_m: Floats,
    alive: Mask, arriving: Arriving,
) -> tuple[Plants, Modules]:  # fmt: skip
    """The plants that germinate in a step: first of the seeds that fall, then of those that arrive.

    `plants` are all of the step, those that die in it too, whose last seeds fall; `adapted` (P,) is how well the
    climate suits them, `trunk_m` (P,) the diameters of their stems at the foot, metres; those `alive` (P,) take room.
    """
    traits, parameters = now.traits, now.parameters
    sp, rng = plants.species, child_rng(state.seed, "community", state.step + 1)
    mean = np.where(plants.flowering, traits.seeds_per_yr[sp] * adapted * parameters.step_yr, 0.0)
    refuse_more_seeds(float(mean.sum()) + len(arriving.species))
    count = rng.poisson(mean)
    mother = np.repeat(np.arange(len(plants)), count)
    place = plants.position_m[mother] + rng.normal(size=(len(mother), 2)) * traits.seeding_radius_m[sp[mother], None]
    size = np.array(state.site.size_m)
    if parameters.periodic:
        place %= size
        place[place >= size] = 0.0
    place, species = np.concatenate([place, arriving.position_m]), np.concatenate([sp[mother], arriving.species])
    needed = np.concatenate([np.zeros(len(mother)), arriving.needed])
    fit = _germinates(place, species, needed, state, now, around)
    place, species = place[fit], species[fit]
    own = int(fit[: len(mother)].sum())
    # By chance, not by mothers' rows, which go by species; and those of the stand as if no others arrived.
    order = np.concatenate([rng.permutation(own), own + rng.permutation(len(place) - own)])
    room = np.empty(len(place), dtype=np.bool_)
    half_m = 0.5 * trunk_m[alive]
    room[order] = _with_room(place[order], plants.position_m[alive], half_m, parameters, state.site.size_m)
    return new_seedlings(place[room], species[room], state, now, state.step + 1)


def _germinates(
    place: Floats, species: SpeciesIndex, needed: Floats, state: State, now: StepParameters, around: Surroundings
) -> Mask:
    """(N,) whether ground, climate and light let a seed germinate, which needs so much of o."""
    traits, parameters = now.traits, now.parameters
    fit: Mask = np.all((place >= 0) & (place <= state.site.size_m), axis=1)
    at = np.flatnonzero(fit)
    fit[at] = _is_open(place[at], parameters, state.site)
    at = np.flatnonzero(fit)
    ground = ground_at(state.site, place[at])
    adapted, leaf_share = adaptation(now, species[at], place[at], ground, around)
    suits = adapted >= np.maximum(needed[at], parameters.adaptation_min)
    tolerance = traits.shade_tolerance[species[at]]
    light = leaf_share * (tolerance + (1 - tolerance) * around.light_at(place[at]))
    point = traits.compensation[species[at]]
    enough = traits.sprouting[species[at]] * traits.vigour_min[species[at]]
    fit[at] = suits & ((light - point) / (1 - point) > enough)
    return fit


def _with_room(
    place: Floats, taken: Floats, trunk_m: Floats, parameters: BranchModulesParameters, size_m: tuple[float, float]
) -> Mask:
    """(N,) which seeds, in their order, lie far enough from plants and from the seeds before them."""
    keep = np.zeros(len(place), dtype=np.bool_)
    if not len(place):
        return keep
    spacing, (width, height) = max(parameters.seedling_spacing_m, _LEAST_SPACING_M), size_m
    side = max(spacing + float(trunk_m.max(initial=0.0)), (width * height / _MOST_CELLS) ** 0.5)
    cells = max(1, floor(width / side)), max(1, floor(height / side))
    _settle(place, taken, trunk_m, spacing, width, height, cells, parameters.periodic, keep)
    return keep


@compiled
def _cell(x, y, width, height, cells):  # type: ignore[no-untyped-def]
    a, b = floor(x / width * cells[0]), floor(y / height * cells[1])
    return min(max(a, 0), cells[0] - 1), min(max(b, 0), cells[1] - 1)


@compiled
def _settle(place, taken, trunk, spacing, width, height, cells, periodic, keep):  # type: ignore[no-untyped-def]
    """Set `keep`; the plants that are there and the seeds that are kept lie in lists of the cells of a grid."""
    nx, ny = cells
    n = len(taken)
    head = np.full(nx * ny, -1, dtype=np.int64)
    following = np.empty(n + len(place), dtype=np.int64)
    for i in range(n):
        a, b = _cell(taken[i, 0], taken[i, 1], width, height, cells)
        following[i] = head[b * nx + a]
        head[b * nx + a] = i
    for k in range(len(place)):
        x, y = place[k, 0], place[k, 1]
        a, b = _cell(x, y, width, height, cells)
        free = True
        for other_b in range(b - 1, b + 2):
            for other_a in range(a - 1, a + 2):
                if not periodic and not (0 <= other_a < nx and 0 <= other_b < ny):
                    continue
                i = head[other_b % ny * nx + other_a % nx]
                while i >= 0 and free:
                    other = taken[i] if i < n else place[i - n]
                    dx, dy = abs(other[0] - x), abs(other[1] - y)
                    if periodic:
                        dx, dy = min(dx, width - dx), min(dy, height - dy)
                    reach = spacing + (trunk[i] if i < n else 0.0)
                    free = dx * dx + dy * dy >= reach * reach
                    i = following[i]
        if free:
            keep[k] = True
            following[n + k] = head[b * nx + a]
            head[b * nx + a] = n + k


def new_seedlings(
    place: Floats, species: SpeciesIndex, state: State, now: StepParameters, step: int
) -> tuple[Plants, Modules]:
    """Plants that begin, numbered from the state's next id: upright root modules, and seeds of no age."""
    plants = _new_plants(state.next_id, species, place, state.site, step=step, modules=1)
    traits, n = now.traits, len(plants)
    prototype = choose_prototype(
        load_prototypes(), traits.apical_control[species], traits.determinacy[species], allowed=now.allowed[species]
    )
    up = np.broadcast_to(np.array([0.0, 0.0, 1.0]), (n, 3))
    roll_rad = 2 * np.pi * uniform(state.seed, plants.plant_id, np.zeros(n, dtype=np.uint32))
    return plants, seedling_modules(prototype, orientation_along(up, roll_rad))


def _new_plants(first_id: int, species: SpeciesIndex, place: Floats, site: Site, *, step: int, modules: int) -> Plants:
    """Plants that arrive in a step, of no size, with so many modules each."""
    n = len(place)
    return Plants(
        plant_id=new_ids(first_id, n),
        species=species,
        position_m=np.ascontiguousarray(place),
        ground_m=ground_at(site, place),
        born=np.full(n, step, dtype=np.int32),
        flowering=np.zeros(n, dtype=np.bool_),
        next_number=np.full(n, modules, dtype=np.uint32),
        adaptation=np.ones(n, dtype=np.float32),
        tallest_m=np.zeros(n, dtype=np.float32),
    )


def step_forest(state: State, climate: LocalClimate | None = None, arriving: Arriving = NO_SEEDS) -> State:
    """The state one step later; `state` itself is left as it was.

    Without a `climate` by place it is that of the parameters. `arriving` are seeds from elsewhere, which germinate
    where others of their species would.
    """
    now = step_parameters(state)
    plants, modules, traits = state.plants, state.modules, now.traits
    species, counts = plants.species, np.diff(modules.first)
    stature = stature_of(modules, species, now)
    around = surroundings_of(state, now, stature.leaves, climate)
    feet = plants.position_m, plants.ground_m
    adapted, leaf_share = adaptation(now, species, *feet, around)
    light = np.repeat(traits.shade_tolerance[species].astype(np.float32), counts)
    light += (1 - light) * around.light
    most = traits.root_vigour_max[species] * adapted * _vitality(state, now)
    used = light * np.repeat(leaf_share.astype(np.float32), counts)
    gain = net_gain(used, species, modules.first, now)
    flow = distribute(modules, gain, stature, species, most, _form(plants, now)[0], now)
    ready = flow.vigour / stature.size
    pace = growth.pace_of(state.seed, plants.plant_id, species, now)
    wood = replace(modules, age=growth.grow(modules, ready, species, pace, now))
    wood, diameter_m = growth.overgrown(modules, wood, species, now)
    keep, disused_m2 = growth.shed(wood, ready, diameter_m, species, now)
    rows = growth.rows_after(wood, keep, flow.sprouts, plants.next_number)
    aged = replace(wood, vigour=flow.vigour, light=light, disused_m2=disused_m2)
    plants = replace(
        plants,
        next_number=rows.next_number,
        flowering=plants.flowering | _flowers(state, now, flow),
        adaptation=np.where(traits.grows[species], adapted, 1.0).astype(np.float32),
    )
    modules = _after(aged, rows, plants, state, now, around)
    withered, tallest_m = growth.died_back(plants, modules, now)
    plants = replace(plants, tallest_m=tallest_m)
    alive = ((np.diff(rows.first) > 0) | ~traits.grows[species]) & ~withered
    trunk_m = np.zeros(len(plants))
    trunk_m[counts > 0] = diameter_m[aged.first[:-1][counts > 0]]
    new, seeded = _seedlings(state, now, around, plants, adapted, trunk_m, alive, arriving)
    snags = growth.snags_after(state, now, plants, wood, alive)
    if not alive.all():
        modules, plants = modules.of_plants(alive), plants.where(alive)
    modules = modules.and_then(seeded)
    refuse_more_modules(len(modules) + len(snags.modules), now.parameters.most_modules)
    step, next_id = state.step + 1, state.next_id + len(new)
    return replace(state, step=step, next_id=next_id, plants=plants.and_then(new), modules=modules, snags=snags)


def _vitality(state: State, now: StepParameters) -> Floats:
    """(P,) share of its greatest vigour that each plant has at its age: 1, and after its life span less and less."""
    age_yr = (state.step + 1 - state.plants.born) * now.parameters.step_yr
    late = (age_yr - now.traits.life_span_yr[state.plants.species]) / now.parameters.senescence_yr
    return np.asarray(np.clip(1.0 - late, 0.0, 1.0))


def _form(plants: Plants, now: StepParameters) -> tuple[Floats, Floats]:
    """Apical control and determinacy of each plant, (P,) each: the mature ones once it flowers."""
    traits, sp = now.traits, plants.species
    control = np.where(plants.flowering, traits.apical_control_mature[sp], traits.apical_control[sp])
    return control, np.where(plants.flowering, traits.determinacy_mature[sp], traits.determinacy[sp])


def _flowers(state: State, now: StepParameters, flow: Flow) -> Mask:
    """(P,) whether a plant has reached its flowering age: the later, the less vigour its grown root module has."""
    plants, modules, traits = state.plants, state.modules, now.traits
    out = np.zeros(len(plants), dtype=np.bool_)
    rooted = np.flatnonzero(np.diff(modules.first) > 0)
    root, sp = modules.first[rooted], plants.species[rooted]
    with np.errstate(divide="ignore"):
        delay = np.minimum(traits.root_vigour_max[sp] / flow.vigour[root], traits.flowering_delay_max[sp])
    age_yr = (state.step + 1 - plants.born[rooted]) * now.parameters.step_yr
    old = age_yr >= traits.flowering_age_yr[sp] * np.maximum(delay, 1.0)
    out[rooted] = old & (modules.age[root] >= traits.mature_age[sp])
    return out


def _after(
    modules: Modules, rows: NextRows, plants: Plants, state: State, now: StepParameters, around: Surroundings
) -> Modules:
    """The modules that stay, those that grow and bear nothing turned a little more, and those that begin."""
    new = np.flatnonzero(rows.new)
    names = ("prototype", "age", "age_yr", "base_m", "rotation", "vigour", "light", "disused_m2")
    columns = {name: getattr(modules, name)[rows.source] for name in names}
    columns["age_yr"] += np.float32(now.parameters.step_yr)
    for name in ("age", "age_yr", "vigour", "light", "disused_m2"):
        columns[name][new] = 0.0
    after = Modules(first=rows.first, number=rows.number, parent=rows.parent, node=rows.node, **columns)
    if len(new):
        _begin(after, new, modules, rows, plants, state, now)
    _turn(after, new, rows, state, now, around)
    return after


def _begin(
    after: Modules, new: Indices, modules: Modules, rows: NextRows, plants: Plants, state: State, now: StepParameters
) -> None:
    """Give new modules, rows `new` of `after`, their prototype, their place and their first orientation."""
    bearer = rows.source[new]
    plant = np.searchsorted(rows.first, new, side="right") - 1
    sp = plants.species[plant]
    control, determinacy = _form(plants, now)
    share = np.minimum(modules.vigour[bearer] / now.traits.vigour_max[sp], 1.0)
    after.base_m[new], direction = terminal_pose(
        now.tables, sp, modules.prototype[bearer], modules.base_m[bearer], modules.rotation[bearer], rows.node[new]
    )
    after.prototype[new] = choose_prototype(
        load_prototypes(), control[plant], share * determinacy[plant], allowed=now.allowed[sp]
    )
    roll_rad = 2 * np.pi * uniform(state.seed, plants.plant_id[plant], rows.number[new])
    after.rotation[new] = orientation_along(direction, roll_rad)


def _turn(
    after: Modules, new: Indices, rows: NextRows, state: State, now: StepParameters, around: Surroundings
) -> None:
    """Turn new modules, then by fewer steps those that grow too: all by the spheres at the step's beginning."""
    parameters = now.parameters
    if not parameters.orient or len(after) == 0:
        return
    kind = np.repeat(state.plants.species, np.diff(after.first))
    axis = growth.on_axis(after, now.main_path)
    growing = (after.age < now.traits.mature_age[kind]) & (after.parent >= 0)
    together = min(parameters.turning_steps, parameters.orientation_steps)
    for chosen, steps in (
        (new, parameters.orientation_steps - together),
        (np.flatnonzero(growing), parameters.turning_steps),
    ):
        if steps and len(chosen):
            turning = _turning(after, chosen, rows, state, now, axis[chosen])
            after.rotation[chosen] = orient(
                around.grid, turning, steps=steps, angle_rad=parameters.turn_rad, boxes=around.boxes
            )


def _turning(
    after: Modules, chosen: Indices, rows: NextRows, state: State, now: StepParameters, is_axis: Mask
) -> Turning:
    """The modules in rows `chosen` of `after`; `is_axis` (N,) says whether they continue the plant's main axis."""
    traits, tables, plants = now.traits, now.tables, state.plants
    born, source, bearer = rows.new[chosen], rows.source[chosen], state.modules.parent_row()
    plant = np.searchsorted(after.first, chosen, side="right") - 1
    kind, prototype = plants.species[plant], after.prototype[chosen]
    leads = is_axis & (traits.apical_control[kind] > 0.5)
    return Turning(
        base_world_m=np.column_stack([plants.position_m[plant], plants.ground_m[plant]]) + after.base_m[chosen],
        rotation=after.rotation[chosen],
        centre_m=tables.grown_spheres_m[0][kind, prototype],
        radius_m=tables.grown_spheres_m[1][kind, prototype],
        row=np.where(born, -1, source),
        parent_row=np.where(born, source, bearer[source]),
        # The leader goes up, whatever stands beside it: an angle and room are what its branches turn to.
        tropism_angle_rad=np.where(leads, 0.0, traits.tropism_angle_rad[kind]),
        tropism_weight=traits.tropism_weight[kind],
        collision_weight=np.where(leads, 0.0, traits.collision_weight[kind]),
        ground_m=plants.ground_m[plant],
    )
