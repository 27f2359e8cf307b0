"""Phenology: how many leaves a plant has at a time of the year, how large they are, and of which season's colour.

A species has four dates, days of the year at a reference latitude and altitude of the northern hemisphere::

    phenology: {leaf_out: 121, full_leaf: 143, colouring: 284, leaf_fall: 299, latitude_deg: 51, altitude_m: 300}
    phenology: evergreen

``leaf_out``: leaves unfold (BBCH 11). ``full_leaf``: they have their size (BBCH 19). ``colouring``: half of the leaves
have changed colour (BBCH 94). ``leaf_fall``: half have fallen (BBCH 95). With S the smooth step from 0 to 1, d the day,
h = leaf_fall - colouring and g = full_leaf - leaf_out:

    size of a leaf      S((d - leaf_out) / g)                             of its grown area
    young               1 - S((d - leaf_out) / 2 g)                       share of the spring's spectrum
    coloured            S((d - colouring + h) / 2 h)                      share of the autumn's
    on the tree         1 - (1 - kept) S((d - leaf_fall + h) / 2 h)       share of the leaves
    withered            S((d - leaf_fall) / h)                            of the coloured: share of the dry spectrum

So a beech is green until a month before its last leaf falls (Škrk et al. 2020: a month from half coloured to bare).

Place. Leaf-out and full leaf come later, and the two dates of autumn earlier, by `ALTITUDE` and `LATITUDE` days. In the
southern hemisphere all dates are half a year later. Between the tropics there is no cold season: summergreen species
keep their leaves; drought-deciduous ones have dates of the rains, which depend on the hemisphere alone. Where the
season would be shorter than a month, or longer than the year, both shifts are reduced in proportion.

Individuals. Each plant comes earlier or later than its species, in spring and in autumn apart, by days of its own with
the standard deviations `spring_sd_days` and `autumn_sd_days`; scene/phenology.py.

Litter. Leaves that fell in the last `FRESH_DAYS` days lie on the ground in the colours of autumn; older ones are brown.

A season's name instead of a date means the same stage for all species: ``spring`` two thirds of the way from leaf-out
to full leaf, ``autumn`` half way from colouring to leaf fall, ``winter`` the middle of the bare season. ``dry`` is the
dry season: drought-deciduous species are bare, and all others but evergreens are brown.

References
----------
Altitude: Čufar et al. 2012 (Trees 26, 1091-1100): beech of 47 places in Slovenia, 46 N: leaf-out from 14 April at 55 m
to 13 May at 1050 m, colouring from 29 to 3 October; Richardson et al. 2006 (Global Change Biology 12, 1174-1188): 2.7
days per 100 m at Hubbard Brook. Latitude: the same beeches against those of Flensburg, 54.8 N, 25 m, 1954-1999 (PEP725;
in Zani et al. 2020, Science 370, 1066-1071): 2 May and 6 October. Individuals: Denéchère et al. 2021 (International
Journal of Biometeorology 65, 369-379): 4.0 and 8.5 days in 14 stands of 9 species. From leaf-out to full leaf: O'Keefe
2015 (Harvard Forest, HF003). Škrk et al. 2020 (Les/Wood 69(2), 5-20).
"""

from __future__ import annotations

from bisect import bisect
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal, Self

from pydantic import Field, model_validator

from forestgen.recipe.fields import Fraction, NonNegative, Number, Section, Text, violation
from forestgen.recipe.spectra import SEASONS, Season

LeafSeason = Literal["spring", "summer", "autumn", "winter", "dry"]
ALTITUDE = 2.6, 1.9  # days later in spring and earlier in autumn per 100 m
LATITUDE = 2.2, 2.7  # per degree towards the pole
TROPIC_DEG = 23.44
YEAR = 365
FRESH_DAYS = 30.0  # that fallen leaves keep their colour before they are brown as the litter: our estimate
_MONTHS = 60, 152, 244, 335  # days on which March, June, September and December begin
_STEPS = 20  # of every share, so that plants share exemplars and materials
_SPRING, _AUTUMN = 2 / 3, 1 / 2  # of the way from leaf-out to full leaf, and from colouring to leaf fall
_SHORTEST, _LONGEST = 30, 350  # days in full green at least; days with leaves at most


@dataclass(frozen=True)
class LeafState:
    """A plant's leaves at a time: shares from 0 to 1."""

    share: float = 1.0  # of its leaves that it has
    size: float = 1.0  # of a leaf's area, over a grown one's
    spectra: tuple[float, float, float, float] = (0.0, 1.0, 0.0, 0.0)  # of `SEASONS` in the leaves' spectrum; sum 1
    flowers: bool = True  # whether flowers and fruits are there

    @property
    def is_whole(self) -> bool:
        """Whether the plant has all that it has in summer, of whatever colour."""
        return (self.share, self.size, self.flowers) == (1.0, 1.0, True)

    @classmethod
    def of_season(cls, season: Season) -> LeafState:
        """All leaves, of one season's spectrum."""
        spring, summer, autumn, dry = (float(one == season) for one in SEASONS)
        return cls(spectra=(spring, summer, autumn, dry))


SUMMER = LeafState()
BARE = LeafState(0.0, flowers=False)


@dataclass(frozen=True)
class TimeOfYear:
    """When and where: a day of the year, or a season by its name."""

    season: LeafSeason | None = "summer"  # None: by the day
    day: int = 0  # 1 to 366; 0: by the season
    latitude_deg: float = 50.0  # north positive
    altitude_m: float = 0.0

    @property
    def name(self) -> LeafSeason:
        """The season; by the day that of its months, half a year apart in the hemispheres, summer in the tropics."""
        if self.season is not None:
            return self.season
        names: tuple[LeafSeason, ...] = ("winter", "spring", "summer", "autumn")
        return "summer" if self.is_tropical else names[bisect(_MONTHS, self.northern_day) % 4]

    @property
    def is_tropical(self) -> bool:
        return abs(self.latitude_deg) <= TROPIC_DEG

    @property
    def northern_day(self) -> float:
        """The day of the year at which the northern hemisphere is in the same season."""
        return self.day if self.latitude_deg >= 0 else (self.day + YEAR / 2 - 1) % YEAR + 1


class Phenology(Section):
    """When a species has leaves, and of what colour: days of the year of the northern hemisphere."""

    habit: Literal["evergreen", "summergreen", "drought_deciduous"] = Field(
        "summergreen",
        description="evergreen: as in summer all year. summergreen: by the cold season; not between the tropics. "
        "drought_deciduous: by the rains.",
    )
    leaf_out: Number = Field(121, ge=1, le=450, description="Leaves unfold, day of the year.")
    full_leaf: Number = Field(143, ge=1, le=450, description="They are grown.")
    colouring: Number = Field(284, ge=1, le=450, description="Half are coloured; above 365 in the next year.")
    leaf_fall: Number = Field(299, ge=1, le=450, description="Half have fallen.")
    kept: Fraction = Field(
        0.0, description="Share of leaves that stays on the plant: withered; green if drought-deciduous."
    )
    latitude_deg: Number = Field(51.0, ge=0, le=80, description="Where the dates are from, degrees north.")
    altitude_m: Number = Field(300.0, ge=-430, le=6000, description="The same above sea level, metres.")
    spring_sd_days: NonNegative = Field(
        4.0, le=60, description="Standard deviation of plants of a stand in spring, days."
    )
    autumn_sd_days: NonNegative = Field(8.5, le=60, description="The same in autumn, days.")
    source: Text = Field("", max_length=1000, description="Where the dates come from.")

    @model_validator(mode="after")
    def _dates_rise(self) -> Self:
        dates = self.leaf_out, self.full_leaf, self.colouring, self.leaf_fall
        if not (sorted(set(dates)) == list(dates) and 2 * self.leaf_fall - self.colouring - self.leaf_out <= _LONGEST):
            expected = f"leaf_out < full_leaf < colouring < leaf_fall, with leaves for at most {_LONGEST} days"
            got = ", ".join(f"{date:g}" for date in dates)
            raise violation(expected, problem="the dates of the leaves do not follow each other", got=got)
        return self

    def dates(self, latitude_deg: float, altitude_m: float) -> tuple[float, float, float, float]:
        """Leaf-out, full leaf, colouring and leaf fall at a place, as days of the northern hemisphere; they rise."""
        spring = autumn = 0.0
        if self.habit == "summergreen":
            north, up = abs(latitude_deg) - self.latitude_deg, (altitude_m - self.altitude_m) / 100.0
            spring, autumn = LATITUDE[0] * north + ALTITUDE[0] * up, -LATITUDE[1] * north - ALTITUDE[1] * up
            longer = autumn - spring
            room = (
                self.leaf_out + self.colouring - 2 * self.leaf_fall + _LONGEST
                if longer > 0
                else self.full_leaf - self.colouring + min(_SHORTEST, self.colouring - self.full_leaf)
            )
            factor = min(1.0, room / longer) if longer else 1.0
            spring, autumn = spring * factor, autumn * factor
        return self.leaf_out + spring, self.full_leaf + spring, self.colouring + autumn, self.leaf_fall + autumn


def leaf_state(
    phenology: Phenology | None, time: TimeOfYear, *, spring_days: float = 0.0, autumn_days: float = 0.0
) -> LeafState:
    """Leaves of a plant at a time of the year.

    `phenology`: None: all leaves all year, of the season's spectrum; in winter of autumn's. `spring_days`,
    `autumn_days`: how much later than its species the plant is.
    """
    if phenology is None:
        return LeafState.of_season("autumn" if time.name == "winter" else time.name)
    if phenology.habit == "evergreen":
        return SUMMER
    is_dry = phenology.habit == "drought_deciduous"
    if time.season == "dry":
        return replace(BARE, share=_rounded(phenology.kept)) if is_dry else LeafState.of_season("dry")
    if time.season == "summer" or (is_dry if time.season is not None else time.is_tropical and not is_dry):
        return SUMMER
    return _at(phenology, time, spring_days, autumn_days)


def fallen_lately(phenology: Phenology | None, time: TimeOfYear) -> float:
    """Share of a plant's leaves that fell in the last `FRESH_DAYS` days, and lie on the ground in autumn's colours."""
    if phenology is None or phenology.habit == "evergreen" or time.season in ("summer", "dry"):
        return 0.0
    is_dry = phenology.habit == "drought_deciduous"
    if is_dry if time.season is not None else time.is_tropical and not is_dry:
        return 0.0
    dates, day = _dates_and_day(phenology, time)
    half = dates[3] - dates[2]
    now, before = (_step(0.5 * (one - dates[3]) / half + 0.5) for one in (day, day - FRESH_DAYS))
    return (1.0 - phenology.kept) * (now - before)


def _dates_and_day(phenology: Phenology, time: TimeOfYear) -> tuple[tuple[float, float, float, float], float]:
    """The species' dates at the place, and the day in the year that begins in the middle of its bare season."""
    dates = leaf_out, full_leaf, colouring, leaf_fall = phenology.dates(time.latitude_deg, time.altitude_m)
    half = leaf_fall - colouring
    middle = 0.5 * (leaf_fall + half + leaf_out - YEAR)  # of the bare season before leaf-out
    named = {"spring": leaf_out + _SPRING * (full_leaf - leaf_out), "autumn": colouring + _AUTUMN * half}
    if time.season is None:
        return dates, (time.northern_day - middle) % YEAR + middle
    return dates, named.get(time.season, middle)


def _at(phenology: Phenology, time: TimeOfYear, spring_days: float, autumn_days: float) -> LeafState:
    (leaf_out, full_leaf, colouring, leaf_fall), day = _dates_and_day(phenology, time)
    half, grown, kept = leaf_fall - colouring, full_leaf - leaf_out, phenology.kept
    spring, autumn = day - spring_days - leaf_out, day - autumn_days
    size, young = _rounded(_step(spring / grown)), 1.0 - _step(0.5 * spring / grown)
    coloured, fallen = (_step(0.5 * (autumn - date) / half + 0.5) for date in (colouring, leaf_fall))
    withered = coloured * _step((autumn - leaf_fall) / half)
    share = 1.0 - (1.0 - kept) * fallen
    if phenology.habit == "drought_deciduous":  # what is kept is green, and new leaves come among it
        share, size = share * size + kept * (1.0 - size), 1.0
        young, coloured, withered = young if share > kept else 0.0, coloured * (1.0 - kept), 0.0
    elif size == 0.0:  # before leaf-out: what last year left
        share, size, young, coloured, withered = kept, 1.0, 0.0, 1.0, 1.0
    share = _rounded(share)
    if share == 0.0:
        return BARE
    flowers = size * share * (1.0 - coloured) >= 0.5
    spectra = young * (1 - coloured), (1 - young) * (1 - coloured), coloured - withered, withered
    return LeafState(share, size, _parts(spectra), flowers)


def _step(x: float) -> float:
    """0 up to 0, 1 from 1 on, smooth between."""
    x = min(max(x, 0.0), 1.0)
    return x * x * (3.0 - 2.0 * x)


def _rounded(share: float) -> float:
    return round(share * _STEPS) / _STEPS


def _parts(spectra: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    """Rounded shares, whose sum is still 1."""
    sums = [round(sum(spectra[:end]) * _STEPS) for end in range(5)]
    first, second, third, fourth = ((high - low) / _STEPS for low, high in pairwise(sums))
    return first, second, third, fourth
