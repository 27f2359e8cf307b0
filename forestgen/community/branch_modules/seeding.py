"""Seeds: how many fall, where, which of them germinate, and what a plant begins with (Makowski 2023, 2.6.3, 2.6.4)."""

from __future__ import annotations

from dataclasses import dataclass
from math import floor
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from forestgen.architecture.modules import Modules
from forestgen.architecture.prototypes import choose_prototype
from forestgen.community.arrivals import new_ids
from forestgen.community.branch_modules.climate import LocalClimate, adaptation
from forestgen.community.branch_modules.identity import along, uniform
from forestgen.community.branch_modules.parameters import is_blocked
from forestgen.community.branch_modules.state import Plants, State, refuse_more_seeds, seedling_modules
from forestgen.community.branch_modules.surroundings import ground_at
from forestgen.core.compiled import compiled

if TYPE_CHECKING:
    from forestgen.community.branch_modules.kinds import Kinds
    from forestgen.community.branch_modules.surroundings import Surroundings

Floats = NDArray[np.float64]
_MOST_CELLS = 4_000_000
_LEAST_SPACING_M = 0.01  # no two plants stand at one place


@dataclass(frozen=True)
class Standing:
    """The plants of a step, those that die in it too: their last seeds fall."""

    plants: Plants
    adapted: Floats  # (P,) how well the climate suits them
    trunk_m: Floats  # (P,) diameters of their stems at the foot, metres
    alive: NDArray[np.bool_]  # (P,) who stays, and takes room


@dataclass(frozen=True)
class Arriving:
    """Seeds from elsewhere."""

    position_m: Floats  # (N, 2) on the site
    species: NDArray[np.uint16]  # (N,)
    needed: Floats  # (N,) o (Eq. 38) from which on each germinates, 0 to 1


NOBODY = Arriving(np.empty((0, 2)), np.empty(0, np.uint16), np.empty(0))


def seedlings(
    state: State,
    kinds: Kinds,
    around: Surroundings,
    standing: Standing,
    climate: LocalClimate | None,
    arriving: Arriving,
    rng: np.random.Generator,
) -> tuple[Plants, Modules]:
    """The plants that germinate in a step: first of the seeds that fall, then of those that arrive."""
    traits, parameters, plants = kinds.traits, kinds.parameters, standing.plants
    sp = plants.species
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
    fit = _germinates(place, species, needed, state, kinds, around, climate)
    place, species = place[fit], species[fit]
    alive = standing.alive
    own = int(fit[: len(mother)].sum())
    # By chance, not by mothers' rows, which go by species; and those of the stand as if no others arrived.
    order = np.concatenate([rng.permutation(own), own + rng.permutation(len(place) - own)])
    room = np.empty(len(place), dtype=np.bool_)
    room[order] = _with_room(place[order], plants.position_m[alive], 0.5 * standing.trunk_m[alive], state, kinds)
    return begun(place[room], species[room], state, kinds, state.step + 1)


def _germinates(
    place: Floats,
    species: NDArray[np.uint16],
    needed: Floats,
    state: State,
    kinds: Kinds,
    around: Surroundings,
    climate: LocalClimate | None,
) -> NDArray[np.bool_]:
    """(N,) whether ground, climate and light let a seed germinate, which needs so much of o."""
    size, traits, parameters = state.site.size_m, kinds.traits, kinds.parameters
    fit: NDArray[np.bool_] = np.all((place >= 0) & (place <= size), axis=1)
    at = np.flatnonzero(fit)
    open_soil = ~is_blocked(parameters.blocked_soil(), place[at, 0], place[at, 1], size)
    if len(around.boxes):
        open_soil &= ~around.boxes.cover(place[at], size if parameters.periodic else None)
    fit[at] = open_soil
    at = np.flatnonzero(fit)
    ground = ground_at(state.site, place[at])
    adapted, leaf_share = adaptation(parameters, traits, species[at], place[at], ground, around, climate)
    suits = adapted >= np.maximum(needed[at], parameters.adaptation_min)
    tolerance = traits.shade_tolerance[species[at]]
    light = leaf_share * (tolerance + (1 - tolerance) * around.light_at(place[at]))
    point = traits.compensation[species[at]]
    enough = traits.sprouting[species[at]] * traits.vigour_min[species[at]]
    fit[at] = suits & ((light - point) / (1 - point) > enough)
    return fit


def _with_room(place: Floats, taken: Floats, trunk_m: Floats, state: State, kinds: Kinds) -> NDArray[np.bool_]:
    """(N,) which seeds, in their order, lie far enough from plants and from the seeds before them."""
    keep = np.zeros(len(place), dtype=np.bool_)
    if not len(place):
        return keep
    spacing = max(kinds.parameters.seedling_spacing_m, _LEAST_SPACING_M)
    width, height = state.site.size_m
    side = max(spacing + float(trunk_m.max(initial=0.0)), (width * height / _MOST_CELLS) ** 0.5)
    cells = max(1, floor(width / side)), max(1, floor(height / side))
    _settle(place, taken, trunk_m, spacing, width, height, cells, kinds.parameters.periodic, keep)
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


def begun(place: Floats, species: NDArray[np.uint16], state: State, kinds: Kinds, step: int) -> tuple[Plants, Modules]:
    """Plants that begin, numbered from the state's next id: upright root modules, and seeds of no age."""
    n = len(place)
    ids = new_ids(state.next_id, n)
    zeros = np.zeros(n, dtype=np.uint32)
    plants = Plants(
        plant_id=ids,
        species=species,
        position_m=np.ascontiguousarray(place),
        ground_m=ground_at(state.site, place),
        born=np.full(n, step, dtype=np.int32),
        flowering=np.zeros(n, dtype=np.bool_),
        next_number=zeros + np.uint32(1),
        adaptation=np.ones(n, dtype=np.float32),
        tallest_m=np.zeros(n, dtype=np.float32),
    )
    traits = kinds.traits
    prototype = choose_prototype(
        state.prototypes, traits.apical_control[species], traits.determinacy[species], allowed=kinds.allowed[species]
    )
    up = np.broadcast_to(np.array([0.0, 0.0, 1.0]), (n, 3))
    return plants, seedling_modules(prototype, along(up, 2 * np.pi * uniform(state.seed, ids, zeros)))
