"""Plants of a stand's ground: herbs, shrubs and seedlings, anywhere or in clumps."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, model_validator

from forestgen.community.ground.living_conditions import Conditions
from forestgen.community.models import thomas, uniform
from forestgen.community.placement.densities import Sizes, Stand, one_size, radii_at
from forestgen.community.placement.density_map import DensityMap
from forestgen.community.placement.model import GriddedModel, PlantingTargets, read_densities, stream_of
from forestgen.community.population import Ecologies, Floats, Site, SpeciesEcology
from forestgen.core.errors import RecipeError
from forestgen.recipe.fields import NonNegative, Positive, Section, violation

# Ground that the discs of large clumps cover, of the area of all discs: the integral of (1 - exp(-x)) / x from 0 to 1.
_COVER_OF_CLUMPS = 0.7966
_FEWER_OVERLAP = 2.3  # ours: of clumps of few plants, within 1% of the process' own cover, see the tests
_FEWEST = 0.1  # plants of a clump, in the mean: as many as thomas allows
_LEAST_TOLERANCE = 0.02  # of shade, ours: plants that bear none have some place too


class GroundPlants(Section):
    """Plants of one species below the trees."""

    plants_per_ha: NonNegative | None = Field(None, le=1e8, description="How many per hectare; or, instead, cover.")
    cover: Positive | None = Field(
        None, le=0.99, description="Share of even, open ground under their discs of radius_m."
    )
    radius_m: Annotated[Sizes | None, BeforeValidator(one_size)] = Field(
        None, description="Radii: a number, or {median, sigma} of a log-normal; null: median half of the largest."
    )
    height_sigma: NonNegative = Field(0.0, le=1, description="Scatter of heights about the species' allometry.")
    map: DensityMap | None = Field(None, description="Relative density over the site.")
    clump_m: Positive | None = Field(
        None,
        le=200,
        description="Width of the clumps that they stand in, metres, at most the site's longer side; "
        "null: each stands anywhere.",
    )

    @model_validator(mode="after")
    def _one_number(self) -> Self:
        if (self.plants_per_ha is None) == (self.cover is None):
            raise violation("one of plants_per_ha and cover", problem="how many plants?")
        return self

    def stand(self, species: SpeciesEcology) -> Stand:
        """As placement models take it."""
        number = self.plants_per_ha
        if self.cover is not None:
            number = -math.log1p(-self.cover) / (math.pi * self._mean_square(species) * self._spread(species)) * 1e4
        return Stand.model_construct(
            plants_per_ha=number, radius_m=self.radius_m, height_sigma=self.height_sigma, map=self.map,
            count=None, conditions=Conditions(),
        )  # fmt: skip

    def clumps(self, species: SpeciesEcology, site: Site, *, periodic: bool) -> thomas.ThomasParameters | None:
        """Clumps, of a fourth of their width as sigma, in whose middle as many discs stand as cover the ground once.

        Raises `RecipeError`: they are wider than the site.
        """
        if self.clump_m is None:
            return None
        if self.clump_m > max(site.size_m):
            where, got = f"community.ground.{species.name}.clump_m", f"{self.clump_m:g} m"
            expected = f"at most {max(site.size_m):g} m, the site's longer side"
            hint = "narrower clumps, or none: leave clump_m out"
            raise RecipeError("clumps are wider than the site", where=where, expected=expected, got=got, hint=hint)
        return thomas.ThomasParameters.model_construct(
            plants_per_cluster=self._many(species), sigma_m=0.25 * self.clump_m, periodic=periodic
        )

    def _many(self, species: SpeciesEcology) -> float:
        """Plants of a clump, in the mean; 0 where each stands anywhere."""
        return max(_FEWEST, 0.125 * self.clump_m**2 / self._mean_square(species)) if self.clump_m else 0.0

    def _spread(self, species: SpeciesEcology) -> float:
        """Logarithm of the share of even ground that they leave, over that of plants that each stand anywhere."""
        return _COVER_OF_CLUMPS + (1.0 - _COVER_OF_CLUMPS) / (1.0 + _FEWER_OVERLAP * self._many(species))

    def _mean_square(self, species: SpeciesEcology) -> float:
        """Of their radii, square metres."""
        return float(np.mean(radii_at(self.radius_m, species, (np.arange(4096) + 0.5) / 4096) ** 2))


class GroundParameters(uniform.UniformParameters):
    """The ground's plants, as another model places them."""

    plants_key: ClassVar[str] = "ground"
    clumps: Mapping[str, thomas.ThomasParameters] = {}


class GroundModel(GriddedModel[GroundParameters]):
    """Plants anywhere or, of some species, in clumps, which stand below crowns as readily as their species bears shade.

    `crowns`: (rows, cols) whether the site's ground is under crowns, row 0 at y = 0; None: there are no trees.
    """

    def __init__(self, crowns: NDArray[np.bool_] | None) -> None:
        self._crowns = crowns

    def positions(
        self,
        parameters: GroundParameters,
        site: Site,
        species: Ecologies,
        wanted: PlantingTargets,
        rng: np.random.Generator,
    ) -> tuple[Floats, Mapping[str, str]]:
        position_m, _ = uniform.MODEL.positions(parameters, site, species, wanted, rng)
        fields = read_densities(parameters, site, species) if parameters.clumps else []
        for index, field in enumerate(fields):
            one, mine = species[index], np.flatnonzero(wanted.sp == index)
            clumps = parameters.clumps.get(one.name)
            if clumps is not None and len(mine) and field.any():
                lit = field if self._crowns is None else field * self._light(field.shape, one.shade_tolerance)
                stream = stream_of(rng, "clumps", one.name)
                position_m[mine] = thomas.MODEL.place_species(clumps, site, lit, len(mine), stream)
        why = dict.fromkeys((one.name for one in species), uniform.MODEL.missing_reason)
        return position_m, why | dict.fromkeys(parameters.clumps, thomas.MODEL.missing_reason)

    def _light(self, shape: tuple[int, ...], tolerance: float) -> Floats:
        """(rows, cols) relative density under crowns and in the open."""
        assert self._crowns is not None
        row, col = ((np.arange(n) + 0.5) / n * most for n, most in zip(shape, self._crowns.shape, strict=True))
        under = self._crowns[np.ix_(row.astype(np.intp), col.astype(np.intp))]
        return np.asarray(np.where(under, max(tolerance, _LEAST_TOLERANCE), 1.0))
