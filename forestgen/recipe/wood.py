"""A species' section `wood`: dead branches, barks by height, covers of the bark, roots, sweep and forks. Only trees of
given sizes have dead branches, sweep and forks."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from forestgen.recipe.fields import Fraction, Name, NonNegative, Number, Positive, Section, violation

Tile = tuple[Positive, Positive]
TILE = "Repeat of its texture, round and along, metres; its `bark`'s `tile_m` counts."
Shares = tuple[Fraction, Fraction]
Degrees = Annotated[Number, Field(ge=-90, le=180)]


class DeadBranches(Section):
    """Branches below the living crown, which shade has killed; see plants/dead_branches.py."""

    material: Name = Field("dead_branch", description="One of the species' materials.")
    keeps_m: Positive = Field(
        le=100, description="Depth below the living crown at which 1/e of a branch is left, metres."
    )
    gone_m: Positive = Field(
        le=200, description="Depth at which 1/e of the branches are left; the stem has closed over the others, metres."
    )
    whorl_m: Positive = Field(0.4, le=5, description="Distance of whorls, metres.")
    per_whorl: NonNegative = Field(le=20, description="Branches of a whorl.")
    between_per_m: NonNegative = Field(
        0.0, le=50, description="Branches beside the whorls, half as long, on a metre of the stem."
    )
    longest: Positive = Field(
        le=1.5, description="Length of the uppermost when they died, over the radius of the crown."
    )
    thickness: Positive = Field(0.012, le=0.1, description="Diameter at the foot over the length when they died.")
    angle_deg: Degrees = Field(90.0, description="Between a branch and the stem above it, degrees.")
    droop_deg_per_m: Number = Field(0.0, ge=-90, le=90, description="Turn to the ground along a branch, degrees.")
    twigs_per_m: NonNegative = Field(
        0.0, le=50, description="Twigs on a metre of the uppermost branches; further down they are gone."
    )
    tile_m: Tile | None = Field(None, description=TILE)


class BarkZone(Section):
    """Another bark of a part of the stem: above a height or below one. It begins unevenly, in ever more flakes."""

    material: Name = Field(description="One of the species' materials.")
    above: Shares | None = Field(None, description="Shares of the height between which it begins, for the upper stem.")
    below: Shares | None = Field(None, description="The same for the foot of the stem.")
    tile_m: Tile | None = Field(None, description=TILE)

    @model_validator(mode="after")
    def _is_above_or_below(self) -> Self:
        if (self.above is None) == (self.below is None):
            problem, got = "a bark without a place, or with two", "both" if self.above else "neither"
            raise violation("above, or below", problem=problem, got=got)
        low, high = self.above or self.below or (0.0, 0.0)
        if low > high:
            raise violation("shares that ascend", problem="a zone upside down", got=f"[{low:g}, {high:g}]")
        return self


class Cover(Section):
    """What grows on the bark, such as moss; see plants/stem_surface.py."""

    material: Name = Field(description="One of the species' materials, such as moss.")
    at_foot: Fraction = Field(0.0, description="Share of the stem that it grows on at the ground.")
    fades_m: Positive = Field(0.5, le=100, description="Height at which this share has fallen to 1/e, metres.")
    weather: Fraction = Field(0.0, description="Share on the weather side, beside that at the foot.")
    weather_fades_m: Positive = Field(5.0, le=100, description="Height at which it has fallen to 1/e, metres.")
    weather_side_deg: Number = Field(
        315.0, ge=0, le=360, description="Azimuth of the weather side, clockwise from north, degrees."
    )


class Roots(Section):
    """Roots that run out from the stem over the ground, and dive."""

    count: Positive = Field(le=12, description="How many, on average.")
    reach_m: Positive = Field(le=5, description="How far the longest run out from a stem of 30 cm, metres.")
    rise: NonNegative = Field(
        0.8, le=3, description="How far the stem widens above each at the ground, over its radius."
    )


class Sweep(Section):
    """How far stems are from straight."""

    foot_deg: NonNegative = Field(0.0, le=30, description="Standard deviation of the lean at the foot, degrees.")
    fades_m: Positive = Field(1.5, le=20, description="Height at which the lean has fallen to 1/e, metres.")
    bow: NonNegative = Field(
        0.0, le=0.1, description="Standard deviation of the way aside, over the height, of bows further up."
    )
    nod_m: NonNegative = Field(0.0, le=5, description="Length of the leader that nods to a side, metres.")


class Forks(Section):
    """Stems that fork into two."""

    share: Fraction = Field(description="Share of the trees.")
    between: tuple[Fraction, Fraction] = Field((0.15, 0.7), description="Where, over the stem's height.")
    angle_deg: NonNegative = Field(28.0, le=90, description="Mean angle between the stems at the fork, degrees.")

    @model_validator(mode="after")
    def _ascends(self) -> Self:
        low, high = self.between
        if low > high:
            raise violation("two shares that ascend", problem="a range upside down", got=f"[{low:g}, {high:g}]")
        return self


class Wood(Section):
    """Dead branches, other barks by height, covers of the bark, roots, sweep and forks of a tree."""

    dead_branches: DeadBranches | None = Field(None, description="Dead branches below the crown; null: none.")
    bark_zones: tuple[BarkZone, ...] = Field((), max_length=4, description="Other barks of the stem, by height.")
    covers: tuple[Cover, ...] = Field((), max_length=4, description="What grows on the bark; the first goes before.")
    roots: Roots | None = Field(None, description="Roots above the ground; null: none.")
    sweep: Sweep | None = Field(None, description="How crooked the stem is; null: as its generator grows it.")
    forks: Forks | None = Field(None, description="Trees whose stem forks; null: none.")

    @property
    def has_weather_side(self) -> bool:
        return any(one.weather > 0.0 for one in self.covers)

    @property
    def materials(self) -> tuple[str, ...]:
        """Names of materials."""
        dead = () if self.dead_branches is None else (self.dead_branches.material,)
        zones = (one.material for one in self.bark_zones)
        return (*dead, *zones, *(one.material for one in self.covers))
