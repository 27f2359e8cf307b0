"""Whether ground looks alike as geometry and as paint: `uv run python benchmarks/ground_cover.py [--samples N]`.

For each kind of layer and two covers, seen straight down under two suns: mean radiance of the ground where the layer is
geometry over that where it is painted, in five bands of Sentinel-2. Also the share p of light that meets another thing
of the layer at which both would be equal, by the layer's law (scene/ground_layers/layer.py). Exits with 1 where a ratio
is beyond `tests/support/ground_looks.py` says. Some five minutes on two cores.
"""

from __future__ import annotations

import argparse
import sys

from support.ground_looks import BANDS, LAYERS, LEAST, MOST, looks

COVERS = (0.3, 0.8)
SUNS_DEG = (30.0, 55.0)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=64, help="light paths a pixel")
    parser.add_argument("--layer", choices=sorted(LAYERS), help="this one alone")
    asked = parser.parse_args()
    missed = 0
    print(f"{'layer':<28} {'cover':>5} {'sun':>4}  " + "  ".join(f"{band:>5}" for band in BANDS) + "   p")
    for name in [asked.layer] if asked.layer else LAYERS:
        for cover in COVERS:
            for sun_deg in SUNS_DEG:
                found = looks(LAYERS[name] | {"cover": cover}, sun_deg, asked.samples)
                wrong = any(not LEAST <= one <= MOST for one in found.ratio)
                missed += wrong
                told = "  ".join(f"{one:5.2f}" for one in found.ratio)
                print(
                    f"{name:<28} {cover:5.2f} {sun_deg:4.0f}  {told}   {found.trapped:.2f}{'  MISSED' if wrong else ''}"
                )
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
