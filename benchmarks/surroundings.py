"""Cost of a stand that goes on beyond its site: `uv run python benchmarks/surroundings.py`; exit 1 above 1.3 times.

For each view three processes, with `site.surroundings` open, repeat and forest, render the same image with all labels
in turn; the first round compiles and loads, and medians are of the others. Time is that of all processors; memory is
the peak of the process. The views look where the site has plants in all cases: from above its middle, along its ground,
and up. What shows more forest and less sky costs more by that alone. `--view up`: that view alone.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
from statistics import median

SIDE_M, ROUNDS, BOUND = 60, 2, 1.3
KINDS = ("open", "repeat", "forest")
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


def serve(surroundings: str, view: str) -> None:
    """For each line read, render an image and print its CPU seconds, instances, and the peak memory so far."""
    from forestgen.core.progress import Silent, Timings
    from forestgen.pipeline import assemble_image, image_frames
    from forestgen.recipe.load import load_recipe_data
    from forestgen.scene.plan import check_plan

    plan = check_plan(load_recipe_data(recipe(surroundings, view), "benchmark"))
    for _ in sys.stdin:
        start = _cpu_s()
        scene = assemble_image(plan, Silent(), Timings())
        for _ in image_frames(scene, Silent(), Timings()):
            pass
        used, peak_gb = _cpu_s() - start, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
        print(json.dumps({"cpu_s": used, "peak_gb": peak_gb, "instances": len(scene.spec.instances)}), flush=True)


def _cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def rendered(view: str) -> dict[str, dict[str, float]]:
    """Of each kind of surroundings what `serve` prints: the medians."""
    command = [sys.executable, __file__, "--view", view, "--serve"]
    servers = {
        kind: subprocess.Popen([*command, kind], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        for kind in KINDS
    }
    rounds: dict[str, list[dict[str, float]]] = {kind: [] for kind in KINDS}
    for _ in range(1 + ROUNDS):
        for kind, server in servers.items():
            print("next", file=server.stdin, flush=True)
            rounds[kind].append(json.loads(server.stdout.readline()))  # type: ignore[union-attr]
    for server in servers.values():
        server.communicate()
    return {kind: {key: median(one[key] for one in found[1:]) for key in found[0]} for kind, found in rounds.items()}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--view", choices=VIEWS)
    parser.add_argument("--serve", choices=KINDS, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.serve:
        serve(arguments.serve, arguments.view)
        return 0
    worst = 0.0
    print("view                        CPU s open  around  ratio   peak GB open  around  ratio   instances")
    for view in [arguments.view] if arguments.view else VIEWS:
        found = rendered(view)
        for kind in KINDS[1:]:
            (cpu, more_cpu), (peak, more_peak), (count, more) = (
                [found[one][key] for one in ("open", kind)] for key in ("cpu_s", "peak_gb", "instances")
            )
            worst = max(worst, more_cpu / cpu, more_peak / peak)
            seconds = f"{cpu:10.1f} {more_cpu:7.1f} {more_cpu / cpu:6.2f}"
            memory = f"{peak:12.2f} {more_peak:7.2f} {more_peak / peak:6.2f}"
            print(f"{view}, {kind:8}".ljust(26), f"{seconds}   {memory}   {count:,.0f} -> {more:,.0f}", flush=True)
    print(f"largest ratio {worst:.2f}, at most {BOUND}")
    return int(worst > BOUND)


if __name__ == "__main__":
    sys.exit(main())
