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

Layers have bare names: programs that know layers, as Blender, put the part's name before them (normal.camera.X).
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
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.errors import OutputError
from forestgen.dataset.camera import camera_model, exr_attributes
from forestgen.dataset.png import classes_text, parts_text
from forestgen.dataset.tonemap import band_figures, picture_light
from forestgen.labels.channels.channel import Layers, layer
from forestgen.labels.labelled import LabelledFrame
from forestgen.recipe.registries import LABEL_CHANNELS
from forestgen.render.frame import Radiance
from forestgen.scene.spec import Camera

# x, y of red, green, blue and white (D65): ITU-R BT.709-6, table 1, item 1.3 and 1.4
REC709_CHROMATICITIES = (0.640, 0.330, 0.300, 0.600, 0.150, 0.060, 0.3127, 0.3290)
COLOUR_UNIT = "cd/m2, linear Rec. 709 (D65)"
BAND_UNIT = "W m-2 sr-1 nm-1"
_BIASED = "radiance.denoised"


def write_exr(path: Path, labelled: LabelledFrame, attributes: Mapping[str, str]) -> None:
    """Write a frame; `attributes`, name -> text, go into every part's header as ``forestgen/name``."""
    parts, radiance = frame_parts(labelled), labelled.frame.radiance
    names = {"classes": classes_text(labelled.classes.names), "parts": parts_text()}
    units = {part: unit for one in LABEL_CHANNELS.load_all(labelled.channels) for part, unit in one.units.items()}
    light = light_attributes(radiance, {part: units.get(part) for part in parts})
    header = _header(labelled.frame.camera, {**names, **light, **attributes})
    write_parts(path, parts, header, own_attributes(radiance))


def write_parts(
    path: Path,
    parts: Mapping[str, Layers],
    header: Mapping[str, Any],
    own: Mapping[str, Mapping[str, Any]] | None = None,
) -> None:
    """Write parts of (H, W) channels; a failure raises `OutputError`.

    `header` are attributes of all parts, `own` those that a part has besides, or instead. A single part makes a file
    that old readers know, without name.
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
        reason, hint = str(error).replace(f' "{path}"', ""), "check the folder and the free space of its disk"
        raise OutputError(f"cannot write OpenEXR: {reason}", where=str(path), hint=hint) from error


def read_exr(path: Path) -> dict[str, Layers]:
    """Pixels of an OpenEXR file: part name -> channel name -> (H, W) array in the type it was stored in."""
    import OpenEXR

    parts = OpenEXR.File(str(path), separate_channels=True).parts
    return {part.name(): {name: np.asarray(one.pixels) for name, one in part.channels.items()} for part in parts}


def read_exr_attributes(path: Path) -> dict[str, Any]:
    """Header of the first part: attribute name -> value."""
    import OpenEXR

    return dict(OpenEXR.File(str(path), separate_channels=True, header_only=True).parts[0].header)


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


def frame_parts(labelled: LabelledFrame) -> dict[str, Layers]:
    """Part -> channel -> (H, W) array, float32 or uint32, as the table above has them."""
    surface, labels = labelled.frame.surface, labelled.pixels
    first = {
        **radiance_channels(labelled.frame.radiance),
        "depth": layer("Z", surface.depth_m) | layer("distance", surface.distance_m),
    }
    numbers: Layers = {"plant_id": labels.instance, "part": labels.part, "semantic": labels.semantic}
    last = {"identity": {key: one for name, values in numbers.items() for key, one in layer(name, values).items()}}
    for one in LABEL_CHANNELS.load_all(labelled.channels):
        for part, found in one.parts(labelled).items():
            into = last if one.of_all_samples or part in last else first
            into[part] = into.get(part, {}) | found
    return {name: found for name, found in {**first, **last}.items() if found}


def radiance_channels(radiance: Radiance) -> dict[str, dict[str, NDArray[Any]]]:
    """Part -> channel -> (H, W)."""
    parts = {"radiance": radiance.mean, _BIASED: radiance.denoised, "radiance.variance": radiance.variance}
    return {
        part: {n: np.ascontiguousarray(values[..., k], dtype=np.float32) for k, n in enumerate(radiance.channels)}
        for part, values in parts.items()
        if values is not None
    }


def light_attributes(radiance: Radiance, units: Mapping[str, str | None]) -> dict[str, str]:
    """Attributes of all parts' headers, which go under ``forestgen/``: units, colour or bands, bias.

    `units` are those of each part of the file that is neither radiance nor depth; None: it has none.
    """
    unit = BAND_UNIT if radiance.bands else COLOUR_UNIT
    own = {"radiance": unit, _BIASED: unit, "radiance.variance": f"({unit.partition(',')[0]})^2", "depth": "m"}
    attributes = {f"units.{part}": found for part, one in units.items() if (found := own.get(part, one)) is not None}
    attributes |= {"samples": str(radiance.samples), "picture": picture_light(radiance)[1]}
    if radiance.replicates:
        attributes["replicates"] = str(radiance.replicates)
    if math.isfinite(radiance.relative_error):
        attributes["relative_error"] = f"{radiance.relative_error:.6g}"
        attributes["relative_error_p95"] = f"{radiance.relative_error_p95:.6g}"
        attributes["stopped_by"] = radiance.stopped_by
    if radiance.bands:
        attributes["bands"] = json.dumps(band_figures(radiance.channels, radiance.bands))
    else:
        attributes["colour_space"] = "linear Rec. 709 (D65)"
    if radiance.open_irradiance:
        values = dict(zip(radiance.channels, radiance.open_irradiance, strict=True))
        attributes["open_irradiance"] = json.dumps(values)
    if radiance.denoised is not None:
        attributes["biased"] = _BIASED
    return attributes


def own_attributes(radiance: Radiance) -> Mapping[str, Mapping[str, Any]]:
    """Attributes of single parts: part -> name -> value.

    OpenEXR's ``whiteLuminance`` is the luminance in cd/m² of the RGB value (1, 1, 1).
    """
    white = {} if radiance.bands else {"whiteLuminance": 1.0}
    biased = {"forestgen/biased": "denoised: not the mean of samples, and radiance.variance is not its error"}
    return {"radiance": white, _BIASED: {**white, **biased}}
