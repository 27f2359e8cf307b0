"""How the recipe's light is computed."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from forestgen.recipe.fields import Flag, Number, Section, Whole, mistake

_Error = Annotated[Number, Field(gt=0, le=10)]
_Samples = Annotated[Whole, Field(ge=1, le=65536)]


class Render(Section):
    """How the radiance is computed.

    Without a target or a time budget an image has just its `samples`. With them, passes go on after the first `samples`
    until each target is met, the time is spent, or there are `most_samples`.
    """

    mode: Literal["rgb", "spectral"] = Field(
        default="rgb",
        description="rgb: light is computed in linear Rec. 709. spectral: at wavelengths from 360 to 830 nm, of which "
        "the colour is made. Cameras with bands are spectral in any case.",
    )
    samples: _Samples = Field(
        default=16,
        description="Light paths a pixel, over all passes. A spectral image has passes of three wavelengths: 4 for "
        "colour, 1 to 8 for most sensors of 1 to 13 bands. Each takes as many paths, at least one: samples are "
        "rounded up to a multiple of the passes, and need twice that for the variance to be known.",
    )
    target_error: _Error | None = Field(
        default=None,
        description="Goes on until the image's relative error is at most this: standard error over value, both over "
        "all channels and 3 x 3 pixels, the mean of all pixels. A pixel darker than a tenth of the image's mean is "
        "measured against that tenth.",
    )
    target_error_p95: _Error | None = Field(
        default=None, description="Goes on until the 95th percentile of the pixels' relative error is at most this."
    )
    time_budget_s: Annotated[Number, Field(gt=0, le=1e7)] | None = Field(
        default=None,
        description="Goes on for about so many seconds an image, building its scene not counted. The samples, and so "
        "the bytes of the image, then depend on the machine and on what else it does.",
    )
    most_samples: _Samples = Field(
        default=4096, description="Light paths a pixel at most, with a target or a time budget."
    )
    denoise: Flag = Field(default=True, description="Whether to remove the noise that remains.")
    clouds: Literal["auto", "farfield", "exact"] = Field(
        default="auto",
        description="How light goes through clouds. farfield: they are rendered once, and their light and shadow fall "
        "on the scene from afar. exact: their volume is traced with the scene. auto: farfield where clouds are far "
        "above the plants and cameras, otherwise exact.",
    )
    max_depth: Whole = Field(default=64, ge=1, le=4096, description="Most scatterings of a path.")

    @model_validator(mode="after")
    def _enough(self) -> Render:
        open_ended = (self.target_error, self.target_error_p95, self.time_budget_s) != (None, None, None)
        if open_ended and self.most_samples < self.samples:
            raise mistake(
                f"at least samples, {self.samples}",
                problem="fewer samples than it begins with",
                got=str(self.most_samples),
                hint="lower samples, or raise most_samples",
                at=("most_samples",),
            )
        return self
