"""Cameras of the renderer, and images taken with them.

Some projections are the renderer's own, as `Projection.sensor` says. Images of the others are put together from views
that it has by render/assembled.py.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.render.settings import SAMPLER
from forestgen.render.variant import mitsuba
from forestgen.scene.projection import projection_of
from forestgen.scene.spec import Camera

_NEAR_M, _FAR_M = 1e-3, 1e7  # the identity pass starts at the camera itself; the sun's disc stands at 1e6 m


@dataclass(frozen=True)
class FilmWindow:
    """Rows and columns of the image that a pass renders."""

    x: int
    y: int
    width: int
    height: int


def is_assembled(camera: Camera) -> bool:
    """Whether images of this camera are put together from others; they need `LEAST_SAMPLES` in each capture."""
    return projection_of(camera).sensor(camera) is None


def sensor_of(camera: Camera, samples: int, window: FilmWindow | None = None) -> Any:
    """A Mitsuba sensor at the origin, of a camera that is not assembled."""
    mi = mitsuba()
    sensor = projection_of(camera).sensor(camera)
    assert sensor is not None
    matrix = _axes(camera.world_from_camera)
    matrix[:3, :2] *= sensor.scale
    return mi.load_dict(
        {
            **sensor.plugin,
            "near_clip": _NEAR_M,
            "far_clip": _FAR_M,
            "to_world": mi.ScalarTransform4f(matrix),
            "film": _film(camera.size_px, window),
            "sampler": {"type": SAMPLER, "sample_count": samples},
        }
    )


def square_view(world_from_view: NDArray[np.float64], size_px: int, window: FilmWindow) -> Any:
    """A pinhole of 90 degrees across a square, with one random ray through each pixel of the window."""
    mi = mitsuba()
    return mi.load_dict(
        {
            "type": "perspective",
            "fov": 90.0,
            "fov_axis": "x",
            "near_clip": _NEAR_M,
            "far_clip": _FAR_M,
            "to_world": mi.ScalarTransform4f(_axes(world_from_view)),
            "film": _film((size_px, size_px), window),
            "sampler": {"type": "independent", "sample_count": 1},
        }
    )


def _axes(world_from_camera: NDArray[np.float64]) -> NDArray[np.float64]:
    """(4, 4) of the renderer's axes: its x points left and its y up; this function alone knows."""
    matrix = np.eye(4)
    matrix[:3, :3] = world_from_camera * [-1.0, -1.0, 1.0]
    return matrix


def _film(size_px: tuple[int, int], window: FilmWindow | None) -> dict[str, Any]:
    film: dict[str, Any] = {
        "type": "hdrfilm",
        "width": size_px[0],
        "height": size_px[1],
        "rfilter": {"type": "box"},
        "pixel_format": "rgba",
        "component_format": "float32",
    }
    if window is not None:
        film |= {
            "crop_offset_x": window.x,
            "crop_offset_y": window.y,
            "crop_width": window.width,
            "crop_height": window.height,
        }
    return film
