"""What runs inside a Dask worker.

A worker that fits gets the work once, and a resource that is named after the run, of which it has one: Dask gives the
run's jobs to such workers alone, and one at a time to each, however many threads it has. All jobs of a process run in
one thread of their own, since the renderer keeps state by thread.

A job whose run has been stopped or killed meanwhile puts nothing into the data set: Dask marks the task as cancelled.
"""

from __future__ import annotations

import asyncio
import pickle
import platform
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

from forestgen.core.errors import OutputError
from forestgen.core.registry import register_again
from forestgen.runs.contract import Job, Outcome, StorageBackend, Work

Make = Callable[[Work, Job, int], Outcome]


@dataclass(frozen=True)
class _Site:
    """What a worker's process keeps of a run."""

    make: Make
    work: Work
    thread: ThreadPoolExecutor


_SITES: dict[str, _Site] = {}  # by the run's token


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
    """What differs, for people; "" if nothing that matters does.

    Packages that do not enter the hash may differ; they are named only where the hash differs as well.
    """
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

    Parameters
    ----------
    token : the run's.
    here : `versions` where the run was started.
    packed : pickled pair of the parts that other packages have registered, and of the pickled pair of the function
        that does a job and its work.
    dask_worker : the worker, which Dask fills in.
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
    _SITES[token] = _Site(make, work, ThreadPoolExecutor(1, "forestgen-job"))
    return ""


async def dismiss(token: str, dask_worker: Any) -> None:
    """Forget a run."""
    await dask_worker.set_resources(**{token: 0})
    site = _SITES.pop(token, None)
    if site is not None:
        site.thread.shutdown(wait=False, cancel_futures=True)


def do_job(token: str, job: Job, attempt: int) -> Outcome:
    """The task: a job of a run that this worker is ready for."""
    from distributed import get_worker
    from distributed.worker import thread_state

    worker, key = get_worker(), thread_state.key

    def given_up() -> bool:
        task = worker.state.tasks.get(key)
        return task is None or task.state == "cancelled"

    site = _SITES[token]
    guarded: Any = GuardedStorage(site.work.storage, given_up)
    work = replace(site.work, storage=guarded)
    return site.thread.submit(site.make, work, job, attempt).result()
