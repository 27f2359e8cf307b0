"""Keys of what shapes the ground of a site in the small: mounds and hollows, paths, ponds and streams."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from forestgen.recipe import fields
from forestgen.recipe.ground import GroundLayer
from forestgen.recipe.registries import GROUND_COVERS, GROUND_OF

MOST_LINES, MOST_POINTS = 20, 200
_NARROWEST_ROAD_M = 2.4
BEYOND_M = 60.0  # of the site's edge, as far as a path or stream may go on
DISSOLVED_PER_M = 2.4  # see scene/water.py

Corner = Annotated[fields.Number, Field(ge=-1e4, le=1e4)]
PlaceOnGround = tuple[Corner, Corner]


def _goes_on(points: tuple[PlaceOnGround, ...]) -> tuple[PlaceOnGround, ...]:
    if len(set(points)) < 2:
        raise fields.violation("two different places at least", problem="this line has no length")
    return points


Line = Annotated[tuple[PlaceOnGround, ...], Field(min_length=2, max_length=MOST_POINTS), AfterValidator(_goes_on)]
_Cover = Annotated[fields.Text, *fields.part_name(GROUND_COVERS)]


class MicroRelief(fields.Section):
    """Mounds and hollows of the ground."""

    rms_m: fields.NonNegative = Field(0.05, le=0.5, description="Standard deviation of their height, metres.")
    longest_m: fields.Positive = Field(
        4.0, ge=2, le=20, description="Longest distance between mounds, metres; the shortest is a quarter of it."
    )


class Path(fields.Section):
    """A line of bare ground on which people walk or drive."""

    what: Literal["path", "forest_road"] = Field(
        "path", description="path: trodden, slightly hollow. forest_road: two ruts and a middle strip."
    )
    points_m: Line = Field(
        description=f"Places [x, y] that it runs along, metres; smooth at corners, up to {BEYOND_M:g} m off the site."
    )
    width_m: fields.Positive | None = Field(
        None, ge=0.3, le=20, description="Width, metres. Default: 0.8 of a path, 3.5 of a forest road."
    )
    ground: _Cover | None = Field(
        None,
        description=f"What its surface is. Default: {GROUND_OF['path']}; {GROUND_OF['forest_road']} of a forest road.",
    )

    @model_validator(mode="after")
    def _has_room(self) -> Self:
        if self.what == "forest_road" and self.wide_m < _NARROWEST_ROAD_M:
            expected = f"at least {_NARROWEST_ROAD_M:g} m: two ruts and a middle strip"
            raise fields.violation(expected, problem="a road too narrow for a car", got=f"{self.wide_m:g} m")
        return self

    @property
    def surface(self) -> str:
        return self.ground or GROUND_OF[self.what]

    @property
    def wide_m(self) -> float:
        return self.width_m or (0.8 if self.what == "path" else 3.5)


class _Water(fields.Section):
    depth_m: fields.Positive
    dissolved_per_m: fields.NonNegative = Field(
        DISSOLVED_PER_M,
        le=30,
        description="Absorption at 440 nm by dissolved matter, 1/m: 0 is pure water; brown water of bogs has 10.",
    )
    ground: _Cover = Field(GROUND_OF["bed"], description="What its bed is.")


class Pond(_Water):
    """Still water with a level surface."""

    what: Literal["pond"] = Field(description="What it is.")
    position_m: PlaceOnGround = Field(description="Its middle, on the site: [x, y], metres.")
    radius_m: fields.Positive = Field(ge=1, le=500, description="Mean radius of its shore, metres.")
    depth_m: fields.Positive = Field(1.0, le=50, description="Depth in the middle, metres.")


class Stream(_Water):
    """Water that runs down a bed."""

    what: Literal["stream"] = Field(description="What it is.")
    points_m: Line = Field(
        description=f"Places [x, y] that it runs along, metres; smooth at corners, up to {BEYOND_M:g} m off the site. "
        "It runs down to the lower end."
    )
    width_m: fields.Positive = Field(1.5, ge=0.3, le=100, description="Width of the water, metres.")
    depth_m: fields.Positive = Field(0.25, le=20, description="Depth in the middle, metres.")


Water = Annotated[Pond | Stream, Field(discriminator="what")]
Waters = Annotated[tuple[Water, ...], Field(max_length=MOST_LINES)]
Paths = Annotated[tuple[Path, ...], Field(max_length=MOST_LINES)]


def check_layers(layers: Sequence[GroundLayer], water: Waters, paths: Paths) -> None:
    """Raise a violation for a layer that lies on what the site does not have."""
    roads = any(one.what == "forest_road" for one in paths)
    a_water, a_path = ("a pond or stream", "site.water"), ("a path or forest road", "site.paths")
    needed = {
        "roadside": (roads, "a forest_road", "site.paths"),
        "path": (bool(paths), *a_path),
        "shore": (bool(water), *a_water),
        "water": (bool(water), *a_water),
    }
    for index, layer in enumerate(layers):
        has, what, where = needed.get(layer.on, (True, "", ""))
        if not has:
            raise fields.violation(
                f"{what} in {where}",
                problem="this layer lies nowhere on the site",
                got=f"on: {layer.on}",
                hint=f"add {what} to {where}, or leave `on` out",
                at=("ground", "layers", index, "on"),
            )


def check_on_site(water: Waters, paths: Paths, size_m: tuple[float, float]) -> None:
    """Raise a violation for what does not lie on the site, or goes on too far beside it."""
    for key, entries in (("water", water), ("paths", paths)):
        for index, one in enumerate(entries):
            is_pond = isinstance(one, Pond)
            away = 0.0 if is_pond else BEYOND_M
            places = (one.position_m,) if isinstance(one, Pond) else one.points_m
            for number, place in enumerate(places):
                if all(-away <= x <= side + away for x, side in zip(place, size_m, strict=True)):
                    continue
                at = ("position_m",) if is_pond else ("points_m", number)
                raise fields.violation(
                    f"x from {-away:g} to {size_m[0] + away:g} and y from {-away:g} to {size_m[1] + away:g} metres",
                    problem=f"this {one.what} does not lie on the site",
                    got=f"[{place[0]:g}, {place[1]:g}]",
                    at=(key, index, *at),
                )
