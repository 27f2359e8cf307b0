"""Radiance in frame.exr: its parts, and what their headers say of it."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.dataset.bands import band_figures
from forestgen.dataset.tonemap import picture_light
from forestgen.render.frame import Radiance

COLOUR_UNIT = "cd/m2, linear Rec. 709 (D65)"
BAND_UNIT = "W m-2 sr-1 nm-1"
_BIASED = "radiance.denoised"


def radiance_channels(radiance: Radiance) -> dict[str, dict[str, NDArray[Any]]]:
    """Part -> channel -> (H, W)."""
    parts = {
        "radiance": radiance.mean,
        "radiance.denoised": radiance.denoised,
        "radiance.variance": radiance.variance,
    }
    return {
        part: {n: np.ascontiguousarray(values[..., k], dtype=np.float32) for k, n in enumerate(radiance.channels)}
        for part, values in parts.items()
        if values is not None
    }


def light_attributes(radiance: Radiance, units: Mapping[str, str | None]) -> dict[str, str]:
    """Attributes of all parts' headers, which go under ``forestgen/``: units, colour or bands, bias.

    Parameters
    ----------
    units : of each part of the file that is neither radiance nor depth; None: it has none.
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
