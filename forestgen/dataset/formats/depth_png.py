"""FRAME/depth.png: 16-bit depth along the camera's z, with its scale in FRAME/depth.json.

A pixel holds round(depth_m / unit_m), at least 1 and at most 65,534, of the surface that the pixel centre's ray
meets. So a depth of a step or more is read back within half a step. Two values are marks:

| value | meaning |
|---|---|
| 0 | sky: no surface |
| 65,535 | a surface beyond 65,534 steps, such as 655.34 m with the default step of 0.01 m |

depth.json holds `unit_m`, `no_depth` (0), `beyond` (65535) and `farthest_m`. frame.exr holds the same depths as floats.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from forestgen.dataset.formats.format import DatasetFormat, in_order, read_shard, write_shard
from forestgen.dataset.png import write_png
from forestgen.dataset.settings import DatasetSettings
from forestgen.labels.labelled import LabelledFrame

PICTURE_NAME, SCALE_NAME = "depth.png", "depth.json"
NO_DEPTH, MOST_STEPS, BEYOND = 0, 65_534, 65_535


class DepthPng(DatasetFormat):
    """16-bit depth along the camera's axis."""

    name = "depth_png"
    check_module = "forestgen.dataset.check.depth_png"
    bytes_per_pixel = 2

    def write_frame(self, folder: Path, labelled: LabelledFrame, settings: DatasetSettings) -> None:
        """Write the frame's depth and its scale into its folder; a failure raises `OutputError`."""
        unit_m = settings.depth_unit_m
        write_png(folder / PICTURE_NAME, encode_depth(labelled.frame.surface.depth_m, unit_m))
        scale = {"beyond": BEYOND, "farthest_m": MOST_STEPS * unit_m, "no_depth": NO_DEPTH, "unit_m": unit_m}
        write_shard(folder / SCALE_NAME, scale)

    def merge(self, root: Path, folders: Iterable[Path | str], settings: DatasetSettings) -> None:
        """Check that every frame has its depth; there is no file over all frames. See `DatasetFormat.merge`."""
        for folder in in_order(folders):
            read_shard(root / folder / SCALE_NAME, {"unit_m": float})


FORMAT = DepthPng()


def encode_depth(depth_m: NDArray[np.float32], unit_m: float) -> NDArray[np.uint16]:
    """(H, W) steps of depths, infinite for the sky."""
    steps = np.rint(np.asarray(depth_m, dtype=np.float64) / unit_m)
    steps = np.where(steps > MOST_STEPS, BEYOND, np.maximum(steps, 1.0))
    return np.where(np.isfinite(depth_m), steps, NO_DEPTH).astype(np.uint16)
