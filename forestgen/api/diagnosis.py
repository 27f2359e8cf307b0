"""What this machine offers, and what to do about what is missing."""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any

from forestgen.core import __version__
from forestgen.core.processes import free_bytes
from forestgen.dataset.manifest import package_versions

_LEAST_FREE_BYTES = 3_000_000_000
_PATIENCE_S = 120
_LIBRARIES = (  # name, function of render.variant, remedy
    ("scalar_rgb", "check_scalar", "reinstall mitsuba: `uv sync --reinstall-package mitsuba`"),
    (
        "llvm_ad_rgb",
        "check_llvm",
        "install the package karellen-llvm-core, or point DRJIT_LIBLLVM_PATH at libLLVM 19 or newer",
    ),
)
_PREPARE = "pass"  # run before each check of a library; tests break the library here


@dataclass(frozen=True)
class Finding:
    """One line of a diagnosis."""

    name: str
    good: bool
    text: str
    remedy: str = ""
    required: bool = True


@dataclass(frozen=True)
class Diagnosis:
    """All findings."""

    version: str  # of forestgen
    python: str
    system: str
    findings: tuple[Finding, ...]

    @property
    def ready(self) -> bool:
        """Whether forestgen can render here."""
        return all(one.good or not one.required for one in self.findings)

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return {**asdict(self), "ready": self.ready}

    def __str__(self) -> str:
        return "\n".join(self.lines())

    def lines(self) -> Iterator[str]:
        """The findings, for people."""
        yield f"forestgen {self.version}, Python {self.python}, {self.system}"
        for one in self.findings:
            mark = "ok  " if one.good else ("FAIL" if one.required else "none")
            yield f"  {mark}  {one.name:<18} {one.text}"
            if not one.good and one.remedy:
                yield f"        {'':<18} -> {one.remedy}"
        yield "ready to render" if self.ready else "forestgen cannot render here yet"


def doctor() -> Diagnosis:
    """What this machine offers: `Diagnosis.ready` tells whether forestgen can render here."""
    libraries = (_tried(*one) for one in _LIBRARIES)  # each in a process of its own
    gpu = _tried("GPU", "cuda_devices", "", required=False)
    use = "used if FORESTGEN_TRACING is cuda" if gpu.good else "not needed"
    findings = (*_machine(), *libraries, replace(gpu, text=f"{gpu.text}; {use}"))
    system = f"{platform.system()} {platform.machine()}"
    return Diagnosis(__version__, platform.python_version(), system, findings)


def _machine() -> Iterator[Finding]:
    import psutil

    good = (3, 11) <= sys.version_info[:2] < (3, 14)
    version = f"{platform.python_version()}, {sys.executable}"
    yield Finding("Python", good, version, "use Python 3.11, 3.12 or 3.13")
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    yield Finding("cores", True, f"{usable} usable of {os.cpu_count()}")
    free = free_bytes()
    text = f"{free / 1e9:.1f} GB free of {psutil.virtual_memory().total / 1e9:.1f} GB"
    yield Finding("memory", free > _LEAST_FREE_BYTES, text, "close other programs: 3 GB is the least")
    free = shutil.disk_usage(".").free
    yield Finding("disk, this folder", free > 1e9, f"{free / 1e9:.1f} GB free", "a 640x360 frame takes about 25 MB")
    versions = package_versions()
    missing = [name for name, version in versions.items() if version is None]
    wanted = ("mitsuba", "drjit", "mitsuba-oidn", "numpy", "OpenEXR")
    text = ", ".join(f"{name} {versions[name] or 'missing'}" for name in wanted)
    yield Finding("packages", not missing, text, f"missing: {', '.join(missing)}; run `uv sync`")


def _tried(name: str, function: str, remedy: str, *, required: bool = True) -> Finding:
    """What a check of `render.variant` says, in a process of its own: an unfit library may end the whole process."""
    code = f"{_PREPARE}; from forestgen.render import variant; print(variant.{function}())"
    try:
        done = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, encoding="utf-8", timeout=_PATIENCE_S, check=False
        )
    except subprocess.TimeoutExpired:
        return Finding(name, False, f"no answer within {_PATIENCE_S} s", remedy, required)
    except OSError as error:
        return Finding(name, False, str(error), remedy, required)
    if done.returncode == 0:
        return Finding(name, True, done.stdout.strip(), required=required)
    last = (done.stderr.strip().splitlines() or ["it said nothing"])[-1].removeprefix("RuntimeError: ")
    crash = "" if done.returncode > 0 else f"crashed with signal {-done.returncode}: "
    return Finding(name, False, crash + last, remedy, required)
