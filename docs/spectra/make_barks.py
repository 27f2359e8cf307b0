"""Writes scenes/spectra/bark, wood, stems and fruits.

    uv run --no-project --with prosail --with earthlib==1.1.0 python docs/spectra/make_barks.py

Where no measurement of a surface was to be had, its table is a mixture of earthlib's measured spectra with weights that
give the colour that the species is known by, and its header says "constructed".
"""

from __future__ import annotations

import numpy as np
from make_leaves import coloured, opaque, prospect
from tables import DATE, EARTHLIB, GRID_NM, UNIT, Library, colour_weights, mixture, write, write_measured

SCRIPT = "docs/spectra/make_barks.py"
MEASURED = {
    "bark/oak": ("bark of California black oak, Quercus kelloggii", ["kellbark"]),
    "bark/coulter_pine": ("bark of Coulter pine, Pinus coulteri", ["coulbark"]),
    "bark/dead_birch": ("bark of a dead birch", ["dedbirch"]),
    "bark/dead_aspen": ("bark of a dead aspen", ["dedaspen"]),
    "bark/dead_spruce": ("bark of a dead spruce", ["dedspruc"]),
}
FALLEN = {
    "wood/fallen": (
        "dead wood on the ground, old and weathered",
        ["deadwood", "oldwood", "wdslash", "MCON_Tower_CWD2_Canopy"],
    ),
}
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
WHITE_LAYER = 0.68  # of the bark's blackness that is left under a birch's white layer


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
        metadata = {
            "what": name.split("/")[1].replace("_", " "),
            "constructed": f"a mixture of spectra with the colour that the species is known by, "
            f"{', '.join(f'{x:g}' for x in colour)} in linear Rec. 709; not a measurement of this surface",
            "source": f"{EARTHLIB}, names of its measured spectra; PROSPECT-D where it says so: "
            + ", ".join(f"{w:.3f} {part}" for part, w in weights.items()),
            "licence": "MIT (earthlib); the mixture CC0",
            "date": DATE,
            "made by": SCRIPT,
            "unit": UNIT,
        }
        print(name, np.round(got, 3), colour, f"sum {sum(weights.values()):.2f}", f"peak {values.max():.2f}")  # noqa: T201
        write(name, metadata, library.wavelength_nm, {"reflectance": values})


def write_birch(library: Library) -> None:
    """White bark of a living birch."""
    birch = 1 - WHITE_LAYER * (1 - library.mean("dedbirch"))
    metadata = {
        "what": "white bark of a living birch",
        "constructed": f"1 - {WHITE_LAYER} (1 - R), R the measured bark of a dead birch: fresh bark is whiter; the "
        "factor gives a reflectance of 0.55 in green light",
        "source": f"{EARTHLIB}, its spectrum dedbirch",
        "licence": "MIT (earthlib); the change CC0",
        "date": DATE,
        "made by": SCRIPT,
        "unit": UNIT,
    }
    write("bark/birch", metadata, library.wavelength_nm, {"reflectance": birch})


def write_living_barks(library: Library) -> None:
    """Bark of living trees: its colour, and the infrared of measured branches."""
    for name, (colour, species) in LIVING_BARKS.items():
        branch = np.interp(library.wavelength_nm, BRANCH_NM, np.mean([BRANCHES[one] for one in species], axis=0))
        metadata = {
            "what": name.split("/")[1].replace("_", " "),
            "constructed": f"to 690 nm the smooth spectrum of its colour, {', '.join(f'{x:g}' for x in colour)} in "
            f"linear Rec. 709 (Mallett and Yuksel 2019), from 740 nm on measured branches of {', '.join(species)}",
            "source": "Juola, Rautiainen and Hovi 2025, Data in Brief 63, 112255, at 18 wavelengths",
            "licence": "facts of a publication; the rest CC0",
            "date": "2026-11-28",
            "made by": SCRIPT,
            "unit": UNIT,
        }
        write(name, metadata, library.wavelength_nm, {"reflectance": coloured(colour, branch, library.wavelength_nm)})


def write_pine_upper(library: Library) -> None:
    """The orange bark of a Scots pine's upper stem."""
    colour = (0.300, 0.135, 0.055)
    metadata = {
        "what": "thin orange bark of a Scots pine's upper stem, Pinus sylvestris",
        "constructed": f"to 690 nm the smooth spectrum of its colour, {colour} in linear Rec. 709 (Mallett and Yuksel "
        "2019), from 740 nm on a measured inner bark; not a measurement of this surface",
        "source": f"{EARTHLIB}, its spectrum innrbark",
        "licence": "MIT (earthlib); the rest CC0",
        "date": DATE,
        "made by": SCRIPT,
        "unit": UNIT,
    }
    values = coloured(colour, library.mean("innrbark"), library.wavelength_nm)
    write("bark/pine_upper", metadata, library.wavelength_nm, {"reflectance": values})


def main() -> None:
    """Write all tables."""
    library = Library()
    write_measured(library, MEASURED, SCRIPT)
    write_measured(library, FALLEN, SCRIPT, "2026-11-29")
    write_birch(library)
    write_mixtures(library)
    write_living_barks(library)
    write_pine_upper(library)


if __name__ == "__main__":
    main()
