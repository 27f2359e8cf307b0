"""Forms of fronds of palms and ferns, of blades of grass and their seed heads."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from forestgen.geometry import patches
from forestgen.geometry.mesh import UP, Floats
from forestgen.geometry.patches import Patch
from forestgen.plants.organs.base import Bend, Detail, MaybeSize, OrganForm, OrganPatch, PartName, Size
from forestgen.plants.organs.leaves import LobedBlade, SimpleBlade

_ALONG = np.array([0.0, 1.0, 0.0])
_BREAK, _TIP = 0.59, 0.21  # of a blade of grass, share of its length: foot to where it breaks, and dry tip
_PALM_LEAFLET = 0.68  # area of a leaflet over its length times its width


def _sideways(angle_rad: Floats, lift_rad: Floats | float, side: Floats) -> Floats:
    """(N, 3, 3) attitudes of leaflets at an angle from a rachis along y, lifted out of its plane; side is +1 or -1."""
    lift = np.broadcast_to(lift_rad, angle_rad.shape)
    out = np.column_stack([side * np.cos(lift), np.zeros(len(side)), np.sin(lift)])
    along = np.cos(angle_rad)[:, None] * _ALONG + np.sin(angle_rad)[:, None] * out
    upper = np.column_stack([-side * np.sin(lift), np.zeros(len(side)), np.cos(lift)])
    return patches.attitude(along, upper)


def _rachis(length_m: float, diameter_m: float, detail: int) -> Patch:
    """The axis of a frond along y, tapering to a point: 3 or 5 sides."""
    share = np.linspace(0.0, 1.0, (4, 8, 16)[detail])
    return patches.tube(patches.on_axis(share * length_m), 0.5 * diameter_m * (1.0 - share) ** 0.7, (3, 3, 5)[detail])


def _of_area(made: Callable[[float], Patch], wanted_m2: float) -> Patch:
    """What `made` gives of a factor on its blades' width, such that the area is `wanted_m2`."""
    broad = 1.0
    for _ in range(3):
        patch = made(broad)
        broad *= wanted_m2 / patches.area_m2(patch)
    return made(broad)


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

    def patches(self) -> list[OrganPatch]:
        """Leaflets, lifted above the rachis' plane so that the frond is V-shaped; the rachis."""
        profiles = ([1.0, 0.0], [0.5, 1.0, 0.75, 0.0], [0.3, 0.9, 1.0, 0.85, 0.5, 0.0])
        widths = self.leaflet_width_m * np.array(profiles[self.detail])
        share = (np.arange(self.leaflets) + 0.5) / self.leaflets
        place = self.stalk_m + (self.length_m - self.stalk_m) * share**0.95
        size = np.clip(0.45 + 2.2 * share, 0.0, 1.0) * (1.0 - 0.62 * np.clip((share - 0.45) / 0.55, 0.0, 1.0) ** 2)
        angle = np.radians(72.0 - 48.0 * share**1.3)
        jitter = 0.12 * np.sin(12.9898 * np.arange(2 * self.leaflets))
        arch = np.radians(self.arch_deg)

        def made(broad: float) -> Patch:
            folded = self.detail == 2
            leaflet = patches.strip(self.leaflet_length_m, broad * widths, keel_rad=np.radians(25.0), folded=folded)
            leaflet = patches.bent(leaflet, self.leaflet_length_m, np.radians(self.droop_deg), 1.3)
            parts = []
            for side, wobble in ((1.0, jitter[::2]), (-1.0, jitter[1::2])):
                lift = np.radians(self.lift_deg) + 1.3 * wobble
                turn = _sideways(angle + wobble, lift, np.full(self.leaflets, side))
                parts.append(patches.copies(leaflet, turn * size[:, None, None], patches.on_axis(place)))
            return patches.bent(patches.join(parts), self.length_m, arch, 1.6)

        leaflet_m2 = _PALM_LEAFLET * self.leaflet_length_m * self.leaflet_width_m
        blades = _of_area(made, 2.0 * float(np.sum(size**2)) * leaflet_m2)
        axis = patches.bent(_rachis(self.length_m, self.diameter_m, self.detail), self.length_m, arch, 1.6)
        return [OrganPatch(self.material, blades), OrganPatch(self.stalk_material or self.material, axis)]


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

    def patches(self) -> list[OrganPatch]:
        """The pleated blade of folded segments, the outermost `spread_deg` apart, at the end of its stalk."""
        edge = np.radians(self.spread_deg) * (np.arange(self.segments + 1) / self.segments - 0.5)
        middle = 0.5 * (edge[1:] + edge[:-1])
        half = 0.5 * (edge[1] - edge[0])
        inner = self.radius_m * (1.0 - self.split)
        width = 2.0 * inner * np.tan(half)
        reach = self.radius_m * (1.0 - 0.25 * (np.abs(middle) / max(np.abs(edge[0]), 1e-9)) ** 2)
        if self.detail == 0:
            profile, at = width * np.array([0.0, 1.0, 0.0]), np.array([0.0, 1.0 - self.split, 1.0])
        else:
            profile, at = width * np.array([0.0, 1.0, 0.8, 0.5, 0.0]), np.array([0.0, 1.0, 1.3, 1.7, 2.0])
            at = np.where(at <= 1.0, at * (1.0 - self.split), 1.0 - self.split + (at - 1.0) * self.split)
        ray = _ray(at * self.radius_m, profile, np.radians(22.0), folded=self.detail > 0)
        ray = patches.bent(ray, self.radius_m, np.radians(self.droop_deg), 2.5)
        along = np.column_stack([np.sin(middle), np.cos(middle), np.zeros(self.segments)])
        linear = patches.attitude(along, np.tile(UP, (self.segments, 1))) * (reach / self.radius_m)[:, None, None]
        fan = OrganPatch(
            self.material, patches.copies(ray, linear, np.tile([0.0, self.stalk_m, 0.0], (self.segments, 1)))
        )
        if self.stalk_m == 0.0:
            return [fan]
        axis = _rachis(1.25 * self.stalk_m, self.diameter_m, self.detail)
        return [fan, OrganPatch(self.stalk_material or self.material, axis)]


def _ray(y: Floats, width: Floats, keel_rad: float, *, folded: bool) -> Patch:
    """A ribbon pointed at both ends, of widths at uneven steps."""
    body = patches.strip(1.0, width[1:], keel_rad=keel_rad, folded=folded)
    columns = 3 if folded else 2
    points = body.points.copy()
    points[:, 1] = np.append(np.repeat(y[1:-1], columns), y[-1])
    points = np.concatenate([points, [[0.0, y[0], 0.0]]])
    ends = [(len(points) - 1, k, k + 1) for k in range(columns - 1)]
    uv = np.concatenate([body.uv, [[0.5, 0.0]]])
    uv[:, 1] = points[:, 1] / y[-1]
    return Patch(points, np.concatenate([body.faces, np.array(ends, np.int64)]), uv)


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

    def patches(self) -> list[OrganPatch]:
        """The blade; stipe and rachis: straight below the blade, bent with it above."""
        arch = np.radians(self.arch_deg)

        def made(broad: float) -> Patch:
            return patches.bent(self._blade(self.detail, broad), self.length_m, arch, 1.4)

        sheet = made(1.0) if self.detail == 2 else _of_area(made, patches.area_m2(self._blade(2, 1.0)))
        stops = (3, 6, 12)[self.detail]
        upper = patches.on_axis(np.linspace(0.0, self.length_m, stops))
        upper = patches.bend(upper, self.length_m, arch, 1.4) + np.array([0.0, self.stipe_m, 0.0])
        radius = 0.5 * self.diameter_m * (1.0 - np.linspace(0.0, 1.0, stops)) ** 0.8
        if self.stipe_m > 0.0:
            upper, radius = np.concatenate([[[0.0, 0.0, 0.0]], upper]), np.append(0.5 * self.diameter_m, radius)
        axis = patches.tube(upper, radius, (3, 3, 5)[self.detail])
        blade = OrganPatch(self.material, patches.lifted(sheet, self.stipe_m))
        return [blade, OrganPatch(self.stalk_material or self.material, axis)]

    def _blade(self, detail: int, broad: float) -> Patch:
        """Pairs of pinnae along the rachis, longest at its foot; pinnules are drawn from detail 1 on."""
        pinnae, length_m = self.pinnae, self.length_m
        share = (np.arange(pinnae) + 0.35) / pinnae
        place = length_m * (1.0 - (1.0 - share) ** 1.25)
        reach = 0.5 * self.width_m * (1.0 - share) ** 1.05 + 0.004 * length_m
        side = np.array([1.0, -1.0])
        parts = []
        for k in range(pinnae):
            gap = (place[min(k + 1, pinnae - 1)] - place[max(k - 1, 0)]) / (2.0 if 0 < k < pinnae - 1 else 1.0)
            breadth = 1.12 * max(gap, 0.02 * length_m * (1 - share[k]) + 1e-4)
            pinna = _pinna(reach[k], breadth, max(2, round(self.divisions * reach[k] / reach[0])), detail, broad)
            angle = np.array([np.radians(68.0 - 22.0 * share[k])] * 2)
            feet = patches.on_axis(np.maximum(place[k] + 0.12 * gap * side, 0.0))
            parts.append(patches.copies(pinna, _sideways(angle, 0.10 + 0.05 * np.sin(3.0 * k), side), feet))
        return patches.join(parts)


def _pinna(length_m: float, breadth_m: float, pinnules: int, detail: int, broad: float) -> Patch:
    """One pinna along y with its pinnules; at detail 0 a plain blade."""
    if detail == 0:
        plain = patches.strip(length_m, broad * breadth_m * np.array([0.75, 0.7, 0.0]), folded=False)
        return patches.bent(plain, length_m, 0.3, 1.5)
    share = (np.arange(pinnules) + 0.4) / pinnules
    size = 0.72 * breadth_m * (1.0 - share**1.6 * 0.85)
    step = length_m / pinnules
    if detail == 1:
        one = patches.strip(1.0, np.array([0.5, 0.0]), folded=False)
        one = one._replace(points=one.points * [broad, 1.0, 1.0])
    else:
        one = _pinnule()
    parts = []
    for side in (1.0, -1.0):
        turn = _sideways(np.radians(66.0 - 20.0 * share), 0.05, np.full(pinnules, side))
        linear = turn * size[:, None, None]
        linear[:, :, 0] *= np.clip(1.9 * step / np.maximum(size, 1e-9), 0.3, 1.3)[:, None]
        parts.append(patches.copies(one, linear, patches.on_axis(share * length_m)))
    tip = patches.strip(1.6 * step, np.array([0.5 * step * broad, 0.0]), folded=False)
    parts.append(patches.lifted(tip, length_m - 1.2 * step))
    axis = patches.strip(length_m, np.array([0.05 * breadth_m, 0.0]), folded=False)
    parts.append(axis._replace(points=axis.points + 0.0003 * UP))
    return patches.bent(patches.join(parts), length_m, 0.35, 1.5)


@lru_cache(maxsize=1)
def _pinnule() -> Patch:
    """A lobed pinnule of length 1."""
    return LobedBlade.model_construct(
        length_m=1.0, width_m=0.40, fold_deg=6.0, curl_deg=18.0,
        lobes=3, sinus=0.5, roundness=2.2, slant=0.2, widest=0.25, base=0.4, tip=0.9,
    ).blade(1)  # fmt: skip


class GrassBlade(OrganForm):
    """One leaf of grass."""

    form: Literal["grass_blade"]
    length_m: Size = Field(description="length, metres")
    width_m: Size = Field(description="greatest width, metres")
    arch_deg: Bend = Field(60.0, description="bend from foot to tip, most of it near the tip, degrees")
    keel_deg: Annotated[float, Field(ge=0, lt=85)] = Field(20.0, description="rise of the halves, at detail 2, degrees")
    twist_deg: Annotated[float, Field(ge=-720, le=720)] = Field(30.0, description="turn about itself, degrees")
    broken_deg: Bend = Field(0.0, description="turn down where the blade is broken over, degrees; 0: whole")
    tip_material: str | None = Field(None, description="of the last fifth, at detail 1 and 2; its own if not given")
    detail: Detail = 1

    def patches(self) -> list[OrganPatch]:
        """A long blade that tapers, keeled at its foot, arching over more and more towards its tip."""
        length_m, width = self.length_m, _grass_width(np.linspace(0.0, 1.0, (3, 6, 12)[self.detail]))
        turn, keel = np.radians(self.twist_deg), np.radians(self.keel_deg)
        kink = np.array([0.0, _BREAK * length_m, 0.0])

        def made(broad: float) -> Patch:
            ribbon = patches.strip(length_m, broad * self.width_m * width, keel_rad=keel, folded=self.detail == 2)
            x, y, z = ribbon.points.T
            c, s = np.cos(turn * (y / length_m) ** 2), np.sin(turn * (y / length_m) ** 2)
            twisted = ribbon._replace(points=np.column_stack([x * c + z * s, y, z * c - x * s]))
            broken = patches.bend(twisted.points - kink, 0.02 * length_m, np.radians(self.broken_deg)) + kink
            return twisted._replace(points=patches.bend(broken, length_m, np.radians(self.arch_deg), 2.2))

        fine = np.linspace(0.0, 1.0, 401)
        blade = _of_area(made, length_m * self.width_m * float(np.trapezoid(_grass_width(fine), fine)))
        if self.tip_material is None or self.detail == 0:
            return [OrganPatch(self.material, blade)]
        tip = blade.uv[blade.faces, 1].min(axis=1) > 1.0 - _TIP
        material = {False: self.material, True: self.tip_material}
        return [OrganPatch(material[of], blade._replace(faces=blade.faces[tip == of])) for of in material]


def _grass_width(share: Floats) -> Floats:
    """Width of a grass leaf along its length, share of the greatest: even, then a long taper to a point."""
    even = 0.72 + 0.28 * np.sin(np.pi * np.minimum(share / 0.7, 1.0))
    return np.asarray(even * np.clip((1.0 - share) / 0.6, 0.0, 1.0) ** 0.75, dtype=np.float64)


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

    def patches(self) -> list[OrganPatch]:
        stems, grains = (patches.bent(one, self.length_m, np.radians(self.nod_deg), 1.3) for one in self._head())
        green = self.stalk_material or self.material
        made = [OrganPatch(green, patches.lifted(stems, self.stalk_m))]
        if self.stalk_m > 0.0:
            flat = patches.strip(self.stalk_m, np.full(2, self.diameter_m), folded=False)
            stalk = patches.stem(self.stalk_m, self.diameter_m, self.detail) if self.detail else flat
            made.append(OrganPatch(green, stalk))
        return [*made, OrganPatch(self.material, patches.lifted(grains, self.stalk_m))]

    def _head(self) -> tuple[Patch, Patch]:
        """The axis with its branches, and the spikelets."""
        length_m, branches = self.length_m, self.branches
        share = (np.arange(branches) + 0.5) / branches
        turn = np.arange(branches) * np.pi * (3.0 - np.sqrt(5.0))
        reach = np.maximum(0.5 * self.width_m * np.sin(np.pi * (0.2 + 0.8 * share)) ** 0.8, 0.4 * self.spikelet_m)
        angle = np.radians(62.0 - 35.0 * share)
        outward = patches.outwards(turn)
        along = np.sin(angle)[:, None] * outward + np.cos(angle)[:, None] * _ALONG
        feet = patches.on_axis(share * length_m)
        wire = patches.strip(1.0, np.array([0.012 * length_m, 0.0]), folded=False)
        linear = patches.attitude(along, outward * np.cos(angle)[:, None] - np.sin(angle)[:, None] * _ALONG)
        stems = [
            patches.copies(wire, linear * np.stack([np.ones(branches), reach, np.ones(branches)], 1)[:, None, :], feet)
        ]
        stops = (3, 4, 8)[self.detail]
        path = patches.on_axis(np.linspace(0.0, length_m, stops))
        stems.append(patches.tube(path, 0.006 * length_m * np.append(np.linspace(1.0, 0.4, stops - 1), 0.0), 3))
        place = (np.arange(self.spikelets) + 1.0) / self.spikelets
        feet = (feet[:, None] + (reach[:, None] * place)[:, :, None] * along[:, None]).reshape(-1, 3)
        lean = np.repeat(along, self.spikelets, axis=0)
        side = patches.outwards(np.arange(len(lean)) * 2.4)
        return patches.join(stems), patches.copies(
            _spikelet(self.spikelet_m, self.detail), patches.attitude(lean + 0.35 * side, side), feet
        )


def _spikelet(length_m: float, detail: int) -> Patch:
    if detail == 0:
        return patches.strip(length_m, length_m * np.array([0.5, 0.0]), folded=False)
    if detail == 1:
        return SimpleBlade.model_construct(
            length_m=length_m, width_m=0.3 * length_m, widest=0.4, base=1.0, tip=1.2, fold_deg=30.0
        ).blade(0)
    profile = np.array([[0.0, 0.0], [0.13, 0.3], [0.11, 0.6], [0.0, 1.0]]) * length_m
    return patches.revolve(profile, 4)
