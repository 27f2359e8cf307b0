"""An object store through fsspec: opened, its failures in people's words, uploads that are tried again and checked."""

from __future__ import annotations

import errno
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from forestgen.core.errors import OutputError

T = TypeVar("T")

# Scheme -> what pip installs for it; "" where fsspec alone does it.
SCHEMES = {"s3": "forestgen[s3]", "gs": "gcsfs", "az": "adlfs", "abfs": "adlfs"}
_IN_PROCESS = "memory"  # fsspec's own, which ends with its process: for tests
CONNECTIONS = 16  # transfers at once
PAUSES_S = (0.0, 1.0, 4.0, 15.0)  # before each try of a transfer; the store's own library tries again as well
_FINAL_CODES = ("NoSuchBucket", "InvalidBucketName", "PermanentRedirect", "301")
_FINAL_ERRORS = ("NoCredentialsError", "PartialCredentialsError", "ParamValidationError", "InvalidRegionError")


def check_url(url: str) -> str:
    """The scheme of a data set's address, such as ``s3``; an address that cannot be one raises `OutputError`."""
    scheme, separator, path = url.partition("://")
    parts = path.removeprefix("/").removesuffix("/").split("/")
    if not separator or scheme not in (*SCHEMES, _IN_PROCESS):
        problem = "no kind of store that forestgen writes to"
        expected = "a folder, or " + ", ".join(f"{name}://" for name in SCHEMES)
        raise OutputError(problem, where=url, expected=expected, got=f"{scheme}://" if separator else "no scheme")
    if "@" in parts[0] and ":" in parts[0]:
        raise OutputError(
            "the address holds a password",  # so it is not repeated here
            where=f"{scheme}://",
            expected="an address without one: it would be in logs, and in the data card",
            hint="give credentials by the environment or by the store's own configuration file",
        )
    if any(part in ("", ".", "..") for part in parts) or any(mark in path for mark in "?#\\"):
        problem = "the address is no name of a folder in a store"
        raise OutputError(problem, where=url, expected=f"{scheme}://BUCKET/PREFIX")
    return scheme


def file_system(scheme: str) -> Any:
    """fsspec's file system of a scheme; one a process, which its threads share.

    Raises `OutputError` when the package for it is not installed.
    """
    return _opened(scheme, os.getpid())


@cache
def _opened(scheme: str, _process: int) -> Any:
    import fsspec

    # Listings are never kept: other processes write here.
    options: dict[str, Any] = {"use_listings_cache": False, "skip_instance_cache": True}
    if scheme == "s3":
        options["config_kwargs"] = {"max_pool_connections": 2 * CONNECTIONS}
    try:
        return fsspec.filesystem(scheme, **options)
    except ImportError as error:
        problem, where = f"{scheme}:// needs a package that is not installed here", f"{scheme}://"
        raise OutputError(problem, where=where, got=str(error), hint=f"pip install '{SCHEMES[scheme]}'") from error


@contextmanager
def storage_errors(where: str) -> Iterator[None]:
    """Failures of a store, which are of many libraries' types, as `OutputError`."""
    try:
        yield
    except OutputError:
        raise
    except Exception as error:  # noqa: BLE001 - each store's library has types of its own
        raise storage_error(error, where) from _as_os_error(error)


def store_code(error: BaseException) -> str:
    """The store's own code of a failure, such as ``NoSuchBucket``; "" if it gave none."""
    for one in (error, error.__cause__):
        response = getattr(one, "response", None)
        if isinstance(response, dict):
            return str(response.get("Error", {}).get("Code", ""))
    return ""


def is_final(error: BaseException) -> bool:
    """Whether trying again would fail again."""
    return (
        isinstance(error, PermissionError | FileNotFoundError | OutputError)
        or store_code(error) in _FINAL_CODES
        or type(error).__name__ in _FINAL_ERRORS
    )


def storage_error(error: BaseException, where: str) -> OutputError:
    """A failure as an `OutputError` with what to do about it."""
    name, code = type(error).__name__, store_code(error)
    got = f"{code}: {error}" if code else f"{name}: {error}"
    bucket = "/".join(where.split("/")[:3])
    if code == "NoSuchBucket" or "bucket does not exist" in str(error).lower():
        return OutputError("there is no such bucket", where=bucket, hint="make it, or correct its name")
    if name in ("NoCredentialsError", "PartialCredentialsError"):
        hint = "set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or AWS_PROFILE, here and on the workers"
        return OutputError("no credentials were found", where=where, hint=hint)
    if isinstance(error, PermissionError):
        expected = "credentials that may list the bucket, and read, write and delete objects below the prefix"
        hint = "check AWS_PROFILE or AWS_ACCESS_KEY_ID, here and on the workers, and the bucket's policy"
        return OutputError("the store refused access", where=where, expected=expected, got=got, hint=hint)
    if isinstance(error, ConnectionError | TimeoutError) or "Connect" in name or "Timeout" in name:
        hint = "check the network, and AWS_ENDPOINT_URL if the store is not Amazon's"
        return OutputError("the store does not answer", where=where, got=got, hint=hint)
    hint = "look at the store's own status, then `resume=True`"
    return OutputError("the store failed", where=where, got=got, hint=hint)


def _as_os_error(error: Exception) -> OSError:
    """A failure as an `OSError`: its cause tells callers that storage failed."""
    failure = OSError(errno.EIO, str(error))
    failure.__cause__ = error
    return failure


def persistently(task: Callable[[], T], where: str) -> T:
    """The result of a transfer, which is tried a few times unless the failure is a final one."""
    for pause_s in PAUSES_S:
        time.sleep(pause_s)
        try:
            return task()
        except Exception as error:  # noqa: BLE001 - as above
            if is_final(error) or pause_s == PAUSES_S[-1]:
                raise storage_error(error, where) from _as_os_error(error)
    raise AssertionError("unreachable")


def put_checked(store: Any, source: Path | bytes, target: str, where: str) -> None:
    """Upload a file, or bytes, and compare its size there; tried a few times.

    Raises `OutputError` when it did not arrive whole.
    """
    size = len(source) if isinstance(source, bytes) else source.stat().st_size

    def put() -> None:
        if isinstance(source, bytes):
            store.pipe_file(target, source)
        else:
            store.put_file(str(source), target)
        arrived = store.size(target)
        if arrived != size:
            raise OSError(f"{arrived} of {size} bytes arrived")

    persistently(put, where)
