"""depth.png against frame.exr: within half a step, with 0 for the sky and 65,535 beyond its reach."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from forestgen.dataset.check.files import Finding, finding, read_json
from forestgen.dataset.check.frame_data import FrameData, Wrong, frame_check

_PICTURE, _SCALE = "depth.png", "depth.json"
_MOST, _BEYOND = 65_534, 65_535
_HALF = 0.5 + 1e-6  # a step; float32 against decimal


@frame_check("depth.png", _PICTURE, files=(_PICTURE,), exr=("depth Z",))
def depth_png(frame: FrameData) -> Iterator[Finding | Wrong]:
    """Steps times unit_m is the depth within half a step."""
    unit_m = float(read_json(frame.root, frame.file(_SCALE))["unit_m"])
    if not 0 < unit_m < np.inf:
        yield finding("unit_m is no length", "metres, more than 0 and finite", unit_m, file=frame.file(_SCALE))
        return
    got = frame.picture(_PICTURE).astype(np.float64)
    depth_m = frame.exr["depth"]["Z"].astype(np.float64)
    with np.errstate(over="ignore"):  # a depth in steps of almost nothing lies beyond the format
        steps = depth_m / unit_m
    sky = np.isinf(depth_m)
    yield Wrong((got == 0) != sky, "0 is the sky's alone", "0 for the sky", got)
    beyond = ~sky & (steps > _MOST + _HALF)
    yield Wrong(beyond & (got != _BEYOND), "the depth is beyond the format", str(_BEYOND), got)
    wrong = ~sky & (steps <= _MOST) & ~(np.abs(got - np.maximum(steps, 1.0)) <= _HALF)
    yield Wrong(wrong, "the depth is not frame.exr's, in steps", steps, got)


FRAME_CHECKS = (depth_png,)
