"""Compiled loops that are kept on disk are made anew when a helper in another file changes."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

HELPER = """
from forestgen.core.compiled import compiled

@compiled
def step():
    return {value}
"""
BETWEEN = """
from forestgen.core.compiled import compiled
from helper import step

@compiled
def twice():
    return 2 * step()
"""
LOOP = """
from between import twice
from forestgen.core.compiled import compiled

@compiled
def total():
    return sum([twice(), 1])

if __name__ == "__main__":
    import loop
    print(loop.total(), sum(loop.total.stats.cache_hits.values()))
"""


def run(folder: Path) -> list[str]:
    done = subprocess.run([sys.executable, "loop.py"], cwd=folder, capture_output=True, text=True, check=True)
    return done.stdout.split()


def test_a_kept_loop_follows_its_helpers(tmp_path: Path) -> None:
    for name, text in (("helper", HELPER.format(value=3)), ("between", BETWEEN), ("loop", LOOP)):
        (tmp_path / f"{name}.py").write_text(text)
    assert run(tmp_path) == ["7", "0"]
    assert run(tmp_path) == ["7", "1"]  # from the disk
    (tmp_path / "helper.py").write_text(HELPER.format(value=5))
    assert run(tmp_path) == ["11", "0"]
