"""A camera's exposure and its sensor, for raw images beside the linear ones; dataset/raw.py applies them.

Photographic relations (ISO 2720, ISO 12232), with f-number N, time t, luminance L, speed S:

    exposure value   2^EV = N² / t at ISO 100;        N² / t = 2^EV S / 100 at another
    a meter sets     N² / t = L S / K,  K = 12.5 cd s/m²/lx
"""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from forestgen.recipe.fields import Flag, Fraction, NonNegative, Number, Positive, Section, Whole, mistake

_METER_CONSTANT = 12.5  # K of ISO 2720 for reflected light, as most makers set it


class Exposure(Section):
    """Lens and sensor that make a raw image. Without shutter_s and ev the picture is metered."""

    f_number: Annotated[Positive, Field(ge=0.5, le=128, description="Focal length by the pupil's diameter.")] = 8.0
    shutter_s: Annotated[
        Positive | None, Field(ge=1e-7, le=86400, description="Exposure time, seconds. Default: by ev, or metered.")
    ] = None
    ev: Annotated[
        Number | None,
        Field(
            ge=-10,
            le=25,
            description="Exposure value at ISO 100, log2(f_number² / shutter_s): full sun 15, overcast 12; sets the "
            "shutter, longer for a lower iso.",
        ),
    ] = None
    compensation_ev: Annotated[
        Number, Field(ge=-10, le=10, description="Stops by which a metered exposure is brighter.")
    ] = 0.0
    iso: Annotated[Positive, Field(ge=1, le=1e7, description="Sensitivity by saturation, ISO 12232.")] = 100.0
    base_iso: Annotated[
        Positive, Field(ge=1, le=1e7, description="The iso at which saturation fills the well; the least one.")
    ] = 100.0
    vignetting: Annotated[
        Fraction, Field(description="0: none; 1: the fourth power of the cosine off the axis; between: mixed.")
    ] = 0.0
    full_well_electrons: Annotated[Positive, Field(ge=10, le=1e8, description="That a pixel holds.")] = 30_000.0
    read_noise_electrons: Annotated[
        NonNegative, Field(le=1e5, description="Standard deviation of what reading a pixel adds.")
    ] = 3.0
    bits: Annotated[Whole, Field(ge=8, le=16, description="Of a digital number.")] = 14
    mosaic: Annotated[Flag, Field(description="Whether each pixel sees one colour only, in squares of RGGB.")] = True

    @model_validator(mode="after")
    def _one_way_to_expose(self) -> Self:
        if self.shutter_s is not None and self.ev is not None:
            raise mistake(
                "shutter_s or ev, not both",
                problem="the exposure is given twice",
                got=f"shutter_s {self.shutter_s:g} and ev {self.ev:g}",
                hint="leave one out; without both the picture is metered",
                at=("ev",),
            )
        if self.compensation_ev and (self.shutter_s is not None or self.ev is not None):
            raise mistake(
                "0, or neither shutter_s nor ev",
                problem="only a metered exposure is compensated",
                got=f"{self.compensation_ev:g}",
                at=("compensation_ev",),
            )
        if self.iso < self.base_iso:
            raise mistake(
                f"base_iso or more: {self.base_iso:g}",
                problem="the well is full before such an iso saturates",
                got=f"{self.iso:g}",
                hint="lower base_iso with it for a sensor of less sensitivity",
                at=("iso",),
            )
        return self

    def shutter_for_s(self, luminance_cd_m2: float) -> float:
        """Time that is set, or that a meter pointed at this mean luminance sets; 1 s in the dark."""
        if self.shutter_s is not None:
            return self.shutter_s
        if self.ev is not None:
            return float(self.f_number**2 / (2.0**self.ev * self.iso / 100.0))
        if not luminance_cd_m2 > 0:
            return 1.0
        metered_s = _METER_CONSTANT * self.f_number**2 / (luminance_cd_m2 * self.iso)
        return float(metered_s * 2.0**self.compensation_ev)
