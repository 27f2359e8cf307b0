"""A species: its ecology, its shape's scaling, its geometry's generator and its materials; and buildings.

One file a species, ``scenes/species/NAME.yaml``; a recipe's ``species`` section names the file and overrides its keys,
or holds the whole species itself. Under a shipped species' name the overrides do without ``from``. A kind of building
is a part: scene/buildings.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from forestgen.recipe.fields import (
    Colour,
    Coordinate,
    Flag,
    Fraction,
    GivenSection,
    Name,
    NonNegative,
    Number,
    OpenSection,
    PartSection,
    Positive,
    Section,
    Text,
    shorthand,
    violation,
)  # fmt: skip
from forestgen.recipe.phenology import Phenology
from forestgen.recipe.registries import BUILDINGS, DEFAULT_BUILDING
from forestgen.recipe.spectra import MOST_BYTES, Season
from forestgen.recipe.tree_sizes import TreeSizes
from forestgen.recipe.wood import Wood

TALLEST_M = 200.0
_Side = Annotated[Positive, Field(ge=0.5, le=200)]


class Ecology(Section):
    """How a species grows, competes and spreads."""

    growth_m_per_yr: NonNegative = Field(le=10, description="Growth of the radius, metres per year.")
    max_radius_m: Positive = Field(le=100, description="Radius at which a plant is mature, metres.")
    shade_tolerance: Fraction = Field(description="Probability that a dominated plant survives a step, 0 to 1.")
    old_age_survival: Fraction = Field(description="Probability that a mature plant survives a step, 0 to 1.")
    seedlings_per_ha_per_yr: NonNegative = Field(le=1e6, description="New plants per hectare (10,000 m²) and year.")
    seedling_radius_m: Positive = Field(0.05, le=10, description="Radius of a new plant, metres.")


class PowerLaw(Section):
    """``scale * radius^exponent``, metres; the radius in metres."""

    scale: Positive = Field(description="Value at a radius of 1 m, metres.")
    exponent: Number = Field(ge=0, le=5, description="Power of the radius, no unit.")

    def __call__(self, radius_m: float | NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(self.scale * np.asarray(radius_m, dtype=np.float64) ** self.exponent, dtype=np.float64)

    def inverse(self, value_m: float) -> float:
        """Radius in metres of a plant that has this value; the exponent must not be 0."""
        return float((value_m / self.scale) ** (1.0 / self.exponent))


class Allometry(Section):
    """Size of a plant from its radius in the community (Lane 2002, chapter 6)."""

    height_m: PowerLaw = Field(description="Height of the plant, metres, from its radius.")
    width_m: PowerLaw = Field(description="Width of the crown, metres, from its radius.")

    def height(self, radius_m: float | NDArray[np.float64]) -> NDArray[np.float64]:
        """Height in metres of plants of `radius_m`, metres, any shape."""
        return self.height_m(radius_m)

    def width(self, radius_m: float | NDArray[np.float64]) -> NDArray[np.float64]:
        """Crown width in metres of plants of `radius_m`, metres, any shape."""
        return self.width_m(radius_m)


class Plant(OpenSection):
    """What makes a species' geometry: a generator, and keys that the generator checks itself."""

    generator: Text = Field(min_length=1, max_length=100, description="Id of the plant generator.")


BarkPattern = Literal["furrowed", "plated", "scaly", "smooth", "papery", "ringed", "fibrous", "end_grain"]
TileSide = Annotated[Positive, Field(ge=0.01, le=10)]


class Bark(Section):
    """Pattern and relief of a surface, whose mean colour stays the material's reflectance; see plants/bark/."""

    pattern: BarkPattern = Field(description="What the bark looks like.")
    tile_m: tuple[TileSide, TileSide] = Field(
        (0.5, 0.75), description="Width round the stem and height of the texture's one repeat, metres."
    )
    scale_m: Positive | None = Field(
        None,
        ge=0.0005,
        le=1,
        description="Width of a ridge, plate, scale, ring or mark, metres; null: the pattern's own.",
    )
    depth_m: NonNegative | None = Field(None, le=0.1, description="Deepest crack, metres; null: the pattern's own.")
    dark: Colour | None = Field(
        None, description="Colour of cracks, linear Rec. 709, before the mean is set; null: chosen."
    )
    light: Colour | None = Field(None, description="Colour of what stands out, before the mean is set; null: chosen.")
    marks: Fraction | None = Field(
        None,
        le=0.5,
        description="Share of lenticels, checks, cracks or fresh scales, 0 to 0.5; null: the pattern's own.",
    )
    mark_colour: Colour | None = Field(
        None, description="Colour of the marks of smooth, papery, scaly and plated bark; null: as dark."
    )
    lichen: NonNegative = Field(0.0, le=0.9, description="Share of the surface that lichen covers.")
    lichen_colour: Colour = Field((0.3, 0.33, 0.24), description="Colour of lichen, before the mean is set.")

    @model_validator(mode="after")
    def _repeats(self) -> Self:
        most = 0.5 * min(self.tile_m)
        if self.scale_m is not None and self.scale_m > most:
            problem, got = "the texture's repeat is too small for features of this size", f"{self.scale_m:g} m"
            raise violation(f"at most half of tile_m: {most:g} m", problem=problem, got=got, at="scale_m")
        return self


LeafType = Literal["broad", "needle"]


class SpectrumFile(Section):
    """A table of reflectance and perhaps transmittance by wavelength; see recipe/spectra.py."""

    name: Text = Field(min_length=1, max_length=1000, description="Such as leaves/birch, or a path.")
    text: Text | None = Field(
        None, max_length=MOST_BYTES, description="The table itself, as drawn recipes keep a file of your own."
    )


class Material(Section):
    """What an organ's surface does with light: by a spectrum, or by a colour, linear Rec. 709."""

    spectrum: Annotated[SpectrumFile | None, *shorthand("name")] = Field(
        None,
        description="Table of reflectance and transmittance by wavelength, of which the colours follow: leaves/birch, "
        "bark/oak, ... or a path from the recipe's folder. In place of reflectance and transmittance.",
    )
    season: Season | None = Field(None, description="Of the spectrum, where it has seasons; null: by its phenology.")
    reflectance: Colour | None = Field(None, description="Reflected fraction of red, green, blue; linear Rec. 709.")
    transmittance: Colour = Field(
        (0.0, 0.0, 0.0), description="Fraction let through of red, green, blue; linear Rec. 709."
    )
    roughness: Fraction = Field(0.5, description="Roughness of the gloss, 0 to 1: 0.2 is waxy, 0.6 matt.")
    gloss: NonNegative = Field(
        0.0,
        le=0.08,
        description="Share of light that the skin of a leaf or petal mirrors, part of its reflectance: 0 is matt, 0.04 "
        "smooth wax. Bark has none.",
    )
    leaf_type: LeafType | None = Field(
        None,
        description="Leaves differ in light and pigments within crowns and between plants, as measured broad leaves or "
        "needles do; null: all are alike. For materials with a spectrum.",
    )
    bark: Bark | None = Field(
        None, description="Pattern of an opaque surface; null: one colour. The reflectance is its mean."
    )

    @model_validator(mode="after")
    def _says_it_once(self) -> Self:
        if self.spectrum is None and self.reflectance is None:
            raise violation("reflectance, or a spectrum", problem="a material without colour", got="neither")
        if self.spectrum is None and self.season is not None:
            raise violation("a season of a spectrum", problem="colours have no season", got=self.season, at="season")
        if self.spectrum is not None and (self.reflectance is not None or max(self.transmittance) > 0):
            expected = "a spectrum, or reflectance and transmittance"
            problem = "colours beside a spectrum, of which they follow"
            hint = "leave one out; `spectrum: null` takes back a species file's"
            raise violation(expected, problem=problem, got="both", hint=hint)
        if self.bark is not None and max(self.transmittance) > 0:
            raise violation("no transmittance, or no bark", problem="bark lets no light through", got="both")
        reflectance = self.reflectance or (0.0, 0.0, 0.0)
        for channel, r, t in zip(("red", "green", "blue"), reflectance, self.transmittance, strict=True):
            if r + t > 1.0 + 1e-9:
                expected = "reflectance + transmittance of at most 1 in every channel"
                got = f"{r:g} + {t:g} in {channel}"
                raise violation(expected, problem="more light leaves than arrives", got=got)
        return self


class Tissue(Section):
    """What turns volume and area into mass, dry; and the size of leaves."""

    wood_density_kg_per_m3: Positive = Field(500.0, le=1500, description="Dry wood over its fresh volume, kg/m³.")
    leaf_mass_per_area_kg_per_m2: Positive = Field(0.08, le=2, description="Dry leaf over one side's area, kg/m².")
    leaf_length_m: Positive | None = Field(
        None,
        le=10,
        description="Length of a full-grown leaf's blade or needle, metres: of those that fall, and of those near a "
        "camera. A crown may be drawn with larger ones, each for several. Default: as drawn.",
    )


class PlantType(Section):
    """Parameters of one plant type; symbols of the paper in brackets."""

    life_span_yr: Positive = Field(le=10_000, description="Age at which it begins to fail [p_max], years.")
    root_vigour_max: Positive = Field(le=1e5, description="Most vigour of its root module [v_rootmax].")
    growth_rate_per_yr: Positive = Field(
        le=10, description="Physiological age that a module of full vigour gains a year [g_p], 1/year."
    )
    apical_control: Fraction = Field(
        description="Share of main over lateral branches [lambda]: above 0.5 one stem leads."
    )
    determinacy: Fraction = Field(description="Place in the morphospace of prototypes [D].")
    apical_control_mature: Fraction | None = Field(None, description="The same once it flowers; null: as before.")
    determinacy_mature: Fraction | None = Field(None, description="The same once it flowers; null: as before.")
    prototypes: tuple[Text, ...] = Field(
        (),
        max_length=64,
        description="Module prototypes that it may have, by name; none: all. Palms have column.",
    )
    flowering_age_yr: NonNegative = Field(
        0.0, le=10_000, description="Age at which the most vigorous plant flowers [F_age], years."
    )
    flowering_delay_max: Number = Field(
        1.2, ge=1, le=100, description="Plants of little vigour flower at most so many times later."
    )
    tropism_angle_rad: Number = Field(
        0.52,
        ge=-1.57,
        le=3.15,
        description="Angle that branches turn to [alpha], radians from the vertical; if < 0, below the level.",
    )
    tropism_weight: NonNegative = Field(0.6, le=1e3, description="Of that angle in a module's turning [omega_2].")
    collision_weight: NonNegative = Field(4.0, le=1e3, description="Of free space in it [omega_1].")
    tropism_strength: Number = Field(
        0.0,
        ge=-5,
        le=5,
        description="Bend of young segments: up above 0, down below [g_2; Table 1 prints it as g_1].",
    )
    tropism_decay: Positive = Field(
        0.3, le=100, description="Physiological age at which the bend has fallen to half [g_1]."
    )
    thickening_cm: Positive = Field(2.0, le=50, description="Diameter of a grown terminal segment [phi], cm.")
    shoots_per_terminal: Number = Field(
        1.0,
        ge=1,
        le=1000,
        description="Shoots of that diameter that a terminal stands for: wood is so much thicker.",
    )
    length_per_age_m: Positive = Field(
        1.0, le=50, description="Length of a segment per physiological age [beta], metres."
    )
    longest_segment_m: Positive = Field(0.8, le=20, description="Longest segment [l_max], metres.")
    mature_age: Positive = Field(1.0, le=100, description="Physiological age of a grown module [a_mature].")
    vigour_min: Positive = Field(0.08, le=1, description="Modules of less vigour, over their size, are shed [v_min].")
    sprouting: Number = Field(
        2.0, ge=1, le=20, description="A terminal bears a module at so many times that vigour; see the model."
    )
    disused_share: Fraction = Field(
        0.15, description="Share of the pipes of shed modules that stays in the wood below for good."
    )
    upkeep: NonNegative = Field(
        0.01, le=0.9, description="Share of the vigour on its way up that a metre of the way takes, 1/m."
    )
    reach_m: Positive = Field(
        25.0, le=500, description="Way from the root at which a branch gets 1/e of what it would, metres."
    )
    slowing_per_m: NonNegative = Field(
        0.0,
        le=1,
        description="Share of the growth rate that a metre of the distance from the foot takes, 1/m; see the model.",
    )
    growth_spread: NonNegative = Field(
        0.0, le=0.5, description="Standard deviation of plants' growth rates over their mean; see the model."
    )
    compensation: NonNegative = Field(
        0.4, le=0.9, description="Light exposure of which a module can just live, and give nothing."
    )
    vigour_max: Positive = Field(1.0, le=1e4, description="Vigour at which a module grows fastest [v_max].")
    opacity: Fraction = Field(
        0.5, description="Share of the light that a grown module's foliage takes, over its sphere's disc."
    )
    shade_tolerance: Fraction = Field(0.3, description="Light exposure in the deepest shade [s_tol].")
    seeds_per_yr: NonNegative = Field(1.0, le=1000, description="Seeds of a flowering plant, 1/year.")
    seeding_radius_m: Positive = Field(
        5.0, le=1000, description="Standard deviation of a seed's way, along x and y, metres."
    )
    temperature_c: Number = Field(12.0, ge=-20, le=40, description="Optimal mean temperature [T_A], deg C.")
    temperature_width_c: Positive = Field(8.0, le=100, description="Standard deviation about it, K.")
    precipitation_mm_per_yr: Number = Field(800.0, ge=0, le=10_000, description="Optimal precipitation [P_A], mm/year.")
    precipitation_width_mm_per_yr: Positive = Field(
        500.0, le=10_000, description="Standard deviation about it, mm/year."
    )

    in_biomes: Flag = Field(
        True, description="Whether a recipe's biome chooses this species, where it is a shipped one."
    )

    @model_serializer(mode="wrap")
    def _without_what_few_need(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {key: value for key, value in handler(self).items() if key != "in_biomes" or not value}

    @model_validator(mode="after")
    def _can_grow(self) -> Self:
        if self.vigour_min >= self.vigour_max:
            expected, problem = f"below vigour_max = {self.vigour_max:g}", "no vigour lets a module grow"
            raise violation(expected, problem=problem, got=f"{self.vigour_min:g}", at="vigour_min")
        if self.sprouting * self.vigour_min >= 1.0:
            most = 1.0 / self.vigour_min
            expected = f"below {most:g}, so that sprouting x vigour_min is less than the 1 of full light"
            problem, got = "no light lets a seed germinate", f"{self.sprouting:g}"
            raise violation(expected, problem=problem, got=got, at="sprouting")
        return self


class Species(Section):
    """One species of the recipe, complete: its file and the recipe's overrides merged."""

    description: Text = Field("", max_length=2000, description="What the species is, for people.")
    height_m: Positive | None = Field(
        None,
        le=TALLEST_M,
        description="Mature height, metres: sets allometry.height_m.scale so that a plant of ecology.max_radius_m is "
        "this tall. Null leaves the allometry as it is.",
    )
    map_colour: Text | None = Field(
        None, pattern="^#[0-9A-Fa-f]{6}$", description="Colour on maps, #RRGGBB; null: chosen."
    )
    ecology: Ecology = Field(description="How the species grows, competes and spreads.")
    allometry: Allometry = Field(description="Size of a plant from its radius.")
    tree: TreeSizes | None = Field(
        None, description="Sizes of its trees by their height; null: height and width by the allometry alone."
    )
    tissue: Tissue = Field(Tissue.model_validate({}), description="Density of wood and leaves, for mass.")
    sources: tuple[Text, ...] = Field(
        (), max_length=20, description="Where the proportions come from, one reference each."
    )
    plant: Plant = Field(description="What makes its geometry.")
    triangles: tuple[tuple[Positive, NonNegative], ...] | None = Field(
        None,
        min_length=2,
        max_length=100,
        description="Pairs of a plant's height in metres and its triangles at full detail, to estimate memory; "
        "null: by height and width. docs/species_triangles.py measures them.",
    )
    modules: PlantType | None = Field(None, description="How it grows as branch modules; null: it does not.")
    modules_plant: Plant | None = Field(
        None,
        description="Plant generator of its branch modules, if `plant` serves other communities; null: `plant`.",
    )
    materials: dict[Name, Material] = Field(
        default_factory=dict, description="Materials of the plant's organs, by name."
    )
    phenology: Annotated[Phenology | None, *shorthand("habit")] = Field(
        None, description="When it has leaves, and of what colour; null: always, of the season's spectrum."
    )
    wood: Wood | None = Field(
        None, description="Dead branches, barks by height, covers, roots, sweep and forks of its trees; null: none."
    )

    @model_serializer(mode="wrap")
    def _without_what_few_need(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        rare = ("phenology", "triangles", "wood")
        return {key: value for key, value in handler(self).items() if key not in rare or value is not None}

    @model_validator(mode="after")
    def _height_is_a_plants(self) -> Self:
        height_m = self.mature_height_m
        if not 0 < height_m <= TALLEST_M:
            expected, problem = f"a mature height of at most {TALLEST_M:g} m", "the allometry gives no plant's height"
            got = f"{height_m:g} m = allometry.height_m at ecology.max_radius_m"
            raise violation(expected, problem=problem, got=got)
        return self

    @model_validator(mode="after")
    def _wood_has_materials(self) -> Self:
        for name in self.wood.materials if self.wood is not None else ():
            if name not in self.materials:
                problem, expected = (
                    "the wood names a material that the species does not have",
                    ", ".join(self.materials),
                )
                raise violation(f"one of {expected}", problem=problem, got=name, at="wood")
        return self

    @property
    def mature_height_m(self) -> float:
        """Height at ``ecology.max_radius_m``, metres."""
        return self.height_m or float(self.allometry.height(self.ecology.max_radius_m))

    def settled(self) -> Species:
        """The same species with `height_m` moved into the allometry's scale."""
        if self.height_m is None:
            return self
        law = self.allometry.height_m
        scale = self.height_m / self.ecology.max_radius_m**law.exponent
        allometry = self.allometry.model_copy(update={"height_m": law.model_copy(update={"scale": scale})})
        return self.model_copy(update={"height_m": None, "allometry": allometry})


class Building(PartSection, GivenSection):
    """A building: plants neither grow into it nor get light through it."""

    registry = BUILDINGS
    selector = "kind"

    kind: Text = Field(DEFAULT_BUILDING, description="What it is, also the name of its class in labels.")
    position_m: tuple[Coordinate, Coordinate] = Field(
        description="Middle of its ground plan: x, y, metres; on the site."
    )
    azimuth_deg: Number = Field(
        0.0, ge=-360, le=360, description="Turn of its width from east, clockwise from above, degrees."
    )
    size_m: tuple[_Side, _Side, _Side] = Field(
        (10.0, 8.0, 7.0), description="Width along its ridge, depth, and height to the ridge, metres."
    )
    materials: dict[Name, Material] = Field(
        default_factory=dict, description="Materials in place of the kind's own, by part."
    )

    @property
    def turn_rad(self) -> float:
        """The same anticlockwise, as world axes turn, radians."""
        return -math.radians(self.azimuth_deg)

    def corners_m(self) -> NDArray[np.float64]:
        """(4, 2) world x and y of its ground plan's corners."""
        x, y = 0.5 * self.size_m[0], 0.5 * self.size_m[1]
        cos, sin = math.cos(self.turn_rad), math.sin(self.turn_rad)
        plan = np.array([[-x, -y], [x, -y], [x, y], [-x, y]])
        return np.asarray(plan @ np.array([[cos, sin], [-sin, cos]]) + self.position_m)
