"""Label channel `sun`: whether the sun's centre is visible from the surface at each pixel's centre."""

from __future__ import annotations

from forestgen.labels.channels.channel import LabelChannel, Layers, layer
from forestgen.labels.labelled import LabelledFrame


class Sun(LabelChannel):
    """Shadows: where the sun is visible."""

    name = "sun"

    def parts(self, labelled: LabelledFrame) -> dict[str, Layers]:
        return {"sun": layer("visible", labelled.frame.surface.sun_visible)}


CHANNEL = Sun()
