"""Forms of organs, as the `shapes` of a species' file name them: `form` says which, and each has its own keys.

Here are leaves, simple, lobed, palmate and compound, and the type of all forms.
"""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from forestgen.geometry.leaves import Blade, Entire, Lobed, Outline, Palmate, compound_leaf, leaf
from forestgen.plants.organs.base import Bend, Detail, MaybeSize, OrganForm, Pieces, Size
from forestgen.plants.organs.flowers import Acorn, Berry, Bud, Catkin, Cone, Daisy, Disc, FourPetals, Lily
from forestgen.plants.organs.fronds import (
    FanFrond,
    Fascicle,
    FernFrond,
    GrassBlade,
    GrassPanicle,
    NeedleTwig,
    PalmFrond,
)
from forestgen.recipe.fields import Section

_STALK_WIDTH = 0.018  # of the blade's length, where the file does not say

Sharpness = Annotated[float, Field(ge=0.15, le=3.0)]
Widest = Annotated[float, Field(ge=0.1, le=0.9)]


class _Blade(Section):
    """Keys of every blade."""

    length_m: Size = Field(description="length of the blade without its stalk, metres")
    width_m: Size = Field(description="greatest width, flat, metres")
    fold_deg: Annotated[float, Field(ge=0, lt=85)] = Field(
        0.0, description="rise of each half above the midrib, of each lobe of a palmate leaf about its vein, degrees"
    )
    curl_deg: Bend = Field(0.0, description="bend of the tip below the foot's direction, degrees")

    def outline(self) -> Outline:
        raise NotImplementedError

    def wave(self) -> tuple[float, float]:
        """Number and height of the margin's waves."""
        return 0.0, 0.0

    def blade(self, detail: int) -> Blade:
        """The blade for the geometry's functions."""
        waves, height = self.wave()
        return Blade(self.outline(), self.length_m, self.width_m, self.fold_deg, self.curl_deg, waves, height, detail)


class _Waved(_Blade):
    waves: Annotated[float, Field(ge=0, le=40)] = Field(0.0, description="number of the margin's waves up and down")
    wave_height: Annotated[float, Field(ge=0, le=1)] = Field(
        0.1, description="height of the margin's waves, share of half the width"
    )

    def wave(self) -> tuple[float, float]:
        return (self.waves, self.wave_height) if self.waves else (0.0, 0.0)


class SimpleBlade(_Waved):
    """Elliptic, ovate, lanceolate, linear, deltoid, round, heart-shaped: see geometry/outlines.py."""

    form: Literal["simple"]
    widest: Widest = Field(0.4, description="where the blade is widest, share of its length from its foot")
    base: Sharpness = Field(0.5, description="sharpness of the base: 0.3 blunt, 0.5 round, 1 wedge, 1.5 drawn out")
    tip: Sharpness = Field(1.0, description="sharpness of the tip, in the same way")
    heart: Annotated[float, Field(ge=0, le=0.3)] = Field(
        0.0, description="depth of a heart-shaped base's lobes behind the petiole's end, share of the length"
    )
    teeth: Annotated[int, Field(ge=0, le=60)] = Field(0, description="teeth on each side; drawn at detail 2")
    tooth_depth: Annotated[float, Field(ge=0, le=0.35)] = Field(
        0.08, description="height of the teeth, share of the local half-width"
    )
    double_teeth: bool = Field(False, description="a smaller tooth upon each tooth")

    @model_validator(mode="after")
    def _heart_is_blunt(self) -> Self:
        if self.heart > 0.0 and self.base > 1.0:
            raise ValueError(f"a base of at most 1 with a heart-shaped base, got {self.base:g}")
        return self

    def outline(self) -> Outline:
        return Entire(
            self.widest, self.base, self.tip, self.heart, self.teeth, self.tooth_depth, double=self.double_teeth
        )


class LobedBlade(_Waved):
    """Pinnate lobes, as an oak's."""

    form: Literal["lobed"]
    lobes: Annotated[int, Field(ge=1, le=15)] = Field(4, description="on each side, beside the one at the tip")
    sinus: Annotated[float, Field(ge=0, le=0.9)] = Field(0.45, description="depth of the sinuses, share of half-width")
    roundness: Annotated[float, Field(ge=1, le=8)] = Field(2.2, description="1 pointed lobes, 2 round, more: square")
    slant: Annotated[float, Field(ge=0, le=0.45)] = Field(
        0.06, description="rise of the widest lobe's tip above its foot, share of the blade's length"
    )
    widest: Widest = Field(0.6, description="where the blade is widest, share of its length from its foot")
    base: Sharpness = Field(0.9, description="sharpness of the base: 0.5 round, 1 wedge")
    tip: Sharpness = Field(0.75, description="sharpness of the tip, in the same way")

    def outline(self) -> Outline:
        return Lobed(self.lobes, self.sinus, self.roundness, self.slant, self.widest, self.base, self.tip)


class PalmateBlade(_Blade):
    """Lobes about the petiole's end, as a maple's."""

    form: Literal["palmate"]
    lobes: Literal[3, 5, 7, 9, 11, 13] = Field(5, description="lobes in all")
    sinus: Annotated[float, Field(ge=0, le=0.9)] = Field(0.5, description="depth of the sinuses, share of the lobes")
    spread_deg: Annotated[float, Field(ge=30, le=160)] = Field(
        125.0, description="angle of the outermost lobes from the middle one, degrees"
    )
    outer: Annotated[float, Field(ge=0.2, le=1)] = Field(
        0.45, description="length of the outermost lobes, share of the middle one's"
    )
    teeth: Annotated[int, Field(ge=0, le=6)] = Field(2, description="coarse teeth on each side of a lobe, at detail 2")
    tooth_depth: Annotated[float, Field(ge=0, le=0.3)] = Field(0.12, description="their height, share of the lobe")

    @model_validator(mode="after")
    def _turns_less_than_half(self) -> Self:
        widest = 176.0 / (1.0 + 0.62 / ((self.lobes - 1) // 2))
        if self.spread_deg > widest:
            raise ValueError(f"a spread_deg of at most {widest:.0f} for {self.lobes} lobes, which else overlap")
        return self

    def outline(self) -> Outline:
        return Palmate(self.lobes, self.sinus, self.spread_deg, self.outer, self.teeth, self.tooth_depth)


class _Leaf(OrganForm, _Blade):
    """A simple leaf: blade and petiole."""

    stalk_m: MaybeSize = Field(0.0, description="length of the petiole, metres; the blade begins at its end")
    stalk_width_m: Size | None = Field(None, description="its width, metres; 1.8% of the blade's length if not given")
    detail: Detail = 1

    def patches(self) -> tuple[Pieces, ...]:
        width = self.stalk_width_m or _STALK_WIDTH * self.length_m
        return (Pieces(self.material, (leaf(self.blade(self.detail), self.stalk_m, width),)),)


class SimpleLeaf(_Leaf, SimpleBlade):
    """A leaf of one undivided blade."""


class LobedLeaf(_Leaf, LobedBlade):
    """A pinnately lobed leaf."""


class PalmateLeaf(_Leaf, PalmateBlade):
    """A palmately lobed leaf."""


Leaflet = Annotated[SimpleBlade | LobedBlade | PalmateBlade, Field(discriminator="form")]


class CompoundLeaf(OrganForm):
    """Leaflets on a rachis, or about the petiole's end."""

    form: Literal["compound"]
    leaflet: Leaflet = Field(description="blade of the largest leaflet: a simple, lobed or palmate form's keys")
    leaflets: Annotated[int, Field(ge=2, le=200)] = Field(5, description="in all; an odd number ends in one")
    arrangement: Literal["pinnate", "palmate"] = Field("pinnate", description="along a rachis, or all from one point")
    rachis_m: MaybeSize = Field(0.0, description="from the lowest pair to the end, metres; pinnate ones need it")
    stalk_m: MaybeSize = Field(0.0, description="petiole, metres")
    stalk_width_m: Size = Field(0.0015, description="width of petiole and rachis, metres")
    angle_deg: Annotated[float, Field(ge=0, le=170)] = Field(
        60.0, description="from the rachis; of palmate ones: from the middle leaflet to the outermost, degrees"
    )
    taper: Annotated[float, Field(ge=0.2, le=1)] = Field(0.8, description="size of the smallest, share of the largest")
    curl_deg: Bend = Field(0.0, description="bend of the whole leaf, degrees")
    detail: Detail = 1

    @model_validator(mode="after")
    def _has_room(self) -> Self:
        if self.arrangement == "pinnate" and self.rachis_m <= 0.0:
            raise ValueError("a pinnate leaf needs rachis_m, the length of the axis that bears its leaflets")
        if self.arrangement == "palmate" and self.rachis_m > 0.0:
            raise ValueError("a palmate leaf has no rachis: leave rachis_m out")
        return self

    def patches(self) -> tuple[Pieces, ...]:
        whole = compound_leaf(
            self.leaflet.blade(self.detail),
            self.leaflets,
            palmate=self.arrangement == "palmate",
            rachis_m=self.rachis_m,
            stalk_m=self.stalk_m,
            stalk_width_m=self.stalk_width_m,
            angle_deg=self.angle_deg,
            taper=self.taper,
            curl_deg=self.curl_deg,
        )
        return (Pieces(self.material, (whole,)),)


#: The form of one kind of organ, told apart by its key `form`.
OrganShape = Annotated[
    SimpleLeaf
    | LobedLeaf
    | PalmateLeaf
    | CompoundLeaf
    | Fascicle
    | NeedleTwig
    | PalmFrond
    | FanFrond
    | FernFrond
    | GrassBlade
    | GrassPanicle
    | Daisy
    | FourPetals
    | Lily
    | Catkin
    | Bud
    | Berry
    | Acorn
    | Cone
    | Disc,
    Field(discriminator="form"),
]
