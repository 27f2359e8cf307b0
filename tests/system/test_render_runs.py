"""`forestgen render` as a run: what stays when an image fails, what --resume and --overwrite do, and Ctrl-C.

Most images here are pretended: bytes that follow from the job's key.
"""

from __future__ import annotations

import errno
import json
import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

import pretend_jobs
import pytest
from command_line import run, start, tiny, tree

from forestgen.core.errors import AssetError, ForestgenError, OutputError, RecipeError, RenderError, ResourceError
from forestgen.core.progress import Progress
from forestgen.recipe.load import DrawnRecipe, LoadedRecipe
from forestgen.runs import work as work_module
from forestgen.runs.contract import Done, Job, Work
from forestgen.runs.storage import LocalStorage

Failures = dict[int, BaseException]  # by image


@pytest.fixture
def failures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Failures:
    """Images are pretended, but for those that a test lets fail; what they print are numbers of images."""
    (tmp_path / "faults").mkdir()
    monkeypatch.setenv(pretend_jobs.FAULTS, str(tmp_path / "faults"))
    errors: Failures = {}

    def pretend(work: Work, job: Job, attempt: int, progress: Progress) -> Done:
        if job.image in errors:
            work.storage.staging()  # something is there already
            raise errors[job.image]
        done = pretend_jobs.make(work, job, attempt)
        assert isinstance(done, Done)
        return done

    monkeypatch.setattr(work_module, "make_here", pretend)
    return errors


@pytest.fixture
def recipe(tmp_path: Path) -> Path:
    return tiny(tmp_path, ("seed: 3", "seed: 3\ndataset: {formats: []}"))


def frames(folder: Path) -> list[str]:
    return sorted(path.name for path in (folder / "train").iterdir() if path.is_dir())


def kept(folder: Path) -> dict[str, bytes | None]:
    """What two runs must have in common."""
    return {
        name: content
        for name, content in tree(folder).items()
        if name.split("/")[0] not in ("run", ".forestgen", "report.html")
    }


ERRORS = [RecipeError, AssetError, ResourceError, OutputError, RenderError]


@pytest.mark.parametrize("kind", ERRORS)
def test_the_first_image_fails_with_its_own_error_and_nothing_stays(
    kind: type[ForestgenError], failures: Failures, recipe: Path, tmp_path: Path
) -> None:
    failures[0] = kind("no", where="tiny.yaml:3: site", expected="yes", got="no", hint="say yes")
    before = tree(tmp_path)
    answer = run("render", recipe, "-o", tmp_path / "new" / "out")
    answer.refused(kind.exit_code)
    assert tree(tmp_path) == before
    (tmp_path / "empty").mkdir()
    run("render", recipe, "-o", tmp_path / "empty").refused(kind.exit_code)
    assert tree(tmp_path) == {**before, "empty": None}


def test_finished_images_stay_and_resume_goes_on(failures: Failures, recipe: Path, tmp_path: Path) -> None:
    failures[2] = RenderError("no", hint="say yes")
    out = tmp_path / "out"
    run("render", recipe, "-o", out, "--count", "4").refused(5)
    assert frames(out) == ["000000-left", "000000-right", "000001-left", "000001-right"]
    assert not (out / "dataset.json").exists()  # it is not whole
    run("render", recipe, "-o", out, "--count", "4").refused(4)
    run("render", recipe, "-o", out, "--count", "4", "--resume").refused(5)
    assert len(frames(out)) == 4
    failures.clear()
    answer = run("render", recipe, "-o", out, "--count", "4", "--resume")
    assert answer.code == 0, answer.err
    assert "4 of 4 images done, 2 of them before" in answer.out
    assert pretend_jobs.begun(tmp_path / "faults") == [0, 1, 2, 3]
    assert run("render", recipe, "-o", tmp_path / "whole", "--count", "4").code == 0
    assert kept(out) == kept(tmp_path / "whole")
    assert json.loads((out / "dataset.json").read_text())["splits"] == {"train": {"images": 4, "frames": 8}}


def test_an_image_that_cannot_be_drawn_ends_the_run_with_its_own_error(
    failures: Failures, recipe: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real: Callable[[LoadedRecipe, int], DrawnRecipe] = LoadedRecipe.draw

    def draw(self: LoadedRecipe, index: int) -> DrawnRecipe:
        if index == 1:
            raise AssetError("gone", where="tiny.yaml:4: species", hint="look for it")
        return real(self, index)

    monkeypatch.setattr(LoadedRecipe, "draw", draw)
    run("render", recipe, "-o", tmp_path / "out", "--count", "3").refused(2)
    assert frames(tmp_path / "out") == ["000000-left", "000000-right"]


def test_overwrite_replaces_a_data_set_once_an_image_is_made(failures: Failures, recipe: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    render = ("render", recipe, "-o", out, "--overwrite")
    assert run(*render, "--count", "2").code == 0
    before = tree(tmp_path)
    run(*render, "--set", "sky.turbidity=99").refused(2)
    run(*render, "--set", "cameras.0.size_px=[16384,16384]", "--set", "labels.samples=1024").refused(3)
    run(*render, "--resume").refused(2)
    assert tree(tmp_path) == before  # what is refused before any work touches nothing
    failures[0] = RenderError("no")
    run(*render, "--set", "seed=4").refused(5)
    failures[0] = KeyboardInterrupt()
    answer = run(*render, "--set", "seed=4")
    assert (answer.code, answer.err) == (130, "interrupted: nothing was written; a previous data set is as it was\n")
    assert tree(tmp_path) == before
    failures.clear()
    failures[1] = RenderError("no")
    run(*render, "--count", "2", "--set", "seed=4").refused(5)
    assert frames(out) == ["000000-left", "000000-right"]
    failures.clear()
    assert run(*render, "--count", "2", "--set", "seed=4").code == 0
    after = kept(out)
    assert after.keys() == {name.removeprefix("out/") for name in before if name.startswith("out/")} & after.keys()
    assert after["train/000000-left/mask.bin"] != before["out/train/000000-left/mask.bin"]
    assert len(list((out / ".forestgen" / "jobs").iterdir())) == 2  # nothing of the previous one
    assert not [path.name for path in tmp_path.iterdir() if path.name.startswith(".")]


def test_overwrite_is_for_data_sets_alone(failures: Failures, recipe: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    other.mkdir()
    (other / "thesis.tex").write_text("five years")
    before = tree(tmp_path)
    run("render", recipe, "-o", other, "--overwrite").refused(4)
    assert tree(tmp_path) == before


def test_quiet_prints_nothing_and_the_default_folder_is_free(
    failures: Failures, recipe: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("tiny", "tiny-2"):
        answer = run("render", recipe, "--quiet")
        assert (answer.code, answer.out, answer.err) == (0, "", "")
        assert (tmp_path / "outputs" / name / "dataset.json").is_file()
    failures[0] = RenderError("no")
    run("render", recipe, "--quiet").refused(5)
    assert not (tmp_path / "outputs" / "tiny-3").exists()


def test_results_go_to_standard_output_and_progress_does_not(failures: Failures, recipe: Path, tmp_path: Path) -> None:
    answer = run("render", recipe, "-o", tmp_path / "out", "--count", "2", "--set", "dataset.splits={val: 1}")
    assert answer.code == 0
    assert answer.err == "writing the files over all images\n"
    assert "2 of 2 images done" in answer.out
    assert f"look at {tmp_path}/out/val/000001-left/preview.png" in answer.out


def test_storage_that_fails_in_the_middle_of_an_image_is_named(
    recipe: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    out = tmp_path / "out"
    before = tree(tmp_path)
    for name in ("complete", "_put_into_place"):
        with monkeypatch.context() as patched:
            if name == "_put_into_place":
                patched.setattr(work_module, "complete", _complete_badly)
            else:
                patched.setattr(work_module, name, full)
            run("render", recipe, "-o", out).refused(4)
        assert tree(tmp_path) == before


def _complete_badly(work: Work, *_: object) -> None:
    """An image is made, and its frames cannot be moved into the data set."""
    cause = OutputError("cannot write: No space left on device", where=f"{work.storage.name}/x", hint="free some space")
    raise work_module._StorageFailedError from cause


def test_an_image_that_was_just_finished_counts_when_the_run_is_interrupted(
    failures: Failures, recipe: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make = work_module.make_here

    def interrupted(work: Work, job: Job, attempt: int, progress: Progress) -> Done:
        done = make(work, job, attempt, progress)
        if job.image == number:
            raise KeyboardInterrupt  # the record is written, and the run has not heard of it
        return done

    monkeypatch.setattr(work_module, "make_here", interrupted)
    for number in (0, 2):
        answer = run("render", recipe, "-o", tmp_path / str(number), "--count", "5")
        assert answer.code == 130
        assert len(frames(tmp_path / str(number))) == 2 * (number + 1)
        log = (tmp_path / str(number) / "run" / "log.jsonl").read_text().splitlines()
        assert json.loads(log[-1])["done"] == number + 1


def test_a_stop_just_after_the_record_was_written_keeps_the_image(
    failures: Failures, recipe: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write = LocalStorage.write

    def stopped(place: LocalStorage, target: str, content: bytes) -> None:
        write(place, target, content)
        if "/jobs/" in target:
            raise KeyboardInterrupt

    out = tmp_path / "out"
    with monkeypatch.context() as patched:
        patched.setattr(LocalStorage, "write", stopped)
        answer = run("render", recipe, "-o", out, "--count", "5")
    assert answer.code == 130
    assert len(frames(out)) == 2
    assert json.loads((out / "run" / "log.jsonl").read_text().splitlines()[-1])["done"] == 1
    assert run("render", recipe, "-o", out, "--count", "5", "--resume").code == 0
    assert len(frames(out)) == 10


@pytest.mark.slow
def test_ctrl_c_keeps_finished_images(tmp_path: Path) -> None:
    """Real images in a process of its own."""
    recipe, out = tiny(tmp_path), tmp_path / "out"
    process = start("render", recipe, "-o", out, "--count", "200")
    jobs = out / ".forestgen" / "jobs"
    until = time.monotonic() + 240
    while not (jobs.is_dir() and any(jobs.iterdir())):
        assert process.poll() is None
        assert time.monotonic() < until
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    done = len(list(jobs.iterdir()))
    says = f"interrupted: {done} of 200 images are done and stay; the same command with --resume goes on\n"
    assert err.endswith(says)  # a slow machine tells before how far it is
    assert err.count("interrupted") == 1
    assert len(frames(out)) == done
    answer = run("render", recipe, "-o", out, "--count", str(done), "--resume")
    assert answer.code == 0, answer.err
    assert f"{done} of {done} image" in answer.out
    assert run("verify", out).code == 0
