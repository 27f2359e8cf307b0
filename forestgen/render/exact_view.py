"""A scene and the volume of its clouds, traced together: no approximation. There are two ways, of the same mean.

Whole: all in one scene, clouds as bricks (render/cloud_bricks.py), by the renderer's volume path tracer. For fog, for
cameras in or above the clouds, and for assembled cameras. A path ends where it leaves the world or by chance, never by
a number of scatterings: an optical depth of 100 takes hundreds of them.

Parted: where all plants, the ground and the camera lie below the lowest cloud. A path is cut where it passes from the
scene to the clouds or back:

1. Light that comes from the sun straight to a surface, however thinned by clouds, and on from surface to surface to the
   camera: by the volume path tracer, with clouds that only absorb.
2. All other light enters a path, seen from the camera, where it leaves the scene. Paths among surfaces are the
   renderer's (`EscapeScene` finds where they leave); random walks through the clouds from there on are our own
   (render/volume_random_walk.py), and find the sun, scattered, and the sky.
3. Of the walks that leave the clouds downwards and meet the scene again, one in `_DOWN_EVERY` is followed in the whole
   way, at that many times its weight. So light that goes to and fro between forest and clouds is counted once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.errors import RenderError
from forestgen.core.randomness import child_rng, child_seed
from forestgen.render import cloud_bricks
from forestgen.render.build import load, origin_of, ray_corners_m, scene_dict
from forestgen.render.capture import FilmWindow, capture, is_assembled
from forestgen.render.cloud_shadow import height_of
from forestgen.render.frame import RenderJob, Timer
from forestgen.render.light import along, emitters_of, has_sun, sky_map, sun_disc, sun_radiance
from forestgen.render.surfaces import SpectralBsdfs
from forestgen.render.variant import CLOUD_ROULETTE_DEPTH, SCALAR, mi, path_tracer, using
from forestgen.render.volume_random_walk import WalkField, disc_parameters
from forestgen.scene.colour import RGB, Channels
from forestgen.scene.spec import SceneSpec

Floats = NDArray[np.float64]
_CODE = "vertex_code"
_MARGIN_M = 2000.0  # of the outer box around the inner one
_TRIES = 8  # of a path, or a pixel, that ends in no number
_FEW_BROKEN, _BROKEN_SHARE = 8, 1e-5  # more than both together are refused
_DOWN_EVERY = 16
# Rays that see the sky cost nearly nothing and make the outline of every leaf: more of them, and walks for each; fewer
# paths among plants, which cost most, with many walks each.
_SEEN_TIMES, _SEEN_WALKS = 4, 2
_SCATTERED_WALKS = 6
_MOST_PATHS = 2_000_000  # followed at a time, for the sake of memory
_CLEARANCE_M = 0.5  # between the scene and the clouds, at least, for the parted way


@dataclass(frozen=True)
class Escapes:
    """Paths that left the scene, in the renderer's frame."""

    pixel: NDArray[np.int64]  # (N,) number of the film's pixel, row by row
    throughput: Floats  # (N, 3)
    place_m: Floats  # (N, 3) on the inner box
    direction: Floats  # (N, 3) unit


class EscapeScene:
    """A scene's surfaces, without light, closed in boxes: where paths from a camera leave it.

    The renderer tells nothing about single paths. But a scene closed in a box that shines tells it: the image of a box
    that shines with radiance 1, one path a pixel, is the paths' throughput; the image of the same box, shining with its
    own coordinates, by the same paths, is the throughput times where they leave; and a second, larger box tells where
    they go. No other light is in the scene, so no path knows which of the three it is part of: same seed, same path.

    The inner box has half-widths `half_m` and a floor; its top lies above all surfaces and the camera, in the
    renderer's frame.
    """

    def __init__(
        self, scene: Mapping[str, Any], integrator: Any, *, top_m: float, half_m: float, bottom_m: float
    ) -> None:
        self._scattering, self._straight = integrator, path_tracer("path", 1)
        self._sizes = ((top_m, half_m), (top_m + _MARGIN_M, 2 * half_m))
        bottoms = (bottom_m, bottom_m - _MARGIN_M)
        self._boxes = [_box(*size, bottom) for size, bottom in zip(self._sizes, bottoms, strict=True)]
        # It takes all light samples, so that paths find the box by scattering alone, at full weight. It is above
        # everything and shines upwards: from below it has no light to give, which costs no shadow ray.
        lamp = {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().translate([0.0, 0.0, top_m + 2 * _MARGIN_M]),
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 1.0}},
        }
        self._scenes = [load({**scene, "lamp": lamp, "box": box}) for box in self._boxes]

    def seen(self, *film: Any) -> Escapes:
        """The rays that meet no surface, through each pixel of a film: a camera, a seed and a window of its image."""
        image = self._image(self._straight, 0, None, film)
        return self._found(self._straight, np.flatnonzero(image.any(axis=1)), image, film)

    def scattered(self, *film: Any) -> Escapes:
        """One path through each pixel of a film, of those that leave the scene after they met a surface."""
        image, straight = (self._image(tracer, 0, None, film) for tracer in (self._scattering, self._straight))
        return self._found(self._scattering, np.flatnonzero(image.any(axis=1) & ~straight.any(axis=1)), image, film)

    def _image(self, tracer: Any, which: int, order: tuple[int, ...] | None, film: tuple[Any, ...]) -> Floats:
        """(pixels, 3) of the inner or outer box, which shines with its coordinates in an order or with 1."""
        parameters = mi.traverse(self._boxes[which])
        vertices = np.array(parameters["vertex_positions"]).reshape(-1, 3)
        code = np.ones_like(vertices) if order is None else vertices[:, list(order)]
        parameters[_CODE] = np.ascontiguousarray(code, dtype=np.float32).ravel()
        parameters.update()
        camera, seed, window = film
        image = capture(tracer, self._scenes[which], camera, samples=1, seed=seed, window=window)
        return image[..., :3].reshape(-1, 3)

    def _found(self, tracer: Any, pixel: NDArray[np.int64], image: Floats, film: tuple[Any, ...]) -> Escapes:
        throughput, places = image[pixel], []
        for which, (top_m, half_m) in enumerate(self._sizes):
            place = np.full((len(pixel), 3), np.nan)
            # A coordinate is read from a channel in which the path has any throughput; blue may well have none.
            for order in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
                code = self._image(tracer, which, order, film)[pixel]
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
    middle, reach = (top_m + bottom_m) / 2, (top_m - bottom_m) / 2
    code = {"type": "mesh_attribute", "name": _CODE}
    box = mi.load_dict(
        {
            "type": "cube",
            "flip_normals": True,
            "to_world": mi.ScalarTransform4f().translate([0.0, 0.0, middle]).scale([half_m, half_m, reach]),
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}},
            "emitter": {"type": "area", "radiance": code, "sampling_weight": 0.0},
        }
    )
    box.add_attribute(_CODE, 3, np.ones_like(np.array(mi.traverse(box)["vertex_positions"])))
    return box


class ExactView:
    """A scene with its clouds, ready to be captured."""

    def __init__(self, job: RenderJob, timer: Timer) -> None:
        self.job, self.timer = job, timer
        spec, camera = job.spec, job.camera
        assert spec.clouds is not None
        self.origin = origin = origin_of(camera)
        self.bsdfs = bsdfs = SpectralBsdfs()
        with timer("radiance: build"):
            surfaces = scene_dict(spec, origin, bsdfs)
            bricks = cloud_bricks.divide(spec.clouds, origin)
            shapes, media = cloud_bricks.brick_shapes(spec.clouds, bricks, origin)
            shell = cloud_bricks.camera_shell(spec.clouds, bricks, media, camera)
            emitters = {name: bsdfs.add(emitter) for name, emitter in emitters_of(spec.sky).items()}
            self._whole = load({**surfaces, **shapes, **shell, **emitters})
            self._tracer = endless_tracer()
            gap = None if is_assembled(camera) else clear_air_m(spec, float(ray_corners_m(camera)[:, 2].max()))
            self._parts = None if gap is None else _Parts(self, surfaces, bricks, gap)

    def take(self, channels: Channels, samples: int, number: tuple[int, int]) -> Floats:
        with using(SCALAR):
            with self.timer("radiance: repaint"):
                self.bsdfs.repaint(channels)
            if self._parts is None:
                with self.timer("light paths"):
                    return _captured(self._tracer, self._whole, self.job, samples, ("whole", *number))
            # In the scenes that were looked at the sun's own light was much less noisy than that of clouds and sky.
            image = self._parts.by_sun((samples + 1) // 2, number)
            return image + self._parts.by_clouds(channels, samples, number, self.followed)

    def followed(self, place_m: Floats, direction: Floats, seed: int) -> Floats:
        """(N, 3) radiance that comes from the scene with its clouds to (N, 3) places, one path each."""
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed)
        result = np.empty((len(place_m), 3))

        def follow(row: int) -> None:
            ray = mi.RayDifferential3f(mi.Ray3f(place_m[row].tolist(), direction[row].tolist()))
            result[row] = self._tracer.sample(self._whole, sampler, ray)[0]

        for row in range(len(place_m)):
            follow(row)
        return _mended(result, len(place_m), lambda attempt, row: follow(row))


def endless_tracer() -> Any:
    """The volume path tracer of the whole way."""
    return path_tracer("volpath", -1, rr_depth=CLOUD_ROULETTE_DEPTH)


def clear_air_m(spec: SceneSpec, camera_m: float) -> tuple[float, float] | None:
    """World heights of the top of surfaces and the rays' starts (`camera_m`), and of the lowest cloud; or None."""
    assert spec.clouds is not None
    clouds = spec.clouds
    cloudy = np.flatnonzero(clouds.extinction_per_m.any(axis=(1, 2)))
    if not len(cloudy):
        return None
    # Between the centres of an empty layer and the next the field rises from 0.
    lowest = clouds.low_m[2] + max(0.0, float(cloudy[0]) - 0.5) * clouds.cell_m[2]
    top = max(camera_m, float(spec.terrain.mesh.vertices_m[:, 2].max()), _highest_plant_m(spec))
    return (top, lowest) if lowest - top > 2 * _CLEARANCE_M else None


def _highest_plant_m(spec: SceneSpec) -> float:
    highest = -np.inf
    for index in np.unique(spec.instances.exemplar):
        box = spec.exemplars[index].bounds_m()
        corners = np.array([[box[i, 0], box[j, 1], box[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
        up = spec.instances.transform[spec.instances.exemplar == index, 2]
        highest = max(highest, float((up[:, :3] @ corners.T + up[:, 3:]).max()))
    return highest


class _Parts:
    """The parted way."""

    def __init__(
        self, view: ExactView, surfaces: dict[str, Any], bricks: cloud_bricks.Bricks, gap_m: tuple[float, float]
    ) -> None:
        self._job, self._timer, origin = view.job, view.timer, view.origin
        job, spec = view.job, view.job.spec
        assert spec.clouds is not None
        self._field = WalkField.of(spec.clouds, origin)
        self._aloft_m = max(height_of(spec.clouds) - float(spec.terrain.mesh.vertices_m[:, 2].min()), 0.0)
        self._disc, self._by_sun = None, None
        if has_sun(spec.sky):
            matrix = np.array(sun_disc(spec.sky, RGB)["to_world"].matrix, dtype=np.float64)  # as the renderer has it
            self._disc = disc_parameters(matrix[:3, 3], float(np.linalg.norm(matrix[:3, 0])))
            shapes, _ = cloud_bricks.brick_shapes(spec.clouds, bricks, origin, albedo=0.0)
            sun = view.bsdfs.add(lambda channels: sun_disc(spec.sky, channels))
            self._by_sun = load({**surfaces, **shapes, "sun": sun})
            self._thinned = path_tracer("volpath", job.max_depth)
        top, lowest = gap_m
        ground = spec.terrain.mesh.vertices_m - origin
        self._escapes = EscapeScene(
            surfaces,
            path_tracer("path", job.max_depth),
            top_m=min((top + lowest) / 2, top + 20.0) - origin[2],
            half_m=max(1000.0, 1.02 * float(np.abs(ground[:, :2]).max())),
            bottom_m=float(ground[:, 2].min()) - 100.0,
        )

    def by_sun(self, samples: int, number: tuple[int, int]) -> Floats:
        """(H, W, 3) light that no cloud has scattered since it left the sun, on its way to its first surface."""
        camera = self._job.camera
        if self._by_sun is None:
            return np.zeros((camera.size_px[1], camera.size_px[0], 3))
        with self._timer("light paths"):
            return _captured(self._thinned, self._by_sun, self._job, samples, ("sun", *number))

    def by_clouds(self, channels: Channels, samples: int, number: tuple[int, int], followed: Any) -> Floats:
        """(H, W, 3) all other light."""
        camera = self._job.camera
        width, height = camera.size_px
        spec = self._job.spec
        sky, sun = sky_map(spec.sky, channels), sun_radiance(spec.sky, channels, self._aloft_m)
        kinds = (
            ("seen", self._escapes.seen, _SEEN_TIMES * samples, _SEEN_WALKS),
            ("scattered", self._escapes.scattered, samples, _SCATTERED_WALKS),
        )
        total = np.zeros((height * width, 3))
        for kind, trace, count, each in kinds:
            for index, (fine, window) in enumerate(_films(width, height, count)):
                name = (kind, *number, index)
                finer = replace(camera, size_px=(width * fine, height * fine))
                with self._timer("light paths"):
                    paths = trace(finer, child_seed(self._job.seed, *name), window)
                light = np.zeros((len(paths.pixel), 3))
                for walk in range(each):
                    light += self._walked(paths, sky, sun, (*name, walk), followed) / each
                row = window.offset_y + paths.pixel // window.width
                column = window.offset_x + paths.pixel % window.width
                pixel = row // fine * width + column // fine
                for channel in range(3):
                    weight = paths.throughput[:, channel] * light[:, channel] / count
                    total[:, channel] += np.bincount(pixel, weight, len(total))
        return total.reshape(height, width, 3)

    def _walked(self, paths: Escapes, sky: Any, sun: Floats, name: tuple[str | int, ...], followed: Any) -> Floats:
        """(N, 3) radiance that one walk each finds for paths that left the scene."""
        with self._timer("clouds"):
            seed = child_seed(self._job.seed, "walks", *name)
            walks = self._field.walk(paths.place_m, paths.direction, self._disc, seed)
            light = walks.sun[:, None] * sun
            down = (walks.direction[:, 2] <= 0) & (walks.leaves_m[:, 2] > paths.place_m[:, 2])
            light += np.where(down, 0.0, walks.weight)[:, None] * along(sky, walks.direction)
        chosen = np.flatnonzero(down & (walks.weight > 0))
        rng = child_rng(self._job.seed, "down", *name)
        chosen = chosen[rng.random(len(chosen)) < 1.0 / _DOWN_EVERY]
        with self._timer("light paths"):
            seed = child_seed(self._job.seed, "followed", *name)
            met = followed(walks.leaves_m[chosen], walks.direction[chosen], seed)
        light[chosen] += _DOWN_EVERY * walks.weight[chosen, None] * met
        return light


def _captured(tracer: Any, scene: Any, job: RenderJob, samples: int, name: tuple[str | int, ...]) -> Floats:
    """(H, W, 3) image of the volume path tracer."""
    image = capture(tracer, scene, job.camera, samples=samples, seed=child_seed(job.seed, *name))[..., :3]

    def again(attempt: int, row: int, column: int) -> None:
        seed, window = child_seed(job.seed, *name, "again", attempt, row, column), FilmWindow(column, row, 1, 1)
        image[row, column] = capture(tracer, scene, job.camera, samples=samples, seed=seed, window=window)[0, 0, :3]

    return _mended(image, samples * image[..., 0].size, again)


def _mended(result: Floats, paths: int, again: Callable[..., None]) -> Floats:
    """The result, its places without a number made `again`, by the attempt and where they are.

    Now and then a path of the renderer's through bricks ends in no number (one in half a million was seen; why is not
    known). `RenderError`: there are many such paths, so that something else is wrong.
    """
    count = 0
    for attempt in range(_TRIES):
        broken = np.argwhere(~np.isfinite(result).all(axis=-1)).tolist()
        count += len(broken)
        if not broken:
            return result
        if count > _FEW_BROKEN + _BROKEN_SHARE * paths:
            break
        for place in broken:
            again(attempt, *place)
    raise RenderError(
        f"{count} of {paths} paths of light through the clouds end in no number",
        hint="the image would be wrong; move the camera by a few metres, or choose coarser clouds",
    )


def _films(width: int, height: int, samples: int) -> list[tuple[int, FilmWindow]]:
    """Films of one path a pixel that together give an image its samples: times as fine, and which part of it.

    A pixel of the image is so cut into squares with a path through each, as evenly as a stratified sampler would.
    """
    films = []
    while samples > 0:
        fine = int(np.sqrt(samples))
        while fine > 1 and fine * fine * width > _MOST_PATHS:
            fine -= 1
        samples -= fine * fine
        rows = max(1, _MOST_PATHS // (fine * fine * width)) * fine
        films += [
            (fine, FilmWindow(0, first, width * fine, min(rows, height * fine - first)))
            for first in range(0, height * fine, rows)
        ]
    return films
