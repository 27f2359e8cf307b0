"""Placement from a density, plant by plant, each of which deforms the density for those that follow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from pydantic import Field

from forestgen.community.model import Site, SpeciesEcology
from forestgen.community.placement.densities import grid_shape, species_density
from forestgen.community.placement.field import DensityField, place
from forestgen.community.placement.kernels import NAMED, Kernel, KernelSection, table
from forestgen.community.placement.model import PlacementModel, placed_state, placement_rng, wanted_plants
from forestgen.community.placement.stands import PlacementParameters
from forestgen.community.standing import State
from forestgen.recipe.fields import Name, Whole

_WHY = "no place is left where the kernels, the map and the conditions allow one"


class DeformationKernelParameters(PlacementParameters):
    """What a recipe says about the model besides its species."""

    kernels: Kernel | dict[Name, Kernel | dict[Name, Kernel]] = Field(
        KernelSection(**NAMED["inhibition"]),
        description="The kernel of all plants; or by species that deforms; or by that and the species that is affected",
    )
    cells: Whole | None = Field(None, ge=16, le=16384, description="Cells along the site's longer side.")


class DeformationKernel(PlacementModel):
    """The model; see the module's page."""

    Parameters = DeformationKernelParameters

    def init(
        self, parameters: DeformationKernelParameters, site: Site, species: Sequence[SpeciesEcology], seed: int
    ) -> State:
        """The plants at their places."""
        rng = placement_rng(seed)
        wanted = wanted_plants(parameters, site, species, rng)
        shape = grid_shape(site, parameters.cells or 256)
        fields = [
            DensityField(species_density(parameters, site, one.name, shape), site.size_m, periodic=parameters.periodic)
            for one in species
        ]
        assert not isinstance(parameters.kernels, Mapping)
        kernels = [[table(parameters.kernels)] * len(species)] * len(species)
        placement = place(fields, wanted.sp, wanted.r_m, kernels, rng.random((len(wanted.sp), 2)))
        return placed_state(parameters, species, seed, wanted, placement.position_m, _WHY)


MODEL = DeformationKernel()
