"""Forms of flowers, buds and flowers."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from forestgen.geometry import flowers
from forestgen.geometry.patches import Patch, stem
from forestgen.plants.organs.base import Bend, Detail, MaybeSize, OrganForm, PartName, Pieces, Size

Opening = Annotated[float, Field(ge=0, le=170)]


class _OnStalk(OrganForm):
    """An organ at the end of a stalk."""

    part: PartName = Field("flower", description="the label of its surface")
    stalk_m: MaybeSize = Field(0.0, description="length of the stalk, metres")
    stalk_diameter_m: Size = Field(0.001, description="its diameter, metres")
    stalk_material: str | None = Field(None, description="of the stalk and other green parts; the organ's own")
    detail: Detail = 1

    def up(self, *patches: Patch) -> tuple[Patch, ...]:
        """The patches at the stalk's end."""
        return tuple(flowers.lifted(patch, self.stalk_m) for patch in patches)

    def stalk(self, *green: Patch) -> Pieces:
        """The stalk, with other patches of its material at its end."""
        stalk = (stem(self.stalk_m, self.stalk_diameter_m, self.detail),) if self.stalk_m else ()
        return Pieces(self.stalk_material or self.material, stalk + self.up(*green))


class Daisy(_OnStalk):
    """A head of white rays about a yellow disc. `material` is the rays'."""

    form: Literal["daisy"]
    diameter_m: Size = Field(0.024, description="of the head with its rays, metres")
    disc_m: Size = Field(0.008, description="diameter of the disc, metres")
    petals: Annotated[int, Field(ge=3, le=200)] = Field(34, description="rays, in two whorls")
    petal_width_m: Size = Field(0.002, description="greatest width of a ray, metres")
    opening_deg: Opening = Field(80.0, description="rays from the stalk's direction, degrees")
    disc_material: str = Field(description="of the disc")

    @model_validator(mode="after")
    def _rays_show(self) -> Self:
        if self.disc_m >= 0.9 * self.diameter_m:
            raise ValueError(f"a disc_m below 0.9 of diameter_m, so that the rays show: {0.9 * self.diameter_m:g} m")
        return self

    def patches(self) -> tuple[Pieces, ...]:
        rays, disc, cup = flowers.daisy(
            self.diameter_m, self.disc_m, self.petals, self.petal_width_m, self.opening_deg, self.detail
        )
        return Pieces(self.material, self.up(rays)), Pieces(self.disc_material, self.up(disc)), self.stalk(cup)


class FourPetals(_OnStalk):
    """A fireweed's flower. `material` is the petals'."""

    form: Literal["four_petals"]
    length_m: Size = Field(description="of a petal, metres")
    width_m: Size = Field(description="of a petal, metres")
    opening_deg: Opening = Field(68.0, description="petals from the stalk's direction, degrees")
    sepal_material: str | None = Field(None, description="of the sepals; the petals' own if not given")
    stamen_material: str | None = Field(None, description="of stamens and style; the petals' own if not given")

    def patches(self) -> tuple[Pieces, ...]:
        petals, sepals, stamens = flowers.four_petals(self.length_m, self.width_m, self.opening_deg, self.detail)
        return (
            Pieces(self.material, self.up(petals)),
            Pieces(self.sepal_material or self.material, self.up(sepals)),
            Pieces(self.stamen_material or self.material, self.up(stamens)),
            self.stalk(),
        )


class Lily(_OnStalk):
    """A trumpet of six tepals. `material` is the tepals'."""

    form: Literal["lily"]
    length_m: Size = Field(description="of a tepal, metres")
    width_m: Size = Field(description="of an inner tepal, metres")
    opening_deg: Opening = Field(24.0, description="tepals at their foot from the stalk's direction, degrees")
    recurve_deg: Bend = Field(95.0, description="bend of a tepal outward, most of it near its tip, degrees")
    stamen_material: str | None = Field(None, description="of filaments and style; the tepals' own if not given")
    anther_material: str = Field(description="of the anthers")

    def patches(self) -> tuple[Pieces, ...]:
        tepals, threads, anthers = flowers.lily(
            self.length_m, self.width_m, self.opening_deg, self.recurve_deg, self.detail
        )
        return (
            Pieces(self.material, self.up(tepals)),
            Pieces(self.stamen_material or self.material, self.up(threads)),
            Pieces(self.anther_material, self.up(anthers)),
            self.stalk(),
        )


class Catkin(_OnStalk):
    """A spike of scales, as a birch's or a poplar's."""

    form: Literal["catkin"]
    length_m: Size = Field(description="length, metres")
    diameter_m: Size = Field(description="diameter, metres")
    scales: Annotated[int, Field(ge=3, le=500)] = Field(40, description="scales about the axis")

    def patches(self) -> tuple[Pieces, ...]:
        spike = flowers.catkin(self.length_m, self.diameter_m, self.scales, self.detail)
        return Pieces(self.material, self.up(spike)), self.stalk()


class Bud(_OnStalk):
    """A closed bud or a pod."""

    form: Literal["bud"]
    length_m: Size = Field(description="length without the stalk, metres")
    width_m: Size = Field(description="greatest width, metres")

    def patches(self) -> tuple[Pieces, ...]:
        body = flowers.bud(self.length_m, self.width_m, self.detail)
        return Pieces(self.material, self.up(body)), self.stalk()


class Berry(_OnStalk):
    """A round fruit, or a cluster of drupelets as a bramble's."""

    part: PartName = Field("fruit", description="the label of its surface")
    form: Literal["berry"]
    diameter_m: Size = Field(description="diameter, metres")
    length_m: Size | None = Field(None, description="length, metres; the diameter if not given")
    drupelets: Annotated[int, Field(ge=1, le=200)] = Field(1, description="1: one smooth fruit; 20-40: a bramble's")

    def patches(self) -> tuple[Pieces, ...]:
        body = flowers.berry(self.diameter_m, self.length_m or self.diameter_m, self.drupelets, self.detail)
        return Pieces(self.material, self.up(body)), self.stalk()


class Acorn(_OnStalk):
    """A nut in its cup."""

    part: PartName = Field("fruit", description="the label of its surface")
    form: Literal["acorn"]
    length_m: Size = Field(description="length with the cup, metres")
    diameter_m: Size = Field(description="diameter of the nut, metres")
    cup_material: str | None = Field(None, description="of the cup; the nut's own if not given")

    def patches(self) -> tuple[Pieces, ...]:
        nut, cup = flowers.acorn(self.length_m, self.diameter_m, self.detail)
        cup_material = self.cup_material or self.material
        return Pieces(self.material, self.up(nut)), Pieces(cup_material, self.up(cup)), self.stalk()


class Cone(_OnStalk):
    """A conifer's cone."""

    part: PartName = Field("fruit", description="the label of its surface")
    form: Literal["cone"]
    length_m: Size = Field(description="length, metres")
    diameter_m: Size = Field(description="diameter of the closed cone, metres")
    scales: Annotated[int, Field(ge=5, le=400)] = Field(60, description="scales in its spirals")
    opening_deg: Opening = Field(35.0, description="scales from the axis at the foot, degrees")

    def patches(self) -> tuple[Pieces, ...]:
        body = flowers.cone(self.length_m, self.diameter_m, self.scales, self.opening_deg, self.detail)
        return Pieces(self.material, self.up(body)), self.stalk()


class Disc(OrganForm):
    """A flat round face, such as a sawn end: its middle in the origin, its normal z."""

    part: PartName = Field("trunk", description="the label of its surface")
    form: Literal["disc"]
    diameter_m: Size = Field(description="diameter, metres")
    sides: Annotated[int, Field(ge=3, le=200)] = Field(24, description="corners of its edge")

    def patches(self) -> tuple[Pieces, ...]:
        return (Pieces(self.material, (flowers.disc(self.diameter_m, self.sides),)),)
