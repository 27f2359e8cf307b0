"""transforms.json against camera.json: one camera in OpenGL's axes and in OpenCV's."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

import numpy as np

from forestgen.dataset.check.check import DatasetCheck, FrameCheck
from forestgen.dataset.check.finding import Finding, number, numbers
from forestgen.dataset.check.frame_data import FrameData
from forestgen.dataset.check.merged import TRANSFORMS, Merged, folder_of

_TOLERANCE = 1e-6


def has_transforms(merged: Merged) -> bool:
    return bool(merged.transforms_files)


def has_share(frame: FrameData) -> bool:
    return TRANSFORMS in frame.task.shared


def structure(merged: Merged) -> Iterator[Finding]:
    """Each frame is once in the transforms of its image, and the files that they name are there."""
    seen: Counter[str] = Counter()
    for file in merged.transforms_files:
        for frame in merged.transforms(file)["frames"]:
            name = folder_of(frame["file_path"])
            seen[name] += 1
            for key in ("file_path", "depth_file_path"):
                if key in frame and not (merged.root / str(frame[key])).is_file():
                    yield Finding(file, f"{key} is not there", got=str(frame[key]), image=name)
    for name in merged.frames:
        if seen[name] != 1:
            got = f"{seen[name]} times"
            yield Finding(merged.transforms_files[0], "a frame is not listed once", "once", got, name)


def transforms(frame: FrameData) -> Iterator[Finding]:
    """The pose is camera.json's inverse with y and z turned round; the focal lengths and the centre are its model's."""
    share, camera = frame.task.shared[TRANSFORMS], frame.camera
    file = share["file"]
    expected = np.linalg.inv(camera.camera_from_world) @ np.diag([1.0, -1.0, -1.0, 1.0])
    got = np.asarray(share["transform_matrix"], dtype=np.float64)
    if got.shape != (4, 4) or not np.allclose(got, expected, rtol=_TOLERANCE, atol=_TOLERANCE):
        problem = "transform_matrix is not camera.json's pose"
        yield Finding(file, problem, numbers(expected), numbers(got), frame.name)
    width, height = camera.size_px
    # A panorama's are so that (x - cx) / fl_x runs from -1 to 1 and (y - cy) / fl_y from -1/2 to 1/2.
    exchange, geometry = camera.projection.exchange, camera.geometry
    focal = geometry.focal_px if exchange is None or exchange.has_k else (width / 2, height)
    for key, value in (
        *(("w", width), ("h", height), ("fl_x", focal[0]), ("fl_y", focal[1])),
        *(("cx", geometry.centre_px[0]), ("cy", geometry.centre_px[1])),
    ):
        if not abs(float(share[key]) - float(value)) <= _TOLERANCE * max(1.0, abs(float(value))):
            yield Finding(file, f"{key} is not camera.json's", number(value), number(share[key]), frame.name)


FRAME_CHECKS = (FrameCheck("transforms", "cameras are camera.json's", TRANSFORMS, has_share, transforms, True),)
DATASET_CHECKS = (DatasetCheck("transforms files", "each frame once", TRANSFORMS, has_transforms, structure),)
