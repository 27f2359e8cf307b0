"""Nadir reflectance in bands of Sentinel-2A, gaps, clumping and leaf profiles of closed stands, beside measured ones.

    uv run python benchmarks/stand_reflectance.py [--stand spruce] [--samples 64]

Endless stands of one species, sun 30 degrees from the zenith. Ranges are measured ones: tests/support/
stand_reflectance.py and stand_structure.py. A stand takes about a minute.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import asdict

from support.stand_reflectance import BANDS, MEASURED, measure
from support.stand_structure import RANGES, STANDS, grown, structure


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--stand", choices=STANDS, help="one stand; by default all")
    parser.add_argument("--samples", type=int, default=64, help="light paths a pixel and band")
    arguments = parser.parse_args()
    for name in [arguments.stand] if arguments.stand else STANDS:
        found = measure(name, arguments.samples)
        ndvi = (found.factor["B8"] - found.factor["B4"]) / (found.factor["B8"] + found.factor["B4"])
        print(f"{name}: NDVI {ndvi:.2f}", flush=True)
        for band in BANDS:
            value, (low, high) = found.factor[band], MEASURED[name][band]
            held = "kept" if low <= value <= high else "MISSED"
            print(f"  {band:<4} {value:.4f} +-{found.error[band]:.4f}   measured {low:.3f} to {high:.3f}   {held}")
        for key, share in asdict(structure(grown(STANDS[name]))).items():
            low, high = RANGES[name].get(key, (math.nan, math.nan))
            held = "" if math.isnan(low) else f"measured {low:.2f} to {high:.2f}   "
            held += "kept" if low <= share <= high else "MISSED" if held else ""
            print(f"  {key:<22} {share:.3f}   {held}", flush=True)


if __name__ == "__main__":
    main()
