"""The contract between labels and files: everything that is known of one image. Pure NumPy.

Of each plant a camera sees pixels, areas, boxes, keypoints:

| term             | definition |
|------------------|------------|
| visible pixels   | pixels that the plant wins in the instance mask |
| visible area     | sum of the plant's coverage over all pixels, won or lost; pixels |
| amodal area      | the same for the plant alone, with the same sub-pixel positions, within the image |
| visible fraction | visible area over amodal area: the share of the plant's part of the image that nothing hides |
| full box         | box of the projection of the plant's convex hull, beyond the image too; of what the camera faces |
| truncation       | share of the full box' area that lies outside the image |
| truncated        | a won pixel touches the image's border, the seam of a panorama too; a fisheye's circle is none |
| keypoints        | stem base (the instance's origin), tip (highest vertex), crown centre: scene/plant_measures.py |
| keypoint state   | 0 outside the image or behind the camera; 1 inside, where the plant does not win; 2 where it wins |
| distance         | from the camera to the stem base |

A keypoint at (x, y) falls in the pixel (floor x, floor y). State 2 says that the plant is what the pixel shows, not
that the point itself is in view: a stem base may stand behind its own plant's leaves. Outside of a fisheye's circle
there is no keypoint, as behind the camera. A lens projects through its middle; its areas and boxes are of what is seen
through all of it. A plant across a panorama's seam has boxes as wide as the image: its parts lie at both ends.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.community.population import Population
from forestgen.core.parts import Part
from forestgen.labels.masks import AmodalMasks, PixelLabels, amodal_masks, pixel_labels, rows_of
from forestgen.recipe.classes import ClassMap
from forestgen.recipe.registries import DEFAULT_CHANNELS
from forestgen.render.frame import Frame
from forestgen.scene import projection
from forestgen.scene.plant_measures import PlantMeasures
from forestgen.scene.spec import Camera

KEYPOINTS = ("stem_base", "tip", "crown_centre")
OUTSIDE, HIDDEN, VISIBLE = 0, 1, 2  # states of a keypoint


@dataclass(frozen=True)
class VisiblePlants:
    """One row a plant of the population, seen or not, in the population's order."""

    plant_id: NDArray[np.uint32]  # (N,)
    visible_pixels: NDArray[np.int64]  # (N,) pixels that the plant wins in the instance mask
    visible_area_px: NDArray[np.float64]  # (N,) pixels: sum of its coverage over all pixels, won or lost
    box_px: NDArray[np.int32]  # (N, 4) x, y, width, height of the won pixels, COCO's convention; 0 where none
    truncated: NDArray[np.bool_]  # (N,) a won pixel touches the image's border

    @property
    def has_box(self) -> NDArray[np.bool_]:
        """(N,) the plant wins at least one pixel."""
        return self.visible_pixels > 0


@dataclass(frozen=True)
class PlantViews:
    """What one camera sees of each plant: one row a plant of the population, in its order."""

    visible: VisiblePlants
    amodal_pixels: NDArray[np.int64]  # (N,) 0 where the plant is unseen or amodal masks were not asked for
    amodal_area_px: NDArray[np.float64]  # (N,) NaN there
    amodal_box_px: NDArray[np.int32]  # (N, 4) x, y, width, height; 0 there
    full_box_px: NDArray[np.float64]  # (N, 4) left, top, right, bottom, beyond the image too; NaN there
    visible_fraction: NDArray[np.float64]  # (N,) visible_area_px / amodal_area_px, in [0, 1]; NaN there
    truncation: NDArray[np.float64]  # (N,) share of full_box_px outside the image; NaN there
    stem_pixels: NDArray[np.int64]  # (N,) pixels that the plant wins with its trunk
    keypoint_px: NDArray[np.float64]  # (N, 3, 2) stem base, tip, crown centre; NaN where the camera cannot see
    keypoint_state: NDArray[np.uint8]  # (N, 3) 0 outside the image, 1 hidden, 2 the plant wins the pixel it falls in
    distance_m: NDArray[np.float64]  # (N,) from the camera to the stem base


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
    def outside(self) -> NDArray[np.bool_]:
        """(N,) plants beyond the site's edge; no statistics of the stand count them."""
        return outside_of(self.population)

    @property
    def category(self) -> NDArray[np.intp]:
        """(N,) index of each plant's category, see `ClassMap.instance_categories`."""
        return self.classes.instance_categories[1][self.species]


def outside_of(population: Population) -> NDArray[np.bool_]:
    """(N,) its plants beyond the site's edge."""
    return population.columns.get("outside", np.zeros(len(population), dtype=np.bool_))


def shown_rows(frame: Frame, population: Population) -> NDArray[np.bool_]:
    """(N,) the plants of the site, and those outside that the frame shows."""
    rows = ~outside_of(population)
    if not rows.all():
        shown = np.union1d(np.unique(frame.identity.plant_id), np.unique(frame.surface.plant_id))
        rows |= np.isin(population.plant_id, shown)
    return rows


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


def plant_views(
    frame: Frame,
    plant_id: NDArray[np.uint32],
    pixels: PixelLabels,
    measures: PlantMeasures,
    amodal: AmodalMasks | None,
) -> PlantViews:
    """Measure each plant (N,), ids sorted, in one image; see the table above. `measures` are in the same order."""
    count, stems = len(plant_id), pixels.instance[pixels.part == Part.TRUNK]
    visible = visible_plants(plant_id, frame.identity.plant_id, pixels.instance)
    points_m = np.stack([measures.stem_base_m, measures.tip_m, measures.crown_centre_m], axis=1)
    keypoint_px = project(frame.camera, points_m)
    away = measures.stem_base_m - np.asarray(frame.camera.position_m)
    alone = np.zeros((count, 5), dtype=np.int64)  # pixels and box
    area, full_box = np.full(count, np.nan), np.full((count, 4), np.nan)
    if amodal is not None:
        row = rows_of(amodal.plant_id, plant_id)
        alone[row] = np.column_stack([amodal.pixels, amodal.box_px])
        area[row], full_box[row] = amodal.area_px, amodal.full_box_px
    fraction = np.divide(visible.visible_area_px, area, out=np.full(count, np.nan), where=area > 0.0)
    return PlantViews(
        visible=visible,
        amodal_pixels=alone[:, 0],
        amodal_area_px=area,
        amodal_box_px=alone[:, 1:].astype(np.int32),
        full_box_px=full_box,
        visible_fraction=np.minimum(fraction, 1.0),  # a ray along an edge may miss a plant that stands alone
        truncation=truncation(full_box, frame.camera.size_px),
        stem_pixels=np.bincount(rows_of(stems[stems != 0], plant_id), minlength=count).astype(np.int64),
        keypoint_px=keypoint_px,
        keypoint_state=_states(keypoint_px, plant_id, pixels.instance),
        distance_m=np.sqrt(np.einsum("nk,nk->n", away, away)),
    )


def project(camera: Camera, points_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """(..., 2) pixels, right and down, of (..., 3) points in the world; NaN for those that the camera cannot see."""
    away = points_m - np.asarray(camera.position_m)
    seen = projection.project(camera, projection.in_own_axes(camera, away))
    pixels = np.stack([seen.x_px, seen.y_px], axis=-1)
    return np.asarray(np.where(seen.in_front[..., None], pixels, np.nan))


def truncation(full_box_px: NDArray[np.float64], size_px: tuple[int, int]) -> NDArray[np.float64]:
    """(N,) share of the area of (N, 4) boxes (left, top, right, bottom) outside the image; NaN for boxes that are."""
    box = full_box_px.reshape(-1, 2, 2)  # corner, axis
    inside = np.clip(box, 0.0, np.asarray(size_px, dtype=np.float64))
    extent, kept = box[:, 1] - box[:, 0], inside[:, 1] - inside[:, 0]
    # By axis, so that a box without width is in or out as its line is.
    within = np.all((box[:, 1] >= 0.0) & (box[:, 0] <= np.asarray(size_px)), axis=1)
    share = np.divide(kept, extent, out=np.ones_like(kept), where=extent > 0.0).prod(axis=1)
    outside = 1.0 - np.where(within, share, 0.0)
    return np.asarray(np.where(np.isnan(full_box_px).any(axis=1), np.nan, outside))


def _states(
    points_px: NDArray[np.float64], plant_id: NDArray[np.uint32], instance: NDArray[np.uint32]
) -> NDArray[np.uint8]:
    """(N, K) states of (N, K, 2) keypoints."""
    height, width = instance.shape
    x, y = points_px[..., 0], points_px[..., 1]
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)  # False for NaN
    state = np.zeros(inside.shape, dtype=np.uint8)
    at = instance[y[inside].astype(np.intp), x[inside].astype(np.intp)]
    owner = np.broadcast_to(plant_id[:, None], inside.shape)[inside]
    state[inside] = np.where(at == owner, VISIBLE, HIDDEN)
    return state


def visible_plants(
    plant_id: NDArray[np.uint32], samples: NDArray[np.uint32], instance: NDArray[np.uint32]
) -> VisiblePlants:
    """What is visible of each plant (N,), ids sorted, of samples (H, W, S) and mask (H, W).

    An id in the image that is not among the plants' raises `ValueError`.
    """
    pixels, box = _boxes(plant_id, instance)
    ids, count = np.unique(samples, return_counts=True)
    area = np.zeros(len(plant_id))
    area[rows_of(ids[ids != 0], plant_id)] = count[ids != 0] / samples.shape[2]
    height, width = instance.shape
    far = box[:, :2] + box[:, 2:]
    touches = (box[:, 0] == 0) | (box[:, 1] == 0) | (far[:, 0] == width) | (far[:, 1] == height)
    return VisiblePlants(plant_id, pixels, area, box, truncated=touches & (pixels > 0))


def _boxes(plant_id: NDArray[np.uint32], instance: NDArray[np.uint32]) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Pixel counts (N,) and boxes (N, 4) of the mask, by sorting its pixels by plant."""
    pixels = np.zeros(len(plant_id), dtype=np.int64)
    box = np.zeros((len(plant_id), 4), dtype=np.int32)
    y, x = np.nonzero(instance)
    if len(x) == 0:
        return pixels, box
    row = rows_of(instance[y, x], plant_id)
    order = np.argsort(row, kind="stable")
    present, first, count = np.unique(row[order], return_index=True, return_counts=True)
    pixels[present] = count
    low = np.stack([np.minimum.reduceat(axis[order], first) for axis in (x, y)], axis=1)
    high = np.stack([np.maximum.reduceat(axis[order], first) for axis in (x, y)], axis=1)
    box[present, :2] = low
    box[present, 2:] = high - low + 1
    return pixels, box
