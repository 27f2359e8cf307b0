"""The stands of the biomes' recipes beside published bounds: `uv run python benchmarks/biome_stands.py [BIOME ...]`.

Prints a line for each measure of `support.biome_bounds`, in half a minute to two a biome. Exits with 1 if one is
missed.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import asdict
from time import perf_counter

from silviculture_stands import Report

from support.biome_bounds import BIOMES, SOURCES, measured


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("biome", nargs="*", choices=[[], *BIOMES], help="all by default")
    parser.add_argument("--set", nargs="*", default=[], metavar="KEY=VALUE", help="keys of the recipes")
    arguments = parser.parse_args()
    report = Report()
    for name in arguments.biome or BIOMES:
        start = perf_counter()
        figures = asdict(measured(name, tuple(arguments.set)))
        print(f"{name}: {SOURCES[name]}; {perf_counter() - start:.0f} s", flush=True)
        for key, value in figures.items():
            low, high = getattr(BIOMES[name], key)
            report.check(key, f"{value:.2f}", low <= value <= high, f"{low:g} to {high:g}")
    return 1 if report.missed else 0


if __name__ == "__main__":
    sys.exit(main())
