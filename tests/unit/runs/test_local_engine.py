"""The local engine's bookkeeping; with real workers it is met in tests/system/test_batch_faults.py."""

from __future__ import annotations

import os
from multiprocessing import Pipe
from types import SimpleNamespace
from typing import Any

from forestgen.runs.contract import Job
from forestgen.runs.engines.local import LocalEngine, _Worker


def test_what_a_large_worker_has_just_finished_counts() -> None:
    """Its outcome waits in the pipe: it is taken, and only a job that is not done fails for its memory."""
    work: Any = SimpleNamespace(memory_bytes=1, threads=None)
    engine = LocalEngine(work, 1, print)  # type: ignore[arg-type]
    (ours, theirs), (silent, _other) = Pipe(), Pipe()
    killed: list[bool] = []
    process: Any = SimpleNamespace(
        pid=os.getpid(),  # which has more than a byte
        sentinel=silent,
        is_alive=lambda: True,
        kill=lambda: killed.append(True),
        join=lambda timeout=None: None,
    )
    worker = _Worker(process, ours, (Job(0, 0, "train", "key"), 1))
    engine._workers.append(worker)
    theirs.send("done")
    engine._check_bounds()
    assert not killed
    engine._listen(1.0)
    assert engine._outcomes == ["done"]
    worker.task = (Job(1, 1, "train", "key"), 1)
    engine._check_bounds()
    assert killed
    assert [(one.kind, one.job.image) for one in engine._outcomes[1:]] == [("memory", 1)]  # type: ignore[union-attr]
