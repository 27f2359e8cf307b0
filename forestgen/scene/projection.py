"""Rays and pixels of cameras, each kind; camera's axes: x right, y down, z forward.

- perspective: x / z = (u - W/2) / f, with f = W/2 / tan(hfov / 2)
- orthographic: x = (u - W/2) width_m / W; rays are parallel to z and begin in the plane of the camera, so what has
  z > 0 is seen and nothing else
- fisheye: equidistant, theta = r / f from the axis at r pixels from the middle, with f = W / hfov in pixels a radian;
  no ray beyond the circle of radius W/2, which is that of hfov / 2
- panorama: equirectangular over the whole sphere; u is longitude to the right, v latitude downwards

Depth is the distance along z for perspective and orthographic cameras, and along the ray for the others. The two
directions that a map tears apart have one place each: straight behind a fisheye of 360 degrees is to the right, and a
panorama's poles are above and below its middle.

A thin lens bends no ray through its middle: those are the perspective camera's. Identity samples go through fixed
points of the lens, `lens_points`, and meet in the plane of focus at z = focus_m.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from forestgen.scene.spec import Camera

Floats = NDArray[np.float64]

# Steps of the R2 sequence (Roberts 2018) in units of 2^-32: powers of the inverse of the real root of x^3 = x + 1.
LENS_STEPS = (3242174889, 2447445414)
HASH_ROUNDS = 8  # after 4, numbers of neighbouring pixels are not yet uniform


@dataclass(frozen=True)
class Rays:
    """Rays of pixels in the camera's axes, of any shape S."""

    origin_m: Floats  # (*S, 3)
    direction: Floats  # (*S, 3) unit
    valid: NDArray[np.bool_]  # (*S,) False outside of a fisheye's circle


@dataclass(frozen=True)
class WorldRays:
    """Rays through the centres of all pixels, world."""

    origin_m: Floats  # (3,), or (H, W, 3) of an orthographic camera
    direction: Floats  # (H, W, 3) unit
    valid: NDArray[np.bool_]  # (H, W) False outside of a fisheye's circle


@dataclass(frozen=True)
class Pixels:
    """Where points of the camera's axes appear, of any shape S."""

    x_px: Floats  # (*S,)
    y_px: Floats  # (*S,)
    depth_m: Floats  # (*S,)
    in_front: NDArray[np.bool_]  # (*S,) False where the camera cannot see: behind it, or outside of a fisheye's circle


def rays(camera: Camera, x_px: Floats, y_px: Floats) -> Rays:
    """Rays through image points; a lens' are those through its middle."""
    width, height = camera.size_px
    x, y = np.broadcast_arrays(np.asarray(x_px, np.float64) - width / 2, np.asarray(y_px, np.float64) - height / 2)
    origin, valid = np.zeros((*x.shape, 3)), np.ones(x.shape, dtype=bool)
    if camera.projection == "perspective":
        direction = np.stack([x / camera.focal_px, y / camera.focal_px, np.ones_like(x)], axis=-1)
        direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    elif camera.projection == "orthographic":
        origin[..., 0], origin[..., 1] = x * camera.width_m / width, y * camera.width_m / width
        direction = np.zeros_like(origin)
        direction[..., 2] = 1.0
    elif camera.projection == "fisheye":
        valid = in_circle(camera, x, y)
        radius = np.hypot(x, y)
        theta = radius / fisheye_focal_px(camera)
        sine = np.divide(np.sin(theta), radius, out=np.zeros_like(radius), where=radius > 0)
        direction = np.stack([x * sine, y * sine, np.cos(theta)], axis=-1)
    else:
        longitude, latitude = x / width * 2 * np.pi, y / height * np.pi
        direction = np.stack(
            [np.sin(longitude) * np.cos(latitude), np.sin(latitude), np.cos(longitude) * np.cos(latitude)], axis=-1
        )
    return Rays(origin, direction, valid)


def centre_rays(camera: Camera) -> Rays:
    """(H, W) rays through the pixels' centres, in the camera's axes."""
    width, height = camera.size_px
    return rays(camera, *np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5))


def world_rays(camera: Camera, rows: slice | None = None) -> WorldRays:
    """Rays through the pixels' centres, of some rows or of all, world."""
    width, height = camera.size_px
    own = rays(camera, *np.meshgrid(np.arange(width) + 0.5, np.arange(height)[rows or slice(None)] + 0.5))
    axes = np.asarray(camera.world_from_camera, dtype=np.float64)
    origin = np.asarray(camera.position_m, dtype=np.float64)
    if camera.projection == "orthographic":
        origin = own.origin_m @ axes.T + origin
    return WorldRays(origin, own.direction @ axes.T, own.valid)


def project(camera: Camera, points_m: Floats) -> Pixels:
    """Image points of (*S, 3) points in the camera's axes; of a point at the camera's own place, `in_front` is False.

    Where `in_front` is False the image point of a perspective or orthographic camera means nothing; a fisheye's is
    where its map goes on beyond the circle.
    """
    width, height = camera.size_px
    x, y, z = np.moveaxis(np.asarray(points_m, dtype=np.float64), -1, 0)
    if camera.projection == "perspective":
        seen = z > 0
        safe = np.where(seen, z, 1.0)
        u, v, depth = x / safe * camera.focal_px, y / safe * camera.focal_px, z
    elif camera.projection == "orthographic":
        scale = width / camera.width_m
        u, v, depth, seen = x * scale, y * scale, z, z > 0
    elif camera.projection == "fisheye":
        across = np.hypot(x, y)
        radius = np.arctan2(across, z) * fisheye_focal_px(camera)
        sideways = across > 0
        u = radius * np.divide(x, across, out=np.ones_like(across), where=sideways)
        v = radius * np.divide(y, across, out=np.zeros_like(across), where=sideways)
        depth = np.hypot(across, z)
        # Rounding may carry a point of the circle itself across.
        seen = (radius <= width / 2 * (1 + 1e-12)) & (depth > 0)
    else:
        level = np.hypot(x, z)
        depth = np.hypot(level, y)
        u = np.arctan2(x, z) / (2 * np.pi) * width
        v = np.arctan2(y, level) / np.pi * height  # not by the sine's inverse, which is blind near the poles
        seen = depth > 0
    return Pixels(u + width / 2, v + height / 2, depth, seen)


def depth_is_distance(camera: Camera) -> bool:
    """Whether depth runs along the ray; otherwise it runs along z."""
    return camera.projection in ("fisheye", "panorama")


def fisheye_focal_px(camera: Camera) -> float:
    """Pixels a radian."""
    return camera.size_px[0] / float(np.radians(camera.hfov_deg))


def in_circle(camera: Camera, x: Floats, y: Floats) -> NDArray[np.bool_]:
    """Whether points, pixels from the middle of a fisheye's image, lie in its circle. Exact for pixel centres."""
    return np.asarray(x * x + y * y <= (camera.size_px[0] / 2) ** 2)


def image_circle(camera: Camera) -> NDArray[np.bool_]:
    """(H, W) pixels whose centre sees something: all but those outside of a fisheye's circle."""
    width, height = camera.size_px
    if camera.projection != "fisheye":
        return np.ones((height, width), dtype=np.bool_)
    x, y = np.meshgrid(np.arange(width) + 0.5 - width / 2, np.arange(height) + 0.5 - height / 2)
    return in_circle(camera, x, y)


def lens_points(column: NDArray[np.integer], row: NDArray[np.integer], number: NDArray[np.integer]) -> Floats:
    """(*S, 2) points of the unit disc through which the samples of pixels go; uniform over it.

    A pixel's samples are points (a, b) of the R2 sequence on the torus, shifted by two random numbers of the pixel,
    in whole steps of 2^-32; then r = sqrt(a), phi = 2 pi b. Neighbouring pixels differ in their shift. The tracer has
    the same a and b, and the rest in single precision.

    Parameters
    ----------
    column, row, number : (*S,) pixel and number of the sample in it.
    """
    count = np.asarray(number, dtype=np.uint32)
    with np.errstate(over="ignore"):
        a, b = (
            ((shift + count * np.uint32(step)) >> np.uint32(8)) * 2.0**-24
            for shift, step in zip(pixel_hash(column, row), LENS_STEPS, strict=True)
        )
    radius, angle = np.sqrt(a), 2 * np.pi * b
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)


def pixel_hash(column: NDArray[np.integer], row: NDArray[np.integer]) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
    """Two random 32-bit numbers of a pixel: rounds of the cipher TEA.

    References
    ----------
    Zafar, Olano and Curtis 2010, "GPU random numbers via the tiny encryption algorithm", HPG.
    """
    keys = [np.uint32(key) for key in (0xA341316C, 0xC8013EA4, 0xAD90777D, 0x7E95761E)]
    first, second = (np.array(value, dtype=np.uint32) for value in np.broadcast_arrays(column, row))
    total = np.zeros((), dtype=np.uint32)
    with np.errstate(over="ignore"):
        for _ in range(HASH_ROUNDS):
            total = total + np.uint32(0x9E3779B9)
            first = first + (
                ((second << np.uint32(4)) + keys[0]) ^ (second + total) ^ ((second >> np.uint32(5)) + keys[1])
            )
            second = second + (
                ((first << np.uint32(4)) + keys[2]) ^ (first + total) ^ ((first >> np.uint32(5)) + keys[3])
            )
    return first, second
