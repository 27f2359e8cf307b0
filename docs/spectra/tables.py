"""What the scripts beside this file share: how a table of scenes/spectra is read and written, and earthlib's spectra.

Measured spectra are those that the PyPI package earthlib (MIT) ships: bark, wood, litter and sand by field
spectrometers (ASD), from the Joint Fire Science Program, the USGS and Santa Barbara (Herold et al. 2004), at 10 nm.
"""

from __future__ import annotations

import csv
import importlib.util
import re
from pathlib import Path

import numpy as np

SPECTRA = Path(__file__).resolve().parents[2] / "scenes" / "spectra"
GRID_NM = np.arange(400.0, 2501.0, 5.0)
DATE = "2026-11-21"  # of tables with measured spectra
UNIT = "wavelength in nm; fractions of 1"
EARTHLIB = "PyPI package earthlib 1.1.0 (MIT)"


def write(
    name: str, metadata: dict[str, str], wavelength_nm: np.ndarray, columns: dict[str, np.ndarray], form: str = ".5f"
) -> None:
    """Write a table with its provenance; columns (W,) by name, five digits behind the point unless `form` differs."""
    for column, values in columns.items():
        if column.startswith(("reflectance", "transmittance")) and not (values.min() >= 0 and values.max() <= 1):
            raise ValueError(f"{name}: {column} from {values.min():.3f} to {values.max():.3f}")
    lines = [f"# {key}: {text}" for key, text in metadata.items()]
    lines.append(",".join(["wavelength_nm", *columns]))
    for row, wavelength in enumerate(wavelength_nm):
        lines.append(",".join([f"{wavelength:g}", *(f"{values[row]:{form}}" for values in columns.values())]))
    path = SPECTRA / f"{name}.csv"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")


def read(name: str) -> np.ndarray:
    """The columns of a table of scenes/spectra, wavelength in nm first: (C, W)."""
    text = (SPECTRA / f"{name}.csv").read_text(encoding="utf-8")
    return np.array([line.split(",") for line in text.splitlines() if line[0].isdigit()], dtype=float).T


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


def write_measured(library: Library, measured: dict[str, tuple[str, list[str]]], script: str, date: str = DATE) -> None:
    """Tables of measured surfaces: by name what it is, and the spectra; `script`: that makes them."""
    for name, (what, spectra) in measured.items():
        metadata = {
            "what": what,
            "source": f"measured with a field spectrometer; {EARTHLIB}, its spectra {', '.join(spectra)}",
            "licence": "MIT (earthlib)",
            "date": date,
            "made by": f"{script}, which takes the mean where there are several",
            "unit": UNIT + "; where the air's water hides the ground (1350-1460, 1790-1960 nm) there is no row",
        }
        write(name, metadata, library.wavelength_nm, {"reflectance": library.mean(*spectra)})


def colour_weights(wavelength_nm: np.ndarray) -> np.ndarray:
    """(3, W): a reflectance's linear Rec. 709 under D65 as a product; linear between wavelengths."""
    cie, light = read("responses/cie_1931"), read("standards/d65")
    power = np.interp(cie[0], light[0], light[1])
    xyz = cie[1:] * power
    to_rgb = np.array([[3.24097, -1.53738, -0.49861], [-0.96924, 1.87597, 0.04156], [0.05563, -0.20398, 1.05697]])
    weight = to_rgb @ xyz / xyz[1].sum()
    between = np.stack([np.interp(cie[0], wavelength_nm, one) for one in np.eye(len(wavelength_nm))], axis=1)
    return np.asarray(weight @ between)


def mixture(colour: tuple[float, ...], parts: dict[str, np.ndarray], wavelength_nm: np.ndarray) -> dict[str, float]:
    """Weights of spectra that give a colour: none negative, their sum near 1, and as many alike as may be."""
    from scipy.optimize import nnls  # late: not all scripts have it

    weights, spectra = colour_weights(wavelength_nm), np.stack(list(parts.values()), axis=1)
    count = spectra.shape[1]
    rows = np.vstack([100 * weights @ spectra / np.array(colour)[:, None], 3 * np.ones(count), 0.15 * np.eye(count)])
    aim = np.concatenate([100 * np.ones(3), [3], np.zeros(count)])
    found, _ = nnls(rows, aim)
    return {name: float(w) for name, w in zip(parts, found, strict=True) if w > 0.004}
