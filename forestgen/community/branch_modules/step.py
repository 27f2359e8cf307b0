"""One step of all plants and modules: light, vigour, growth, shedding, new modules, turning, seeds, death."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from forestgen.architecture.geometry import terminal_pose
from forestgen.architecture.modules import Modules
from forestgen.architecture.prototypes import choose_prototype, load_prototypes
from forestgen.community.branch_modules.growth import (
    NextRows,
    died_back,
    grow,
    on_axis,
    overgrown,
    rows_after,
    shed,
    snags_after,
)
from forestgen.community.branch_modules.orientation import Turning, orient
from forestgen.community.branch_modules.seeding import NO_SEEDS, Arriving, Standing, seedlings
from forestgen.community.branch_modules.state import (
    Plants,
    State,
    StepParameters,
    orientation_along,
    refuse_more_modules,
    step_parameters,
    uniform,
)
from forestgen.community.branch_modules.surroundings import LocalClimate, Surroundings, adaptation, surroundings_of
from forestgen.community.branch_modules.vigour import Flow, distribute, net_gain, stature_of
from forestgen.core.randomness import child_rng


@dataclass(frozen=True)
class StepContext:
    """What holds in one step, with what its plants see."""

    now: StepParameters
    around: Surroundings
    bearer: NDArray[np.int64]  # (M,) row of the module that bears each, -1 for roots


def step_forest(state: State, climate: LocalClimate | None = None, arriving: Arriving = NO_SEEDS) -> State:
    """The state one step later; `state` itself is left as it was.

    Without a `climate` by place it is that of the parameters. `arriving` are seeds from elsewhere, which germinate
    where others of their species would.
    """
    now = step_parameters(state)
    plants, modules, traits, tables = state.plants, state.modules, now.traits, now.tables
    species, counts, step_yr = plants.species, np.diff(modules.first), now.parameters.step_yr
    stature = stature_of(modules, species, tables, traits)
    around = surroundings_of(state, now, stature.leaves)
    feet = plants.position_m, plants.ground_m
    adapted, leaf_share = adaptation(now.parameters, traits, species, *feet, around, climate)
    light = np.repeat(traits.shade_tolerance[species].astype(np.float32), counts)
    light += (1 - light) * around.light
    most = traits.root_vigour_max[species] * adapted * _vitality(state, now)
    used = light * np.repeat(leaf_share.astype(np.float32), counts)
    gain = net_gain(used, species, modules.first, traits)
    flow = distribute(modules, gain, stature, species, most, _form(plants, now)[0], tables, traits)
    ready = flow.vigour / stature.size
    wood = replace(modules, age=grow(modules, ready, species, traits, step_yr))
    wood, diameter_m = overgrown(modules, wood, species, tables, traits)
    keep, disused_m2 = shed(wood, ready, diameter_m, species, tables, traits, step_yr)
    rows = rows_after(wood, keep, flow.sprouts, plants.next_number)
    aged = replace(wood, vigour=flow.vigour, light=light, disused_m2=disused_m2)
    plants = replace(
        plants,
        next_number=rows.next_number,
        flowering=plants.flowering | _flowers(state, now, flow),
        adaptation=np.where(traits.grows[species], adapted, 1.0).astype(np.float32),
    )
    modules = _after(aged, rows, plants, state, StepContext(now, around, modules.parent_row()))
    withered, tallest_m = died_back(plants, modules, now)
    plants = replace(plants, tallest_m=tallest_m)
    alive = ((np.diff(rows.first) > 0) | ~traits.grows[species]) & ~withered
    trunk_m = np.zeros(len(plants))
    trunk_m[counts > 0] = diameter_m[aged.first[:-1][counts > 0]]
    rng = child_rng(state.seed, "community", state.step + 1)
    standing = Standing(plants, adapted, trunk_m, alive)
    new, seeded = seedlings(state, now, around, standing, climate, arriving, rng)
    snags = snags_after(state, now, plants, wood, alive)
    if not alive.all():
        modules, plants = modules.of_plants(alive), plants.where(alive)
    modules = modules.and_then(seeded)
    refuse_more_modules(len(modules) + len(snags.modules), now.parameters.most_modules)
    step, next_id = state.step + 1, state.next_id + len(new)
    return replace(state, step=step, next_id=next_id, plants=plants.and_then(new), modules=modules, snags=snags)


def _vitality(state: State, now: StepParameters) -> NDArray[np.float64]:
    """(P,) share of its greatest vigour that each plant has at its age: 1, and after its life span less and less."""
    age_yr = (state.step + 1 - state.plants.born) * now.parameters.step_yr
    late = (age_yr - now.traits.life_span_yr[state.plants.species]) / now.parameters.senescence_yr
    return np.asarray(np.clip(1.0 - late, 0.0, 1.0))


def _form(plants: Plants, now: StepParameters) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Apical control and determinacy of each plant, (P,) each: the mature ones once it flowers."""
    traits, sp = now.traits, plants.species
    control = np.where(plants.flowering, traits.apical_control_mature[sp], traits.apical_control[sp])
    return control, np.where(plants.flowering, traits.determinacy_mature[sp], traits.determinacy[sp])


def _flowers(state: State, now: StepParameters, flow: Flow) -> NDArray[np.bool_]:
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


def _after(modules: Modules, rows: NextRows, plants: Plants, state: State, context: StepContext) -> Modules:
    """The modules that stay, those that grow and bear nothing turned a little more, and those that begin."""
    new = np.flatnonzero(rows.new)
    names = ("prototype", "age", "age_yr", "base_m", "rotation", "vigour", "light", "disused_m2")
    columns = {name: getattr(modules, name)[rows.source] for name in names}
    columns["age_yr"] += np.float32(context.now.parameters.step_yr)
    for name in ("age", "age_yr", "vigour", "light", "disused_m2"):
        columns[name][new] = 0.0
    after = Modules(first=rows.first, number=rows.number, parent=rows.parent, node=rows.node, **columns)
    if len(new):
        _begin(after, new, modules, rows, plants, state, context.now)
    _turn(after, new, rows, state, context)
    return after


def _begin(
    after: Modules,
    new: NDArray[np.int64],
    modules: Modules,
    rows: NextRows,
    plants: Plants,
    state: State,
    now: StepParameters,
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


def _turn(after: Modules, new: NDArray[np.int64], rows: NextRows, state: State, context: StepContext) -> None:
    """Turn new modules, then by fewer steps those that grow too: all by the spheres at the step's beginning."""
    now, around, parameters = context.now, context.around, context.now.parameters
    if not parameters.orient or len(after) == 0:
        return
    kind = np.repeat(state.plants.species, np.diff(after.first))
    axis = on_axis(after, now.main_path)
    growing = (after.age < now.traits.mature_age[kind]) & (after.parent >= 0)
    together = min(parameters.turning_steps, parameters.orientation_steps)
    for chosen, steps in (
        (new, parameters.orientation_steps - together),
        (np.flatnonzero(growing), parameters.turning_steps),
    ):
        if steps and len(chosen):
            turning = _turning(after, chosen, rows, state, context, axis[chosen])
            after.rotation[chosen] = orient(
                around.grid, turning, steps=steps, angle_rad=parameters.turn_rad, boxes=around.boxes
            )


def _turning(
    after: Modules,
    chosen: NDArray[np.int64],
    rows: NextRows,
    state: State,
    context: StepContext,
    is_axis: NDArray[np.bool_],
) -> Turning:
    """The modules in rows `chosen` of `after`; `is_axis` (N,) says whether they continue the plant's main axis."""
    traits, tables, plants = context.now.traits, context.now.tables, state.plants
    born, source = rows.new[chosen], rows.source[chosen]
    plant = np.searchsorted(after.first, chosen, side="right") - 1
    kind, prototype = plants.species[plant], after.prototype[chosen]
    return Turning(
        base_world_m=np.column_stack([plants.position_m[plant], plants.ground_m[plant]]) + after.base_m[chosen],
        rotation=after.rotation[chosen],
        centre_m=tables.grown_spheres_m[0][kind, prototype],
        radius_m=tables.grown_spheres_m[1][kind, prototype],
        row=np.where(born, -1, source),
        parent_row=np.where(born, source, context.bearer[source]),
        # The leader goes up: an angle from the vertical is what its branches have.
        tropism_angle_rad=np.where(is_axis & (traits.apical_control[kind] > 0.5), 0.0, traits.tropism_angle_rad[kind]),
        tropism_weight=traits.tropism_weight[kind],
        collision_weight=traits.collision_weight[kind],
        ground_m=plants.ground_m[plant],
    )
