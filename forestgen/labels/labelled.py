"""The contract between labels and files: everything that is known of one image."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.community.population import Population
from forestgen.labels.masks import AmodalMasks, PixelLabels, amodal_masks, pixel_labels
from forestgen.labels.plants_table import PlantViews, plant_views
from forestgen.recipe.classes import ClassMap
from forestgen.recipe.registries import DEFAULT_CHANNELS
from forestgen.render.frame import Frame
from forestgen.scene.plant_measures import PlantMeasures


@dataclass(frozen=True)
class LabelledFrame:
    """One camera's view with all of its labels. Rows of plants are the population's, sorted by plant_id."""

    frame: Frame
    population: Population
    species: NDArray[np.intp]  # (N,) index into `classes.species_names`, the recipe's order
    classes: ClassMap
    pixels: PixelLabels
    views: PlantViews
    measures: PlantMeasures
    amodal: AmodalMasks | None
    channels: frozenset[str] = frozenset(DEFAULT_CHANNELS)  # of the recipe's labels.channels: what files should hold

    @property
    def category(self) -> NDArray[np.intp]:
        """(N,) index of each plant's category, see `ClassMap.instance_categories`."""
        return self.classes.instance_categories[1][self.species]


def label_frame(
    frame: Frame,
    population: Population,
    classes: ClassMap,
    measures: PlantMeasures,
    channels: Collection[str] = DEFAULT_CHANNELS,
) -> LabelledFrame:
    """Make all labels of a frame of `population`; `channels` are those to write, as in the recipe's labels.channels.

    Measures of other plants, or of another order, raise `ValueError`, as plants of the image alone do.
    """
    if len(measures.exemplar) != len(population):
        raise ValueError(f"measures of {len(measures.exemplar)} plants for a population of {len(population)}")
    identity = frame.identity
    species = classes.species_index(population.species_names)[population.species]
    pixels = pixel_labels(identity.plant_id, identity.part, population.plant_id, species, classes)
    amodal = None if frame.amodal is None else amodal_masks(frame.amodal, identity.plant_id, pixels.instance)
    views = plant_views(frame, population.plant_id, pixels, measures, amodal)
    return LabelledFrame(
        frame, population, species, classes, pixels, views, measures, amodal, channels=frozenset(channels)
    )
