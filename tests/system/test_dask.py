"""The Dask engine on a real scheduler with worker processes, on loopback."""

from __future__ import annotations

import hashlib
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import batch_pieces
import dask_jobs
import pytest

from forestgen.core.errors import ForestgenError, ResourceError
from forestgen.dataset.settings import data_set_of
from forestgen.runs.contract import Done, Failed, Job, Outcome, Work
from forestgen.runs.engines.dask import DaskEngine
from forestgen.runs.records import versions_hash
from forestgen.runs.storage import LocalStorage
from support.error_messages import raises_error
from support.tiers import few

_BOUND_S = 240.0  # of anything here
_STRANGE_PYTHON = "import platform\nplatform.python_version = lambda: '3.10.99'\n"
_NO_FORESTGEN = """
import sys
class Hidden:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == "forestgen":
            raise ModuleNotFoundError("No module named 'forestgen'", name="forestgen")
sys.meta_path.insert(0, Hidden())
"""


class Cluster:
    """A scheduler and workers, each a process."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.doomed = folder / "doomed"
        self.doomed.mkdir()
        self.processes: list[subprocess.Popen[bytes]] = []
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        self.address = f"tcp://127.0.0.1:{port}"
        self.file = folder / "scheduler.json"
        self.scheduler = self._start("scheduler", "--host", "127.0.0.1", "--port", str(port))

        until(self.file.exists)

    def worker(self, *options: str, startup: str = "") -> subprocess.Popen[bytes]:
        """Start a worker; `startup` is Python that runs in it before anything else."""
        options = ("--no-nanny", "--nthreads", "1", "--death-timeout", "60", *options)
        return self._start("worker", self.address, *options, startup=startup)

    def stop(self) -> None:
        for process in self.processes:
            process.kill()
            process.wait()

    def _start(self, what: str, *options: str, startup: str = "") -> subprocess.Popen[bytes]:
        number = len(self.processes)
        home = self.folder / f"{what}-{number}"
        home.mkdir()
        (home / "sitecustomize.py").write_text(startup)
        paths = [str(home), str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")]
        command = [sys.executable, "-m", f"distributed.cli.dask_{what}", "--no-dashboard", *options]
        command += ["--scheduler-file", str(self.file)] if what == "scheduler" else ["--local-directory", str(home)]
        with (home / "log").open("wb") as log:
            process = subprocess.Popen(
                command,
                env={
                    **os.environ,
                    "PYTHONPATH": os.pathsep.join(filter(None, paths)),
                    dask_jobs.DOOMED: str(self.doomed),
                },
                stdout=log,
                stderr=log,
            )
        self.processes.append(process)
        return process


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    """A scheduler of the test's own, without workers."""
    cluster = Cluster(tmp_path)
    yield cluster
    cluster.stop()


@pytest.fixture(scope="module")
def crowd(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    """A scheduler with three workers, which tests share: each process takes seconds to start."""
    cluster = Cluster(tmp_path_factory.mktemp("crowd"))
    cluster.worker("--name", "one", "--memory-limit", "1GB")
    cluster.worker("--name", "two", "--memory-limit", "1GB")
    cluster.worker("--name", "large", "--memory-limit", "0", "--resources", "GPU=1 MEMORY=4e9")
    until(lambda: _count_workers(cluster) == 3)
    yield cluster
    cluster.stop()


def work_in(folder: Path) -> Work:
    """A batch whose jobs write into a folder."""
    loaded = batch_pieces.recipe(folder.parent / "recipe")
    return Work(loaded, data_set_of(loaded.draw(0)), LocalStorage(folder), versions_hash())


def jobs(count: int, first: int = 0) -> list[Job]:
    return [
        Job(image - first, image, "train", f"{image:06d}-{hashlib.sha1(str(image).encode()).hexdigest()}")
        for image in range(first, first + count)
    ]


def run(engine: DaskEngine, todo: list[Job]) -> list[Outcome]:
    """Outcomes of all jobs; each is tried once."""
    for job in todo:
        engine.submit(job, 1)
    outcomes: list[Outcome] = []
    end = time.monotonic() + _BOUND_S
    while len(outcomes) < len(todo):
        assert time.monotonic() < end, outcomes
        outcomes += engine.wait(1.0)
    return outcomes


def content(folder: Path) -> dict[str, bytes]:
    """All files but work in progress."""
    files = [path for path in sorted(folder.rglob("*")) if path.is_file() and "staging" not in path.parts]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def until(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + _BOUND_S
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


def test_a_worker_that_differs_is_refused_by_name(crowd: Cluster, tmp_path: Path) -> None:
    """It has another Python: it gets no job, and a message says what differs; the others go on."""
    stranger = crowd.worker("--name", "old", startup=_STRANGE_PYTHON)
    told: list[str] = []

    def notice(event: str, fields: Mapping[str, str]) -> None:
        if event == "worker_refused":
            told.append(fields["message"])

    with DaskEngine(work_in(tmp_path / "out"), crowd.address, make=dask_jobs.make, notice=notice) as engine:
        until(lambda: bool(engine.wait(0.1)) or bool(told))
        outcomes = run(engine, jobs(6))
    stranger.kill()
    assert len(told) == 1
    assert re.fullmatch(r"worker old \(tcp:.*\) is refused: its versions differ: Python 3.10.99 \(here .*\)", told[0])
    workers = {one.run.worker for one in outcomes if isinstance(one, Done)}
    assert workers
    assert str(stranger.pid) not in workers


@pytest.mark.parametrize(
    ("asked", "expected"),
    [
        ({"resources": {"TPU": 1.0}}, "a job takes 1 TPU, and it declares 0"),
        ({"job_memory_bytes": 5_000_000_000}, "about 5.00 GB of memory, and it may take 1.00 GB"),
        ({"job_memory_bytes": 5_000_000_000}, r"a job takes 5e\+09 MEMORY, and it declares 4e\+09"),
    ],
)
def test_what_no_worker_has_is_refused_at_once(
    asked: dict[str, Any], expected: str, crowd: Cluster, tmp_path: Path
) -> None:
    """Resources that are declared, and memory that a job is estimated to need."""
    start = time.monotonic()
    with (
        pytest.raises(ResourceError, match=expected),
        DaskEngine(work_in(tmp_path / "out"), crowd.address, make=dask_jobs.make, **asked),
    ):
        pass
    assert time.monotonic() - start < 20.0


def test_workers_that_have_the_resources_get_the_jobs(crowd: Cluster, tmp_path: Path) -> None:
    with DaskEngine(
        work_in(tmp_path / "out"),
        crowd.address,
        make=dask_jobs.make,
        resources={"GPU": 1},
        job_memory_bytes=2_000_000_000,
    ) as engine:
        outcomes = run(engine, jobs(3))
        assert engine.workers == 1
    assert all(isinstance(one, Done) for one in outcomes)


def test_nobody_writes_after_the_run_was_given_up(crowd: Cluster, tmp_path: Path) -> None:
    """A job that is in the middle when the run stops ends without a trace in the data set."""
    gpu = {"GPU": 1.0}  # one worker has it: its place is free again when the first job has ended
    with DaskEngine(work_in(tmp_path / "out"), crowd.address, make=dask_jobs.make_slowly, resources=gpu) as engine:
        engine.submit(jobs(1)[0], 1)
        until((crowd.doomed / "begun-0").exists)
    (crowd.doomed / "go").touch()
    with DaskEngine(work_in(tmp_path / "next"), crowd.address, make=dask_jobs.make, resources=gpu) as engine:
        (done,) = run(engine, jobs(1))
    assert isinstance(done, Done)
    assert content(tmp_path / "next")
    assert not content(tmp_path / "out")


@pytest.mark.slow
def test_a_worker_killed_in_a_job_leaves_the_bytes_of_a_local_run(crowd: Cluster, tmp_path: Path) -> None:
    """One of three workers dies in the middle of a job, another joins: every job is done, with the same bytes.

    The last of those that share the workers: any of them may be the one that dies.
    """
    told: list[tuple[str, str]] = []

    def notice(event: str, fields: Mapping[str, str]) -> None:
        told.append((event, fields["message"]))

    todo = jobs(24)
    reference = work_in(tmp_path / "local")
    for job in todo:
        dask_jobs.make(reference, job, 1)
    (crowd.doomed / "7").touch()
    with DaskEngine(work_in(tmp_path / "dask"), str(crowd.file), make=dask_jobs.make, notice=notice) as engine:
        outcomes = run(engine, todo[:12])
        until(lambda: bool(engine.wait(0.1)) or [event for event, _ in told].count("worker_lost") == 1)
        replacement = crowd.worker("--name", "four", "--nthreads", "3")
        until(lambda: bool(engine.wait(0.1)) or any("four" in message for _, message in told))
        outcomes += run(engine, todo[12:])

    assert sorted(one.job.image for one in outcomes) == list(range(24))
    assert all(isinstance(one, Done) for one in outcomes), outcomes
    assert not (crowd.doomed / "7").exists(), "no worker died"
    assert content(tmp_path / "dask") == content(tmp_path / "local")
    threads = {one.run.worker: one.run.timings_s["threads"] for one in outcomes if isinstance(one, Done)}
    assert threads.pop(str(replacement.pid)) == 3.0, "the renderer has as many threads as its worker"
    assert set(threads.values()) == {1.0}


@pytest.mark.slow
def test_a_cluster_of_strangers_is_refused(cluster: Cluster, tmp_path: Path) -> None:
    cluster.worker("--name", "other-python", startup=_STRANGE_PYTHON)
    cluster.worker("--name", "bare", startup=_NO_FORESTGEN)
    until(lambda: _count_workers(cluster) == 2)
    with (
        pytest.raises(ResourceError, match="none of the 2 Dask workers can do this batch") as refusal,
        DaskEngine(work_in(tmp_path / "out"), cluster.address, make=dask_jobs.make),
    ):
        pass
    assert "Python 3.10.99" in str(refusal.value)
    assert "forestgen is not installed there" in str(refusal.value)


@pytest.mark.slow
def test_a_job_that_kills_every_worker_fails_with_their_deaths_counted(cluster: Cluster, tmp_path: Path) -> None:
    """Dask tries it on four workers; it comes back as failed, and no --retries 2 would try it again."""
    for _ in range(4):
        cluster.worker()
    with DaskEngine(work_in(tmp_path / "out"), cluster.address, make=dask_jobs.make) as engine:
        (failed,) = run(engine, jobs(1, dask_jobs.POISON))
    assert isinstance(failed, Failed)
    assert (failed.kind, failed.attempt) == ("worker", 4)
    assert "4 Dask workers died" in failed.message


_RUN_SLOWLY = """
import sys, dask_jobs, test_dask
from pathlib import Path
with test_dask.DaskEngine(test_dask.work_in(Path(sys.argv[1])), sys.argv[2], make=dask_jobs.make_slowly) as engine:
    test_dask.run(engine, test_dask.jobs(1))
"""


@pytest.mark.slow
def test_nobody_writes_for_a_run_that_was_killed(cluster: Cluster, tmp_path: Path) -> None:
    """`kill -9` of the run leaves nobody to cancel its jobs: Dask notices that it is gone."""
    cluster.worker()
    paths = [str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")]
    killed = subprocess.Popen(
        [sys.executable, "-c", _RUN_SLOWLY, str(tmp_path / "out"), cluster.address],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths))},
    )
    cluster.processes.append(killed)
    until((cluster.doomed / "begun-0").exists)
    killed.kill()
    killed.wait()
    time.sleep(1.0)  # until the scheduler has heard of it
    (cluster.doomed / "go").touch()
    with DaskEngine(work_in(tmp_path / "next"), cluster.address, make=dask_jobs.make) as engine:
        (done,) = run(engine, jobs(1))  # the one worker does it after the first job
    assert isinstance(done, Done)
    assert not content(tmp_path / "out")


@pytest.mark.slow
def test_a_scheduler_that_dies_ends_the_run_soon(cluster: Cluster, tmp_path: Path) -> None:
    cluster.worker()
    start = time.monotonic()

    def lose_it() -> None:
        with DaskEngine(work_in(tmp_path / "out"), cluster.address, make=dask_jobs.make_slowly) as engine:
            engine.submit(jobs(1)[0], 1)
            until((cluster.doomed / "begun-0").exists)
            cluster.scheduler.send_signal(signal.SIGKILL)
            nonlocal start
            start = time.monotonic()
            while time.monotonic() - start < _BOUND_S:
                engine.wait(1.0)

    with raises_error(ResourceError):
        lose_it()
    assert time.monotonic() - start < 30.0


@pytest.mark.parametrize(
    "address",
    few([None, "http://127.0.0.1:8786", "nowhere.json", "tcp://127.0.0.1:1"], 3),
)
def test_addresses_that_nobody_answers(address: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("forestgen.runs.engines.dask._CONNECT_S", 1.0)
    start = time.monotonic()
    with (
        raises_error(ForestgenError),
        DaskEngine(work_in(tmp_path / "out"), address, make=dask_jobs.make),
    ):
        pass
    assert time.monotonic() - start < 15.0


@pytest.mark.slow
def test_no_workers_yet_is_said_and_waited_for(cluster: Cluster, tmp_path: Path) -> None:
    told: list[str] = []

    def notice(event: str, fields: Mapping[str, str]) -> None:
        if event == "waiting":
            cluster.worker()
        told.append(f"{event}: {fields['message']}")

    with DaskEngine(work_in(tmp_path / "out"), cluster.address, make=dask_jobs.make, notice=notice) as engine:
        assert engine.workers == 1
    assert told[0].startswith(f"waiting: the Dask scheduler {cluster.address}: it has no workers")


def _count_workers(cluster: Cluster) -> int:
    from distributed import Client

    with Client(cluster.address, timeout=30, set_as_default=False) as client:
        return len(client.scheduler_info()["workers"])


@pytest.mark.slow
def test_rendered_images_have_the_bytes_of_a_local_run(cluster: Cluster, tmp_path: Path) -> None:
    """Eight images, three workers that render, one killed while it does: the same files and records as here."""
    loaded = batch_pieces.recipe(tmp_path / "recipe")
    todo = batch_pieces.jobs_of(loaded, range(8))
    for _ in range(3):
        cluster.worker()
    work = work_in(tmp_path / "dask")
    killed = False
    with DaskEngine(work, cluster.address) as engine:
        for job in todo:
            engine.submit(job, 1)
        outcomes: list[Outcome] = []
        end = time.monotonic() + 500.0
        while len(outcomes) < len(todo) and time.monotonic() < end:
            outcomes += engine.wait(0.2)
            if not killed and work.storage.names(".forestgen/staging"):  # someone is in the middle
                writer = next(one for one in work.storage.names(".forestgen/staging")).split("-")[1]
                os.kill(int(writer), signal.SIGKILL)
                killed = True
    assert killed
    assert [one for one in outcomes if not isinstance(one, Done)] == []
    batch_pieces.make(loaded, todo, tmp_path / "local")
    assert content(tmp_path / "dask") == content(tmp_path / "local")
