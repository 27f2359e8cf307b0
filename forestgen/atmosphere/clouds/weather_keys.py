"""Keys of simulated weather: air at rest, what the ground gives off, the box of air, and chapters of a story.

All may be left out, and are then those of the type; see `forestgen.atmosphere.clouds.simulated`.
"""

from __future__ import annotations

from typing import Annotated, Any, Self

from pydantic import Field, field_validator, model_validator

from forestgen.core.errors import RecipeError
from forestgen.recipe.fields import Fraction, GivenSection, NonNegative, Number, Positive, Text, mistake, spelled_out
from forestgen.recipe.registries import CLOUD_SOURCES
from forestgen.recipe.sky import FileName, NamedFile, Sha256

_OF_TYPE = " Default: the type's."


class SoundingSection(GivenSection):
    """Air at rest by height: a file, or a mixed layer, a layer above it and an inversion."""

    file: Annotated[
        FileName | None,
        Field(description="CSV file of heights, temperature and humidity, relative to the recipe's folder."),
    ] = None
    sha256: Annotated[
        Sha256 | None,
        Field(description="SHA-256 of the file, written when the recipe is loaded; another file is refused."),
    ] = None
    ground_temperature_c: Annotated[
        Number | None, Field(ge=-60, le=60, description="Of the air at the ground, degrees Celsius." + _OF_TYPE)
    ] = None
    ground_pressure_hpa: Annotated[
        Number | None,
        Field(ge=400, le=1100, description="At the ground, hPa; also beside a file. Default: 1013.25."),
    ] = None
    mixed_layer_m: Annotated[
        NonNegative | None,
        Field(
            le=20000,
            description="Depth of the air next to the ground that is stirred through: it cools upwards by 9.8 K/km, "
            "and its vapour is the same at all heights. Metres." + _OF_TYPE,
        ),
    ] = None
    lapse_rate_k_per_km: Annotated[
        Number | None,
        Field(
            ge=-300,
            le=30,
            description="How fast it cools upwards from there to the inversion, K/km; negative: it gets warmer."
            + _OF_TYPE,
        ),
    ] = None
    inversion_m: Annotated[
        Positive | None, Field(le=30000, description="Height of the inversion, metres." + _OF_TYPE)
    ] = None
    inversion_jump_k: Annotated[
        NonNegative | None,
        Field(le=40, description="How much warmer it becomes across the inversion itself, K." + _OF_TYPE),
    ] = None
    lapse_rate_above_k_per_km: Annotated[
        Number | None, Field(ge=-300, le=30, description="How fast it cools upwards above it, K/km." + _OF_TYPE)
    ] = None
    relative_humidity: Annotated[
        Fraction | None, Field(description="At the ground, 0 to 1, over water." + _OF_TYPE)
    ] = None
    relative_humidity_aloft: Annotated[
        Fraction | None,
        Field(description="Just below the inversion, 0 to 1; linear between it and the mixed layer's top." + _OF_TYPE),
    ] = None
    relative_humidity_above: Annotated[
        Fraction | None, Field(description="Above the inversion, 0 to 1." + _OF_TYPE)
    ] = None

    @model_validator(mode="after")
    def _file_or_numbers(self) -> Self:
        of_files = {"file", "sha256", "ground_pressure_hpa"}  # a table has no pressure
        given = [key for key in self.model_fields_set - of_files if getattr(self, key) is not None]
        if self.file is not None and given:
            raise mistake(
                "a file, or numbers",
                problem="the sounding is given twice",
                got=f"file and {', '.join(sorted(given))}",
                hint="leave out one of them",
                at=("file",),
            )
        return self


class EmissionSection(GivenSection):
    """What the ground gives to the air."""

    heat_w_per_m2: Annotated[
        Number | None, Field(ge=-500, le=5000, description="Mean flux of sensible heat, W/m2." + _OF_TYPE)
    ] = None
    latent_w_per_m2: Annotated[
        Number | None, Field(ge=-100, le=5000, description="Mean flux of vapour as latent heat, W/m2." + _OF_TYPE)
    ] = None
    vapour_g_per_m2_s: Annotated[
        Number | None,
        Field(ge=-0.05, le=2, description="The same as mass: 0.1 g/m2/s is 250 W/m2. Instead of latent_w_per_m2."),
    ] = None
    patch_m: Annotated[
        Positive | None, Field(le=100000, description="Size of warm and moist patches, metres." + _OF_TYPE)
    ] = None
    contrast: Annotated[
        NonNegative | None,
        Field(le=10, description="How much patches differ: standard deviation over mean." + _OF_TYPE),
    ] = None
    map: Annotated[
        NamedFile | None,
        Field(
            description="A grey picture (or .npy array) of the emission over the domain, north up, whose mean is made "
            "1; instead of patches of noise. The domain is where the simulation is, not the site."
        ),
    ] = None

    @field_validator("map", mode="before")
    @classmethod
    def _named(cls, value: Any) -> Any:
        return spelled_out(value, "file")

    @model_validator(mode="after")
    def _vapour_once(self) -> Self:
        for one, other in (("latent_w_per_m2", "vapour_g_per_m2_s"), ("map", "patch_m"), ("map", "contrast")):
            if getattr(self, one) is not None and getattr(self, other) is not None:
                raise mistake(f"{one} or {other}", problem="given twice", got=f"{one}, {other}", at=(other,))
        return self


class DomainSection(GivenSection):
    """The box of air that is simulated; at its sides it goes on periodically."""

    extent_m: Annotated[
        Positive | None, Field(ge=100, le=200000, description="Side of its square, metres." + _OF_TYPE)
    ] = None
    height_m: Annotated[Positive | None, Field(ge=20, le=25000, description="Its height, metres." + _OF_TYPE)] = None
    cell_m: Annotated[Positive | None, Field(ge=0.5, le=5000, description="Width of a cell, metres." + _OF_TYPE)] = None
    cell_height_m: Annotated[
        Positive | None, Field(ge=0.5, le=2000, description="Height of a cell, metres." + _OF_TYPE)
    ] = None


class WeatherKeys(GivenSection):
    """What makes one kind of weather another."""

    sounding: Annotated[
        SoundingSection | None, Field(description="The air at rest: a file's name, or its keys." + _OF_TYPE)
    ] = None
    emission: Annotated[EmissionSection | None, Field(description="What the ground gives off." + _OF_TYPE)] = None
    domain: Annotated[DomainSection | None, Field(description="The box that is simulated." + _OF_TYPE)] = None
    cooling_k_per_h: Annotated[
        Number | None,
        Field(
            ge=-10,
            le=10,
            description="How fast the air below the inversion radiates its heat away, K/h." + _OF_TYPE,
        ),
    ] = None
    wind_m_per_s: Annotated[
        NonNegative | None, Field(le=100, description="Speed of the wind aloft, m/s." + _OF_TYPE)
    ] = None
    wind_from_deg: Annotated[
        Number | None,
        Field(
            ge=-360,
            le=360,
            description="Where it comes from, degrees clockwise from north: 270 is west. Default: site.wind_from_deg.",
        ),
    ] = None

    @field_validator("sounding", mode="before")
    @classmethod
    def _file_alone(cls, value: Any) -> Any:
        return spelled_out(value, "file")


class Chapter(WeatherKeys):
    """The weather from one moment of a story on, until the next chapter."""

    at_s: Annotated[NonNegative, Field(le=1e6, description="When it begins, seconds after the story does.")]
    type: Annotated[Text, Field(description="The type whose values hold for all keys that are left out.")]
    change_s: Annotated[
        Positive | None,
        Field(le=1e6, description="How quickly the mean air becomes that of the new sounding, seconds. Default 1200."),
    ] = None

    @field_validator("type")
    @classmethod
    def _is_simulated(cls, value: str) -> str:
        try:
            if hasattr(CLOUD_SOURCES.load(value), "conditions"):
                return value
        except RecipeError:
            pass
        simulated = [name for name, part in CLOUD_SOURCES.parts() if hasattr(part, "conditions")]
        raise mistake("one of " + ", ".join(simulated), problem="no simulated weather is called so", got=value)
