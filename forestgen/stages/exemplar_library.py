"""Plants that all images of a split share: `plants.library`.

A library's plant depends on the recipe's own seed, the split, its species and size, and not on the image. No split
shows a plant of another one's, so that validation and testing see plants that training never saw.
"""

from __future__ import annotations

from forestgen.recipe.species import Species
from forestgen.scene.exemplars import SLENDERNESS_STEP, Library, rung_of
from forestgen.stages.plan import Plan


def library_of(plan: Plan) -> Library | None:
    """None if each image has plants of its own."""
    section = plan.drawn.recipe.plants
    return None if section.library is None else Library(section.library, section.variants_per_size)


def modelled_species(plan: Plan, name: str) -> Species:
    """The species as its exemplars grow: with a library, its heights' scale is on a ladder too.

    A recipe may draw `height_m` for each image; without the ladder no two images would ask for the same plant.
    """
    species = plan.drawn.species[name]
    if plan.drawn.recipe.plants.library is None:
        return species
    law = species.allometry.height_m
    scale = SLENDERNESS_STEP ** rung_of(law.scale, SLENDERNESS_STEP)
    allometry = species.allometry.model_copy(update={"height_m": law.model_copy(update={"scale": scale})})
    return species.model_copy(update={"allometry": allometry})


def origin_of(plan: Plan, name: str, rank: int, variant: int) -> tuple[int, tuple[str | int, ...]]:
    """Root seed and identity of an exemplar's randomness."""
    drawn = plan.drawn
    if drawn.recipe.plants.library is None:
        return drawn.image_seed, ("exemplar", name, rank, variant) if variant else ("exemplar", name, rank)
    slenderness = rung_of(drawn.species[name].allometry.height_m.scale, SLENDERNESS_STEP)
    return drawn.recipe.seed, ("library", drawn.split, name, slenderness, rank, variant)
