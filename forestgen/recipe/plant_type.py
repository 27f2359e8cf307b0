"""Plant types: how a species grows as a graph of branch modules (Makowski 2023, Tables 1 to 3)."""

from __future__ import annotations

from typing import Annotated, Any, Self

from pydantic import Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from forestgen.recipe.fields import Flag, Fraction, NonNegative, Number, Positive, Section, Text, mistake


class PlantType(Section):
    """Parameters of one plant type; symbols of the paper in brackets."""

    life_span_yr: Annotated[Positive, Field(le=10_000, description="Age at which it begins to fail [p_max], years.")]
    root_vigour_max: Annotated[Positive, Field(le=1e5, description="Most vigour of its root module [v_rootmax].")]
    growth_rate_per_yr: Annotated[
        Positive, Field(le=10, description="Physiological age that a module of full vigour gains a year [g_p], 1/year.")
    ]
    apical_control: Annotated[
        Fraction, Field(description="Share of main over lateral branches [lambda]: above 0.5 one stem leads.")
    ]
    determinacy: Annotated[Fraction, Field(description="Place in the morphospace of prototypes [D].")]
    apical_control_mature: Annotated[
        Fraction | None, Field(description="The same once it flowers; null: as before.")
    ] = None
    determinacy_mature: Annotated[Fraction | None, Field(description="The same once it flowers; null: as before.")] = (
        None
    )
    prototypes: Annotated[
        tuple[Text, ...],
        Field(max_length=64, description="Module prototypes that it may have, by name; none: all. Palms have column."),
    ] = ()
    flowering_age_yr: Annotated[
        NonNegative, Field(le=10_000, description="Age at which the most vigorous plant flowers [F_age], years.")
    ] = 0.0
    flowering_delay_max: Annotated[
        Number, Field(ge=1, le=100, description="Plants of little vigour flower at most so many times later.")
    ] = 1.2
    tropism_angle_rad: Annotated[
        Number,
        Field(
            ge=-1.57,
            le=3.15,
            description="Angle that branches turn to [alpha], radians from the vertical; if < 0, below the level.",
        ),
    ] = 0.52
    tropism_weight: Annotated[
        NonNegative, Field(le=1e3, description="Of that angle in a module's turning [omega_2].")
    ] = 0.6
    collision_weight: Annotated[NonNegative, Field(le=1e3, description="Of free space in it [omega_1].")] = 4.0
    tropism_strength: Annotated[
        Number,
        Field(
            ge=-5, le=5, description="Bend of young segments: up above 0, down below [g_2; Table 1 prints it as g_1]."
        ),
    ] = 0.0
    tropism_decay: Annotated[
        Positive, Field(le=100, description="Physiological age at which the bend has fallen to half [g_1].")
    ] = 0.3
    thickening_cm: Annotated[Positive, Field(le=50, description="Diameter of a grown terminal segment [phi], cm.")] = (
        2.0
    )
    shoots_per_terminal: Annotated[
        Number,
        Field(
            ge=1, le=1000, description="Shoots of that diameter that a terminal stands for: wood is so much thicker."
        ),
    ] = 1.0
    length_per_age_m: Annotated[
        Positive, Field(le=50, description="Length of a segment per physiological age [beta], metres.")
    ] = 1.0
    longest_segment_m: Annotated[Positive, Field(le=20, description="Longest segment [l_max], metres.")] = 0.8
    mature_age: Annotated[Positive, Field(le=100, description="Physiological age of a grown module [a_mature].")] = 1.0
    vigour_min: Annotated[
        Positive, Field(le=1, description="Modules of less vigour, over their size, are shed [v_min].")
    ] = 0.08
    sprouting: Annotated[
        Number, Field(ge=1, le=20, description="A terminal bears a module at so many times that vigour; see the model.")
    ] = 2.0
    disused_share: Annotated[
        Fraction, Field(description="Share of the pipes of shed modules that stays in the wood below for good.")
    ] = 0.15
    upkeep: Annotated[
        Fraction, Field(le=0.9, description="Share of the vigour on its way up that a metre of the way takes, 1/m.")
    ] = 0.01
    reach_m: Annotated[
        Positive, Field(le=500, description="Way from the root at which a branch gets 1/e of what it would, metres.")
    ] = 25.0
    compensation: Annotated[
        Fraction, Field(le=0.9, description="Light exposure of which a module can just live, and give nothing.")
    ] = 0.4
    vigour_max: Annotated[Positive, Field(le=1e4, description="Vigour at which a module grows fastest [v_max].")] = 1.0
    opacity: Annotated[
        Fraction, Field(description="Share of the light that a grown module's foliage takes, over its sphere's disc.")
    ] = 0.5
    shade_tolerance: Annotated[Fraction, Field(description="Light exposure in the deepest shade [s_tol].")] = 0.3
    seeds_per_yr: Annotated[NonNegative, Field(le=1000, description="Seeds of a flowering plant, 1/year.")] = 1.0
    seeding_radius_m: Annotated[
        Positive, Field(le=1000, description="Standard deviation of a seed's way, along x and y, metres.")
    ] = 5.0
    temperature_c: Annotated[Number, Field(ge=-20, le=40, description="Optimal mean temperature [T_A], deg C.")] = 12.0
    temperature_width_c: Annotated[Positive, Field(le=100, description="Standard deviation about it, K.")] = 8.0
    precipitation_mm_per_yr: Annotated[
        Number, Field(ge=0, le=10_000, description="Optimal precipitation [P_A], mm/year.")
    ] = 800.0
    precipitation_width_mm_per_yr: Annotated[
        Positive, Field(le=10_000, description="Standard deviation about it, mm/year.")
    ] = 500.0

    in_biomes: Annotated[
        Flag, Field(description="Whether a recipe's biome chooses this species, where it is a shipped one.")
    ] = True

    @model_serializer(mode="wrap")
    def _without_what_few_need(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {key: value for key, value in handler(self).items() if key != "in_biomes" or not value}

    @model_validator(mode="after")
    def _vigours_in_order(self) -> Self:
        if self.vigour_min >= self.vigour_max:
            raise mistake(
                f"below vigour_max = {self.vigour_max:g}",
                got=f"{self.vigour_min:g}",
                at=("vigour_min",),
                problem="no vigour lets a module grow",
            )
        return self

    @model_validator(mode="after")
    def _can_sprout(self) -> Self:
        if self.sprouting * self.vigour_min >= 1.0:
            raise mistake(
                f"below {1.0 / self.vigour_min:g}, so that sprouting x vigour_min is less than the 1 of full light",
                got=f"{self.sprouting:g}",
                at=("sprouting",),
                problem="no light lets a seed germinate",
            )
        return self
