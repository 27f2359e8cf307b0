"""What soil water and vegetation do: `uv run python benchmarks/ecoclimates.py FIGURE [--quick] [--seeds N] [--out
FOLDER]`.

FIGURE is one of these, or `all`; numbers of figures are those of seeds 002, chapter 4. Each draws a picture
`FIGURE.png`, prints what it measured and exits with 1 where a bound is missed. `--quick`: fewer years, larger cells;
of trees smaller sites and the first seed alone.

    patterns     46   five rainfalls: bare ground, spots, labyrinth, gaps, full cover; stripes on a hillside
    persistence  46   spots, labyrinth and gaps through 500 years
    forests      46   the same patterns with trees: one stand, five rainfalls; bands through 500 years
    tipping      48   rain that falls slowly or fast on trees, with and without microclimates
    valleys      42   a pioneer and a species that likes it wet, on hills, with and without microclimate
    edges     43, 49  four species in a patch of forest; height of the canopy by distance to the edge
    drought  37, 38, 40   oaks, pines and shrubs in a drought; pines on hills; a tropical forest that turns dry
    clouds       39   the air of a summer's afternoon over four kinds of vegetation
    clearing     41   clouds over a forest, a clearing and its regrowth
    foehn    44, 45   a wind over a ridge: which side is warmer and drier, and which species grow there
    year         -    a year of 100,000 plants on 1 km2 with their weather: cost, and where the water goes
    soil         -    a year of 1 km2 in cells of 1.5 m over a terrain: where the water goes, and the cost

In `patterns` and `persistence` plants are a density (Rietkerk et al. 2002); in all others but `soil` they grow by
branch modules, as the recipes in recipes/ecoclimates/ have it. See docs/adr/0012-ecoclimates.md.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from time import perf_counter

from ecoclimate_air import clearing, clouds, year
from ecoclimate_drought import drought
from ecoclimate_edges import edges
from ecoclimate_foehn import foehn
from ecoclimate_forests import forests
from ecoclimate_patterns import patterns, persistence
from ecoclimate_relief import valleys
from ecoclimate_soil import soil
from ecoclimate_tipping import tipping
from matplotlib.figure import Figure
from silviculture_stands import Report

from forestgen.community.plots import save_figure

FIGURES: dict[str, Callable[[Report, bool, range], Figure]] = {
    "patterns": patterns,
    "persistence": persistence,
    "forests": forests,
    "tipping": tipping,
    "valleys": valleys,
    "edges": edges,
    "drought": drought,
    "clouds": clouds,
    "clearing": clearing,
    "foehn": foehn,
    "year": year,
    "soil": soil,
}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("figure", choices=[*FIGURES, "all"])
    parser.add_argument("--quick", action="store_true", help="fewer years, larger cells; of trees one seed")
    parser.add_argument("--seeds", type=int, default=3, help="number of seeds, from 0 on")
    parser.add_argument("--out", type=Path, default=Path("outputs/ecoclimates"), help="folder of the pictures")
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
