"""The report of awkward folders: each makes a whole page, or one clear error and nothing."""

from __future__ import annotations

import base64
import io
import json
import os
import re
import shutil

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from forestgen.api.datasets import write_report as write_page
from forestgen.cli import app
from forestgen.core.errors import DatasetError, OutputError, RecipeError
from forestgen.dataset import png
from forestgen.dataset.index import INDEX_NAME, read_index
from forestgen.dataset.report.frames import read_frames
from forestgen.dataset.report.page import BUDGET_BYTES, MOST_FRAMES, _mask, _photo, choose, write_report
from forestgen.dataset.report.source import MOST_MESSAGES, read_run
from support.data_sets import SPLITS, write_data_set, write_rows
from support.error_messages import raises_error

PICTURE = re.compile(r'src="data:image/webp;base64,([^"]*)"')


def report(folder) -> str:
    write_report(folder, folder / "report.html")
    return (folder / "report.html").read_text(encoding="utf-8")


def pictures(page: str) -> list[Image.Image]:
    return [Image.open(io.BytesIO(base64.b64decode(content))) for content in PICTURE.findall(page)]


def test_the_page_depends_on_the_files_alone(tmp_path):
    write_data_set(tmp_path / "a", 6)
    shutil.copytree(tmp_path / "a", tmp_path / "somewhere" / "a")
    first = report(tmp_path / "a")
    assert report(tmp_path / "a") == first  # over the first
    assert report(tmp_path / "somewhere" / "a") == first
    assert str(tmp_path) not in first


def test_one_image_and_no_run(tmp_path):
    write_data_set(tmp_path, 1, run=False)
    page = report(tmp_path)
    assert len(pictures(page)) == 3
    assert "There is no log of a run" in page


def test_no_failures(tmp_path):
    write_data_set(tmp_path, 5)
    log = tmp_path / "run" / "log.jsonl"
    log.write_text("\n".join(line for line in log.read_text().splitlines() if "job_failed" not in line))
    assert "No attempt failed." in report(tmp_path)


def test_without_the_jobs_table_the_log_tells_the_same(tmp_path):
    write_data_set(tmp_path, 9)
    whole = read_run(tmp_path)
    (tmp_path / "run" / "jobs.parquet").unlink()
    log = read_run(tmp_path)
    assert log == whole
    assert log.done == set(range(8))
    assert log.given_up == [8]
    assert log.damaged_lines == 1


def test_times_of_a_resumed_run_leave_the_pause_out(tmp_path):
    (tmp_path / "run").mkdir()
    lines = [
        {"time": "2026-01-01T00:00:00+00:00", "event": "start"},
        {"time": "2026-01-01T00:01:00+00:00", "event": "job_done", "image": 0, "seconds": 60},
        {"time": "2026-01-02T00:00:00+00:00", "event": "start"},
        {"time": "2026-01-02T00:03:00+00:00", "event": "job_done", "image": 1, "seconds": 180},
    ]
    (tmp_path / "run" / "log.jsonl").write_text("\n".join(map(json.dumps, lines)))
    run = read_run(tmp_path)
    assert (run.runs, run.running_s, run.finished_s) == (2, 240.0, [60.0, 240.0])
    assert run.images_per_hour == pytest.approx(30.0)


@pytest.mark.parametrize(
    "line",
    [b"\xff\xfe", b"[1, 2]", b"{}", b'{"event": 3}', b'{"event": "job_done"}', b'{"event": "job_done", "image": "x"}',
     b"[" * 100_000, b'{"event": "job_done", "image": NaN}'],
)  # fmt: skip
def test_a_damaged_line_counts_and_harms_nothing(tmp_path, line):
    write_data_set(tmp_path, 3)
    before = read_run(tmp_path)
    with (tmp_path / "run" / "log.jsonl").open("ab") as log:
        log.write(line + b"\n")
    after = read_run(tmp_path)
    assert after.damaged_lines == before.damaged_lines + 1
    assert (after.done, after.failures) == (before.done, before.failures)
    assert "cannot be read" in report(tmp_path)


@pytest.mark.parametrize(
    "fields",
    [{"seconds": "long"}, {"timings_s": [1, 2]}, {"timings_s": {"x": None}}, {"peak_memory_bytes": -5}, {"time": 7},
     {"time": "soon"}, {"worker": {}}],
)  # fmt: skip
def test_strange_values_in_a_line_harm_nothing(tmp_path, fields):
    write_data_set(tmp_path, 3)
    (tmp_path / "run" / "jobs.parquet").unlink()
    line = {"time": "2026-01-05T20:00:00+00:00", "event": "job_done", "image": 0, "seconds": 3, **fields}
    with (tmp_path / "run" / "log.jsonl").open("a") as log:
        log.write(json.dumps(line) + "\n")
    assert "Time and memory" in report(tmp_path)


def test_many_messages_are_bounded(tmp_path):
    (tmp_path / "run").mkdir()
    lines = [
        {
            "time": "2026-01-01T00:00:00+00:00",
            "event": "job_failed",
            "image": k,
            "kind": "bug",
            "message": f"no. {k}" * 999,
        }
        for k in range(500)
    ]
    (tmp_path / "run" / "log.jsonl").write_text("\n".join(map(json.dumps, lines)))
    run = read_run(tmp_path)
    assert len(run.failures) == MOST_MESSAGES
    assert run.failed_attempts == 500
    assert run.unlisted_attempts == 500 - MOST_MESSAGES
    assert len(report(tmp_path)) < 200_000


def test_a_run_that_has_not_ended_has_a_report(tmp_path):
    write_data_set(tmp_path, 4)
    (tmp_path / INDEX_NAME).unlink()
    assert "the run has not ended" in report(tmp_path)


def test_a_lost_preview_is_shown_by_its_thumbnail(tmp_path):
    (row,) = write_data_set(tmp_path, 1, run=False)
    (tmp_path / row["folder"] / "preview.png").unlink()
    (tmp_path / "thumbnails").mkdir()
    Image.new("RGB", (20, 10), (200, 30, 30)).save(tmp_path / "thumbnails" / f"{row['frame']}.jpg")
    assert [picture.size for picture in pictures(report(tmp_path))] == [(20, 10), (48, 36), (48, 36)]


@pytest.mark.parametrize("content", [b"", b"\x89PNG\r\n\x1a\n", b"GIF89a", None])
def test_a_damaged_picture_is_left_out(tmp_path, content):
    (row,) = write_data_set(tmp_path, 1, run=False)
    for path in (tmp_path / row["folder"]).glob("*.png"):
        path.unlink() if content is None else path.write_bytes(content)
    page = report(tmp_path)
    assert pictures(page) == []
    assert "No picture of it can be read." in page


@pytest.mark.parametrize("folder", ["../outside/a", "/{outside}/a", "train/link"])
def test_pictures_outside_the_data_set_stay_there(tmp_path, folder):
    data, outside = tmp_path / "data", tmp_path / "outside"
    (row,) = write_data_set(data, 1, run=False)
    shutil.move(data / row["folder"], outside / "a")
    (data / "train" / "link").symlink_to(outside / "a")
    write_rows(data / INDEX_NAME, [{**row, "folder": folder.format(outside=outside)}])
    assert pictures(report(data)) == []


def test_masks_keep_their_colours(tmp_path):
    (row,) = write_data_set(tmp_path, 1, run=False)
    shown = pictures(report(tmp_path))[2].convert("RGB")
    with Image.open(tmp_path / row["folder"] / "semantic.png") as mask:
        assert np.array_equal(np.asarray(shown), np.asarray(mask.convert("RGB")))


def test_columns_that_lack_are_unknown(tmp_path):
    import pyarrow.parquet as pq

    write_data_set(tmp_path, 5, run=False)
    table = pq.read_table(tmp_path / INDEX_NAME)
    for name in ("folder", "class_pixels", "sun_azimuth_deg", "width_px", "draw.sky.turbidity"):
        pq.write_table(table.drop_columns([name]), tmp_path / INDEX_NAME)
        report(tmp_path)
    pq.write_table(table.select(["frame", "split", "image"]), tmp_path / INDEX_NAME)
    assert "No classes are counted here." in report(tmp_path)


def test_the_sample_spreads_over_splits_and_strata(tmp_path):
    write_data_set(tmp_path, 600, run=False, pictures=False)
    frames = read_frames(tmp_path / INDEX_NAME)
    rows = choose(frames, tuple(SPLITS))
    assert len(rows) == len(set(rows)) == MOST_FRAMES
    for column, count in (("split", 3), ("season", 2), ("clouds", 3)):
        texts = frames.texts(column)
        shown = [texts[row] for row in rows]
        assert len(set(shown)) == count
        assert min(map(shown.count, shown)) >= MOST_FRAMES // count // 2
    images = frames.numbers("image")[rows]
    assert images.min() < 60
    assert images.max() > 540


@pytest.mark.parametrize("encode", [_photo, _mask])
@pytest.mark.parametrize("quota", [BUDGET_BYTES // (3 * MOST_FRAMES), 60_000])
def test_a_picture_keeps_within_its_quota(encode, quota):
    noise = np.random.default_rng(0).integers(0, 256, (300, 400, 3), dtype=np.uint8)  # no encoder can press it
    content = encode(Image.fromarray(noise), quota)
    assert quota / 3 < len(content) <= quota
    with Image.open(io.BytesIO(content)) as small:
        assert small.width / small.height == pytest.approx(4 / 3, rel=0.03)


def test_a_page_of_many_images_stays_small(tmp_path):
    rows = write_data_set(tmp_path, 40, run=False, pictures=False)
    many = [{**rows[k % 40], "frame": f"{k:06d}-eye", "image": k, "folder": "train/noise"} for k in range(3000)]
    write_rows(tmp_path / INDEX_NAME, many)
    noise = np.random.default_rng(0).integers(0, 256, (24, 32, 3), dtype=np.uint8)
    (tmp_path / "train" / "noise").mkdir(parents=True)
    for name in ("preview.png", "overlay.png", "semantic.png"):
        png.write_png(tmp_path / "train" / "noise" / name, noise)
    page = report(tmp_path)
    assert len(pictures(page)) == 3 * MOST_FRAMES
    assert len(PICTURE.sub("", page)) < 300_000  # all but the pictures
    assert "3,000" in page


def test_a_folder_that_is_none_of_ours(tmp_path):
    for folder in (tmp_path, tmp_path / "nowhere"):
        with raises_error(RecipeError):
            write_report(folder, tmp_path / "report.html")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("content", [b"", b"PAR1 but not really PAR1"])
def test_a_damaged_index(tmp_path, content):
    write_data_set(tmp_path, 2)
    (tmp_path / INDEX_NAME).write_bytes(content)
    with raises_error(DatasetError, place="index.parquet"):
        write_report(tmp_path, tmp_path / "report.html")
    assert not (tmp_path / "report.html").exists()


def test_a_damaged_card_is_told(tmp_path):
    write_data_set(tmp_path, 2)
    (tmp_path / "dataset.json").write_text("{")
    assert "dataset.json cannot be read." in report(tmp_path)


@pytest.mark.parametrize("card", [{"recipes": 3, "splits": ["x"], "licence": 1}, {"recipes": [{"missing": [[1]]}, 5]}])
def test_a_strange_card_harms_nothing(tmp_path, card):
    write_data_set(tmp_path, 2)
    (tmp_path / "dataset.json").write_text(json.dumps(card))
    assert len(pictures(report(tmp_path))) >= 2


def test_a_page_that_cannot_be_written(tmp_path):
    write_data_set(tmp_path / "data", 1, run=False)
    (tmp_path / "data" / "taken").mkdir()
    for target in (tmp_path / "nowhere" / "report.html", tmp_path / "data" / "taken"):
        with raises_error(OutputError):
            write_report(tmp_path / "data", target)
    assert not any("report" in path.name for path in tmp_path.rglob("*"))


def test_a_page_replaces_nothing_unasked(tmp_path):
    """But the data set's own page; and what is no regular file stays whatever is asked for."""
    write_data_set(tmp_path / "data", 1, run=False)
    target = tmp_path / "page.html"
    target.write_text("mine")
    with raises_error(OutputError, place="page.html"):
        write_page(tmp_path / "data", target)
    assert target.read_text() == "mine"
    result = CliRunner().invoke(app, ["report", str(tmp_path / "data"), "-o", str(target)])
    assert result.exit_code == 4
    result = CliRunner().invoke(app, ["report", str(tmp_path / "data"), "-o", str(target), "--overwrite"])
    assert result.exit_code == 0
    (tmp_path / "link").symlink_to("data")
    for own in (None, tmp_path / "data" / "report.html", tmp_path / "link" / "report.html"):
        (tmp_path / "data" / "report.html").write_text("an older page")
        write_page(tmp_path / "data", own)
        assert (tmp_path / "data" / "report.html").read_bytes() == target.read_bytes()
    (tmp_path / "data" / "report.html").unlink()
    os.mkfifo(tmp_path / "data" / "report.html")
    (tmp_path / "linked.html").symlink_to(target)
    for strange in (None, tmp_path / "data" / "report.html", tmp_path / "linked.html"):
        with raises_error(OutputError):
            write_page(tmp_path / "data", strange, overwrite=True)
    assert (tmp_path / "linked.html").is_symlink()


def test_the_command(tmp_path):
    write_data_set(tmp_path / "data", 2)
    result = CliRunner().invoke(app, ["report", str(tmp_path / "data")], prog_name="forestgen")
    assert (result.exit_code, result.stderr) == (0, "")
    assert f"file: {tmp_path / 'data' / 'report.html'}" in result.stdout
    result = CliRunner().invoke(app, ["report", str(tmp_path / "data"), "--out", str(tmp_path / "page.html")])
    assert (tmp_path / "page.html").read_bytes() == (tmp_path / "data" / "report.html").read_bytes()
    refused = CliRunner().invoke(app, ["report", str(tmp_path)], prog_name="forestgen")
    assert refused.exit_code == RecipeError.exit_code
    assert refused.stderr.startswith("error: ")
    assert len(list(read_index(tmp_path / "data" / INDEX_NAME))) == 1
