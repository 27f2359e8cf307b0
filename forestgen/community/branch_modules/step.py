"""One step of all plants and modules: light, vigour, growth, shedding, new modules, turning, seeds, death."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from forestgen.architecture.geometry import terminal_pose
from forestgen.architecture.modules import Modules
from forestgen.architecture.prototypes import choose_prototype
from forestgen.community.branch_modules.climate import LocalClimate, adaptation
from forestgen.community.branch_modules.growth import Rows, grow, on_axis, rows_after
from forestgen.community.branch_modules.identity import along, uniform
from forestgen.community.branch_modules.kinds import Kinds, kinds_at
from forestgen.community.branch_modules.seeding import NOBODY, Arriving, Standing, seedlings
from forestgen.community.branch_modules.shedding import overgrown, shed
from forestgen.community.branch_modules.snags import died_back, snags_after
from forestgen.community.branch_modules.state import Plants, State, appended, refuse_more_modules, rows_of_plants
from forestgen.community.branch_modules.surroundings import Surroundings, surroundings_of, turned
from forestgen.community.branch_modules.vigour import Flow, distribute, net_gain, stature_of
from forestgen.core.randomness import child_rng


@dataclass(frozen=True)
class Now:
    """What holds in one step, with what its plants see."""

    kinds: Kinds
    around: Surroundings
    adapted: NDArray[np.float64]  # (P,) o of Eq. 13
    light: NDArray[np.float32]  # (M,) effective light exposure
    bearer: NDArray[np.int64]  # (M,) row of the module that bears each, -1 for roots


def advanced(state: State, climate: LocalClimate | None = None, arriving: Arriving = NOBODY) -> State:
    """The state one step later; `state` itself is left as it was.

    Parameters
    ----------
    climate : by place; None: that of the parameters.
    arriving : seeds from elsewhere, which germinate where others of their species would.
    """
    kinds = kinds_at(state)
    plants, modules, traits = state.plants, state.modules, kinds.traits
    species = plants.species
    stature = stature_of(modules, species, kinds.tables, kinds.traits)
    around = surroundings_of(state, kinds, stature.leaves)
    feet = plants.position_m, plants.ground_m
    adapted, leaf_share = adaptation(kinds.parameters, traits, species, *feet, around, climate)
    tolerance = traits.shade_tolerance[species].astype(np.float32)
    light = np.repeat(tolerance, np.diff(modules.first))
    light += (1 - light) * around.light
    now = Now(kinds, around, adapted, light, modules.parent_row())
    most = traits.root_vigour_max[species] * adapted * _vitality(state, kinds)
    used = light * np.repeat(leaf_share.astype(np.float32), np.diff(modules.first))
    gain = net_gain(used, species, modules.first, traits)
    flow = distribute(modules, gain, stature, species, most, _form(plants, kinds)[0], kinds.tables, traits)
    ready = flow.vigour / stature.size
    aged = replace(modules, age=grow(modules, ready, species, traits, kinds.parameters.step_yr))
    aged, diameter_m = overgrown(modules, aged, species, kinds.tables, traits)
    wood = aged
    falls = shed(aged, ready, diameter_m, species, kinds.tables, traits, kinds.parameters.step_yr)
    rows = rows_after(aged, falls.keep, flow.sprouts, plants.next_number)
    aged = replace(aged, vigour=flow.vigour, light=light, disused_m2=falls.disused_m2)
    flowering = plants.flowering | _flowers(state, kinds, flow)
    felt = np.where(traits.grows[species], adapted, 1.0).astype(np.float32)
    plants = replace(plants, next_number=rows.next_number, flowering=flowering, adaptation=felt)
    modules = _after(aged, rows, plants, state, now)
    alive = (np.diff(rows.first) > 0) | ~traits.grows[species]
    withered, tallest_m = died_back(plants, modules, kinds)
    alive, plants = alive & ~withered, replace(plants, tallest_m=tallest_m)
    trunk_m = np.zeros(len(plants))
    trunk_m[np.diff(aged.first) > 0] = diameter_m[aged.first[:-1][np.diff(aged.first) > 0]]
    rng = child_rng(state.seed, "community", state.step + 1)
    standing = Standing(plants, adapted, trunk_m, alive)
    new, seeded = seedlings(state, kinds, around, standing, climate, arriving, rng)
    snags = snags_after(state, kinds, plants, wood, alive)
    if not alive.all():
        modules, plants = rows_of_plants(modules, alive), plants.where(alive)
    modules = appended(modules, seeded)
    refuse_more_modules(len(modules) + len(snags.modules), kinds.parameters.most_modules)
    return replace(
        state,
        step=state.step + 1,
        next_id=state.next_id + len(new),
        plants=plants.and_then(new),
        modules=modules,
        snags=snags,
    )


def _vitality(state: State, kinds: Kinds) -> NDArray[np.float64]:
    """(P,) share of its greatest vigour that each plant has at its age: 1, and after its life span less and less."""
    age_yr = (state.step + 1 - state.plants.born) * kinds.parameters.step_yr
    late = (age_yr - kinds.traits.life_span_yr[state.plants.species]) / kinds.parameters.senescence_yr
    return np.asarray(np.clip(1.0 - late, 0.0, 1.0))


def _form(plants: Plants, kinds: Kinds) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Apical control and determinacy of each plant, (P,) each: the mature ones once it flowers."""
    traits, sp = kinds.traits, plants.species
    control = np.where(plants.flowering, traits.apical_control_mature[sp], traits.apical_control[sp])
    return control, np.where(plants.flowering, traits.determinacy_mature[sp], traits.determinacy[sp])


def _flowers(state: State, kinds: Kinds, flow: Flow) -> NDArray[np.bool_]:
    """(P,) whether a plant has reached its flowering age: the later, the less vigour its grown root module has."""
    plants, modules, traits = state.plants, state.modules, kinds.traits
    out = np.zeros(len(plants), dtype=np.bool_)
    rooted = np.flatnonzero(np.diff(modules.first) > 0)
    root, sp = modules.first[rooted], plants.species[rooted]
    with np.errstate(divide="ignore"):
        delay = np.minimum(traits.root_vigour_max[sp] / flow.vigour[root], traits.flowering_delay_max[sp])
    age_yr = (state.step + 1 - plants.born[rooted]) * kinds.parameters.step_yr
    out[rooted] = (age_yr >= traits.flowering_age_yr[sp] * np.maximum(delay, 1.0)) & (
        modules.age[root] >= traits.mature_age[sp]
    )
    return out


def _after(modules: Modules, rows: Rows, plants: Plants, state: State, now: Now) -> Modules:
    """The modules that stay, those that grow and bear nothing turned a little more, and those that begin."""
    kinds, source = now.kinds, rows.source
    step_yr = kinds.parameters.step_yr
    new = np.flatnonzero(rows.new)
    age, age_yr = modules.age[source], modules.age_yr[source] + np.float32(step_yr)
    vigour, light, disused = modules.vigour[source], modules.light[source], modules.disused_m2[source]
    for column in (age, age_yr, vigour, light, disused):
        column[new] = 0.0
    base_m, rotation, prototype = modules.base_m[source], modules.rotation[source], modules.prototype[source]
    after = Modules(
        rows.first, rows.number, rows.parent, rows.node, prototype, age, age_yr, base_m, rotation, vigour, light,
        disused,
    )  # fmt: skip
    if len(new):
        _begin(after, new, modules, rows, plants, state, now)
    _turn(after, new, rows, state, now)
    return after


def _begin(
    after: Modules, new: NDArray[np.int64], modules: Modules, rows: Rows, plants: Plants, state: State, now: Now
) -> None:
    """Give new modules, rows `new` of `after`, their prototype, their place and the attitude that they begin with."""
    kinds, bearer = now.kinds, rows.source[new]
    plant = np.searchsorted(rows.first, new, side="right") - 1
    sp = plants.species[plant]
    control, determinacy = _form(plants, kinds)
    share = np.minimum(modules.vigour[bearer] / kinds.traits.vigour_max[sp], 1.0)
    after.base_m[new], direction = terminal_pose(
        kinds.tables, sp, modules.prototype[bearer], modules.base_m[bearer], modules.rotation[bearer], rows.node[new]
    )
    after.prototype[new] = choose_prototype(
        state.prototypes, control[plant], share * determinacy[plant], allowed=kinds.allowed[sp]
    )
    roll_rad = 2 * np.pi * uniform(state.seed, plants.plant_id[plant], rows.number[new])
    after.rotation[new] = along(direction, roll_rad)


def _turn(after: Modules, new: NDArray[np.int64], rows: Rows, state: State, now: Now) -> None:
    """Turn new modules, then by fewer steps those that grow too: all by the spheres at the step's beginning."""
    kinds, parameters = now.kinds, now.kinds.parameters
    if not parameters.orient or len(after) == 0:
        return
    kind = np.repeat(state.plants.species, np.diff(after.first))
    axis = on_axis(after, kinds.main_path)
    growing = (after.age < kinds.traits.mature_age[kind]) & (after.parent >= 0)
    together = min(parameters.turning_steps, parameters.orientation_steps)
    for chosen, steps in (
        (new, parameters.orientation_steps - together),
        (np.flatnonzero(growing), parameters.turning_steps),
    ):
        if steps and len(chosen):
            born, source = rows.new[chosen], rows.source[chosen]
            bearer = np.where(born, source, now.bearer[source])
            former = np.where(born, -1, source), bearer
            after.rotation[chosen] = turned(now.around, kinds, after, chosen, state, former, axis[chosen], steps)
