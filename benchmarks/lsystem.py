"""Speed of the L-system engine: `uv run python benchmarks/lsystem.py`.

1. F -> FFF, 14 steps, alternately by forestgen and by npm's `lindenmayer` (fetched into a temporary folder where node
   and npm are there): modules derived a second, the modules of all steps counted. forestgen's program has parametric
   productions too, and once more F carries a parameter.
2. A step of succession of three species at 10,000, 100,000 and 1,000,000 plants: seconds, microseconds a plant, and the
   peak of traced memory above the old state, with that state itself.
"""

from __future__ import annotations

import json
import math
import shutil
import subprocess
import sys
import tempfile
import tracemalloc
from pathlib import Path
from statistics import median
from time import perf_counter

from forestgen.community.models.multiset_lsystem import MODEL, State
from forestgen.community.population import Site, SpeciesEcology
from forestgen.lsystem.compiler import Program, compile_program
from forestgen.lsystem.derivation import derive
from forestgen.lsystem.parsing import parse_text

STEPS = 14
MODULES = (3 ** (STEPS + 1) - 1) // 2 - 1  # of steps 1 to 14
ROUNDS = 5
# The fireweed, poplar and spruce that come with forestgen.
SPECIES = (
    #              name        growth  R     shaded oldage rate  r_1  A_H  c_H
    SpeciesEcology("fireweed", 0.32, 0.50, 0.00, 0.84, 340.0, 0.13, 3.0, 0.7),
    SpeciesEcology("poplar", 0.06, 2.9, 0.55, 0.982, 24.0, 0.05, 9.8, 0.75),
    SpeciesEcology("spruce", 0.05, 3.2, 0.85, 0.9995, 9.0, 0.05, 9.2, 0.93),
)
PEER = """
const module_ = require('lindenmayer'); const LSystem = module_.default || module_;
const system = new LSystem({axiom: 'F', productions: {F: 'FFF'}});
const begin = process.hrtime.bigint();
system.iterate(%d);
const length = system.getString().length;
console.log(JSON.stringify([length, Number(process.hrtime.bigint() - begin) / 1e9]));
"""


def program(rules: str) -> Program:
    return compile_program(parse_text(rules, "benchmark.lsys"))


PLAIN = program("axiom: F\nF --> FFF\nA(x) : x > 1 --> A(x/2)F\n")
PARAMETRIC = program("axiom: F(1)\nF(x) --> F(x/3)F(x/3)F(x/3)\n")


def ours(one: Program) -> float:
    begin = perf_counter()
    for state in derive(one, STEPS, 0):
        length = len(state.multiset.code)
    assert length == 3**STEPS
    return MODULES / (perf_counter() - begin)


def peer(folder: Path) -> float:
    done = subprocess.run(["node", "-e", PEER % STEPS], cwd=folder, check=True, capture_output=True, text=True)
    length, seconds = json.loads(done.stdout)
    assert length == 3**STEPS
    return float(MODULES / seconds)


def has_peer(folder: Path) -> bool:
    if not (shutil.which("node") and shutil.which("npm")):
        print("node or npm is not there: no comparison with lindenmayer")
        return False
    done = subprocess.run(
        ["npm", "install", "--no-audit", "--no-fund", "lindenmayer"], cwd=folder, capture_output=True, check=False
    )
    if done.returncode:
        print("npm cannot fetch lindenmayer: no comparison with it")
    return done.returncode == 0


def rewriting() -> None:
    ours(PLAIN), ours(PARAMETRIC)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        there = has_peer(folder)
        plain, parametric, other = [], [], []
        for _ in range(ROUNDS):
            plain.append(ours(PLAIN))
            parametric.append(ours(PARAMETRIC))
            other.append(peer(folder) if there else math.nan)
    print(f"F -> FFF, n = {STEPS}:      {median(plain) / 1e6:7.1f} M modules/s")
    print(f"F(x) -> 3 F(x/3):       {median(parametric) / 1e6:7.1f} M modules/s")
    print(f"lindenmayer, F -> FFF:  {median(other) / 1e6:7.1f} M modules/s")
    print(f"ratio F -> FFF to lindenmayer: {median(plain) / median(other):.1f}")


def stand(plants: int, steps: int = 40) -> State:
    side = 120.0 * math.sqrt(plants / 1950)
    state = MODEL.init(MODEL.Parameters(), Site((side, side)), SPECIES, 1)
    for _ in range(steps):
        state = MODEL.step(state)
    return state


def succession() -> None:
    base = None
    for plants in (10_000, 100_000, 1_000_000):
        state = stand(plants)
        words = state.derivation.multiset
        n = len(words)
        times = []
        for _ in range(ROUNDS):
            begin = perf_counter()
            MODEL.step(state)
            times.append(perf_counter() - begin)
        held = sum(
            one.nbytes for one in (words.code, words.parameter, words.word_start, words.word_id, words.born_step)
        )
        tracemalloc.start()
        MODEL.step(state)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        each = min(times) / n
        base = base or each
        print(
            f"step of {n:9,} plants: {median(times):6.3f} s (least {min(times):.3f}), {1e6 * each:.2f} us a plant, "
            f"{each / base:.2f} of the smallest stand's; {(held + peak) / n:.0f} bytes a plant at the peak"
        )


if __name__ == "__main__":
    if "--succession" not in sys.argv:
        rewriting()
    succession()
