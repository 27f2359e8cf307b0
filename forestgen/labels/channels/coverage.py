"""Label channels of all samples of a pixel.

- `coverage`: the ids that cover most of each pixel, with their shares
- `amodal`: masks of each plant as if nothing stood before it; see labels/masks.py. It has no part in frame.exr:
  plants.parquet and the formats hold the masks.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from forestgen.labels.channels.channel import ChannelView, LabelChannel, Layers, layer
from forestgen.labels.labelled import LabelledFrame
from forestgen.render.amodal import trace_amodal
from forestgen.render.frame import Frame

STORED_RANKS = 8


class Coverage(LabelChannel):
    """The ids that cover most of a pixel, and their shares."""

    name = "coverage"
    of_all_samples = True

    def parts(self, labelled: LabelledFrame) -> dict[str, Layers]:
        ranks = labelled.pixels.ranks
        found: Layers = {}
        for rank in range(min(STORED_RANKS, ranks.plant_id.shape[-1])):
            found |= layer(f"rank{rank}.id", ranks.plant_id[..., rank])
            found |= layer(f"rank{rank}.coverage", ranks.coverage[..., rank])
        return {"coverage": found}


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


COVERAGE, AMODAL = Coverage(), Amodal()
