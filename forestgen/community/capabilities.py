"""What a community model may offer besides `CommunityModel`: protocols that core code asks for by `capability`.

A model has a capability if it has its methods. `parameters` are the model's own; what is drawn is its recipe.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from forestgen.community.registry import COMMUNITY_MODELS

if TYPE_CHECKING:
    from forestgen.architecture.prototypes import Tables
    from forestgen.atmosphere.grid import AirGrid, Weather
    from forestgen.community.placement.model import Densities
    from forestgen.community.population import Ecologies, Population, Site
    from forestgen.community.simulation import CommunityPlan
    from forestgen.core.progress import Progress
    from forestgen.recipe.load import DrawnRecipe

Capability = TypeVar("Capability")


@runtime_checkable
class PlanChecks(Protocol):
    """Checks of the model's keys against the rest of the recipe."""

    def check_recipe(self, drawn: DrawnRecipe, parameters: Any) -> None:
        """Raise `RecipeError` or `ResourceError`, with the key's line, before anything is simulated."""


@runtime_checkable
class HasObstacles(Protocol):
    """Buildings of the site block light and plants, and are the first rows of every population: plant_id 1, 2, ..."""

    has_obstacles: bool


@runtime_checkable
class OwnSkeletons(Protocol):
    """Plants with branches of their own, in `Population.modules`."""

    def skeleton_tables(self, parameters: Any, species: Ecologies, population: Population) -> Tables:
        """The shapes and sizes of a population's modules at its time; species in the population's order."""

    def check_foliage(self, drawn: DrawnRecipe, parameters: Any, species: Collection[str]) -> None:
        """Raise `RecipeError` if plants will need foliage on their own branches beyond that of `species`."""

    def keeps_skeletons(self, parameters: Any) -> bool:
        """Whether a history keeps the modules too."""


@runtime_checkable
class OwnAir(Protocol):
    """Air that the model simulates over its plants, for ``sky.clouds.type: community``."""

    def air_grid(self, drawn: DrawnRecipe, parameters: Any) -> AirGrid:
        """The cells of the air that a picture shows; raises `RecipeError` if there is none at the last step."""

    def air(self, plan: CommunityPlan, population: Population, progress: Progress) -> Weather:
        """The air over a population as the community left it; raises `RecipeError` if it cannot be stepped."""


class SoilWaterMaps(NamedTuple):
    """Water of a site, row 0 at y = 0."""

    soil_mm: NDArray[np.float64]  # (rows, cols)
    surface_mm: NDArray[np.float64]  # (rows, cols)
    depth_m: float  # of the soil that holds it, by default


@runtime_checkable
class SoilWater(Protocol):
    """Water on and in the soil."""

    def soil_water(self, parameters: Any, population: Population) -> SoilWaterMaps:
        """The water of a population's time."""


@runtime_checkable
class AskedDensities(Protocol):
    """Plants placed by densities that the recipe asks for."""

    def densities(self, parameters: Any, site: Site, species: Ecologies, placed: Population) -> Densities:
        """The densities, for pictures and statistics of the plants `placed` in step 0."""


@runtime_checkable
class AskedHeights(Protocol):
    """Plants of sizes that the recipe asks for."""

    def asked_heights_m(self, parameters: Any, site: Site, species: Ecologies) -> Mapping[str, tuple[float, float]]:
        """Least and greatest height, metres, of nearly all plants of each species that is placed."""


@runtime_checkable
class OneCohort(Protocol):
    """Plants that may all be of one age, and so of one size."""

    def is_cohort(self, parameters: Any, site: Site, species: Ecologies) -> bool:
        """Whether no seedlings are known to follow the first plants."""


def capability(model: object, kind: type[Capability]) -> Capability | None:
    """The model, if it has a capability; else None."""
    return model if isinstance(model, kind) else None


def models_with(kind: type[Any]) -> str:
    """Names of the models that have a capability, for messages: it imports them all."""
    names = [name for name in COMMUNITY_MODELS.ids() if isinstance(COMMUNITY_MODELS.load(name), kind)]
    return " or ".join(names)
