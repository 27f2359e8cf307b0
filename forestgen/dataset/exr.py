"""One multi-part OpenEXR a frame: radiance, geometry and identity, losslessly.

| part               | channels                          | type    | meaning |
|--------------------|-----------------------------------|---------|---------|
| radiance           | R G B                             | float32 | linear Rec. 709 |
| radiance.denoised  | R G B                             | float32 | the same, denoised; only where it was asked for |
| radiance.variance  | R G B                             | float32 | variance of `radiance` |
| depth              | Z                                 | float32 | metres along the camera's axis; inf for the sky |
| normal             | X Y Z                             | float32 | world, unit; 0 for the sky |
| position           | X Y Z                             | float32 | world, metres; NaN for the sky |
| identity           | plant_id part semantic            | uint32  | the largest coverage's |
| coverage           | rank0.id rank0.coverage ... rank7 | uint32, float32 | the ids that cover most of each pixel |

Depth, normal and position are those of pixel centres. Attributes: OpenEXR's standard ones for colour and camera, and
``forestgen/...`` strings. Equal input gives equal bytes: no date, no host name.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.errors import OutputError
from forestgen.dataset.camera import camera_model, screen_window_width, world_to_camera, world_to_ndc
from forestgen.labels.masks import CoverageRanks
from forestgen.labels.pixels import PixelLabels
from forestgen.render.frame import Frame
from forestgen.scene.spec import Camera

Channels = dict[str, NDArray[Any]]

STORED_RANKS = 8
# x, y of red, green, blue and white (D65): ITU-R BT.709-6, table 1, item 1.3 and 1.4
REC709_CHROMATICITIES = (0.640, 0.330, 0.300, 0.600, 0.150, 0.060, 0.3127, 0.3290)


def write_exr(path: Path, frame: Frame, labels: PixelLabels, attributes: Mapping[str, str]) -> None:
    """Write a frame.

    Parameters
    ----------
    path : the file to write.
    frame, labels : of the same (H, W).
    attributes : name -> text, written as ``forestgen/name`` in every part's header.
    """
    import OpenEXR

    header = {**_header(frame.camera, attributes), "compression": OpenEXR.ZIP_COMPRESSION}
    header["type"] = OpenEXR.scanlineimage
    parts = [OpenEXR.Part(dict(header), channels, name) for name, channels in _parts(frame, labels).items()]
    try:
        OpenEXR.File(parts).write(str(path))
    except (OSError, RuntimeError) as error:
        reason = str(error).replace(f' "{path}"', "")  # `where` says it once
        raise OutputError(
            f"cannot write OpenEXR: {reason}", where=str(path), hint="check the folder and the free space of its disk"
        ) from error


def read_exr(path: Path) -> dict[str, Channels]:
    """Pixels of an OpenEXR file: part name -> channel name -> (H, W) array in the type it was stored in."""
    return {
        part.name(): {name: np.asarray(channel.pixels) for name, channel in part.channels.items()}
        for part in _open(path, header_only=False).parts
    }


def read_exr_attributes(path: Path) -> dict[str, Any]:
    """Header of the first part: attribute name -> value."""
    return dict(_open(path, header_only=True).parts[0].header)


def _open(path: Path, *, header_only: bool) -> Any:
    import OpenEXR

    return OpenEXR.File(str(path), separate_channels=True, header_only=header_only)


def _header(camera: Camera, attributes: Mapping[str, str]) -> dict[str, Any]:
    ours = {
        "camera": json.dumps(camera_model(camera), sort_keys=True),
        "units": "metres, world frame: x east, y north, z up",
        "colour_space": "linear Rec. 709 (D65)",
        **attributes,
    }
    return {
        # OpenEXR demands equal chromaticities in all parts of a file, those without colour included.
        "chromaticities": REC709_CHROMATICITIES,
        "worldToCamera": world_to_camera(camera),
        "worldToNDC": world_to_ndc(camera),
        "pixelAspectRatio": 1.0,
        "screenWindowCenter": np.zeros(2, dtype=np.float32),
        "screenWindowWidth": screen_window_width(camera),
        **{f"forestgen/{name}": str(ours[name]) for name in sorted(ours)},
    }


def _parts(frame: Frame, labels: PixelLabels) -> dict[str, Channels]:
    identity, radiance = frame.identity, frame.radiance
    parts = {"radiance": _split("RGB", radiance.mean)}
    if radiance.denoised is not None:
        parts["radiance.denoised"] = _split("RGB", radiance.denoised)
    return {
        **parts,
        "radiance.variance": _split("RGB", radiance.variance),
        "depth": _split("Z", identity.depth_m[..., None]),
        "normal": _split("XYZ", identity.normal),
        "position": _split("XYZ", identity.position_m),
        "identity": {
            "plant_id": labels.instance.astype(np.uint32),
            "part": labels.part.astype(np.uint32),
            "semantic": labels.semantic.astype(np.uint32),
        },
        "coverage": _rank_channels(labels.ranks),
    }


def _rank_channels(ranks: CoverageRanks) -> Channels:
    channels: Channels = {}
    for rank in range(min(STORED_RANKS, ranks.plant_id.shape[-1])):
        channels[f"rank{rank}.id"] = np.ascontiguousarray(ranks.plant_id[..., rank])
        channels[f"rank{rank}.coverage"] = np.ascontiguousarray(ranks.coverage[..., rank])
    return channels


def _split(names: str, values: NDArray[Any]) -> Channels:
    """(H, W, C) -> a contiguous (H, W) float32 array a channel."""
    return {name: np.ascontiguousarray(values[..., i], dtype=np.float32) for i, name in enumerate(names)}
