"""What goes wrong in a night: killed runs and workers, two runs at once, memory and disks that are full.

Jobs are pretended (`pretend_jobs`), runs and workers are real processes.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import random
import resource
import signal
import sys
import time
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

import pytest
from batch_runs import assert_records_hold, assert_same, faults_folder, local, processes_below, recipe, serial, shown
from command_line import start, wait_for_handler
from pretend_jobs import FAULTS, begun, make

from forestgen.core.errors import OutputError
from forestgen.pipeline import WrittenImage
from forestgen.runs.records import done_keys
from forestgen.runs.storage import LocalStorage
from forestgen.runs.work import make_job
from forestgen.scene.build import BuiltScene
from support.error_messages import raises_error

IMAGES = 10


@pytest.fixture
def faults(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(FAULTS, "")
    return faults_folder(tmp_path)


def in_a_process(*arguments: Any) -> BaseProcess:
    """`batch_runs.local` in a process of its own, forked from one that has all modules loaded."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["forestgen.runs.run", "forestgen.runs.engines.local"])
    process = context.Process(target=_run, args=(os.environ[FAULTS], *map(str, arguments)))
    process.start()
    return process


def _run(faults: str, path: str, target: str, count: str) -> None:
    os.environ[FAULTS] = faults
    local(path, target, int(count), make)


def done_images(target: Path) -> set[int]:
    return {int(key.partition("-")[0]) for key in done_keys(LocalStorage(target))}


def wait_until(condition: Any, process: BaseProcess, within_s: float = 60.0) -> None:
    """Until a condition holds, or the process has ended."""
    end = time.monotonic() + within_s
    while not condition() and process.is_alive():
        assert time.monotonic() < end
        time.sleep(0.01)


def survive_kills(folder: Path, faults: Path, kills: int, seed: int) -> None:
    """A batch that is killed, or whose worker is, at random moments, and resumed; then compared with one left alone."""
    path, target, rng = recipe(folder), folder / "killed", random.Random(seed)
    (faults / "seconds").write_text("0.15")
    for kill in range(kills):
        before, done = len(begun(faults)), done_images(target)
        process = in_a_process(path, target, IMAGES)
        if rng.random() < 0.6:
            wait_until(lambda since=before: len(begun(faults)) > since, process)
        time.sleep(rng.uniform(0, 0.4))
        victims = processes_below(process.pid or 0)
        if kill % 3 == 2 and victims:
            os.kill(rng.choice(victims), signal.SIGKILL)
            time.sleep(rng.uniform(0, 0.3))
        process.kill()
        process.join()
        wait_until_gone(victims)
        assert done <= assert_records_hold(target)
        assert not done & set(begun(faults)[before:]), "an image that was done was made again"
        if len(done_images(target)) >= IMAGES - 1:  # start over: kills of a finished batch are less of a test
            for key in sorted(done_keys(LocalStorage(target)))[rng.randrange(IMAGES) :]:
                (target / ".forestgen/jobs" / f"{key}.json").unlink()
    (faults / "seconds").write_text("0")
    local(str(path), str(target), IMAGES, make)
    serial(path, folder / "whole", IMAGES, make)
    assert_same(target, folder / "whole")
    assert not list((target / ".forestgen").glob("staging/*"))


def wait_until_gone(pids: list[int]) -> None:
    import psutil

    _, alive = psutil.wait_procs([psutil.Process(pid) for pid in pids if psutil.pid_exists(pid)], timeout=10)
    assert not alive, "workers outlived their run"


def test_a_batch_survives_kills_of_the_run_and_of_workers(tmp_path: Path, faults: Path) -> None:
    survive_kills(tmp_path, faults, kills=3, seed=1)


@pytest.mark.slow
def test_a_batch_survives_twenty_kills(tmp_path: Path, faults: Path) -> None:
    survive_kills(tmp_path, faults, kills=20, seed=2)


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere a stopped process outlives its parent")
def test_a_stopped_worker_dies_with_its_run(tmp_path: Path, faults: Path) -> None:
    """Else it would write into the data set, without its lock, when somebody wakes it."""
    (faults / "seconds").write_text("0.5")
    path, target = recipe(tmp_path), tmp_path / "data"
    process = in_a_process(path, target, IMAGES)
    wait_until(lambda: begun(faults), process)
    workers = processes_below(process.pid or 0)
    assert workers
    for pid in workers:
        os.kill(pid, signal.SIGSTOP)
    process.kill()
    process.join()
    wait_until_gone(workers)


def test_a_killed_worker_fails_its_job_alone_and_is_replaced(tmp_path: Path, faults: Path) -> None:
    for image in (1, 3):
        (faults / f"die-{image}").touch()
    path, target = recipe(tmp_path), tmp_path / "data"
    summary = local(str(path), str(target), 6, make)
    assert summary.failed == ()
    assert sorted(begun(faults)) == [0, 1, 1, 2, 3, 3, 4, 5]
    lost = [event for event in log_of(target) if event["event"] == "worker_lost"]
    assert sorted(event["image"] for event in lost) == [1, 3]
    assert all("SIGKILL" in event["message"] and "memory" in event["message"] for event in lost)
    serial(path, tmp_path / "whole", 6, make)
    assert_same(target, tmp_path / "whole")


def test_a_worker_that_takes_too_much_memory_is_stopped(tmp_path: Path, faults: Path) -> None:
    (faults / "hoard-1").touch()
    path, target = recipe(tmp_path), tmp_path / "data"
    summary = local(str(path), str(target), 4, make, retries=1, memory_bytes=500_000_000)
    assert [(failed.job.image, failed.kind, failed.attempt) for failed in summary.failed] == [(1, "memory", 2)]
    assert "more than the 0.50 GB" in summary.failed[0].message
    assert "`worker_memory`" in summary.failed[0].message
    assert assert_records_hold(target) == {0, 2, 3}
    (faults / "hoard-1").unlink()
    local(str(path), str(target), 4, make)
    serial(path, tmp_path / "whole", 4, make)
    assert_same(target, tmp_path / "whole")


def test_a_worker_that_hangs_is_stopped_and_its_image_tried_again(tmp_path: Path, faults: Path) -> None:
    (faults / "stop-1").touch()  # the first attempt at it
    path, target = recipe(tmp_path), tmp_path / "data"
    summary = local(str(path), str(target), 3, make, timeout_s=6.0)
    assert summary.failed == ()
    again = [event for event in log_of(target) if event["event"] == "job_failed"]
    assert [(event["image"], event["kind"], event["will_retry"]) for event in again] == [(1, "time", True)]
    assert "`timeout`" in again[0]["message"]
    assert assert_records_hold(target) == {0, 1, 2}


def test_of_two_runs_on_one_folder_the_second_is_refused(tmp_path: Path, faults: Path) -> None:
    (faults / "seconds").write_text("0.5")
    path, target = recipe(tmp_path), tmp_path / "data"
    first = in_a_process(path, target, IMAGES)
    try:
        wait_until(lambda: begun(faults), first)
        for resume in (False, True):
            with raises_error(OutputError, place="data") as refused:
                serial(path, target, IMAGES, make, resume=resume)
            assert f"process {first.pid}" in str(refused.value)
        assert first.is_alive()
    finally:
        first.kill()
        first.join()
    (faults / "seconds").write_text("0")
    assert serial(path, target, 2, make, resume=True, discard=True).images == 2  # a dead run's lock is nobody's


@pytest.mark.slow
def test_a_full_disk_stops_the_run_and_loses_nothing(tmp_path: Path, faults: Path) -> None:
    """A limit on the size of files stands in for a full disk: the kernel refuses a frame's EXR file."""
    path, target = recipe(tmp_path), tmp_path / "data"
    with pytest.raises(KeyboardInterrupt):
        serial(path, target, 2, make_job, stop_after=1)
    before, limits = shown(target), resource.getrlimit(resource.RLIMIT_FSIZE)
    limit = max(map(len, before.values())) * 3 // 4
    assert (target / "run/log.jsonl").stat().st_size < limit / 2
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limits[1]))
    try:
        with raises_error(OutputError):
            serial(path, target, 2, make_job, resume=True, retries=1)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert shown(target) == before
    events = log_of(target)
    assert [event["will_retry"] for event in events if event["event"] == "job_failed"] == [True, False]
    assert events[-1]["event"] == "stop"
    assert serial(path, target, 2, make_job, resume=True).failed == ()
    assert assert_records_hold(target) == {0, 1}


def two_frames(scene: BuiltScene, settings: Any, folder: Path, progress: Any, timings: Any) -> WrittenImage:
    """In place of `pipeline.write_image`: frames that take no time."""
    from PIL import Image

    number = scene.drawn.image_index
    frames = [folder / f"{number:06d}-{camera}" for camera in ("left", "right")]
    for frame in frames:
        frame.mkdir()
        Image.new("RGB", (8, 6), (10, 90, 30)).save(frame / "preview.png")
    rows = tuple({"frame": frame.name, "split": "train", "image": number, "camera": "left"} for frame in frames)
    report = {"image": number, "seed": scene.drawn.image_seed, "counts": {}}
    return WrittenImage(tuple(frames), rows, (), report)


def test_a_disk_that_fills_while_frames_are_placed(
    tmp_path: Path, faults: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At each call that gives a file its name: no record without its files, no frame without its record."""
    import errno

    monkeypatch.setattr(
        "forestgen.runs.work.assemble_image",
        lambda plan, *_, **__: BuiltScene(plan, None, None, []),  # type: ignore[arg-type]
    )
    monkeypatch.setattr("forestgen.runs.work.write_image", two_frames)
    path, target = recipe(tmp_path), tmp_path / "data"
    left = 0  # calls that still work
    replace, rename = Path.replace, Path.rename

    def full(move):  # type: ignore[no-untyped-def]
        def moved(source, destination):  # type: ignore[no-untyped-def]
            nonlocal left
            if "thumbnails" in str(destination) or "0000" in Path(destination).name:
                left -= 1
                if left < 0:
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return move(source, destination)

        return moved

    monkeypatch.setattr(Path, "replace", full(replace))
    monkeypatch.setattr(Path, "rename", full(rename))
    for works in (0, 1, 2, 4):  # a frame fails, the second, a thumbnail, the record
        left = works
        with raises_error(OutputError, place="data"):
            serial(path, target, 1, make_job, resume=True, retries=0)
        assert done_keys(LocalStorage(target)) == set()
        assert not list((target / "train").glob("0*"))
    left = 1000
    assert serial(path, target, 1, make_job, resume=True).frames == 2


def _killed_at(faults: str, target: str, path: str, moves: int) -> None:
    """A batch that dies before its n-th file or folder gets its name."""
    os.environ[FAULTS] = faults
    left = moves

    def until_killed(move: Any) -> Any:
        def moved(source: Path, destination: Path) -> Path:
            nonlocal left
            left -= 1
            if left < 0:
                os.kill(os.getpid(), signal.SIGKILL)
            return Path(move(source, destination))

        return moved

    Path.rename, Path.replace = until_killed(Path.rename), until_killed(Path.replace)  # type: ignore[method-assign]
    serial(Path(path), Path(target), 3, make, resume=True)


@pytest.mark.slow
def test_a_run_that_is_killed_at_any_rename_goes_on(tmp_path: Path, faults: Path) -> None:
    """Of frames, records, a split's merged files, and the files of the whole; again and again on one folder."""
    path = recipe(tmp_path)
    serial(path, tmp_path / "whole", 3, make)
    target = tmp_path / "killed"
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["forestgen.runs.run", "forestgen.runs.engines.local"])
    for moves in (0, 2, 3, 5, 6, 8, 9, 11, 14):
        process = context.Process(target=_killed_at, args=(str(faults), str(target), str(path), moves))
        process.start()
        process.join(60)
        assert process.exitcode in (0, -signal.SIGKILL)
        assert_records_hold(target)
        if (target / "dataset.json").exists():  # it comes last, but for the run's own files
            assert_same(target, tmp_path / "whole")
    serial(path, target, 3, make, resume=True)
    assert_same(target, tmp_path / "whole")
    assert not list((target / ".forestgen").glob("staging/*"))


def test_ctrl_c_stops_at_once_and_says_what_is_done(tmp_path: Path) -> None:
    """The command itself, its workers loading the renderer."""
    target = tmp_path / "data"
    process = start("batch", recipe(tmp_path), "--count", "50", "--out", target, "--workers", "1")
    wait_for_handler(process, signal.SIGTERM)
    end = time.monotonic() + 120
    while not (target / "run/log.jsonl").exists() and process.poll() is None:
        assert time.monotonic() < end
        time.sleep(0.05)
    time.sleep(0.5)
    workers = processes_below(process.pid)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert "of 50 images" in err
    assert "--resume" in err
    assert "Traceback" not in err
    wait_until_gone(workers)
    assert log_of(target)[-1]["event"] == "stop"


def test_half_a_line_in_the_log_harms_nothing(tmp_path: Path, faults: Path) -> None:
    path, target = recipe(tmp_path), tmp_path / "data"
    serial(path, target, 2, make)
    with (target / "run/log.jsonl").open("a") as log:
        log.write('{"event": "job_do')
    serial(path, target, 3, make, resume=True)
    lines = (target / "run/log.jsonl").read_text().splitlines()
    broken = [line for line in lines if not line.endswith("}")]
    assert broken == ['{"event": "job_do']
    assert json.loads(lines[-1])["event"] == "finish"


def log_of(target: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (target / "run/log.jsonl").read_text().splitlines()]
