"""Forms of needles, in bundles and on twigs.

A needle covers 0.8 of its length times its width, whatever the number of its triangles. A twig's shape may draw fewer
needles than it bears: each one drawn then stands for several, longer by the power 0.4 of their number, up to `longest`
times, and wider by the rest, so that the area stays. Needles no longer than true ones keep the shoot as thick, and its
needles shade one another as true ones do.
"""

from __future__ import annotations

from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from forestgen.core.parts import Part
from forestgen.geometry.mesh import GOLDEN_RAD, Floats
from forestgen.geometry.patches import Patch, attitude, bend, copies, on_axis, outwards, tube
from forestgen.plants.organs.base import Bend, Detail, MaybeSize, OrganForm, OrganPatch, Share, Size

NeedleWidth = Annotated[float, Field(ge=1e-4, le=0.05)]
MOST_NEEDLES = 2000
_COVER = 0.8  # area of a needle over its length times its width
_LENGTH_POWER = 0.4
_STRIP_LENGTH = 1.0  # over the step between pairs of crossed strips
_LEVEL_SHARE = 0.89  # of the area, in strips that lie in the plane of the twig's two sides
_STRIP_ROLL = 0.5  # radians, at most
_BEYOND = 0.1  # of a strip beyond the twig's tip


class Fascicle(OrganForm):
    """A bundle of needles, as a pine's."""

    form: Literal["fascicle"]
    needles: Annotated[int, Field(ge=1, le=60)] = Field(2, description="in one bundle")
    length_m: Size = Field(description="length of a needle, metres")
    width_m: NeedleWidth = Field(0.0014, description="width of a needle, metres")
    spread_deg: Annotated[float, Field(ge=0, le=170)] = Field(28.0, description="angle between opposite ones, degrees")
    curl_deg: Bend = Field(12.0, description="bend of each, degrees")
    detail: Detail = 1

    def patches(self) -> list[OrganPatch]:
        """Needles from one foot: each leans out by about half of `spread_deg`."""
        one = needle_patch(self.length_m, self.width_m, np.radians(self.curl_deg), self.detail)
        k = np.arange(self.needles)
        lean = 0.5 * np.radians(self.spread_deg) * (0.8 + 0.4 * _even(k, 0.7549))
        outward = outwards(2.0 * np.pi * (k + 0.25) / self.needles)
        along = np.cos(lean)[:, None] * [0.0, 1.0, 0.0] + np.sin(lean)[:, None] * outward
        size = 0.94 + 0.12 * _even(k, 0.5698)
        size /= np.sqrt(np.mean(size**2))  # the area stays
        bundle = copies(one, attitude(along, -outward) * size[:, None, None], 0.3 * self.width_m * outward)
        return [OrganPatch(self.material, bundle)]


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
    crossed: bool = Field(
        False, description="`drawn` strips in crossed pairs along the twig, about as thick as the shoot, from afar"
    )
    fascicle: Annotated[int, Field(ge=1, le=8)] = Field(
        1, description="needles in a bundle where a camera is near, as 2 of Scots pine"
    )
    longest: Annotated[float, Field(ge=1, le=10)] = Field(
        3.2, description="a needle that stands for many is at most so many times as long"
    )
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

    def patches(self) -> list[OrganPatch]:
        """The needles; the twig: three sides, tapering to a point, a single slim triangle pair a side at detail 0."""
        needles = OrganPatch(self.material, self.needles())
        if self.diameter_m == 0.0:
            return [needles]
        stops = 2 if self.detail == 0 else 3
        radius = 0.5 * self.diameter_m * np.linspace(1.0, 0.4, stops)
        radius[-1] = 0.0
        twig = tube(on_axis(np.linspace(0.0, self.length_m, stops)), radius, 3)
        return [needles, OrganPatch(self.twig_material or self.material, twig, Part.BRANCH)]

    @property
    def equivalent_needles(self) -> float:
        """Number of drawn needles, each as large as the largest, that would have the area of all."""
        every = max(round(self.per_m * self.length_m), 1)
        drawn = float(min(self.drawn or every, every))
        return drawn / (2.0 * _LEVEL_SHARE) if self.crossed else drawn

    def needles(self) -> Patch:
        """From afar; `angle_deg` is between twig and needle at the twig's base, and a third less at its tip."""
        needles = max(round(self.per_m * self.length_m), 1)
        drawn = min(self.drawn or needles, needles)
        if self.crossed and self.drawn is not None:
            return self._strips(needles, max(drawn // 2, 1))
        stands_for = max(needles / drawn, 1.0)
        longer = min(stands_for**_LENGTH_POWER, self.longest)
        width_m = self.needle_width_m * stands_for / longer
        one = needle_patch(self.needle_length_m * longer, width_m, np.radians(self.curl_deg), self.detail)
        k = np.arange(drawn)
        share = (k + 0.5) / drawn
        turn = k * GOLDEN_RAD
        side, rise = np.cos(turn), np.sin(turn)
        # Parted needles of the upper and lower side sweep to the right and left.
        side = side + self.parting * (np.sign(side) * np.sqrt(1.0 - rise**2 * 0.2) - side)
        rise = rise * (1.0 - self.parting) + 0.15 * self.parting
        outward = np.column_stack([side, np.zeros(drawn), rise])
        outward /= np.linalg.norm(outward, axis=1, keepdims=True)
        angle = np.radians(self.angle_deg) * (1.0 - 0.33 * share**2) * (0.85 + 0.3 * _even(k, 0.7549))
        last = share > 1.0 - 0.5 * self.needle_length_m / self.length_m
        angle = np.where(last, angle * 0.6, angle)
        along = np.sin(angle)[:, None] * outward + np.cos(angle)[:, None] * [0.0, 1.0, 0.0]
        # The flat side looks up, more or less: needles turn about themselves.
        upper = outward * np.cos(angle)[:, None] * -1.0 + np.sin(angle)[:, None] * [0.0, 1.0, 0.0]
        roll = 2.0 * np.pi * _even(k, 0.5698)
        upper = np.cos(roll)[:, None] * upper + np.sin(roll)[:, None] * np.cross(along, upper)
        upper = np.where(upper[:, 2:] < 0.0, -upper, upper)
        size = (0.9 + 0.2 * _even(k, 0.618)) * np.where(share < 0.06, 0.75, 1.0)
        size /= np.sqrt(np.mean(size**2))  # the area stays
        return copies(one, attitude(along, upper) * size[:, None, None], on_axis(share * self.length_m))

    def _strips(self, needles: int, pairs: int) -> Patch:
        """All needles as crossed strips, one pair after another along the twig; the last reach beyond its tip."""
        step_m = self.length_m / pairs
        length_m = _STRIP_LENGTH * step_m
        width_m = needles * self.needle_length_m * self.needle_width_m / (pairs * length_m)
        one = needle_patch(length_m, width_m, np.radians(self.curl_deg), self.detail)
        k = np.arange(2 * pairs)
        is_level = k % 2 == 0
        turn = np.where(is_level, 0.5 * np.pi, 0.0) + _STRIP_ROLL * (2.0 * _even(k // 2, 0.618) - 1.0)
        linear = attitude(np.tile([0.0, 1.0, 0.0], (len(k), 1)), outwards(turn))
        linear[:, :, 0] *= np.where(is_level, _LEVEL_SHARE, 1.0 - _LEVEL_SHARE)[:, None]
        last_m = self.length_m - (1.0 - _BEYOND) * length_m
        return copies(one, linear, on_axis(np.asarray(last_m - step_m * (pairs - 1 - k // 2), dtype=np.float64)))


def bears_on_twigs(form: OrganForm) -> bool:
    """Whether needles stand along the twigs that bear the shoots too; a pine's are on its last shoots alone."""
    return isinstance(form, NeedleTwig) and form.fascicle == 1


def needle_patch(length_m: float, width_m: float, curve_rad: float, detail: int) -> Patch:
    """One needle along y, bent down: 1 triangle, 2 (a diamond, broadest at a third) or 5 (two pieces and a point)."""
    half = 0.5 * width_m * _COVER
    if detail == 0:
        flat, faces = np.array([[2.0 * half, 0.0], [0.0, 1.0], [-2.0 * half, 0.0]]), [(0, 1, 2)]
    elif detail == 1:
        flat = np.array([[0.0, 0.0], [2.0 * half, 0.3], [0.0, 1.0], [-2.0 * half, 0.3]])
        faces = [(0, 1, 3), (1, 2, 3)]  # the short diagonal: the needle may curve
    else:
        side = half / 0.8
        flat = np.array([[side, 0.0], [-side, 0.0], [side, 0.35], [-side, 0.35], [side * 0.9, 0.7]])
        flat = np.concatenate([flat, [[-side * 0.9, 0.7], [0.0, 1.0]]])
        flat[:, 0] *= 0.8 / (0.35 + 0.3325 + 0.135)  # the pieces' widths together
        faces = [(0, 2, 1), (1, 2, 3), (2, 4, 3), (3, 4, 5), (4, 6, 5)]
    points = np.column_stack([flat[:, 0], flat[:, 1] * length_m, np.zeros(len(flat))])
    uv = np.column_stack([0.5 + 0.5 * flat[:, 0] / np.abs(flat[:, 0]).max(), flat[:, 1]])
    return Patch(bend(points, length_m, curve_rad), np.array(faces, np.int64), uv)


def _even(k: NDArray[np.int64], step: float) -> Floats:
    """Numbers in 0..1 that fill it evenly: additive recurrence."""
    return np.asarray((0.5 + k * step) % 1.0, dtype=np.float64)
