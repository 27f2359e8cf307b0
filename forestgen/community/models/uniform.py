"""Independent random places: the pattern without any pattern, which others are compared with.

Reference: Baddeley, Rubak and Turner 2015, Spatial Point Patterns, ch. 5 (binomial process); B. Lane, Models of Plant
Communities for Image Synthesis, University of Calgary, 2002, section 5.1 (the inverse transformation method).

Each plant's place is drawn by itself from its species' density f, map times conditions:

    P(place in A) = ∫_A f / ∫ f,    f constant in each of the grid's cells.

On even ground the Hopkins index is 1 and Ripley's K(r) = π r². Plants may stand on one another.

Parameters: see below. Radii and heights follow from the species' max_radius_m and height_m.

Recipe::

    community: {model: uniform, plants: {daisy: {count: 400}}}

Decisions
---------
- The number asked for is placed exactly: a binomial process, not a Poisson process.
- Species are independent of one another. Sizes are independent of places.
- The kernel `neutral` of `deformation_kernel` gives the same places on the same grid.
- `periodic` changes nothing: plants that do not see one another have no edges.
"""

from __future__ import annotations

import numpy as np

from forestgen.community.placement import model as placement
from forestgen.community.placement.field import DensityField
from forestgen.community.population import Ecologies, Floats, Site


class UniformParameters(placement.GriddedParameters):
    """What a recipe says about the model besides its species."""


class Uniform(placement.GriddedModel[UniformParameters]):
    Parameters = UniformParameters

    def positions(
        self,
        parameters: UniformParameters,
        site: Site,
        species: Ecologies,
        wanted: placement.PlantingTargets,
        rng: np.random.Generator,
    ) -> tuple[Floats, str]:
        """Each species' places from its own stream of random numbers."""
        position_m = np.full((len(wanted.sp), 2), np.nan)
        uniform = placement.uniform_samples(wanted, species, rng)
        for index, density in enumerate(placement.read_densities(parameters, site, species)):
            mine = wanted.sp == index
            field = DensityField(density, site.size_m, periodic=parameters.periodic)
            if mine.any() and field.total > 0:
                position_m[mine] = field.draw(uniform[mine])
        return position_m, self.missing_reason


MODEL = Uniform()
