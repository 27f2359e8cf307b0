"""Mitsuba's variants, made ready once. Nothing else in forestgen imports Mitsuba at module level.

The LLVM variant, or where it is asked for the CUDA one, traces identity and light paths (no code per instance or
material); the scalar variant traces what needs Mitsuba's own integrators: exact clouds, light meters, charts. All need
Dr.Jit, whose LLVM back end needs libLLVM >= 19: the wheel `karellen-llvm-core` ships one in the environment's lib/, and
DRJIT_LIBLLVM_PATH must name it before Dr.Jit is first imported.
"""

from __future__ import annotations

import importlib
import os
import sys
import sysconfig
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from forestgen.core.errors import ResourceError
from forestgen.core.processes import uninterrupted
from forestgen.render.cuda import cuda_devices

SCALAR = "scalar_rgb"
LLVM = "llvm_ad_rgb"
CUDA = "cuda_ad_rgb"
TRACING_ENVIRONMENT = "FORESTGEN_TRACING"  # llvm (the default) or cuda
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
    """The `mitsuba` module, prepared; enter `using` before building anything with it.

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
        # Each change of variant transforms a few functions of Mitsuba's again: a long batch passes the limit of 1,000.
        warnings.filterwarnings("ignore", "The AST-transforming decorator @drjit.syntax", RuntimeWarning)
        module.set_log_level(module.LogLevel.Error)
        _ready["mitsuba"] = module
    if threads is not None:
        drjit().set_thread_count(threads)
    return _ready["mitsuba"]


@contextmanager
def using(variant: str) -> Iterator[Any]:
    """The `mitsuba` module in a variant, which stays the current one afterwards.

    Mitsuba's own context changes back, and each change takes 0.1 s: its integrators in Python are loaded anew.
    """
    mi = mitsuba()
    if mi.variant() != variant:
        mi.set_variant(variant)
    yield mi


def drjit() -> Any:
    """The `drjit` module, after LLVM's place is known."""
    if "mitsuba" not in _ready:
        mitsuba()
    return importlib.import_module("drjit")


def tracing_variant() -> str:
    """The variant that traces identity and light paths: LLVM, or what the environment variable FORESTGEN_TRACING names.

    Both run the same code. Their ids differ in samples that lie within rounding error of an edge: so one machine with
    a GPU and one without would write different bytes, and CUDA is never chosen by itself.
    """
    named = os.environ.get(TRACING_ENVIRONMENT, "llvm").lower()
    variants = {"llvm": LLVM, "cuda": CUDA}
    if named not in variants:
        raise ResourceError(
            f"the environment variable {TRACING_ENVIRONMENT} names no device to trace on",
            expected=" or ".join(variants),
            got=named,
        )
    return variants[named]


@contextmanager
def tracing_on(device: str | None) -> Iterator[None]:
    """In the block, and in worker processes that it starts, trace rays on ``llvm`` or ``cuda``; None: no change."""
    if device is None:
        yield
        return
    before = os.environ.get(TRACING_ENVIRONMENT)
    os.environ[TRACING_ENVIRONMENT] = device
    try:
        yield
    finally:
        if before is None:
            os.environ.pop(TRACING_ENVIRONMENT, None)
        else:
            os.environ[TRACING_ENVIRONMENT] = before


def require(variant: str) -> None:
    """Raise `ResourceError` if a tracing variant cannot run here."""
    if variant == LLVM:
        require_llvm()
        return

    try:
        cuda_devices()
    except RuntimeError as error:
        raise ResourceError(
            f"rays were to be traced on CUDA, and there is {error}",
            expected="an NVIDIA driver and device",
            hint=f"unset {TRACING_ENVIRONMENT} to trace on the processor; `forestgen doctor` shows what is found",
        ) from error


def require_llvm() -> None:
    """Raise `ResourceError` if the LLVM variant cannot run here."""
    if find_llvm() is None:
        raise ResourceError(
            "no LLVM library was found, and tracing rays needs one",
            expected=f"libLLVM 19 or newer in {Path(sys.prefix) / 'lib'} or at DRJIT_LIBLLVM_PATH",
            hint="pip install karellen-llvm-core; `forestgen doctor` shows what is found",
        )
