"""Heights of stands by age from yield tables and site curves, and even-aged stands of branch modules beside them.

Heights are those of good sites, as the stands grow at their species' best climate. `top` is the mean height of the 100
tallest trees a hectare, `mean` that of trees by basal area (Lorey). Basal areas are those of moderately thinned stands
at 80 years.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from forestgen.community.branch_modules.state import State
from forestgen.community.models.branch_modules import MODEL
from forestgen.community.population import Population, Site, SpeciesEcology
from forestgen.recipe.biome import shipped_plant_types

SIDE_M = 20.0
PLANTS_PER_HA = 1600


@dataclass(frozen=True)
class SiteCurve:
    """What is published of a species."""

    height: Literal["top", "mean"]
    height_m: dict[int, float]  # by age, years
    source: str
    basal_area_m2_per_ha: float | None = None


CURVES = {
    "beech": SiteCurve(
        "mean", {40: 14.7, 80: 27.6, 120: 35.4}, "Wiedemann 1931, Fagus sylvatica, class I, moderate thinning", 32.1
    ),
    "birch": SiteCurve("mean", {40: 18.3, 80: 26.0}, "Schwappach 1903 and 1929, Betula pendula, class I", 18.5),
    "eucalyptus": SiteCurve(
        "top", {80: 63.2, 155: 74.2}, "Sillett et al. 2010, Eucalyptus regnans, means of 5 trees each, in BAAD"
    ),
    "hemlock": SiteCurve("top", {20: 9.4, 40: 21.2, 80: 36.2, 150: 49.6}, "Wiley 1978, Tsuga heterophylla, SI50 28 m"),
    "larch": SiteCurve(
        "mean",
        {20: 9.0, 40: 17.7, 80: 27.0, 120: 31.3},
        "Schober 1946, Larix decidua, class II, moderate thinning",
        28.3,
    ),
    "maple": SiteCurve(
        "mean",
        {20: 7.9, 40: 16.8, 80: 25.4, 120: 28.7},
        "Wimmenauer 1919 and 1929, Fraxinus excelsior, class I.5: tabled with sycamore in Hamilton and Christie 1971",
        26.8,
    ),
    "oak": SiteCurve(
        "mean", {20: 7.8, 40: 15.6, 80: 23.8, 150: 30.9}, "Juettner 1955, Quercus, class I, moderate thinning", 25.0
    ),
    "pine": SiteCurve(
        "mean", {40: 15.7, 80: 25.4, 120: 30.0}, "Wiedemann 1943, Pinus sylvestris, class I, moderate thinning", 33.7
    ),
    "poplar": SiteCurve("top", {20: 10.9, 40: 18.7, 80: 27.3}, "Nigh et al. 2002, Populus tremuloides, SI50 22 m"),
    "sequoia": SiteCurve(
        "top",
        {40: 28.8, 80: 39.3, 150: 48.8},
        "Dunning 1942, mixed conifers of the Sierra Nevada, class IA: the Forest Vegetation Simulator (ws/htcalc.f) "
        "has giant sequoias by it",
    ),
    "spruce": SiteCurve("top", {40: 12.0, 80: 26.0, 150: 36.3}, "Goudie 1984, Picea glauca, SI50 22 m, from seed"),
    "sweetgum": SiteCurve(
        "top",
        {20: 15.3, 40: 24.6, 80: 31.8},
        "Broadfoot and Krinard 1959, as in Carmean et al. 1989 (Forest Vegetation Simulator, sn/htcalc.f), Liquidambar "
        "styraciflua, SI50 27.4 m",
    ),
}
_PASOH = "canopy trees of Pasoh some 45 years after logging: 30 to 40 m (NIES, Pasoh field site); to 60 m later"
#: Top heights without a published curve: least, most, and age, years, at which trees of the species' forests have them.
RANGES_M = {
    "cecropia": (15.0, 21.0, 30, "from memory, Silander & Lugo 1990: to 20 m, 30 years; Kricher 2017: rarely 25 m"),
    "kapok": (30.0, 45.0, 80, _PASOH),
    "meranti": (30.0, 45.0, 80, _PASOH),
    "willow": (10.0, 15.0, 50, "Enescu et al. 2016, European Atlas of Forest Tree Species: to 10 m, seldom to 15 m"),
}


def grown_stand(name: str, years: int, *, side_m: float = SIDE_M, seed: int = 1, **keys: Any) -> list[State]:
    """Each year's state of a planted stand of one shipped species, on a torus, at its best climate."""
    kind = shipped_plant_types()[name].model_copy(update=keys)
    ecology = SpeciesEcology(name, 0.1, 5.0, 0.5, 0.9, 0.0, 0.1, 4.0, 0.75, modules=kind)
    plants = round(PLANTS_PER_HA * side_m**2 / 1e4)
    section = {"initial_plants": plants, "steps": years, "periodic": True, "seedling_spacing_m": 1.0}
    parameters = MODEL.Parameters.model_validate(section)
    states: list[State] = [MODEL.init(parameters, Site((side_m, side_m)), [ecology], seed)]
    for _ in range(years):
        states.append(MODEL.step(states[-1]))
    return states


@dataclass(frozen=True)
class Stand:
    """What a forester measures of a stand."""

    top_m: float
    mean_m: float
    top_dbh_m: float  # mean of the same trees as the top height
    stems_per_ha: float  # of 7 cm dbh and more
    basal_area_m2_per_ha: float
    leaf_area_index: float

    @property
    def slenderness(self) -> float:
        return self.top_m / self.top_dbh_m


def measured(population: Population, area_ha: float) -> Stand:
    """The stand of a snapshot's plants over 1.3 m."""
    tall = population.height_m > 1.3
    height, dbh = population.height_m[tall], population.columns["trunk_diameter_m"][tall].astype(np.float64)
    section = np.pi / 4 * dbh**2
    top = np.argsort(-height)[: max(1, round(100 * area_ha))]
    return Stand(
        top_m=float(height[top].mean()),
        mean_m=float(np.average(height, weights=section)),
        top_dbh_m=float(dbh[top].mean()),
        stems_per_ha=float(np.sum(dbh >= 0.07)) / area_ha,
        basal_area_m2_per_ha=float(section.sum()) / area_ha,
        leaf_area_index=float(population.columns["leaf_area_m2"].sum()) / (1e4 * area_ha),
    )
