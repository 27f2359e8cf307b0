"""How plants begin: the first ones at random places, and seeds (Makowski 2023, 2.6.3, 2.6.4).

Seeds: how many fall, where, which of them germinate, and what a plant begins with.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import floor

import numpy as np

from forestgen.architecture.modules import Modules
from forestgen.architecture.prototypes import choose_prototype, load_prototypes
from forestgen.community.arrivals import new_ids
from forestgen.community.branch_modules.parameters import BranchModulesParameters, is_blocked
from forestgen.community.branch_modules.state import (
    Plants,
    State,
    StepParameters,
    no_modules,
    no_snags,
    orientation_along,
    refuse_more_modules,
    refuse_more_seeds,
    seedling_modules,
    step_parameters,
    uniform,
)
from forestgen.community.branch_modules.surroundings import Surroundings, adaptation, boxes_of, ground_at
from forestgen.community.ecology import SpeciesEcology
from forestgen.community.model import Site
from forestgen.community.population import Floats, Mask, SpeciesIndex
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
class Standing:
    """The plants of a step, those that die in it too: their last seeds fall."""

    plants: Plants
    adapted: Floats  # (P,) how well the climate suits them
    trunk_m: Floats  # (P,) diameters of their stems at the foot, metres
    alive: Mask  # (P,) which stay, and take room


@dataclass(frozen=True)
class Arriving:
    """Seeds from elsewhere."""

    position_m: Floats  # (N, 2) on the site
    species: SpeciesIndex  # (N,)
    needed: Floats  # (N,) o (Eq. 38) from which on each germinates, 0 to 1


NO_SEEDS = Arriving(np.empty((0, 2)), np.empty(0, np.uint16), np.empty(0))


def seedlings(
    state: State, now: StepParameters, around: Surroundings, standing: Standing, arriving: Arriving
) -> tuple[Plants, Modules]:
    """The plants that germinate in a step: first of the seeds that fall, then of those that arrive."""
    traits, parameters, plants = now.traits, now.parameters, standing.plants
    sp, rng = plants.species, child_rng(state.seed, "community", state.step + 1)
    mean = np.where(plants.flowering, traits.seeds_per_yr[sp] * standing.adapted * parameters.step_yr, 0.0)
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
    alive = standing.alive
    own = int(fit[: len(mother)].sum())
    # By chance, not by mothers' rows, which go by species; and those of the stand as if no others arrived.
    order = np.concatenate([rng.permutation(own), own + rng.permutation(len(place) - own)])
    room = np.empty(len(place), dtype=np.bool_)
    trunk_m = 0.5 * standing.trunk_m[alive]
    room[order] = _with_room(place[order], plants.position_m[alive], trunk_m, parameters, state.site.size_m)
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
    return min(max(floor(x / width * cells[0]), 0), cells[0] - 1), min(
        max(floor(y / height * cells[1]), 0), cells[1] - 1
    )


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
