"""The Thomas process: clusters around unobserved parent points, the standard model of clustered patterns.

Reference: M. Thomas, A generalization of Poisson's binomial limit for use in ecology, Biometrika 36, 1949; Baddeley,
Rubak and Turner 2015, Spatial Point Patterns, ch. 12; Waagepetersen 2007, Biometrics 63 (with a density).

Parents are a Poisson process of κ per square metre. Each plant belongs to a random parent and stands away from it by a
normal deviate of standard deviation σ along each axis. On even ground

    K(r) = π r² + (1 - exp(-r² / (4 σ²))) / κ,    g(r) = 1 + exp(-r² / (4 σ²)) / (4 π σ² κ).

With a density f, map times conditions, a plant survives with probability f / max f. κ is chosen so that a cluster on
the best ground has μ plants in the mean: κ = n / (μ · area · mean f / max f).

Parameters: see below; μ is plants_per_cluster, σ is sigma_m, at most the site's longer side. f and n are
those of `plants`. Radii and heights follow from the species' max_radius_m and height_m.

Recipe::

    community: {model: thomas, plants_per_cluster: 12, sigma_m: 0.4, plants: {daisy: {count: 400}}}

Decisions
---------
- The number asked for is placed exactly: the process given its number. Parents are not conditioned on that number, and
  K, the mean over patterns, is a little lower than the formula where clusters are few, by about 1 / n + μ / n of the
  second term.
- Where edges do not meet, parents also stand beyond them, as far as 5 σ; else clusters would thin out at the edge.
- Parents whose plants would nearly all be lost, beyond the edge or on poor ground, are drawn again: fewer than a tenth
  of the plants survive that should.
- The mean density counts as a 256th of the greatest at least, or a tiny spot would need parents everywhere. Where next
  to no plant survives, the search ends after 2000 trials a plant, and a note says how many were placed.
- Species are independent of one another: each has its own parents, of its own κ. Sizes are independent of places.
"""

from __future__ import annotations

import math

import numpy as np
from pydantic import Field

from forestgen.community.placement.model import GriddedModel, GriddedParameters, density_at
from forestgen.community.population import Ecologies, Floats, Site
from forestgen.core.errors import RecipeError
from forestgen.recipe.fields import Number, Positive

_REACH = 5.0  # σ: towards one side, one plant in 3.5 million stands farther away
_LEAST_SHARE = 1 / 256  # of the mean density in the greatest
_TRIALS_PER_PLANT, _TRIALS_AT_ONCE = 2000, 1_000_000
_REDRAWS = 50  # of parents
TRIAL_BYTES = 100 * _TRIALS_AT_ONCE


class ThomasParameters(GriddedParameters):
    """What a recipe says about the model besides its species."""

    plants_per_cluster: Number = Field(
        10.0, ge=0.1, le=1e6, description="mean number of a parent's plants, where the density is the greatest"
    )
    sigma_m: Positive | None = Field(
        None, description="standard deviation of a plant's distance from its parent along each axis, metres; "
        "null: a fifth of the parents' spacing"
    )  # fmt: skip


def parents_per_m2(n: int, plants_per_cluster: float, field: Floats, area_m2: float) -> float:
    """κ of n plants on a (rows, cols) density, which is not 0 everywhere."""
    share = max(float(field.mean() / field.max()), _LEAST_SHARE)
    return n / (plants_per_cluster * share * area_m2)


def _refuse_wide_clusters(parameters: ThomasParameters, site: Site) -> None:
    widest = max(site.size_m)
    if parameters.sigma_m is not None and parameters.sigma_m > widest:
        problem, expected = "clusters are wider than the site", f"at most {widest:g} m, the site's longer side"
        got, hint = f"{parameters.sigma_m:g} m", "clusters so wide cannot be seen: the model uniform has none"
        raise RecipeError(problem, where="community.sigma_m", expected=expected, got=got, hint=hint)


def _domain(field: Floats, size_m: tuple[float, float], reach_m: float, periodic: bool) -> tuple[Floats, Floats]:
    """(2,) corner and (2,) size in metres of the rectangle whose parents can have plants on ground of any density."""
    corner, extent = np.zeros(2), np.array(size_m)
    for axis, side in enumerate(size_m):
        some = np.flatnonzero(field.any(axis=axis))  # axis 0 runs along y: what is left is x
        cell = side / field.shape[1 - axis]
        low, high = some[0] * cell - reach_m, (some[-1] + 1) * cell + reach_m
        if not periodic or high - low < side:
            corner[axis], extent[axis] = low, high - low
    return corner, extent


class _Clusters:
    """Parents of one species, and trials of plants around them."""

    def __init__(
        self, field: Floats, n: int, parameters: ThomasParameters, site: Site, rng: np.random.Generator
    ) -> None:
        self.field, self.size_m, self.periodic, self.rng = field, site.size_m, parameters.periodic, rng
        self.per_m2 = parents_per_m2(n, parameters.plants_per_cluster, field, site.area_m2)
        self.sigma_m = parameters.sigma_m or 0.2 / math.sqrt(self.per_m2)
        self.corner, self.extent = _domain(field, site.size_m, _REACH * self.sigma_m, parameters.periodic)
        self.survival = float(field.mean() / field.max()) * site.area_m2 / float(np.prod(self.extent))  # of a trial
        self.parents = self._parents()

    def _parents(self) -> Floats:
        number = 0
        mean = self.per_m2 * float(np.prod(self.extent))
        while number == 0:  # a Poisson number that is not 0; of a very small mean, 1
            number = int(self.rng.poisson(mean)) if mean > 0.01 else 1
        return self.corner + self.extent * self.rng.random((number, 2))

    def try_plants(self, trials: int) -> Floats:
        """(M, 2) places of those that survive, metres."""
        rng, size = self.rng, np.array(self.size_m)
        at = self.parents[rng.integers(len(self.parents), size=trials)]
        at = at + self.sigma_m * rng.standard_normal((trials, 2))
        lot = rng.random(trials) * self.field.max()
        if self.periodic:
            at = np.mod(at, size)
        inside = np.all((at >= 0) & (at < size), axis=1)  # the remainder of -1e-20 is the size itself
        at, lot = at[inside], lot[inside]
        return np.asarray(at[lot < density_at(self.field, at, self.size_m)])

    def draw(self, n: int) -> Floats:
        """(n, 2) places, metres; nan for plants that found none."""
        places = np.full((n, 2), np.nan)
        have, trials, redraws = 0, 0, 0
        while have < n and trials < _TRIALS_PER_PLANT * n + _TRIALS_AT_ONCE:
            now = min(_TRIALS_AT_ONCE, 100 + math.ceil(1.2 * (n - have) / max(self.survival, 1e-6)))
            good = self.try_plants(now)
            trials += now
            if have == 0 and redraws < _REDRAWS and len(good) < 0.1 * min(n, now * self.survival):
                self.parents, redraws = self._parents(), redraws + 1
                continue
            places[have : have + len(good)] = good[: n - have]
            have = min(n, have + len(good))
        return places


class Thomas(GriddedModel[ThomasParameters]):
    Parameters = ThomasParameters
    missing_reason = "clusters hardly meet the ground that the map and the conditions allow"

    def place_species(
        self, parameters: ThomasParameters, site: Site, density: Floats, n: int, rng: np.random.Generator
    ) -> Floats:
        """(n, 2) places of a species, metres; nan for plants that found none."""
        _refuse_wide_clusters(parameters, site)
        return _Clusters(density, n, parameters, site, rng).draw(n)

    def estimate_bytes(self, parameters: ThomasParameters, site: Site, species: Ecologies) -> int:
        """Bytes for all plants, grids, parents and trials at once; refuses what `init` would."""
        _refuse_wide_clusters(parameters, site)
        parents = self.expected_plants(parameters, site, species) / parameters.plants_per_cluster / _LEAST_SHARE
        return super().estimate_bytes(parameters, site, species) + TRIAL_BYTES + math.ceil(48 * parents)


MODEL = Thomas()
