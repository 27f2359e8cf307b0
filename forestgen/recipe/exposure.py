"""The key `exposure` of a recipe's cameras: lens, sensor and picture of a raw image; see dataset/raw.py."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from forestgen.recipe.fields import Flag, Fraction, NonNegative, Number, Positive, Section, Whole, violation

_METER_CONSTANT = 12.5  # K of ISO 2720 in cd s/m²/lx for reflected light, as most makers set it
Aberration = Annotated[Number, Field(ge=-0.05, le=0.05)]


class Jpeg(Section):
    """A camera's own picture of its raw image, photo.jpg, 4:2:0."""

    quality: Whole = Field(90, ge=1, le=100, description="Of the compression.")
    white_balance: Literal["auto", "daylight"] = Field(
        "auto", description="auto: by the picture's greys, 4000 to 10,000 K; daylight: white is that of D65."
    )
    contrast: Positive = Field(
        1.5, ge=0.5, le=3, description="Slope of the curve in the shadows, of logarithms; 1.5 is usual."
    )
    saturation: NonNegative = Field(
        1.0, le=3, description="Of colours, by those that a colour chart is seen in; 0: a grey picture."
    )
    sharpening: NonNegative = Field(
        0.0, le=3, description="Share of a pixel's difference from the mean about it that is added: an unsharp mask."
    )


class Exposure(Section):
    """Lens and sensor that make a raw image. Without shutter_s and ev the picture is metered."""

    f_number: Positive = Field(8.0, ge=0.5, le=128, description="Focal length by the pupil's diameter.")
    shutter_s: Positive | None = Field(
        None, ge=1e-7, le=86400, description="Exposure time, seconds. Default: by ev, or metered."
    )
    ev: Number | None = Field(
        None,
        ge=-10,
        le=25,
        description="Exposure value at ISO 100, log2(f_number² / shutter_s): full sun 15, overcast 12; sets the "
        "shutter, longer for a lower iso.",
    )
    compensation_ev: Number = Field(0.0, ge=-10, le=10, description="Stops by which a metered exposure is brighter.")
    iso: Positive = Field(100.0, ge=1, le=1e7, description="Sensitivity by saturation, ISO 12232.")
    base_iso: Positive = Field(
        100.0, ge=1, le=1e7, description="The iso at which saturation fills the well; the least one."
    )
    vignetting: Fraction = Field(
        0.0,
        description="0: none; 1: the fourth power of the cosine off the axis; between: mixed; of perspective.",
    )
    falloff: Annotated[tuple[Annotated[Number, Field(ge=-10, le=10)], ...], Field(max_length=3)] = Field(
        (),
        description="Of any projection: k1, k2, k3 of 1 + k1 r² + k2 r⁴ + k3 r⁶, the light that arrives; r is 1 in the "
        "image's corners.",
    )
    chromatic_aberration: tuple[Aberration, Aberration] = Field(
        (0.0, 0.0),
        description="By how much the images of red and of blue are larger than that of green, shares: [0.0003, "
        "-0.0003]; of sensors of three colours.",
    )
    blur_px: NonNegative = Field(
        0.0, le=20, description="Standard deviation of the blur of lens and sensor, pixels: 0.3 to 0.7 of sharp ones."
    )
    veiling_glare: Number = Field(
        0.0, ge=0, le=0.3, description="Share of the light that the lens spreads widely over the image: 0.01 to 0.05."
    )
    ghosts: Literal["coated", "uncoated"] | None = Field(
        None,
        description="Of perspective: images of the stop that the surfaces of a double Gauss make of the sun, faint "
        "ones if coated, about 200 times as bright ones if not, as before 1940. None: none.",
    )
    full_well_electrons: Positive = Field(30_000.0, ge=10, le=1e8, description="That a pixel holds.")
    read_noise_electrons: NonNegative = Field(
        3.0, le=1e5, description="Standard deviation of what reading a pixel adds."
    )
    bits: Whole = Field(14, ge=8, le=16, description="Of a digital number.")
    mosaic: Flag = Field(True, description="Whether each pixel sees one colour only, in squares of RGGB.")
    jpeg: Jpeg | None = Field(
        None, description="The camera's own picture, photo.jpg, of a sensor of three colours. None: no such."
    )

    @model_validator(mode="after")
    def _one_way_to_expose(self) -> Self:
        metered = self.shutter_s is None and self.ev is None
        if self.shutter_s is not None and self.ev is not None:
            problem, got = "the exposure is given twice", f"shutter_s {self.shutter_s:g} and ev {self.ev:g}"
            hint = "leave one out; without both the picture is metered"
            raise violation("shutter_s or ev, not both", problem=problem, got=got, hint=hint, at="ev")
        if self.compensation_ev and not metered:
            problem, got = "only a metered exposure is compensated", f"{self.compensation_ev:g}"
            raise violation("0, or neither shutter_s nor ev", problem=problem, got=got, at="compensation_ev")
        if self.iso < self.base_iso:
            problem, expected = "the well is full before such an iso saturates", f"base_iso or more: {self.base_iso:g}"
            hint = "lower base_iso with it for a sensor of less sensitivity"
            raise violation(expected, problem=problem, got=f"{self.iso:g}", hint=hint, at="iso")
        return self

    def shutter_for_s(self, luminance_cd_m2: float) -> float:
        """Time that is set, or that a meter pointed at this mean luminance sets; 1 s in the dark.

        Photographic relations (ISO 2720, ISO 12232), with f-number N, time t, luminance L, speed S: at ISO 100 the
        exposure value is 2^EV = N² / t, at another N² / t = 2^EV S / 100; a meter sets N² / t = L S / K.
        """
        if self.shutter_s is not None:
            return self.shutter_s
        if self.ev is not None:
            return float(self.f_number**2 / (2.0**self.ev * self.iso / 100.0))
        if not luminance_cd_m2 > 0:
            return 1.0
        metered_s = _METER_CONSTANT * self.f_number**2 / (luminance_cd_m2 * self.iso)
        return float(metered_s * 2.0**self.compensation_ev)
