"""manifest.json of what `simulate` and `calibrate` write, and of a split: what made its files, and their sums."""

from __future__ import annotations

import hashlib
import platform
import sys
from collections.abc import Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

from forestgen.dataset.files import write_json
from forestgen.dataset.safe_path import SafePath

MANIFEST_NAME = "manifest.json"
SCHEMA = "forestgen-manifest/1"
PACKAGES = (
    "forestgen", "numpy", "scipy", "numba", "mitsuba", "drjit", "mitsuba-oidn", "colour-science", "pvlib",
    "karellen-llvm-core", "trimesh", "OpenEXR", "pillow", "pyarrow", "pycocotools",
)  # fmt: skip


def build_manifest(
    root: Path,
    *,
    recipe_hash: str,
    root_seed: int,
    image_seeds: Sequence[int],
    timings_s: Mapping[str, float],
    extra: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Describe a run after all of its other files in `root` are written; `extra` is stored under ``run``."""
    return {
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


def write_manifest(root: Path, manifest: Mapping[str, Any]) -> None:
    """Write manifest.json into a run's folder."""
    write_json(root / MANIFEST_NAME, manifest)


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
            with path.open("rb") as stream:
                digest = hashlib.file_digest(stream, "sha256").hexdigest()
            files[name] = {"bytes": path.stat().st_size, "sha256": digest}
    return files
