"""The engine past one machine: `dask.distributed`, on a scheduler that the user has.

Each fitting worker gets the work once, also one that joins later, and does one job at a time: with the work it
gets a resource named after the run, of which it has one, and Dask gives the run's jobs to such workers alone, however
many threads they have. All jobs of a process run in one thread of their own, since the renderer keeps state by thread.
A job whose run has been stopped or killed meanwhile puts nothing into the data set: Dask marks the task as cancelled.

A worker that dies: Dask gives its job to another, as often as its setting ``distributed.scheduler.allowed-failures``
allows (3 unless it is changed), and this is no new attempt of ours: on a cluster most workers that go were taken away,
and their jobs are not to blame. A job whose workers keep dying comes back as failed, with all of those deaths counted
among its attempts. A scheduler that is gone ends the run: what was done stays done, and ``--resume`` goes on.

References
----------
distributed.dask.org: "Worker Resources", "Why did my worker die?".
"""

from __future__ import annotations

import asyncio
import json
import pickle
import platform
import queue
import secrets
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from forestgen.core.errors import OutputError, ResourceError
from forestgen.core.registry import register_again, registrations
from forestgen.runs.contract import Failed, Job, Notice, Outcome, StorageBackend, Work

_SCHEMES = ("tcp", "tls", "ws", "wss", "ucx")
_CONNECT_S = 10.0
_RESULT_S = 10.0  # for a small object that its worker says is there
_LOOK_EVERY_S = 3.0
_SAY_EVERY_S = 60.0  # that there are no workers
_SETTLED_AT_ONCE = 16
_LEAVE_WITHIN_S = 5.0
_MOST_NAMED = 5
_MEMORY = "MEMORY"
_START_ONE = "start one with `dask scheduler`, and workers with `dask worker tcp://HOST:8786`: docs/clusters.md"


class DaskEngine:
    """See `contract.Engine`.

    Parameters
    ----------
    work : sent to each worker once.
    address : of the scheduler, such as ``tcp://host:8786``, or its scheduler file.
    make : what does a job, `runs.work.make_job`. It must be importable by name on the workers.
    resources : resource -> amount that each job takes, as workers declare them (``dask worker --resources``).
    job_memory_bytes : that a job takes at its peak, from the estimate; None if it is not known.
    notice : called with events ``worker_joined``, ``worker_lost``, ``worker_refused`` and ``waiting``, with a message.

    Raises `ResourceError`: on entry, no scheduler answers, or none of its workers fits; later, the scheduler is gone.
    """

    def __init__(
        self,
        work: Work,
        address: str | None,
        *,
        make: Make,
        resources: Mapping[str, float] | None = None,
        job_memory_bytes: int | None = None,
        notice: Notice = lambda event, fields: None,
    ) -> None:
        packed = pickle.dumps((registrations(), pickle.dumps((make, work))))
        self._pool = WorkerPool(packed, resources or {}, job_memory_bytes, notice)
        self._address = address
        self._client: Any = None
        self._finished: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._jobs: dict[str, tuple[Any, Job, int]] = {}  # task's key -> future, job, attempt

    def __enter__(self) -> DaskEngine:
        self._client = _connect(_address_of(self._address))
        try:
            self._pool.gather(self._client)
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
                self._pool.dismiss()
        with suppress(Exception):
            self._client.close(timeout=_CONNECT_S)

    @property
    def workers(self) -> int:
        return len(self._pool)

    def submit(self, job: Job, attempt: int) -> None:
        key = f"{self._pool.token}-{job.image}-{attempt}-{secrets.token_hex(4)}"
        future = self._client.submit(
            do_job, self._pool.token, job, attempt, key=key, pure=False, resources=self._pool.task_resources
        )
        self._jobs[key] = (future, job, attempt)
        future.add_done_callback(self._finished.put)

    def wait(self, timeout_s: float) -> list[Outcome]:
        end = time.monotonic() + timeout_s
        outcomes: list[Outcome] = []
        while not outcomes:
            if self._client.status != "running":
                raise self._gone()
            try:
                self._pool.look()
            except Exception as error:
                raise self._gone() from error
            left = end - time.monotonic()
            with suppress(queue.Empty):
                outcomes += self._outcome(self._finished.get(timeout=min(max(left, 0.0), _LOOK_EVERY_S)))
            if left <= 0:
                break
        with suppress(queue.Empty):
            while True:
                outcomes += self._outcome(self._finished.get_nowait())
        return outcomes

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

    def _gone(self) -> ResourceError:
        hint = "see why it ended, start it again, then `resume=True`: what was done is kept"
        return ResourceError("the Dask scheduler is gone", where=str(self._address), hint=hint)


class WorkerPool:
    """The workers of a cluster that take part in a run: who fits, who is refused and why, who comes and goes.

    Workers are looked at again every few seconds. Getting one ready (it imports forestgen and is given the work)
    happens in threads, so that a slow worker, or one that hangs, keeps no other waiting.

    `packed`: the work, for `settle`; `resources`, `job_memory_bytes`, `notice`: see `DaskEngine`.
    """

    def __init__(
        self, packed: bytes, resources: Mapping[str, float], job_memory_bytes: int | None, notice: Notice
    ) -> None:
        self.token = f"forestgen-{secrets.token_hex(6)}"  # the run's; workers that fit offer one of a resource so named
        self._client: Any = None
        self._versions, self._packed, self._notice = versions(), packed, notice
        self._needed = dict(resources)
        self._job_memory_bytes = job_memory_bytes
        self._names: dict[str, str] = {}  # of the workers that fit, by address
        self._refused: dict[str, str] = {}  # address -> why
        self._settling: dict[str, Future[Any]] = {}
        self._threads = ThreadPoolExecutor(_SETTLED_AT_ONCE, "forestgen-settle")
        self._info: dict[str, Any] = {}  # the scheduler's information on each worker, by address
        self._looked = self._said = float("-inf")

    def __len__(self) -> int:
        return len(self._names)

    @property
    def task_resources(self) -> dict[str, float]:
        """What each job takes of its worker."""
        return {**self._needed, self.token: 1}

    def gather(self, client: Any) -> None:
        """Wait until a worker is ready. Raises `ResourceError` if there are workers and none of them fits."""
        self._client = client
        while True:
            self.look()
            if self._names:
                return
            if self._refused and not self._settling:
                rows = [f"{address}: {why}" for address, why in self._refused.items()]
                more = len(rows) - _MOST_NAMED
                raise ResourceError(
                    f"none of the {len(rows)} Dask workers can do this batch",
                    where=str(self._client.scheduler.address),
                    got="\n            ".join(rows[:_MOST_NAMED] + ([f"and {more} more"] if more > 0 else [])),
                    hint="install the same forestgen, from the same lockfile, on all machines; start workers with what "
                    'the jobs take, such as --memory-limit 8GB --resources "GPU=1"',
                )
            time.sleep(0.1)

    def look(self) -> None:
        """Take in the workers that have become ready; every few seconds, see who is there."""
        self._take_settled()
        now = time.monotonic()
        if now - self._looked < _LOOK_EVERY_S:
            return
        self._looked = now
        self._info = dict(self._client.scheduler_info()["workers"])
        self._notice_lost()
        # Where workers declare memory as a resource, jobs take of it what they are estimated to need.
        declared = [name for one in self._info.values() for name in one["resources"] if name.upper() == _MEMORY]
        if declared and self._job_memory_bytes is not None and not any(n.upper() == _MEMORY for n in self._needed):
            self._needed[declared[0]] = float(self._job_memory_bytes)
        for address, one in self._info.items():
            if not any(address in known for known in (self._names, self._settling, self._refused)):
                self._consider(address, one)
        if not self._names and not self._settling and now - self._said > _SAY_EVERY_S:
            self._said = now
            there = "none of its workers fits" if self._info else "it has no workers"
            scheduler = f"the Dask scheduler {self._client.scheduler.address}"
            self._notice("waiting", {"message": f"{scheduler}: {there}; waiting for one"})

    def dismiss(self) -> None:
        """Let workers forget the run; those that do not answer soon are left as they are."""
        for future in self._settling.values():
            future.cancel()
        if self._names:
            threads = ThreadPoolExecutor(1, "forestgen-dismiss")
            done = threads.submit(self._client.run, dismiss, self.token, workers=list(self._names), on_error="ignore")
            with suppress(Exception):  # they keep a few megabytes until they end
                done.result(_LEAVE_WITHIN_S)
            threads.shutdown(wait=False)
        self._threads.shutdown(wait=False, cancel_futures=True)

    def _notice_lost(self) -> None:
        """Workers that are gone, or were started anew under the same address."""
        info = self._info
        for address in [one for one in self._names if self.token not in info.get(one, {}).get("resources", {})]:
            name = self._names.pop(address)
            self._notice("worker_lost", {"worker": name, "message": f"worker {name} was lost"})
        for address in [one for one in self._refused if one not in info]:
            del self._refused[address]

    def _consider(self, address: str, one: Mapping[str, Any]) -> None:
        """Refuse a worker for what it declares, or get it ready."""
        if one["status"] not in ("running", "paused"):
            return
        lacks = self._what_lacks(one)
        if lacks:
            self._refuse(address, one, lacks)
            return
        self._settling[address] = self._threads.submit(
            self._client.run, settle, self.token, self._versions, self._packed, workers=[address], on_error="return"
        )

    def _take_settled(self) -> None:
        for address in [one for one, future in self._settling.items() if future.done()]:
            try:
                answer = self._settling.pop(address).result().get(address, OSError("no answer"))
            except Exception as error:  # noqa: BLE001 - of many kinds: an unpickling worker, a lost connection
                answer = error
            if isinstance(answer, OSError) or address not in self._info:
                continue  # it went, or did not answer: if it is still there, it is asked again
            if answer != "":
                text = answer if isinstance(answer, str) else f"{type(answer).__name__}: {answer}"
                if "ModuleNotFound" in text:  # Dask may wrap an error in one of its own
                    text = f"forestgen is not installed there, or another version of it ({text})"
                self._refuse(address, self._info[address], text)
                continue
            self._names[address] = name = _name_of(address, self._info[address])
            self._notice("worker_joined", {"worker": name, "message": f"worker {name} joined"})

    def _refuse(self, address: str, one: Mapping[str, Any], why: str) -> None:
        self._refused[address] = why
        name = _name_of(address, one)
        self._notice("worker_refused", {"worker": name, "message": f"worker {name} is refused: {why}"})

    def _what_lacks(self, one: Mapping[str, Any]) -> str:
        """What a worker has too little of, "" if nothing."""
        rows = [
            f"a job takes {amount:g} {name}, and it declares {one['resources'].get(name, 0):g}"
            for name, amount in self._needed.items()
            if one["resources"].get(name, 0) < amount
        ]
        limit, needed = int(one["memory_limit"] or 0), self._job_memory_bytes
        if limit and needed is not None and limit < needed:
            rows.append(f"a job takes about {needed / 1e9:.2f} GB of memory, and it may take {limit / 1e9:.2f} GB")
        return "; ".join(rows)


def _name_of(address: str, one: Mapping[str, Any]) -> str:
    """A worker for people: its name, if it has one of its own, and its address."""
    name = str(one.get("name", address))
    return address if name == address else f"{name} ({address})"


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
        expected, hint = "tcp://HOST:8786, or the file of `dask scheduler --scheduler-file FILE`", _START_ONE
        raise ResourceError("there is no such scheduler file", where=target, expected=expected, hint=hint) from error
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


Make = Callable[[Work, Job, int], Outcome]


# What a worker's process keeps of a run, by the run's token.
_SITES: dict[str, tuple[Make, Work, ThreadPoolExecutor]] = {}


class GuardedStorage:
    """A `StorageBackend` in which nothing is changed any more once the job was given up."""

    def __init__(self, storage: StorageBackend, given_up: Callable[[], bool]) -> None:
        self._storage, self._given_up = storage, given_up

    def __getattr__(self, name: str) -> Any:
        if name in ("put_folder", "put_file", "write", "remove") and self._given_up():
            raise OutputError("the run that asked for this job has ended", where=self._storage.name)
        return getattr(self._storage, name)


def versions() -> dict[str, str]:
    """What must be the same on all machines: its name for people -> version or hash."""
    from forestgen.dataset.manifest import package_versions
    from forestgen.runs.records import versions_hash

    return {
        "Python": platform.python_version(),
        "machine": platform.machine(),
        **{name: str(version) for name, version in package_versions().items()},
        "forestgen's code": versions_hash(),
    }


def differences(here: Mapping[str, str], there: Mapping[str, str]) -> str:
    """What differs, for people; "" where the code's hash does not, whatever packages that are not in it do."""
    code = "forestgen's code"
    if here[code] == there.get(code):
        return ""
    rows = [
        f"{name} {there.get(name, 'missing')} (here {value})"
        for name, value in here.items()
        if name != code and there.get(name) != value
    ]
    return ", ".join(rows) or "forestgen's own code: its source files are not the same"


async def settle(token: str, here: Mapping[str, str], packed: bytes, dask_worker: Any) -> str:
    """Make a worker ready for a run; what keeps it from that, "" if nothing does.

    `here`: `versions` where the run was started; `packed`: pickled pair of the parts that other packages have
    registered, and of the pickled pair of the function that does a job and its work; `dask_worker`: Dask fills it in.
    """
    reason = await asyncio.to_thread(_settle, token, here, packed, int(dask_worker.state.nthreads))
    if not reason:
        await dask_worker.set_resources(**{token: 1})
    return reason


def _settle(token: str, here: Mapping[str, str], packed: bytes, threads: int) -> str:
    registered, packed_work = pickle.loads(packed)
    register_again(registered)  # before versions are compared: parts of other packages count among them
    different = differences(here, versions())
    if different:
        return f"its versions differ: {different}"
    make, work = pickle.loads(packed_work)
    if work.threads is None:
        work = replace(work, threads=threads)
    _SITES[token] = make, work, ThreadPoolExecutor(1, "forestgen-job")
    return ""


async def dismiss(token: str, dask_worker: Any) -> None:
    """Forget a run."""
    await dask_worker.set_resources(**{token: 0})
    site = _SITES.pop(token, None)
    if site is not None:
        site[2].shutdown(wait=False, cancel_futures=True)


def do_job(token: str, job: Job, attempt: int) -> Outcome:
    """The task: a job of a run that this worker is ready for."""
    from distributed import get_worker
    from distributed.worker import thread_state

    worker, key = get_worker(), thread_state.key

    def given_up() -> bool:
        task = worker.state.tasks.get(key)
        return task is None or task.state == "cancelled"

    make, work, thread = _SITES[token]
    guarded: Any = GuardedStorage(work.storage, given_up)
    return thread.submit(make, replace(work, storage=guarded), job, attempt).result()
