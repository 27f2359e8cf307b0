"""Writes scenes/spectra/standards/water.csv, by which wet ground is dark beyond 1300 nm.

    uv run --no-project --with prosail==2.0.5 python docs/spectra/make_water.py

The coefficients are those of the leaf model PROSPECT-D, as the PyPI package prosail ships them.
"""

from __future__ import annotations

from prosail.spectral_library import get_spectra
from tables import GRID_NM, write

if __name__ == "__main__":
    per_m = 100.0 * get_spectra().prospectd.kw[(GRID_NM - 400).astype(int)]  # from 1/cm at 400, 401, ... nm
    write(
        "standards/water",
        {
            "what": "absorption of liquid water: light fades by exp(-absorption x depth)",
            "source": "PROSPECT-D (Féret et al. 2017), as in the PyPI package prosail 2.0.5",
            "licence": "public data distributed with PROSAIL",
            "date": "2026-11-22",
            "made by": "docs/spectra/make_water.py: each fifth nm",
            "unit": "wavelength in nm; 1/m",
        },
        GRID_NM,
        {"absorption_per_m": per_m},
        ".5g",
    )
