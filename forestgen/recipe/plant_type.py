"""Plant types: how a species grows as a graph of branch modules (Makowski 2023, Tables 1 to 3)."""

from __future__ import annotations

from typing import Self

from pydantic import Field, model_validator

from forestgen.recipe.fields import Fraction, NonNegative, Number, Positive, Section, Text, mistake


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
    apical_control_mature: Fraction | None = Field(
        default=None, description="The same once it flowers; null: as before."
    )
    determinacy_mature: Fraction | None = Field(default=None, description="The same once it flowers; null: as before.")
    prototypes: tuple[Text, ...] = Field(
        default=(),
        max_length=64,
        description="Module prototypes that it may have, by name; none: all. Palms have column.",
    )
    flowering_age_yr: NonNegative = Field(
        default=0.0, le=10_000, description="Age at which the most vigorous plant flowers [F_age], years."
    )
    flowering_delay_max: Number = Field(
        default=1.2, ge=1, le=100, description="Plants of little vigour flower at most so many times later."
    )
    tropism_angle_rad: Number = Field(
        default=0.52,
        ge=-1.57,
        le=3.15,
        description="Angle that branches turn to [alpha], radians from the vertical; if < 0, below the level.",
    )
    tropism_weight: NonNegative = Field(
        default=0.6, le=1e3, description="Of that angle in a module's turning [omega_2]."
    )
    collision_weight: NonNegative = Field(default=4.0, le=1e3, description="Of free space in it [omega_1].")
    tropism_strength: Number = Field(
        default=0.0,
        ge=-5,
        le=5,
        description="Bend of young segments: up above 0, down below [g_2; Table 1 prints it as g_1].",
    )
    tropism_decay: Positive = Field(
        default=0.3, le=100, description="Physiological age at which the bend has fallen to half [g_1]."
    )
    thickening_cm: Positive = Field(default=2.0, le=50, description="Diameter of a grown terminal segment [phi], cm.")
    shoots_per_terminal: Number = Field(
        default=1.0,
        ge=1,
        le=1000,
        description="Shoots of that diameter that a terminal stands for: wood is so much thicker.",
    )
    length_per_age_m: Positive = Field(
        default=1.0, le=50, description="Length of a segment per physiological age [beta], metres."
    )
    longest_segment_m: Positive = Field(default=0.8, le=20, description="Longest segment [l_max], metres.")
    mature_age: Positive = Field(default=1.0, le=100, description="Physiological age of a grown module [a_mature].")
    vigour_min: Positive = Field(
        default=0.08, le=1, description="Modules of less vigour, over their size, are shed [v_min]."
    )
    sprouting: Number = Field(
        default=2.0, ge=1, le=20, description="A terminal bears a module at so many times that vigour; see the model."
    )
    disused_share: Fraction = Field(
        default=0.15, description="Share of the pipes of shed modules that stays in the wood below for good."
    )
    upkeep: NonNegative = Field(
        default=0.01, le=0.9, description="Share of the vigour on its way up that a metre of the way takes, 1/m."
    )
    reach_m: Positive = Field(
        default=25.0, le=500, description="Way from the root at which a branch gets 1/e of what it would, metres."
    )
    compensation: NonNegative = Field(
        default=0.4, le=0.9, description="Light exposure of which a module can just live, and give nothing."
    )
    vigour_max: Positive = Field(default=1.0, le=1e4, description="Vigour at which a module grows fastest [v_max].")
    opacity: Fraction = Field(
        default=0.5, description="Share of the light that a grown module's foliage takes, over its sphere's disc."
    )
    shade_tolerance: Fraction = Field(default=0.3, description="Light exposure in the deepest shade [s_tol].")
    seeds_per_yr: NonNegative = Field(default=1.0, le=1000, description="Seeds of a flowering plant, 1/year.")
    seeding_radius_m: Positive = Field(
        default=5.0, le=1000, description="Standard deviation of a seed's way, along x and y, metres."
    )
    temperature_c: Number = Field(default=12.0, ge=-20, le=40, description="Optimal mean temperature [T_A], deg C.")
    temperature_width_c: Positive = Field(default=8.0, le=100, description="Standard deviation about it, K.")
    precipitation_mm_per_yr: Number = Field(
        default=800.0, ge=0, le=10_000, description="Optimal precipitation [P_A], mm/year."
    )
    precipitation_width_mm_per_yr: Positive = Field(
        default=500.0, le=10_000, description="Standard deviation about it, mm/year."
    )

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
