"""Biomes: which species grow under a climate of two numbers, and the name of such land.

``community: {model: branch_modules, biome: {temperature_c: 5.6, precipitation_mm_per_yr: 940}}`` or ``biome: {place:
Helsinki}``: a recipe that names no species gets those shipped species with a ``modules`` section that the climate
suits best, by their adaptation

    o = exp(-(T - T_A)^2 / (2 s_T^2)) exp(-(P - P_A)^2 / (2 s_P^2))

(Makowski 2023, Eq. 13), and initial plants in proportion to it. Where the recipe names species, these are what grows.
A place's two numbers come from the climate normals in ``scenes/climate/stations.csv``; a number that stands beside the
place takes precedence, so a stored recipe, which has both, gives the same recipe again.
"""

from __future__ import annotations

import copy
import csv
import difflib
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

from pydantic import ValidationError

from forestgen.core.arguments import read_text
from forestgen.core.errors import AssetError, RecipeError
from forestgen.recipe.assets import list_assets, scenes_dir
from forestgen.recipe.fields import extent_m
from forestgen.recipe.sources import SourceMap, parse_yaml
from forestgen.recipe.species import PlantType

ADAPTATION_MIN = 0.2  # a species of less is not chosen
MOST_SPECIES = 8
PLANTS_PER_M2 = 0.2  # at the start, where the recipe does not say
MOST_PLANTS = 2000
WARMEST_C, COLDEST_C = 33.0, -10.0  # Makowski 2023, Table 3
WETTEST_MM, DRIEST_MM = 4300.0, 10.0
_NUMBERS = {"temperature_c": (COLDEST_C, WARMEST_C, "deg C"), "precipitation_mm_per_yr": (DRIEST_MM, WETTEST_MM, "mm")}


@dataclass(frozen=True)
class Station:
    """A place and its climate normals."""

    name: str
    latitude_deg: float
    longitude_deg: float
    temperature_c: float  # mean of the year
    precipitation_mm_per_yr: float
    source: str


@dataclass(frozen=True)
class Chosen:
    """A species that a climate suits."""

    name: str
    adaptation: float  # o of Eq. 13, 0 to 1
    plant_type: PlantType


def biome_name(temperature_c: float, precipitation_mm_per_yr: float) -> str:
    """Name of land of this climate: one of the ten biomes of Whittaker's diagram.

    Bounds that are straight lines stand for the diagram's curves (Whittaker, R. H. (1975). Communities and Ecosystems;
    Ricklefs, R. E. (2008). The Economy of Nature, Fig. 5.5), set so that the climates of Makowski 2023, Table 4, have
    the names that its figures give them. T in deg C, P in mm/year, the first line that holds:

    ======================== ==========================================================
    tundra                   T < -3
    desert                   P < 10 T + 70, Köppen's bound for rain in all seasons
    tropical (T >= 20)       savanna P < 1200, seasonal forest P < 2000, rain forest
    grassland                P < 300 + 10 T
    boreal forest            T < 7
    shrubland                P < 50 + 45 T
    temperate seasonal       P < 2000; above it temperate rain forest
    ======================== ==========================================================
    """
    t, p = temperature_c, precipitation_mm_per_yr
    if t < -3:
        return "tundra"
    if p < 10 * t + 70:
        return "desert"
    if t >= 20:
        return "savanna" if p < 1200 else "tropical seasonal forest" if p < 2000 else "tropical rain forest"
    if p < 300 + 10 * t:
        return "grassland"
    if t < 7:
        return "boreal forest"
    if p < 50 + 45 * t:
        return "shrubland"
    return "temperate seasonal forest" if p < 2000 else "temperate rain forest"


def adaptation(plant_type: PlantType, temperature_c: float, precipitation_mm_per_yr: float) -> float:
    """How well a climate suits a plant type, 0 to 1: o of Eq. 13."""
    warm = (temperature_c - plant_type.temperature_c) / plant_type.temperature_width_c
    wet = (precipitation_mm_per_yr - plant_type.precipitation_mm_per_yr) / plant_type.precipitation_width_mm_per_yr
    return math.exp(-0.5 * (warm * warm + wet * wet))


@cache
def shipped_plant_types() -> Mapping[str, PlantType]:
    """Name -> plant type of the shipped species that have one, by name."""
    found = {}
    for name in list_assets("species"):
        path = scenes_dir() / "species" / f"{name}.yaml"
        section = _modules_section(read_text(path, "a species", most_bytes=1_000_000, error=AssetError))
        if section:
            data, _ = parse_yaml(section, str(path), error=AssetError)
            try:
                found[name] = PlantType.model_validate(data["modules"])
            except ValidationError as cause:
                problem = cause.errors()[0]
                where = ".".join(["modules", *map(str, problem["loc"])])
                raise AssetError("bad value", where=f"{path}: {where}", expected=problem["msg"]) from cause
    return found


def _modules_section(text: str) -> str:
    """The lines of the top-level key ``modules`` of a species' file: reading it whole takes fifty times as long."""
    lines = text.splitlines()
    start = next((number for number, line in enumerate(lines) if line.startswith("modules:")), None)
    if start is None:
        return ""
    after = range(start + 1, len(lines))
    end = next((number for number in after if lines[number] and lines[number][0] not in " #}"), len(lines))
    return "\n".join(lines[start:end])


def choose_species(temperature_c: float, precipitation_mm_per_yr: float, *, where: str | None = None) -> list[Chosen]:
    """The shipped species that a climate suits, the best first; at most `MOST_SPECIES`.

    Raises `RecipeError`, at the biome's place in the recipe, where none is suited; it says which came closest.
    """
    climate = (temperature_c, precipitation_mm_per_yr)
    types = {name: one for name, one in shipped_plant_types().items() if one.in_biomes}
    found = [Chosen(name, adaptation(one, *climate), one) for name, one in types.items()]
    ranked = sorted(found, key=lambda one: (-one.adaptation, one.name))
    chosen = [one for one in ranked if one.adaptation >= ADAPTATION_MIN][:MOST_SPECIES]
    if chosen:
        return chosen
    best, likes = ranked[0], ranked[0].plant_type
    closest = (
        f"{best.name} comes closest with {best.adaptation:.2g}: "
        f"it likes {likes.temperature_c:g} ± {likes.temperature_width_c:g} deg C and "
        f"{likes.precipitation_mm_per_yr:g} ± {likes.precipitation_width_mm_per_yr:g} mm/year"
    )
    expected = f"an adaptation of at least {ADAPTATION_MIN:g} for one of {len(ranked)} species"
    got = f"{temperature_c:g} deg C and {precipitation_mm_per_yr:g} mm/year; {closest}"
    hint = "name species yourself, with a modules section of their own climate"
    raise RecipeError("no species fits this climate", where=where, expected=expected, got=got, hint=hint)


@cache
def stations() -> Mapping[str, Station]:
    """Lower-case name -> place of the climate normals that come with forestgen."""
    path = scenes_dir() / "climate" / "stations.csv"
    text = read_text(path, "climate normals", most_bytes=1_000_000, error=AssetError)
    rows = csv.DictReader(line for line in text.splitlines() if not line.startswith("#"))
    found = {}
    for row in rows:
        numbers = {key: float(row[key]) for key in row if key.endswith(("_deg", "_c", "_yr"))}
        found[row["name"].lower()] = Station(name=row["name"], source=row["source"], **numbers)
    return found


def find_station(place: str, *, where: str | None = None) -> Station:
    """The station of that name, in any case of its letters; raises `RecipeError` with all names where there is none."""
    known = stations()
    if place.strip().lower() in known:
        return known[place.strip().lower()]
    near = difflib.get_close_matches(place.strip().lower(), known, n=1)
    hint = f"did you mean {known[near[0]].name}?" if near else "or write the two numbers yourself"
    names = ", ".join(sorted(station.name for station in known.values()))
    raise RecipeError("no climate of this place", where=where, expected=names, got=f"{place!r:.60}", hint=hint)


def settle_biome(data: dict[str, Any], sources: SourceMap) -> bool:
    """Give a recipe's ``community.biome`` its numbers and, where none are named, its species; in place.

    Returns whether species were chosen: they are then ``{from: NAME}`` entries yet to be merged. Raises `RecipeError`
    for an unknown place, a number out of range, or where no species fits.
    """
    community = data.get("community")
    biome = community.get("biome") if isinstance(community, dict) else None
    if not isinstance(community, dict) or not isinstance(biome, dict):
        return False
    place, where = biome.get("place"), sources.where(("community", "biome", "place"))
    if not isinstance(place, str | None):
        raise RecipeError("bad value", where=where, expected="the name of a place", got=f"{place!r:.60}")
    station = None if place is None else find_station(place, where=where)
    for key in _NUMBERS if station is not None else ():
        biome[key] = getattr(station, key) if biome.get(key) is None else biome[key]
    if data.get("species"):
        return False
    t, p = (_number(biome, key, sources) for key in _NUMBERS)
    chosen = choose_species(t, p, where=sources.where(("community", "biome")))
    data["species"] = {one.name: {"from": one.name} for one in chosen}
    given = community.get("initial_plants")
    if given is None or (isinstance(given, int) and not isinstance(given, bool)):
        width_m, depth_m = extent_m(data.get("site"))
        plants = max(1, min(MOST_PLANTS, round(PLANTS_PER_M2 * width_m * depth_m))) if given is None else given
        community["initial_plants"] = _shares(chosen, plants)
    return True


def forget_drawn_biome(drawn: dict[str, Any], written: Mapping[str, Any]) -> None:
    """Put back in place, in the content of a recipe whose biome is drawn, what `settle_biome` made of one image's."""
    drawn["community"]["biome"] = copy.deepcopy(written["community"]["biome"])
    if not written.get("species"):
        drawn["species"] = {}
        drawn["community"].pop("initial_plants", None)
        if "initial_plants" in written["community"]:
            drawn["community"]["initial_plants"] = copy.deepcopy(written["community"]["initial_plants"])


def _number(biome: Mapping[str, Any], key: str, sources: SourceMap) -> float:
    least, most, unit = _NUMBERS[key]
    value = biome.get(key)
    good = isinstance(value, int | float) and not isinstance(value, bool) and least <= value <= most
    if good and value is not None:
        return float(value)
    written = key in biome
    where = sources.where(("community", "biome", *((key,) if written else ())))
    expected, got = f"{key}, a number from {least:g} to {most:g} {unit}", f"{value!r:.60}" if written else "no such key"
    hint = None if written else "biome: {temperature_c: 5.6, precipitation_mm_per_yr: 940} or {place: Helsinki}"
    raise RecipeError("bad value" if written else "half a biome", where=where, expected=expected, got=got, hint=hint)


def _shares(chosen: list[Chosen], total: int) -> dict[str, int]:
    """`total` plants in proportion to the species' adaptation, by largest remainders."""
    weight = sum(one.adaptation for one in chosen)
    exact = {one.name: total * one.adaptation / weight for one in chosen}
    counts = {name: int(share) for name, share in exact.items()}
    left = total - sum(counts.values())
    for name in sorted(exact, key=lambda name: counts[name] - exact[name])[: max(left, 0)]:
        counts[name] += 1
    return counts
