"""Reflectance of periodic stands of one species seen from above, and of measured forests in the same bands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from forestgen.core.progress import Silent, Timings
from forestgen.core.spectrum import Spectrum
from forestgen.render.frame import RenderJob, StoppingCriterion
from forestgen.render.rendering import render_radiance
from support.stand_structure import STANDS, grown

BANDS = ("B3", "B4", "B5", "B8", "B11")
Range = tuple[float, float]

# AVIRIS over plots of NASA's Forest Functional Types programme, midsummer 2008 to 2010, corrected for the atmosphere
# (Singh et al. 2015, Ecological Applications 25, 2180-2197; github.com/ashiklom/edr-da, aviris/NASA_FFT), averaged over
# the half-widths of Sentinel-2A's bands: 5th to 95th percentile of the images with NDVI above 0.7 of plots where at
# least three quarters of the sampled leaves were pine (21 images, 15 plots), spruce or fir (8, 4), or maple, beech or
# basswood (12, 9). Widened to stands of Hyytiälä, Finland, with their measured trees, needles, leaves and forest floor
# (seven of pine and spruce, two of birch), by the forest reflectance model FRT (Kuusk and Nilson 2000, Remote Sensing
# of Environment 72, 244-252; github.com/mottus/f_art_python, test_forests), the sun 30 degrees from the zenith.
_RANGES = {
    "pine": ((0.028, 0.055), (0.014, 0.043), (0.048, 0.110), (0.20, 0.37), (0.084, 0.186)),
    "spruce": ((0.020, 0.057), (0.011, 0.029), (0.037, 0.092), (0.18, 0.50), (0.070, 0.155)),
    "birch": ((0.032, 0.062), (0.014, 0.033), (0.057, 0.113), (0.37, 0.55), (0.148, 0.204)),
    "beech": ((0.032, 0.062), (0.013, 0.030), (0.057, 0.113), (0.40, 0.55), (0.148, 0.204)),
}
MEASURED: Mapping[str, Mapping[str, Range]] = {
    name: dict(zip(BANDS, ranges, strict=True)) for name, ranges in _RANGES.items()
}


# Floor of mesic forests in Hyytiälä, reflectance by wavelength in nm: shrubs, herbs, mosses. Forsström et al. 2021
# (doi:10.17632/2g9nkcdj53.1) and Hovi et al. 2024 (doi:10.23729/9a8d90cd-73e2-438d-9230-94e10e61adc9), the mean of the
# sites of fertility class MT in github.com/mottus/f_art_python. Beech stands on their litter.
_FLOOR = (
    (400, 0.020),
    (450, 0.028),
    (520, 0.057),
    (560, 0.083),
    (600, 0.070),
    (650, 0.063),
    (680, 0.062),
    (697, 0.109),
    (704, 0.147),
    (712, 0.191),
    (740, 0.308),
    (780, 0.341),
    (835, 0.366),
    (900, 0.390),
    (1560, 0.245),
    (1610, 0.280),
    (1660, 0.300),
)
GREEN_FLOOR = ("spruce", "pine", "birch")


@dataclass(frozen=True)
class Reflectance:
    """Of a stand, seen straight down."""

    factor: dict[str, float]  # by band: bidirectional reflectance factor under sun and sky
    error: dict[str, float]  # standard error


def measure(name: str, samples: int = 64) -> Reflectance:
    """A stand's reflectance with the sun 30 degrees from the zenith."""
    scene = grown(STANDS[name])
    spec, terrain = scene.spec, scene.spec.terrain
    if name in GREEN_FLOOR:
        wavelength_nm, reflectance = np.array(_FLOOR, dtype=np.float64).T
        even = np.ones_like(terrain.texture) * np.array(terrain.mean_colour, dtype=np.float32)
        terrain = replace(terrain, mixture=None, texture=even, spectrum=Spectrum(wavelength_nm, reflectance))
    spec = replace(spec, terrain=replace(terrain, far_share=np.zeros_like(terrain.far_share)))
    camera = spec.cameras[0]
    camera = replace(camera, bands=tuple(band for band in camera.bands if band.name in BANDS))
    job = RenderJob(spec=spec, camera=camera, until=StoppingCriterion(samples), seed=5)
    radiance = render_radiance(job, progress=Silent(), timer=Timings())
    scale = np.pi / np.array(radiance.open_irradiance)
    mean = radiance.mean.mean(axis=(0, 1)) * scale
    error = np.sqrt(radiance.variance.mean(axis=(0, 1)) / radiance.mean[..., 0].size) * scale
    return Reflectance(
        dict(zip(radiance.channels, mean.tolist(), strict=True)),
        dict(zip(radiance.channels, error.tolist(), strict=True)),
    )
