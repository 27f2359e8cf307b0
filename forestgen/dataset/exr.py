"""One multi-part OpenEXR a frame: radiance, geometry and identity, losslessly.

| part                  | channels                    | type   | meaning                                               |
|-----------------------|-----------------------------|--------|-------------------------------------------------------|
| radiance              | R G B, or a channel a band  | float  | linear Rec. 709 in cd/m2; bands: W m-2 sr-1 nm-1      |
| radiance.denoised     | as above                    | float  | the same, denoised: biased; only where asked for      |
| radiance.variance     | as above                    | float  | variance of `radiance`, its unit squared              |
| depth                 | Z distance                  | float  | metres along the camera's axis, along the ray; of     |
|                       |                             |        | fisheyes and panoramas both along the ray             |
| normal                | X Y Z                       | float  | world, unit, geometric, towards the camera; sky 0     |
| normal.camera         | X Y Z                       | float  | the same, in the camera's axes                        |
| normal.shading        | X Y Z                       | float  | world, unit, interpolated over the mesh; sky 0        |
| normal.shading.camera | X Y Z                       | float  | the same, in the camera's axes                        |
| position              | X Y Z                       | float  | world, metres; NaN for the sky                        |
| position.camera       | X Y Z                       | float  | the camera's axes, metres; Z is depth.Z to the bit,   |
|                       |                             |        | but of fisheyes and panoramas                         |
| albedo                | R G B                       | float  | reflectance + transmittance; sky 0                    |
| sun                   | visible                     | uint32 | 1 where nothing hides the sun's centre; sky 0         |
| cloud                 | opacity                     | float  | 1 - transmittance of the clouds along the ray         |
| motion                | forward.u forward.v         | float  | pixels right, down, to the next frame; NaN: none      |
| boundary              | occluding                   | uint32 | 1 where the surface hides a neighbouring pixel's      |
| module                | number node                 | uint32 | branch module's number + 1, 0: none; its segment's    |
|                       |                             |        | node; where labels.channels name it                   |
|                       | own                         | uint32 | 1: the plant's own branches; 0: of what stands for it |
| identity              | plant_id part semantic      | uint32 | of the largest coverage                               |
|                       | centre.plant_id centre.part | uint32 | of the centre's ray                                   |
|                       | centre.exemplar centre.face | uint32 | number of the exemplar + 1, 0: none; its triangle     |
| coverage              | rank0.id ... rank7.id       | uint32 | the ids that cover most of the pixel                  |
|                       | rank0.coverage ...          | float  | their shares; 0 where no id takes the rank            |

"float" is float32. All but radiance, coverage and identity's first three are those of the ray through the pixel's
centre. The camera's axes are OpenCV's: x right, y down, z forward. Depth and distance are infinite for the sky. Parts
that the recipe's labels.channels leaves out are absent, and so is the motion of a still camera.

Channels have bare names: programs that know layers, as Blender, put the part's name before them (normal.camera.X).
Integers are for readers that keep them; programs for pictures turn them into floats, which hold ids up to 2^24 only:
cryptomatte.exr is made for those. Equal input gives equal bytes: no date, no host name.

Attributes are OpenEXR's standard ones for colour and camera, and ``forestgen/...`` strings:

| attribute                        | what it says                                                                      |
|----------------------------------|-----------------------------------------------------------------------------------|
| chromaticities, whiteLuminance   | of Rec. 709; the luminance of (1, 1, 1) in cd/m2, which is 1 (radiance in colour) |
| colour_space, units.PART         | of radiance in colour; the unit of a part's values                                |
| bands                            | of radiance in bands, JSON: channel, response, centre and width in nm             |
| samples, biased                  | light paths a pixel; the part that is no mean of samples, if there is one         |
| relative_error, .._p95           | of radiance: standard error over value, mean of the pixels and 95th percentile    |
| stopped_by                       | why no more samples were taken                                                    |
| view, picture                    | the previews' view transform, and the channels that they show                     |
| classes, parts                   | JSON: the names of the numbers in semantic and part                               |
| camera, recipe_hash, seed, ...   | camera.json in one line; where the image comes from                               |

Compression is ZIP, lossless. Measured on 640 x 480 pixels of 10,000 trees, all parts: 104 bytes a pixel of 240;
radiance, its variance and the denoised copy take 36, what is in the camera's axes 22, identity and coverage 8. PIZ took
111 and twice the time, ZIPS 118. ZSTD took 103, but older readers lack it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.errors import OutputError
from forestgen.dataset.camera import camera_model, exr_attributes
from forestgen.dataset.legend import classes_text, parts_text
from forestgen.dataset.light_parts import light_attributes, own_attributes, radiance_channels
from forestgen.labels.labelled import LabelledFrame
from forestgen.labels.masks import CoverageRanks
from forestgen.render.frame import Branches, Surface
from forestgen.scene.projection import centre_rays, projection_of
from forestgen.scene.spec import Camera

Channels = dict[str, NDArray[Any]]

STORED_RANKS = 8
# x, y of red, green, blue and white (D65): ITU-R BT.709-6, table 1, item 1.3 and 1.4
REC709_CHROMATICITIES = (0.640, 0.330, 0.300, 0.600, 0.150, 0.060, 0.3127, 0.3290)


def write_exr(path: Path, labelled: LabelledFrame, attributes: Mapping[str, str]) -> None:
    """Write a frame.

    Parameters
    ----------
    path : the file to write.
    labelled : what is known of the frame.
    attributes : name -> text, written as ``forestgen/name`` in every part's header.
    """
    parts, radiance = frame_parts(labelled), labelled.frame.radiance
    names = {"classes": classes_text(labelled.classes.names), "parts": parts_text()}
    header = _header(labelled.frame.camera, {**names, **light_attributes(radiance, parts), **attributes})
    write_parts(path, parts, header, own_attributes(radiance))


def write_parts(
    path: Path,
    parts: Mapping[str, Channels],
    header: Mapping[str, Any],
    own: Mapping[str, Mapping[str, Any]] | None = None,
) -> None:
    """Write parts of (H, W) channels; a single part makes a file that old readers know, without name.

    Parameters
    ----------
    header : attributes of all parts.
    own : part -> attributes that it has besides, or instead.

    Raises
    ------
    OutputError
        When the file cannot be written.
    """
    import OpenEXR

    common = {**header, "compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    if len(parts) == 1:
        file = OpenEXR.File(common, *parts.values())
    else:
        own = own or {}
        file = OpenEXR.File(
            [OpenEXR.Part({**common, **own.get(name, {})}, channels, name) for name, channels in parts.items()]
        )
    try:
        file.write(str(path))
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
        **attributes,
    }
    return {
        # OpenEXR demands equal chromaticities in all parts of a file, those without colour included.
        "chromaticities": REC709_CHROMATICITIES,
        **exr_attributes(camera),
        **{f"forestgen/{name}": str(ours[name]) for name in sorted(ours)},
    }


def frame_parts(labelled: LabelledFrame) -> dict[str, Channels]:
    """Part -> channel -> (H, W) array, float32 or uint32, as the table above has them."""
    frame, labels = labelled.frame, labelled.pixels
    wanted = labelled.channels
    parts = {
        **radiance_channels(frame.radiance),
        "depth": _single("Z", frame.surface.depth_m) | _single("distance", frame.surface.distance_m),
        **(_surface_parts(frame.surface, frame.camera) if "surface" in wanted else {}),
        "albedo": _split("RGB", frame.surface.albedo if "albedo" in wanted else None),
        "sun": _single("visible", frame.surface.sun_visible if "sun" in wanted else None),
        "cloud": _single("opacity", frame.cloud_opacity if "cloud" in wanted else None),
        "motion": _split(("forward.u", "forward.v"), frame.motion_px if "motion" in wanted else None),
        "boundary": _single("occluding", labelled.boundaries),
        "module": _branch_channels(frame.branches if "module" in wanted else None),
        "identity": {
            **_single("plant_id", labels.instance),
            **_single("part", labels.part),
            **_single("semantic", labels.semantic),
            **(_centre_channels(frame.surface) if "surface" in wanted else {}),
        },
        "coverage": _rank_channels(labels.ranks) if "coverage" in wanted else {},
    }
    return {name: channels for name, channels in parts.items() if channels}


def _surface_parts(surface: Surface, camera: Camera) -> dict[str, Channels]:
    rotation = camera.world_from_camera
    return {
        "normal": _split("XYZ", surface.normal),
        "normal.camera": _split("XYZ", _turned(surface.normal, rotation)),
        "normal.shading": _split("XYZ", surface.shading_normal),
        "normal.shading.camera": _split("XYZ", _turned(surface.shading_normal, rotation)),
        "position": _split("XYZ", surface.position_m),
        "position.camera": _split("XYZ", camera_position_m(surface.depth_m, camera)),
    }


def _centre_channels(surface: Surface) -> Channels:
    return {
        **_single("centre.plant_id", surface.plant_id),
        **_single("centre.part", surface.part),
        **_single("centre.exemplar", surface.exemplar),
        **_single("centre.face", surface.face),
    }


def _branch_channels(branches: Branches | None) -> Channels:
    if branches is None:
        return {}
    return {
        **_single("number", branches.module),
        **_single("node", branches.node),
        **_single("own", branches.is_own),
    }


def _rank_channels(ranks: CoverageRanks) -> Channels:
    channels: Channels = {}
    for rank in range(min(STORED_RANKS, ranks.plant_id.shape[-1])):
        channels |= _single(f"rank{rank}.id", ranks.plant_id[..., rank])
        channels |= _single(f"rank{rank}.coverage", ranks.coverage[..., rank])
    return channels


def camera_position_m(depth_m: NDArray[np.float32], camera: Camera) -> NDArray[np.float32]:
    """(H, W, 3) in the camera's axes, of pixel centres: exact far from the world's origin too; NaN for the sky."""
    depth = np.where(np.isfinite(depth_m), depth_m, np.nan).astype(np.float64)
    if not projection_of(camera).is_pinhole:
        rays = centre_rays(camera)
        return (rays.origin_m + rays.direction * depth[..., None]).astype(np.float32)
    x, y = camera.pixel_slopes
    return np.stack([depth * x, depth * y[:, None], depth], axis=-1).astype(np.float32)


def _turned(vectors: NDArray[np.float32], world_from_camera: NDArray[np.float64]) -> NDArray[np.float32]:
    return (vectors @ world_from_camera).astype(np.float32)


def _split(names: Sequence[str], values: NDArray[Any] | None) -> Channels:
    """(H, W, C) -> a channel each; None -> none."""
    channels: Channels = {}
    if values is not None:
        for i, name in enumerate(names):
            channels |= _single(name, values[..., i])
    return channels


def _single(name: str, values: NDArray[Any] | None) -> Channels:
    """(H, W) -> contiguous, float32 or uint32, as OpenEXR has them; None -> none."""
    if values is None:
        return {}
    kind = np.float32 if np.issubdtype(values.dtype, np.floating) else np.uint32
    return {name: np.ascontiguousarray(values, dtype=kind)}
