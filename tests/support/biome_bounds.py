"""What stands of the ten biomes measure by inventories and monographs, and what the biomes' recipes have.

Leaf area index: mean and standard deviation of the biome's class in the database of Scurlock, Asner & Gower (2001,
ORNL), recomputed from it (github.com/jgewirtzman/lai_wai, data/inputs/LAI_data_asner.csv) without Tukey's outliers, as
in Asner, Scurlock & Hicke (2003), Global Ecology and Biogeography 12, 191-205. Savannas: within the bounds of either
grasslands or shrublands. Deserts: from 0, since the class has no barren land.

Cover: classes of the IGBP, Loveland et al. (2000), International Journal of Remote Sensing 21, 1303-1330, as in the
legend of MODIS MCD12Q1 (Google Earth Engine): forests over 60% of trees, savannas 10 to 30%, open shrublands 10 to
60% of woody plants, barren land and grasslands under 10%.

What `SOURCES` calls "from memory" was not found and has to be looked up. Yield tables: R package ForestElementsR
(github.com/cran/ForestElementsR, data/fe_ytable_*.rda).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np

import forestgen as fg

FOLDER = Path(__file__).parents[2] / "recipes" / "biomes"
ANY = (0.0, np.inf)
NONE = (0.0, 0.0)
Range = tuple[float, float]
Value = TypeVar("Value", float, Range)


@dataclass(frozen=True)
class Figures(Generic[Value]):
    """Of a stand, or their bounds."""

    stems_per_ha: Value  # of the biome's least DBH
    basal_area_m2_per_ha: Value  # of these
    largest_share: Value  # of one species in the basal area
    leaf_area_index: Value
    canopy_cover: Value  # vertical rays that meet a plant above 1.3 m
    crown_cover: Value  # ground below crowns, which count as whole discs at random places
    top_height_m: Value  # of the 100 thickest stems a hectare; without any, of the tallest tenth of the plants


HALF = (0.0, 0.5)
FOREST = (0.6, 1.0)
BIOMES: dict[str, Figures[Range]] = {
    "boreal": Figures((314, 1148), (24.8, 46.7), HALF, (1.3, 4.0), FOREST, ANY, (18.1, 31.2)),
    "temperate_seasonal": Figures((176, 509), (24.2, 32.3), HALF, (3.5, 6.7), FOREST, ANY, (21.6, 32.5)),
    "temperate_rain": Figures((427, 1000), (60, 123), HALF, (2.1, 8.8), FOREST, ANY, (38.4, 54.3)),
    "tropical_rain": Figures((400, 602), (25.2, 37.1), HALF, (3.1, 6.5), FOREST, ANY, (30, 46)),
    "tropical_seasonal": Figures((275, 502), (7.2, 40), HALF, (1.4, 6.5), FOREST, ANY, (10, 40)),
    "savanna": Figures((10, 250), (2.5, 10), ANY, (0.5, 3.7), (0.1, 0.3), ANY, (4, 16)),
    "shrubland": Figures((0, 200), (0, 5), ANY, (0.5, 3.7), (0, 0.6), (0.1, 0.6), ANY),
    "grassland": Figures(NONE, NONE, ANY, (0.52, 2.9), (0, 0.1), ANY, (0.15, 1.8)),
    "desert": Figures((0, 50), (0, 1), ANY, (0, 2.2), (0, 0.1), (0, 0.1), ANY),
    "tundra": Figures(NONE, NONE, ANY, (0.41, 3.4), (0, 0.1), (0.1, 0.6), (0, 2.0)),
}
LEAST_DBH_CM = dict.fromkeys(BIOMES, 7.0) | dict.fromkeys(
    ("temperate_seasonal", "temperate_rain", "tropical_rain", "tropical_seasonal"), 10.0
)
#: Of stems, basal area and height; the largest share is ours: no species has most of a mixed forest.
SOURCES = {
    "boreal": "yield tables at 80 years, classes I to III: pine (Wiedemann 1943), spruce (Wiedemann 1936), larch "
    "(Schober 1946). Beside them mixed stands in Estonia: 565-1116 stems, 23.3-35.4 m2 (Forestry Studies 2021, "
    "doi:10.2478/fsmu-2021-0007)",
    "temperate_seasonal": "yield tables at 90 years: oak (Juettner 1955) and beech (Wiedemann 1931) I and II, red oak "
    "(Bauer 1955) I to III, ash (Wimmenauer 1919) I and II; lowest height oak II, highest sweetgum, SI50 27.4 m "
    "(Broadfoot & Krinard 1959). Beside them oak and hickory of 110 years in Ohio: 378 trees, 26.8 m2 (Yaussy, "
    "Hutchinson & Sutherland, USDA General Technical Report NE-299, chapter 9)",
    "temperate_rain": "old hemlocks and firs: 427 trees, 82.9 m2 (Shaw et al. 2004, Ecosystems 7, 427-439); hemlocks "
    "of 90 years: 440-1000 trees (Jozsa, slides); redwoods of Mendocino: to 123 m2 (Valentine, report); heights of "
    "100 years: Wiley 1978, SI50 26 to 39 m. From memory: at least 60 m2 (Barnes 1962, USDA Technical Bulletin 1273)",
    "tropical_rain": "Pasoh: 530 trees, 25.2 m2 (Manokaran & LaFrankie 1990, Journal of Tropical Forest Science 3, "
    "14-24), 30 to 40 m high, with emergents more (NIES); Sabah: 400 (Falck 2002, the same, 14, 304-321); Borneo: "
    "602, 37.1 m2, 39 to 46 m of trees of 1 m (Lewis et al. 2013, Philosophical Transactions B 368, table 3)",
    "tropical_seasonal": "moist and dry deciduous forest of Suruli: 502 and 275 trees, 16.5 and 7.2 m2 (Naveenkumar & "
    "Sundarapandian, Journal of Applied and Natural Science). From memory: to 40 m2, heights (Murphy & Lugo 1986, "
    "Annual Review of Ecology and Systematics 17, 67-88). Most that was read: 28.7 m2, Huai Kha Khaeng (Bunyavejchewin "
    "et al. 2001, Natural History Bulletin of the Siam Society 49, 89-106); 37.5 m2 from 3 cm DBH, Puthupet "
    "(Venkateswaran & Parthasarathy 2005, Biodiversity and Conservation 14, 1335-1344)",
    "savanna": "from memory: 5 m2 at 400 mm, twofold (Scholes et al. 2002, Journal of Vegetation Science 13, 419-428), "
    "stems, heights. Read: Skukuza, 550 mm: 128 trees over 2.5 m, 6.8 m2, mean height 9 m, to 13 m (Scholes et "
    "al. 2001, Koedoe 44, 73-84)",
    "shrubland": "stems and basal area are ours: few trees",
    "grassland": "short grasses from 0.15 m, tall ones to 1.8 m (Kephart, West & Wedin 1995, in: Forages I)",
    "desert": "stems and basal area are ours: few trees. Scrub of Mojave and Sonora covers 1 to 50% (USNVC M088)",
    "tundra": "dwarf shrubs below 0.4 m to low shrubs of 2 m (CAVM, subzones D and E)",
}


def measured(name: str, settings: tuple[str, ...] = ()) -> Figures[float]:
    """The stand of a biome's recipe, as it is rendered."""
    recipe, least_cm = fg.load(FOLDER / f"{name}.yaml", settings), LEAST_DBH_CM[name]
    table, plants = recipe.stand(min_dbh_cm=least_cm), recipe.simulate()
    total = table.total
    by_species = [row.basal_area_m2_per_ha for row in table.rows if row.storey == "all" and row.species != "all"]
    height_m = np.sort(plants["height_m"])
    tallest_m = float(height_m[-max(1, len(height_m) // 10) :].mean())
    crowns_m2 = float(np.nansum(np.pi * plants["radius_m"] ** 2))
    return Figures(
        total.stems_per_ha,
        total.basal_area_m2_per_ha,
        max(by_species, default=0.0) / max(total.basal_area_m2_per_ha, 1e-9),
        total.leaf_area_index,
        total.canopy_cover,
        1.0 - float(np.exp(-crowns_m2 / (1e4 * table.site_ha))),
        total.dominant_height_m if total.stems_per_ha else tallest_m,
    )
