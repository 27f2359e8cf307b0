"""What a kept result depends on besides its inputs: code, tables, packages, machine.

Whoever keeps results names the layers that shape them. A change in one of their files, of whatever kind, makes every
result anew: that costs time, and showing an old result would cost trust.
"""

from __future__ import annotations

import hashlib
import importlib.util
import platform
from collections.abc import Iterator
from functools import cache
from importlib.metadata import version
from pathlib import Path

from forestgen.core.registry import Registration, registrations
from forestgen.core.version import __version__

SOURCES = (".py", ".lark")
TABLES = (".csv", ".npz", ".yaml")
PACKAGE = Path(__file__).parents[1]


def code_hash(
    parts: tuple[str, ...], packages: tuple[str, ...], tables: tuple[Path, ...] = (), without: tuple[str, ...] = ()
) -> str:
    """Hash, hexadecimal, of all that shapes a kind of results besides their inputs.

    Parameters
    ----------
    parts : folders and files of the package, such as ``community`` and ``pipeline.py``.
    packages : that they compute with; their versions count, and those of forestgen and Python, and the machine's kind.
    tables : folders of tables that they read.
    without : folders and files of the parts that do not shape the results.

    Parts that other packages have registered count too, by the files of their modules.
    """
    return _code_hash(parts, packages, tables, without, registrations())


@cache
def _code_hash(
    parts: tuple[str, ...],
    packages: tuple[str, ...],
    tables: tuple[Path, ...],
    without: tuple[str, ...],
    registered: tuple[Registration, ...],
) -> str:
    digest = hashlib.blake2b(digest_size=20)
    versions = [version(name) for name in packages]
    digest.update(repr((__version__, platform.machine(), platform.python_version(), versions)).encode())
    for path in source_files(parts, without):
        _add(digest, PACKAGE, path)
    for folder in tables:
        for path in _files(folder, TABLES):
            _add(digest, folder, path)
    for one in registered:
        spec = importlib.util.find_spec(one.path.partition(":")[0])
        digest.update(f"\n{one.kind} {one.name} {one.path}\n".encode())
        if spec is not None and spec.origin is not None:
            _add(digest, Path(spec.origin).parent, Path(spec.origin))
    return digest.hexdigest()


def source_files(parts: tuple[str, ...], without: tuple[str, ...] = ()) -> list[Path]:
    """The files that `code_hash` reads of the package's parts."""
    left_out = [PACKAGE / one for one in without]
    found = (path for part in parts for path in _files(PACKAGE / part, SOURCES))
    return [path for path in found if not any(path.is_relative_to(one) for one in left_out)]


def _files(part: Path, suffixes: tuple[str, ...]) -> Iterator[Path]:
    """A file, or those of a folder, however deep, sorted."""
    if part.is_file():
        yield part
        return
    yield from sorted(path for path in part.rglob("*") if path.suffix in suffixes and path.is_file())


def _add(digest: hashlib.blake2b, root: Path, path: Path) -> None:
    """Name, size and content of a file."""
    content = path.read_bytes()
    digest.update(f"\n{path.relative_to(root).as_posix()} {len(content)}\n".encode())
    digest.update(content)
