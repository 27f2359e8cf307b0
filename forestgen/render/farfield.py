"""A scene under clouds that are far above it.

Three estimators add up: light of the sky on the scene, light of the sun on the scene, and the sky itself in the share
of each pixel that the scene leaves open (see render/sky.py).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.progress import Progress
from forestgen.core.randomness import child_seed
from forestgen.render import sky
from forestgen.render.build import load, origin_of, scene_dict
from forestgen.render.light import has_sun, sky_light, sun_disc
from forestgen.render.painted import Painted, path_tracer
from forestgen.render.sensors import FilmWindow, capture
from forestgen.render.variant import mitsuba
from forestgen.render.views import Shot, Timer, pixels_of
from forestgen.scene.channels import RGB, Channels


class FarfieldView:
    def __init__(self, shot: Shot, progress: Progress, timer: Timer) -> None:
        self._shot, self._timer = shot, timer
        self._painted = painted = Painted(timer)
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
            self._hidden = path_tracer("volpath", shot.max_depth, hide_emitters=True)
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
