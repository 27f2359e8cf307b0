"""A small frame with every awkwardness: thin plants, ids beyond 2^31, sky at infinity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from forestgen.community.population import Population
from forestgen.core.parts import Part
from forestgen.render.frame import Frame, Identity, Radiance
from forestgen.scene.spec import Camera

WIDTH, HEIGHT, SAMPLES = 60, 40, 8
SPECIES = ("poplar", "spruce", "oak")


@dataclass(frozen=True)
class Shot:
    frame: Frame
    population: Population


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
    n = len(plants)
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
        depth_m=np.where(sky, np.inf, 5 + noise(HEIGHT, WIDTH)).astype(np.float32),
        position_m=np.where(sky[..., None], np.nan, noise(HEIGHT, WIDTH, 3)).astype(np.float32),
        normal=noise(HEIGHT, WIDTH, 3),
        albedo=noise(HEIGHT, WIDTH, 3),
        mean_normal=noise(HEIGHT, WIDTH, 3),
    )
    radiance = Radiance(mean, mean * np.float32(0.01), mean * np.float32(1.1) if denoised else None, 64)
    population = Population(
        time_yr=30.0,
        species_names=("oak", "poplar"),
        plant_id=plants,
        species=(np.arange(n) % 2).astype(np.uint16),
        position_m=rng.random((n, 3)),
        radius_m=rng.random(n),
        height_m=rng.random(n) * 20,
        age_yr=rng.random(n) * 30,
        status=(np.arange(n) % 4).astype(np.uint8),
    )
    return Shot(Frame(make_camera(), radiance, identity), population)
