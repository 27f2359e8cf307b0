"""The workers of a Dask cluster that take part in a run: who fits, who is refused and why, who comes and goes.

Workers are looked at again every few seconds. Getting one ready (it imports forestgen and is given the work) happens in
threads, so that a slow worker, or one that hangs, keeps no other waiting.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from typing import Any

from forestgen.core.errors import ResourceError
from forestgen.runs.contract import Notice
from forestgen.runs.engines.dask_worker import dismiss, settle

LOOK_EVERY_S = 3.0
SAY_EVERY_S = 60.0  # that there is nobody to work
_SETTLED_AT_ONCE = 16
_LEAVE_WITHIN_S = 5.0
_MOST_NAMED = 5
_MEMORY = "MEMORY"


class Crew:
    """The fitting workers of a cluster.

    Parameters
    ----------
    client : of `distributed`, connected.
    token : the run's; workers that fit offer one of a resource of this name.
    versions : as they are here, `dask_worker.versions`.
    packed : the work, for `dask_worker.settle`.
    resources : resource -> amount that each job takes, as workers declare them.
    job_memory_bytes : that a job takes at its peak; None if it is not known.
    notice : told who comes, goes and is refused.
    """

    def __init__(
        self,
        client: Any,
        token: str,
        versions: Mapping[str, str],
        packed: bytes,
        resources: Mapping[str, float],
        job_memory_bytes: int | None,
        notice: Notice,
    ) -> None:
        self._client, self._token, self._notice = client, token, notice
        self._versions, self._packed = dict(versions), packed
        self._needed = dict(resources)
        self._job_memory_bytes = job_memory_bytes
        self._names: dict[str, str] = {}  # of the workers that fit, by address
        self._refused: dict[str, str] = {}  # address -> why
        self._settling: dict[str, Future[Any]] = {}
        self._threads = ThreadPoolExecutor(_SETTLED_AT_ONCE, "forestgen-settle")
        self._info: dict[str, Any] = {}  # what the scheduler told of each worker, by address
        self._looked = self._said = float("-inf")

    def __len__(self) -> int:
        return len(self._names)

    @property
    def task_resources(self) -> dict[str, float]:
        """What each job takes of its worker."""
        return {**self._needed, self._token: 1}

    def gather(self) -> None:
        """Wait until a worker is ready.

        Raises
        ------
        ResourceError
            When there are workers and none of them fits.
        """
        while True:
            self.look()
            if self._names:
                return
            if self._refused and not self._settling:
                raise self._nobody_fits()
            time.sleep(0.1)

    def look(self) -> None:
        """Take in the workers that have become ready; every few seconds, see who is there."""
        self._take_settled()
        now = time.monotonic()
        if now - self._looked < LOOK_EVERY_S:
            return
        self._looked = now
        self._info = dict(self._client.scheduler_info()["workers"])
        self._notice_lost()
        self._need_memory()
        for address, one in self._info.items():
            if address not in self._names and address not in self._settling and address not in self._refused:
                self._consider(address, one)
        if not self._names and not self._settling and now - self._said > SAY_EVERY_S:
            self._said = now
            there = "none of its workers fits" if self._info else "it has no workers"
            self._notice("waiting", {"message": f"{self._scheduler}: {there}; waiting for one"})

    def dismiss(self) -> None:
        """Let workers forget the run; those that do not answer soon are left as they are."""
        for future in self._settling.values():
            future.cancel()
        if self._names:
            threads = ThreadPoolExecutor(1, "forestgen-dismiss")
            done = threads.submit(self._client.run, dismiss, self._token, workers=list(self._names), on_error="ignore")
            with suppress(Exception):  # they keep a few megabytes until they end
                done.result(_LEAVE_WITHIN_S)
            threads.shutdown(wait=False)
        self._threads.shutdown(wait=False, cancel_futures=True)

    @property
    def _scheduler(self) -> str:
        return f"the Dask scheduler {self._client.scheduler.address}"

    def _notice_lost(self) -> None:
        """Workers that are gone, or were started anew under the same address."""
        info = self._info
        for address in [one for one in self._names if self._token not in info.get(one, {}).get("resources", {})]:
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
            self._client.run, settle, self._token, self._versions, self._packed, workers=[address], on_error="return"
        )

    def _take_settled(self) -> None:
        for address in [one for one, future in self._settling.items() if future.done()]:
            answer = _answer(self._settling.pop(address), address)
            if isinstance(answer, OSError) or address not in self._info:
                continue  # it went, or did not answer: if it is still there, it is asked again
            if answer != "":
                self._refuse(address, self._info[address], _why(answer))
                continue
            self._names[address] = name = _name_of(address, self._info[address])
            self._notice("worker_joined", {"worker": name, "message": f"worker {name} joined"})

    def _refuse(self, address: str, one: Mapping[str, Any], why: str) -> None:
        self._refused[address] = why
        name = _name_of(address, one)
        self._notice("worker_refused", {"worker": name, "message": f"worker {name} is refused: {why}"})

    def _need_memory(self) -> None:
        """Where workers declare memory as a resource, jobs take of it what they are estimated to need."""
        if self._job_memory_bytes is None or any(name.upper() == _MEMORY for name in self._needed):
            return
        for one in self._info.values():
            for name in one["resources"]:
                if name.upper() == _MEMORY:
                    self._needed[name] = float(self._job_memory_bytes)
                    return

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

    def _nobody_fits(self) -> ResourceError:
        rows = [f"{address}: {why}" for address, why in self._refused.items()]
        more = len(rows) - _MOST_NAMED
        return ResourceError(
            f"none of the {len(rows)} Dask workers can do this batch",
            where=str(self._client.scheduler.address),
            got="\n            ".join(rows[:_MOST_NAMED] + ([f"and {more} more"] if more > 0 else [])),
            hint="install the same forestgen, from the same lockfile, on all machines; start workers with what the "
            'jobs take, such as --memory-limit 8GB --resources "GPU=1"',
        )


def _answer(future: Future[Any], address: str) -> Any:
    """What a worker answered: "", why it does not fit, or an exception."""
    try:
        return future.result().get(address, OSError("no answer"))
    except Exception as error:  # noqa: BLE001 - of many kinds: an unpickling worker, a lost connection
        return error


def _why(answer: Any) -> str:
    if isinstance(answer, str):
        return answer
    text = f"{type(answer).__name__}: {answer}"  # Dask may wrap an error in one of its own
    return f"forestgen is not installed there, or another version of it ({text})" if "ModuleNotFound" in text else text


def _name_of(address: str, one: Mapping[str, Any]) -> str:
    """A worker for people: its name, if it has one of its own, and its address."""
    name = str(one.get("name", address))
    return address if name == address else f"{name} ({address})"
