"""What a label channel is: one file in this folder, one line in recipe/registries.py."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from forestgen.labels.labelled import LabelledFrame
from forestgen.recipe.registries import LABEL_CHANNELS
from forestgen.render.frame import Frame

if TYPE_CHECKING:
    from forestgen.core.progress import Progress, Timings
    from forestgen.render.identity import SceneTracer
    from forestgen.scene.spec import Camera, SceneSpec

Layers = dict[str, NDArray[Any]]  # channel of frame.exr -> (H, W) float32 or uint32


@dataclass(frozen=True)
class ChannelView:
    """What a channel is made of, besides the frame."""

    tracer: SceneTracer  # of the scene as it is at the camera's time
    following: tuple[Camera, SceneSpec] | None  # the sequence's next camera, and the scene as it is then
    progress: Progress
    timings: Timings


class LabelChannel:
    """A label channel, without a state. Each method does nothing unless it is overridden."""

    name: str  # that recipes use: the registry's
    units: Mapping[str, str] = {}  # part of frame.exr -> the unit of its values
    of_all_samples: bool = False  # its parts are not of the centres' rays; frame.exr has these last

    def add(self, frame: Frame, view: ChannelView) -> Frame:
        """The frame with what the channel needs of the scene, which files are not made of.

        A channel of another package keeps its arrays in `Frame.own`, under its name.
        """
        return frame

    def parts(self, labelled: LabelledFrame) -> dict[str, Layers]:
        """Part of frame.exr -> its channels, for `layer` and `layers`; none where the frame has nothing to show."""
        return {}


def layers(names: Sequence[str], values: NDArray[Any] | None) -> Layers:
    """(H, W, C) -> a channel each; None -> none."""
    found: Layers = {}
    if values is not None:
        for i, name in enumerate(names):
            found |= layer(name, values[..., i])
    return found


def layer(name: str, values: NDArray[Any] | None) -> Layers:
    """(H, W) -> contiguous, float32 or uint32, as OpenEXR has them; None -> none."""
    if values is None:
        return {}
    kind = np.float32 if np.issubdtype(values.dtype, np.floating) else np.uint32
    return {name: np.ascontiguousarray(values, dtype=kind)}


def add_channels(frame: Frame, names: Sequence[str], view: ChannelView) -> Frame:
    """The frame with what its label channels need."""
    for one in LABEL_CHANNELS.load_all(names):
        frame = one.add(frame, view)
    return frame
