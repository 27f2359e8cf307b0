"""Label channel `module`: which branch module, and which segment of it, lies under the centre of each pixel.

A module's number is its own within its plant for life (`architecture/modules.py`), so a branch is named by the plant's
id, the module's number and the node of the module's prototype that ends the segment. Twigs and leaves that are drawn on
a segment are that segment's. A plant that another one stands for shows that one's branches: `is_own` is false then.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from forestgen.architecture.prototypes import MOST_NODES
from forestgen.labels.channels.channel import ChannelView, LabelChannel, Layers, layer
from forestgen.labels.labelled import LabelledFrame
from forestgen.plants.exemplar import Exemplar
from forestgen.render.frame import Branches, Frame, Surface


class Module(LabelChannel):
    """Branch modules and their segments."""

    name = "module"

    def add(self, frame: Frame, view: ChannelView) -> Frame:
        return replace(frame, branches=branch_labels(frame.surface, view.tracer.spec.exemplars))

    def parts(self, labelled: LabelledFrame) -> dict[str, Layers]:
        branches = labelled.frame.branches
        if branches is None:
            return {}
        return {
            "module": layer("number", branches.module) | layer("node", branches.node) | layer("own", branches.is_own)
        }


CHANNEL = Module()


def branch_labels(surface: Surface, exemplars: Sequence[Exemplar]) -> Branches:
    """Look up the surface's triangles in the scene's exemplars."""
    shape = surface.exemplar.shape
    module, node = np.zeros(shape, dtype=np.uint32), np.zeros(shape, dtype=np.uint32)
    is_own = np.zeros(shape, dtype=np.bool_)
    for index in np.unique(surface.exemplar[surface.exemplar > 0]).tolist():
        marks = exemplars[index - 1].marks()
        if marks is None:
            continue
        seen = surface.exemplar == index
        found = marks[surface.face[seen]]
        module[seen], node[seen] = found // MOST_NODES + 1, found % MOST_NODES
        is_own[seen] = exemplars[index - 1].is_unique
    return Branches(module, node, is_own)
