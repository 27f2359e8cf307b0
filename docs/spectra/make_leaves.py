"""Writes scenes/spectra/leaves, flowers and fruits: reflectance and transmittance by PROSPECT-D.

    uv run --no-project --with prosail python docs/spectra/make_leaves.py

PROSPECT-D (Féret, Gitelson, Noble and Jacquemoud 2017, Remote Sensing of Environment 193, 204-215) as the PyPI package
prosail computes it. No parameter of a green leaf is chosen for its look or for a stand's reflectance.

Measured leaves
---------------
FFT: 1,382 leaves and needles of 60 species of North American forests, from three heights of the crowns (Serbin et al.
2014, Ecological Applications 24, 1651-1669; Singh et al. 2015, ibid. 25, 2180-2197), with water and dry matter by
weighing; N, chlorophyll and carotenoids by inversion of PROSPECT-5 (Shiklomanov et al. 2016, Remote Sensing of
Environment 183, 226-238; github.com/ashiklom/prospect_bayes). Medians over all heights; n is the number of samples.
Hyytiälä: mean reflectance and transmittance of leaves and needles in midsummer (Hovi et al. 2024,
doi:10.23729/9a8d90cd-73e2-438d-9230-94e10e61adc9; Rautiainen et al. 2024, Earth System Science Data 16, 5069-5087;
github.com/mottus/f_art_python), to which PROSPECT-D is fitted from 400 to 2400 nm, for needles with a share of light
past them, 0.035 (pine) and 0.054 (spruce), which is part of the measured transmittance alone. Leaves of birch have no
gaps between them: their table of summer is what was measured (`MEASURED`); PROSPECT makes their other seasons.
Järvselja: needles of Picea abies in the bands of RAMI-V (Kuusk et al. 2013), fitted without 626 to 690 nm. Warren et
al. 2006: Eucalyptus leaves, as AusTraits has them (Falster et al. 2021, Scientific Data 8, 254). Moles et al. 2011
(ibid.).

What follows from them
----------------------
- Needles: reflectance alone, of a mat of needles, fixes the pigments over N, and N comes out too large. Where it passes
  `NEEDLE_N`, that of needles whose transmittance was measured too, N and pigments are scaled down to it.
- `SURFACE`: the skin of needles reflects more than that of PROSPECT's leaf, s at all wavelengths, a part of the fit to
  Hyytiälä: R' = s + (1 - s) R, T' = (1 - s) T. At 450 nm, where hardly any light comes out of a leaf, needles of pine
  reflect 0.096 and those of spruce 0.054, PROSPECT's leaf 0.042. Without it the residual of pine's reflectance is 0.018
  instead of 0.009, and both fits have a quarter less chlorophyll than FFT's and Järvselja's needles.
- A species that FFT lacks has the pigments of its nearest measured relative, and the dry matter of its own species file
  (leaf_mass_per_area_kg_per_m2). Its N and water follow from the dry matter, as over all broad leaves of FFT: N rises
  by 49 per g/cm² (711 leaves), water is 1.47 times the dry matter.
- `VARIATION`: FFT's leaves of the crowns' top and bottom over those of all heights, medians over the species with three
  samples or more of each (20 broad-leaved, 8 conifers). Plants differ in chlorophyll by 15%: broad leaves of one
  species, height and plot by 16% (34 leaves of 15 groups), plots' means by 15% (broad leaves) and 16% (needles).

Herbs, spring, autumn and dry leaves lie in the ranges of LOPEX, ANGERS and other sets (Féret et al. 2008, Remote
Sensing of Environment 112, 3030-3043, and 2017): N 1.0 to 3.0, chlorophyll to 110 and carotenoids to 28 µg/cm²,
anthocyanins to 17 µg/cm² and more in red leaves, water 0.004 to 0.05 cm, dry matter 0.0017 to 0.033 g/cm². Chlorophyll
over the season follows Demarez et al. 1999 (International Journal of Remote Sensing 20, 1975-1987: hornbeam, oak and
beech), colours of autumn Merzlyak et al. 2003 (Journal of Experimental Botany 54, 707-714) and Gitelson et al. 2001
(Photochemistry and Photobiology 74, 38-45).
"""

from __future__ import annotations

import numpy as np
import prosail
from tables import GRID_NM, read, write

Leaf = tuple[float, ...]  # N, chlorophyll, carotenoids, anthocyanins (µg/cm²), brown pigments, water (cm), dry (g/cm²)
NEEDLE_N = 1.9
N_PER_DRY = 49.0
WATER_PER_DRY = 1.47


def needle(n: float, chlorophyll: float, carotenoids: float, water: float, dry: float) -> Leaf:
    """A needle of FFT, whose N is at most `NEEDLE_N`."""
    scale = min(NEEDLE_N / n, 1.0)
    return scale * n, scale * chlorophyll, scale * carotenoids, 0.0, 0.0, water, dry


def relative(n: float, chlorophyll: float, carotenoids: float, dry: float, own_dry: float) -> Leaf:
    """A broad leaf of `own_dry` with the pigments of a relative, whose dry matter is `dry`."""
    return n + N_PER_DRY * (own_dry - dry), chlorophyll, carotenoids, 0.0, 0.0, WATER_PER_DRY * own_dry, own_dry


def seasons(summer: Leaf, autumn: Leaf) -> dict[str, Leaf]:
    """All four. `autumn`: N, chlorophyll, carotenoids, anthocyanins, brown pigments.

    A young leaf has half of the chlorophyll and 0.6 of the dry matter, as those of beech and oak.
    """
    n, chlorophyll, carotenoids, _, _, water, dry = summer
    return {
        "spring": (n - 0.08, 0.48 * chlorophyll, 0.55 * carotenoids, 0.3, 0.0, 1.1 * water, 0.6 * dry),
        "summer": summer,
        "autumn": (*autumn, 0.85 * water, 0.9 * dry),
        "dry": (n + 0.5, 1.0, 2.5, 0.8, 1.1, 0.0006, 0.9 * dry),
    }


def evergreen(green: Leaf, brown: float = 1.2) -> dict[str, Leaf]:
    """One leaf for the year, and the dead one."""
    return {"": green, "dry": (green[0] + 0.7, 1.0, 3.0, 0.5, brown, 0.001, green[6])}


THUJA, JUNIPER = (2.18, 51.7, 12.7, 0.0299, 0.0189), (2.79, 73.9, 15.8, 0.0225, 0.0188)
LEAVES: dict[str, dict[str, Leaf]] = {
    "acacia": seasons(relative(1.25, 51.7, 6.8, 0.0048, 0.0120), (1.65, 6, 6.5, 0.0, 0.3)),
    "baobab": seasons(relative(1.19, 45.5, 10.5, 0.0044, 0.0090), (1.55, 4, 7.5, 0.0, 0.3)),
    "beech": {
        "spring": (1.25, 25, 6.5, 0.3, 0.00, 0.0100, 0.0035),
        "summer": relative(1.12, 41.9, 10.4, 0.0029, 0.0065),
        "autumn": (1.50, 3, 6.5, 1.5, 0.50, 0.0080, 0.0055),
        "dry": (1.90, 1, 2.5, 1.5, 1.20, 0.0006, 0.0055),
    },
    "birch": {
        "spring": (1.40, 22, 6.0, 0.0, 0.00, 0.0110, 0.0045),
        "summer": (1.52, 42.9, 9.8, 0.0, 0.00, 0.0102, 0.0048),
        "autumn": (1.60, 4, 8.0, 0.0, 0.08, 0.0085, 0.0060),
        "dry": (2.00, 1, 2.5, 0.5, 0.90, 0.0006, 0.0060),
    },
    "maple": {
        "spring": (1.30, 28, 7.0, 0.8, 0.00, 0.0100, 0.0045),
        "summer": relative(1.24, 42.1, 10.2, 0.0040, 0.0070),
        "autumn": (1.55, 5, 8.0, 5.0, 0.10, 0.0080, 0.0060),
        "dry": (1.95, 1, 2.5, 2.5, 1.00, 0.0006, 0.0060),
    },
    "oak": {
        "spring": (1.35, 24, 6.5, 0.8, 0.00, 0.0105, 0.0060),
        "summer": relative(1.29, 56.0, 9.9, 0.0062, 0.0085),
        "autumn": (1.60, 7, 6.5, 1.0, 0.95, 0.0080, 0.0085),
        "dry": (2.00, 1, 2.5, 1.5, 1.60, 0.0006, 0.0085),
    },
    "poplar": {
        "spring": (1.40, 22, 6.0, 0.5, 0.00, 0.0125, 0.0060),
        "summer": (1.43, 51.3, 11.1, 0.0, 0.00, 0.0092, 0.0072),
        "autumn": (1.60, 3, 8.5, 0.0, 0.06, 0.0100, 0.0080),
        "dry": (2.00, 1, 2.5, 0.8, 1.10, 0.0006, 0.0080),
    },
    "shrub": {
        "spring": (1.35, 24, 6.0, 0.3, 0.00, 0.0090, 0.0035),
        "summer": relative(1.29, 41.9, 9.5, 0.0040, 0.0045),
        "autumn": (1.55, 6, 8.0, 0.3, 0.12, 0.0070, 0.0045),
        "dry": (1.95, 1, 2.5, 0.8, 1.10, 0.0006, 0.0045),
    },
    "bracken": {
        "spring": (1.40, 27, 6.5, 0.0, 0.00, 0.0120, 0.0035),
        "summer": (1.54, 45, 10.0, 0.0, 0.04, 0.0100, 0.0050),
        "autumn": (1.70, 5, 7.0, 0.5, 0.50, 0.0060, 0.0045),
        "dry": (2.20, 1, 2.5, 1.0, 1.50, 0.0005, 0.0045),
    },
    "bramble": {
        "spring": (1.40, 32, 7.5, 0.5, 0.00, 0.0100, 0.0045),
        "summer": (1.51, 60, 13.4, 0.0, 0.01, 0.0090, 0.0060),
        "autumn": (1.55, 24, 9.0, 6.0, 0.06, 0.0085, 0.0060),
        "dry": (2.00, 1, 2.5, 2.0, 1.20, 0.0006, 0.0060),
    },
    "daisy": {
        "spring": (1.50, 38, 8.5, 0.0, 0.00, 0.0210, 0.0045),
        "summer": (1.57, 45, 10.1, 0.0, 0.00, 0.0200, 0.0050),
        "autumn": (1.60, 33, 8.5, 0.3, 0.05, 0.0180, 0.0050),
        "dry": (2.20, 1, 2.5, 0.5, 0.80, 0.0006, 0.0045),
    },
    "fireweed": {
        "spring": (1.45, 32, 7.5, 0.5, 0.00, 0.0130, 0.0040),
        "summer": (1.54, 46, 10.2, 0.0, 0.00, 0.0120, 0.0050),
        "autumn": (1.60, 10, 8.0, 6.0, 0.10, 0.0090, 0.0050),
        "dry": (2.00, 1, 2.5, 2.0, 1.00, 0.0006, 0.0050),
    },
    "grass": {
        "spring": (1.50, 33, 7.5, 0.0, 0.00, 0.0115, 0.0035),
        "summer": (1.62, 41, 9.2, 0.0, 0.08, 0.0100, 0.0040),
        "autumn": (1.75, 18, 7.0, 0.0, 0.20, 0.0075, 0.0040),
        "dry": (2.30, 1, 2.5, 0.0, 0.30, 0.0006, 0.0040),
    },
    "lily": {
        "spring": (1.38, 42, 9.5, 0.0, 0.00, 0.0210, 0.0045),
        "summer": (1.43, 54, 12.0, 0.0, 0.00, 0.0200, 0.0050),
        "autumn": (1.60, 8, 8.0, 0.0, 0.20, 0.0120, 0.0045),
        "dry": (2.20, 1, 2.5, 0.0, 0.80, 0.0006, 0.0045),
    },
    "cecropia": seasons(relative(1.19, 53.2, 10.0, 0.0045, 0.0080), (1.6, 6, 8.0, 0.0, 0.4)),
    "cotton_grass": seasons(relative(1.27, 25.5, 7.5, 0.0051, 0.0080), (1.6, 8, 7.0, 2.0, 0.4)),
    "dwarf_birch": seasons(relative(1.38, 43.9, 11.3, 0.0044, 0.0060), (1.55, 5, 7.5, 6.0, 0.1)),
    "kapok": seasons(relative(1.19, 45.5, 10.5, 0.0044, 0.0080), (1.55, 5, 8.0, 0.0, 0.2)),
    "larch": seasons(needle(1.61, 38.2, 7.7, 0.0160, 0.0090), (1.75, 4, 7.5, 0.0, 0.2)),
    "redgrass": {
        "spring": (1.40, 24, 6.0, 1.0, 0.00, 0.0130, 0.0050),
        "summer": (1.42, 27.6, 6.6, 0.0, 0.00, 0.0125, 0.0058),
        "autumn": (1.60, 8, 6.0, 3.0, 0.30, 0.0080, 0.0058),
        "dry": (2.30, 1, 2.5, 1.0, 0.40, 0.0006, 0.0058),
    },
    "sweetgum": seasons(relative(1.26, 47.1, 14.0, 0.0054, 0.0075), (1.55, 4, 7.0, 9.0, 0.1)),
    "willow": seasons((1.29, 56.0, 10.3, 0.0, 0.0, 0.0088, 0.0070), (1.6, 6, 8.5, 0.0, 0.2)),
    "cypress": evergreen(needle(*THUJA), 2.4),
    "eucalyptus": evergreen((2.00, 41.8, 7.3, 0.0, 0.0, 0.0135, 0.0204)),
    "fan_palm": evergreen((1.57, 54.4, 13.0, 0.0, 0.0, 0.0176, 0.0120)),
    "hemlock": evergreen(needle(1.57, 59.8, 13.6, 0.0151, 0.0110), 2.2),
    "juniper": evergreen(needle(*JUNIPER), 2.4),
    "meranti": evergreen(relative(1.19, 54.4, 13.0, 0.0044, 0.0090)),
    "palm": {"": (1.57, 45, 10.0, 0, 0.19, 0.0150, 0.0130), "dry": (2.30, 1, 3.0, 0.5, 1.20, 0.0008, 0.0130)},
    "pine": {"": (1.86, 45, 9.6, 0.0, 0.05, 0.0346, 0.0147), "dry": (2.60, 1, 3.0, 1.5, 2.20, 0.0010, 0.0200)},
    "rosemary": evergreen(needle(3.04, 59.1, 20.9, 0.0243, 0.0200)),
    "sequoia": evergreen(needle(*(0.5 * (a + b) for a, b in zip(THUJA, JUNIPER, strict=True))), 2.3),
    "spruce": {"": (1.92, 52, 11.6, 0.0, 0.03, 0.0346, 0.0158), "dry": (2.60, 1, 3.0, 1.5, 2.60, 0.0010, 0.0200)},
    "tree_fern": evergreen((1.54, 45, 10.0, 0.0, 0.04, 0.0099, 0.0059)),
}
NAMES = {  # and where the green leaf's numbers come from
    "acacia": "umbrella thorn, Vachellia tortilis; pigments: FFT, Robinia pseudoacacia, n 5",
    "baobab": "African baobab, Adansonia digitata; pigments: FFT, Tilia americana, n 53",
    "beech": "European beech, Fagus sylvatica; pigments: FFT, Fagus grandifolia, n 18",
    "birch": "silver birch, Betula pendula; Hyytiälä, upper side",
    "maple": "sycamore maple, Acer pseudoplatanus; pigments: FFT, Acer saccharum, n 119",
    "oak": "English oak, Quercus robur; pigments: FFT, Quercus alba, n 60",
    "poplar": "trembling poplar, Populus tremuloides; FFT, n 26",
    "shrub": "hazel, Corylus avellana; pigments: FFT, Corylus americana, n 14",
    "bracken": "bracken, Pteridium aquilinum",
    "bramble": "bramble, Rubus fruticosus agg.",
    "daisy": "oxeye daisy and other meadow herbs",
    "fireweed": "fireweed, Chamaenerion angustifolium",
    "grass": "grass",
    "lily": "lily",
    "cecropia": "trumpet tree, Cecropia; pigments: FFT, Ulmus americana, n 10",
    "cotton_grass": "cotton grass, Eriophorum vaginatum; pigments: FFT, Carex, n 1",
    "dwarf_birch": "dwarf birch, Betula nana; pigments: FFT, Betula glandulosa, n 1",
    "kapok": "kapok, Ceiba pentandra; pigments: FFT, Tilia americana, n 53",
    "larch": "European larch, Larix decidua: needles; FFT, Larix laricina, n 4",
    "redgrass": "red grass, Themeda triandra; FFT, Andropogon gerardii, n 2, all by inversion",
    "sweetgum": "sweetgum, Liquidambar styraciflua; pigments: FFT, Nyssa sylvatica of the same wet forests, n 7",
    "willow": "goat willow, Salix caprea; FFT, Populus grandidentata, n 3",
    "cypress": "Mediterranean cypress, Cupressus sempervirens: scales; FFT, Thuja occidentalis, n 50",
    "eucalyptus": "mountain ash, Eucalyptus regnans; Warren et al. 2006; N of a thick leaf with two palisades",
    "fan_palm": "fan palm, Licuala; chlorophyll: median of evergreen broad-leaved forests, Croft et al. 2020, Remote "
    "Sensing of Environment 236, 111479",
    "hemlock": "western hemlock, Tsuga heterophylla: needles; FFT, Tsuga canadensis, n 112",
    "juniper": "common juniper, Juniperus communis: needles; FFT, Juniperus virginiana, n 2, all by inversion",
    "meranti": "light red meranti, Shorea leprosula; chlorophyll: median of evergreen broad-leaved forests, Croft et "
    "al. 2020, Remote Sensing of Environment 236, 111479",
    "palm": "palm",
    "pine": "Scots pine, Pinus sylvestris: needles; mean of Hyytiälä (chlorophyll 44) and FFT (46 by `needle`, n 4)",
    "rosemary": "rosemary, Salvia rosmarinus; FFT, Ledum groenlandicum, an evergreen leaf with rolled margins, n 4",
    "sequoia": "giant sequoia, Sequoiadendron giganteum: needles; FFT, mean of Thuja and Juniperus",
    "spruce": "spruce, Picea: needles; mean of Picea abies in Hyytiälä (chlorophyll 54) and Järvselja (58), and FFT, "
    "Picea mariana and rubens (44, n 47, top and middle of the crowns)",
    "tree_fern": "soft tree fern, Dicksonia antarctica; dry matter and water: Moles et al. 2011",
}
WHITE_PETAL = (3.2, 0.0, 0.0, 0.0, 0.0, 0.0150, 0.0020)
PETALS: dict[str, tuple[tuple[float, ...], tuple[float, ...]]] = {  # colours of reflectance and transmittance
    "flowers/bramble_petal": ((0.60, 0.54, 0.56), (0.22, 0.19, 0.20)),
    "flowers/bramble_stamen": ((0.42, 0.36, 0.18), (0.0, 0.0, 0.0)),
    "flowers/daisy_ray": ((0.62, 0.61, 0.60), (0.20, 0.19, 0.19)),
    "flowers/daisy_disc": ((0.62, 0.42, 0.035), (0.02, 0.015, 0.0)),
    "flowers/fireweed_petal": ((0.42, 0.060, 0.30), (0.28, 0.030, 0.19)),
    "flowers/fireweed_bud": ((0.26, 0.040, 0.12), (0.05, 0.010, 0.03)),
    "flowers/lily_tepal": ((0.62, 0.60, 0.52), (0.26, 0.26, 0.21)),
    "flowers/lily_bud": ((0.42, 0.50, 0.26), (0.06, 0.08, 0.03)),
    "flowers/lily_filament": ((0.50, 0.55, 0.30), (0.0, 0.0, 0.0)),
    "flowers/lily_anther": ((0.55, 0.30, 0.03), (0.0, 0.0, 0.0)),
    "flowers/grass_spikelet": ((0.30, 0.24, 0.15), (0.10, 0.07, 0.04)),
    "fruits/bramble_ripe": ((0.012, 0.008, 0.014), (0.0, 0.0, 0.0)),
    "fruits/bramble_unripe": ((0.30, 0.030, 0.028), (0.0, 0.0, 0.0)),
}
# Factors on N, chlorophyll, carotenoids, water and dry matter of the mean leaf.
VARIATION = {
    "broad": {
        "sun": (1.072, 1.106, 1.054, 1.249, 1.463),
        "shade": (0.938, 0.890, 0.935, 0.824, 0.735),
        "pale": (1.0, 0.85, 0.85, 1.0, 1.0),
    },
    "needle": {
        "sun": (1.136, 0.999, 1.021, 1.071, 1.152),
        "shade": (0.924, 1.002, 1.018, 0.895, 0.873),
        "pale": (1.0, 0.85, 0.85, 1.0, 1.0),
    },
}
MEASURED = {("birch", "summer"): "standards/birch_leaf"}  # in place of PROSPECT's
SURFACE = {"pine": 0.042, "spruce": 0.026}
MEAN_LEAVES = {"broad": "maple", "needle": "spruce"}
SYMBOLS = ("N", "chlorophyll", "carotenoids", "anthocyanins", "brown", "water", "dry matter")


def prospect(parameters: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Reflectance and transmittance on `GRID_NM`."""
    n, chlorophyll, carotenoids, anthocyanins, brown, water, dry = parameters
    wavelength, r, t = prosail.run_prospect(
        n, chlorophyll, carotenoids, brown, water, dry, ant=anthocyanins, prospect_version="D"
    )
    return np.interp(GRID_NM, wavelength, r), np.interp(GRID_NM, wavelength, t)


def leaf(name: str, parameters: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Reflectance and transmittance of a species' leaf."""
    s = SURFACE.get(name, 0.0)
    reflected, passed = prospect(parameters)
    return s + (1 - s) * reflected, (1 - s) * passed


def opaque(reflectance: np.ndarray, transmittance: np.ndarray) -> np.ndarray:
    """Reflectance of endlessly many such leaves on each other (Stokes 1862)."""
    r, t = reflectance, transmittance
    a = 1 + r**2 - t**2
    return np.asarray((a - np.sqrt(a**2 - 4 * r**2)) / (2 * r))


def metadata(what: str, parameters: dict[str, tuple[float, ...]]) -> dict[str, str]:
    """The lines above a table."""
    lines = {
        "what": what,
        "source": "PROSPECT-D (Féret et al. 2017), computed by the PyPI package prosail 2.0.5; not measured",
        "licence": "results of a computation, CC0",
        "date": "2026-11-28",
        "made by": "docs/spectra/make_leaves.py, which has the literature of the parameters",
        "unit": "wavelength in nm; fractions of 1, all directions (hemispherical)",
        "parameters": ", ".join(SYMBOLS) + " (µg/cm²; water cm, dry matter g/cm²; N and brown have no unit)",
    }
    for season, values in parameters.items():
        lines[season or "all year"] = ", ".join(f"{value:g}" for value in values)
    return lines


def main() -> None:
    """Write all tables."""
    for name, seasons in LEAVES.items():
        columns = {}
        for season, parameters in seasons.items():
            suffix = f"_{season}" if season else ""
            measured = MEASURED.get((name, season))
            both = leaf(name, parameters) if measured is None else read(measured)[1:]
            columns[f"reflectance{suffix}"], columns[f"transmittance{suffix}"] = both
        lines = metadata(NAMES[name], seasons)
        for season in seasons:
            if (name, season) in MEASURED:
                lines["source"] += f", but for {season}"
                lines[season] = f"measured, {MEASURED[name, season]}; PROSPECT-D fitted to it has " + lines[season]
        if name in SURFACE:
            lines["surface"] = f"{SURFACE[name]:g} of the light, which the skin reflects beyond PROSPECT's"
        write(f"leaves/{name}", lines, GRID_NM, columns)
    reference = (1.5, 40.0, 8.0, 0.0, 0.0, 0.01, 0.009)
    r, t = prospect(reference)
    write("leaves/prospect_reference", metadata("PROSPECT's own example", {"": reference}), GRID_NM,
          {"reflectance": r, "transmittance": t})  # fmt: skip
    stem = (1.8, 32.0, 8.0, 0.5, 0.12, 0.03, 0.02)
    lines = metadata("green stems and stalks: reflectance of leaves upon leaves without end", {"": stem})
    write("leaves/green_stem", lines, GRID_NM, {"reflectance": opaque(*prospect(stem))})
    for name, (reflected, passed) in PETALS.items():
        write_petal(name, reflected, passed)
    write_variation()


def write_variation() -> None:
    """Reflectance and transmittance of sun, shade and pale leaves over those of the mean leaf."""
    columns = {}
    for kind, leaves in VARIATION.items():
        seasons = LEAVES[MEAN_LEAVES[kind]]
        n, chlorophyll, carotenoids, anthocyanins, brown, water, dry = seasons.get("summer", seasons.get("", ()))
        mean = leaf(MEAN_LEAVES[kind], (n, chlorophyll, carotenoids, anthocyanins, brown, water, dry))
        for name, (f_n, f_ab, f_car, f_w, f_dry) in leaves.items():
            own = f_n * n, f_ab * chlorophyll, f_car * carotenoids, anthocyanins, brown, f_w * water, f_dry * dry
            both = leaf(MEAN_LEAVES[kind], own)
            for side, one, base in zip(("reflectance", "transmittance"), both, mean, strict=True):
                columns[f"{kind}_{name}_{side}"] = (one + 1e-3) / (base + 1e-3)
    lines = {
        "what": "leaves of the crown's top (sun) and bottom (shade) and of plants with 15% less chlorophyll (pale)",
        "source": "PROSPECT-D (Féret et al. 2017) of measured leaves, by prosail 2.0.5; see make_leaves.py",
        "licence": "results of a computation, CC0",
        "date": "2026-11-28",
        "made by": "docs/spectra/make_leaves.py",
        "unit": "wavelength in nm; over the mean leaf of the species, each plus 0.001",
    }
    write("standards/leaf_variation", lines, GRID_NM, columns, form=".4f")


def coloured(colour: tuple[float, ...], beyond: np.ndarray, wavelength_nm: np.ndarray) -> np.ndarray:
    """The smooth spectrum of a colour to 690 nm, another spectrum from 740 nm on."""
    basis_nm, *basis = read("standards/mallett_2019")
    visible = sum(one * np.interp(wavelength_nm, basis_nm, primary) for one, primary in zip(colour, basis, strict=True))
    infrared = np.clip((wavelength_nm - 690.0) / 50.0, 0.0, 1.0)
    infrared = infrared**2 * (3 - 2 * infrared)
    return np.asarray(visible + infrared * (beyond - visible))


def write_petal(name: str, reflected: tuple[float, ...], passed: tuple[float, ...]) -> None:
    """A petal or fruit: its colour's smooth spectrum in visible light, a leaf without pigments in the infrared."""
    r, t = prospect(WHITE_PETAL)
    if not any(passed):
        r, t = opaque(r, t) * (0.5 if name.startswith("fruits") else 0.8), 0.0 * t
    columns = {"reflectance": coloured(reflected, r, GRID_NM)}
    if any(passed):
        columns["transmittance"] = coloured(passed, t, GRID_NM)
    metadata = {
        "what": name.split("/")[1].replace("_", " "),
        "constructed": "to 690 nm the smooth spectrum of its colour in linear Rec. 709 (Mallett and Yuksel 2019), from "
        "740 nm on a leaf without pigments (PROSPECT-D, N 3.2, water 0.015 cm), endlessly many of them times 0.8 "
        "(fruits 0.5) where no light passes; not a measurement",
        "source": f"colour of reflectance {reflected}, of transmittance {passed}; PyPI package prosail 2.0.5",
        "licence": "CC0",
        "date": "2026-11-21",
        "made by": "docs/spectra/make_leaves.py, after make_responses.py",
        "unit": "wavelength in nm; fractions of 1",
    }
    write(name, metadata, GRID_NM, columns)


if __name__ == "__main__":
    main()
