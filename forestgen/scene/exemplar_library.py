"""Exemplars of fixed sizes, which many images share.

Clusters fit one image's plants best, and no other image asks for the same sizes. A library's sizes are the rungs of a
ladder instead, each `SIZE_STEP` times the one below, the same for all images; plants are scaled to their own height.
So a data set of any length grows as many plants as its ladder has rungs and each rung variants.

A library's plant depends on the recipe's own seed, the split, its species and size, and not on the image. No split
shows a plant of another one's, so that validation and testing see plants that training never saw.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.core.randomness import child_rng
from forestgen.recipe.load import DrawnRecipe
from forestgen.recipe.species import Species
from forestgen.scene.exemplar_plan import ExemplarPlan

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SIZE_STEP = 1.25  # of radii: a plant is at most 12% from its rung
SLENDERNESS_STEP = 1.15  # of the scale of the heights' allometry, which a recipe may draw for each image


@dataclass(frozen=True)
class Library:
    """The plants that images share."""

    variants: int  # of each size
    shown: int  # of these in one image, at most


def rung_of(value: float, step: float) -> int:
    """The nearest rung of a ladder that has one at 1."""
    return round(float(np.log(value) / np.log(step)))


def rungs_of(radius_m: Floats, most: int) -> Ints:
    """(N,) rung that stands for each plant: its own, or where there are more than `most`, one of those evenly between.

    Parameters
    ----------
    radius_m : (N,) of a species' plants, at least one.
    """
    own: Ints = np.rint(np.log(radius_m) / np.log(SIZE_STEP)).astype(np.int64)
    if len(np.unique(own)) <= most:
        return own
    low, high = int(own.min()), int(own.max())
    count = min(most, high - low + 1)
    chosen = np.rint(low - 0.5 + (np.arange(count) + 0.5) * (high - low + 1) / count).astype(np.int64)
    place = np.searchsorted((chosen[:-1] + chosen[1:]) / 2, own)
    return np.asarray(chosen[place], dtype=np.int64)


def plan_from_library(
    index: int, name: str, radius_m: Floats, own: Ints, library: Library, most_sizes: int, seed: int
) -> tuple[ExemplarPlan, Ints]:
    """Exemplars of a species' plants by their rung, and the (N,) variant of each plant.

    Parameters
    ----------
    index, name : of the species.
    radius_m : (N,) of its plants.
    own : (N,) each plant's own number below `library.shown`, whatever else grows.
    most_sizes : in this image.
    seed : of the image, which chooses the variants that it shows.
    """
    rungs, label = np.unique(rungs_of(radius_m, most_sizes), return_inverse=True)
    shown = np.array([_shown(library, name, int(rung), seed) for rung in rungs])
    label = label.reshape(-1)
    plan = ExemplarPlan(
        species=np.full(len(rungs), index, dtype=np.uint16),
        radius_m=SIZE_STEP ** rungs.astype(np.float64),
        rank=rungs,
        variant=np.zeros(len(rungs), dtype=np.int64),
        level=np.zeros(len(rungs), dtype=np.int64),
        exemplar_of_plant=label.astype(np.uint32),
        plant=np.full(len(rungs), -1, dtype=np.int64),
        is_unique=np.zeros(len(rungs), dtype=np.bool_),
    )
    return plan, shown[label, own]


def _shown(library: Library, name: str, rung: int, seed: int) -> Ints:
    """(shown,) the variants of a size that an image has."""
    rng = child_rng(seed, "library", name, rung)
    return np.asarray(rng.permutation(library.variants)[: library.shown], dtype=np.int64)


def library_of(drawn: DrawnRecipe) -> Library | None:
    """None if each image has plants of its own."""
    section = drawn.recipe.plants
    return None if section.library is None else Library(section.library, section.variants_per_size)


def modelled_species(drawn: DrawnRecipe, name: str) -> Species:
    """The species as its exemplars grow: with a library, its heights' scale is on a ladder too.

    A recipe may draw `height_m` for each image; without the ladder no two images would ask for the same plant.
    """
    species = drawn.species[name]
    if drawn.recipe.plants.library is None:
        return species
    law = species.allometry.height_m
    scale = SLENDERNESS_STEP ** rung_of(law.scale, SLENDERNESS_STEP)
    allometry = species.allometry.model_copy(update={"height_m": law.model_copy(update={"scale": scale})})
    return species.model_copy(update={"allometry": allometry})


def origin_of(drawn: DrawnRecipe, name: str, rank: int, variant: int) -> tuple[int, tuple[str | int, ...]]:
    """Root seed and identity of an exemplar's randomness."""
    if drawn.recipe.plants.library is None:
        return drawn.image_seed, ("exemplar", name, rank, variant) if variant else ("exemplar", name, rank)
    slenderness = rung_of(drawn.species[name].allometry.height_m.scale, SLENDERNESS_STEP)
    return drawn.recipe.seed, ("library", drawn.split, name, slenderness, rank, variant)
