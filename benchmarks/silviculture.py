"""What forests of branch modules measure: `uv run python benchmarks/silviculture.py FIGURE [--quick] [--out FOLDER]`.

FIGURE is one of these, or `all`; numbers of figures and tables are those of Makowski 2023. Each grows its stands, draws
a picture `FIGURE.png`, prints what it measured and exits with 1 where a bound is missed. `--quick`: smaller
or younger stands. Processor time of `logistic` and `allometry`, which have one stand: 4 minutes, quick 1.

    logistic     18b  wood of a thousand pines against the logistic curve
    thinning     17   mean mass against density of plants over 5 cm: -3/2
    allometry    19   height and leaf mass against trunk diameter
    gaps         12   pioneers take a gap, the climax species comes back
    succession   3    shrub, pine, tolerant tree
    clustering   9    the smaller the seeding radius, the more clustered (Table 2)
    elevation    16   belts on a mountain (Table 2)
    biomes       T4   stems, height, wood and species of the biomes (Table 4)
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from time import perf_counter
from typing import Any

from silviculture_biomes import biomes, zones
from silviculture_figures import allometry, crowd, logistic, pines, thinning
from silviculture_forests import clustered, elevation, gapped, gaps, mountain, patterns, stages, succession
from silviculture_stands import Report

from forestgen.community.plots import save_figure

Figures = dict[str, tuple[Callable[[bool], Any], Callable[[Report, Any], Any]]]
grown = cache(pines)  # one stand for two figures
FIGURES: Figures = {
    "logistic": (grown, logistic),
    "thinning": (crowd, thinning),
    "allometry": (grown, allometry),
    "gaps": (gapped, gaps),
    "succession": (stages, succession),
    "clustering": (patterns, clustered),
    "elevation": (mountain, elevation),
    "biomes": (zones, biomes),
}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("figure", choices=[*FIGURES, "all"])
    parser.add_argument("--quick", action="store_true", help="smaller or younger stands")
    parser.add_argument("--out", type=Path, default=Path("outputs/silviculture"), help="folder of the pictures")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    report = Report()
    for name in FIGURES if arguments.figure == "all" else [arguments.figure]:
        stand, measure = FIGURES[name]
        start = perf_counter()
        print(name, flush=True)
        path = arguments.out / f"{name}.png"
        save_figure(measure(report, stand(arguments.quick)), path)
        print(f"  {path}, {perf_counter() - start:.0f} s", flush=True)
    return 1 if report.missed else 0


if __name__ == "__main__":
    sys.exit(main())
