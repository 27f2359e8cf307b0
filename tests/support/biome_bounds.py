"""What stands of the ten biomes measure by inventories and monographs, and what the biomes' recipes have.

Leaf area index: mean and standard deviation of the biome's class, Asner, Scurlock & Hicke (2003), Global Ecology and
Biogeography 12, 191-205; of savannas from the least of grasslands to the highest of shrublands. Cover: classes of the
IGBP, Loveland et al. (2000), International Journal of Remote Sensing 21, 1303-1330: forests over 60%, savannas 10 to
30% of trees, open shrublands 10 to 60%, grasslands under 10% of trees and shrubs, barren land under 10%.

The class of deserts (1.31 +- 0.85) has no barren land, whose lower bound is 0. Read at the source: Asner's deserts and
its range, the curves of Broadfoot & Krinard and of Dunning. All other numbers are from memory and have to be looked up.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

import forestgen as fg

FOLDER = Path(__file__).parents[2] / "recipes" / "biomes"
ANY = (0.0, np.inf)
NONE = (0.0, 0.0)
Range = tuple[float, float]


@dataclass(frozen=True)
class Biome:
    """Bounds of a biome; the fields of `Measured` in the same order."""

    stems_per_ha: Range
    basal_area_m2_per_ha: Range
    largest_share: Range
    leaf_area_index: Range
    canopy_cover: Range
    crown_cover: Range
    top_height_m: Range
    least_dbh_cm: float
    source: str


@dataclass(frozen=True)
class Measured:
    """What one recipe's stand has."""

    stems_per_ha: float  # of the biome's least DBH
    basal_area_m2_per_ha: float  # of these
    largest_share: float  # of one species in the basal area
    leaf_area_index: float
    canopy_cover: float  # vertical rays that meet a plant above 1.3 m
    crown_cover: float  # ground below crowns, which count as whole discs at random places
    top_height_m: float  # of the 100 thickest stems a hectare; without any, of the tallest tenth of the plants


HALF = (0.0, 0.5)
FOREST = (0.6, 1.0)
BIOMES = {
    "boreal": Biome(
        (300, 1500), (18, 45), HALF, (1.3, 4.0), FOREST, ANY, (15, 30), 7,
        "Man & Greenway 2011, boreal mixed woods, Forestry Chronicle 87, 385; heights: Goudie 1984 and Wiedemann 1943",
    ),
    "temperate_seasonal": Biome(
        (161, 427), (25, 35), HALF, (3.5, 6.7), FOREST, ANY, (22, 36), 10,
        "Parker 1989, old central hardwoods, Natural Areas Journal 9, 5-11; heights: Broadfoot & Krinard 1959",
    ),
    "temperate_rain": Biome(
        (250, 900), (60, 125), HALF, (2.1, 8.8), FOREST, ANY, (38, 60), 10,
        "Barnes 1962, yield of western hemlock, USDA Technical Bulletin 1273; heights: Wiley 1978 and Dunning 1942",
    ),
    "tropical_rain": Biome(
        (400, 660), (25, 43), HALF, (3.1, 6.5), FOREST, ANY, (30, 45), 10,
        "Losos & Leigh 2004, Tropical Forest Diversity and Dynamism: plots of Barro Colorado, Pasoh, Lambir",
    ),
    "tropical_seasonal": Biome(
        (250, 500), (17, 40), HALF, (1.4, 6.5), FOREST, ANY, (10, 40), 10,
        "Murphy & Lugo 1986, Annual Review of Ecology and Systematics 17, 67-88; stems: Losos & Leigh 2004, plots of "
        "Mudumalai and Huai Kha Khaeng",
    ),
    "savanna": Biome(
        (10, 250), (2.5, 10), ANY, (0.29, 3.7), (0.1, 0.3), ANY, (4, 16), 7,
        "Scholes et al. 2002, Kalahari, Journal of Vegetation Science 13, 419-428: 5 m2/ha at 400 mm, twofold",
    ),
    "shrubland": Biome(
        (0, 200), (0, 5), ANY, (0.5, 3.7), (0, 0.6), (0.1, 0.6), ANY, 7,
        "Loveland et al. 2000: open shrublands with a few trees",
    ),
    "grassland": Biome(NONE, NONE, ANY, (0.52, 2.9), (0, 0.1), ANY, (0.1, 1.5), 7, "Loveland et al. 2000"),
    "desert": Biome((0, 50), (0, 1), ANY, (0, 2.2), (0, 0.1), (0, 0.1), ANY, 7, "Loveland et al. 2000: barren land"),
    "tundra": Biome(
        NONE, NONE, ANY, (0.41, 3.4), (0, 0.1), (0.1, 0.6), (0.1, 2.0), 7,
        "Walker et al. 2005, Circumpolar Arctic Vegetation Map, Journal of Vegetation Science 16, 267-282: low shrubs",
    ),
}  # fmt: skip


def measured(name: str, settings: tuple[str, ...] = ()) -> Measured:
    """The stand of a biome's recipe, as it is rendered."""
    recipe, least_cm = fg.load(FOLDER / f"{name}.yaml", settings), BIOMES[name].least_dbh_cm
    table, plants = recipe.stand(min_dbh_cm=least_cm), recipe.simulate()
    total = table.total
    by_species = [row.basal_area_m2_per_ha for row in table.rows if row.storey == "all" and row.species != "all"]
    height_m = np.sort(plants["height_m"])
    tallest_m = float(height_m[-max(1, len(height_m) // 10) :].mean())
    crowns_m2 = float(np.nansum(np.pi * plants["radius_m"] ** 2))
    return Measured(
        total.stems_per_ha,
        total.basal_area_m2_per_ha,
        max(by_species, default=0.0) / max(total.basal_area_m2_per_ha, 1e-9),
        total.leaf_area_index,
        total.canopy_cover,
        1.0 - float(np.exp(-crowns_m2 / (1e4 * table.site_ha))),
        total.dominant_height_m if total.stems_per_ha else tallest_m,
    )
