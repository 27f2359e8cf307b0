from __future__ import annotations

import errno
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from forestgen.core.errors import OutputError
from forestgen.dataset import folder as module
from forestgen.dataset.files import write_bytes
from forestgen.dataset.folder import OutputFolder
from support.error_messages import raises_error


def tree(root):
    return {path.relative_to(root).as_posix(): path.read_bytes() if path.is_file() else None
            for path in root.rglob("*")}  # fmt: skip


def make_run(target, text="old"):
    with OutputFolder(target) as staging:
        write_bytes(staging / "manifest.json", b'{"schema": "forestgen-manifest/1"}')
        write_bytes(staging / "data.txt", text.encode())


@pytest.fixture
def dead_pid():
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


def test_appears_whole_and_only_at_the_end(tmp_path):
    target = tmp_path / "deep" / "er" / "run"
    with OutputFolder(target) as staging:
        assert staging.parent == target.parent
        assert staging.name.startswith(".run.partial-")
        write_bytes(staging / "a", b"1")
        assert not target.exists()
    assert tree(tmp_path / "deep") == {"er": None, "er/run": None, "er/run/a": b"1"}
    assert target.stat().st_mode & 0o777 == 0o777 & ~current_umask()


def current_umask():
    mask = os.umask(0)
    os.umask(mask)
    return mask


def write_then_raise(target, error):
    with OutputFolder(target, overwrite=True) as staging:
        write_bytes(staging / "a", b"1")
        raise error


@pytest.mark.parametrize("interruption", [KeyboardInterrupt, SystemExit, ValueError, MemoryError])
def test_an_interruption_leaves_no_trace(tmp_path, interruption):
    make_run(tmp_path / "run")
    before = tree(tmp_path)
    for target in (tmp_path / "run", tmp_path / "new", tmp_path / "made" / "for" / "it"):
        with pytest.raises(interruption):
            write_then_raise(target, interruption)
        assert tree(tmp_path) == before


def test_relative_targets_and_links(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    make_run("run")
    (tmp_path / "link").symlink_to("run")
    with OutputFolder("link", overwrite=True) as staging:
        write_bytes(staging / "b", b"")
    assert (tmp_path / "link").is_symlink()
    assert tree(tmp_path / "run") == {"b": b""}


def test_a_file_is_refused(tmp_path):
    write_bytes(tmp_path / "run", b"precious")
    for overwrite in (False, True):
        with raises_error(OutputError, place="run"), OutputFolder(tmp_path / "run", overwrite=overwrite):
            pytest.fail("entered")
    assert tree(tmp_path) == {"run": b"precious"}


def test_a_file_among_the_parents_is_refused(tmp_path):
    write_bytes(tmp_path / "file", b"precious")
    with raises_error(OutputError, place="run"), OutputFolder(tmp_path / "file" / "run"):
        pytest.fail("entered")
    assert tree(tmp_path) == {"file": b"precious"}


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_strangers_folder_is_never_replaced(tmp_path, overwrite):
    (tmp_path / "run").mkdir()
    write_bytes(tmp_path / "run" / "thesis.tex", b"precious")
    write_bytes(tmp_path / "run" / "manifest.json", b"[1]")
    before = tree(tmp_path)
    with raises_error(OutputError, place="run"), OutputFolder(tmp_path / "run", overwrite=overwrite):
        pytest.fail("entered")
    assert tree(tmp_path) == before


def test_an_empty_folder_is_used(tmp_path):
    (tmp_path / "run").mkdir()
    make_run(tmp_path / "run")
    assert [path.name for path in tmp_path.iterdir()] == ["run"]
    assert (tmp_path / "run" / "data.txt").read_bytes() == b"old"


def test_a_previous_run_is_replaced_only_on_demand(tmp_path):
    make_run(tmp_path / "run")
    with raises_error(OutputError, place="run"), OutputFolder(tmp_path / "run"):
        pytest.fail("entered")
    with OutputFolder(tmp_path / "run", overwrite=True) as staging:
        write_bytes(staging / "new.txt", b"new")
        assert (tmp_path / "run" / "data.txt").read_bytes() == b"old"
    assert tree(tmp_path) == {"run": None, "run/new.txt": b"new"}


@pytest.mark.parametrize("failure", [OSError(errno.EACCES, "Permission denied"), KeyboardInterrupt()])
@pytest.mark.parametrize("failing", ["partial", "run"])
def test_a_failed_replacement_restores_the_old(tmp_path, monkeypatch, failure, failing):
    make_run(tmp_path / "run")
    before = tree(tmp_path)
    rename = Path.rename

    def refuse(self, target):
        if self.name == failing or self.name.startswith(f".run.{failing}"):
            raise failure
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", refuse)
    expected = OutputError if isinstance(failure, OSError) else KeyboardInterrupt
    with pytest.raises(expected), OutputFolder(tmp_path / "run", overwrite=True) as staging:
        write_bytes(staging / "new.txt", b"new")
    assert tree(tmp_path) == before


def test_a_target_that_appears_meanwhile_is_not_lost(tmp_path):
    staged = OutputFolder(tmp_path / "run")
    staged.__enter__()
    (tmp_path / "run").mkdir()
    write_bytes(tmp_path / "run" / "other", b"precious")
    with raises_error(OutputError, place="run"):
        staged.__exit__(None, None, None)
    assert tree(tmp_path) == {"run": None, "run/other": b"precious"}


def test_too_little_space(tmp_path):
    with (
        raises_error(OutputError, place="a"),
        OutputFolder(tmp_path / "a" / "run", required_bytes=10**18),
    ):
        pytest.fail("entered")
    assert tree(tmp_path) == {}


@pytest.mark.parametrize("code", [errno.EACCES, errno.EROFS, errno.ENOSPC])
def test_a_folder_that_cannot_be_made(tmp_path, monkeypatch, code):
    # Tests may run as root, whom permissions do not stop: so mkdir itself refuses.
    def refuse(self, *args, **kwargs):
        raise OSError(code, os.strerror(code), str(self))

    monkeypatch.setattr(Path, "mkdir", refuse)
    for target in (tmp_path / "run", tmp_path / "parent" / "run"):
        with raises_error(OutputError, place="run") as caught, OutputFolder(target):
            pytest.fail("entered")
        assert caught.value.hint
        assert "partial" not in str(caught.value)


def test_a_long_name_works_and_a_longer_one_is_explained(tmp_path):
    make_run(tmp_path / ("n" * 255))
    assert [path.name for path in tmp_path.iterdir()] == ["n" * 255]
    with raises_error(OutputError), OutputFolder(tmp_path / ("n" * 256)):
        pytest.fail("entered")


def test_a_loop_of_links_is_explained(tmp_path):
    (tmp_path / "a").symlink_to("b")
    (tmp_path / "b").symlink_to("a")
    with pytest.raises(OutputError), OutputFolder(tmp_path / "a"):
        pytest.fail("entered")


def test_a_full_disk_while_writing(tmp_path, monkeypatch):
    def full(self, content):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    make_run(tmp_path / "run")
    before = tree(tmp_path)
    monkeypatch.setattr(Path, "write_bytes", full)
    with (
        raises_error(OutputError, place="frame.exr") as caught,
        OutputFolder(tmp_path / "run", overwrite=True) as staging,
    ):
        write_bytes(staging / "frame.exr", b"1")
    assert caught.value.where == str(tmp_path / "run" / "frame.exr")
    assert tree(tmp_path) == before


def test_plain_oserrors_of_the_staging_folder_are_explained(tmp_path):
    with raises_error(OutputError, place="such"), OutputFolder(tmp_path / "run") as staging:
        (staging / "no" / "such").write_text("x")
    with raises_error(OutputError, place="run"), OutputFolder(tmp_path / "run"):
        raise OSError(errno.ENOSPC, "No space left on device")
    assert tree(tmp_path) == {}


def test_oserrors_about_other_things_pass(tmp_path):
    with pytest.raises(FileNotFoundError), OutputFolder(tmp_path / "run"):
        (tmp_path / "asset.ply").read_bytes()
    with pytest.raises(BrokenPipeError), OutputFolder(tmp_path / "run"):
        raise BrokenPipeError(errno.EPIPE, "Broken pipe")
    assert tree(tmp_path) == {}


@pytest.mark.skipif(not shutil.which("mount") or os.geteuid() != 0, reason="needs to mount a file system")
def test_a_real_full_disk(tmp_path):
    disk = tmp_path / "disk"
    disk.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(disk)], capture_output=True, check=False
    )
    if mounted.returncode != 0:
        pytest.skip("this machine does not let us mount a tmpfs")
    try:
        with raises_error(OutputError, place="disk"), OutputFolder(disk / "run", required_bytes=2**21):
            pytest.fail("entered")
        with raises_error(OutputError, place="big"), OutputFolder(disk / "run") as staging:
            write_bytes(staging / "big", bytes(2**21))
        assert tree(disk) == {}
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def test_leftovers_of_dead_processes_go_and_others_stay(tmp_path, dead_pid):
    host, mine = module._host(), os.getpid()
    gone = [
        tmp_path / f".run.partial-{host}-{dead_pid}-1-00000000",
        tmp_path / f".run.partial-{host}-{mine}-1-00000000",  # another process had this one's id, as in a container
        tmp_path / f".run.partial-{host}-{os.getppid()}-1-00000000",
    ]
    kept = [
        tmp_path / module.hidden_name(tmp_path / "run", "partial"),
        tmp_path / f".run.partial-{host}-{os.getppid()}-{module._started(os.getppid())}-00000000",
        tmp_path / f".run.partial-0000aaaa-{dead_pid}-1-00000000",
        tmp_path / f".other.partial-{host}-{dead_pid}-1-00000000",
        tmp_path / ".run.notes",
    ]
    for path in (*gone, *kept):
        path.mkdir()
    make_run(tmp_path / "run")
    assert {path.name for path in tmp_path.iterdir()} == {"run", *(path.name for path in kept)}


def test_a_replacement_that_was_killed_halfway_is_undone(tmp_path, dead_pid):
    make_run(tmp_path / "run")
    (tmp_path / "run").rename(tmp_path / f".run.replaced-{module._host()}-{dead_pid}-1-00000000")
    with raises_error(OutputError, place="run"), OutputFolder(tmp_path / "run"):
        pytest.fail("entered")
    assert (tmp_path / "run" / "data.txt").read_bytes() == b"old"
    assert [path.name for path in tmp_path.iterdir()] == ["run"]
