"""Streaks of what falls before a camera, drawn over its image; labels and depth stay as they are.

Things fall at random places between `_NEAREST_M`, below which a lens blurs them, and `_FARTHEST_M`: beyond they are
part of the medium. One of diameter D at the distance r passes along a line of its way in the exposure; a pixel of the
line is covered for the share of the time that the thing needs to pass it. It shows `_CLEAR` of the image's mean
radiance: it is a lens for a field of 165 degrees (Garg and Nayar 2007, section 3). What is farther than the surface is
hidden. Parallel rays see things in a slab before the camera's plane, as large at any distance.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from forestgen.core.randomness import child_rng
from forestgen.render.frame import Frame
from forestgen.scene.motion import shutter_s
from forestgen.scene.projection import image_circle, projection_of, world_rays
from forestgen.scene.spec import Camera, Falling

Floats = NDArray[np.float64]
_NEAREST_M, _FARTHEST_M = 1.0, 12.0
_CLEAR = 0.94  # of the light that a drop lets through
_MOST_THINGS, _MOST_POINTS, _MOST_LENGTH = 1_000_000, 4_000_000, 0.5  # of a call; of the image's diagonal
_DENSE = 8  # points to a pixel of a thing that is wider than one


def with_streaks(
    frame: Frame, falling: tuple[Falling, ...], seed: int, around: Callable[[], Floats] | None = None
) -> Frame:
    """The frame with what falls in its image; `around` finds the (C,) mean light from all sides of the camera."""
    shows = image_circle(frame.camera)
    for index, one in enumerate(falling):
        rng = child_rng(seed, "falling", index, frame.camera.name)
        covered = coverage(one, frame.camera, frame.surface.distance_m, rng)
        radiance, light = frame.radiance, around() if one.is_white and around is not None else None
        shown = replace(
            radiance,
            mean=_over(radiance.mean, covered, shows, light),
            variance=(radiance.variance * (1.0 - covered[..., None]) ** 2).astype(np.float32),
            denoised=None if radiance.denoised is None else _over(radiance.denoised, covered, shows, light),
        )
        frame = replace(frame, radiance=shown)
    return frame


def _over(
    image: NDArray[np.float32], covered: Floats, shows: NDArray[np.bool_], light: Floats | None
) -> NDArray[np.float32]:
    thing = _CLEAR * image[shows].mean(axis=0, dtype=np.float64) if light is None else light
    return np.asarray(image + covered[..., None] * (thing - image), dtype=np.float32)


@dataclass(frozen=True)
class _View:
    """What pixels of a camera cover at 1 m, row by row, and how far they see."""

    camera: Camera
    start_m: Floats  # (P, 3) of rays, from the camera's place
    direction: Floats  # (P, 3)
    right: Floats  # (P, 3) by how much the view changes from pixel to pixel: directions, or places of parallel rays
    down: Floats  # (P, 3)
    area_m2: Floats  # (P,)
    open_m: Floats  # (P,)
    is_parallel: bool


def coverage(one: Falling, camera: Camera, distance_m: NDArray[np.float32], rng: np.random.Generator) -> Floats:
    """(H, W) share of the exposure in which pixels see a falling thing."""
    rays, is_parallel = world_rays(camera), projection_of(camera).is_parallel
    across_m = rays.origin_m if is_parallel else rays.direction  # of a view at 1 m
    right, down = np.gradient(across_m, axis=1), np.gradient(across_m, axis=0)
    area_m2 = np.linalg.norm(np.cross(right, down), axis=-1) * rays.valid  # of pixels, at 1 m
    start = np.broadcast_to(rays.origin_m - camera.position_m, rays.direction.shape)
    start, ways, right, down = (array.reshape(-1, 3) for array in (start, rays.direction, right, down))
    view = _View(camera, start, ways, right, down, area_m2.ravel(), distance_m.astype(np.float64).ravel(), is_parallel)
    power = 1 if is_parallel else 3
    near, far = _NEAREST_M**power, _FARTHEST_M**power
    count = int(rng.poisson(one.number_per_m3 * float(area_m2.sum()) * (far - near) / power))
    covered = np.zeros(area_m2.size)
    for first in range(0, count, _MOST_THINGS):
        covered += _covered(one, view, min(_MOST_THINGS, count - first), rng)
    return np.minimum(covered, 1.0).reshape(area_m2.shape) * rays.valid


def _covered(one: Falling, view: _View, count: int, rng: np.random.Generator) -> Floats:
    """(P,) shares by so many things."""
    camera, (width, height), power = view.camera, view.camera.size_px, 1 if view.is_parallel else 3
    near, far = _NEAREST_M**power, _FARTHEST_M**power
    pixel = rng.choice(view.area_m2.size, size=count, p=view.area_m2 / view.area_m2.sum())
    distance = (near + (far - near) * rng.random(count)) ** (1.0 / power)
    grows = np.ones(count) if view.is_parallel else distance  # a pixel's side, over that at 1 m
    diameter_mm = one.least_mm + rng.exponential(one.mean_excess_mm, count)
    way = np.column_stack([np.tile(one.drift_m_per_s, (count, 1)), -one.fall(diameter_mm)])
    if camera.motion is not None:
        place = view.start_m[pixel] + distance[:, None] * view.direction[pixel]
        turn = np.asarray(camera.world_from_camera) @ camera.motion.rotation_rad_per_s
        way = way - camera.motion.velocity_m_per_s - np.cross(turn, place)
    open_s = one.shutter_s if camera.exposure is None else shutter_s(camera)
    motion = _pixels(way * (open_s / grows)[:, None], view.right[pixel], view.down[pixel])
    length = np.linalg.norm(motion, axis=1)
    seen_mm = diameter_mm if one.seen_mm is None else one.seen_mm(diameter_mm)
    wide = seen_mm / 1000.0 / (grows * np.sqrt(np.maximum(view.area_m2[pixel], 1e-12)))
    across, shown = np.maximum(wide, 1.0), np.minimum(length, _MOST_LENGTH * np.hypot(width, height))
    # All points of a thing together cover its cross-section, or what of it lies on the length that is shown.
    area = 0.25 * np.pi * wide**2 * (shown + across) / (length + across)
    steps = np.ceil(np.where(across > 1.0, _DENSE, 2.0) * (shown + across) * across).astype(np.int64)
    centre = np.column_stack([pixel % width, pixel // width]) + rng.random((count, 2))
    covered = np.zeros(width * height)
    for some in np.array_split(np.arange(count), max(1, -(-int(steps.sum()) // _MOST_POINTS))):
        if not len(some):
            continue
        row = np.repeat(some, steps[some])
        along = (
            motion[row] / np.maximum(length[row], 1e-9)[:, None] * (shown[row] * (rng.random(len(row)) - 0.5))[:, None]
        )
        radius, angle = 0.5 * across[row] * np.sqrt(rng.random(len(row))), 2.0 * np.pi * rng.random(len(row))
        disc = radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
        x, y = np.floor(centre[row] + along + disc).astype(np.int64).T
        good = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        at = np.where(good, y * width + x, 0)
        good &= distance[row] < view.open_m[at]
        covered += np.bincount(at[good], weights=(area / steps)[row][good], minlength=width * height)
    return covered


def _pixels(change: Floats, right: Floats, down: Floats) -> Floats:
    """(N, 2) by how many pixels directions or places (N, 3) change; `right`, `down` are their changes by a pixel."""
    a, b, c = (np.einsum("nk,nk->n", *pair) for pair in ((right, right), (right, down), (down, down)))
    u, v = (np.einsum("nk,nk->n", change, one) for one in (right, down))
    scale = np.maximum(a * c - b * b, 1e-30)
    return np.column_stack([(c * u - b * v) / scale, (a * v - b * u) / scale])
