"""Forms of needles, fronds and grasses."""

from __future__ import annotations

from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from forestgen.core.parts import Part
from forestgen.geometry import fronds
from forestgen.geometry.patches import bent, placed, stem, strip
from forestgen.plants.organs.base import Bend, Detail, MaybeSize, OrganForm, PartName, Pieces, Share, Size

NeedleWidth = Annotated[float, Field(ge=1e-4, le=0.05)]
MOST_NEEDLES = 2000


class Fascicle(OrganForm):
    """A bundle of needles, as a pine's."""

    form: Literal["fascicle"]
    needles: Annotated[int, Field(ge=1, le=60)] = Field(2, description="in one bundle")
    length_m: Size = Field(description="length of a needle, metres")
    width_m: NeedleWidth = Field(0.0014, description="width of a needle, metres")
    spread_deg: Annotated[float, Field(ge=0, le=170)] = Field(28.0, description="angle between opposite ones, degrees")
    curl_deg: Bend = Field(12.0, description="bend of each, degrees")
    detail: Detail = 1

    def patches(self) -> tuple[Pieces, ...]:
        bundle = fronds.fascicle(
            self.needles, self.length_m, self.width_m, self.spread_deg, self.curl_deg, detail=self.detail
        )
        return (Pieces(self.material, (bundle,)),)


class NeedleTwig(OrganForm):
    """A twig set with needles, all around it or parted."""

    form: Literal["needle_twig"]
    length_m: Size = Field(description="length of the twig, metres")
    per_m: Annotated[float, Field(gt=0, le=10_000)] = Field(description="needles on a metre of twig")
    needle_length_m: Size = Field(description="length of a needle, metres")
    needle_width_m: NeedleWidth = Field(0.0012, description="width of a needle, metres")
    drawn: Annotated[int, Field(ge=1, le=MOST_NEEDLES)] | None = Field(
        None, description="needles drawn, each larger so that the area stays; all of them if not given"
    )
    angle_deg: Annotated[float, Field(ge=5, le=150)] = Field(50.0, description="between twig and needle, degrees")
    parting: Share = Field(0.0, description="0: needles all around; 1: all to the twig's two sides")
    curl_deg: Bend = Field(8.0, description="bend of each needle, degrees")
    diameter_m: MaybeSize = Field(0.0, description="of the twig, metres; 0: the twig itself is not drawn")
    twig_material: str | None = Field(None, description="of the twig, whose label is a branch's; the needles' own")
    detail: Detail = 0

    @model_validator(mode="after")
    def _not_too_many(self) -> Self:
        borne = self.per_m * self.length_m
        if self.drawn is None and borne > MOST_NEEDLES:
            raise ValueError(
                f"at most {MOST_NEEDLES} needles drawn on a twig; per_m * length_m is {borne:,.0f}: "
                "give a smaller number as `drawn`"
            )
        return self

    def patches(self) -> tuple[Pieces, ...]:
        count = max(round(self.per_m * self.length_m), 1)
        green = fronds.needle_twig(
            self.length_m,
            count,
            min(self.drawn or count, count),
            self.needle_length_m,
            self.needle_width_m,
            angle_deg=self.angle_deg,
            parting=self.parting,
            curve_deg=self.curl_deg,
            detail=self.detail,
        )
        if self.diameter_m == 0.0:
            return (Pieces(self.material, (green,)),)
        twig = fronds.twig(self.length_m, self.diameter_m, self.detail)
        return Pieces(self.material, (green,)), Pieces(self.twig_material or self.material, (twig,), Part.BRANCH)


class PalmFrond(OrganForm):
    """A feather palm's leaf."""

    form: Literal["palm_frond"]
    length_m: Size = Field(description="of the whole leaf, metres")
    stalk_m: MaybeSize = Field(0.0, description="bare foot of the rachis, metres")
    leaflets: Annotated[int, Field(ge=2, le=200)] = Field(50, description="on each side")
    leaflet_length_m: Size = Field(description="of the longest leaflet, metres")
    leaflet_width_m: Size = Field(description="of a leaflet, metres")
    arch_deg: Bend = Field(70.0, description="bend of the rachis from foot to tip, degrees")
    lift_deg: Annotated[float, Field(ge=-80, le=80)] = Field(25.0, description="leaflets above the rachis, degrees")
    droop_deg: Bend = Field(35.0, description="bend of each leaflet, degrees")
    diameter_m: Size = Field(0.03, description="of the rachis at its foot, metres")
    stalk_material: str | None = Field(None, description="of the rachis; the leaflets' own if not given")
    detail: Detail = 1

    @model_validator(mode="after")
    def _room(self) -> Self:
        if self.stalk_m >= 0.9 * self.length_m:
            raise ValueError(f"a stalk_m below 0.9 of length_m, of which it is a part: {0.9 * self.length_m:g} m")
        return self

    def patches(self) -> tuple[Pieces, ...]:
        blades = fronds.palm_frond(
            self.length_m,
            self.stalk_m,
            self.leaflets,
            self.leaflet_length_m,
            self.leaflet_width_m,
            arch_deg=self.arch_deg,
            lift_deg=self.lift_deg,
            droop_deg=self.droop_deg,
            detail=self.detail,
        )
        axis = fronds.rachis(self.length_m, self.diameter_m, self.detail)
        axis = bent(axis, self.length_m, np.radians(self.arch_deg), 1.6)
        return Pieces(self.material, (blades,)), Pieces(self.stalk_material or self.material, (axis,))


class FanFrond(OrganForm):
    """A fan palm's leaf."""

    form: Literal["fan_frond"]
    radius_m: Size = Field(description="of the fan, metres")
    stalk_m: MaybeSize = Field(0.0, description="petiole, metres")
    segments: Annotated[int, Field(ge=3, le=120)] = Field(30, description="rays of the fan")
    spread_deg: Annotated[float, Field(ge=40, le=350)] = Field(230.0, description="angle of the whole fan, degrees")
    split: Annotated[float, Field(ge=0.05, le=0.95)] = Field(0.45, description="share of the radius that is divided")
    droop_deg: Bend = Field(40.0, description="bend of the rays towards their tips, degrees")
    diameter_m: Size = Field(0.015, description="of the petiole, metres")
    stalk_material: str | None = Field(None, description="of the petiole; the fan's own if not given")
    detail: Detail = 1

    def patches(self) -> tuple[Pieces, ...]:
        fan = fronds.fan_frond(
            self.radius_m,
            self.stalk_m,
            self.segments,
            spread_deg=self.spread_deg,
            split=self.split,
            droop_deg=self.droop_deg,
            detail=self.detail,
        )
        if self.stalk_m == 0.0:
            return (Pieces(self.material, (fan,)),)
        axis = fronds.rachis(1.25 * self.stalk_m, self.diameter_m, self.detail)
        return Pieces(self.material, (fan,)), Pieces(self.stalk_material or self.material, (axis,))


class FernFrond(OrganForm):
    """A triangular fern frond, twice or three times divided, as bracken's."""

    form: Literal["fern_frond"]
    length_m: Size = Field(description="of the blade without its stipe, metres")
    width_m: Size = Field(description="of the blade at its foot, metres")
    stipe_m: MaybeSize = Field(0.0, description="bare stalk below the blade, metres")
    pinnae: Annotated[int, Field(ge=2, le=60)] = Field(12, description="pairs of pinnae")
    divisions: Annotated[int, Field(ge=2, le=40)] = Field(12, description="pinnules on each side of the longest pinna")
    arch_deg: Bend = Field(40.0, description="bend of the blade from foot to tip, degrees")
    diameter_m: Size = Field(0.005, description="of the stipe, metres")
    stalk_material: str | None = Field(None, description="of stipe and rachis; the blade's own if not given")
    detail: Detail = 1

    def patches(self) -> tuple[Pieces, ...]:
        sheet = fronds.fern_frond(
            self.length_m,
            self.width_m,
            self.pinnae,
            divisions=self.divisions,
            arch_deg=self.arch_deg,
            detail=self.detail,
        )
        sheet = placed(sheet, np.eye(3), np.array([0.0, self.stipe_m, 0.0]))
        axis = fronds.frond_axis(self.stipe_m, self.length_m, self.diameter_m, self.arch_deg, self.detail)
        return Pieces(self.material, (sheet,)), Pieces(self.stalk_material or self.material, (axis,))


class GrassBlade(OrganForm):
    """One leaf of grass."""

    form: Literal["grass_blade"]
    length_m: Size = Field(description="length, metres")
    width_m: Size = Field(description="greatest width, metres")
    arch_deg: Bend = Field(60.0, description="bend from foot to tip, most of it near the tip, degrees")
    keel_deg: Annotated[float, Field(ge=0, lt=85)] = Field(20.0, description="rise of the halves, at detail 2, degrees")
    twist_deg: Annotated[float, Field(ge=-720, le=720)] = Field(30.0, description="turn about itself, degrees")
    detail: Detail = 1

    def patches(self) -> tuple[Pieces, ...]:
        blade = fronds.grass_blade(
            self.length_m,
            self.width_m,
            arch_deg=self.arch_deg,
            keel_deg=self.keel_deg,
            twist_deg=self.twist_deg,
            detail=self.detail,
        )
        return (Pieces(self.material, (blade,)),)


class GrassPanicle(OrganForm):
    """A seed head of grass: spikelets on the branches of an axis."""

    part: PartName = Field("flower", description="the label of its surface")
    form: Literal["grass_panicle"]
    length_m: Size = Field(description="of the seed head, metres")
    width_m: MaybeSize = Field(0.0, description="greatest width, metres; 0: a spike")
    stalk_m: MaybeSize = Field(0.0, description="bare stalk below it, metres")
    branches: Annotated[int, Field(ge=1, le=100)] = Field(16, description="branches of the axis")
    spikelets: Annotated[int, Field(ge=1, le=30)] = Field(4, description="spikelets on each branch")
    spikelet_m: Size = Field(0.006, description="length of a spikelet, metres")
    nod_deg: Bend = Field(20.0, description="bend of the seed head, degrees")
    diameter_m: Size = Field(0.0015, description="of the stalk, metres")
    stalk_material: str | None = Field(None, description="of stalk and branches; the spikelets' own if not given")
    detail: Detail = 1

    def patches(self) -> tuple[Pieces, ...]:
        stems, grains = fronds.grass_panicle(
            self.length_m,
            self.width_m,
            self.branches,
            self.spikelets,
            self.spikelet_m,
            nod_deg=self.nod_deg,
            detail=self.detail,
        )
        up = np.array([0.0, self.stalk_m, 0.0])
        green = [placed(stems, np.eye(3), up)]
        if self.stalk_m > 0.0:
            green.append(
                strip(self.stalk_m, np.full(2, self.diameter_m), folded=False)
                if self.detail == 0
                else stem(self.stalk_m, self.diameter_m, self.detail)
            )
        grains = placed(grains, np.eye(3), up)
        return Pieces(self.stalk_material or self.material, tuple(green)), Pieces(self.material, (grains,))
