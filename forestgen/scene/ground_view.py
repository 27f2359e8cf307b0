"""Which tiles and spots of the ground cameras see, and how well."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from forestgen.geometry.mesh import Floats
from forestgen.scene.motion import with_their_ways
from forestgen.scene.projection import project, projection_of, rays
from forestgen.scene.spec import Camera
from forestgen.scene.terrain import HeightField

TILE_M = 1.0
LEAST_PX = 1.0  # length of a thing that is drawn
FAR_M = 120.0  # from a camera that is lower above the ground, or does not look down with all of its image
MOST_TILES = 24_000  # in a scene
_NEAR_M = 3.0  # around a camera, tiles are drawn behind it, too: their light and shadow may be in view
_WIDEST_M = 400.0  # of what a camera that looks down may have as tiles
_DESCENTS = 4  # until the ground that rays reach is low enough
_STEEP = 0.5  # sine of the angle of the rays of such a camera with the level

Ints = NDArray[np.intp]


def best_pixel_m(cameras: Sequence[Camera], height: HeightField) -> float:
    """The least that a pixel of any camera covers of the ground, metres."""
    best = np.inf
    for camera in cameras:
        x, y, z = camera.position_m
        above = max(z - float(height(np.array([x]), np.array([y]))[0]), 0.3)
        best = min(best, float(projection_of(camera).finest_pixel_m(camera, np.array([above]))[0]))
    return best


def seen_tiles(cameras: Sequence[Camera], height: HeightField, length_m: float) -> tuple[Ints, Floats]:
    """(K, 2) columns and rows of the tiles where a thing of a length is seen, and (K,) metres to the nearest camera, of
    parallel rays to the middle of what it sees.
    """
    pairs = [tiles_before(camera, height, length_m) for camera in with_their_ways(cameras)]
    every = np.concatenate([np.zeros((0, 2), np.intp), *(at for at, _ in pairs)])
    distance = np.concatenate([np.zeros(0), *(apart for _, apart in pairs)])
    order = np.lexsort((distance, every[:, 1], every[:, 0]))
    every, distance = every[order], distance[order]
    first = np.ones(len(every), dtype=bool)
    first[1:] = (every[1:] != every[:-1]).any(axis=1)
    return every[first], distance[first]


def tiles_before(camera: Camera, height: HeightField, length_m: float) -> tuple[Ints, Floats]:
    """The tiles that one camera sees, in no order, and their distance as above."""
    projection, place = projection_of(camera), np.asarray(camera.position_m)
    pixel_at_1_m = float(projection.finest_pixel_m(camera, np.array([1.0]))[0])
    reach_m, footprint = length_m / LEAST_PX / pixel_at_1_m, _footprint(camera, height)
    if footprint is None:
        reach_m = min(FAR_M, reach_m)
        footprint = place[:2], np.full(2, reach_m)
    elif projection.is_parallel:
        if length_m < LEAST_PX * pixel_at_1_m:
            return np.zeros((0, 2), np.intp), np.zeros(0)
        reach_m = np.inf
    middle_m, half_m = footprint
    low, high = np.floor((middle_m - half_m) / TILE_M), np.ceil((middle_m + half_m) / TILE_M)
    columns, rows = np.arange(low[0], high[0]), np.arange(low[1], high[1])
    at = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2).astype(np.intp)
    ground = (at + 0.5) * TILE_M
    points = np.column_stack([ground, height(*ground.T)])
    away = np.linalg.norm(points - place, axis=1)
    image = project(camera, (points - place) @ camera.world_from_camera)
    margin = TILE_M / np.maximum(projection.finest_pixel_m(camera, np.maximum(away, 1e-3)), 1e-9)
    width, tall = camera.size_px
    seen = image.in_front & (image.x_px > -margin) & (image.x_px < width + margin)
    seen &= (image.y_px > -margin) & (image.y_px < tall + margin)
    if projection.is_parallel:
        return at[seen], np.hypot(*(ground - middle_m).T)[seen]
    kept = (away < reach_m) & (seen | (away < _NEAR_M))
    return at[kept], away[kept]


def in_view(cameras: Sequence[Camera], middle_m: Floats, radius_m: float) -> NDArray[np.bool_]:
    """(N,) whether balls of a radius about (N, 3) points may be in a camera's view, were nothing before them."""
    found = np.zeros(len(middle_m), dtype=bool)
    for camera in with_their_ways(cameras):
        away = middle_m - np.asarray(camera.position_m)
        image = project(camera, away @ camera.world_from_camera)
        pixel_m = projection_of(camera).finest_pixel_m(camera, np.maximum(np.linalg.norm(away, axis=1), 1e-3))
        margin, (width, tall) = radius_m / np.maximum(pixel_m, 1e-9), camera.size_px
        seen = image.in_front & (image.x_px > -margin) & (image.x_px < width + margin)
        found |= seen & (image.y_px > -margin) & (image.y_px < tall + margin)
    return found


def _footprint(camera: Camera, height: HeightField) -> tuple[Floats, Floats] | None:
    """(2,) middle and (2,) half sides, metres, of what a camera sees of the ground, at most `_WIDEST_M` wide. None of
    one that is not of parallel rays and is low, or does not look down with all of its image.
    """
    columns, rows = np.array([[0, 0], [1, 0], [0, 1], [1, 1], [0.5, 0.5]]).T * np.array(camera.size_px)[:, None]
    own, axes = rays(camera, columns, rows), np.asarray(camera.world_from_camera, dtype=np.float64)
    way, start = own.direction @ axes.T, own.origin_m @ axes.T + np.asarray(camera.position_m)
    falls, ground = -way[:, 2], height(*start[:, :2].T)
    if projection_of(camera).is_parallel:
        falls = np.maximum(falls, 0.05)
    elif not own.valid.all() or falls.min() < _STEEP or start[-1, 2] - ground[-1] < FAR_M:
        return None
    for _ in range(_DESCENTS):
        reached = start + np.clip((start[:, 2] - ground) / falls, 0.0, None)[:, None] * way
        ground = np.minimum(ground, height(*reached[:, :2].T))
    low, high = reached[:, :2].min(axis=0) - TILE_M, reached[:, :2].max(axis=0) + TILE_M
    return reached[-1, :2], np.minimum(np.maximum(high - reached[-1, :2], reached[-1, :2] - low), 0.5 * _WIDEST_M)


def nearest(apart: Sequence[Floats], most: int) -> list[NDArray[np.bool_]]:
    """Which of several lists' distances are among the `most` nearest; of equal ones the first."""
    if not apart:
        return []
    every = np.concatenate(apart)
    kept = np.zeros(len(every), dtype=bool)
    kept[np.argsort(every, kind="stable")[:most]] = True
    return np.split(kept, np.cumsum([len(one) for one in apart])[:-1])
