"""Label channel `cloud`: opacity of the clouds along the ray of each pixel's centre."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from forestgen.atmosphere.optical_depth import cloud_opacity
from forestgen.labels.channels.channel import ChannelView, LabelChannel, Layers, layer
from forestgen.labels.labelled import LabelledFrame
from forestgen.render.frame import Frame
from forestgen.scene.projection import world_rays


class Cloud(LabelChannel):
    """Opacity of clouds."""

    name = "cloud"
    units: Mapping[str, str] = {"cloud": "1"}

    def add(self, frame: Frame, view: ChannelView) -> Frame:
        """0 everywhere under a clear sky."""
        distance_m, clouds = frame.surface.distance_m, view.tracer.spec.clouds
        if clouds is None:
            return replace(frame, cloud_opacity=np.zeros(distance_m.shape, dtype=np.float32))
        with view.timings("cloud opacity"):
            rays = world_rays(frame.camera)
            far_m = np.where(rays.valid, distance_m, np.float32(0))
            return replace(frame, cloud_opacity=cloud_opacity(clouds, rays.origin_m, rays.direction, far_m))

    def parts(self, labelled: LabelledFrame) -> dict[str, Layers]:
        return {"cloud": layer("opacity", labelled.frame.cloud_opacity)}


CHANNEL = Cloud()
