"""What the scripts beside this file share: how a table of scenes/spectra is read and written."""

from __future__ import annotations

from pathlib import Path

import numpy as np

SPECTRA = Path(__file__).resolve().parents[2] / "scenes" / "spectra"
GRID_NM = np.arange(400.0, 2501.0, 5.0)


def write(
    name: str, told: dict[str, str], wavelength_nm: np.ndarray, columns: dict[str, np.ndarray], form: str = ".5f"
) -> None:
    """Write a table with its provenance; columns (W,) by name, five digits behind the point unless `form` differs."""
    for column, values in columns.items():
        if column.startswith(("reflectance", "transmittance")) and not (values.min() >= 0 and values.max() <= 1):
            raise ValueError(f"{name}: {column} from {values.min():.3f} to {values.max():.3f}")
    lines = [f"# {key}: {text}" for key, text in told.items()]
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
