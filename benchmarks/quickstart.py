"""The quickstart's time: `uv run python benchmarks/quickstart.py`; exit code 1 if a bound is missed.

Bounds: `forestgen render recipes/quickstart.yaml`, a fresh process with imports and compilation, takes under 90 s of
wall-clock time, and under 40 s of it without light paths.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter

TOTAL_BOUND_S, OUTSIDE_BOUND_S = 90.0, 40.0
ROOT = Path(__file__).resolve().parents[1]


def main() -> int:
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "out"
        recipe = ROOT / "recipes" / "quickstart.yaml"
        start = perf_counter()
        subprocess.run(
            [sys.executable, "-m", "forestgen", "render", str(recipe), "-o", str(target)], check=True, cwd=ROOT
        )
        total = perf_counter() - start
        summary = json.loads((target / "run" / "summary.json").read_text(encoding="utf-8"))
    stages = summary["timings_s"]
    inside = stages["light paths"]
    outside = total - inside
    print()
    for name, spent in sorted(stages.items(), key=lambda item: -item[1]):
        print(f"  {name:<20} {spent:7.2f} s {100 * spent / total:5.1f}%")
    rest = total - sum(stages.values())
    print(f"  {'start-up, the rest':<20} {rest:7.2f} s {100 * rest / total:5.1f}%")
    print(f"total                  {total:7.2f} s (bound {TOTAL_BOUND_S:.0f} s)")
    print(f"without light paths    {outside:7.2f} s (bound {OUTSIDE_BOUND_S:.0f} s)")
    print(f"peak memory            {summary['peak_memory_bytes'] / 1e9:7.2f} GB")
    return int(total >= TOTAL_BOUND_S or outside >= OUTSIDE_BOUND_S)


if __name__ == "__main__":
    sys.exit(main())
