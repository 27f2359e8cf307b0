"""Placements that cannot be: one clear message, soon, and no memory taken; and those that bar or crowd plants out."""

from __future__ import annotations

import re
import time
from pathlib import Path

import numpy as np
import pytest
from command_line import TINY, Answer, run
from PIL import Image

FOREST = "{model: deformation_kernel, plants: {fireweed: {count: 40}}}"
MODELS = [
    "deformation_kernel", "halftone", "height_field", "jittered_grid", "poisson_disc", "strauss", "thomas", "uniform",
]  # fmt: skip

# What is wrong: the community section.
MISTAKES = {
    "a map of zeros": "{model: uniform, plants: {fireweed: {count: 4, map: dark.png}}}",
    "a map with a hole": "{model: uniform, plants: {fireweed: {count: 4, map: hole.npy}}}",
    "a map of another shape": "{model: uniform, plants: {fireweed: {count: 4, map: square.png}}}",
    "a map of next to nothing": "{model: uniform, plants: {fireweed: {count: 4, map: faint.npy}}}",
    "a map of astronomical values": "{model: uniform, plants: {fireweed: {count: 4, map: [[1.0e+13]]}}}",
    "one of two maps is missing": (
        "{model: uniform, plants: {fireweed: {count: 4, map: {choice: [light.png, lihgt.png]}}}}"
    ),
    "a negative kernel": (
        "{model: deformation_kernel, kernels: {curve: [[0, -1], [1, 1]]}, plants: {fireweed: {count: 4}}}"
    ),
    "no such kernel": "{model: deformation_kernel, kernels: inhibiton, plants: {fireweed: {count: 4}}}",
    "a kernel of nobody": "{model: deformation_kernel, kernels: {daisy: inhibition}, plants: {fireweed: {count: 4}}}",
    "a species in other case": "{model: uniform, plants: {fireweed: {count: 4}, Fireweed: {count: 4}}}",
    "no number": "{model: uniform, plants: {fireweed: {map: light.png}}}",
    "half a plant": "{model: uniform, plants: {fireweed: {count: 0.5}}}",
    "a billion plants": "{model: uniform, plants: {fireweed: {count: 1.0e+9}}}",
    "a trillion plants by a map": "{model: uniform, plants: {fireweed: {plants_per_ha: 1.0e+8, map: [[1.0e+12]]}}}",
    "giants": "{model: uniform, plants: {fireweed: {count: 4, radius_m: 9}}}",
    "a response above 1": "{model: uniform, plants: {fireweed: {count: 4, conditions: {sun: 2}}}}",
    "discs without number": "{model: poisson_disc, distance_m: 0.001, plants: {fireweed: {count: 4}}}",
    "a chain without end": (
        "{model: strauss, sweeps: 100000, interaction_radius_m: 6, plants: {fireweed: {count: 100000}}}"
    ),
    "clusters wider than the site": "{model: thomas, sigma_m: 900, plants: {fireweed: {count: 4}}}",
}


def recipe(folder: Path, community: str) -> Path:
    """A tiny recipe beside some maps."""
    for name, side, value in (("dark", (20, 24), 0), ("light", (20, 24), 9), ("square", (20, 20), 9)):
        Image.fromarray(np.full(side, value, np.uint8)).save(folder / f"{name}.png")
    hole = np.ones((20, 24))
    hole[2, 3] = np.nan
    np.save(folder / "hole.npy", hole)
    np.save(folder / "faint.npy", np.full((20, 24), 5e-324))
    spot = np.zeros((500, 600))
    spot[250, 300] = 1
    np.save(folder / "spot.npy", spot)
    path = folder / "bad.yaml"
    path.write_text(re.sub("community: .*", lambda _: f"community: {community}", TINY), encoding="utf-8")
    return path


def notes_of(answer: Answer) -> str:
    assert answer.code == 0, answer.err
    assert not answer.err
    return "\n".join(line for line in answer.out.splitlines() if line.startswith("note: "))


@pytest.mark.parametrize("name", MISTAKES)
def test_what_cannot_be_placed_is_refused(name: str, tmp_path: Path) -> None:
    path = recipe(tmp_path, MISTAKES[name])
    start = time.process_time()
    run("simulate", path, "-o", tmp_path / "out").refused(2)
    assert time.process_time() - start < 20.0
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("model", MODELS)
def test_a_barred_site_is_told_before_anything_is_simulated(model: str, tmp_path: Path) -> None:
    path = recipe(tmp_path, f"{{model: {model}, keep_out: [[1]], plants: {{fireweed: {{count: 40}}}}}}")
    assert "of fireweed, keep_out bars the whole site" in notes_of(run("validate", path))


def test_discs_that_hardly_find_ground_end(tmp_path: Path) -> None:
    path = recipe(tmp_path, "{model: poisson_disc, plants: {fireweed: {count: 40, map: spot.npy}}}")
    notes = notes_of(run("simulate", path, "-o", tmp_path / "out"))
    assert re.search(r"\d+ of 40 plants of fireweed were placed: no more fit", notes)


def test_many_species_of_one_file_are_read_once(tmp_path: Path) -> None:
    names = [f"s{i}" for i in range(120)]
    plants = ", ".join(f"{name}: {{count: 1}}" for name in names)
    path = recipe(tmp_path, f"{{model: uniform, plants: {{{plants}}}}}")
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace("{fireweed: }", f"{{{', '.join(f'{name}: fireweed' for name in names)}}}"))
    start = time.process_time()
    assert not notes_of(run("validate", path))
    assert time.process_time() - start < 20.0  # reading each took 0.1 s, and ever longer


def test_traits_of_many_plants_are_known_without_placing_them(tmp_path: Path) -> None:
    path = recipe(tmp_path, "{model: uniform, plants: {fireweed: {count: 5000000}}}")
    start = time.process_time()
    run("validate", path, "--set", "plants.traits=[vigour]").refused(2)
    assert time.process_time() - start < 10.0
