"""Streaks of what falls before a camera, drawn over its image; labels and depth stay as they are.

Things fall at random places between `_NEAREST_M`, below which a lens blurs them, and `_FARTHEST_M`: beyond they are
part of the medium. One of diameter D at the distance r passes along a line of its way in the exposure; a pixel of the
line is covered for the share of the time that the thing needs to pass it. It shows `_CLEAR` of the image's mean
radiance: it is a lens for a field of 165 degrees (Garg and Nayar 2007, section 3). What is farther than the surface is
hidden. Parallel rays see things in a slab before the camera's plane, as large at any distance.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from forestgen.core.randomness import child_rng
from forestgen.render.frame import Frame
from forestgen.scene.projection import image_circle, projection_of, world_rays
from forestgen.scene.spec import Camera, Falling

Floats = NDArray[np.float64]
_NEAREST_M, _FARTHEST_M = 1.0, 12.0
_CLEAR = 0.94  # of the light that a drop lets through
_MOST_POINTS, _MOST_LENGTH = 4_000_000, 0.5  # of a call; of the image's diagonal


def with_streaks(frame: Frame, falling: tuple[Falling, ...], seed: int) -> Frame:
    """The frame with what falls in its image."""
    shows = image_circle(frame.camera)
    for index, one in enumerate(falling):
        rng = child_rng(seed, "falling", index, frame.camera.name)
        covered = coverage(one, frame.camera, frame.surface.distance_m, rng)
        radiance = frame.radiance
        shown = replace(
            radiance,
            mean=_over(radiance.mean, covered, shows),
            variance=(radiance.variance * (1.0 - covered[..., None]) ** 2).astype(np.float32),
            denoised=None if radiance.denoised is None else _over(radiance.denoised, covered, shows),
        )
        frame = replace(frame, radiance=shown)
    return frame


def _over(image: NDArray[np.float32], covered: Floats, shows: NDArray[np.bool_]) -> NDArray[np.float32]:
    drop = _CLEAR * image[shows].mean(axis=0, dtype=np.float64)
    return np.asarray(image + covered[..., None] * (drop - image), dtype=np.float32)


def coverage(one: Falling, camera: Camera, distance_m: NDArray[np.float32], rng: np.random.Generator) -> Floats:
    """(H, W) share of the exposure in which pixels see a falling thing."""
    rays, is_parallel = world_rays(camera), projection_of(camera).is_parallel
    across_m = rays.origin_m if is_parallel else rays.direction  # of a view at 1 m
    height, width = across_m.shape[:2]
    right, down = np.gradient(across_m, axis=1), np.gradient(across_m, axis=0)
    area_m2 = np.linalg.norm(np.cross(right, down), axis=-1) * rays.valid  # of pixels, at 1 m
    power = 1 if is_parallel else 3
    near, far = _NEAREST_M**power, _FARTHEST_M**power
    count = rng.poisson(one.number_per_m3 * float(area_m2.sum()) * (far - near) / power)
    pixel = rng.choice(area_m2.size, size=count, p=area_m2.ravel() / area_m2.sum())
    distance = (near + (far - near) * rng.random(count)) ** (1.0 / power)
    grows = np.ones(count) if is_parallel else distance  # a pixel's side, over that at 1 m
    diameter_mm = one.least_mm + rng.exponential(one.mean_excess_mm, count)
    way = np.column_stack([np.tile(one.drift_m_per_s, (count, 1)), -one.fall(diameter_mm)])
    shutter_s = one.shutter_s
    if camera.exposure is not None and camera.exposure.shutter_s is not None:
        shutter_s = camera.exposure.shutter_s
    motion = _pixels(way * (shutter_s / grows)[:, None], right.reshape(-1, 3)[pixel], down.reshape(-1, 3)[pixel])
    length = np.linalg.norm(motion, axis=1)
    most = _MOST_LENGTH * np.hypot(width, height)
    wide = diameter_mm / 1000.0 / (grows * np.sqrt(np.maximum(area_m2.ravel()[pixel], 1e-12)))
    across = np.maximum(wide, 1.0)
    share = 0.25 * np.pi * wide**2 / ((length + across) * across)
    shown = np.minimum(length, most)
    centre = np.column_stack([pixel % width, pixel // width]) + rng.random((count, 2))
    covered, open_px = np.zeros(width * height), np.asarray(distance_m, dtype=np.float64).ravel()
    steps = np.ceil(2.0 * (shown + 1.0)).astype(np.int64) * np.ceil(across).astype(np.int64)
    for some in np.array_split(np.arange(count), max(1, -(-int(steps.sum()) // _MOST_POINTS))):
        if not len(some):
            continue
        row = np.repeat(some, steps[some])
        along, aside = rng.random(len(row)) - 0.5, rng.random(len(row)) - 0.5
        unit = motion[row] / np.maximum(length[row], 1e-9)[:, None]
        place = centre[row] + unit * ((shown + 1.0)[row] * along)[:, None]
        place += unit[:, ::-1] * [1.0, -1.0] * ((across - 1.0)[row] * aside)[:, None]
        x, y = np.floor(place).astype(np.int64).T
        good = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        at = np.where(good, y * width + x, 0)
        good &= distance[row] < open_px[at]
        area = ((shown + 1.0) * across / steps)[row]  # pixels that a point stands for
        covered += np.bincount(at[good], weights=(share[row] * area)[good], minlength=width * height)
    return np.minimum(covered, 1.0).reshape(height, width) * rays.valid


def _pixels(change: Floats, right: Floats, down: Floats) -> Floats:
    """(N, 2) by how many pixels directions or places (N, 3) change; `right`, `down` are their changes by a pixel."""
    a, b, c = (np.einsum("nk,nk->n", *pair) for pair in ((right, right), (right, down), (down, down)))
    u, v = (np.einsum("nk,nk->n", change, one) for one in (right, down))
    scale = np.maximum(a * c - b * b, 1e-30)
    return np.column_stack([(c * u - b * v) / scale, (a * v - b * u) / scale])
