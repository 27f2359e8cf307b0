"""Label channel `coverage`: the ids that cover most of each pixel, with their shares."""

from __future__ import annotations

from forestgen.labels.channels.channel import LabelChannel, Layers, layer
from forestgen.labels.labelled import LabelledFrame

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


CHANNEL = Coverage()
