"""Label channel `amodal`: masks of each plant as if nothing stood before it; see labels/masks.py.

It has no part in frame.exr: plants.parquet and the formats hold the masks.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from forestgen.labels.channels.channel import ChannelView, LabelChannel
from forestgen.render.amodal import trace_amodal
from forestgen.render.frame import Frame


class Amodal(LabelChannel):
    """Amodal masks."""

    name = "amodal"

    def add(self, frame: Frame, view: ChannelView) -> Frame:
        """Of the plants that a sample saw."""
        plants = np.unique(frame.identity.plant_id)
        plants = plants[plants != 0]
        samples = frame.identity.plant_id.shape[2]
        with view.progress.stage(f"amodal {frame.camera.name}", len(plants)) as advance:
            found = trace_amodal(
                view.tracer, frame.camera, plants, samples=samples, timer=view.timings, advance=advance
            )
        return replace(frame, amodal=found)


CHANNEL = Amodal()
