"""What runs in a worker process of the local engine.

Nothing is imported here but the standard library: how many threads the numerical libraries start is settled before
they are loaded.
"""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import pickle
import signal
import sys
import threading
from contextlib import suppress
from multiprocessing.connection import Connection, wait

_THREADS = ("NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")

_PR_SET_PDEATHSIG = 1  # of linux/prctl.h


def serve(pipe: Connection, packed: bytes, threads: int | None) -> None:
    """Do the jobs that come through the pipe, one at a time, until it closes.

    `packed`: the pickled parts that other packages have registered, the function ``(work, job, attempt) -> Outcome``,
    and its work.
    `threads`: of the libraries; None: as they choose.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all processes of a terminal; the run stops this one
    _die_with_the_run()
    threading.Thread(target=_leave_with_the_run, name="leave with the run", daemon=True).start()
    if threads is not None:
        os.environ.update(dict.fromkeys(_THREADS, str(threads)))
    from forestgen.core.registry import register_again  # after the number of threads is settled

    registered, make, work = pickle.loads(packed)
    register_again(registered)
    while True:
        try:
            job, attempt = pipe.recv()
        except EOFError:
            return
        pipe.send(make(work, job, attempt))


def _die_with_the_run() -> None:
    """Ask Linux to kill this process when the run dies: even one that was stopped, or is deep in compiled code.

    Elsewhere the thread below does it. A run that has died just before is noticed by it as well.
    """
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):  # a C library without it
            ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def _leave_with_the_run() -> None:
    """End with a run that was killed: without its lock, no worker may write into the data set."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)
