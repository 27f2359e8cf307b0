"""Writes scenes/spectra/leaves, flowers and fruits: reflectance and transmittance by PROSPECT-D.

    uv run --no-project --with prosail python docs/spectra/make_leaves.py

PROSPECT-D (Féret, Gitelson, Noble and Jacquemoud 2017, Remote Sensing of Environment 193, 204-215) as the PyPI package
prosail computes it. Parameters lie in the ranges of measured leaves: LOPEX, ANGERS and other sets in Féret et al. 2008
(Remote Sensing of Environment 112, 3030-3043) and 2017: N 1.0 to 3.0, chlorophyll to 110 and carotenoids to 28 µg/cm²,
anthocyanins to 17 µg/cm² and more in red leaves, water 0.004 to 0.05 cm, dry matter 0.0017 to 0.033 g/cm². Within them,
chlorophyll, N and brown pigments of summer leaves are those that give the species' look; chlorophyll over the season
follows Demarez et al. 1999 (International Journal of Remote Sensing 20, 1975-1987: hornbeam, oak and beech), colours of
autumn Merzlyak et al. 2003 (Journal of Experimental Botany 54, 707-714) and Gitelson et al. 2001 (Photochemistry and
Photobiology 74, 38-45). PROSPECT is a model of flat leaves; needles have a larger N, as in Malenovský et al. 2006
(International Journal of Remote Sensing 27, 5315-5340) for Norway spruce.
"""

from __future__ import annotations

import numpy as np
import prosail
from tables import GRID_NM, SPECTRA, write

SEASONS = ("spring", "summer", "autumn", "dry")
ALL_YEAR = ("", "dry")
# N, chlorophyll, carotenoids, anthocyanins (µg/cm²), brown pigments, water (cm), dry matter (g/cm²)
LEAVES: dict[str, dict[str, tuple[float, ...]]] = {
    "beech": {
        "spring": (1.25, 25, 6.5, 0.3, 0.00, 0.0100, 0.0035),
        "summer": (1.35, 54, 12.0, 0.0, 0.00, 0.0090, 0.0060),
        "autumn": (1.50, 3, 6.5, 1.5, 0.50, 0.0080, 0.0055),
        "dry": (1.90, 1, 2.5, 1.5, 1.20, 0.0006, 0.0055),
    },
    "birch": {
        "spring": (1.40, 22, 6.0, 0.0, 0.00, 0.0110, 0.0045),
        "summer": (1.53, 39, 8.7, 0.0, 0.00, 0.0100, 0.0070),
        "autumn": (1.60, 4, 8.0, 0.0, 0.08, 0.0085, 0.0060),
        "dry": (2.00, 1, 2.5, 0.5, 0.90, 0.0006, 0.0060),
    },
    "maple": {
        "spring": (1.30, 28, 7.0, 0.8, 0.00, 0.0100, 0.0045),
        "summer": (1.40, 56, 12.5, 0.0, 0.03, 0.0090, 0.0070),
        "autumn": (1.55, 5, 8.0, 5.0, 0.10, 0.0080, 0.0060),
        "dry": (1.95, 1, 2.5, 2.5, 1.00, 0.0006, 0.0060),
    },
    "oak": {
        "spring": (1.35, 24, 6.5, 0.8, 0.00, 0.0105, 0.0060),
        "summer": (1.49, 52, 11.7, 0.0, 0.00, 0.0100, 0.0090),
        "autumn": (1.60, 7, 6.5, 1.0, 0.95, 0.0080, 0.0085),
        "dry": (2.00, 1, 2.5, 1.5, 1.60, 0.0006, 0.0085),
    },
    "poplar": {
        "spring": (1.40, 22, 6.0, 0.5, 0.00, 0.0125, 0.0060),
        "summer": (1.51, 42, 9.4, 0.0, 0.00, 0.0120, 0.0090),
        "autumn": (1.60, 3, 8.5, 0.0, 0.06, 0.0100, 0.0080),
        "dry": (2.00, 1, 2.5, 0.8, 1.10, 0.0006, 0.0080),
    },
    "shrub": {
        "spring": (1.35, 24, 6.0, 0.3, 0.00, 0.0090, 0.0035),
        "summer": (1.42, 44, 9.8, 0.0, 0.00, 0.0080, 0.0050),
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
    "palm": {"": (1.57, 45, 10.0, 0.0, 0.19, 0.0150, 0.0130), "dry": (2.30, 1, 3.0, 0.5, 1.20, 0.0008, 0.0130)},
    "pine": {"": (1.95, 100, 20.0, 0.0, 0.02, 0.0300, 0.0200), "dry": (2.60, 1, 3.0, 1.5, 2.20, 0.0010, 0.0200)},
    "spruce": {"": (1.85, 105, 21.0, 0.0, 0.20, 0.0250, 0.0200), "dry": (2.60, 1, 3.0, 1.5, 2.60, 0.0010, 0.0200)},
}
NAMES = {
    "beech": "European beech, Fagus sylvatica",
    "birch": "silver birch, Betula pendula",
    "maple": "maple, Acer",
    "oak": "English oak, Quercus robur",
    "poplar": "poplar, Populus",
    "shrub": "deciduous shrub such as hazel",
    "bracken": "bracken, Pteridium aquilinum",
    "bramble": "bramble, Rubus fruticosus agg.",
    "daisy": "oxeye daisy and other meadow herbs",
    "fireweed": "fireweed, Chamaenerion angustifolium",
    "grass": "grass",
    "lily": "lily",
    "palm": "palm",
    "pine": "Scots pine, Pinus sylvestris: needles",
    "spruce": "Norway spruce, Picea abies: needles",
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
SYMBOLS = ("N", "chlorophyll", "carotenoids", "anthocyanins", "brown", "water", "dry matter")


def prospect(parameters: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Reflectance and transmittance on `GRID_NM`."""
    n, chlorophyll, carotenoids, anthocyanins, brown, water, dry = parameters
    wavelength, r, t = prosail.run_prospect(
        n, chlorophyll, carotenoids, brown, water, dry, ant=anthocyanins, prospect_version="D"
    )
    return np.interp(GRID_NM, wavelength, r), np.interp(GRID_NM, wavelength, t)


def opaque(reflectance: np.ndarray, transmittance: np.ndarray) -> np.ndarray:
    """Reflectance of endlessly many such leaves on each other (Stokes 1862)."""
    r, t = reflectance, transmittance
    a = 1 + r**2 - t**2
    return np.asarray((a - np.sqrt(a**2 - 4 * r**2)) / (2 * r))


def told(what: str, parameters: dict[str, tuple[float, ...]]) -> dict[str, str]:
    """The lines above a table."""
    lines = {
        "what": what,
        "source": "PROSPECT-D (Féret et al. 2017), computed by the PyPI package prosail 2.0.5; not measured",
        "licence": "results of a computation, CC0",
        "date": "2026-11-21",
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
            columns[f"reflectance{suffix}"], columns[f"transmittance{suffix}"] = prospect(parameters)
        write(f"leaves/{name}", told(NAMES[name], seasons), GRID_NM, columns)
    reference = (1.5, 40.0, 8.0, 0.0, 0.0, 0.01, 0.009)
    r, t = prospect(reference)
    write("leaves/prospect_reference", told("PROSPECT's own example", {"": reference}), GRID_NM,
          {"reflectance": r, "transmittance": t})  # fmt: skip
    stem = (1.8, 32.0, 8.0, 0.5, 0.12, 0.03, 0.02)
    lines = told("green stems and stalks: reflectance of leaves upon leaves without end", {"": stem})
    write("leaves/green_stem", lines, GRID_NM, {"reflectance": opaque(*prospect(stem))})
    for name, (reflected, passed) in PETALS.items():
        write_petal(name, reflected, passed)


def coloured(colour: tuple[float, ...], beyond: np.ndarray, wavelength_nm: np.ndarray) -> np.ndarray:
    """The smooth spectrum of a colour to 690 nm, another spectrum from 740 nm on."""
    lines = [line for line in (SPECTRA / "standards/mallett_2019.csv").read_text().splitlines() if line[0].isdigit()]
    basis = np.array([[float(cell) for cell in line.split(",")] for line in lines])
    visible = sum(one * np.interp(wavelength_nm, basis[:, 0], basis[:, k + 1]) for k, one in enumerate(colour))
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
    told = {
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
    write(name, told, GRID_NM, columns)


if __name__ == "__main__":
    main()
