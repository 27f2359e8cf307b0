"""What this machine offers, and what to do about what is missing."""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Callable
from dataclasses import dataclass

from forestgen import __version__
from forestgen.cli.console import output
from forestgen.dataset.manifest import package_versions
from forestgen.render.check import check_cuda, check_llvm, check_scalar

_LEAST_FREE_BYTES = 3_000_000_000


@dataclass(frozen=True)
class Finding:
    """One line of the report."""

    name: str
    good: bool
    text: str
    remedy: str = ""
    required: bool = True


def report() -> int:
    """Print the findings; exit code 0 if forestgen can render here, 3 if not."""
    out = output()
    out.print(f"forestgen {__version__}, Python {platform.python_version()}, {platform.system()} {platform.machine()}")
    blocked = False
    for find in (_python, _cores, _memory, _disk, _packages, _scalar, _llvm, _cuda):
        finding = find()
        mark = "ok  " if finding.good else ("FAIL" if finding.required else "none")
        out.print(f"  {mark}  {finding.name:<18} {finding.text}", markup=False)
        if not finding.good and finding.remedy:
            out.print(f"        {'':<18} -> {finding.remedy}", markup=False)
        blocked |= finding.required and not finding.good
    out.print("forestgen cannot render here yet" if blocked else "ready to render")
    return 3 if blocked else 0


def _python() -> Finding:
    good = (3, 11) <= sys.version_info[:2] < (3, 14)
    return Finding("Python", good, platform.python_version(), "use Python 3.11, 3.12 or 3.13")


def _cores() -> Finding:
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return Finding("cores", True, f"{usable} usable of {os.cpu_count()}")


def _memory() -> Finding:
    import psutil

    memory = psutil.virtual_memory()
    text = f"{memory.available / 1e9:.1f} GB free of {memory.total / 1e9:.1f} GB"
    return Finding("memory", memory.available > _LEAST_FREE_BYTES, text, "free some memory: 3 GB is the least")


def _disk() -> Finding:
    import shutil

    free = shutil.disk_usage(".").free
    return Finding("disk, this folder", free > 1e9, f"{free / 1e9:.1f} GB free", "a 640x360 frame takes about 25 MB")


def _packages() -> Finding:
    versions = package_versions()
    missing = [name for name, version in versions.items() if version is None]
    wanted = ("mitsuba", "drjit", "mitsuba-oidn", "numpy", "OpenEXR")
    text = ", ".join(f"{name} {versions[name]}" for name in wanted)
    return Finding("packages", not missing, text, f"missing: {', '.join(missing)}; run `uv sync`")


def _checked(name: str, check: Callable[[], str], remedy: str, *, required: bool = True) -> Finding:
    try:
        return Finding(name, True, check(), required=required)
    except (RuntimeError, ImportError, AttributeError, OSError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        return Finding(name, False, reason, remedy, required)


def _scalar() -> Finding:
    return _checked("scalar_rgb", check_scalar, "reinstall mitsuba: `uv sync --reinstall-package mitsuba`")


def _llvm() -> Finding:
    remedy = "install karellen-llvm-core, or point DRJIT_LIBLLVM_PATH at libLLVM 19 or newer"
    return _checked("llvm_ad_rgb", check_llvm, remedy)


def _cuda() -> Finding:
    remedy = "no NVIDIA GPU or driver; forestgen does not need one"
    return _checked("cuda_ad_rgb", check_cuda, remedy, required=False)
