"""A camera's exposure and its sensor, for raw images beside the linear ones: see dataset/raw.py for the equations."""

from __future__ import annotations

from typing import Self

from pydantic import Field, model_validator

from forestgen.recipe.fields import Flag, Fraction, NonNegative, Number, Positive, Section, Whole, mistake


class Exposure(Section):
    """Lens and sensor that make a raw image. Without shutter_s and ev the picture is metered."""

    f_number: Positive = Field(default=8.0, ge=0.5, le=128, description="Focal length by the pupil's diameter.")
    shutter_s: Positive | None = Field(
        default=None, ge=1e-7, le=86400, description="Exposure time, seconds. Default: by ev, or metered."
    )
    ev: Number | None = Field(
        default=None,
        ge=-10,
        le=25,
        description="Exposure value at ISO 100, log2(f_number² / shutter_s): full sun 15, overcast 12; sets the "
        "shutter, longer for a lower iso.",
    )
    compensation_ev: Number = Field(
        default=0.0, ge=-10, le=10, description="Stops by which a metered exposure is brighter."
    )
    iso: Positive = Field(default=100.0, ge=1, le=1e7, description="Sensitivity by saturation, ISO 12232.")
    base_iso: Positive = Field(
        default=100.0, ge=1, le=1e7, description="The iso at which saturation fills the well; the least one."
    )
    vignetting: Fraction = Field(
        default=0.0, description="0: none; 1: the fourth power of the cosine off the axis; between: mixed."
    )
    full_well_electrons: Positive = Field(default=30_000.0, ge=10, le=1e8, description="That a pixel holds.")
    read_noise_electrons: NonNegative = Field(
        default=3.0, le=1e5, description="Standard deviation of what reading a pixel adds."
    )
    bits: Whole = Field(default=14, ge=8, le=16, description="Of a digital number.")
    mosaic: Flag = Field(default=True, description="Whether each pixel sees one colour only, in squares of RGGB.")

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
