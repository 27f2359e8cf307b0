"""A small frame with every awkwardness: thin plants, ids beyond 2^31, sky at infinity."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from forestgen.community.population import Population
from forestgen.core.parts import Part
from forestgen.dataset.settings import DatasetSettings
from forestgen.labels.labelled import LabelledFrame, label_frame, plant_views
from forestgen.labels.masks import AmodalMasks
from forestgen.recipe.classes import ClassMap
from forestgen.render.frame import Frame, Identity, Radiance, Surface
from forestgen.scene.plant_measures import PlantMeasures
from forestgen.scene.spec import Camera

WIDTH, HEIGHT, SAMPLES = 60, 40, 8
SPECIES = ("poplar", "spruce", "oak")
CLASSES = ClassMap(SPECIES)
SETTINGS = DatasetSettings(SPECIES, CLASSES.names, SPECIES, tuple(range(len(SPECIES))))


@dataclass(frozen=True)
class Shot:
    frame: Frame
    population: Population
    labelled: LabelledFrame  # of both, with amodal masks, boundaries and motion


def make_camera(name="camera0", size_px=(WIDTH, HEIGHT)):
    forward = np.array([0.6, 0.7, -0.2])
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(forward, right), forward], axis=1)
    return Camera(name, (3.0, -4.0, 12.0), axes, size_px, 55.0)


def make_shot(plant_id, seed=0, denoised=True):
    rng = np.random.default_rng(seed)
    plants = np.array(sorted(plant_id), np.uint32)
    ids = np.zeros((HEIGHT, WIDTH, SAMPLES), np.uint32)
    part = np.zeros(ids.shape, np.uint8)
    part[HEIGHT // 2 :] = Part.GROUND
    for plant in plants[:-1]:  # the last one stays unseen
        y, x = rng.integers(0, HEIGHT - 4), rng.integers(0, WIDTH - 4)
        spot = (slice(y, y + 12), slice(x, x + 9))
        hit = rng.random(ids[spot].shape) < 0.6
        ids[spot][hit] = plant
        part[spot][hit] = Part.LEAF
    sky = (ids[..., 0] == 0) & (part[..., 0] == Part.NOTHING)

    def noise(*shape):
        return rng.random(shape).astype(np.float32)

    mean = noise(HEIGHT, WIDTH, 3) + np.float32(0.01)
    identity = Identity(
        plant_id=ids,
        part=part,
    )
    depth = np.where(sky, np.inf, 5 + noise(HEIGHT, WIDTH)).astype(np.float32)
    surface = Surface(
        plant_id=ids[..., 0].copy(),
        part=part[..., 0].copy(),
        exemplar=(ids[..., 0] > 0).astype(np.uint32),
        face=np.zeros((HEIGHT, WIDTH), np.uint32),
        depth_m=depth,
        distance_m=depth * np.float32(1.25),
        position_m=np.where(sky[..., None], np.nan, noise(HEIGHT, WIDTH, 3)).astype(np.float32),
        normal=noise(HEIGHT, WIDTH, 3),
        shading_normal=noise(HEIGHT, WIDTH, 3),
        albedo=noise(HEIGHT, WIDTH, 3),
        sun_visible=~sky & (noise(HEIGHT, WIDTH) < 0.5),
    )
    radiance = Radiance(mean, mean * np.float32(0.01), mean * np.float32(1.1) if denoised else None, 64)
    population = make_population(plants, rng)
    motion = noise(HEIGHT, WIDTH, 2) * 3
    motion[0, 0] = np.nan
    frame = Frame(
        make_camera(),
        radiance,
        identity,
        surface,
        cloud_opacity=noise(HEIGHT, WIDTH),
        motion_px=motion,
    )
    return Shot(frame, population, make_labels(frame, population, rng))


def make_labels(frame, population, rng, classes=CLASSES):
    """Labels with amodal masks that reach beyond what is seen, by the definition: pixel by pixel."""
    labelled = label_frame(frame, population, classes, make_measures(population, rng))
    amodal = make_amodal(frame.identity.plant_id, labelled.pixels.instance, rng)
    views = plant_views(frame, population.plant_id, labelled.pixels, labelled.measures, amodal)
    return replace(labelled, amodal=amodal, views=views)


def make_population(plants, rng):
    """Oaks and poplars by turns."""
    n = len(plants)
    return Population(
        time_yr=30.0,
        species_names=("oak", "poplar"),
        plant_id=plants,
        species=(np.arange(n) % 2).astype(np.uint16),
        position_m=rng.random((n, 3)),
        radius_m=rng.random(n),
        height_m=rng.random(n) * 20,
        age_yr=rng.random(n) * 30,
        status=(np.arange(n) % 4).astype(np.uint8),
        columns={
            "adaptation": np.linspace(0, 1, n, dtype=np.float32),
            "dead_form": np.where(np.arange(n) % 4 == 3, np.uint8(1), np.uint8(0)),
            "decay_class": np.where(np.arange(n) % 4 == 3, np.uint8(5), np.uint8(0)),
        },
    )


def make_measures(population, rng):
    """Plants that stand before the camera, on either side of the image's borders."""
    n = len(population)
    ahead = np.asarray(make_camera().position_m) + rng.uniform(5, 30, (n, 1)) * make_camera().world_from_camera[:, 2]
    base = ahead + rng.uniform(-4, 4, (n, 3))
    dbh = rng.random(n)
    dbh[::3] = np.nan
    return PlantMeasures(
        exemplar=(np.arange(n) % 3).astype(np.uint32),
        world_from_exemplar=np.concatenate([np.broadcast_to(np.eye(3), (n, 3, 3)), base[:, :, None]], axis=2),
        crown_width_m=rng.random(n) * 4,
        dbh_m=dbh,
        crown_base_m=np.full(n, 1.5),
        leaf_area_m2=rng.random(n) * 50,
        stem_base_m=base,
        tip_m=base + np.array([0.1, 0.0, 3.0]),
        crown_centre_m=base + np.array([0.0, 0.1, 2.0]),
    )


def make_amodal(samples, instance, rng):
    """Each plant that a sample hit, seen alone: where it is seen, and in about a tenth of the other samples nearby."""
    plants = [plant for plant in np.unique(samples) if plant]
    boxes, masks, areas, full = [], [], [], []
    for plant in plants:
        hit = samples == plant
        y, x = np.nonzero(hit.any(axis=2))
        near = np.zeros(hit.shape, bool)
        near[max(0, y.min() - 2) : y.max() + 3, max(0, x.min() - 2) : x.max() + 3] = True
        alone = hit | (near & (rng.random(hit.shape) < 0.1))
        mask = (alone.sum(axis=2) * 2 > SAMPLES) | (instance == plant)
        areas.append(alone.mean(axis=2).sum())
        full.append([x.min() - 2.5, y.min() - 1.5, x.max() + 3.5, y.max() + 2.5])
        y, x = np.nonzero(mask)
        low_x, low_y, high_x, high_y = (x.min(), y.min(), x.max() + 1, y.max() + 1) if len(x) else (0, 0, 0, 0)
        boxes.append([low_x, low_y, high_x - low_x, high_y - low_y])
        masks.append(mask[low_y:high_y, low_x:high_x].ravel())
    return AmodalMasks(
        plant_id=np.array(plants, np.uint32),
        box_px=np.array(boxes, np.int32).reshape(-1, 4),
        first=np.concatenate([[0], np.cumsum([len(mask) for mask in masks])]).astype(np.int64),
        inside=np.concatenate([np.zeros(0, bool), *masks]),
        pixels=np.array([mask.sum() for mask in masks], np.int64),
        area_px=np.array(areas, np.float64),
        full_box_px=np.array(full, np.float64).reshape(-1, 4),
    )
