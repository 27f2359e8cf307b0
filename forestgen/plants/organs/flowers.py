"""Forms of flowers, buds and fruits, and of cut faces: flower heads and closed bodies, y the axis."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from forestgen.geometry import patches
from forestgen.geometry.mesh import GOLDEN_RAD, Floats
from forestgen.geometry.patches import Patch
from forestgen.plants.organs.base import Bend, Detail, MaybeSize, OrganForm, OrganPatch, PartName, Size
from forestgen.plants.organs.leaves import SimpleBlade

Opening = Annotated[float, Field(ge=0, le=170)]


class _OnStalk(OrganForm):
    """An organ at the end of a stalk."""

    part: PartName = Field("flower", description="the label of its surface")
    stalk_m: MaybeSize = Field(0.0, description="length of the stalk, metres")
    stalk_diameter_m: Size = Field(0.001, description="its diameter, metres")
    stalk_material: str | None = Field(None, description="of the stalk and other green parts; the organ's own")
    detail: Detail = 1

    def on_stalk(self, *organ: tuple[str | None, Patch], green: tuple[Patch, ...] = ()) -> list[OrganPatch]:
        """Patches by material (None: the organ's own) at the end of the stalk; the stalk; other green patches."""
        own, stalk = self.material, self.stalk_material or self.material
        made = [OrganPatch(material or own, patches.lifted(patch, self.stalk_m)) for material, patch in organ]
        if self.stalk_m:
            made.append(OrganPatch(stalk, patches.stem(self.stalk_m, self.stalk_diameter_m, self.detail)))
        return [*made, *(OrganPatch(stalk, patches.lifted(patch, self.stalk_m)) for patch in green)]


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

    def patches(self) -> list[OrganPatch]:
        """Rays in two whorls, the domed disc, and the green involucre below."""
        reach = 0.5 * (self.diameter_m - 0.8 * self.disc_m)
        ray = SimpleBlade.model_construct(
            length_m=reach, width_m=self.petal_width_m, widest=0.6, base=0.8, tip=0.35, fold_deg=6.0, curl_deg=14.0
        ).blade(min(self.detail, 1))
        rays = []
        for k, count in enumerate((self.petals - self.petals // 2, self.petals // 2)):
            turn = k * np.pi / max(count, 1)
            opening = np.radians(self.opening_deg - 7.0 * k)
            rays.append(
                patches.lifted(patches.whorl(ray, count, opening, 0.4 * self.disc_m, turn), 0.02 * self.disc_m * k)
            )
        sides, rows = ((6, 3), (10, 4), (20, 7))[self.detail]
        angle = np.linspace(0.0, 0.5 * np.pi, rows)
        dome = np.column_stack([0.5 * self.disc_m * np.cos(angle), 0.30 * self.disc_m * np.sin(angle)])
        dome[-1, 0] = 0.0
        disc = patches.revolve(dome, sides)
        if self.detail == 2:  # florets
            bump = 1.0 + 0.05 * np.cos(np.arange(len(disc.points)) * 2.4)
            disc = disc._replace(points=disc.points * bump[:, None])
        cup = np.column_stack([[0.0, 0.22, 0.46, 0.52], [-0.30, -0.26, -0.12, 0.02]]) * self.disc_m
        return self.on_stalk(
            (None, patches.join(rays)), (self.disc_material, disc), green=(patches.revolve(cup, sides),)
        )


class FourPetals(_OnStalk):
    """A fireweed's flower. `material` is the petals'."""

    form: Literal["four_petals"]
    length_m: Size = Field(description="of a petal, metres")
    width_m: Size = Field(description="of a petal, metres")
    opening_deg: Opening = Field(68.0, description="petals from the stalk's direction, degrees")
    sepal_material: str | None = Field(None, description="of the sepals; the petals' own if not given")
    stamen_material: str | None = Field(None, description="of stamens and style; the petals' own if not given")

    def patches(self) -> list[OrganPatch]:
        """Petals, sepals between them, and stamens with the style."""
        length_m, width_m, detail = self.length_m, self.width_m, self.detail
        wavy: dict[str, Any] = {"fold_deg": 5.0, "curl_deg": 20.0, "waves": 1.0, "wave_height": 0.12} if detail else {}
        petal = SimpleBlade.model_construct(
            length_m=length_m, width_m=width_m, widest=0.66, base=0.9, tip=0.45, **wavy
        ).blade(detail)
        opening = np.radians(self.opening_deg)
        petals = patches.whorl(petal, 4, opening, 0.04 * length_m, np.pi / 4.0)
        sepal = patches.strip(0.9 * length_m, 0.17 * width_m * np.array([0.8, 1.0, 0.0]), folded=False)
        sepals = patches.whorl(sepal, 4, opening + 0.15, 0.03 * length_m)
        count = (0, 4, 8)[detail]
        parts = [patches.tube(_line(0.85 * length_m, 0.5, 3), 0.022 * length_m * np.array([1.0, 0.8, 0.0]), 3)]
        if count:
            thread = patches.strip(0.7 * length_m, 0.035 * length_m * np.array([1.0, 0.8]), folded=False)
            anther = patches.lifted(
                patches.revolve(np.array([[0.0, 0.0], [0.035, 0.05], [0.0, 0.12]]) * length_m, 3), 0.68 * length_m
            )
            parts.append(patches.whorl(patches.join([thread, anther]), count, 0.5 * opening, 0.02 * length_m, 0.2))
        return self.on_stalk((None, petals), (self.sepal_material, sepals), (self.stamen_material, patches.join(parts)))


class Lily(_OnStalk):
    """A trumpet of six tepals. `material` is the tepals'."""

    form: Literal["lily"]
    length_m: Size = Field(description="of a tepal, metres")
    width_m: Size = Field(description="of an inner tepal, metres")
    opening_deg: Opening = Field(24.0, description="tepals at their foot from the stalk's direction, degrees")
    recurve_deg: Bend = Field(95.0, description="bend of a tepal outward, most of it near its tip, degrees")
    stamen_material: str | None = Field(None, description="of filaments and style; the tepals' own if not given")
    anther_material: str = Field(description="of the anthers")

    def patches(self) -> list[OrganPatch]:
        """Recurved tepals; filaments and style; anthers."""
        length_m, opening = self.length_m, np.radians(self.opening_deg)
        tepals = []
        for k, share in enumerate((1.0, 0.78)):  # the outer three are narrower
            flat = SimpleBlade.model_construct(
                length_m=length_m, width_m=self.width_m * share, widest=0.55, base=0.75, tip=0.9,
                fold_deg=12.0, waves=1.5, wave_height=0.1,
            ).blade(max(self.detail, 1))  # fmt: skip
            petal = patches.bent(flat, length_m, np.radians(self.recurve_deg), 2.5)
            tepals.append(patches.whorl(petal, 3, opening, 0.05 * length_m, k * np.pi / 3.0))
        leaning = np.radians(0.55 * self.opening_deg)
        line = _line(0.72 * length_m, 0.35, 4)
        thread = patches.tube(line, 0.010 * length_m * np.ones(4), 3)
        threads = patches.whorl(thread, 6, leaning, 0.02 * length_m, np.pi / 6.0)
        style = patches.tube(_line(0.85 * length_m, 0.15, 4), length_m * np.array([0.014, 0.012, 0.012, 0.0]), 3)
        profile = np.array([[0.0, -0.06], [0.022, -0.03], [0.022, 0.03], [0.0, 0.06]]) * length_m
        anther = patches.revolve(profile, (3, 4, 6)[self.detail])
        across = patches.placed(anther, np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), line[-1])
        anthers = patches.whorl(across, 6, leaning, 0.02 * length_m, np.pi / 6.0)
        stamens = patches.join([threads, style])
        return self.on_stalk(
            (None, patches.join(tepals)), (self.stamen_material, stamens), (self.anther_material, anthers)
        )


def _line(length_m: float, bend_rad: float, stops: int) -> Floats:
    return patches.bend(patches.on_axis(np.linspace(0.0, length_m, stops)), length_m, bend_rad, 1.5)


class Catkin(_OnStalk):
    """A spike of scales, as a birch's or a poplar's."""

    form: Literal["catkin"]
    length_m: Size = Field(description="length, metres")
    diameter_m: Size = Field(description="diameter, metres")
    scales: Annotated[int, Field(ge=3, le=500)] = Field(40, description="scales about the axis")

    def patches(self) -> list[OrganPatch]:
        """Scales about a spindle; at detail 0 the spindle alone."""
        length_m, diameter_m = self.length_m, self.diameter_m
        spindle = np.array([[0.0, 0.0], [0.42, 0.1], [0.5, 0.4], [0.4, 0.8], [0.0, 1.0]])
        if self.detail == 0:
            return self.on_stalk((None, patches.revolve(spindle * [diameter_m, length_m], 4)))
        core = patches.revolve(spindle * [0.75 * diameter_m, length_m], 6)
        size = 1.5 * np.sqrt(np.pi * diameter_m * length_m / self.scales)
        scale = SimpleBlade.model_construct(
            length_m=size, width_m=0.9 * size, widest=0.5, base=0.6, tip=0.8, fold_deg=15.0, curl_deg=-20.0
        ).blade(self.detail - 1)
        share = (np.arange(self.scales) + 0.5) / self.scales
        radius = 0.30 * diameter_m * np.sin(np.pi * (0.12 + 0.8 * share)) ** 0.5
        grow = np.clip(np.sin(np.pi * (0.15 + 0.75 * share)) ** 0.4, 0.4, 1.0)
        spike = _set_with(core, scale, np.radians(34.0), radius, share * length_m * 0.97, grow)
        return self.on_stalk((None, spike))


def _set_with(core: Patch, scale: Patch, angle_rad: Floats, radius_m: Floats, height_m: Floats, size: Floats) -> Patch:
    """The core and scales in a golden spiral about it, at (N, 1) angles, or one for all, from the axis.

    The other arrays are (N,): where the scales' feet are, and the scales' sizes.
    """
    outward = patches.outwards(np.arange(len(size)) * GOLDEN_RAD)
    along = np.sin(angle_rad) * outward + np.cos(angle_rad) * np.array([0.0, 1.0, 0.0])
    upper = np.sin(angle_rad) * np.array([0.0, 1.0, 0.0]) - np.cos(angle_rad) * outward
    feet = patches.on_axis(height_m) + radius_m[:, None] * outward
    return patches.join([core, patches.copies(scale, patches.attitude(along, upper) * size[:, None, None], feet)])


class Bud(_OnStalk):
    """A closed bud or a pod."""

    form: Literal["bud"]
    length_m: Size = Field(description="length without the stalk, metres")
    width_m: Size = Field(description="greatest width, metres")

    def patches(self) -> list[OrganPatch]:
        """A spindle, thickest at 45% of its length; of 6 triangles at detail 0."""
        profiles = (
            [(0.0, 0.0), (0.5, 0.45), (0.0, 1.0)],
            [(0.0, 0.0), (0.36, 0.15), (0.5, 0.45), (0.3, 0.78), (0.0, 1.0)],
            [(0.0, 0.0), (0.24, 0.05), (0.42, 0.2), (0.5, 0.42), (0.43, 0.62), (0.25, 0.83), (0.1, 0.95), (0.0, 1.0)],
        )
        profile = np.array(profiles[self.detail]) * [self.width_m, self.length_m]
        return self.on_stalk((None, patches.revolve(profile, (3, 5, 9)[self.detail])))


class Berry(_OnStalk):
    """A round fruit, or a cluster of drupelets as a bramble's."""

    part: PartName = Field("fruit", description="the label of its surface")
    form: Literal["berry"]
    diameter_m: Size = Field(description="diameter, metres")
    length_m: Size | None = Field(None, description="length, metres; the diameter if not given")
    drupelets: Annotated[int, Field(ge=1, le=200)] = Field(1, description="1: one smooth fruit; 20-40: a bramble's")

    def patches(self) -> list[OrganPatch]:
        """The fruit, or round drupelets on an egg."""
        diameter_m, length_m = self.diameter_m, self.length_m or self.diameter_m
        if self.drupelets == 1 or self.detail == 0:
            sides, rows = ((5, 4), (8, 6), (14, 9))[self.detail]
            angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, rows)
            profile = np.column_stack([0.5 * diameter_m * np.cos(angle), 0.5 * length_m * (1.0 + np.sin(angle))])
            profile[[0, -1], 0] = 0.0
            return self.on_stalk((None, patches.revolve(profile, sides)))
        k = np.arange(self.drupelets)
        z = 1.0 - 2.0 * (k + 0.5) / self.drupelets
        turn = k * GOLDEN_RAD
        ring = np.sqrt(1.0 - z * z)
        outward = np.column_stack([ring * np.cos(turn), z, ring * np.sin(turn)])
        size = 0.5 * min(diameter_m, length_m)
        grain = size * 2.0 / np.sqrt(self.drupelets) * 0.95
        reach = np.array([0.5 * diameter_m - grain, 0.5 * length_m - grain, 0.5 * diameter_m - grain])
        sides, rows = ((4, 3), (5, 4), (7, 6))[self.detail]
        angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, rows)
        profile = grain * np.column_stack([np.cos(angle), np.sin(angle)])
        profile[[0, -1], 0] = 0.0
        helper = np.tile([0.31, 0.27, 0.91], (self.drupelets, 1))
        feet = outward * reach + [0.0, 0.5 * length_m, 0.0]
        return self.on_stalk(
            (None, patches.copies(patches.revolve(profile, sides), patches.attitude(outward, helper), feet))
        )


class Acorn(_OnStalk):
    """A nut in its cup."""

    part: PartName = Field("fruit", description="the label of its surface")
    form: Literal["acorn"]
    length_m: Size = Field(description="length with the cup, metres")
    diameter_m: Size = Field(description="diameter of the nut, metres")
    cup_material: str | None = Field(None, description="of the cup; the nut's own if not given")

    def patches(self) -> list[OrganPatch]:
        sides, size = (5, 8, 14)[self.detail], [self.diameter_m, self.length_m]
        y = np.linspace(0.0, 1.0, (4, 6, 10)[self.detail])
        nut = np.column_stack([0.5 * (1.0 - np.abs(2.0 * y - 1.0) ** 2.6) ** 0.5, 0.12 + 0.82 * y])
        nut = np.concatenate([nut[:-1], [[0.07, 0.945], [0.0, 1.0]]]) * size
        cup = np.array([[0.0, 0.0], [0.30, 0.03], [0.52, 0.14], [0.60, 0.28], [0.57, 0.37], [0.48, 0.38]]) * size
        return self.on_stalk((None, patches.revolve(nut, sides)), (self.cup_material, patches.revolve(cup, sides)))


class Cone(_OnStalk):
    """A conifer's cone."""

    part: PartName = Field("fruit", description="the label of its surface")
    form: Literal["cone"]
    length_m: Size = Field(description="length, metres")
    diameter_m: Size = Field(description="diameter of the closed cone, metres")
    scales: Annotated[int, Field(ge=5, le=400)] = Field(60, description="scales in its spirals")
    opening_deg: Opening = Field(35.0, description="scales from the axis at the foot, degrees")

    def patches(self) -> list[OrganPatch]:
        """Scales in spirals about a spindle; a plain spindle at detail 0."""
        length_m, diameter_m = self.length_m, self.diameter_m
        profile = np.array([[0.0, 0.0], [0.36, 0.08], [0.5, 0.35], [0.42, 0.7], [0.2, 0.94], [0.0, 1.0]])
        if self.detail == 0:
            return self.on_stalk((None, patches.revolve(profile * [diameter_m, length_m], 5)))
        core = patches.revolve(profile * [0.72 * diameter_m, length_m], 6)
        share = (np.arange(self.scales) + 0.5) / self.scales
        angle = np.radians(self.opening_deg) * (1.1 - 0.6 * share)
        radius = np.interp(share, profile[:, 1], profile[:, 0]) * 0.62 * diameter_m
        size = 1.6 * np.sqrt(np.pi * diameter_m * length_m / self.scales)
        scale = SimpleBlade.model_construct(
            length_m=size, width_m=0.85 * size, widest=0.62, base=0.6, tip=0.5, fold_deg=10.0, curl_deg=-18.0
        ).blade(self.detail - 1)
        grow = np.clip(radius / (0.31 * diameter_m), 0.45, 1.0)
        body = _set_with(core, scale, angle[:, None], radius, 0.92 * share * length_m, grow)
        return self.on_stalk((None, body))


class Disc(OrganForm):
    """A flat round face, such as a sawn end: its middle in the origin, its normal z."""

    part: PartName = Field("trunk", description="the label of its surface")
    form: Literal["disc"]
    diameter_m: Size = Field(description="diameter, metres")
    sides: Annotated[int, Field(ge=3, le=200)] = Field(24, description="corners of its edge")

    def patches(self) -> list[OrganPatch]:
        """A regular polygon; texture coordinates are its square's."""
        turn = np.arange(self.sides) * (2.0 * np.pi / self.sides)
        rim = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(self.sides)])
        points = 0.5 * self.diameter_m * np.concatenate([np.zeros((1, 3)), rim])
        k = np.arange(self.sides)
        faces = np.column_stack([np.zeros(self.sides, np.int64), 1 + k, 1 + (k + 1) % self.sides])
        return [OrganPatch(self.material, Patch(points, faces, 0.5 + points[:, :2] / self.diameter_m))]
