"""A plantation: trees in rows at a fixed spacing, displaced by some decimetres, with gaps where seedlings failed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydantic import Field

from forestgen.community.population import Site, SpeciesEcology
from forestgen.community.static_model import Placement, StaticModel, StaticParameters


class PlantationParameters(StaticParameters):
    """Keys of `community: {model: plantation}`."""

    row_m: float = Field(3.0, ge=0.5, description="distance between rows")
    tree_m: float = Field(2.0, ge=0.5, description="distance between the trees of a row")
    displacement_m: float = Field(0.2, ge=0, description="standard deviation of a tree's distance from its place")
    failed: float = Field(0.1, ge=0, le=1, description="share of the trees that are missing")
    smallest: float = Field(0.6, gt=0, le=1, description="least radius, as a share of the species' largest")
    largest: float = Field(0.9, gt=0, le=1, description="greatest radius, as a share of the species' largest")


class Plantation(StaticModel[PlantationParameters]):
    """Trees in rows along y; the species alternate from row to row."""

    Parameters = PlantationParameters

    def place(
        self,
        parameters: PlantationParameters,
        site: Site,
        species: Sequence[SpeciesEcology],
        rng: np.random.Generator,
    ) -> Placement:
        x, y = (np.arange(d / 2, side, d) for d, side in zip(_spacing(parameters), site.size_m, strict=True))
        position_m = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
        kinds = np.repeat(np.arange(len(x)) % len(species), len(y))
        position_m = np.clip(position_m + rng.normal(0, parameters.displacement_m, position_m.shape), 0, site.size_m)
        largest_m = np.array([one.max_radius_m for one in species])[kinds]
        radius_m = largest_m * rng.uniform(parameters.smallest, parameters.largest, len(kinds))
        alive = rng.random(len(kinds)) >= parameters.failed
        return Placement(kinds[alive], position_m[alive], radius_m[alive])

    def most_plants(self, parameters: PlantationParameters, site: Site, species: Sequence[SpeciesEcology]) -> float:
        (row_m, tree_m), (width_m, depth_m) = _spacing(parameters), site.size_m
        return (width_m / row_m + 1) * (depth_m / tree_m + 1) * (1 - parameters.failed)


def _spacing(parameters: PlantationParameters) -> tuple[float, float]:
    return parameters.row_m, parameters.tree_m


MODEL = Plantation()
