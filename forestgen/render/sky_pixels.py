"""The cloudy sky in the pixels of a camera: rays of any camera, each followed by one path through the clouds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from forestgen.core.randomness import child_rng, child_seed
from forestgen.render.cloud_paths import gather
from forestgen.render.sky import TracedClouds
from forestgen.render.sky_radiance import sky_map, sun_irradiance
from forestgen.scene.channels import Channels
from forestgen.scene.projection import rays
from forestgen.scene.spec import Camera

_CALL_RAYS = 1 << 18
# Of two R2 sequences (Roberts 2018), powers of 0.7549 and of 0.8192: they fill a pixel, and the lens, evenly.
_STEPS = np.array([[0.7548776662466927], [0.5698402909980532], [0.8191725133961645], [0.6710436067037893]])
_LEVEL = 1e-6  # sine of the lowest elevation
Floats = NDArray[np.float64]


class SkyPixels:
    """The sky behind a scene.

    Rays that point below the horizon see the sky as high above it as they point below: there the terrain is, and what
    it leaves open of a pixel on the horizon is sky. The plain that lights the clouds from below is never seen.
    """

    def __init__(self, clouds: TracedClouds, camera: Camera) -> None:
        self._clouds, self._camera = clouds, camera

    def take(self, wanted: NDArray[np.bool_], channels: Channels, samples: int, seed: int) -> Floats:
        """(H, W, 3) mean radiance of the sky over what each pixel sees; 0 in pixels that are not wanted."""
        sky = self._clouds.sky
        light, sun = self._clouds.under(sky_map(sky, channels)), sun_irradiance(sky, channels)
        albedo = self._clouds.albedo(channels)
        image = np.zeros((*wanted.shape, 3))
        rows, columns = np.nonzero(wanted)
        for first in range(0, len(rows), _CALL_RAYS):
            part = slice(first, first + _CALL_RAYS)
            row, column = rows[part], columns[part]
            rng = child_rng(seed, "rays", first)
            shift = rng.random((4, len(row)))
            total, count = np.zeros((len(row), 3)), np.zeros((len(row), 1))
            for number in range(samples):
                places = (shift + number * _STEPS) % 1.0
                origin, direction, seen = camera_rays(self._camera, row, column, places)
                direction[:, 2] = np.maximum(np.abs(direction[:, 2]), _LEVEL)
                own = child_seed(seed, "paths", first, number)
                found = gather(self._clouds.field, light, origin, direction, seed=own)
                total += found.radiance(albedo, sun) * seen[:, None]
                count += seen[:, None]
            image[row, column] = total / np.maximum(count, 1.0)
            missed = count[:, 0] == 0  # on the edge of a fisheye's circle, which holds the pixel's centre
            if missed.any():
                centre = np.full((4, int(missed.sum())), 0.5)
                origin, direction, _ = camera_rays(self._camera, row[missed], column[missed], centre)
                direction[:, 2] = np.maximum(np.abs(direction[:, 2]), _LEVEL)
                own = child_seed(seed, "centres", first)
                found = gather(self._clouds.field, light, origin, direction, seed=own)
                image[row[missed], column[missed]] = found.radiance(albedo, sun)
        return image


def camera_rays(
    camera: Camera, row: NDArray[np.intp], column: NDArray[np.intp], places: Floats
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """(N, 3) origins and directions, world, of one ray through each pixel; (N,) whether it sees anything.

    Parameters
    ----------
    places : (4, N) in [0, 1): where a ray goes through its pixel, right and down, and two numbers for the lens.
    """
    own = rays(camera, column + places[0], row + places[1])
    origin, direction = own.origin_m, own.direction
    if camera.lens is not None:
        radius, turn = camera.lens.aperture_radius_m * np.sqrt(places[2]), 2 * np.pi * places[3]
        origin = np.stack([radius * np.cos(turn), radius * np.sin(turn), np.zeros_like(turn)], axis=-1)
        direction = direction * (camera.lens.focus_m / direction[:, 2:]) - origin
        direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    axes = np.asarray(camera.world_from_camera, dtype=np.float64)
    return origin @ axes.T + np.asarray(camera.position_m), direction @ axes.T, own.valid
