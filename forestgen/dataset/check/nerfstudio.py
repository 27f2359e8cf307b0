"""transforms.json against camera.json: one camera in OpenGL's axes and in OpenCV's."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from forestgen.dataset.check.files import Finding, finding
from forestgen.dataset.check.frame_data import FrameData, frame_check
from forestgen.dataset.check.merged import Merged, dataset_check, folder_of

_FILE = "transforms.json"
_FILES = re.compile(r"transforms(-.*)?\.json")
_SHARE = "nerfstudio"
_TOLERANCE = 1e-6


def _files(merged: Merged) -> list[str]:
    """transforms.json, or transforms-000000.json and so on."""
    names = {path.name for path in merged.root.iterdir()} | set(merged.listed)
    return sorted(filter(_FILES.fullmatch, names))


def frame_shares(merged: Merged) -> Mapping[str, Any]:
    """Frame -> its entry in its transforms file, and that file."""
    frames = [(file, one) for file in _files(merged) for one in merged.lists(file, "frames")["frames"]]
    return {folder_of(one["file_path"]): {**one, "file": file} for file, one in frames}


@dataset_check("transforms files", _FILE, when=lambda merged: bool(_files(merged)))
def structure(merged: Merged) -> Iterator[Finding]:
    """Each frame is once in the transforms of its image, and the files that they name are there."""
    seen: Counter[str] = Counter()
    files = _files(merged)
    for file in files:
        for frame in merged.lists(file, "frames")["frames"]:
            name = folder_of(frame["file_path"])
            seen[name] += 1
            for key in ("file_path", "depth_file_path"):
                if key in frame and not (merged.root / str(frame[key])).is_file():
                    yield finding(f"{key} is not there", got=frame[key], file=file, image=name)
    for name in merged.frames:
        if seen[name] != 1:
            yield finding("a frame is not listed once", "once", f"{seen[name]} times", file=files[0], image=name)


@frame_check("transforms", _FILE, share=_SHARE, shared=True)
def transforms(frame: FrameData) -> Iterator[Finding]:
    """The pose is camera.json's inverse with y and z turned round; the focal lengths and the centre are its model's."""
    share, camera = frame.shared[_SHARE], frame.camera
    file = share["file"]
    expected = np.linalg.inv(camera.camera_from_world) @ np.diag([1.0, -1.0, -1.0, 1.0])
    got = np.asarray(share["transform_matrix"], dtype=np.float64)
    if got.shape != (4, 4) or not np.allclose(got, expected, rtol=_TOLERANCE, atol=_TOLERANCE):
        yield finding("transform_matrix is not camera.json's pose", expected, got, file=file)
    width, height = camera.size_px
    # A panorama's are so that (x - cx) / fl_x runs from -1 to 1 and (y - cy) / fl_y from -1/2 to 1/2.
    exchange, geometry = camera.projection.exchange, camera.geometry
    focal = geometry.focal_px if exchange is None or exchange.has_k else (width / 2, height)
    values = {"w": width, "h": height, "fl_x": focal[0], "fl_y": focal[1]}
    values |= {"cx": geometry.centre_px[0], "cy": geometry.centre_px[1]}
    for key, value in values.items():
        if not abs(float(share[key]) - float(value)) <= _TOLERANCE * max(1.0, abs(float(value))):
            yield finding(f"{key} is not camera.json's", value, share[key], file=file)


FRAME_CHECKS, DATASET_CHECKS = (transforms,), (structure,)
