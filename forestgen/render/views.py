"""A view of a scene that is built once and captured pass after pass, in other channels and with other seeds.

Under a clear sky one capture does all. Under clouds three estimators add up: light of the sky on the scene, light of
the sun on the scene, and the sky itself in the share of each pixel that the scene leaves open (see render/sky.py).
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from forestgen.core.progress import Progress
from forestgen.core.randomness import child_seed
from forestgen.render import sky
from forestgen.render.build import load, origin_of, scene_dict
from forestgen.render.light import emitters_of, has_sun, sky_light, sun_disc
from forestgen.render.noise import Until
from forestgen.render.sensors import FilmWindow, capture
from forestgen.render.settings import ROULETTE_DEPTH
from forestgen.render.surfaces import Paints, repaint
from forestgen.render.variant import BLOCK_PX, mitsuba
from forestgen.render.wavelengths import Mode
from forestgen.scene.channels import RGB, Channels
from forestgen.scene.projection import image_circle, rays
from forestgen.scene.spec import Camera, SceneSpec

Timer = Callable[[str], AbstractContextManager[Any]]


@dataclass(frozen=True)
class Shot:
    """What to render, and how well."""

    spec: SceneSpec
    camera: Camera
    until: Until
    seed: int  # of the frame
    mode: Mode = "rgb"  # a camera with bands is rendered at wavelengths whatever it says
    max_depth: int = 64  # longest path through the canopy; clouds have their own
    sky_share: NDArray[np.bool_] | None = None  # (H, W) pixels that may see the sky, the others skip clouds; None: all


class View(Protocol):
    """A scene, ready to be captured."""

    def take(self, channels: Channels, samples: int, number: tuple[int, int]) -> NDArray[np.float64]:
        """(H, W, 3) radiance in three channels, by independent paths for each `number` of replicate and pass."""


def build_view(shot: Shot, progress: Progress, timer: Timer) -> View:
    """Build the scene of a shot. Call it, and what it returns, in the scalar variant."""
    if shot.spec.clouds is None:
        return _ClearView(shot, timer)
    return _CloudyView(shot, progress, timer)


class PixelKinds(NamedTuple):
    """(H, W) pixels of a camera by what they can see."""

    seen: NDArray[np.bool_]  # the centre sees anything: it lies in a fisheye's circle
    whole: NDArray[np.bool_]  # all of the pixel does
    above: NDArray[np.bool_]  # all of it does, above a flat earth's horizon


def pixels_of(camera: Camera) -> PixelKinds:
    """What a camera's pixels can see."""
    width, height = camera.size_px
    seen = image_circle(camera)
    x, y = np.meshgrid(np.arange(width + 1.0), np.arange(height + 1.0))
    corners = rays(camera, x, y)
    whole = seen & _all_corners(corners.valid)
    return PixelKinds(seen, whole, whole & _all_corners(corners.direction @ camera.world_from_camera[2] > -1e-9))


def _all_corners(corners: NDArray[np.bool_]) -> NDArray[np.bool_]:
    return np.asarray(corners[:-1, :-1] & corners[:-1, 1:] & corners[1:, :-1] & corners[1:, 1:])


class _Painted:
    """The emitters and surfaces of scenes, whose channels change in place."""

    def __init__(self, timer: Timer) -> None:
        self.paints = Paints()
        self._lights: list[tuple[Any, Callable[[Channels], dict[str, Any]]]] = []
        self._timer = timer

    def light(self, recipe: Callable[[Channels], dict[str, Any]], first: dict[str, Any] | None = None) -> Any:
        """An emitter that is made, and later repainted, by a function of the channels; an object for one scene."""
        emitter = mitsuba().load_dict(recipe(RGB) if first is None else first, optimize=False)
        self._lights.append((emitter, recipe))
        return emitter

    def show(self, channels: Channels) -> None:
        if channels == self.paints.channels:
            return
        mi = mitsuba()
        with self._timer("radiance: repaint"):
            self.paints.repaint(channels)
            for emitter, recipe in self._lights:
                repaint(emitter, mi.load_dict(recipe(channels), optimize=False))


class _ClearView:
    def __init__(self, shot: Shot, timer: Timer) -> None:
        self._shot, self._timer = shot, timer
        self._painted = _Painted(timer)
        with timer("radiance: build"):
            emitters = {name: self._painted.light(emitter) for name, emitter in emitters_of(shot.spec.sky).items()}
            self._scene = load({**scene_dict(shot.spec, origin_of(shot.camera), self._painted.paints), **emitters})
            self._integrator = _path_tracer("path", shot.max_depth)

    def take(self, channels: Channels, samples: int, number: tuple[int, int]) -> NDArray[np.float64]:
        self._painted.show(channels)
        seed = child_seed(self._shot.seed, "clear", *number)
        with self._timer("mitsuba"):
            return capture(self._integrator, self._scene, self._shot.camera, samples=samples, seed=seed)[..., :3]


class _CloudyView:
    def __init__(self, shot: Shot, progress: Progress, timer: Timer) -> None:
        self._shot, self._timer = shot, timer
        self._painted = painted = _Painted(timer)
        spec, origin = shot.spec, origin_of(shot.camera)
        baked = self._bake(progress)
        with timer("radiance: build"):
            plants = scene_dict(spec, origin, painted.paints)  # meshes are shared; instances belong to one scene each
            self._by_sky = load({**plants, "light": painted.light(baked, baked(RGB))})
            self._by_sun = None
            of_sky = {"sky": painted.light(lambda channels: sky_light(spec.sky, channels))}
            if has_sun(spec.sky):
                disc = painted.light(lambda channels: sun_disc(spec.sky, channels))
                self._by_sun = load({**plants, "light": disc, "sheet": sky.sun_sheet(spec, origin)})
                of_sky["sun"] = painted.light(lambda channels: sun_disc(spec.sky, channels))
            self._clouds = load(sky.clouds_over_ground(spec, origin, of_sky))
            self._hidden = _path_tracer("volpath", shot.max_depth, hide_emitters=True)
            self._through = mitsuba().load_dict(sky.CLOUD_INTEGRATOR)
        kinds = pixels_of(shot.camera)
        self._above, self._below = kinds.above, kinds.whole & ~kinds.above
        share = np.ones_like(self._above) if shot.sky_share is None else shot.sky_share
        self._window = cloud_window(share & kinds.seen, self._above)

    def _bake(self, progress: Progress) -> Callable[[Channels], dict[str, Any]]:
        """Light of the sky through the clouds, by channels."""
        spec, origin = self._shot.spec, origin_of(self._shot.camera)
        seed = child_seed(self._shot.seed, "bake") >> 1
        with progress.stage("light of the sky", 1) as advance:
            with self._timer("mitsuba"):
                if self._shot.mode == "rgb" and not self._shot.camera.bands:
                    colour = sky.bake_sky(spec, origin, RGB, seed=seed)
                    advance(1)
                    return lambda channels: colour
                spectral = sky.bake_spectral_sky(spec, origin, seed=seed)
            advance(1)
        middle = Channels((640.0, 550.0, 450.0))  # something to build with: each pass repaints it
        return lambda channels: spectral.light(middle if channels == RGB else channels)

    def take(self, channels: Channels, samples: int, number: tuple[int, int]) -> NDArray[np.float64]:
        self._painted.show(channels)
        # The sky's light is smooth, and the sky itself easily denoised: they need fewer samples than the sun.
        few = (samples + 1) // 2
        by_sky = self._capture(self._hidden, self._by_sky, few, ("sky", *number))
        image, cover = by_sky[..., :3], by_sky[..., 3:4]
        if self._by_sun is not None:
            image = image + self._capture(self._hidden, self._by_sun, samples, ("sun", *number))[..., :3]
        window = self._window
        if window is None:
            return np.asarray(image)
        beyond = self._capture(self._through, self._clouds, few, ("clouds", *number), window)[..., :3]
        inside = slice(window.y, window.y + window.height), slice(window.x, window.x + window.width)
        image[inside] += (1.0 - cover[inside]) * sky_alone(beyond, self._above[inside], self._below[inside])
        return np.asarray(image)

    def _capture(
        self, integrator: Any, scene: Any, samples: int, name: tuple[str, int, int], window: FilmWindow | None = None
    ) -> NDArray[np.float64]:
        seed = child_seed(self._shot.seed, *name)
        with self._timer("mitsuba"):
            return capture(integrator, scene, self._shot.camera, samples=samples, seed=seed, window=window)


def _path_tracer(kind: str, max_depth: int, **more: Any) -> Any:
    settings = {"type": kind, "max_depth": max_depth, "rr_depth": ROULETTE_DEPTH, "block_size": BLOCK_PX}
    return mitsuba().load_dict(settings | more)


def sky_alone(image: NDArray[np.float64], above: NDArray[np.bool_], below: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(H, W, 3) the cloud pass, its pixels `below` the horizon replaced by the nearest ones `above`.

    There it shows its plain. In a pixel that holds both, mean coverage times the pass' mean would mix the plain into
    the sky: 1% too dark along the horizon.
    """
    from scipy.ndimage import distance_transform_edt

    if not below.any() or not above.any():
        return image
    rows, columns = distance_transform_edt(~above, return_distances=False, return_indices=True)
    return np.asarray(np.where(below[..., None], image[rows, columns], image))


def cloud_window(share: NDArray[np.bool_], above: NDArray[np.bool_]) -> FilmWindow | None:
    """Smallest window that holds the pixels that may see the sky, and the pixel above the horizon next to each."""
    from scipy.ndimage import distance_transform_edt

    if not share.any() or not above.any():
        return None
    rows, columns = np.nonzero(share)
    if not above.all():
        nearest = distance_transform_edt(~above, return_distances=False, return_indices=True)
        up_rows, up_columns = nearest[:, rows, columns]
        rows, columns = np.concatenate([rows, up_rows]), np.concatenate([columns, up_columns])
    top, left = int(rows.min()), int(columns.min())
    return FilmWindow(left, top, int(columns.max()) - left + 1, int(rows.max()) - top + 1)
