"""What the command hands to the estimate and says of it, and what it tells at the end."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from forestgen.cli.batch_command import Asked

from forestgen.cli import batch_command
from forestgen.runs.contract import Failed, FailureKind, Job
from forestgen.runs.discards import Standing
from forestgen.runs.summary import BatchSummary


def asked(count: int = 1000, workers: int | None = None, threads: int | None = None) -> Asked:
    return Asked(
        recipe=Path("r.yaml"), overrides=(), count=count, target="out", resume=False, discard=False, workers=workers,
        threads=threads, memory_bytes=None, timeout_s=None, retries=2, engine="local", scheduler=None, resources={},
    )  # fmt: skip


@pytest.mark.parametrize(("count", "probe", "said"), [(1000, False, True), (10, False, False), (10, True, True)])
def test_measuring_is_told_where_no_bar_shows_it(
    count: int, probe: bool, said: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    given: dict[str, Any] = {}
    monkeypatch.setattr(batch_command, "estimate", lambda *_, **named: given.update(named))
    nothing: Any = None
    batch_command._expect(asked(count), nothing, nothing, Standing(0, 0, frozenset()), probe=probe)
    assert ("making some images to measure them" in capsys.readouterr().err) == said
    assert (given["workers"], given["threads"]) == (None, None)  # the estimate shares the cores out


@pytest.mark.parametrize(
    ("kinds", "hint"),
    [(("recipe", "bug"), "fail again in the same way"), (("recipe", "time"), "--resume tries them again")],
)
def test_images_that_cannot_be_made_are_not_worth_another_run(kinds: tuple[FailureKind, ...], hint: str) -> None:
    failed = tuple(Failed(Job(k, k, "train", "key"), 1, kind, "bad") for k, kind in enumerate(kinds))
    summary = BatchSummary("out", 5, 0, 3, failed, (0, 1), 3, 1000, None, 1.0)
    assert hint in str(batch_command._incomplete(summary))
