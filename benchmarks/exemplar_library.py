"""What a library of plants saves: `uv run python benchmarks/exemplar_library.py [--quick]`.

The plants of some images of recipes/mixed_stand.yaml, with the recipe's library and without one: seconds an image by
turns, of the first images and of later ones, when most of the library has grown. Nothing is rendered.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from pathlib import Path
from statistics import fmean
from time import perf_counter

from forestgen.community.simulation import final_population
from forestgen.core.progress import Silent
from forestgen.core.threads import limit_cores
from forestgen.plants.growing import forget_shared
from forestgen.recipe.load import LoadedRecipe, load_recipe
from forestgen.scene.build import stand_on
from forestgen.scene.growth import choose_exemplars, grow_planned
from forestgen.scene.plan import make_plan
from forestgen.scene.site import height_field
from forestgen.scene.views import drawn_cameras

RECIPE = Path(__file__).resolve().parents[1] / "recipes" / "mixed_stand.yaml"
IMAGES, QUICK_IMAGES = 60, 8


def plants_s(loaded: LoadedRecipe, index: int) -> float:
    """Seconds for an image's exemplars."""
    plan = make_plan(loaded.draw(index))
    population = stand_on(final_population(plan.community, Silent()), height_field(plan.drawn))
    cameras = [camera for entry in drawn_cameras(plan.drawn) for camera in entry]
    start = perf_counter()
    grow_planned(plan, choose_exemplars(plan, population, cameras), Silent(), population)
    return perf_counter() - start


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help=f"{QUICK_IMAGES} images instead of {IMAGES}")
    images = QUICK_IMAGES if parser.parse_args().quick else IMAGES
    limit_cores(1)
    shared = load_recipe(RECIPE, ["community.cells=256"])
    alone = load_recipe(RECIPE, ["community.cells=256", "plants.library=null", "plants.cache=false"])
    with tempfile.TemporaryDirectory() as folder:
        os.environ["FORESTGEN_CACHE"] = folder
        plants_s(alone, images)  # compiles
        forget_shared()
        rows = [(plants_s(alone, index), plants_s(shared, index)) for index in range(images)]
    quarter = max(1, images // 4)
    for name, some in (("first", rows[:quarter]), ("last", rows[-quarter:]), ("all", rows)):
        own, library = (fmean(column) for column in zip(*some, strict=True))
        ratio = own / library
        print(f"{name:<6}{len(some):4} images: own plants {own:6.2f} s, library {library:6.2f} s, ratio {ratio:5.1f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
