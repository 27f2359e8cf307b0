"""Mitsuba's variants, made ready once. Nothing else in forestgen imports Mitsuba at module level.

The scalar variant traces radiance (bitwise repeatable, any number of instances); the LLVM variant traces identity
(no per-instance code). Both need Dr.Jit, whose LLVM back end needs libLLVM >= 19: the wheel `karellen-llvm-core` ships
one in the environment's lib/, and DRJIT_LIBLLVM_PATH must name it before Dr.Jit is first imported.
"""

from __future__ import annotations

import importlib
import os
import sys
import sysconfig
from pathlib import Path
from typing import Any

from forestgen.core.errors import ResourceError
from forestgen.core.interrupts import uninterrupted

SCALAR = "scalar_rgb"
LLVM = "llvm_ad_rgb"
# Pixels along a render block's side, for every integrator. Each block has a random stream of its own, and unless it is
# told a size Mitsuba halves it until every thread has a block: the image would depend on the number of cores.
BLOCK_PX = 16
_ready: dict[str, Any] = {}


def find_llvm() -> Path | None:
    """libLLVM of the environment's wheel, or the one that DRJIT_LIBLLVM_PATH names; None if there is neither."""
    named = os.environ.get("DRJIT_LIBLLVM_PATH")
    if named and Path(named).is_file():
        return Path(named)
    folders = {Path(sys.prefix) / "lib", Path(sysconfig.get_path("data")) / "lib"}
    candidates = [library for folder in folders for library in folder.glob("libLLVM*.so*") if library.is_file()]
    return max(candidates, default=None)


def mitsuba(threads: int | None = None) -> Any:
    """The `mitsuba` module, prepared; call `mi.variant_context` before building anything with it.

    Parameters
    ----------
    threads : size of the renderer's thread pool; None keeps the current one (at first: all cores).
    """
    if "mitsuba" not in _ready:
        library = find_llvm()
        if library is not None:
            os.environ["DRJIT_LIBLLVM_PATH"] = str(library)
        with uninterrupted():
            module: Any = importlib.import_module("mitsuba")
            module.set_variant(SCALAR)
        module.set_log_level(module.LogLevel.Error)
        _ready["mitsuba"] = module
    if threads is not None:
        drjit().set_thread_count(threads)
    return _ready["mitsuba"]


def drjit() -> Any:
    """The `drjit` module, after LLVM's place is known."""
    if "mitsuba" not in _ready:
        mitsuba()
    return importlib.import_module("drjit")


def require_llvm() -> None:
    """Raise `ResourceError` if the LLVM variant cannot run here."""
    if find_llvm() is None:
        raise ResourceError(
            "no LLVM library was found, and the identity pass needs one",
            expected=f"libLLVM 19 or newer in {Path(sys.prefix) / 'lib'} or at DRJIT_LIBLLVM_PATH",
            hint="pip install karellen-llvm-core; `forestgen doctor` shows what is found",
        )
