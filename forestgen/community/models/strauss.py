"""The Strauss process: plants of a species repel each other within a distance, with given strength.

Reference: D. J. Strauss, A model for clustering, Biometrika 62, 1975; F. P. Kelly and B. D. Ripley, Biometrika 63,
1976; Baddeley, Rubak and Turner 2015, Spatial Point Patterns, ch. 13.

Of n plants of a species at x_1 ... x_n the probability density is in proportion to

    f(x_1) ... f(x_n) γ^s,    s the number of pairs nearer than r,

with f the density, map times conditions. γ = 1 is `uniform`, γ = 0 a hard core: no pair at all is nearer. The pattern
is what a Markov chain has come to that starts from random places (Metropolis and others 1953): plant by plant, a new
place x' instead of x is proposed and taken with probability

    min(1, γ^(s' - s))              for x' drawn from f, in every other sweep;
    min(1, γ^(s' - s) f(x') / f(x)) for x' in a square of half width r around x, in the others.

Parameters: see below; γ is gamma, r is interaction_radius_m. f and n are those of `plants`. Radii and
heights follow from the species' max_radius_m and height_m.

Recipe::

    community: {model: strauss, gamma: 0.05, interaction_radius_m: 1.2, plants: {daisy: {count: 400}}}

Decisions
---------
- The number is given: the process conditional on n, where no intensity has to be found.
- A sweep proposes one place to each plant. 200 sweeps are many for all but crowded hard cores (n π r² / 4 above about
  a third of the ground), which freeze: more sweeps get them nearer to equilibrium.
- With γ = 0 pairs of the start can only be dissolved, never made. Plants that are still too near in the end are taken
  away, the smallest first, and a note says how many are left.
- r is half of sqrt(area / n) where it is not given, for each species its own.
- Species are independent of one another. Sizes are independent of places: r is not a plant's radius.
- A proposal takes about a microsecond, and longer with many neighbours within r: 100,000 plants take some 20 s. A
  recipe of more than 2 · 10^10 looks at a neighbour, a minute or so, is refused.
"""

from __future__ import annotations

import math

import numpy as np
from pydantic import Field

from forestgen.community.placement.densities import COUNTING_CELLS, grid_shape, plant_counts, species_density
from forestgen.community.placement.field import DensityField
from forestgen.community.placement.model import GriddedModel, GriddedParameters, stays_apart
from forestgen.community.population import Ecologies, Floats, Site
from forestgen.core.compiled import compiled, unowned_view
from forestgen.core.errors import RecipeError
from forestgen.recipe.fields import Fraction, Positive, Whole

_DRAWN_AT_ONCE = 200_000  # places of the density
_MOST_MEETINGS = 2e10  # of a plant with one that may be near, in all sweeps: about a minute


class StraussParameters(GriddedParameters):
    """What a recipe says about the model besides its species."""

    gamma: Fraction = Field(0.1, description="factor of probability for each pair that is near; 0: none is, 1: random")
    interaction_radius_m: Positive | None = Field(
        None, description="pairs nearer than this are near, metres; null: half of sqrt(area / number)"
    )
    sweeps: Whole = Field(200, ge=1, le=100_000, description="how many new places are proposed to each plant")


@compiled
def _cell(x, y, n, size):  # type: ignore[no-untyped-def]
    """Index of the cell at a place; n is the number of columns and rows."""
    return min(int(y / size[1] * n[1]), n[1] - 1) * n[0] + min(int(x / size[0] * n[0]), n[0] - 1)


@compiled
def _near(x, y, i, at, first, after, n, size, radius, periodic):  # type: ignore[no-untyped-def]
    """How many plants but i are nearer than the radius, which is no more than a cell."""
    found = 0
    cell = _cell(x, y, n, size)
    row, col = cell // n[0], cell % n[0]
    # Of one or two rows on a torus each is met once.
    low_r, high_r = (row - 1, row + 2) if n[1] > 2 else (0, n[1])
    low_c, high_c = (col - 1, col + 2) if n[0] > 2 else (0, n[0])
    for r in range(low_r, high_r):
        for c in range(low_c, high_c):
            if not periodic and (r < 0 or r >= n[1] or c < 0 or c >= n[0]):
                continue
            up = r + n[1] if r < 0 else (r - n[1] if r >= n[1] else r)  # a remainder would take most of the time
            along = c + n[0] if c < 0 else (c - n[0] if c >= n[0] else c)
            j = first[up * n[0] + along]
            while j >= 0:
                if j != i:
                    dx, dy = abs(x - at[j, 0]), abs(y - at[j, 1])
                    if periodic:
                        dx, dy = min(dx, size[0] - dx), min(dy, size[1] - dy)
                    if dx * dx + dy * dy < radius * radius:
                        found += 1
                j = after[j]
    return found


@compiled
def _leave(i, cell, first, after, before):  # type: ignore[no-untyped-def]
    """Take plant i out of its cell's list."""
    if before[i] >= 0:
        after[before[i]] = after[i]
    else:
        first[cell] = after[i]
    if after[i] >= 0:
        before[after[i]] = before[i]


@compiled
def _enter(i, cell, first, after, before):  # type: ignore[no-untyped-def]
    """Put plant i at the head of a cell's list."""
    before[i], after[i] = -1, first[cell]
    if first[cell] >= 0:
        before[first[cell]] = i
    first[cell] = i


@compiled
def _propose(at, to, lot, local, density, grid, lists, n, size, gamma, radius, periodic):  # type: ignore[no-untyped-def]
    """Propose the (N, 2) places `to` to the (N, 2) plants `at`, one after another, in place.

    lot : (N,) in [0, 1). local : whether the density, in cells of `grid`, decides too. n : cells along x and y, whose
    plants linked `lists` have. All arrays are the caller's, who keeps them.
    """
    first, after, before = lists
    for i in range(len(at)):
        _enter(i, _cell(at[i, 0], at[i, 1], n, size), first, after, before)
    at_, flat = unowned_view(at), unowned_view(density)
    first_, after_, before_ = unowned_view(first), unowned_view(after), unowned_view(before)
    for i in range(len(to)):
        x, y = to[i]
        if local:
            if periodic:
                x, y = x % size[0], y % size[1]
            if not (0.0 <= x < size[0] and 0.0 <= y < size[1]):
                continue
            ratio = flat[_cell(x, y, grid, size)] / flat[_cell(at_[i, 0], at_[i, 1], grid, size)]
            if ratio <= 0.0:
                continue
        else:
            ratio = 1.0
        more = _near(x, y, i, at_, first_, after_, n, size, radius, periodic) - _near(
            at_[i, 0], at_[i, 1], i, at_, first_, after_, n, size, radius, periodic
        )
        if more > 0:
            ratio *= gamma**more
        elif more < 0:
            ratio = 1.0 if gamma == 0.0 else ratio / gamma**-more
        if lot[i] < ratio:
            _leave(i, _cell(at_[i, 0], at_[i, 1], n, size), first_, after_, before_)
            at_[i, 0], at_[i, 1] = x, y
            _enter(i, _cell(x, y, n, size), first_, after_, before_)


def relax(
    at: Floats, density: Floats, site: Site, parameters: StraussParameters, radius_m: float, rng: np.random.Generator
) -> None:
    """Let the chain run from the (N, 2) places `at`, in place."""
    n = len(at)
    most = max(1, math.isqrt(4 * n))  # cells: no use in many more than plants
    cells = tuple(max(1, min(most, math.floor(side / radius_m))) for side in site.size_m)
    field = DensityField(density, site.size_m, periodic=parameters.periodic)
    together = max(1, _DRAWN_AT_ONCE // n)
    anywhere = np.zeros((0, n, 2))
    flat, grid = density.ravel(), (density.shape[1], density.shape[0])
    for sweep in range(parameters.sweeps):
        local = sweep % 2 == 1
        if local:
            to = at + radius_m * (2 * rng.random((n, 2)) - 1)
        else:
            if sweep // 2 % together == 0:
                some = min(together, (parameters.sweeps - sweep + 1) // 2)
                anywhere = field.draw(rng.random((some * n, 2))).reshape(some, n, 2)
            to = anywhere[sweep // 2 % together]
        lot = rng.random(n)
        lists = np.full(cells[0] * cells[1], -1, np.int64), np.full(n, -1, np.int64), np.full(n, -1, np.int64)
        _propose(
            at, to, lot, local, flat, grid, lists, cells, site.size_m, parameters.gamma, radius_m, parameters.periodic
        )


def _radius(parameters: StraussParameters, site: Site, n: int) -> float:
    return parameters.interaction_radius_m or 0.5 * math.sqrt(site.area_m2 / max(n, 1))


def _refuse_long_runs(parameters: StraussParameters, site: Site, n: int, field: Floats) -> None:
    """Raise a RecipeError for n plants of a species with more neighbours than can be looked at."""
    radius, mean = _radius(parameters, site, n), float(field.mean())
    if parameters.gamma == 1.0 or mean <= 0:
        return
    crowding = float(np.mean((field / mean) ** 2))
    neighbours = min(float(n), math.pi * radius**2 * n / site.area_m2 * crowding)
    most = _MOST_MEETINGS / (parameters.sweeps * n) - 1
    if 3 * neighbours > most:
        problem = "this Strauss process would take too long"
        expected = f"a radius within which a plant has at most {max(most / 3, 0):,.3g} others at random"
        got = f"{radius:g} m, within which it has about {neighbours:,.3g}"
        hint = "a smaller interaction_radius_m, fewer plants or fewer sweeps"
        raise RecipeError(problem, where="community.interaction_radius_m", expected=expected, got=got, hint=hint)


class Strauss(GriddedModel[StraussParameters]):
    Parameters = StraussParameters
    missing_reason = "as a hard core (gamma: 0), no more were apart after these sweeps"

    def place_species(
        self, parameters: StraussParameters, site: Site, density: Floats, n: int, rng: np.random.Generator
    ) -> Floats:
        """(n, 2) places of a species, metres; nan for those that a hard core has no place for."""
        _refuse_long_runs(parameters, site, n, density)
        field = DensityField(density, site.size_m, periodic=parameters.periodic)
        at = field.draw(rng.random((n, 2)))
        radius = _radius(parameters, site, n)
        if parameters.gamma < 1.0:
            relax(at, density, site, parameters, radius, rng)
        if parameters.gamma == 0.0:
            at[~stays_apart(at, radius, site.size_m, periodic=parameters.periodic)] = np.nan
        return at

    def estimate_bytes(self, parameters: StraussParameters, site: Site, species: Ecologies) -> int:
        """Bytes for all plants and grids at once; refuses what `init` would."""
        shape = grid_shape(site, min(parameters.cells, COUNTING_CELLS))  # one field at a time, and none too large
        for one, n in zip(species, plant_counts(parameters, site, species), strict=True):
            if n:
                _refuse_long_runs(parameters, site, int(n), species_density(parameters, site, one.name, shape))
        proposed = 40 * max(_DRAWN_AT_ONCE, int(self.expected_plants(parameters, site, species)))
        return super().estimate_bytes(parameters, site, species) + 3 * proposed


MODEL = Strauss()
