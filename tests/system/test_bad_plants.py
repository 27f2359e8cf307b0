"""Plants that cannot be: one clear message, soon, and no memory taken."""

from __future__ import annotations

import resource
import time
from pathlib import Path

import pytest
from command_line import run

from forestgen.recipe.assets import find_asset

# What is wrong: the species, text to replace in its file, and its replacement.
MISTAKES: dict[str, tuple[str, str, str]] = {
    "a curve with one point": (
        "poplar",
        "branch_angle_deg: [[0.2, 80], [0.6, 66], [0.9, 50], [1, 38]]",
        "branch_angle_deg: [[0.2, 80]]",
    ),
    "a negative length": ("poplar", "longest_m: 24", "longest_m: -24"),
    "negative internodes": (
        "poplar",
        "internode_m: [[0, 0.30], [0.8, 0.18], [0.95, 0.14], [1, 0.06]]",
        "internode_m: -0.2",
    ),
    "internodes of a micrometre": (
        "poplar",
        "internode_m: [[0, 0.30], [0.8, 0.18], [0.95, 0.14], [1, 0.06]]",
        "internode_m: 1.0e-6",
    ),
    "a billion leaves": ("oak", "spacing_m: 0.051", "spacing_m: 1.0e-7"),
    "no such shape": ("poplar", "- shape: leaf", "- shape: leef"),
    "no such form": ("daisy", "form: daisy", "form: daysy"),
    "a key of another form": ("daisy", "petals: 42", "lobes: 42"),
    "a silhouette without a name": ("poplar", "silhouette: ovoid", "silhouette: ovod"),
    "a formula with a call": ("poplar", "silhouette: ovoid", "silhouette: {formula: \"open('x')\"}"),
    "no such generator": ("poplar", "generator: silhouette", "generator: silhouete"),
    "a trillion strands": ("beech", "strands: ", "strands: 1000000000000 # "),
    "no strand": ("beech", "strands: ", "strands: 0 # "),
    "a billion growth steps": (
        "poplar",
        "generator: silhouette",
        "variation: {kappa: 0.2, lag: 0.1, growth_steps: 1000000000}\n  generator: silhouette",
    ),
    "no such program": ("lily", "program: lily", "program: lilly"),
    "a snag of negative thickness": ("snag", "top_share: 0.62", "top_share: -1"),
}


def twelve_orders(text: str) -> str:
    """Poplar with its four orders three times over."""
    first, rest = text.split("  orders:\n")
    orders, end = rest.split("  shapes:", 1)
    return first + "  orders:\n" + 3 * orders + "  shapes:" + end


def broken_species(folder: Path, species: str, old: str, new: str) -> Path:
    path = folder / "bad.yaml"
    text = find_asset("species", species, folder=folder, where="test").read_text(encoding="utf-8")
    assert old in text, f"{species} has no {old!r} any more"
    path.write_text(text.replace(old, new), encoding="utf-8")
    return path


def peak_bytes() -> int:
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


@pytest.mark.parametrize("name", MISTAKES)
def test_what_cannot_grow_is_refused(name: str, tmp_path: Path) -> None:
    species, old, new = MISTAKES[name]
    path = broken_species(tmp_path, species, old, new)
    before, start = peak_bytes(), time.monotonic()
    run("plant", path, "--out", tmp_path / "plant.ply").refused(2)
    assert time.monotonic() - start < 20.0
    assert peak_bytes() - before < 500_000_000
    assert [one.name for one in tmp_path.iterdir()] == ["bad.yaml"]


def test_twelve_orders_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "bad.yaml"
    text = find_asset("species", "poplar", folder=tmp_path, where="test").read_text(encoding="utf-8")
    path.write_text(twelve_orders(text), encoding="utf-8")
    run("plant", path, "--out", tmp_path / "plant.ply").refused(2)
