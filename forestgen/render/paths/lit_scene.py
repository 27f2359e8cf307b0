"""A scene under a sky that is infinitely far away, ready to be seen by one camera in any channels."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from forestgen.render.cloud_shadow import Sheet
from forestgen.render.identity import SceneTracer
from forestgen.render.light import has_sun
from forestgen.render.paths.light import Sky, Sun
from forestgen.render.paths.scattering import Surfaces
from forestgen.render.paths.surface_tables import paint_of, relief_tables
from forestgen.render.paths.tracer import Image, PathTracer
from forestgen.render.sky_radiance import sun_irradiance, sun_radiance
from forestgen.render.variant import using
from forestgen.scene.channels import Channels
from forestgen.scene.spec import Camera


class LitScene:
    """
    Parameters
    ----------
    radiance : the sky in channels, as `sky_radiance.sky_map` has it.
    sheet : what clouds let through of the sun's light; None: all.
    """

    def __init__(
        self,
        tracer: SceneTracer,
        camera: Camera,
        max_depth: int,
        radiance: Callable[[Channels], NDArray[np.float32]],
        sheet: Sheet | None = None,
    ) -> None:
        self._tracer, self._radiance, self._sheet = tracer, radiance, sheet
        self._shown: Channels | None = None
        with using(tracer.variant):
            self._surfaces = Surfaces(tracer, relief_tables(tracer.spec))
            self._paths = PathTracer(tracer, camera, self._surfaces, max_depth)

    def show(self, channels: Channels) -> None:
        """Have the surfaces and lights of these channels."""
        if channels == self._shown:
            return
        spec = self._tracer.spec
        with using(self._tracer.variant):
            self._surfaces.show(paint_of(spec, channels))
            self._sky = Sky(self._radiance(channels), sampled=spec.clouds is not None)
            self._sun = None
            if has_sun(spec.sky):
                light, disc = sun_irradiance(spec.sky, channels), sun_radiance(spec.sky, channels)
                self._sun = Sun(spec.sky.to_sun, light, disc, self._sheet, self._tracer.origin_m)
        self._shown = channels

    def take(self, samples: int, seed: int) -> Image:
        """An image in the channels that are shown, by independent paths for each seed."""
        with using(self._tracer.variant):
            return self._paths.take(self._sky, self._sun, samples, seed)
