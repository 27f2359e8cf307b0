"""Data sets from strangers: nothing outside is read or changed, nothing is waited for, no damage is a bug of ours."""

from __future__ import annotations

import hashlib
import json
import os
import random
import shutil
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from batch_pieces import copied
from command_line import Answer, run, tree
from hostile_sets import MARK, OUTSIDE, WAYS, WHOLES, changed, outside, summed
from pack_sets import batch

from forestgen.dataset.index import read_index
from support.data_sets import write_rows
from support.tiers import sampled

_LONGEST_S = 60.0  # of a command; a pipe that is waited for, or a device that is read to its end, takes for ever
_opened: list[str] = []
_watching: list[str] = []


def _watch(event: str, arguments: tuple[object, ...]) -> None:
    if _watching and event in ("open", "os.listdir", "os.scandir") and isinstance(arguments[0], str | os.PathLike):
        path = os.path.realpath(arguments[0])
        if path.startswith(_watching[0] + os.sep) or path == "/dev/zero":
            _opened.append(f"{event} {path}")


sys.addaudithook(_watch)  # for good: Python removes none


@pytest.fixture(scope="module")
def packable(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return batch(tmp_path_factory.mktemp("strange") / "set")


@pytest.fixture
def secret(tmp_path: Path) -> Iterator[Path]:
    """A folder beside the data set; what is opened in it meanwhile is written down."""
    folder = outside(tmp_path)
    _opened.clear()
    yield folder
    _watching.clear()


def commands(name: str, root: Path, out: Path) -> list[list[str | Path]]:
    """The commands that read a kind of data set."""
    return {
        "verify": [["verify", root, "--workers", "1"]],
        "merge": [["merge", root, "--out", out / "merged"]],
        "linked merge": [["merge", root, "--link", "--out", out / "linked"]],
        "report": [["report", root, "--out", out / "report.html", "--overwrite"]],
        "pack": [
            ["pack", root, "--format", "webdataset", "--out", out / "shards", "--channels", "preview,annotations"],
            ["pack", root, "--format", "huggingface", "--out", out / "pack"],
        ],
        "exr": [["pack", root, "--format", "webdataset", "--out", out / "exr", "--channels", "depth_m,exr"]],
    }[name]


def ask(names: str, root: Path, secret: Path | None = None) -> list[Answer]:
    """The answers of commands; none is a bug, takes long, or touches what lies outside."""
    out = root.parent / "out"
    out.mkdir(exist_ok=True)
    before = None if secret is None else tree(secret)
    if secret is not None:
        _watching[:] = [str(secret)]
    answers = []
    for name in names.split(", "):
        for command in commands(name, root, out):
            signal.setitimer(signal.ITIMER_REAL, _LONGEST_S)
            answer = run(*command)
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            assert answer.code in (0, 2, 4, 6), (command, answer.err)
            assert "Traceback" not in answer.err + answer.out
            answers.append(answer)
    _watching.clear()
    assert not _opened
    if secret is not None:
        assert tree(secret) == before
    made = b"".join(path.read_bytes() for path in out.rglob("*") if path.is_file())
    assert MARK.encode() not in made + "".join(answer.out + answer.err for answer in answers).encode()
    return answers


FRAME = "train/000000-near"
# A file or folder of the data set, and the commands that read it.
READ = {
    "dataset.json": "verify, merge, report",
    "index.parquet": "verify, report",
    "SHA256SUMS": "verify",
    "recipe.yaml": "verify, merge",
    "record": "verify, merge",
    ".forestgen/jobs": "verify, merge",
    "thumbnails/000000-near.jpg": "verify, merge",
    "train": "verify, merge, report",
    "train/manifest.json": "verify",
    "train/coco.json": "verify",
    "train/panoptic.json": "verify",
    "train/classes.json": "report, verify",
    "train/yolo/boxes/data.yaml": "verify",
    "train/bop": "verify",
    FRAME: "verify, merge, report",
    f"{FRAME}/frame.exr": "verify, merge, linked merge",
    f"{FRAME}/preview.png": "report, verify",
    f"{FRAME}/semantic.png": "verify",
    f"{FRAME}/plants.parquet": "verify",
    f"{FRAME}/camera.json": "verify",
    f"{FRAME}/recipe.yaml": "verify",
    f"{FRAME}/annotations.json": "verify, merge",
}
OF_A_PACK = {
    "index.parquet": "pack", "dataset.json": "pack", "README.md": "pack", "train": "pack", "train/classes.json": "pack",
    "train/000000-camera0": "pack", "train/000000-camera0/preview.png": "pack",
    "train/000000-camera0/annotations.json": "pack", "train/000000-camera0/camera.json": "pack, exr",
    "train/000000-camera0/depth.json": "pack", "train/000000-camera0/frame.exr": "exr",
}  # fmt: skip


def found(root: Path, name: str) -> Path:
    return sorted((root / ".forestgen/jobs").iterdir())[0] if name == "record" else root / name


QUICK = (FRAME, f"{FRAME}/frame.exr", "train", ".forestgen/jobs", "index.parquet", "train/bop")
SLOW_READ = [one if one in QUICK else pytest.param(one, marks=pytest.mark.slow) for one in READ]
SLOW_WAYS = [one if one == "a link to outside" else pytest.param(one, marks=pytest.mark.slow) for one in WAYS]


@pytest.mark.parametrize("name", SLOW_READ)
@pytest.mark.parametrize("way", SLOW_WAYS)
def test_no_file_of_a_data_set_leads_out_of_it(way: str, name: str, whole: Path, tmp_path: Path, secret: Path) -> None:
    root = copied(whole, tmp_path / "set")
    WAYS[way](found(root, name), secret)
    ask(READ[name], root, secret)


@pytest.mark.parametrize("way", sampled(WAYS, 3))
def test_of_one_file_in_every_way(way: str, whole: Path, tmp_path: Path, secret: Path) -> None:
    root = copied(whole, tmp_path / "set")
    WAYS[way](root / FRAME / "camera.json", secret)
    (answer,) = ask("verify", root, secret)
    assert answer.code == 6
    assert "camera.json" in answer.err


@pytest.mark.parametrize("way", SLOW_WAYS)
@pytest.mark.parametrize("name", OF_A_PACK)
def test_no_file_of_a_pack_leads_out_of_it(way: str, name: str, packable: Path, tmp_path: Path, secret: Path) -> None:
    root = shutil.copytree(packable, tmp_path / "set")
    WAYS[way](root / name, secret)
    codes = {answer.code for answer in ask(OF_A_PACK[name], root, secret)}
    assert codes == {"README.md": {0}, "train/000000-camera0/depth.json": {0, 6}}.get(name, {6})


NAMES = (f"../../{OUTSIDE}/own", f"/{OUTSIDE}/own", "..", "a\\own", "C:own", "a\nb", "", "\x00")


@pytest.mark.parametrize("name", sampled(NAMES))
def test_no_row_of_an_index_names_a_file_outside(name: str, packable: Path, tmp_path: Path, secret: Path) -> None:
    """Nor is a name that leads out, or breaks lines, written into a shard."""
    frame = packable / "train/000000-camera0"
    for target in (secret / "own", tmp_path / "own"):
        shutil.copytree(frame, target)
    for column in ("frame", "split"):
        root = shutil.copytree(packable, tmp_path / column)
        rows = list(read_index(root / "index.parquet"))
        rows[0][column] = name
        write_rows(root / "index.parquet", rows)
        assert [answer.code for answer in ask("pack", root, secret)] == [6, 6]
        ask("report", root, secret)


@pytest.mark.parametrize("name", sampled(NAMES))
def test_no_name_in_a_text_leads_out(name: str, whole: Path, tmp_path: Path, secret: Path) -> None:
    """Of sums, of records, of the manifest and of the files over all images; each is told, none is opened."""
    (secret / "own").write_text(MARK)
    root = copied(whole, tmp_path / "set")
    rows = list(read_index(root / "index.parquet"))
    rows[0]["folder"] = name
    write_rows(root / "index.parquet", rows)
    digest = hashlib.sha256(MARK.encode()).hexdigest()
    with (root / "SHA256SUMS").open("a") as sums:
        sums.write(f"{digest}  {name}\n")
    for file, change in {
        "manifest.json": lambda data: data["files"].update({name: {"bytes": len(MARK), "sha256": digest}}),
        "coco.json": lambda data: data["images"][0].update(file_name=name, camera=name),
        "panoptic.json": lambda data: data["annotations"][0].update(file_name=f"../{name}"),
    }.items():
        data = json.loads((root / "train" / file).read_text())
        change(data)
        (root / "train" / file).write_text(json.dumps(data))
    assert [answer.code for answer in ask("verify", root, secret)] == [6]
    other = copied(whole, tmp_path / "other")
    record = found(other, "record")
    data = json.loads(record.read_text())
    data["files"][name] = {"bytes": len(MARK), "sha256": digest}
    record.write_bytes(summed(json.dumps(data).encode()))
    assert [answer.code for answer in ask("verify, merge", other, secret)] == [6, 6]
    assert not (tmp_path / "out/merged").exists()


RESUMED = {
    ".forestgen/lock": 4, ".forestgen/holder.json": 4, ".forestgen/jobs": 6, ".forestgen/staging": 4, ".forestgen": 6,
    "train": 4, "thumbnails": 4, "maps": 4, "run": 4, "run/log.jsonl": 4, "train/coco.json": 0,
}  # fmt: skip


@pytest.mark.parametrize("name", sampled(RESUMED, 3))
def test_a_batch_that_goes_on_writes_and_removes_nothing_outside(
    name: str, whole: Path, tmp_path: Path, secret: Path
) -> None:
    """All images are done, so it only cleans, and writes the files over all of them."""
    root = copied(whole, tmp_path / "set")
    path, target = root / name, secret / "mine"
    if path.is_dir():
        path.rename(target)
    elif "." in path.name[1:] or path.name == "lock":
        target.write_text("mine")
    else:
        (target / "000009-mine").mkdir(parents=True)
    path.unlink(missing_ok=True)
    path.parent.mkdir(exist_ok=True)
    path.symlink_to(target)
    before = tree(secret)
    answer = run("batch", whole.parent / "fireweed.yaml", "--count", "4", "--out", root, "--resume", "--discard")
    assert answer.code == RESUMED[name], answer.err
    assert tree(secret) == before
    if answer.code == 0:
        assert not path.is_symlink()


def test_a_merge_copies_no_more_than_a_record_says(whole: Path, tmp_path: Path) -> None:
    root = copied(whole, tmp_path / "set")
    with (root / FRAME / "frame.exr").open("ab") as stream:
        stream.truncate(2**34)  # sparse: no disk holds the copy
    (answer,) = ask("merge", root)
    answer.refused(6)


def test_a_render_is_not_held_up_by_what_it_would_replace(tmp_path: Path) -> None:
    """--overwrite looks into the folder's manifest.json: a pipe is no manifest, and a link is none."""
    from forestgen.dataset.manifest import is_run_folder
    from forestgen.dataset.pack.pack import is_pack

    for name in ("manifest.json", "pack.json"):
        os.mkfifo(tmp_path / name)
    assert not is_run_folder(tmp_path)
    assert not is_pack(tmp_path)
    (tmp_path / "manifest.json").unlink()
    (tmp_path / "other.json").write_text('{"schema": "forestgen-manifest/1"}')
    (tmp_path / "manifest.json").symlink_to("other.json")
    assert not is_run_folder(tmp_path)
    (tmp_path / "manifest.json").unlink()
    (tmp_path / "manifest.json").write_text("[" * 100_000)
    assert not is_run_folder(tmp_path)


KINDS = {
    "dataset.json": "verify, merge, report",
    "record": "verify, merge",
    "train/manifest.json": "verify",
    "train/coco.json": "verify",
    "train/panoptic.json": "verify",
    "train/classes.json": "verify, report",
    "train/bop/train_pbr/000000/scene_gt.json": "verify",
    f"{FRAME}/camera.json": "verify",
    f"{FRAME}/annotations.json": "verify",
    f"{FRAME}/depth.json": "verify",
    "run/log.jsonl": "report",
}
OF_A_PACKS_JSON = {
    "dataset.json": "pack",
    "train/classes.json": "pack",
    "train/000000-camera0/camera.json": "pack, exr",
    "train/000000-camera0/annotations.json": "pack",
    "train/000000-camera0/depth.json": "pack",
}
LOG = '{"time": "2026-01-01T00:00:00", "event": "job_done", "image": 1, "seconds": 1, "timings_s": {"a": 1}}\n'


def write(root: Path, name: str, content: bytes) -> None:
    (root / "run").mkdir(exist_ok=True)
    path = found(root, name)
    path.write_bytes(summed(content) if name == "record" else content)


def content_of(root: Path, name: str) -> bytes:
    return LOG.encode() if name.startswith("run/") else found(root, name).read_bytes()


@pytest.mark.parametrize("name", sampled(KINDS, 3))
@pytest.mark.parametrize("seed", [1, *(pytest.param(k, marks=pytest.mark.slow) for k in range(2, 20))])
def test_wrong_values_in_json_are_ordinary_errors(name: str, seed: int, whole: Path, tmp_path: Path) -> None:
    root, rng = copied(whole, tmp_path / "set"), random.Random(seed)
    write(root, name, changed(content_of(root, name), rng))
    ask(KINDS[name], root)


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize("kind", [pytest.param(one, marks=pytest.mark.slow) for one in WHOLES])
def test_what_is_no_json_is_an_ordinary_error(name: str, kind: str, whole: Path, tmp_path: Path) -> None:
    root = copied(whole, tmp_path / "set")
    write(root, name, WHOLES[kind](content_of(root, name)))
    ask(KINDS[name], root)


@pytest.mark.parametrize("kind", sampled(WHOLES))
def test_of_each_kind_one_file(kind: str, whole: Path, tmp_path: Path) -> None:
    """Which file it is, is drawn: every command meets some."""
    root, rng = copied(whole, tmp_path / "set"), random.Random(kind)
    name = rng.choice(sorted(KINDS))
    write(root, name, WHOLES[kind](content_of(root, name)))
    ask(KINDS[name], root)


@pytest.mark.parametrize("name", sampled(OF_A_PACKS_JSON, 3))
@pytest.mark.parametrize("quick", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_of_a_pack_too(quick: bool, name: str, packable: Path, tmp_path: Path) -> None:
    content, rng = (packable / name).read_bytes(), random.Random(name)
    drawn = rng.sample(list(WHOLES.values()), 4 if quick else len(WHOLES))
    variants = [make(content) for make in drawn] + [changed(content, rng) for _ in range(4 if quick else 60)]
    root = shutil.copytree(packable, tmp_path / "set")
    for variant in variants:
        (root / name).write_bytes(variant)
        shutil.rmtree(tmp_path / "out", ignore_errors=True)
        ask(OF_A_PACKS_JSON[name], root)


def test_an_error_names_the_file(packable: Path, whole: Path, tmp_path: Path) -> None:
    root = copied(whole, tmp_path / "set")
    (root / "dataset.json").write_bytes(WHOLES["deeply nested"](b""))
    ask("verify", root)[0].refused(6)
    other = shutil.copytree(packable, tmp_path / "other")
    camera = other / "train/000000-camera0/camera.json"
    camera.write_bytes(WHOLES["nested as deep as Python can"](b""))
    for answer in ask("pack", other):
        answer.refused(6)
