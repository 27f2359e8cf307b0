"""All labels of a frame together: what one says, the others do not deny."""

from __future__ import annotations

import numpy as np
import pytest

from forestgen.community.population import Population
from forestgen.core.frames import look_at
from forestgen.core.parts import Part
from forestgen.labels.labelled import label_frame
from forestgen.recipe.classes import ClassMap
from forestgen.recipe.registries import LABEL_CHANNELS
from forestgen.render.frame import Amodal, Frame, Identity, Radiance, Surface
from forestgen.scene.plant_measures import PlantMeasures
from forestgen.scene.spec import Camera

WIDTH, HEIGHT, SAMPLES = 16, 10, 4
PLANTS = np.array([4, 9, 70_000], np.uint32)


@pytest.fixture
def frame():
    """Plants at random; alone, each hits what it hits here, and half of the other samples of its window."""
    rng = np.random.default_rng(3)
    samples = rng.choice(np.array([0, 4, 9], np.uint32), (HEIGHT, WIDTH, SAMPLES))
    part = np.where(samples > 0, rng.choice([Part.TRUNK, Part.LEAF], samples.shape), Part.GROUND).astype(np.uint8)
    windows = np.array([[0, 0, WIDTH, HEIGHT]] * 2, np.int32)
    alone = [(samples == plant) | (rng.random(samples.shape) < 0.5) for plant in PLANTS[:2]]
    hits = [one.sum(axis=2).ravel() for one in alone]
    amodal = Amodal(
        PLANTS[:2], SAMPLES, windows, np.array([0, 160, 320]), np.concatenate(hits).astype(np.uint16),
        np.array([[-WIDTH, 0, WIDTH, HEIGHT], [0, 0, WIDTH, HEIGHT]], float),
    )  # fmt: skip
    colour, number = np.zeros((HEIGHT, WIDTH, 3), np.float32), np.zeros((HEIGHT, WIDTH), np.uint32)
    depth = np.where(np.arange(WIDTH) < 8, 1, 5).astype(np.float32) * np.ones((HEIGHT, 1), np.float32)
    surface = Surface(number, number.astype(np.uint8), number, number, depth, depth, *[colour] * 4, depth > 2)
    position = (0.0, -5.0, 1.0)
    camera = Camera("c", position, look_at(np.array(position), np.zeros(3)), (WIDTH, HEIGHT), 60.0)
    return Frame(
        camera, Radiance(colour, colour, None, 1), Identity(samples, part, colour, colour), surface, amodal=amodal
    )


@pytest.fixture
def population():
    n = len(PLANTS)
    number = np.ones(n)
    species = np.array([1, 0, 1], np.uint16)
    return Population(
        0.0, ("fir", "oak"), PLANTS, species, np.ones((n, 3)), number, number, number, np.zeros(n, np.uint8)
    )


def measures(count):
    return PlantMeasures(
        np.zeros(count, np.uint32), np.zeros((count, 3, 4)), *np.ones((4, count)), *np.zeros((3, count, 3))
    )


def test_labels_agree(frame, population):
    labelled = label_frame(frame, population, ClassMap(("oak", "beech", "fir")), measures(3))
    assert labelled.species.tolist() == [0, 2, 0]  # the recipe's order, not the population's
    instance, views, amodal = labelled.pixels.instance, labelled.views, labelled.amodal
    names = np.array(labelled.classes.names)[labelled.pixels.semantic]
    assert set(names[instance == 4]) == {"oak"}
    assert set(names[instance == 9]) == {"fir"}
    assert set(names[instance == 0]) == {"ground"}
    for row, plant in enumerate(PLANTS[:2]):
        alone = np.zeros(instance.shape, bool)
        x, y, width, height = amodal.box_px[row]
        alone[y : y + height, x : x + width] = amodal.mask_of(row)
        assert not ((instance == plant) & ~alone).any()
        assert views.amodal_pixels[row] == alone.sum() >= views.visible.visible_pixels[row] > 0
        assert 0 < views.visible_fraction[row] < 1
        assert 0 < views.stem_pixels[row] < views.visible.visible_pixels[row]
    assert views.truncation[:2].tolist() == [0.5, 0.0]
    assert np.isnan(views.visible_fraction[2])


def test_boundaries_are_made_where_they_are_asked_for(frame, population):
    found = label_frame(frame, population, ClassMap(("oak", "fir")), measures(3), ["boundaries"])
    assert found.channels == {"boundaries"}
    (channel,) = LABEL_CHANNELS.load_all(found.channels)
    occluding = channel.parts(found)["boundary"]["occluding"]
    assert occluding[:, 7].all()
    assert occluding.sum() == HEIGHT


def test_measures_of_other_plants_are_refused(frame, population):
    with pytest.raises(ValueError, match="2 plants for a population of 3"):
        label_frame(frame, population, ClassMap(("oak", "fir")), measures(2))
