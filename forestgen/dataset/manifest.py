"""What made files, and their sums: manifest.json of `simulate`, `calibrate` and a split, and SHA256SUMS of a data set.

SHA256SUMS has a line a file, as `sha256sum -c SHA256SUMS` reads it.
"""

from __future__ import annotations

import hashlib
import platform
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

from forestgen.core.errors import DatasetError, writing
from forestgen.dataset.files import write_json
from forestgen.dataset.safe_path import SafePath, is_inside

MANIFEST_NAME, SUMS_NAME = "manifest.json", "SHA256SUMS"
_LINE = re.compile(r"([0-9a-f]{64}) [ *](.+)")  # of SHA256SUMS
_LONGEST_LINE = 8192  # bytes
SCHEMA = "forestgen-manifest/1"
PACKAGES = (
    "forestgen", "numpy", "scipy", "numba", "mitsuba", "drjit", "mitsuba-oidn", "colour-science", "pvlib",
    "karellen-llvm-core", "trimesh", "OpenEXR", "pillow", "pyarrow", "pycocotools",
)  # fmt: skip


def write_manifest(
    root: Path,
    *,
    recipe_hash: str,
    root_seed: int,
    image_seeds: Sequence[int],
    timings_s: Mapping[str, float],
    extra: Mapping[str, Any] | None = None,
) -> None:
    """Describe a run, when all of its other files in `root` are written; `extra` is stored under ``run``."""
    content = {
        "schema": SCHEMA,
        "recipe_hash": recipe_hash,
        "root_seed": int(root_seed),
        "image_seeds": [int(seed) for seed in image_seeds],
        "versions": package_versions(),
        "python": platform.python_version(),
        "platform": {"system": platform.system(), "machine": platform.machine()},
        "timings_s": {stage: float(seconds) for stage, seconds in timings_s.items()},
        "peak_memory_bytes": peak_memory_bytes(),
        "files": list_files(root),
        "run": dict(extra or {}),
    }
    write_json(root / MANIFEST_NAME, content)


def is_run_folder(folder: Path) -> bool:
    """Whether `folder` holds a manifest of ours: only such a folder may ever be replaced."""
    try:
        content = SafePath(folder, MANIFEST_NAME).read_json()
    except (OSError, ValueError):
        return False
    return isinstance(content, dict) and str(content.get("schema", "")).startswith("forestgen-manifest/")


def package_versions() -> dict[str, str | None]:
    """Package -> installed version; None where a package is missing."""
    versions: dict[str, str | None] = {}
    for name in PACKAGES:
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            versions[name] = None
    return versions


def peak_memory_bytes() -> int:
    """Largest resident memory of this process so far."""
    if sys.platform == "win32":
        import psutil

        return int(psutil.Process().memory_info().peak_wset)
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(peak) * (1 if sys.platform == "darwin" else 1024)  # macOS counts bytes, Linux KiB


def list_files(root: Path) -> dict[str, dict[str, Any]]:
    """Path relative to `root`, with forward slashes -> size in bytes and SHA-256, the manifest left out."""
    files: dict[str, dict[str, Any]] = {}
    for path in sorted(root.rglob("*")):
        name = path.relative_to(root).as_posix()
        if path.is_file() and name != MANIFEST_NAME:
            files[name] = {"bytes": path.stat().st_size, "sha256": file_sum(path)}
    return files


def write_sums(path: Path, sums: Iterable[tuple[str, str]]) -> None:
    """Write path and SHA-256, hexadecimal, of each file, in the order given; a failure raises `OutputError`."""
    with writing(path), path.open("w", encoding="utf-8", newline="\n") as stream:
        stream.writelines(f"{digest}  {name}\n" for name, digest in sums)


def read_sums(path: Path, refused: Callable[[DatasetError], None] | None = None) -> Iterator[tuple[str, str]]:
    """Path and SHA-256 of each file that is listed; a file that is missing raises `DatasetError`.

    `refused` takes the error of each line of another form, and the other lines are read; None: the first one raises.
    """
    try:
        with SafePath(path.parent, path.name).open() as stream:
            lines = (line.decode("utf-8") for line in iter(lambda: stream.readline(_LONGEST_LINE), b""))
            for number, line in enumerate(lines, start=1):
                match = _LINE.fullmatch(line.rstrip("\n"))
                if match is None or not line.endswith("\n") or not is_inside(match[2]):
                    error = DatasetError(
                        "this line is no checksum",
                        where=f"{path}:{number}",
                        expected="64 hexadecimal digits, two blanks and a path below the data set's folder",
                        got=repr(line[:80]),
                    )
                    if refused is None:
                        raise error
                    refused(error)
                else:
                    yield match[2], match[1]
    except (OSError, ValueError) as error:  # ValueError: bytes that are no UTF-8
        raise DatasetError("the checksums cannot be read", where=str(path), got=str(error)) from error


def file_sum(path: Path | SafePath) -> str:
    """SHA-256, hexadecimal, of a file."""
    with path.open() if isinstance(path, SafePath) else path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
