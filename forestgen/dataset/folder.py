"""The folder of a run: it appears whole, or not at all.

Files are staged in a hidden folder beside the target, ``.NAME.partial-HOST-PID-START-RANDOM``, and renamed into place
when all are written. On any failure, Ctrl-C included, the staging folder goes and what was there before stays. A
process that was killed leaves its staging folder behind; the next run to the same target clears it.
"""

from __future__ import annotations

import glob
import hashlib
import os
import platform
import secrets
import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import TracebackType

from forestgen.core.arguments import flag_of
from forestgen.core.errors import STORAGE_ERRNOS, OutputError, output_error
from forestgen.dataset.manifest import is_run_folder

_LONGEST_STEM = 160  # bytes: leaves room for the suffix in a file system's usual 255


class OutputFolder:
    """Context manager that gives the path of a staging folder and puts it in place on success.

    A target that cannot be used raises `OutputError` on entry, before anything is computed; a failed write later.

    Parameters
    ----------
    target : the run's folder, absent, empty, or a previous run's.
    overwrite : replace a previous run's folder. No other folder is ever replaced.
    required_bytes : an estimate of what will be written, checked against the disk's free space.
    is_ours : whether a folder is a previous output, which may be replaced.
    """

    def __init__(
        self,
        target: Path | str,
        *,
        overwrite: bool = False,
        required_bytes: int = 0,
        is_ours: Callable[[Path], bool] = is_run_folder,
    ) -> None:
        self.target = Path(target)
        self.is_ours = is_ours
        self.overwrite = overwrite
        self.required_bytes = required_bytes
        self._final = self.target
        self._staging: Path | None = None
        self._made_parents: list[Path] = []

    def __enter__(self) -> Path:
        try:
            self._final = self.target.resolve()  # a link to a folder stays a link: what it points at is replaced
            clear_leftovers(self._final)
            self._check_target()
            self._make_parents()
            self._check_space()
            staging = self._final.parent / hidden_name(self._final, "partial")
            self._staging = staging
            staging.mkdir()
        except (OSError, RuntimeError) as error:  # resolve() of looping links raises RuntimeError
            self._discard()
            raise self._as_output_error(error) from error
        except BaseException:
            self._discard()
            raise
        return staging

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        try:
            if error is None:
                self._commit()
                return
        except OSError as failure:
            raise self._as_output_error(failure) from failure
        finally:
            self._discard()
        # An error on a path is ours if the path is in the staging folder; one without a path if storage failed.
        if isinstance(error, OSError) and (
            self._below(error) is not None or (error.filename is None and error.errno in STORAGE_ERRNOS)
        ):
            raise self._as_output_error(error) from error
        if isinstance(error, OutputError) and error.where is not None:
            known = error.where.replace(str(self._staging), str(self.target))
            if known != error.where:  # name the folder that the user asked for, not the hidden one
                texts = {"expected": error.expected, "got": error.got, "hint": error.hint}
                raise OutputError(error.problem, where=known, **texts) from error

    def _check_target(self) -> None:
        target = self._final
        if not _exists(target):
            return
        if not target.is_dir():
            hint = "choose another name"
            raise OutputError("the output is a file", where=str(self.target), expected="a folder", hint=hint)
        if not any(target.iterdir()):
            return
        if not self.is_ours(target):
            problem = "the folder is not empty and holds no forestgen output"
            expected = "a new or empty folder, or a previous forestgen output"
            hint = "choose another folder; forestgen replaces only its own, with `overwrite=True`"
            raise OutputError(problem, where=str(self.target), expected=expected, hint=hint)
        if not flag_of(self.overwrite, "overwrite"):
            problem = "the folder already holds a forestgen output"
            hint = "choose another folder, or `overwrite=True` to replace it"
            raise OutputError(problem, where=str(self.target), hint=hint)

    def _make_parents(self) -> None:
        for folder in reversed(self._final.parents):
            if not _exists(folder):
                folder.mkdir()
                self._made_parents.append(folder)

    def _check_space(self) -> None:
        free = shutil.disk_usage(self._final.parent).free
        if free < self.required_bytes:
            problem, where = "too little free disk space", str(self._final.parent)
            expected = f"{self.required_bytes / 1e6:,.0f} MB"
            hint = "free some space, choose a folder on another disk, or make fewer or smaller images"
            raise OutputError(problem, where=where, expected=expected, got=f"{free / 1e6:,.0f} MB", hint=hint)

    def _commit(self) -> None:
        """Rename the staging folder into place; a folder that was there steps aside until that has worked."""
        assert self._staging is not None
        self._check_target()  # another process may have written there meanwhile
        if not self._final.exists():
            self._staging.rename(self._final)
            return
        aside = self._final.parent / hidden_name(self._final, "replaced")
        try:
            self._final.rename(aside)
            self._staging.rename(self._final)
        except BaseException:
            if aside.exists() and not self._final.exists():
                aside.rename(self._final)
            raise
        shutil.rmtree(aside, ignore_errors=True)  # what stays is cleared by the next run

    def _discard(self) -> None:
        """Remove the staging folder if it is still there, and the parents that were made for it and are empty."""
        if self._staging is not None:
            shutil.rmtree(self._staging, ignore_errors=True)
        with suppress(OSError):
            for folder in reversed(self._made_parents):
                folder.rmdir()

    def _below(self, error: OSError) -> Path | None:
        """The path of an error, below the staging folder; None: it lies elsewhere."""
        if self._staging is None or not isinstance(error.filename, str | os.PathLike):
            return None
        path = Path(error.filename)
        return path.relative_to(self._staging) if path.is_relative_to(self._staging) else None

    def _as_output_error(self, error: OSError | RuntimeError) -> OutputError:
        """It names the path that the user knows."""
        if not isinstance(error, OSError):
            return OutputError(f"cannot write: {error}", where=str(self.target), hint="choose another folder")
        return output_error(error, self.target / (self._below(error) or ""))


def _exists(path: Path) -> bool:
    """Whether there is anything, a broken link included; a path that cannot be read raises `OSError`."""
    try:
        os.lstat(path)
    except FileNotFoundError:
        return False
    return True


def _stem(target: Path) -> str:
    """Start of the hidden names beside `target`, the same in every process, within a file name's length."""
    name = target.name
    if len(os.fsencode(name)) > _LONGEST_STEM:
        name = f"{name[:32]}~{hashlib.sha256(os.fsencode(name)).hexdigest()[:16]}"
    return f".{name}."


def _host() -> str:
    """A token of this machine: a process id means something only there."""
    return hashlib.sha256(platform.node().encode()).hexdigest()[:8]


def hidden_name(target: Path, kind: str) -> str:
    """Name beside `target` for what this process has there for a while."""
    process = f"{os.getpid()}-{_started(os.getpid())}"
    return f"{_stem(target)}{kind}-{_host()}-{process}-{secrets.token_hex(4)}"


def _started(pid: int) -> str:
    """When a process was started, on a clock that nobody sets: ids are given again, at once in a new container."""
    import psutil

    try:
        status = Path(f"/proc/{pid}/stat").read_bytes()
        return status.rpartition(b")")[2].split()[19].decode()  # ticks since the machine was started
    except (OSError, IndexError):
        try:
            return str(int(100 * psutil.Process(pid).create_time()))
        except psutil.Error:
            return ""


def leftovers(target: Path, kind: str) -> list[Path]:
    """What processes of this machine that are dead have left beside `target`; sorted. In doubt a process lives."""
    import psutil

    found = []
    for path in sorted(target.parent.glob(f"{glob.escape(_stem(target))}{kind}-{_host()}-*")):
        process = path.name.rsplit("-", 3)[1:]
        if process[0].isdecimal() and not (
            psutil.pid_exists(int(process[0])) and _started(int(process[0])) in (process[1], "")
        ):
            found.append(path)
    return found


def clear_leftovers(target: Path) -> None:
    """Remove staging folders of dead processes, and finish what one killed while replacing had begun."""
    for path in leftovers(target, "replaced"):
        if target.exists():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.rename(target)
    for path in leftovers(target, "partial"):
        shutil.rmtree(path, ignore_errors=True)
