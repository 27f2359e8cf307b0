"""What a run hands to the estimate, what it refuses, and what it says of images that are missing."""

from __future__ import annotations

import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from forestgen import Recipe, load
from forestgen.core.errors import DatasetError, RecipeError
from forestgen.core.figures import parse_bytes
from forestgen.recipe.assets import recipes_dir
from forestgen.runs import start
from forestgen.runs.contract import Failed, FailureKind, Job, RunOptions
from forestgen.runs.summary import RunSummary
from support.displays import RecordingDisplay
from support.error_messages import raises_error


@pytest.mark.parametrize(("count", "probe", "said"), [(1000, False, True), (10, False, False), (10, True, True)])
def test_measuring_takes_a_minute_and_is_announced(
    count: int, probe: bool, said: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: dict[str, Any] = {}
    monkeypatch.setattr(start, "estimate", lambda *_, **named: given.update(named))
    nothing: Any = SimpleNamespace(loaded=None, settings=None)
    told = RecordingDisplay()
    start._estimate(nothing, count, RunOptions(), told, probe=probe)
    assert ("making some images to measure them" in "".join(told.said)) == said
    assert (given["workers"], given["threads"]) == (None, None)  # the estimate shares the cores out
    assert given["count"] == count


@pytest.mark.parametrize("begin", [Recipe.render, Recipe.batch, Recipe.estimate])
def test_rays_are_traced_on_the_device_that_was_asked_for(
    begin: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[str | None] = []

    def run(*_: object, **__: object) -> None:
        seen.append(os.environ.get("FORESTGEN_TRACING"))

    for name in ("render", "batch", "dry_run"):
        monkeypatch.setattr(start, name, run)
    monkeypatch.delenv("FORESTGEN_TRACING", raising=False)
    begin(load(recipes_dir() / "quickstart.yaml"), tmp_path / "set", device="cuda", progress=False)
    assert seen == ["cuda"]
    assert "FORESTGEN_TRACING" not in os.environ


def summary(failed: tuple[Failed, ...], missing: tuple[int, ...]) -> RunSummary:
    return RunSummary("out", 5, 0, 3, failed, missing, 3, 1000, None, 1.0, notes=("image 4 is damaged",))


def failures(*kinds: FailureKind) -> tuple[Failed, ...]:
    return tuple(Failed(Job(k, k, "train", "key"), 1, kind, "bad") for k, kind in enumerate(kinds))


@pytest.mark.parametrize(
    "kinds",
    [("recipe", "bug"), ("recipe", "time")],
)
def test_images_that_cannot_be_made_are_not_worth_another_run(kinds: tuple[FailureKind, ...]) -> None:
    with raises_error(DatasetError, place="out"):
        start._check_complete(summary(failures(*kinds), (0, 1)))


def test_images_that_are_missing_for_another_reason_are_tried_again() -> None:
    with raises_error(DatasetError, place="out"):
        start._check_complete(summary((), (4,)))
    start._check_complete(summary((), ()))


def test_many_failures_are_counted() -> None:
    with raises_error(DatasetError, place="out"):
        start._check_complete(summary(failures(*["bug"] * 8), tuple(range(8))))


@pytest.mark.parametrize(
    ("options", "where"),
    [
        ({"count": 0}, "count"),
        ({"count": 2.0}, "count"),
        ({"count": True}, "count"),
        ({"workers": 2000}, "workers"),
        ({"threads": -1}, "threads"),
        ({"retries": -1}, "retries"),
        ({"retries": None}, "retries"),
        ({"retries": True}, "retries"),
        ({"timeout": True}, "timeout"),
        ({"engine": "slurm"}, "engine"),
        ({"discard": True}, "discard"),
        ({"resume": True, "overwrite": True}, "overwrite"),
        ({"scheduler": "tcp://x"}, "engine"),
        ({"resources": {"GPU": 1.0}}, "engine"),
        ({"engine": "dask", "workers": 2}, "workers"),
        ({"engine": "dask", "timeout": "3min"}, "timeout"),
        ({"engine": "dask", "worker_memory": "4GB"}, "worker_memory"),
    ],
)
def test_options_that_cannot_be(options: dict[str, Any], where: str) -> None:
    with raises_error(RecipeError, place=where):
        RunOptions(**options).check()


def test_options_that_can() -> None:
    RunOptions().check()
    RunOptions(count=3, resume=True, discard=True, workers=4, threads=1, timeout="3min", worker_memory="4GB").check()
    RunOptions(engine="dask", scheduler="tcp://x", resources={"GPU": 1.0}).check()
    assert RunOptions(worker_memory="4GB").memory_bytes == 4_000_000_000
    assert (RunOptions().memory_bytes, RunOptions().timeout_s) == (None, None)


@pytest.mark.parametrize(
    ("text", "size"),
    [
        ("4GB", 4_000_000_000), ("500 MB", 500_000_000), ("1.5GiB", 3 << 29), ("2g", 2_000_000_000),
        ("100000000", 10**8), (3_000_000_000, 3_000_000_000),
    ],
)  # fmt: skip
def test_sizes(text: str | int, size: int) -> None:
    assert parse_bytes(text, "worker_memory") == size


@pytest.mark.parametrize("text", ["", "GB", "-1GB", "4XB", "0", "four", "1e9"])
def test_what_is_no_size(text: str | int) -> None:
    with raises_error(RecipeError, place="worker_memory"):
        parse_bytes(text, "worker_memory")


@pytest.mark.parametrize(("text", "seconds"), [("90s", 90.0), ("30 min", 1800.0), ("1.5h", 5400.0), (90, 90.0)])
def test_durations(text: str | float, seconds: float) -> None:
    assert RunOptions(timeout=text).timeout_s == seconds


@pytest.mark.parametrize("text", ["", "90", "0s", "-1h", "2 days", "min", 0, -3.0, float("nan"), float("inf")])
def test_what_is_no_duration(text: str | float) -> None:
    with raises_error(RecipeError, place="timeout"):
        _ = RunOptions(timeout=text).timeout_s
