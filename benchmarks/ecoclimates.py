"""What soil water and vegetation do: `uv run python benchmarks/ecoclimates.py FIGURE [--quick] [--seeds N] [--out
FOLDER]`.

FIGURE is one of these, or `all`; numbers of figures are those of seeds 002, chapter 4. Each draws a picture
`FIGURE.png`, prints what it measured and exits with 1 where a bound is missed. `--quick`: fewer years, larger cells.

    patterns     46   five rainfalls: bare ground, spots, labyrinth, gaps, full cover; stripes on a hillside
    persistence  46   spots, labyrinth and gaps through 500 years
    soil         -    a year of 1 km2 in cells of 1.5 m over a terrain: where the water goes, and the cost

So far plants are a density (Rietkerk et al. 2002), without trees and weather: see docs/adr/0012-ecoclimates.md.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from time import perf_counter

from ecoclimate_patterns import patterns, persistence
from ecoclimate_soil import soil
from matplotlib.figure import Figure
from silviculture_stands import Report

from forestgen.community.plots import save_figure

FIGURES: dict[str, Callable[[Report, bool, range], Figure]] = {
    "patterns": patterns,
    "persistence": persistence,
    "soil": soil,
}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("figure", choices=[*FIGURES, "all"])
    parser.add_argument("--quick", action="store_true", help="fewer years, larger cells")
    parser.add_argument("--seeds", type=int, default=3, help="number of seeds, from 0 on")
    parser.add_argument("--out", type=Path, default=Path("out/ecoclimates"), help="folder of the pictures")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    report = Report()
    for name in FIGURES if arguments.figure == "all" else [arguments.figure]:
        start = perf_counter()
        print(name, flush=True)
        path = arguments.out / f"{name}.png"
        save_figure(FIGURES[name](report, arguments.quick, range(max(1, arguments.seeds))), path)
        print(f"  {path}, {perf_counter() - start:.0f} s", flush=True)
    return 1 if report.missed else 0


if __name__ == "__main__":
    sys.exit(main())
