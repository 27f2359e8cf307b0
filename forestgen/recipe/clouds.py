"""The recipe's clouds: simulated weather of a type, a field of noise, a saved field, or none.

The simulated types (fog, stratus, stratocumulus, cumulus, cumulonimbus) share one set of keys. A key that is left out
has the type's own value, from `forestgen.atmosphere.presets`.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Annotated, Any, Literal, Self

from pydantic import Field, SerializerFunctionWrapHandler, field_validator, model_serializer, model_validator

from forestgen.recipe.cloud_keys import NOISE, OF_COMMUNITY, OF_FILES, SIMULATED, Simulated, whose
from forestgen.recipe.fields import (
    Flag,
    Fraction,
    NonNegative,
    Number,
    Positive,
    Section,
    Text,
    Whole,
    mistake,
    spelled_out,
)

_OF_TYPE = " Default: the type's."
_FILE_NAME = Annotated[Text, Field(min_length=1, max_length=4000)]


class _Given(Section):
    """A section whose keys may all be left out; it is written down as it was given."""

    @model_serializer(mode="wrap")
    def _as_given(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {key: value for key, value in handler(self).items() if value is not None}


class NamedFile(_Given):
    """A file beside the recipe, known by its content."""

    file: Annotated[_FILE_NAME, Field(description="Its path, relative to the recipe's folder.")]
    sha256: Annotated[
        Annotated[Text, Field(pattern="^[0-9a-f]{64}$")] | None,
        Field(description="SHA-256 of its content, written when the recipe is loaded; another file is refused."),
    ] = None


class SoundingSection(_Given):
    """Air at rest by height: a file, or a mixed layer, a layer above it and an inversion."""

    file: Annotated[
        _FILE_NAME | None,
        Field(description="CSV file of heights, temperature and humidity, relative to the recipe's folder."),
    ] = None
    sha256: Annotated[
        Annotated[Text, Field(pattern="^[0-9a-f]{64}$")] | None,
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


class EmissionSection(_Given):
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


class DomainSection(_Given):
    """The box of air that is simulated; at its sides it goes on periodically."""

    extent_m: Annotated[
        Positive | None, Field(ge=100, le=200000, description="Side of its square, metres." + _OF_TYPE)
    ] = None
    height_m: Annotated[Positive | None, Field(ge=20, le=25000, description="Its height, metres." + _OF_TYPE)] = None
    cell_m: Annotated[Positive | None, Field(ge=0.5, le=5000, description="Width of a cell, metres." + _OF_TYPE)] = None
    cell_height_m: Annotated[
        Positive | None, Field(ge=0.5, le=2000, description="Height of a cell, metres." + _OF_TYPE)
    ] = None


class WeatherKeys(_Given):
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
    type: Annotated[Simulated, Field(description="The type whose values hold for all keys that are left out.")]
    change_s: Annotated[
        Positive | None,
        Field(le=1e6, description="How quickly the mean air becomes that of the new sounding, seconds. Default 1200."),
    ] = None


class Clouds(WeatherKeys):
    """The clouds above the site, or around it."""

    type: Annotated[
        Literal[Simulated, "community", "noise", "file", "none"],
        Field(
            description="fog, stratus, stratocumulus, cumulus, cumulonimbus: simulated. community: the air that the "
            "community simulates over itself. noise: a field of small cumulus without weather, made in a second. "
            "file: a saved field."
        ),
    ] = "none"
    time_s: Annotated[
        NonNegative | None,
        Field(
            le=1e6,
            description="When the picture is taken, seconds after the simulation begins. Default: the type's; of type "
            "community the end of the day's simulated hours.",
        ),
    ] = None
    seed: Annotated[
        Whole | None,
        Field(
            ge=0,
            lt=2**63,
            description="Of the simulation. Default: the recipe's, so that all images have one sky, simulated once.",
        ),
    ] = None
    droplet_radius_um: Annotated[
        Positive | None,
        Field(le=100, description="Effective radius of the cloud's droplets, micrometres." + _OF_TYPE),
    ] = None
    offset_m: Annotated[
        tuple[Number, Number] | None,
        Field(description="Where the middle of the clouds lies from the site's, metres east and north. Default 0, 0."),
    ] = None
    repeat: Annotated[
        Flag | None,
        Field(description="Whether the clouds go on beyond the box, over and over, to the horizon. Default: they do."),
    ] = None
    story: Annotated[
        tuple[Chapter, ...] | None,
        Field(
            min_length=1,
            max_length=50,
            description="Chapters of weather one after another, instead of one type; the type above is then left out "
            "or that of the first.",
        ),
    ] = None
    file: Annotated[
        NamedFile | None,
        Field(description="Of type file: a saved state of the air (.nc), or a volume of extinction per metre (.vol)."),
    ] = None
    day: Annotated[
        Whole | None,
        Field(
            ge=0,
            le=30,
            description="Of type community: which day of the month after the snapshot; the simulation sees those below "
            "its days_per_month. Default 0.",
        ),
    ] = None
    cell_m: Annotated[
        Positive | None,
        Field(
            ge=5,
            le=1000,
            description="Of type community: width of the air's cells, metres; other cells make another draw of the "
            "same air. Default: community.weather's.",
        ),
    ] = None
    cell_height_m: Annotated[
        Positive | None, Field(ge=5, le=500, description="Of type community: their height, metres. Default: as above.")
    ] = None
    cover: Annotated[
        Fraction | None, Field(description="Of noise: fraction of the sky's area under cloud, 0 to 1. Default 0.35.")
    ] = None
    base_m: Annotated[
        Positive | None, Field(le=20000, description="Of noise: height of the base above ground, metres. Default 900.")
    ] = None
    thickness_m: Annotated[
        Positive | None, Field(le=20000, description="Of noise: height of the layer, metres. Default 350.")
    ] = None
    extinction_per_m: Annotated[
        Positive | None, Field(le=1, description="Of noise: extinction inside a cloud, per metre. Default 0.05.")
    ] = None
    extent_m: Annotated[
        Positive | None, Field(le=20000, description="Of noise: side of the square of clouds, metres. Default 8000.")
    ] = None

    @property
    def simulated(self) -> bool:
        """Whether the air is simulated."""
        return self.type in SIMULATED

    @field_validator("file", mode="before")
    @classmethod
    def _named(cls, value: Any) -> Any:
        return spelled_out(value, "file")

    @model_validator(mode="before")
    @classmethod
    def _filled(cls, data: Any) -> Any:
        """The type of a story is its first chapter's; noise has its own defaults."""
        if not isinstance(data, Mapping):
            return data
        data = {key: value for key, value in data.items() if value is not None}
        story = data.get("story")
        if "type" not in data and isinstance(story, list | tuple) and story and isinstance(story[0], Mapping):
            data["type"] = story[0].get("type", "cumulus")
        return {**NOISE, **data} if data.get("type") == "noise" else data

    @model_validator(mode="after")
    def _keys_of_the_type(self) -> Self:
        if self.type == "none":  # a recipe that draws its type may say how clouds are where there are some
            return self
        others = {"noise": {*NOISE}, "file": {*OF_FILES}, "community": {*OF_COMMUNITY}}
        known = others[self.type] if self.type in others else self._of_simulation()
        for key in sorted(self.model_fields_set - known - {"type"}):
            if getattr(self, key) is not None:
                raise mistake(
                    "one of " + ", ".join(sorted(known)),
                    problem=f"clouds of type {self.type} have no {key}",
                    got=key,
                    hint=whose(key, self.type),
                    at=(key,),
                )
        if self.type == "file":
            self._check_file()
        return self

    def _check_file(self) -> None:
        if self.file is None:
            raise mistake("file: sky.nc", problem="no file is named", got="type: file", at=("type",))
        if not self.file.file.lower().endswith((".nc", ".vol")):
            raise mistake(
                "a state of the air, NAME.nc, or a volume of extinction, NAME.vol",
                problem="this file holds no sky",
                got=self.file.file,
                hint="forestgen weather RECIPE -o sky.nc writes one",
                at=("file",),
            )

    @staticmethod
    def _of_simulation() -> set[str]:
        return {*WeatherKeys.model_fields, "time_s", "seed", "droplet_radius_um", "offset_m", "repeat", "story"}

    @model_validator(mode="after")
    def _story_in_order(self) -> Self:
        if self.story is None or self.type == "none":
            return self
        twice = [key for key in WeatherKeys.model_fields if getattr(self, key) is not None]
        if twice:
            hint = f"move {twice[0]} into the chapters"
            problem = "the weather is given twice, beside the story and in it"
            raise mistake("a story, or its keys", problem=problem, got=", ".join(twice), hint=hint, at=(twice[0],))
        if self.type != self.story[0].type:
            problem = "the story begins with another type"
            raise mistake(self.story[0].type, problem=problem, got=self.type, hint="leave out type", at=("type",))
        if self.story[0].at_s != 0:
            raise mistake("at_s: 0", problem="the story begins late", got=f"{self.story[0].at_s:g}", at=("story", 0))
        for index, (one, other) in enumerate(pairwise(self.story), start=1):
            if other.at_s <= one.at_s:
                expected = f"more than {one.at_s:g} s, when the chapter before it begins"
                raise mistake(
                    expected, problem="chapters out of order", got=f"{other.at_s:g}", at=("story", index, "at_s")
                )
        return self
