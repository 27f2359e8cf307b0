"""A camera's exposure and its sensor, for raw-like images beside the linear truth; dataset/raw.py applies them.

Photographic relations (ISO 2720, ISO 12232), with f-number N, time t, luminance L, speed S:

    exposure value   2^EV = N² / t at ISO 100;        N² / t = 2^EV S / 100 at another
    a meter sets     N² / t = L S / K,  K = 12.5 cd s/m²/lx
"""

from __future__ import annotations

from dataclasses import dataclass

from forestgen.recipe.camera_keys import Exposure as ExposureSection

METER_CONSTANT = 12.5  # K of ISO 2720 for reflected light, as most makers set it


@dataclass(frozen=True)
class Exposure:
    """What turns light into digital numbers."""

    f_number: float
    shutter_s: float | None  # None: metered in the image
    iso: float
    vignetting: float = 0.0  # 0: none, 1: falls as the fourth power of the cosine off the axis; between: mixed
    full_well_electrons: float = 30_000.0  # at saturation at `base_iso`
    read_noise_electrons: float = 3.0
    bits: int = 14
    mosaic: bool = True  # one colour a pixel, RGGB
    base_iso: float = 100.0  # up to which sensitivity is the sensor's own; beyond it the signal is amplified
    compensation_ev: float = 0.0  # stops by which a metered exposure is brighter

    def shutter_for_s(self, luminance_cd_m2: float) -> float:
        """Time that is set, or that a meter pointed at this mean luminance sets; 1 s in the dark."""
        if self.shutter_s is not None:
            return self.shutter_s
        if not luminance_cd_m2 > 0:
            return 1.0
        metered_s = METER_CONSTANT * self.f_number**2 / (luminance_cd_m2 * self.iso)
        return float(metered_s * 2.0**self.compensation_ev)


def exposure_of(section: ExposureSection | None) -> Exposure | None:
    """What a recipe's section says; None for none."""
    if section is None:
        return None
    shutter_s = section.shutter_s
    if section.ev is not None:
        shutter_s = shutter_of_ev_s(section.ev, section.f_number, section.iso)
    return Exposure(
        f_number=section.f_number,
        shutter_s=shutter_s,
        iso=section.iso,
        vignetting=section.vignetting,
        full_well_electrons=section.full_well_electrons,
        read_noise_electrons=section.read_noise_electrons,
        bits=section.bits,
        mosaic=section.mosaic,
        base_iso=section.base_iso,
        compensation_ev=section.compensation_ev,
    )


def shutter_of_ev_s(ev: float, f_number: float, iso: float) -> float:
    """Time of an exposure value, which counts at ISO 100."""
    return float(f_number**2 / (2.0**ev * iso / 100.0))
