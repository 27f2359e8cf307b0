"""Label channel `albedo`: reflectance and transmittance of the surface at each pixel's centre."""

from __future__ import annotations

from collections.abc import Mapping

from forestgen.labels.channels.channel import LabelChannel, Layers, layers
from forestgen.labels.labelled import LabelledFrame


class Albedo(LabelChannel):
    """Reflectance and transmittance of surfaces."""

    name = "albedo"
    units: Mapping[str, str] = {"albedo": "1, linear Rec. 709 (D65)"}

    def parts(self, labelled: LabelledFrame) -> dict[str, Layers]:
        return {"albedo": layers("RGB", labelled.frame.surface.albedo)}


CHANNEL = Albedo()
