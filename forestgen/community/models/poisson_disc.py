"""Poisson discs: random places of which no two are nearer than a distance, as dense as they come.

Reference: R. Bridson, Fast Poisson disk sampling in arbitrary dimensions, SIGGRAPH 2007 sketches, as SciPy has it
(`scipy.stats.qmc.PoissonDisk`); N. Chiba et al., Rendering of forest scenery using 3D textures, J. Visualization and
Computer Animation 8, 1997, after B. Lane, Models of Plant Communities for Image Synthesis, University of Calgary,
2002, section 3.2.

The pattern grows from one random point: around each of its points 30 candidates between 0 and 2 d away are tried, and
one that is no nearer than d to any point joins. It ends when it has filled the site, with about 0.6 area / d² points.
The plants take n of these points, each point with a probability in proportion to the density there, map times
conditions; a chosen point x goes to species s with the probability that species s has there,
q_s = n_s f_s(x) / Σ_t n_t f_t(x) with f of integral 1.

Parameters: see below; d is distance_m. f and n are those of `plants`. Radii and heights follow from
the species' max_radius_m and height_m.

Recipe::

    community: {model: poisson_disc, distance_m: 1.5, plants: {daisy: {count: 400}}}

Decisions
---------
- Without `distance_m` the pattern has as many points as fill the densest ground with plants: n for an even density on
  the whole site, n times the greatest over the mean density otherwise, at most sixteen times n. d is first guessed,
  then made smaller until the points suffice. A few points more than that may remain, and are left out at random.
- With `distance_m`, n plants may be more than fit: then the largest are placed, and a note says how many. They may be
  fewer: then the pattern is a random part of a full one, less even the fewer they are.
- Never the first n points: those are a blot around the first one.
- SciPy's pattern does not wrap. On a torus, of each two points too near across an edge one at random goes, and the
  gaps, there and elsewhere, are filled with random points that fit.
- SciPy's loop is Python's: a millisecond or two a point, and d may take two tries. So a pattern has at most 20,000
  points, and a recipe that needs more is refused; other models place millions.
- SciPy keeps points in single precision: d is enlarged by that error, so that it holds to the last digit.
- One pattern serves all species; d holds between any two plants. Sizes are independent of places.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.spatial import cKDTree

from forestgen.community.placement import model as placement
from forestgen.community.placement.densities import COUNTING_CELLS, grid_shape, plant_counts, species_density
from forestgen.community.placement.labelling import assign, choose, label
from forestgen.community.population import Ecologies, Floats, Site
from forestgen.core.errors import RecipeError
from forestgen.recipe.fields import Positive

MOST_POINTS = 20_000  # of a pattern
_POINTS_PER_PLANT = 16  # at most
_FILL = 0.60  # points times d² over the area that they fill: measured; 0.60 to 0.61 of 1000 and more
_BORDER = 0.55  # of d: as if the area were so much wider and higher where edges do not meet; measured
_ROUNDS = 8  # of a smaller distance
_SINGLE = 2.0**-22  # of the longer side: two points that are rounded to single precision
_DARTS = 4  # thrown at once for each point


class PoissonDiscParameters(placement.GriddedParameters):
    """What a recipe says about the model besides its species."""

    distance_m: Positive | None = Field(
        None, description="no two plants are nearer, metres; null: the greatest at which all of them fit"
    )


def pattern(size_m: tuple[float, float], distance_m: float, periodic: bool, rng: np.random.Generator) -> Floats:
    """(P, 2) points that fill [0, W] x [0, H], no two nearer than a distance; `periodic`: nor across its edges."""
    from scipy.stats import qmc  # slow to import

    wide = distance_m + _SINGLE * max(size_m)
    engine = qmc.PoissonDisk(2, radius=wide, rng=rng, l_bounds=(0.0, 0.0), u_bounds=size_m)
    points = np.asarray(engine.fill_space(), dtype=np.float64).reshape(-1, 2)
    return _joined(points, size_m, distance_m, rng) if periodic else points


def _joined(points: Floats, size_m: tuple[float, float], distance_m: float, rng: np.random.Generator) -> Floats:
    """The pattern on a torus: points that are too near across an edge thinned, gaps filled."""
    box = np.array(size_m)
    points = rng.permutation(points % box)
    points = points[placement.stays_apart(points, distance_m, size_m, periodic=True)]
    while True:
        darts = rng.random((1000 + _DARTS * len(points), 2)) * box
        free = darts[cKDTree(points, boxsize=box).query(darts)[0] >= distance_m]
        free = free[placement.stays_apart(free, distance_m, size_m, periodic=True)]
        points = np.concatenate([points, free])
        if len(free) <= 0.01 * len(points):
            return points


def _needed(fields: Iterable[Floats], counts: NDArray[np.integer], shape: tuple[int, int]) -> tuple[Floats, int]:
    """(rows, cols) plants of all species that a cell expects, relative to the mean; how many points a pattern needs."""
    expected, n = np.zeros(shape), 0
    for count, field in zip(counts, fields, strict=True):
        if count and np.any(field):
            expected += field * (count / field.mean())
            n += int(count)
    expected /= max(n, 1)
    return expected, math.ceil(n * min(float(expected.max()), _POINTS_PER_PLANT)) if n else 0


def _refuse_large_patterns(parameters: PoissonDiscParameters, site: Site, needed: int) -> None:
    """Raise a RecipeError for a pattern of more points than can be made."""
    given = parameters.distance_m
    points = float(needed) if given is None else _FILL * site.area_m2 / given / given
    if points > MOST_POINTS:
        problem = "this pattern of Poisson discs has too many points"
        where = "community.plants" if given is None else "community.distance_m"
        expected = f"at most {MOST_POINTS:,} on the whole site, plants or not"
        hint = "a greater distance_m" if given is not None else "fewer plants, or strauss, halftone, jittered_grid"
        raise RecipeError(problem, where=where, expected=expected, got=f"about {points:,.0f}", hint=hint)


class PoissonDisc(placement.GriddedModel[PoissonDiscParameters]):
    Parameters = PoissonDiscParameters

    def positions(
        self,
        parameters: PoissonDiscParameters,
        site: Site,
        species: Ecologies,
        wanted: placement.PlantingTargets,
        rng: np.random.Generator,
    ) -> tuple[Floats, str]:
        """The plants of all species at points of one pattern."""
        counts = plant_counts(parameters, site, species)
        fields = placement.read_densities(parameters, site, species)
        expected, needed = _needed(fields, counts, grid_shape(site, parameters.cells))
        position_m, distance = np.full((len(wanted.sp), 2), np.nan), 0.0
        if needed:
            _refuse_large_patterns(parameters, site, needed)
            able = np.array([n if np.any(f) else 0 for n, f in zip(counts, fields, strict=True)], dtype=np.int64)
            n = int(able.sum())
            points, distance = _enough(parameters, site, expected, needed, n, rng)
            chosen = points[choose(placement.density_at(expected, points, site.size_m), n, rng)]
            # Of fewer places than plants, the largest plants have theirs.
            able = np.bincount(wanted.sp[able[wanted.sp] > 0][: len(chosen)], minlength=len(species))
            weight = [
                placement.density_at(field, chosen, site.size_m) * (k / max(float(field.mean()), 1e-300))
                for field, k in zip(fields, counts, strict=True)
            ]
            position_m = assign(wanted, chosen, label(np.array(weight), able, rng), rng)
        why = f"no more fit at {distance:.3g} m from one another on the ground that the map and the conditions allow"
        return position_m, why

    def estimate_bytes(self, parameters: PoissonDiscParameters, site: Site, species: Ecologies) -> int:
        """Bytes for all plants and grids at once; a plan asks this first, so that large patterns are refused here."""
        counts = plant_counts(parameters, site, species)
        shape = grid_shape(site, min(parameters.cells, COUNTING_CELLS))  # one field at a time, and none too large
        fields = (species_density(parameters, site, one.name, shape) for one in species)
        needed = _needed(fields, counts, shape)[1]
        if needed:
            _refuse_large_patterns(parameters, site, needed)
        return super().estimate_bytes(parameters, site, species) + 500 * MOST_POINTS


def _fitting(site: Site, points: int, periodic: bool) -> float:
    """Distance at which about so many points fill a site, metres: points d² = fill (W + border d) (H + border d)."""
    border = 0.0 if periodic else _BORDER
    square = max(points - _FILL * border**2, 0.5)
    linear = _FILL * border * sum(site.size_m)
    return (linear + math.sqrt(linear**2 + 4 * square * _FILL * site.area_m2)) / (2 * square)


def _enough(
    parameters: PoissonDiscParameters, site: Site, expected: Floats, needed: int, n: int, rng: np.random.Generator
) -> tuple[Floats, float]:
    """A pattern of `needed` points, n of them where plants may stand, or of the given distance; and its distance."""
    if parameters.distance_m is not None:
        return pattern(site.size_m, parameters.distance_m, parameters.periodic, rng), parameters.distance_m
    distance = _fitting(site, needed, parameters.periodic)
    least = _fitting(site, min(MOST_POINTS, max(needed, _POINTS_PER_PLANT * n)), parameters.periodic)
    for _ in range(_ROUNDS):
        points = pattern(site.size_m, distance, parameters.periodic, rng)
        good = int(np.count_nonzero(placement.density_at(expected, points, site.size_m)))
        if (len(points) >= needed and good >= n) or distance <= least:
            break
        distance = max(least, distance * 0.99 * math.sqrt(min(1.0, len(points) / needed, max(good, 1) / n)))
    return points, distance


MODEL = PoissonDisc()
