"""Data sets in bulk: the same bytes however they come about, and only what is missing is made."""

from __future__ import annotations

import json
import random
from dataclasses import replace
from pathlib import Path

import pytest
from batch_runs import (
    RECIPE,
    WITH_LABELS,
    SerialEngine,
    assert_records_hold,
    assert_same,
    faults_folder,
    recipe,
    serial,
    shown,
)
from command_line import run
from pretend_jobs import FAULTS, begun, make

from forestgen.core.errors import DatasetError, OutputError, RecipeError
from forestgen.recipe.load import load_recipe
from forestgen.runs.contract import Job, Notice, Outcome, RunOptions, Work
from forestgen.runs.run import run_batch
from forestgen.runs.summary import SilentDisplay
from forestgen.runs.work import make_job
from support.error_messages import raises_error


@pytest.fixture
def faults(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(FAULTS, "")
    return faults_folder(tmp_path)


@pytest.mark.slow
def test_two_workers_and_one_process_in_reverse_make_the_same_bytes(tmp_path: Path) -> None:
    """The command with its workers, against the same jobs in another order and in this process."""
    path = recipe(tmp_path, WITH_LABELS)
    answer = run("batch", path, "--count", "2", "--out", tmp_path / "two", "--workers", "2", "--threads", "1")
    assert answer.code == 0, answer.err
    assert "2 of 2 images" in answer.out
    assert f"look at {tmp_path / 'two'}/" in answer.out
    assert f"or at {tmp_path / 'two'}/report.html" in answer.out
    serial(path, tmp_path / "one", 2, make_job, hold=2, order=lambda jobs: len(jobs) - 1)
    assert_same(tmp_path / "one", tmp_path / "two")
    assert assert_records_hold(tmp_path / "two") == {0, 1}
    assert {path.name for path in (tmp_path / "two").iterdir()} == {
        *(".forestgen", "README.md", "SHA256SUMS", "dataset.json", "index.parquet", "recipe.yaml", "report.html"),
        *("run", "thumbnails", "train", "val"),
    }
    events = [json.loads(line) for line in (tmp_path / "two/run/log.jsonl").read_text().splitlines()]
    assert [event["event"] for event in events].count("job_done") == 2
    assert {events[0]["event"], events[-1]["event"]} == {"start", "finish"}


@pytest.mark.slow
def test_the_threads_of_a_worker_change_no_byte_under_clouds(tmp_path: Path) -> None:
    """One worker has both cores, two have one each: so do renderer, compiled loops and linear algebra."""
    sky = "{sun: {elevation_deg: {uniform: [20, 60]}}, clouds: {type: noise, cover: 0.6}}"
    text = WITH_LABELS.replace("{sun: {elevation_deg: {uniform: [20, 60]}}}", sky).replace("flat", "rolling")
    path = recipe(tmp_path, text.replace("denoise: false", "denoise: true"))
    for workers, threads in ((1, 2), (2, 1)):
        more = ("--workers", str(workers), "--threads", str(threads))
        answer = run("batch", path, "--count", "3", "--out", tmp_path / f"by{workers}", *more)
        assert answer.code == 0, answer.err
    assert_same(tmp_path / "by1", tmp_path / "by2")


@pytest.mark.slow
def test_a_batch_is_the_images_that_render_makes(tmp_path: Path) -> None:
    """A batch has the bytes of the data set that `forestgen render` makes, its records too."""
    path = recipe(tmp_path, WITH_LABELS)
    serial(path, tmp_path / "batch", 2, make_job)
    assert run("render", path, "--count", "2", "-o", tmp_path / "rendered").code == 0
    assert any(name.endswith("frame.exr") for name in shown(tmp_path / "rendered"))
    assert_same(tmp_path / "batch", tmp_path / "rendered")


def test_orders_and_interruptions_change_no_byte(tmp_path: Path, faults: Path) -> None:
    """A batch of six, interrupted early and late, resumed in a random order."""
    path = recipe(tmp_path)
    serial(path, tmp_path / "whole", 6, make)
    for point in (0, 1, 4):
        target = tmp_path / f"stopped{point}"
        with pytest.raises(KeyboardInterrupt):
            serial(path, target, 6, make, stop_after=point)
        done = assert_records_hold(target)
        assert len(done) == point
        assert not (target / "dataset.json").exists()
        before = begun(faults)
        rng = random.Random(point)
        summary = serial(
            path, target, 6, make, resume=True, hold=3, order=lambda jobs, rng=rng: rng.randrange(len(jobs))
        )
        assert (summary.already, summary.made) == (point, 6 - point)
        assert sorted(begun(faults)[len(before) :]) == sorted(set(range(6)) - done)
        assert_same(target, tmp_path / "whole")


def test_a_batch_that_grows_makes_only_the_new_images(tmp_path: Path, faults: Path) -> None:
    path = recipe(tmp_path)
    serial(path, tmp_path / "grown", 3, make)
    serial(path, tmp_path / "grown", 7, make, resume=True)
    assert sorted(begun(faults)) == list(range(7))
    serial(path, tmp_path / "whole", 7, make)
    assert_same(tmp_path / "grown", tmp_path / "whole")


def test_a_batch_that_shrinks_loses_what_is_too_much(tmp_path: Path, faults: Path) -> None:
    path = recipe(tmp_path)
    serial(path, tmp_path / "shrunk", 7, make)
    serial(path, tmp_path / "shrunk", 3, make, resume=True, discard=True)
    serial(path, tmp_path / "whole", 3, make)
    assert_same(tmp_path / "shrunk", tmp_path / "whole")


def test_of_a_changed_recipe_only_what_changes_is_made_again(tmp_path: Path, faults: Path) -> None:
    """A story of which the second half changes: the images of the first half stay."""
    path = recipe(tmp_path, RECIPE.replace("steps: 12", "steps: {sequence: [5, 6, 7, 8, 9, 10]}"))
    target = tmp_path / "changed"
    serial(path, target, 6, make)
    before = begun(faults)
    changed = recipe(tmp_path, RECIPE.replace("steps: 12", "steps: {sequence: [5, 6, 7, 11, 12, 13]}"))
    summary = serial(changed, target, 6, make, resume=True, discard=True)
    assert (summary.already, summary.made) == (3, 3)
    assert sorted(begun(faults)[len(before) :]) == [3, 4, 5]
    serial(changed, tmp_path / "whole", 6, make)
    assert_same(target, tmp_path / "whole")


def test_a_change_that_is_interrupted_leaves_no_mixture(tmp_path: Path, faults: Path) -> None:
    """Changed, interrupted, changed back: what was made of the other recipe is made again.

    Two images were made of it, and the next two were handed out, so that their old frames were gone.
    """
    path, target = recipe(tmp_path), tmp_path / "mixed"
    serial(path, target, 5, make)
    with pytest.raises(KeyboardInterrupt):
        serial(path, target, 5, make, "seed=6", resume=True, discard=True, stop_after=2)
    with raises_error(RecipeError, place="mixed"):
        serial(path, target, 5, make, resume=True)
    assert serial(path, target, 5, make, resume=True, discard=True).made == 4
    serial(path, tmp_path / "whole", 5, make)
    assert_same(target, tmp_path / "whole")


def test_other_splits_leave_no_old_folder(tmp_path: Path, faults: Path) -> None:
    path, target = recipe(tmp_path), tmp_path / "split"
    serial(path, target, 5, make)
    serial(path, target, 5, make, "dataset.splits={train: 1, test: 1}", resume=True, discard=True)
    assert not (target / "val").exists()
    serial(path, tmp_path / "whole", 5, make, "dataset.splits={train: 1, test: 1}")
    assert_same(target, tmp_path / "whole")


def test_frames_that_were_deleted_or_doubled_by_hand_are_mended(tmp_path: Path, faults: Path) -> None:
    import shutil

    path, target = recipe(tmp_path), tmp_path / "data"
    serial(path, target, 4, make)
    whole = shown(target)
    shutil.rmtree(target / "train/000000-left")
    shutil.copytree(target / "train/000000-right", target / "val/000000-right")
    (next((target / ".forestgen/jobs").glob("000002-*"))).write_text("{")
    assert serial(path, target, 4, make, resume=True).made == 2
    assert shown(target) == whole


def test_two_records_of_one_image_vouch_for_nothing(tmp_path: Path, faults: Path) -> None:
    """A worker that was thought dead has written, too: the frames may be either's, and are made again."""
    from forestgen.runs.records import read_record, record_bytes

    path, target = recipe(tmp_path), tmp_path / "data"
    serial(path, target, 3, make)
    whole = shown(target)
    (one,) = (target / ".forestgen/jobs").glob("000001-*")
    for letter in "0f":
        key = f"000001-{letter * 40}"
        other = replace(read_record(one.read_bytes(), ""), key=key)
        one.with_name(f"{key}.json").write_bytes(record_bytes(other))
        assert serial(path, target, 3, make, resume=True).made == 1
        assert shown(target) == whole


def test_numbers_can_begin_elsewhere(tmp_path: Path, faults: Path) -> None:
    path = recipe(tmp_path)
    serial(path, tmp_path / "part", 2, make, "first_image=40")
    assert {name.split("/")[1][:6] for name in shown(tmp_path / "part") if name.endswith(".bin")} == {
        "000040",
        "000041",
    }


def test_a_batch_is_not_gone_on_with_unasked(tmp_path: Path, faults: Path) -> None:
    path = recipe(tmp_path)
    serial(path, tmp_path / "data", 2, make)
    before = shown(tmp_path / "data")
    with raises_error(OutputError, place="data"):
        serial(path, tmp_path / "data", 3, make)
    assert shown(tmp_path / "data") == before


def test_what_a_run_notes_down_may_be_damaged(tmp_path: Path, faults: Path) -> None:
    """Its own file, by a disk or by a stranger, and lines of the log: no image is lost, nothing else is removed."""
    path, target = recipe(tmp_path), tmp_path / "data"
    serial(path, target, 3, make)
    whole, marks = shown(target), target / ".forestgen/batch.json"
    said = json.loads(marks.read_text())
    texts = [json.dumps({**said, "splits": names}) for names in (["", "."], ["run", ".."], [3, None], "x")]
    for text in ("", "{", "[" * 100_000, *texts):
        marks.write_text(text)
        (target / "run/mine.txt").touch()
        with (target / "run/log.jsonl").open("ab") as log:
            log.write(b'{"event": "job_done", "image": "3", "time": 1}\n\xff\xfe\n[]\n')
            log.write(b'{"event":"job_done","image":1,"split":3,"attempt":"x","seconds":"s","timings_s":[],')
            log.write(b'"peak_memory_bytes":"a","worker":1,"frames":null,"time":3}\n')
        with raises_error(OutputError, place="data"):
            serial(path, target, 3, make)
        assert serial(path, target, 3, make, resume=True).made == 0
        assert shown(target) == whole
        assert (target / "run/mine.txt").exists()


def test_a_split_that_is_a_link_is_refused(tmp_path: Path, faults: Path) -> None:
    """A run would remove what no record vouches for, and that would be somebody's own folder."""
    path, target, own = recipe(tmp_path), tmp_path / "data", tmp_path / "home"
    serial(path, target, 2, make)
    own.mkdir()
    (own / "000001-letter").write_text("mine")
    (target / "train").rename(tmp_path / "moved")
    (target / "train").symlink_to(own)
    with raises_error(OutputError, place="train"):
        serial(path, target, 2, make, resume=True)
    assert (own / "000001-letter").read_text() == "mine"
    (tmp_path / "link").symlink_to(tmp_path / "far", target_is_directory=True)
    (tmp_path / "far").mkdir()
    serial(path, tmp_path / "link", 2, make)  # the whole folder may be one
    assert (tmp_path / "far/dataset.json").exists()


def test_finished_images_are_thrown_away_only_if_asked(tmp_path: Path, faults: Path) -> None:
    """A smaller count, other numbers, another recipe, other splits: said with how many, and nothing lost."""
    path, target = recipe(tmp_path), tmp_path / "data"
    serial(path, target, 6, make)
    before = shown(target)
    for count, overrides in (
        (2, ()),
        (6, ("first_image=4",)),
        (6, ("seed=6",)),
        (4, ("dataset.splits={train: 1, test: 1}",)),
    ):
        with raises_error(RecipeError, place="data"):
            serial(path, target, count, make, *overrides, resume=True)
        assert shown(target) == before
    assert serial(path, target, 6, make, resume=True).made == 0
    answer = run("batch", path, "--count", "2", "--out", target, "--resume")
    assert answer.code == 2  # a script that tries again and again ends here
    assert "--discard agrees" in answer.err
    assert shown(target) == before


def test_splits_are_told_in_the_recipes_order(tmp_path: Path, faults: Path) -> None:
    from forestgen.dataset.pack.source import open_source

    path, target = recipe(tmp_path), tmp_path / "data"
    summary = serial(path, target, 12, make, "dataset.splits={train: 2, val: 1, test: 1}")
    said = json.loads((target / "dataset.json").read_text())
    assert list(said["splits"]) == ["train", "val", "test"]
    assert said["recipes"][0]["splits"] == {"train": 2.0, "val": 1.0, "test": 1.0}
    assert [split.name for split in open_source(target).splits] == ["train", "val", "test"]
    assert summary.report == str(target / "report.html")
    pages = [(target / name).read_text() for name in ("README.md", "report.html")]
    for page in pages:
        assert page.index("train") < page.index("val") < page.index("test")


def test_what_an_engine_tells_of_its_workers_is_in_the_log(tmp_path: Path, faults: Path) -> None:
    target, told = tmp_path / "data", SilentDisplay()
    said: list[str] = []
    told.say = said.append  # type: ignore[method-assign]

    def engine(work: Work, notice: Notice) -> SerialEngine:
        notice("worker_refused", {"worker": "far", "message": "worker far is refused: other versions"})
        return SerialEngine(work, make)

    run_batch(load_recipe(recipe(tmp_path)), str(target), RunOptions(count=1), engine, display=told)
    assert any("far is refused" in text for text in said)
    events = [json.loads(line) for line in (target / "run/log.jsonl").read_text().splitlines()]
    refused = next(event for event in events if event["event"] == "worker_refused")
    assert refused["worker"] == "far"


def test_the_other_workers_memory_counts_for_no_image(
    tmp_path: Path, faults: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The estimate of an image is an upper one: held against what all workers leave free, it would fail most."""

    def busy(work: Work, job: Job, attempt: int) -> Outcome:
        with monkeypatch.context() as later:
            later.setattr("forestgen.scene.plan.free_bytes", lambda: 10**8)
            return make_job(work, job, attempt)

    assert serial(recipe(tmp_path), tmp_path / "data", 1, busy).failed == ()


def test_a_folder_of_somebody_else_is_never_touched(tmp_path: Path, faults: Path) -> None:
    path, target = recipe(tmp_path), tmp_path / "thesis"
    target.mkdir()
    (target / "chapter1.tex").write_text("mine")
    for resume in (False, True):
        with raises_error(OutputError, place="thesis"):
            serial(path, target, 2, make, resume=resume)
    assert [one.name for one in target.iterdir()] == ["chapter1.tex"]


def test_images_that_fail_are_named_and_left_out(tmp_path: Path, faults: Path) -> None:
    path, target = recipe(tmp_path), tmp_path / "data"
    (faults / "fail-1").write_text("renderer no light")
    (faults / "fail-2").write_text("memory too much")
    summary = serial(path, target, 4, make)
    assert [(failed.job.image, failed.kind, failed.attempt) for failed in summary.failed] == [
        (1, "renderer", 1),  # it would fail again
        (2, "memory", 3),  # it may pass: tried again twice
    ]
    assert assert_records_hold(target) == {0, 3}
    for one in faults.glob("fail-*"):
        one.unlink()
    assert serial(path, target, 4, make, resume=True).failed == ()
    serial(path, tmp_path / "whole", 4, make)
    assert_same(target, tmp_path / "whole")


def test_a_batch_without_hope_is_stopped(tmp_path: Path, faults: Path) -> None:
    for image in range(40):
        (faults / f"fail-{image}").write_text("bug it is broken")
    with raises_error(DatasetError, place="data"):
        serial(recipe(tmp_path), tmp_path / "data", 40, make)
    assert len(begun(faults)) < 15


def test_an_image_that_cannot_be_drawn_fails_alone(tmp_path: Path, faults: Path) -> None:
    """Draws that each are valid and together are not: no extreme shows it."""
    path = recipe(tmp_path)
    loaded = load_recipe(path)
    draw = type(loaded).draw

    def draws(self, index):
        if index == 1:
            raise RecipeError("a drawn value is wrong", where="sun", got="-3")
        return draw(self, index)

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(type(loaded), "draw", draws)
        summary = serial(path, tmp_path / "data", 3, make)
    assert [(failed.job.image, failed.kind) for failed in summary.failed] == [(1, "recipe")]
    assert "a drawn value is wrong" in summary.failed[0].message
    assert assert_records_hold(tmp_path / "data") == {0, 2}


@pytest.mark.parametrize(
    "override",
    [
        "same_stand=true",
        "dataset.splits={run: 1, train: 1}",
        "community={model: placed, plants: [{species: fireweed, position_m: [3, 3]}]}",
    ],
)
def test_recipes_that_make_no_data_set_are_refused(tmp_path: Path, faults: Path, override: str) -> None:
    with raises_error(RecipeError):
        serial(recipe(tmp_path), tmp_path / "data", 10, make, override)
    assert not (tmp_path / "data").exists()


@pytest.mark.parametrize(
    "override",
    ["same_stand=true", "community={model: placed, plants: [{species: fireweed, position_m: [3, 3]}]}"],
)
def test_one_stand_in_the_images_of_one_split_is_a_data_set(tmp_path: Path, faults: Path, override: str) -> None:
    """Three images are all in train. Of more, some would be in other splits: they are refused."""
    path, target = recipe(tmp_path), tmp_path / "data"
    assert serial(path, target, 3, make, override).frames == 6
    assert [one.name for one in target.iterdir() if one.name in ("train", "val", "test")] == ["train"]
    with raises_error(RecipeError):
        serial(path, target, 10, make, override, resume=True)
    assert assert_records_hold(target) == {0, 1, 2}


def test_the_map_of_a_resumed_recipe_may_have_changed_meanwhile(tmp_path: Path, faults: Path) -> None:
    """A file that changes between the run's draw and the worker's is no silent mixture: the job fails, and says why."""
    path = recipe(tmp_path)
    loaded = load_recipe(path)
    from forestgen.dataset.settings import data_set_of
    from forestgen.runs.contract import Job, Work
    from forestgen.runs.storage import LocalStorage

    work = Work(loaded, data_set_of(loaded.draw(0)), LocalStorage(tmp_path / "data"), "versions")
    failed = make_job(work, Job(0, 0, "train", "000000-" + "0" * 40), 1)
    assert failed.kind == "recipe"  # type: ignore[union-attr]
    assert "changed since the batch was started" in failed.message  # type: ignore[union-attr]
    assert not (tmp_path / "data/train").exists()
