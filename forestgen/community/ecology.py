"""How a species lives, as far as community models care."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from forestgen.recipe.species import PlantType, Species


@dataclass(frozen=True)
class SpeciesEcology:
    """How a species lives, as far as a community model cares; the recipe's section checks the numbers.

    References
    ----------
    B. Lane, Models of Plant Communities for Image Synthesis, University of Calgary, 2002, chapters 4 and 6.
    """

    name: str  # as in the recipe
    growth_m_per_yr: float  # radial growth of an undominated plant, m/yr, >= 0
    max_radius_m: float  # R, m, > 0: a plant that reaches it is mature
    shade_tolerance: float  # shaded[sp]: probability in [0, 1] that a dominated plant survives a step
    old_age_survival: float  # oldage[sp]: probability in [0, 1] that a mature plant survives a step
    seedlings_per_ha_per_yr: float  # mean number of seedlings that arrive, 1/(ha yr), >= 0
    seedling_radius_m: float  # mean radius of an arriving seedling, m, > 0
    height_scale: float  # A_H of H = A_H r^c_H, metres of height at r = 1 m, > 0
    height_exponent: float  # c_H of H = A_H r^c_H, >= 0
    modules: PlantType | None = None  # how it grows as a graph of branch modules; None: not at all


Ecologies = Sequence[SpeciesEcology]  # the recipe's species, in its order: a species index counts them


def ecology_of(name: str, species: Species) -> SpeciesEcology:
    """The ecology of a recipe's species."""
    law, own = species.allometry.height_m, species.ecology.model_dump()
    return SpeciesEcology(name, height_scale=law.scale, height_exponent=law.exponent, modules=species.modules, **own)
