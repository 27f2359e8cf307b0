"""What standing plants do to a place by their kernels, and where seeds fall: parts of `models/kernel_growth.py`.

A kernel is taken apart, ``κ = min(κ, 1) max(κ, 1)``: what keeps plants off is evaluated at the places themselves,
exactly, by a neighbour grid; what invites them is sampled at the middles of the cells of a field, for draws.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from forestgen.community.competition import grid
from forestgen.community.ground.living_conditions import Conditions
from forestgen.community.placement.densities import COUNTING_CELLS, grid_shape, relative_density
from forestgen.community.placement.density_map import DensityMap
from forestgen.community.placement.field import DensityField
from forestgen.community.placement.kernels import KernelTable
from forestgen.community.population import Ecologies, Floats, Site
from forestgen.core.cache import BoundedCache
from forestgen.core.compiled import compiled
from forestgen.core.threads import parallel_for
from forestgen.recipe.fields import Section

_LINES = 256  # in which places are looked at in turn
_CELLS_PER_REACH = 6
_means: BoundedCache[float] = BoundedCache(256, lambda _: 1)  # a plan asks for the same many times; densities are large
_FEWEST_CELLS, _MOST_CELLS = 64, 1024  # along the site's longer side, unless a recipe says otherwise


@dataclass(frozen=True)
class Interactions:
    """A matrix of kernels, [affected species, acting species], as compiled loops read it."""

    values: Floats  # (S, S, K) κ at even distances from 0 to the reach, linear between them
    reach: Floats  # (S, S) radii of the acting plant, or metres
    in_radii: NDArray[np.bool_]  # (S, S)
    acts: NDArray[np.bool_]  # (S, S) whether κ is not 1 everywhere
    invites: NDArray[np.bool_]  # (S, S) whether κ exceeds 1 somewhere
    hinders: NDArray[np.bool_]  # (S, S) whether it is below 1 somewhere

    @classmethod
    def of(cls, kernels: Sequence[Sequence[KernelTable]]) -> Interactions:
        """kernels[i][j] is the effect of a plant of species j on species i (Lane's M_ij, Figure 5.7)."""
        n = len(kernels)

        def matrix(number: Callable[[KernelTable], object], dtype: type) -> NDArray[Any]:
            return np.array([[number(one) for one in row] for row in kernels], dtype=dtype).reshape(n, n)

        values = np.array([[one.values for one in row] for row in kernels], dtype=np.float64)
        return cls(
            values=values.reshape(n, n, -1) if n else np.ones((0, 0, 2)),
            reach=matrix(lambda one: one.reach, np.float64),
            in_radii=matrix(lambda one: one.in_radii, np.bool_),
            acts=matrix(lambda one: not one.is_neutral, np.bool_),
            invites=matrix(lambda one: one.values.max() > 1, np.bool_),
            hinders=matrix(lambda one: one.values.min() < 1, np.bool_),
        )

    def reach_m(self, affected: int, acting: int, radius_m: Floats) -> Floats:
        """(N,) distance beyond which plants of a species and of these radii have no effect on another one."""
        reach = self.reach[affected, acting]
        return np.asarray(reach * radius_m if self.in_radii[affected, acting] else np.full(len(radius_m), reach))

    def farthest_m(self, counts: NDArray[np.bool_], sp: NDArray[np.uint16], radius_m: Floats) -> Floats:
        """(N,) distance beyond which each plant has no effect by the kernels that count; -1 where it never has one."""
        out = np.full(len(radius_m), -1.0)
        for affected, acting in np.argwhere(counts):
            of_it = sp == acting
            out[of_it] = np.maximum(out[of_it], self.reach_m(affected, acting, radius_m[of_it]))
        return out


@dataclass(frozen=True)
class Rivals:
    """The plants that act, one row each, and the ground."""

    x_m: Floats  # (N, 2) metres
    r_m: Floats  # (N,) metres
    sp: NDArray[np.uint16]  # (N,)
    plant_id: NDArray[np.uint32]  # (N,)
    size_m: tuple[float, float]
    periodic: bool


@compiled
def _products(first, end, order, asked, g, acting, kernels, most, out):  # type: ignore[no-untyped-def]
    """out[k] = Π min(κ, most) at place k over all plants that rank above r[k] and plant_id[k]."""
    at, r, sp, plant_id = asked
    their_r, their_sp, their_id = acting
    circle, entry, start, n, per_m, size_m, periodic = g
    values, reach, in_radii, counts = kernels
    last = values.shape[2] - 1
    for turn in range(first, end):
        k = order[turn]
        x, y, i = at[k, 0], at[k, 1], sp[k]
        if periodic:
            x, y = x % size_m[0], y % size_m[1]
        column, line = int(min(max(x * per_m[0], 0.0), n[0] - 1.0)), int(min(max(y * per_m[1], 0.0), n[1] - 1.0))
        cell = line * n[0] + column
        product = 1.0
        for e in range(start[cell], start[cell + 1]):
            j = entry[e]
            dx, dy = abs(circle[j, 0] - x), abs(circle[j, 1] - y)
            if periodic:
                dx, dy = min(dx, size_m[0] - dx), min(dy, size_m[1] - dy)
            d2 = dx * dx + dy * dy
            if d2 > circle[j, 2] * circle[j, 2]:  # beyond what it does to any species
                continue
            s = their_sp[j]
            if not counts[i, s] or their_r[j] < r[k] or (their_r[j] == r[k] and their_id[j] >= plant_id[k]):
                continue
            far = reach[i, s] * (their_r[j] if in_radii[i, s] else 1.0)
            if d2 > far * far:
                continue
            t = np.sqrt(d2) / far * last
            low = min(int(t), last - 1)
            product *= min(values[i, s, low] + (t - low) * (values[i, s, low + 1] - values[i, s, low]), most)
            if product == 0.0:
                break
        out[k] = product


def _at(
    asked: tuple[Floats, Floats, NDArray[Any], NDArray[Any]], rivals: Rivals, kernels: Interactions, most: float
) -> Floats:
    """(M,) products of min(κ, most) at places over the standing plants that rank above those that are asked about.

    asked : (M, 2) places, (M,) radii, species and plant_id.
    """
    x_m = asked[0]
    out = np.ones(len(x_m))
    counts = kernels.acts if most > 1 else kernels.hinders
    farthest = kernels.farthest_m(counts, rivals.sp, rivals.r_m)
    rows = np.flatnonzero(farthest >= 0)
    if not len(rows) or not len(x_m):
        return out
    cells = grid.build(rivals.x_m[rows], farthest[rows], rivals.size_m, periodic=rivals.periodic)
    who = rows[cells.circle[:, 3].astype(np.intp)]
    acting = (rivals.r_m[who], rivals.sp[who], rivals.plant_id[who])
    tables = (kernels.values, kernels.reach, kernels.in_radii, counts)
    # Along lines: neighbours in turn find each other's cells in the cache.
    order = np.lexsort((x_m[:, 0], np.floor(x_m[:, 1] / rivals.size_m[1] * _LINES)))
    parallel_for(len(order), lambda first, end: _products(first, end, order, asked, cells, acting, tables, most, out))
    return out


def quality(rivals: Rivals, kernels: Interactions) -> Floats:
    """(N,) min(1, Π κ) of each plant at its own place, over the larger ones; of equal ones the lower plant_id acts."""
    there = (rivals.x_m, rivals.r_m, rivals.sp, rivals.plant_id)
    return np.minimum(_at(there, rivals, kernels, np.inf), 1.0)


def establishment(x_m: Floats, sp: NDArray[np.uint16], rivals: Rivals, kernels: Interactions) -> Floats:
    """(M,) Π min(κ, 1) over all standing plants at (M, 2) places, of species `sp`."""
    seeds = (x_m, np.full(len(x_m), -1.0), sp, np.zeros(len(x_m), dtype=np.uint32))
    return _at(seeds, rivals, kernels, 1.0)


@compiled
def _add(x, far, table, size_m, periodic, out):  # type: ignore[no-untyped-def]
    """Add to each cell of `out` the table's value at its middle's distance from each plant; beyond `far` it is 0."""
    rows, cols = out.shape
    width, height = size_m[0] / cols, size_m[1] / rows
    last = len(table) - 1
    for k in range(len(far)):
        u, v, reach = x[k, 0], x[k, 1], far[k]
        low, count = _within(v, reach, rows, height, periodic)
        for b in range(low, low + count):
            row = b % rows
            dy = abs((row + 0.5) * height - v % size_m[1]) if periodic else abs((row + 0.5) * height - v)
            if periodic:
                dy = min(dy, size_m[1] - dy)
            half = reach * reach - dy * dy
            if half < 0.0:
                continue
            left, across = _within(u, np.sqrt(half), cols, width, periodic)
            for a in range(left, left + across):
                col = a % cols
                dx = abs((col + 0.5) * width - u % size_m[0]) if periodic else abs((col + 0.5) * width - u)
                if periodic:
                    dx = min(dx, size_m[0] - dx)
                t = np.sqrt(dx * dx + dy * dy) / reach * last
                if t <= last:
                    i = min(int(t), last - 1)
                    out[row, col] += table[i] + (t - i) * (table[i + 1] - table[i])


@compiled
def _within(at, reach, n, side, periodic):  # type: ignore[no-untyped-def]
    """First and number of the cells along an axis whose middles may lie within `reach`; on a torus each once."""
    low, high = int(np.ceil((at - reach) / side - 0.5)), int(np.floor((at + reach) / side - 0.5))
    if not periodic:
        low, high = max(low, 0), min(high, n - 1)
        return low, max(0, high - low + 1)
    if high - low + 1 >= n:
        return 0, n
    return low, max(0, high - low + 1)


def invitation(rivals: Rivals, kernels: Interactions, affected: int, shape: tuple[int, int]) -> Floats:
    """(rows, cols) logarithm of Π max(κ, 1) at the middles of cells, for one species; row 0 at y = 0."""
    out = np.zeros(shape)
    for acting in np.flatnonzero(kernels.invites[affected]):
        chosen = rivals.sp == acting
        far = kernels.reach_m(affected, int(acting), rivals.r_m[chosen])
        table = np.log(np.maximum(kernels.values[affected, acting], 1.0))
        _add(rivals.x_m[chosen], far, table, rivals.size_m, rivals.periodic, out)
    return out


class GroundSection(Section):
    """What the ground is to one species."""

    map: DensityMap | None = Field(None, description="Relative density of seedlings over the site.")
    conditions: Conditions = Field(Conditions(), description="What the species asks of the ground.")


@dataclass(frozen=True)
class Ground:
    """The species' relative densities b_i, on one grid; each is made when it is first asked for, and kept."""

    shape: tuple[int, int]  # rows, columns
    mean: Floats  # (S,) of each density
    _size_m: tuple[float, float]
    _makers: tuple[Callable[[], Floats] | None, ...]  # of each species' density; None: it is 1 everywhere

    @cached_property
    def density(self) -> tuple[Floats | None, ...]:
        """(rows, cols) of each species, row 0 at y = 0; None: 1 everywhere."""
        return tuple(None if make is None else make() for make in self._makers)

    @cached_property
    def bare(self) -> tuple[DensityField | None, ...]:
        """The densities where no plant invites, ready to draw from."""
        return tuple(None if one is None else DensityField(one, self._size_m, periodic=True) for one in self.density)


def ground_of(
    sections: Mapping[str, GroundSection],
    keep_out: DensityMap | None,
    site: Site,
    species: Ecologies,
    kernels: Interactions,
    cells: int | None,
) -> Ground:
    """The ground that a recipe describes; `cells` along the site's longer side, None: as many as it takes."""
    plain = GroundSection.model_validate({})
    given = [sections.get(one.name, plain) for one in species]
    varied = [keep_out is not None or one != plain for one in given]
    shape = grid_shape(site, cells or _cells(site, species, kernels, any(varied)))
    makers: list[Callable[[], Floats] | None] = []
    mean = []
    for section, varies in zip(given, varied, strict=True):
        make = partial(relative_density, section.conditions, section.map, keep_out, site, shape) if varies else None
        makers.append(make)
        mean.append(1.0 if make is None else _mean(make, section, keep_out, site, shape))
    return Ground(shape, np.array(mean, dtype=np.float64), site.size_m, tuple(makers))


def _mean(
    make: Callable[[], Floats], section: GroundSection, keep_out: DensityMap | None, site: Site, shape: tuple[int, int]
) -> float:
    """Mean of the density that `make` makes of the others; maps of files are distinguished by their SHA-256."""
    maps = [one for one in (section.map, keep_out) if one is not None]
    if any(one.rows is None and one.sha256 is None for one in maps):
        return float(make().mean())
    said = section.model_dump_json() + (keep_out.model_dump_json() if keep_out is not None else "")
    return _means.get((hashlib.sha256(said.encode()).digest(), site, shape), lambda: float(make().mean()))


def _cells(site: Site, species: Ecologies, kernels: Interactions, varied: bool) -> int:
    """Cells along the longer side that inviting kernels ask for, and maps."""
    cells = COUNTING_CELLS if varied else _FEWEST_CELLS
    for affected, acting in np.argwhere(kernels.invites):
        half_grown = np.array([species[acting].max_radius_m / 2])
        reach_m = float(kernels.reach_m(int(affected), int(acting), half_grown)[0])
        cells = max(cells, round(min(_CELLS_PER_REACH * max(site.size_m) / reach_m, _MOST_CELLS)))
    return cells


def seed_rain(
    ground: Ground,
    affected: int,
    n: int,
    rivals: Rivals,
    kernels: Interactions,
    most_inviting: float,
    rng: np.random.Generator,
) -> Floats:
    """(n, 2) places, metres, drawn from the density times min(Π max(κ, 1), most_inviting) of the plants that stand."""
    uniform = rng.random((n, 2))
    if n == 0:
        return uniform
    density, field = ground.density[affected], ground.bare[affected]
    if len(rivals.r_m) and kernels.invites[affected].any():
        logs = invitation(rivals, kernels, affected, ground.shape)
        inviting = np.exp(np.minimum(logs, np.log(most_inviting)))
        inviting = inviting if density is None else inviting * density
        field = DensityField(inviting, rivals.size_m, periodic=rivals.periodic)
    return uniform * rivals.size_m if field is None else field.draw(uniform)
