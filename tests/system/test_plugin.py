"""The package of examples/plugin, installed: the command line knows its parts, and so do worker processes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

from support.plugin import install_plugin

RECIPE = """\
forestgen: 1
seed: 5
site: {size_m: [6, 5], terrain: flat, ground: soil_wet}
species: {fireweed: }
community: {model: plantation, row_m: 1, tree_m: 1}
plants: {exemplars_per_species: 1}
cameras: [{position_m: [3, -1, 1], look_at_m: [3, 3, 0.4], size_px: [32, 24]}]
render: {samples: 1, denoise: false}
labels: {samples: 1}
dataset: {formats: [stems_csv], splits: {train: 1}}
"""


def test_an_installed_package_adds_its_parts_to_the_command_line(tmp_path: Path) -> None:
    (tmp_path / "r.yaml").write_text(RECIPE, encoding="utf-8")
    environment = {**os.environ, "PYTHONPATH": str(install_plugin(tmp_path))}

    def done(*words: str) -> str:
        command = (sys.executable, "-m", "forestgen", *words)
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return done.stdout

    listing = [line.split() for line in done("models").splitlines()]
    for name in ("plantation", "riverside", "stems_csv", "tallest", "spiral"):
        assert [name, "of", "the", "package", "forestgen-plantation", "0.1.0"] in listing
    done("batch", "r.yaml", "--count", "2", "--workers", "2", "--out", "set", "--quiet")
    for frame in ("000000-camera0", "000001-camera0"):
        head, *rows = (tmp_path / "set" / "train" / frame / "stems.csv").read_text(encoding="utf-8").splitlines()
        assert head == "plant_id,pixels,x_m,y_m"
        assert rows
    done("verify", "set", "--quiet")
    said = done("measure", "tallest", "r.yaml", "--key", "trees_per_ha=1000", "--out", "top.json")
    reading = json.loads((tmp_path / "top.json").read_text(encoding="utf-8"))
    assert said.startswith(f"top height {reading['height_m']:.2f} m, the mean of 3 trees")
    climb = "cameras=[{look_at_m: [3, 3, 0.4], rig: {kind: spiral, radius_m: 5, count: 4, top_m: 3}}]"
    assert "4 images" in done("validate", "r.yaml", "--set", climb)
    done("simulate", "r.yaml", "--set", "community={model: riverside, steps: 9}", "--out", "young", "--quiet")
    more = ("--set", "community={model: riverside, steps: 12}", "--out", "old", "--quiet")
    done("simulate", "r.yaml", *more, "--resume", "young/history.parquet")
