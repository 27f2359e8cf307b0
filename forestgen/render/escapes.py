"""Where paths that come from a camera leave a scene, in what direction and with what throughput, ray by ray.

The renderer tells nothing about single paths. But a scene closed in a box that shines tells it: the image of a box that
shines with radiance 1, one path a pixel, is the paths' throughput; the image of the same box, shining with its own
coordinates, by the same paths, is the throughput times where they leave; and a second, larger box tells where they go.
No other light is in the scene, so no path knows which of the three it is part of: same seed, same path.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.render.build import load
from forestgen.render.capture import capture
from forestgen.render.painted import path_tracer
from forestgen.render.sensors import FilmWindow
from forestgen.render.variant import mitsuba
from forestgen.scene.spec import Camera

Floats = NDArray[np.float64]
_CODE = "vertex_code"
_MARGIN_M = 2000.0  # of the outer box around the inner one


@dataclass(frozen=True)
class Escapes:
    """Paths that left the scene, in the renderer's frame."""

    pixel: NDArray[np.int64]  # (N,) number of the film's pixel, row by row
    throughput: Floats  # (N, 3)
    place_m: Floats  # (N, 3) on the inner box
    direction: Floats  # (N, 3) unit


class EscapeScene:
    """A scene's surfaces, closed in boxes.

    Parameters
    ----------
    scene : its surfaces, without light, as `build.scene_dict` gives them.
    top_m : of the inner box: above all surfaces and the camera, the renderer's frame.
    half_m, bottom_m : the box' sides and floor.
    """

    def __init__(
        self, scene: Mapping[str, Any], integrator: Any, *, top_m: float, half_m: float, bottom_m: float
    ) -> None:
        self._integrator = integrator
        self._at_once = path_tracer("path", 1)
        self._top_m, self._half_m = top_m, half_m
        boxes = [_box(top_m, half_m, bottom_m), _box(top_m + _MARGIN_M, 2 * half_m, bottom_m - _MARGIN_M)]
        self._inner, self._outer = boxes
        lamp = _lamp(top_m + 2 * _MARGIN_M)
        self._scenes = [load({**scene, "lamp": lamp, "box": box}) for box in boxes]

    def seen(self, camera: Camera, seed: int, window: FilmWindow | None = None) -> Escapes:
        """The rays through each pixel of a camera that meet no surface; of one that is not assembled."""
        image = self._image(self._at_once, 0, None, camera, seed, window)
        return self._found(self._at_once, np.flatnonzero(image.any(axis=1)), image, camera, seed, window)

    def scattered(self, camera: Camera, seed: int, window: FilmWindow | None = None) -> Escapes:
        """One path through each pixel, of those that leave the scene after they met a surface."""
        image = self._image(self._integrator, 0, None, camera, seed, window)
        at_once = self._image(self._at_once, 0, None, camera, seed, window)
        pixel = np.flatnonzero(image.any(axis=1) & ~at_once.any(axis=1))
        return self._found(self._integrator, pixel, image, camera, seed, window)

    def _image(
        self, tracer: Any, which: int, order: tuple[int, ...] | None, camera: Camera, seed: int, window: Any
    ) -> Floats:
        """(pixels, 3) of the inner or outer box, which shines with its coordinates in an order or with 1."""
        _show((self._inner, self._outer)[which], order)
        image = capture(tracer, self._scenes[which], camera, samples=1, seed=seed, window=window)
        return image[..., :3].reshape(-1, 3)

    def _found(
        self, tracer: Any, pixel: NDArray[np.int64], image: Floats, camera: Camera, seed: int, window: Any
    ) -> Escapes:
        throughput, places = image[pixel], []
        for which, (top_m, half_m) in enumerate(
            ((self._top_m, self._half_m), (self._top_m + _MARGIN_M, 2 * self._half_m))
        ):
            place = np.full((len(pixel), 3), np.nan)
            # A coordinate is read from a channel in which the path has any throughput; blue may well have none.
            for order in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
                code = self._image(tracer, which, order, camera, seed, window)[pixel]
                for channel, coordinate in enumerate(order):
                    usable = np.isnan(place[:, coordinate]) & (throughput[:, channel] > 0)
                    place[usable, coordinate] = code[usable, channel] / throughput[usable, channel]
                through_top = np.isnan(place[:, 2]) & (np.abs(place[:, :2]).max(axis=1, initial=0) < 0.97 * half_m)
                place[through_top, 2] = top_m
                if not np.isnan(place).any():
                    break
            places.append(place)
        direction = places[1] - places[0]
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        return Escapes(pixel, throughput, places[0], direction)


def _box(top_m: float, half_m: float, bottom_m: float) -> Any:
    """A black box that shines inwards."""
    mi = mitsuba()
    middle, reach = (top_m + bottom_m) / 2, (top_m - bottom_m) / 2
    box = mi.load_dict(
        {
            "type": "cube",
            "flip_normals": True,
            "to_world": mi.ScalarTransform4f().translate([0.0, 0.0, middle]).scale([half_m, half_m, reach]),
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}},
            "emitter": {
                "type": "area",
                "radiance": {"type": "mesh_attribute", "name": _CODE},
                "sampling_weight": 0.0,
            },
        }
    )
    vertices = np.array(mi.traverse(box)["vertex_positions"])
    box.add_attribute(_CODE, 3, np.ones_like(vertices))
    return box


def _lamp(height_m: float) -> dict[str, Any]:
    """What takes all light samples, so that paths find the box by scattering alone, at full weight.

    It is above everything and shines upwards: from below it has no light to give, which costs no shadow ray.
    """
    return {
        "type": "rectangle",
        "to_world": mitsuba().ScalarTransform4f().translate([0.0, 0.0, height_m]),
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 1.0}},
    }


def _show(box: Any, order: tuple[int, ...] | None) -> None:
    """Let a box shine with its coordinates in an order, or with 1."""
    parameters = mitsuba().traverse(box)
    vertices = np.array(parameters["vertex_positions"]).reshape(-1, 3)
    code = np.ones_like(vertices) if order is None else vertices[:, list(order)]
    parameters[_CODE] = np.ascontiguousarray(code, dtype=np.float32).ravel()
    parameters.update()
