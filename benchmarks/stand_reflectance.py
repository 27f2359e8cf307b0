"""Nadir reflectance of closed stands in bands of Sentinel-2A, beside measured forests.

    uv run python benchmarks/stand_reflectance.py [--stand spruce] [--samples 64]

Periodic stands of one species, sun 30 degrees from the zenith. Ranges are measured ones: tests/support/
stand_reflectance.py. A stand takes about a minute.
"""

from __future__ import annotations

import argparse

from support.stand_reflectance import BANDS, MEASURED, STANDS, measure


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--stand", choices=STANDS, help="one stand; by default all")
    parser.add_argument("--samples", type=int, default=64, help="light paths a pixel and band")
    arguments = parser.parse_args()
    for name in [arguments.stand] if arguments.stand else STANDS:
        found = measure(STANDS[name], arguments.samples)
        ndvi = (found.factor["B8"] - found.factor["B4"]) / (found.factor["B8"] + found.factor["B4"])
        print(
            f"{name}: LAI {found.leaf_area_index:.1f}, {found.stems_per_ha:.0f} stems/ha, NDVI {ndvi:.2f}", flush=True
        )
        for band in BANDS:
            value, (low, high) = found.factor[band], MEASURED[name][band]
            held = "kept" if low <= value <= high else "MISSED"
            print(f"  {band:<4} {value:.4f} +-{found.error[band]:.4f}   measured {low:.3f} to {high:.3f}   {held}")


if __name__ == "__main__":
    main()
