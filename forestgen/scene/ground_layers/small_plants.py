"""Small plants of a species as ground cover: grass, ferns, herbs, seedlings of trees, dwarf shrubs.

They are background: of the part ground_plants, without a plant_id. The species is one of the recipe's `species`.

Example
-------
    species: {grass: grass}
    site: {ground: {layers: [{what: small_plants, species: grass, height_m: 0.2, cover: 0.3, patch_m: 2}]}}
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from pydantic import Field

from forestgen.core.errors import RecipeError
from forestgen.core.parts import Part
from forestgen.geometry.mesh import surface_area_m2
from forestgen.plants.build import build_exemplar
from forestgen.plants.exemplar import Exemplar, OrganMesh
from forestgen.plants.parameters import with_detail
from forestgen.plants.registry import clothes_modules
from forestgen.recipe.fields import Name, Positive
from forestgen.recipe.ground import GroundLayer
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.sources import Keys
from forestgen.recipe.species import Species
from forestgen.scene.ground_layers.layer import (
    GroundLayerKind,
    Layer,
    Request,
    Spread,
    Thing,
    mean_surface,
    scaled,
)
from forestgen.scene.phenology import leaf_states
from forestgen.scene.spec import Material
from forestgen.scene.surfaces import materials_of

_VARIANTS = 4
_TRAPPED = 0.74  # share of light: benchmarks/ground_cover.py
_TALLEST_M = 1.5
_FINE_M = 0.001  # what a pixel covers where blades get their outline


class PlantsKeys(GroundLayer):
    """Small plants."""

    species: Name = Field(description="Which one, of the recipe's species.")
    height_m: Positive = Field(0.2, ge=0.01, le=_TALLEST_M, description="Their median height, metres.")
    size_sigma: Positive = Field(0.25, le=1, description="Spread of the logarithm of their height.")


class Plants(GroundLayerKind[PlantsKeys]):
    """Small plants."""

    Parameters = PlantsKeys
    most_triangles = 1_500_000

    def check(self, keys: PlantsKeys, drawn: DrawnRecipe, where: Keys) -> None:
        known = drawn.species.get(keys.species)
        if known is not None and clothes_modules(known.plant.generator):
            problem, expected = "plants of branch modules grow in communities alone", "a species of another generator"
            at = drawn.where(*where, "species")
            raise RecipeError(problem, where=at, expected=expected, got=f"{keys.species}: {known.plant.generator}")
        if known is not None:
            return
        expected, hint = "one of " + ", ".join(drawn.species), f"add `{keys.species}: {keys.species}` to species"
        problem, at = "a species that the recipe does not have", drawn.where(*where, "species")
        raise RecipeError(problem, where=at, expected=expected, got=keys.species, hint=hint)

    def layers(self, keys: PlantsKeys, request: Request, rng: np.random.Generator) -> Sequence[Layer]:
        name, species = keys.species, request.drawn.species[keys.species]
        state, radius_m = leaf_states(request.drawn)[name][0], _radius_of(species, keys.height_m)
        plant = with_detail(request.generators[name], int(request.pixel_m < _FINE_M))
        grow = partial(build_exemplar, name, species, plant, radius_m, pixel_m=request.pixel_m, leaves=state)
        grown = [grow(rng=one) for one in rng.spawn(_VARIANTS)]
        found = materials_of({name: species}, {name: [state]})
        materials: dict[str, Material] = {}
        for _, key in found:
            materials[f"plants/{name}/{key}"] = scaled(found[name, key], 1.0)
        things = tuple(_as_cover(one, name) for one in grown)
        most = max((organ for organ in grown[0].organs), key=lambda organ: organ.mesh.triangles).part
        leafy = [organ for one in grown for organ in one.organs if organ.part == most]
        leaves = [scaled(found[name, organ.material], 1.0) for organ in leafy]
        if any(one.reflectance_spectrum is None for one in leaves):
            raise RecipeError(
                "a species whose leaves have a colour and no spectrum",
                where=request.drawn.where(*request.where, "species"),
                expected="a species whose material names a spectrum",
                got=name,
            )
        leaf = mean_surface(leaves, np.array([surface_area_m2(organ.mesh) for organ in leafy]))
        spread = Spread(tilt_deg=4.0, size_sigma=keys.size_sigma)
        return [Layer(f"plants/{name}", things, materials, keys.cover, leaf, _TRAPPED, spread, keys.patch_m)]


def _radius_of(species: Species, height_m: float) -> float:
    """Community radius of a plant of a height: H = A r^c."""
    law = species.allometry.height_m
    return float((height_m / law.scale) ** (1.0 / law.exponent))


def _as_cover(exemplar: Exemplar, name: str) -> Thing:
    organs = tuple(
        OrganMesh(Part.GROUND_PLANTS, f"plants/{name}/{one.material}", replace(one.mesh, uv=None))
        for one in exemplar.organs
    )
    return Thing(organs, max(exemplar.height_m, exemplar.crown_width_m), is_bushy=True)


LAYER = Plants()
