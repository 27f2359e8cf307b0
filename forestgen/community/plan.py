"""What a recipe's community is simulated from, once its keys are checked."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from forestgen.community.ecology import SpeciesEcology, ecology_of
from forestgen.community.model import CommunityParameters, Site
from forestgen.community.obstacles import Obstacles
from forestgen.recipe.load import DrawnRecipe


@dataclass(frozen=True)
class CommunityPlan:
    """A community model with its parameters, its site and its species."""

    drawn: DrawnRecipe
    model: Any  # a CommunityModel
    parameters: CommunityParameters
    site: Site
    ecologies: list[SpeciesEcology]  # of the species, then of kinds of buildings, which do not grow
    obstacles: Obstacles

    @classmethod
    def of(cls, drawn: DrawnRecipe, model: Any, parameters: CommunityParameters, site: Site) -> CommunityPlan:
        """The plan of a drawn recipe."""
        obstacles = Obstacles(site.buildings)
        ecologies = [ecology_of(name, species) for name, species in drawn.species.items()]
        return cls(drawn, model, parameters, site, ecologies + obstacles.ecologies(), obstacles)

    @property
    def steps(self) -> int:
        return self.parameters.steps

    @property
    def empty_reason(self) -> str | None:
        """Why no plant can ever grow; None if some may. An empty site is no error."""
        reason: str | None = self.model.empty_reason(self.parameters, self.site, self.ecologies)
        return reason
