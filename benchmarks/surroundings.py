"""Cost of a stand that goes on beyond its site: `uv run python benchmarks/surroundings.py`; exit 1 above 1.3 times.

Each view is rendered with all labels in a process of its own, with `site.surroundings` open, repeat and forest in turn.
Time is that of all processors, start-up left out; memory is the process' peak. The views look where the site has plants
in all cases: from above its middle, along its ground, and up. What shows more forest and less sky costs more by that
alone.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
from statistics import median

SIDE_M, ROUNDS, BOUND = 60, 1, 1.3
VIEWS = {
    "from above": {"position_m": [30, 30, 90], "look": "down", "hfov_deg": 30},
    "under the crowns": {"position_m": [30, 6, 1.8], "look_at_m": [30, 50, 6], "hfov_deg": 60, "obstructed": "note"},
    "up": {"kind": "fisheye", "position_m": [30, 30, 1.3], "look": "up", "obstructed": "note"},
}


def recipe(surroundings: str, view: str) -> dict:  # type: ignore[type-arg]
    plants = {
        "spruce": {"plants_per_ha": 300, "radius_m": {"median": 1.6, "sigma": 0.3}},
        "beech": {"plants_per_ha": 350, "radius_m": {"median": 2.0, "sigma": 0.35}},
        "bracken": {"plants_per_ha": 1200, "radius_m": {"median": 0.45, "sigma": 0.3}},
    }
    return {
        "forestgen": 1,
        "site": {"size_m": [SIDE_M, SIDE_M], "terrain": "rolling", "surroundings": surroundings},
        "species": {"spruce": {"from": "spruce"}, "beech": {"from": "beech"}, "bracken": {"from": "bracken"}},
        "community": {"model": "deformation_kernel", "kernels": "inhibition", "cells": 256, "plants": plants},
        "plants": {"exemplars_per_species": 6},
        "cameras": [{"size_px": [160, 120], **VIEWS[view]}],
        "render": {"samples": 16},
    }


def one(surroundings: str, view: str) -> None:
    """Print CPU seconds, by stage where the clock's are known, and the peak memory of one image."""
    from forestgen.core.progress import Silent, Timings
    from forestgen.pipeline import assemble_image, image_frames
    from forestgen.recipe.load import load_recipe_data
    from forestgen.scene.plan import check_plan

    plan = check_plan(load_recipe_data(recipe(surroundings, view), "benchmark"))
    for _ in range(2):  # the first one compiles and loads
        start, timings = _cpu_s(), Timings()
        scene = assemble_image(plan, Silent(), timings)
        for _ in image_frames(scene, Silent(), timings):
            pass
        used = _cpu_s() - start
    found = {"cpu_s": used, "peak_gb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6}
    print(json.dumps({**found, "instances": len(scene.spec.instances), "stages": timings.seconds}))


def _cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def main() -> int:
    worst = 0.0
    print("view                        CPU s open  around  ratio   peak GB open  around  ratio   instances")
    for view in VIEWS:
        runs: dict[str, list[dict]] = {"open": [], "repeat": [], "forest": []}  # type: ignore[type-arg]
        for _ in range(ROUNDS):
            for kind, found in runs.items():
                command = [sys.executable, __file__, kind, view]
                done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
                found.append(json.loads(done.stdout.splitlines()[-1]))
        for kind in ("repeat", "forest"):
            cpu, peak = (
                [median(run[key] for run in runs[one]) for one in ("open", kind)] for key in ("cpu_s", "peak_gb")
            )
            ratios = cpu[1] / cpu[0], peak[1] / peak[0]
            counts = " -> ".join(f"{runs[one][0]['instances']:,}" for one in ("open", kind))
            seconds = f"{cpu[0]:10.1f} {cpu[1]:7.1f} {ratios[0]:6.2f}"
            memory = f"{peak[0]:12.2f} {peak[1]:7.2f} {ratios[1]:6.2f}"
            print(f"{view}, {kind:8}".ljust(26), f"{seconds}   {memory}   {counts}", flush=True)
            worst = max(worst, *ratios)
    print(f"largest ratio {worst:.2f}, at most {BOUND}")
    return int(worst > BOUND)


if __name__ == "__main__":
    if len(sys.argv) > 1:
        one(*sys.argv[1:])
    else:
        sys.exit(main())
