"""Writes scenes/spectra/responses and standards: sensors, the CIE's observer and daylight, primaries of upsampling.

    uv run --with Py6S==1.9.2 python docs/spectra/make_responses.py

Observer, daylight, primaries and cameras come from colour-science, Sentinel-2 from the tables that Py6S took from ESA.
"""

from __future__ import annotations

import colour
import numpy as np
from colour.recovery import MSDS_BASIS_FUNCTIONS_sRGB_MALLETT2019
from Py6S import PredefinedWavelengths
from tables import write

DATE = "2026-11-21"
COLOUR = f"colour-science {colour.__version__} (PyPI)"
SENTINEL = ("01", "02", "03", "04", "05", "06", "07", "08", "8A", "09", "10", "11", "12")
DRONES = {  # band: centre, full width at half maximum, nm
    "drone_multispectral": (
        "five-band camera of drones, after MicaSense's RedEdge-MX",
        {"blue": (475, 32), "green": (560, 27), "red": (668, 14), "red_edge": (717, 12), "nir": (842, 57)},
    ),
    "drone_p4_multispectral": (
        "five-band camera of drones, after DJI's Phantom 4 Multispectral (450, 560, 650, 730 nm ± 16; 840 nm ± 26)",
        {"blue": (450, 32), "green": (560, 32), "red": (650, 32), "red_edge": (730, 32), "nir": (840, 52)},
    ),
}


def main() -> None:
    """Write all tables."""
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    metadata = {
        "what": "colour matching functions of the CIE 1931 standard observer, 2 degrees",
        "source": f"CIE 018:2019, Table 6, as in {COLOUR}",
        "licence": "published standard; tabulated values as facts",
        "date": DATE,
        "unit": "wavelength in nm; no unit",
    }
    values = np.asarray(observer.values)
    write(
        "responses/cie_1931",
        metadata,
        np.asarray(observer.wavelengths),
        dict(zip("xyz", values.T, strict=True)),
        ".12g",
    )
    daylight = colour.SDS_ILLUMINANTS["D65"]
    metadata |= {"what": "CIE standard illuminant D65, relative power", "source": f"CIE 015:2018, as in {COLOUR}"}
    write("standards/d65", metadata, np.asarray(daylight.wavelengths), {"power": np.asarray(daylight.values)}, ".8g")
    basis = MSDS_BASIS_FUNCTIONS_sRGB_MALLETT2019
    metadata |= {
        "what": "reflectances of the primaries of Rec. 709, which add up to 1",
        "source": f"Mallett and Yuksel 2019, Spectral primary decomposition for rendering, as in {COLOUR}",
    }
    columns = dict(zip(("red", "green", "blue"), np.asarray(basis.values).T, strict=True))
    write("standards/mallett_2019", metadata, np.asarray(basis.wavelengths), columns, ".12g")
    cameras()
    sentinel()
    drones()


def cameras() -> None:
    """Consumer cameras that were measured."""
    sources = {
        "nikon_5100": ("Nikon 5100 (NPL)", "Nikon 5100, measured at the National Physical Laboratory"),
        "sigma_sdmerill": ("Sigma SDMerill (NPL)", "Sigma SD Merrill, measured at the National Physical Laboratory"),
    }
    for name, (key, what) in sources.items():
        camera = colour.MSDS_CAMERA_SENSITIVITIES[key]
        metadata = {
            "what": f"spectral sensitivity of a {what}",
            "source": f"Darrodi et al. 2015, J. Opt. Soc. Am. A 32, 381-391, as in {COLOUR}, BSD-3",
            "licence": "BSD-3-Clause (colour-science)",
            "date": DATE,
            "unit": "wavelength in nm; relative; values below 0, which are noise, set to 0",
        }
        values = np.maximum(np.asarray(camera.values), 0.0)
        columns = dict(zip(("red", "green", "blue"), values.T, strict=True))
        write(f"responses/{name}", metadata, np.asarray(camera.wavelengths), columns, ".6g")


def sentinel() -> None:
    """Sentinel-2A's MSI, on the 2.5 nm of its tables."""
    grid, columns = np.arange(410.0, 2322.6, 2.5), {}
    for band in SENTINEL:
        _, low, high, response = getattr(PredefinedWavelengths, f"S2A_MSI_{band}")
        wavelength = 1000 * np.linspace(low, high, len(response))
        values = np.interp(grid, wavelength, response, left=0.0, right=0.0)
        columns[f"B{band}" if band == "8A" else f"B{int(band)}"] = values
    seen = np.flatnonzero(np.any(list(columns.values()), axis=0))
    keep = np.unique(np.clip(np.concatenate([seen - 1, seen, seen + 1]), 0, len(grid) - 1))
    metadata = {
        "what": "spectral responses of Sentinel-2A's MultiSpectral Instrument, 13 bands",
        "source": "ESA, Sentinel-2 Spectral Response Functions, as tabulated each 2.5 nm in Py6S 1.9.2",
        "licence": "free of use, ESA/Copernicus; tabulated values as facts",
        "date": DATE,
        "unit": "wavelength in nm; relative to the band's largest response",
    }
    write("responses/sentinel2a", metadata, grid[keep], {name: values[keep] for name, values in columns.items()}, ".6g")


def drones() -> None:
    """Cameras of which centres and widths are published, not shapes."""
    for name, (what, bands) in DRONES.items():
        grid = np.arange(400.0, 951.0, 1.0)
        columns = {}
        for band, (centre, width) in bands.items():
            shape = np.exp(-4 * np.log(2) * ((grid - centre) / width) ** 2)
            columns[band] = np.where(shape > 1e-3, shape, 0.0)
        seen = np.any(np.array(list(columns.values())) > 0, axis=0)
        keep = np.convolve(seen, [1, 1, 1], mode="same") > 0
        metadata = {
            "what": what,
            "constructed": "Gaussians of the published centre and full width at half maximum; not measured responses",
            "source": "the maker's data sheet: "
            + ", ".join(f"{band} {centre} ({width}) nm" for band, (centre, width) in bands.items()),
            "licence": "CC0; published numbers as facts",
            "date": DATE,
            "unit": "wavelength in nm; relative",
        }
        write(
            f"responses/{name}", metadata, grid[keep], {band: values[keep] for band, values in columns.items()}, ".5f"
        )


if __name__ == "__main__":
    main()
