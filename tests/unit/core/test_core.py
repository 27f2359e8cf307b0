"""Errors, registries, randomness, frames, timings."""

from __future__ import annotations

import json
import subprocess
import sys
import time

import numpy as np
import pytest

from forestgen.core.errors import ForestgenError, RecipeError
from forestgen.core.frames import look_at
from forestgen.core.progress import Silent, Timings
from forestgen.core.randomness import child_rng, child_seed
from forestgen.core.registry import Registry
from support.error_messages import raises_error


def test_a_message_says_what_it_knows_and_nothing_else() -> None:
    assert str(ForestgenError("it broke")) == "it broke"
    full = ForestgenError("bad value", where="a.yaml:3: seed", expected="a number", got="'x'", hint="no quotes")
    assert str(full).splitlines() == [
        "a.yaml:3: seed: bad value",
        "  expected  a number",
        "  got       'x'",
        "  try       no quotes",
    ]


def test_a_registry_loads_late_and_lists_what_it_has() -> None:
    shapes = {"square": ("math:sqrt", "a root"), "circle": ("no.such.module:x", "round")}
    registry = Registry("shape", shapes, contract="collections.abc:Callable")
    assert registry.ids() == ["circle", "square"]
    assert registry.describe("circle") == "round"
    assert registry.load("square")(9) == 3
    with raises_error(RecipeError, place="x.yaml:1"):
        registry.load("sqare", where="x.yaml:1")


def test_a_seed_belongs_to_a_thing_and_not_to_a_moment() -> None:
    things: list[tuple[str | int, ...]] = [
        ("plant", 1),
        ("plant", 2),
        ("plant", "1"),
        ("plan", "t", 1),
        ("plant1",),
        (),
    ]
    seeds = {child_seed(7, *thing) for thing in things} | {child_seed(8, "plant", 1)}
    assert len(seeds) == len(things) + 1
    assert all(0 <= seed < 2**31 for seed in seeds)
    assert child_rng(7, "plant", 1).random() == child_rng(7, "plant", np.int64(1)).random()
    code = "from forestgen.core.randomness import child_rng as r; print(r(7, 'plant', 1).integers(0, 2**62))"
    other = subprocess.run(
        [sys.executable, "-c", code], env={"PYTHONHASHSEED": "1"}, capture_output=True, text=True, check=True
    )
    assert json.loads(other.stdout) == int(child_rng(7, "plant", 1).integers(0, 2**62))


def test_seeds_are_uniform() -> None:
    seeds = np.array([child_seed(0, "image", k) for k in range(20_000)]) / 2**31
    counts, _ = np.histogram(seeds, bins=20, range=(0, 1))
    chi2 = float(((counts - 1000) ** 2 / 1000).sum())
    assert chi2 < 49.6  # the 0.01% point of 19 degrees of freedom


@pytest.mark.parametrize("target", [(0, 5, 0), (5, 0, 0), (3, -4, 2), (0, 0, -5), (0, 0, 5), (1e-9, 0, -5)])
def test_a_camera_looks_along_its_z_with_y_down(target: tuple[float, float, float]) -> None:
    axes = look_at((1.0, 2.0, 3.0), tuple(np.add((1.0, 2.0, 3.0), target)))
    assert axes.T @ axes == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1.0)
    assert axes[:, 2] == pytest.approx(np.array(target) / np.linalg.norm(target))
    if abs(axes[2, 2]) < 0.99:
        assert axes[2, 1] < 0  # y points down
        assert axes[2, 0] == pytest.approx(0, abs=1e-12)  # and the horizon is level


def test_timings_add_up_even_when_work_fails() -> None:
    timings = Timings()

    def fail() -> None:
        with timings("a"):
            time.sleep(0.01)
            raise ZeroDivisionError

    for _ in range(2):
        with pytest.raises(ZeroDivisionError):
            fail()
    assert 0.02 <= timings.seconds["a"] <= timings.total()


def test_silence() -> None:
    with Silent().stage("a", 3) as advance:
        advance(3)
