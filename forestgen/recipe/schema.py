"""The recipe's schema: the keys of a drawn recipe, their units and defaults.

Distributions are drawn, shorthands expanded and species files merged before a recipe meets this schema
(`forestgen.recipe.load`); here every number is a number.
"""

from __future__ import annotations

import datetime
import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    SerializeAsAny,
    SerializerFunctionWrapHandler,
    field_validator,
    model_serializer,
    model_validator,
)

from forestgen.recipe import fields
from forestgen.recipe.cameras import Camera, check_cameras, check_motion, default_view
from forestgen.recipe.classes import MOST_CLASSES, NO_SPECIES, wrong_classes
from forestgen.recipe.dataset import Dataset
from forestgen.recipe.ground import Ground, WetSoil
from forestgen.recipe.land import MicroRelief, Paths, Waters, check_layers, check_on_site
from forestgen.recipe.phenology import LeafSeason, TimeOfYear
from forestgen.recipe.registries import DEFAULT_CHANNELS, LABEL_CHANNELS, TERRAINS
from forestgen.recipe.sampler import Sampling
from forestgen.recipe.sky import SkySection
from forestgen.recipe.species import Building, Species
from forestgen.recipe.weather import MOST_WEATHER, Weather, Wind

SCHEMA_VERSION = 1
MOST_LIBRARY = 1000  # plants of a size
Extent = Annotated[fields.Positive, Field(le=5000)]
_Error = Annotated[fields.Number, Field(gt=0, le=10)]
_Samples = Annotated[fields.Whole, Field(ge=1, le=65536)]


class Terrain(fields.PartSection, fields.GivenSection):
    """The ground's shape."""

    registry = TERRAINS
    selector = "kind"

    kind: fields.Text = Field("flat", description="Shape of the ground.")


class Surroundings(fields.Section):
    """What stands beyond the site's edge."""

    kind: Literal["open", "repeat", "forest"] = Field(
        "open",
        description="open: nothing, on bare ground: a plot in a clearing. repeat: copies of the site's plants, side by "
        "side: the endless stand of which the site is a period, for measurements and light. forest: the site's blocks "
        "in random order and turned, stems kept apart: no visible repetition, for pictures with a horizon. Far ones "
        "are simplified, of several heights, with clearings; statistics are the site's alone.",
    )
    labelled: fields.Flag = Field(
        True,
        description="Whether copies near the site have a plant_id and a row in the plants' table, marked there as "
        "outside. Others are background of the part surroundings.",
    )


class Site(fields.Section):
    """The piece of land: x from 0 to size_m[0] (east), y from 0 to size_m[1] (north)."""

    size_m: tuple[Extent, Extent] = Field((100.0, 100.0), description="Extent east (x) and north (y), metres.")
    terrain: Annotated[SerializeAsAny[Terrain], *fields.shorthand("kind")] = Field(
        default_factory=lambda: Terrain.model_validate({}), description="Shape of the ground, or just its kind."
    )
    ground: Annotated[Ground, *fields.shorthand("kind")] = Field(
        default_factory=lambda: Ground.model_validate({}), description="What covers it, or just its kind."
    )
    micro_relief: Annotated[MicroRelief | None, *fields.shorthand("rms_m", of=float)] = Field(
        None, description="Mounds and hollows, or just their standard deviation, metres. Default: none."
    )
    paths: Paths = Field((), description="Paths and forest roads; nothing stands on them.")
    water: Waters = Field((), description="Ponds and streams.")
    altitude_m: fields.Number = Field(
        0.0,
        ge=-430,
        le=9000,
        description="Height of z = 0 above sea level, metres; for species with a response to elevation_m, and for the "
        "light that comes through the air above.",
    )
    latitude_deg: fields.Number = Field(
        50.0,
        ge=-90,
        le=90,
        description="Latitude, degrees, north positive: where the sun stands over the year, for species with a "
        "response to sun, and for an image's own sun where sky.sun has a date.",
    )
    longitude_deg: fields.Number | None = Field(
        None, ge=-180, le=180, description="Longitude, degrees, east positive; for a sun by date and time."
    )
    date: fields.Text | None = Field(
        None,
        max_length=10,
        description="Day, YYYY-MM-DD, of the plants' phenology, at latitude_deg and altitude_m; with a sun by date, it "
        "is the sun's, and this is left out.",
    )
    wind_from_deg: fields.Number = Field(
        270.0,
        ge=-360,
        le=360,
        description="Where the prevailing wind comes from, degrees clockwise from north: 270 is west; for species with "
        "a response to wind, and for the wind that plants lean and sway in.",
    )
    buildings: tuple[SerializeAsAny[Building], ...] = Field(
        (), max_length=1000, description="What people have built there; for community models that know of buildings."
    )
    wet_soil: Annotated[WetSoil | None, *fields.shorthand("shown", of=bool)] = Field(
        None,
        description="How litter, dry soil, rock and sand darken where the community model has water in its soil; "
        "false: they do not. Default: they do.",
    )

    surroundings: Annotated[Surroundings, *fields.shorthand("kind")] = Field(
        Surroundings.model_validate({}), description="What stands beyond its edge, or just its kind."
    )

    @model_serializer(mode="wrap")
    def _without_what_few_need(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        found: dict[str, Any] = handler(self)
        apart = Surroundings.model_validate({}).model_dump()
        few = {"wet_soil": None, "buildings": (), "date": None, "surroundings": apart}
        few |= {"micro_relief": None, "paths": (), "water": ()}
        return {key: value for key, value in found.items() if key not in few or value not in (few[key], [])}

    @field_validator("date")
    @classmethod
    def _is_day(cls, value: str | None) -> str | None:
        try:
            known = value is None or datetime.date.fromisoformat(value) is not None
        except ValueError:
            known = False
        if not known:
            raise fields.violation("a day as 2026-10-15", problem="not a date", got=value)
        return value

    @model_validator(mode="after")
    def _land_lies_on_it(self) -> Self:
        check_on_site(self.water, self.paths, self.size_m)
        check_layers(self.ground.layers, self.water, self.paths)
        return self

    @model_validator(mode="after")
    def _buildings_stand_on_it(self) -> Self:
        width, depth = self.size_m
        for index, one in enumerate(self.buildings):
            corners = one.corners_m()
            low, high = (", ".join(f"{value:.1f}" for value in corner) for corner in (corners.min(0), corners.max(0)))
            if (corners < 0).any() or (corners > (width, depth)).any():
                x, y = one.position_m
                expected = f"all of its ground plan within x from 0 to {width:g} and y from 0 to {depth:g} metres"
                problem, got = "this building does not lie on the site", f"[{x:g}, {y:g}], from [{low}] to [{high}]"
                raise fields.violation(expected, problem=problem, got=got, at=("buildings", index, "position_m"))
        return self


class Community(fields.OpenSection):
    """The plants of the stand: a community model, and keys that the model checks itself."""

    model: fields.Text = Field(min_length=1, max_length=100, description="Id of the community model.")


#: A section of no plants, where a recipe's community does not matter.
NO_PLANTS: Mapping[str, Any] = {"model": "uniform", "plants": {}}


Channel = Annotated[fields.Text, *fields.part_name(LABEL_CHANNELS)]


class Plants(fields.Section):
    """What each plant looks like."""

    geometry: Literal["plants", "silhouettes"] = Field(
        "plants",
        description="plants: stems, branches and leaves. silhouettes: solids of revolution of the crowns' forms, for "
        "looking at a stand before its plants (Lane 2002, Figure 6.2).",
    )
    exemplars_per_species: fields.Whole = Field(
        10,
        ge=1,
        le=1000,
        description="Sizes modelled for each species: the centres of clusters of its plants' radii, or of its trees' "
        "sizes. Every plant is one of these, scaled to its exact height. Living and dead trees, and those above and "
        "below breast height, have one at least.",
    )
    variants_per_size: fields.Whole = Field(
        1,
        ge=1,
        le=100,
        description="Plants modelled for each size, of different seeds; a plant's own number decides which it is. Time "
        "and memory grow with it.",
    )
    library: fields.Whole | None = Field(
        None,
        ge=1,
        le=MOST_LIBRARY,
        description="Plants of each size that all images of a split share, for data sets of many images: sizes are on "
        "a fixed scale, and an image shows `variants_per_size` of them. null: every image grows its own plants. No "
        "two splits share a plant.",
    )
    traits: Annotated[tuple[fields.Text, ...], AfterValidator(fields.each_once)] = Field(
        (),
        max_length=20,
        description="What counts beside the radius when plants are grouped into sizes: age_yr, height_m, or a column "
        "of the community model's own. One standard deviation of a trait counts half as much as one of the radius' "
        "logarithm.",
    )
    unique: Literal["auto", "all", "none"] | Annotated[fields.Whole, Field(ge=0, le=100_000)] = Field(
        "auto",
        description="Which plants that grew as branch modules are modelled with their own branches: auto, those that "
        "are large in an image, as many as ten million triangles hold; all; none; or so many of the largest. The "
        "others are one of `exemplars_per_species` of these, scaled and turned.",
    )
    levels: fields.Flag = Field(
        False,
        description="Whether plants far from every camera show fewer, larger leaves and twigs, of the same area, "
        "chosen so that they stay below a pixel.",
    )
    near_foliage: fields.Flag = Field(True, description="Whether leaves that cover 2 x 2 pixels have their true size.")
    season: LeafSeason | None = Field(
        None,
        description="Of the leaves, their number, size and colour: spring, summer, autumn, winter, or dry, the dry "
        "season. null: of site.date or the sun's date; without one summer.",
    )
    phenology_classes: fields.Whole = Field(
        2,
        ge=1,
        le=5,
        description="Groups that a species' plants fall into during leaf-out and leaf fall, from early to late. Each "
        "needs plants modelled for it: time and memory grow with it, in those seasons alone.",
    )
    cache: fields.Flag = Field(
        True,
        description="Whether to keep the modelled plants on disk and take them from there when the same ones are asked "
        "for again; nothing else changes. FORESTGEN_CACHE names the folder.",
    )

    @model_validator(mode="after")
    def _library_suits(self) -> Self:
        if self.library is not None and self.library < self.variants_per_size:
            expected = f"at least variants_per_size = {self.variants_per_size}"
            problem = "the library has fewer plants of a size than an image shows"
            raise fields.violation(expected, problem=problem, got=str(self.library), at="library")
        if self.library is not None and self.traits:
            problem = "a library's plants are grouped by their size alone"
            hint = "leave out plants.traits, or plants.library"
            raise fields.violation("no traits", problem=problem, got=", ".join(self.traits), hint=hint, at="traits")
        return self


class Render(fields.Section):
    """How the radiance is computed.

    Without a target or a time budget an image has just its `samples`. With them, passes go on after the first `samples`
    until each target is met, the time is spent, or there are `most_samples`.
    """

    mode: Literal["rgb", "spectral"] = Field(
        "rgb",
        description="rgb: light is computed in linear Rec. 709. spectral: at wavelengths from 360 to 830 nm, of which "
        "the colour is made. Cameras with bands are spectral in any case.",
    )
    samples: _Samples = Field(
        16,
        description="Light paths a pixel, over all passes. A spectral image has passes of three wavelengths: 4 for "
        "colour, 1 to 8 for most sensors of 1 to 13 bands. Each takes as many paths, at least one: samples are "
        "rounded up to a multiple of the passes, and need twice that for the variance to be known.",
    )
    target_error: _Error | None = Field(
        None,
        description="Goes on until the image's relative error is at most this: standard error over value, both over "
        "all channels and 3 x 3 pixels, the mean of all pixels. A pixel darker than a tenth of the image's mean is "
        "measured against that tenth.",
    )
    target_error_p95: _Error | None = Field(
        None, description="Goes on until the 95th percentile of the pixels' relative error is at most this."
    )
    time_budget_s: Annotated[fields.Number, Field(gt=0, le=1e7)] | None = Field(
        None,
        description="Goes on for about so many seconds an image, building its scene not counted. The samples, and so "
        "the bytes of the image, then depend on the machine and on what else it does.",
    )
    most_samples: _Samples = Field(4096, description="Light paths a pixel at most, with a target or a time budget.")
    denoise: fields.Flag = Field(True, description="Whether to remove the noise that remains.")
    clouds: Literal["auto", "farfield", "exact"] = Field(
        "auto",
        description="How light goes through clouds. farfield: they are rendered once, and their light and shadow fall "
        "on the scene from afar. exact: their volume is traced with the scene. auto: farfield where clouds are far "
        "above the plants and cameras, otherwise exact.",
    )
    max_depth: fields.Whole = Field(64, ge=1, le=4096, description="Most scatterings of a path, fog's left out.")

    @model_validator(mode="after")
    def _enough(self) -> Self:
        open_ended = (self.target_error, self.target_error_p95, self.time_budget_s) != (None, None, None)
        if open_ended and self.most_samples < self.samples:
            expected, hint = f"at least samples, {self.samples}", "lower samples, or raise most_samples"
            problem, got = "fewer samples than it begins with", str(self.most_samples)
            raise fields.violation(expected, problem=problem, got=got, hint=hint, at="most_samples")
        return self


class Labels(fields.Section):
    """Which labels are made, and how."""

    samples: fields.Whole = Field(
        16, ge=1, le=1024, description="Identity samples a pixel, a square number: 1, 4, 9, 16, ..."
    )
    channels: Annotated[tuple[Channel, ...], AfterValidator(fields.each_once)] = Field(
        DEFAULT_CHANNELS,
        description="Labels besides the masks: coverage ranks, surface (position, normals), albedo, sun (shadows), "
        "cloud opacity, motion, occlusion boundaries, amodal masks; and module, not among those made by default: "
        "branch modules and their segments.",
    )
    classes: dict[fields.Label, tuple[fields.Name, ...]] | None = Field(
        None,
        max_length=MOST_CLASSES,
        description="Semantic classes: name -> the species and parts in it, a part before a species; `others` are the "
        "species that no class names. A name may have blanks. Default: each species is a class.",
    )

    @field_validator("samples")
    @classmethod
    def _is_square(cls, value: int) -> int:
        if math.isqrt(value) ** 2 != value:
            raise fields.violation("a square number: 1, 4, 9, 16, 25, ...")
        return value


def _is_same_stand(value: Any) -> Any:
    if isinstance(value, bool) or value == "by_split":
        return value
    hint = "this key may not be a distribution" if isinstance(value, Mapping) else None
    raise fields.violation("true, false or by_split", hint=hint)


class Recipe(fields.Section):
    """A drawn, complete recipe."""

    forestgen: Literal[1] = Field(description="Version of the recipe's schema.")
    seed: fields.Whole = Field(0, ge=0, lt=2**63, description="Root of all randomness; 0 is a seed.")
    images: fields.Whole = Field(1, ge=1, le=10**9, description="How many images, each drawn anew.")
    first_image: fields.Whole = Field(
        0, ge=0, le=10**12, description="Index of the first image; a stored drawn recipe keeps its own here."
    )
    same_stand: Annotated[fields.Flag | Literal["by_split"], BeforeValidator(_is_same_stand)] = Field(
        False,
        description="Whether all images show image 0's stand, or by_split, all images of a split the split's own; "
        "distributions are still drawn by image.",
    )
    site: Site = Field(default_factory=lambda: Site.model_validate({}), description="The piece of land.")
    species: dict[fields.Name, Species] = Field(min_length=1, max_length=1000, description="Species by name.")
    community: Community = Field(description="The plants of the stand: a community model and its own keys.")
    plants: Plants = Field(Plants.model_validate({}), description="How plants are modelled.")
    sky: SerializeAsAny[SkySection] = Field(
        default_factory=lambda: SkySection.model_validate({}), description="Everything above: sun, sky, clouds."
    )
    cameras: list[SerializeAsAny[Camera]] = Field(min_length=1, max_length=1000, description="Cameras, at least one.")
    render: Render = Field(Render.model_validate({}), description="The light's computation.")
    labels: Labels = Field(Labels.model_validate({}), description="The labels' computation.")
    wind: Wind = Field(Wind.model_validate({}), description="How plants lean and sway.")
    weather: tuple[SerializeAsAny[Weather], ...] = Field(
        (),
        max_length=MOST_WEATHER,
        description="What is in the air near the ground, and what it leaves on plants and ground. Default: nothing. "
        "`forestgen models --kind weather` lists the kinds.",
    )
    dataset: Dataset = Field(Dataset.model_validate({}), description="Files for training and measuring.")
    sampling: Sampling | None = Field(None, description="How draws are spread over the images, correlated and shared.")

    @model_validator(mode="before")
    @classmethod
    def _complete_cameras(cls, data: Any) -> Any:
        if not isinstance(data, Mapping):
            return data
        cameras = data.get("cameras", [{}])
        if not isinstance(cameras, list):
            return data
        size = fields.extent_m(data.get("site"))
        filled = [
            {"name": f"camera{i}", **camera, **default_view(camera, size)} if isinstance(camera, Mapping) else camera
            for i, camera in enumerate(cameras)
        ]
        return {**data, "cameras": filled}

    @property
    def labelled_names(self) -> tuple[str, ...]:
        """Names of what has instances: the species, and the kinds of buildings."""
        return (*self.species, *dict.fromkeys(one.kind for one in self.site.buildings))

    @property
    def time_of_year(self) -> TimeOfYear:
        """When the plants are shown: by the season's name, or by site.date or the sun's."""
        site, moment = self.site, self.sky.sun.moment
        date = moment if site.date is None else datetime.date.fromisoformat(site.date)
        named = self.plants.season or ("summer" if date is None else None)
        day = date.timetuple().tm_yday if date is not None else 0
        return TimeOfYear(named, day, site.latitude_deg, site.altitude_m)

    @field_validator("cameras")
    @classmethod
    def _names_differ(cls, cameras: list[Camera]) -> list[Camera]:
        check_cameras(cameras)
        return cameras

    @model_validator(mode="after")
    def _sections_fit(self) -> Self:
        given = {
            "latitude_deg": "latitude_deg" in self.site.model_fields_set,  # its default is not the site's place
            "longitude_deg": self.site.longitude_deg is not None,
        }
        missing = [key for key, known in given.items() if not known]
        if self.sky.sun.date is not None and missing:
            problem, got = "the sun by date needs a place on earth", "no " + " and no ".join(missing)
            hint = "site: {latitude_deg: 51.0, longitude_deg: 13.7} is Dresden"
            expected = "site.latitude_deg and site.longitude_deg, degrees"
            raise fields.violation(expected, problem=problem, got=got, hint=hint, at=("site", missing[0]))
        twice = "plants.season" if self.plants.season is not None else "sky.sun.date" if self.sky.sun.date else None
        if self.site.date is not None and twice is not None:
            problem, hint = "the time of the year is given twice", f"leave out site.date or {twice}"
            got = f"site.date and {twice}"
            raise fields.violation("one of them", problem=problem, got=got, hint=hint, at=("site", "date"))
        reserved = (*NO_SPECIES, *(one.kind for one in self.site.buildings))
        for name in self.species:
            if name.lower() in reserved:
                expected = f"another name than {', '.join(reserved)}"
                problem = "labels use this name for what is no plant"
                raise fields.violation(expected, problem=problem, got=name, at=("species", name))
        wrong = None if self.labels.classes is None else wrong_classes(self.labels.classes, self.labelled_names)
        if wrong is not None:
            raise wrong
        check_motion(self.cameras, plants_move=self.wind.speed_m_per_s > 0 and self.wind.gustiness > 0)
        return self
