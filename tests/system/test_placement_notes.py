"""Plants that found no place are told of: on the screen and in the manifest, by every command that places them."""

from __future__ import annotations

import json
from pathlib import Path

from command_line import TINY, run

FULL = """\
community:
  model: deformation_kernel
  periodic: false
  kernels: {curve: [[0, 0], [2, 0], [2.1, 1]], distance: metres}
  plants: {fireweed: {count: 40, radius_m: 0.3}}
"""


def full(folder: Path) -> Path:
    path = folder / "full.yaml"
    community = next(line for line in TINY.splitlines(keepends=True) if line.startswith("community:"))
    path.write_text(TINY.replace(community, FULL), encoding="utf-8")
    return path


def test_simulate_and_render_tell_who_found_no_place(tmp_path: Path) -> None:
    recipe = full(tmp_path)
    told = {}
    for verb in ("simulate", "render"):
        answer = run(verb, recipe, "-o", tmp_path / verb)
        assert answer.code == 0, answer.err
        (line,) = (one for one in answer.out.splitlines() if one.startswith("note: "))
        assert "of 40 plants of fireweed were placed: " in line
        folder = tmp_path / "render" / "train" if verb == "render" else tmp_path / verb
        told[verb] = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))["run"]["notes"]
        assert [line.removeprefix("note: ")] == told[verb]
    assert told["render"] == [f"image 0: {told['simulate'][0]}"]
    placed = int(told["simulate"][0].split()[0])
    assert 0 < placed < 40
    statistics = json.loads((tmp_path / "simulate" / "statistics.json").read_text(encoding="utf-8"))
    assert statistics["placement"]["fireweed"]["placed"] == placed
    assert statistics["placement"]["fireweed"]["asked"] == 40
