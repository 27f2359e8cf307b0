"""The engine past one machine: `dask.distributed`, on a scheduler that the user has.

Each fitting worker gets the work once, also one that joins later, and does one job at a time (`dask_worker.py`).

A worker that dies: Dask gives its job to another, as often as its setting ``distributed.scheduler.allowed-failures``
allows (3 unless it is changed), and this is no new attempt of ours: on a cluster most workers that go were taken away,
and their jobs are not to blame. A job whose workers keep dying comes back as failed, with all of those deaths counted
among its attempts. A scheduler that is gone ends the run: what was done stays done, and ``--resume`` goes on.

References
----------
distributed.dask.org: "Worker Resources", "Why did my worker die?".
"""

from __future__ import annotations

import json
import pickle
import queue
import secrets
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from forestgen.core.errors import ResourceError
from forestgen.core.registry import registrations
from forestgen.runs.contract import Failed, Job, Notice, Outcome, Work
from forestgen.runs.engines.dask_crew import LOOK_EVERY_S, Crew
from forestgen.runs.engines.dask_worker import Make, do_job, versions

_SCHEMES = ("tcp", "tls", "ws", "wss", "ucx")
_CONNECT_S = 10.0
_RESULT_S = 10.0  # for a small object that its worker says is there
_START_ONE = "start one with `dask scheduler`, and workers with `dask worker tcp://HOST:8786`: docs/clusters.md"


class DaskEngine:
    """See `contract.Engine`.

    Parameters
    ----------
    work : sent to each worker once.
    address : of the scheduler, such as ``tcp://host:8786``, or its scheduler file.
    resources : resource -> amount that each job takes, as workers declare them (``dask worker --resources``).
    job_memory_bytes : that a job takes at its peak, from the estimate; None if it is not known.
    notice : told events ``worker_joined``, ``worker_lost``, ``worker_refused`` and ``waiting``, with a message.
    client : of `distributed`, instead of an address; it is left open.
    make : what does a job; None: `batch.work.make_job`. It must be importable by name on the workers.

    Raises
    ------
    ResourceError
        On entry: no scheduler answers, or none of its workers fits. By `wait`: the scheduler is gone.
    """

    def __init__(
        self,
        work: Work,
        address: str | None,
        *,
        resources: Mapping[str, float] | None = None,
        job_memory_bytes: int | None = None,
        notice: Notice = lambda event, fields: None,
        client: Any = None,
        make: Make | None = None,
    ) -> None:
        self._packed = pickle.dumps((registrations(), pickle.dumps((make, work))))
        self._address, self._client, self._owned = address, client, client is None
        self._resources, self._job_memory_bytes, self._notice = dict(resources or {}), job_memory_bytes, notice
        self._token = f"forestgen-{secrets.token_hex(6)}"
        self._finished: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._jobs: dict[str, tuple[Any, Job, int]] = {}  # task's key -> future, job, attempt

    def __enter__(self) -> DaskEngine:
        if self._owned:
            self._client = _connect(_address_of(self._address))
        self._crew = Crew(
            self._client,
            self._token,
            versions(),
            self._packed,
            self._resources,
            self._job_memory_bytes,
            self._notice,
        )
        try:
            self._crew.gather()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        futures = [future for future, _, _ in self._jobs.values()]
        self._jobs.clear()
        with suppress(Exception):  # the scheduler may be gone
            if self._client.status == "running":
                self._client.cancel(futures, force=True)
                self._crew.dismiss()
        if self._owned:
            with suppress(Exception):
                self._client.close(timeout=_CONNECT_S)

    @property
    def workers(self) -> int:
        return len(self._crew)

    def submit(self, job: Job, attempt: int) -> None:
        key = f"{self._token}-{job.image}-{attempt}-{secrets.token_hex(4)}"
        future = self._client.submit(
            do_job, self._token, job, attempt, key=key, pure=False, resources=self._crew.task_resources
        )
        self._jobs[key] = (future, job, attempt)
        future.add_done_callback(self._finished.put)

    def wait(self, timeout_s: float) -> list[Outcome]:
        end = time.monotonic() + timeout_s
        outcomes: list[Outcome] = []
        while not outcomes:
            self._look()
            left = end - time.monotonic()
            with suppress(queue.Empty):
                outcomes += self._outcome(self._finished.get(timeout=min(max(left, 0.0), LOOK_EVERY_S)))
            if left <= 0:
                break
        with suppress(queue.Empty):
            while True:
                outcomes += self._outcome(self._finished.get_nowait())
        return outcomes

    def _look(self) -> None:
        self._check_scheduler()
        try:
            self._crew.look()
        except Exception as error:
            raise self._gone() from error

    def _outcome(self, future: Any) -> list[Outcome]:
        """What came of a task; nothing if its result must be waited for again."""
        if future.key not in self._jobs:
            return []
        _, job, attempt = self._jobs[future.key]
        if future.status == "cancelled":
            raise self._gone()
        try:
            outcome: Outcome = future.result(timeout=_RESULT_S)
        except TimeoutError:  # its worker died with the result: Dask does the job again
            future.add_done_callback(self._finished.put)
            return []
        except Exception as error:  # noqa: BLE001 - a job's own failures are outcomes: this is Dask's
            outcome = _failed(job, attempt, error)
        del self._jobs[future.key]
        return [outcome]

    def _check_scheduler(self) -> None:
        if self._client.status != "running":
            raise self._gone()

    def _gone(self) -> ResourceError:
        return ResourceError(
            "the Dask scheduler is gone",
            where=str(self._address or self._client),
            hint="see why it ended, start it again, then `resume=True`: what was done is kept",
        )


def _failed(job: Job, attempt: int, error: Exception) -> Failed:
    """A job that Dask has given up; the workers that died of it count as attempts."""
    from distributed.scheduler import KilledWorker

    if not isinstance(error, KilledWorker):
        return Failed(job, attempt, "worker", f"Dask could not do the job: {type(error).__name__}: {error}")
    deaths, last = error.allowed_failures + 1, error.last_worker.address
    message = (
        f"{deaths} Dask workers died while they had this job\n"
        f"  try       the log of the last one, {last}: most often memory ran out (dask worker --memory-limit)"
    )
    return Failed(job, attempt + deaths - 1, "worker", message, worker=str(last))


def _address_of(target: str | None) -> str:
    """The scheduler's address, read from its file if a file is named."""
    if target is None:
        raise ResourceError(
            "the dask engine needs a scheduler", expected="`scheduler='tcp://HOST:8786'`", hint=_START_ONE
        )
    scheme, separator, _ = target.partition("://")
    if separator and scheme not in _SCHEMES:
        raise ResourceError("this is no scheduler's address", expected="tcp://HOST:8786 or tls://HOST:8786", got=target)
    if separator:
        return target
    try:
        return str(json.loads(Path(target).read_text(encoding="utf-8"))["address"])
    except FileNotFoundError as error:
        raise ResourceError(
            "there is no such scheduler file",
            where=target,
            expected="tcp://HOST:8786, or the file of `dask scheduler --scheduler-file FILE`",
            hint=_START_ONE,
        ) from error
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ResourceError("this is no scheduler file of Dask's", where=target, got=str(error)) from error


def _connect(address: str) -> Any:
    try:
        from distributed import Client
    except ImportError as error:
        raise ResourceError(
            "the dask engine needs a package that is not installed", hint="pip install 'forestgen[dask]'"
        ) from error
    try:
        return Client(address, timeout=_CONNECT_S, set_as_default=False, name="forestgen")
    except (OSError, ValueError) as error:  # also TimeoutError
        raise ResourceError(
            "no Dask scheduler answers", where=address, got=str(error).splitlines()[0], hint=_START_ONE
        ) from error
