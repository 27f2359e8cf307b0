"""Labelled frames from a drawn mask: for formats' awkward cases."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
from dataset_shots import CLASSES, SETTINGS, make_camera, make_labels, make_population

from forestgen.core.parts import Part
from forestgen.dataset.png import write_png
from forestgen.render.frame import Frame, Identity, Radiance, Surface

SAMPLES = 8
LICENSED = replace(
    SETTINGS,
    description='Trees "seen" from above – été',
    contributor="A. Ünlü \\ Söhne",
    licence_name="CC BY 4.0",
    licence_url="https://creativecommons.org/licenses/by/4.0/",
)


def drawn(instance, part=None, unseen=(), seed=0, classes=CLASSES):
    """A labelled frame with just this instance mask; where nothing grows, sky above and ground below the middle."""
    instance = np.asarray(instance, np.uint32)
    height, width = instance.shape
    if part is None:
        ground = np.where(np.arange(height) < height // 2, Part.NOTHING, Part.GROUND)[:, None]
        part = np.where(instance > 0, Part.LEAF, ground)
    part = np.asarray(part, np.uint8)
    rng = np.random.default_rng(seed)
    plants = np.array(sorted({*np.unique(instance[instance > 0]).tolist(), *unseen}), np.uint32)
    sky = part == Part.NOTHING
    depth = np.where(sky, np.inf, 5 + rng.random(instance.shape)).astype(np.float32)
    colour = rng.random((height, width, 3)).astype(np.float32)
    surface = Surface(
        plant_id=instance,
        part=part,
        exemplar=(instance > 0).astype(np.uint32),
        face=np.zeros(instance.shape, np.uint32),
        depth_m=depth,
        distance_m=depth,
        position_m=np.where(sky[..., None], np.nan, colour).astype(np.float32),
        normal=colour,
        shading_normal=colour,
        albedo=colour,
        sun_visible=~sky,
    )
    samples = np.repeat(instance[..., None], SAMPLES, axis=2)
    identity = Identity(samples, np.repeat(part[..., None], SAMPLES, axis=2), colour, colour)
    frame = Frame(make_camera(size_px=(width, height)), Radiance(colour, colour, None, 4), identity, surface)
    population = make_population(plants, rng)
    assert CLASSES.species_names == SETTINGS.species_names
    return make_labels(frame, population, rng, classes)


def written(module, root, frames, settings=SETTINGS):
    """Frames written by two workers and merged; `frames` is folder name -> labelled frame, in any order."""

    def work(item):
        name, labelled = item
        folder = root / name
        folder.mkdir(parents=True, exist_ok=True)
        width, height = labelled.frame.camera.size_px
        write_png(folder / "preview.png", np.full((height, width, 3), 90, np.uint8))
        module.FORMAT.write_frame(folder, labelled, settings)

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(work, frames.items()))
    module.FORMAT.merge(root, list(frames), settings)
    return root


def all_bytes(root):
    """Content of every file below a folder."""
    return {str(path.relative_to(root)): path.read_bytes() for path in sorted(root.rglob("*")) if path.is_file()}


def awkward_masks():
    """Masks with a plant of one pixel, plants with holes, nested, at corners, in stripes, alone, and none at all."""
    rng = np.random.default_rng(5)
    ring = np.zeros((9, 11), np.uint32)
    ring[1:8, 1:10] = 7
    ring[3:6, 3:8] = 0
    nested = ring.copy()
    nested[4, 5] = 7
    nested[3, 3] = 4_000_000_000
    one = np.zeros((5, 4), np.uint32)
    one[4, 3] = 3
    checks = (np.indices((6, 7)).sum(axis=0) % 2 * 2**24).astype(np.uint32)
    stripes = np.tile(np.arange(6, dtype=np.uint32) % 3, (5, 1))
    noise = rng.integers(0, 5, (23, 31)).astype(np.uint32)
    full, none, single = np.full((4, 6), 9, np.uint32), np.zeros((4, 6), np.uint32), np.array([[2**32 - 1]], np.uint32)
    return [ring, nested, one, checks, stripes, noise, full, none, single, noise[:1], noise[:, :1]]
