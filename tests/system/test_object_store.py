"""A data set in S3: a real S3 server on loopback, reached through fsspec as Amazon's is."""

from __future__ import annotations

import logging
import pickle
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import batch_pieces
import pytest

from forestgen.core.errors import ForestgenError, OutputError
from forestgen.recipe.load import load_recipe
from forestgen.runs import remote_storage, remote_store
from forestgen.runs.contract import Done, Job, JobRun, Notice, Outcome, RunOptions, StorageBackend, Work
from forestgen.runs.records import records_of
from forestgen.runs.remote_storage import RemoteLock, RemoteStorage, storage_of
from forestgen.runs.run import run_batch
from forestgen.runs.storage import LocalStorage
from forestgen.runs.work import failure_kind, make_job
from support.error_messages import raises_error

_SECRET = "vErYsEcReTkEy"
Make = Callable[[Work, Job, int], Outcome]


@pytest.fixture(scope="module")
def bucket() -> Iterator[str]:
    """Address of an empty bucket; credentials are in the environment."""
    from moto.server import ThreadedMotoServer

    logging.getLogger("werkzeug").setLevel(logging.CRITICAL)
    server = ThreadedMotoServer("127.0.0.1", 0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("AWS_ACCESS_KEY_ID", "someone")
        patch.setenv("AWS_SECRET_ACCESS_KEY", _SECRET)
        patch.setenv("AWS_DEFAULT_REGION", "us-east-1")
        patch.setenv("AWS_ENDPOINT_URL", f"http://{host}:{port}")
        remote_store._opened.cache_clear()
        remote_store.file_system("s3").mkdir("forests")
        yield "s3://forests"
    remote_store._opened.cache_clear()
    server.stop()


@pytest.fixture
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tries without pauses, and a lock that needs seconds where it needs minutes."""
    monkeypatch.setattr(remote_store, "PAUSES_S", (0.0, 0.01, 0.02, 0.03))
    monkeypatch.setattr(RemoteLock, "beat_s", 0.1)
    monkeypatch.setattr(RemoteLock, "patience_s", 1.0)
    monkeypatch.setattr(RemoteLock, "settle_s", 0.05)


class HereEngine:
    """Does each job at once, in this process; stops the run before one of them."""

    workers = 1

    def __init__(self, work: Work, make: Make, stop_before: int = -1) -> None:
        self.work, self.make, self.stop_before = work, make, stop_before
        self.outcomes: list[Outcome] = []
        self.images: list[int] = []

    def __enter__(self) -> HereEngine:
        return self

    def __exit__(self, *_: object) -> None:
        self.outcomes.clear()

    def submit(self, job: Job, attempt: int) -> None:
        if job.image == self.stop_before:
            raise KeyboardInterrupt
        self.images.append(job.image)
        self.outcomes.append(self.make(self.work, job, attempt))

    def wait(self, timeout_s: float) -> list[Outcome]:
        outcomes, self.outcomes = self.outcomes, []
        return outcomes


def folder_of(root: Path, files: dict[str, bytes]) -> Path:
    for name, content in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_bytes(content)
    return root


def visible(place: StorageBackend) -> list[str]:
    """Names in the data set's folder, but that of work in progress."""
    return [name for name in place.names("") if name != ".forestgen"]


@pytest.mark.parametrize("kind", ["local", "s3"])
def test_both_places_do_the_same(kind: str, bucket: str, tmp_path: Path) -> None:
    """One series of calls, the same answers from a folder and from S3."""
    place: StorageBackend = LocalStorage(tmp_path / "set") if kind == "local" else RemoteStorage(f"{bucket}/same")
    assert (place.names(""), place.names("x"), place.read("x"), place.size_bytes("x")) == ([], [], None, None)
    assert not place.exists("x")
    place.write("train/000000/a.json", b"{}")
    place.write("train2/b.json", b"[]")
    place.write("empty", b"")
    assert visible(place) == ["empty", "train", "train2"]
    assert place.names("train") == ["000000"]
    assert (place.read("empty"), place.size_bytes("empty"), place.exists("empty")) == (b"", 0, True)
    assert (place.read("train"), place.size_bytes("train"), place.exists("train")) == (None, None, True)

    staging = place.staging()
    folder_of(staging / "frame", {"image.png": b"1" * 7_000_000, "bop/shard.json": b"{}"})
    place.put_folder(staging / "frame", "train/000000")
    assert place.names("train/000000") == ["bop", "image.png"], "what lay there before is gone"
    assert place.size_bytes("train/000000/image.png") == 7_000_000
    folder_of(staging, {"thumbnail.jpg": b"small"})
    place.put_file(staging / "thumbnail.jpg", "thumbnails/000000.jpg")
    assert place.read("thumbnails/000000.jpg") == b"small"
    place.discard(staging)
    assert not staging.exists()

    place.remove("train")
    place.remove("train")
    place.remove("nothing")
    place.remove("empty")
    assert visible(place) == ["thumbnails", "train2"]
    with raises_error(ForestgenError):
        place.write("../outside", b"")


def test_many_files_go_and_come_with_few_requests(bucket: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """To know all names, or all sizes, or to remove all, takes a request each; files come back as they went."""
    place = RemoteStorage(f"{bucket}/many")
    files = {f"jobs/{number:06d}.json": str(number).encode() for number in range(40)}
    wanted = [name for name in files if name != "jobs/000007.json"]
    place.upload(folder_of(tmp_path / "up", {name: files[name] for name in wanted}))
    store, requests = remote_store.file_system("s3"), []
    real = store._call_s3

    async def counted(method: str, *args: Any, **kwargs: Any) -> Any:
        requests.append(method)
        return await real(method, *args, **kwargs)

    monkeypatch.setattr(store, "_call_s3", counted)
    listed = place.names("jobs")
    sizes = place.files("jobs")
    assert len(listed) == len(sizes) == 39
    assert requests == ["list_objects_v2"] * 2
    assert sizes["jobs/000012.json"] == 2
    place.fetch(wanted, tmp_path / "down")
    assert all((tmp_path / "down" / name).read_bytes() == files[name] for name in wanted)
    with pytest.raises(OutputError):
        place.fetch(["jobs/000007.json"], tmp_path / "down")
    with raises_error(OutputError, place="many"):
        place.fetch(["jobs/../../evil"], tmp_path / "down")
    place.link([("jobs/000001.json", "yolo/a"), ("jobs/000002.json", "yolo/b")])
    assert (place.read("yolo/a"), place.read("yolo/b")) == (b"1", b"2")
    requests.clear()
    place.remove_all(list(sizes))
    assert requests == ["delete_objects"]
    assert place.names("") == ["yolo"]


def test_a_place_takes_no_credentials_along(bucket: str) -> None:
    place = storage_of(f"{bucket}/anywhere")
    assert _SECRET.encode() not in pickle.dumps(place)
    assert pickle.loads(pickle.dumps(place)) == place


@pytest.mark.usefixtures("_quick")
def test_uploads_are_tried_again_and_checked(bucket: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A store that loses the end of a file twice is asked a third time; one that always does is an error."""
    place, store = RemoteStorage(f"{bucket}/torn"), remote_store.file_system("s3")
    source = folder_of(tmp_path, {"image.png": b"0123456789"}) / "image.png"
    real: Callable[..., Any] = store.put_file
    tries = []

    def torn(path: str, target: str) -> None:
        tries.append(target)
        if len(tries) <= limit:
            store.pipe_file(target, b"01234")
        else:
            real(path, target)

    monkeypatch.setattr(store, "put_file", torn)
    limit = 2
    place.put_file(source, "image.png")
    assert (place.read("image.png"), len(tries)) == (b"0123456789", 3)

    limit, tries = 99, []
    with raises_error(OutputError, place="image.png") as failure:
        place.put_folder(tmp_path, "frame")
    assert len(tries) == 4
    assert failure_kind(failure.value) == "output", "the job is tried again"


@pytest.mark.parametrize(
    "address",
    [
        "ftp://host/forests",
        "s3:/forests/a",
        "s3://",
        "s3://forests/../other",
        "gs://forests/a",
        f"s3://someone:{_SECRET}@forests/a",
    ],
)
def test_addresses_that_cannot_be(address: str) -> None:
    with raises_error(OutputError) as refusal:
        RemoteStorage(address)
    assert _SECRET not in str(refusal.value)


@pytest.mark.usefixtures("_quick")
def test_stores_that_refuse(bucket: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """No bucket, no permission, nobody there: named as such, soon, whatever is asked first."""
    nowhere = RemoteStorage("s3://no-such-bucket/a")
    for ask in (nowhere.names, nowhere.read, nowhere.size_bytes, nowhere.files, lambda path: nowhere.write(path, b"")):
        with raises_error(OutputError, place="no-such-bucket"):
            ask("x")
    with raises_error(OutputError, place="no-such-bucket"), nowhere.lock():
        pass

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError("Forbidden")

    with monkeypatch.context() as patch:
        patch.setattr(remote_store.file_system("s3"), "pipe_file", refuse)
        with raises_error(OutputError, place="x") as refusal:
            RemoteStorage(f"{bucket}/a").write("x", b"")
        assert failure_kind(refusal.value) == "output"


@pytest.mark.usefixtures("_quick", "bucket")
def test_an_endpoint_that_nobody_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:1")
    remote_store._opened.cache_clear()
    start = time.monotonic()
    try:
        with raises_error(OutputError, place="a"):
            RemoteStorage("s3://forests/a").names("")
    finally:
        remote_store._opened.cache_clear()
    assert time.monotonic() - start < 60.0


@pytest.mark.usefixtures("_quick")
def test_two_runs_at_one_address(bucket: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The second is refused while the first lives; a dead one's lock is taken over; one that lost it is told."""
    place, said = RemoteStorage(f"{bucket}/locked"), []
    with place.lock() as first:
        with (
            raises_error(OutputError, place="locked"),
            place.lock(said.append),
        ):
            pass
        first.check()
        assert len(said) == 1
        assert "waiting 1 s to see whether it lives" in said[0]
    assert place.files(".forestgen") == {}, "a run that ends leaves no lock"

    place.write(".forestgen/lock", b'{"owner": "somebody", "token": "dead"}')
    with place.lock(said.append) as second:
        assert "somebody" in said[-1]
        place.write(".forestgen/lock", b'{"owner": "a thief", "token": "other"}')
        time.sleep(0.5)
        with raises_error(OutputError, place="locked"):
            second.check()
    assert place.exists(".forestgen/lock"), "another's lock stays"


@pytest.mark.usefixtures("_quick")
@pytest.mark.parametrize("conditional", [True, False])
def test_of_runs_that_start_together_one_stays(conditional: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also in a store that overwrites where it is asked to write only what is not there."""
    from concurrent.futures import ThreadPoolExecutor
    from threading import Barrier

    monkeypatch.setattr(RemoteLock, "settle_s", 0.3)
    place = RemoteStorage(f"memory://together-{conditional}/a")
    together, begin = Barrier(5), Barrier(5)
    store = remote_store.file_system("memory")
    real: Callable[..., None] = store.pipe_file

    def write(path: str, content: bytes, mode: str = "overwrite") -> None:
        if mode == "create":
            begin.wait(10.0)  # each has seen that there is no lock
        real(path, content, mode=mode if conditional else "overwrite")

    monkeypatch.setattr(store, "pipe_file", write)

    def attempt(_: int) -> bool:
        try:
            with place.lock():
                together.wait(10.0)
                return True
        except OutputError:
            together.wait(10.0)
            return False

    with ThreadPoolExecutor(5) as pool:
        held = list(pool.map(attempt, range(5)))
    assert held.count(True) == 1


def test_the_lock_is_patient_enough() -> None:
    """A living owner beats several times before another may take its lock."""
    assert remote_storage.PATIENCE_S >= 4 * remote_storage.BEAT_S
    assert remote_storage.SETTLE_S < remote_storage.BEAT_S


@pytest.mark.usefixtures("_quick")
@pytest.mark.slow
def test_a_batch_in_s3_has_the_bytes_of_one_in_a_folder(whole: Path, bucket: str, tmp_path: Path) -> None:
    """Stopped before its last image and gone on with: nothing is made twice, and nothing differs.

    The last image is rendered; the others are put there as a worker would have.
    """

    def make(work: Work, job: Job, attempt: int) -> Outcome:
        if job.image == 3:
            return make_job(work, job, attempt)
        folder = batch_pieces.copied(whole, tmp_path / f"{job.image}", [job.image])
        RemoteStorage(target).upload(folder)
        (record,) = records_of(LocalStorage(folder))
        assert record.key == job.key
        return Done(job, record, JobRun(job.image, attempt, "here", 0.0))

    loaded, target = load_recipe(whole.parent / "fireweed.yaml"), f"{bucket}/batch"
    with pytest.raises(KeyboardInterrupt):
        run_batch(loaded, target, RunOptions(count=4), lambda work, notice: HereEngine(work, make, stop_before=3))
    engines: list[HereEngine] = []

    def resumed(work: Work, notice: Notice) -> HereEngine:
        engines.append(HereEngine(work, make))
        return engines[-1]

    run_batch(loaded, target, RunOptions(count=4, resume=True), resumed)
    assert engines[0].images == [3], "what was done is not done again"

    place = RemoteStorage(target)
    place.fetch(place.files(), tmp_path / "fetched")
    fetched = [path for path in (tmp_path / "fetched").rglob("*") if path.is_file()]
    assert batch_pieces.shown(tmp_path / "fetched") == batch_pieces.shown(whole)
    assert (tmp_path / "fetched" / "dataset.json").exists()
    assert not any(_SECRET.encode() in path.read_bytes() for path in fetched)

    place.write("train/000000-near/preview.png", b"cut")
    place.remove("val/000001-high/camera.json")
    place.remove("thumbnails/000002-near.jpg")
    summary = run_batch(loaded, target, RunOptions(count=4, resume=True), resumed)
    assert engines[1].images == [0, 1], "what a listing shows to be damaged is made again"
    assert summary.missing == ()
    place.fetch(place.files(), tmp_path / "again")
    assert batch_pieces.shown(tmp_path / "again") == batch_pieces.shown(whole)
