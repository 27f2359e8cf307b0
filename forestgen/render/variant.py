"""Mitsuba and its variants, made ready once; no other module imports Mitsuba at its top.

The LLVM variant, or the CUDA one on request, traces identity and light paths without code for each instance or
material. The scalar variant runs Mitsuba's own integrators: exact clouds, light meters, charts. All need Dr.Jit, whose
LLVM back end needs libLLVM >= 19: the wheel `karellen-llvm-core` ships one in the environment's lib/, and
DRJIT_LIBLLVM_PATH must name it before Dr.Jit is first imported.

The constants at the top set how light paths are spent: they change the noise or the time of an image, not its mean. A
benchmark of efficiency, 1 / (variance x CPU seconds), can tune them together.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import importlib
import os
import sys
import sysconfig
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.core.errors import RenderError, ResourceError
from forestgen.core.processes import uninterrupted

SAMPLER = "multijitter"  # of Mitsuba's sensors: stratified over a pixel and a path's first choices
ROULETTE_DEPTH = 2  # scatterings before a path may end by chance
SKY_BESIDE_SUN_WEIGHT = 0.0  # share of light samples that go to a clear sky, against the sun's 1: it is found by chance
CLOUD_ROULETTE_DEPTH = 4096  # earlier, a few long paths carry the light: of a cloud 100 deep, from 64 on, a third of it
SLICES = 2  # replicates of an image, at least: the larger a stratified slice, the less noise
MOST_SLICE_SAMPLES = 32  # of a replicate's pass, a pixel: how far apart are the places where work can stop
SCALAR = "scalar_rgb"
LLVM = "llvm_ad_rgb"
CUDA = "cuda_ad_rgb"
TRACING_ENVIRONMENT = "FORESTGEN_TRACING"  # llvm (the default) or cuda
# Pixels along a render block's side, for every integrator. Each block has a random stream of its own, and unless it is
# given a size, Mitsuba halves it until every thread has a block: the image would depend on the number of cores.
BLOCK_PX = 16
_ready: dict[str, Any] = {}


def cuda_devices() -> str:
    """Names of the devices by the driver: Dr.Jit would log an error without one. RuntimeError: no driver or device."""
    path = ctypes.util.find_library("cuda")
    if path is None:
        raise RuntimeError("no CUDA driver")
    driver = ctypes.CDLL(path)
    count = ctypes.c_int(0)
    if driver.cuInit(0) != 0 or driver.cuDeviceGetCount(ctypes.byref(count)) != 0 or count.value == 0:
        raise RuntimeError("a CUDA driver, but no device")
    names = []
    for number in range(count.value):
        device, name = ctypes.c_int(0), ctypes.create_string_buffer(256)
        known = driver.cuDeviceGet(ctypes.byref(device), number) == 0
        known = known and driver.cuDeviceGetName(name, len(name), device) == 0
        names.append(name.value.decode(errors="replace") if known else "unknown")
    return ", ".join(names)


def find_llvm() -> Path | None:
    """libLLVM of the environment's wheel, or the one that DRJIT_LIBLLVM_PATH names; None if there is neither."""
    named = os.environ.get("DRJIT_LIBLLVM_PATH")
    if named and Path(named).is_file():
        return Path(named)
    folders = {Path(sys.prefix) / "lib", Path(sysconfig.get_path("data")) / "lib"}
    candidates = [library for folder in folders for library in folder.glob("libLLVM*.so*") if library.is_file()]
    return max(candidates, default=None)


class _NoPythonIntegrators:
    """Leaves out Mitsuba's integrators in Python, which it loads anew with each change of variant, for 0.25 s.

    They are those of inverse rendering, such as `prb`, and nothing here uses them.
    """

    @staticmethod
    def find_spec(name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        is_theirs = name == "mitsuba.python.ad.integrators"
        return ModuleSpec(name, _NoPythonIntegrators, is_package=True) if is_theirs else None  # type: ignore[arg-type]

    @staticmethod
    def create_module(spec: ModuleSpec) -> None:
        """As usual."""

    @staticmethod
    def exec_module(module: ModuleType) -> None:
        """It stays empty."""


def mitsuba(threads: int | None = None) -> Any:
    """The `mitsuba` module, prepared; enter `using` before building anything with it.

    `threads` is the size of the renderer's thread pool; None keeps the current one (at first: all cores).
    Raises `ResourceError` in a process that was forked from one that has rendered: it would wait for ever.
    """
    if _ready.get("process", os.getpid()) != os.getpid():
        problem = "this process was forked from one that has rendered, and lacks the threads of its renderer"
        hint = "multiprocessing.get_context('spawn') starts one anew; `recipe.batch` has workers of its own"
        raise ResourceError(problem, expected="a process that was started, or forked before the first image", hint=hint)
    if "mitsuba" not in _ready:
        library = find_llvm()
        if library is not None:
            os.environ["DRJIT_LIBLLVM_PATH"] = str(library)
        sys.meta_path.insert(0, _NoPythonIntegrators)
        with uninterrupted():
            module: Any = importlib.import_module("mitsuba")
            module.set_variant(SCALAR)
        module.set_log_level(module.LogLevel.Error)
        _ready["mitsuba"] = module
    if threads is not None:
        drjit().set_thread_count(threads)
    return _ready["mitsuba"]


@contextmanager
def using(variant: str) -> Iterator[Any]:
    """The `mitsuba` module in a variant, which stays the current one afterwards.

    Mitsuba's own context changes back when it ends.
    """
    if mi.variant() != variant:
        mi.set_variant(variant)
    _ready["process"] = os.getpid()
    yield mi


def drjit() -> Any:
    """The `drjit` module, after LLVM's place is known."""
    mitsuba()
    return importlib.import_module("drjit")


class _Lazy:
    """A module that is loaded when it is first used."""

    def __init__(self, load: Callable[[], Any]) -> None:
        self._load = load

    def __getattr__(self, name: str) -> Any:
        return getattr(self._load(), name)


mi: Any = _Lazy(mitsuba)
dr: Any = _Lazy(drjit)


def on_device(kind: Any, values: NDArray[Any]) -> Any:
    """A copy of `values`, flat, as `mi.Float`, `mi.UInt32` or `mi.Bool`, for arrays that kernels read in order.

    Dr.Jit would borrow NumPy's memory, which begins anywhere, and it compiles a kernel again where other arrays than
    before begin at multiples of 32 bytes: a second for the light paths, in half of all images.
    """
    number: Any = {mi.UInt32: np.uint32, mi.Bool: np.bool_}.get(kind, np.float32)
    flat = np.asarray(values, dtype=number).ravel()
    memory = np.empty(flat.size + 64, flat.dtype)
    first = -memory.ctypes.data % 64 // flat.itemsize
    aligned = memory[first : first + flat.size]
    aligned[:] = flat
    return kind(aligned)


def tracing_variant() -> str:
    """The variant that traces identity and light paths: LLVM, or what the environment variable FORESTGEN_TRACING names.

    Both run the same code. Their ids differ in samples that lie within rounding error of an edge: so one machine with
    a GPU and one without would write different bytes, and CUDA is never chosen by itself.
    """
    named = os.environ.get(TRACING_ENVIRONMENT, "llvm").lower()
    variants = {"llvm": LLVM, "cuda": CUDA}
    if named not in variants:
        problem = f"the environment variable {TRACING_ENVIRONMENT} names no device to trace on"
        raise ResourceError(problem, expected=" or ".join(variants), got=named)
    return variants[named]


@contextmanager
def tracing_on(device: str | None) -> Iterator[None]:
    """In the block, and in worker processes that it starts, trace rays on ``llvm`` or ``cuda``; None: no change."""
    before = os.environ.get(TRACING_ENVIRONMENT)
    if device is not None:
        os.environ[TRACING_ENVIRONMENT] = device
    try:
        yield
    finally:
        if device is not None:
            os.environ.pop(TRACING_ENVIRONMENT)
            if before is not None:
                os.environ[TRACING_ENVIRONMENT] = before


def require(variant: str) -> None:
    """Raise `ResourceError` if a tracing variant cannot run here."""
    if variant == LLVM:
        if find_llvm() is None:
            expected = f"libLLVM 19 or newer in {Path(sys.prefix) / 'lib'} or at DRJIT_LIBLLVM_PATH"
            hint = "pip install karellen-llvm-core; `forestgen doctor` shows what is found"
            raise ResourceError("no LLVM library was found, and tracing rays needs one", expected=expected, hint=hint)
        return
    try:
        cuda_devices()
    except RuntimeError as error:
        problem = f"rays were to be traced on CUDA, and there is {error}"
        hint = f"use `device='llvm'` or {TRACING_ENVIRONMENT}=llvm, the processor; `forestgen doctor` shows more"
        raise ResourceError(problem, expected="an NVIDIA driver and device", hint=hint) from error


@contextmanager
def renderer_errors() -> Iterator[None]:
    """The renderer's and Dr.Jit's own errors as `RenderError`, and as `MemoryError` where they ran out of memory."""
    try:
        yield
    except RuntimeError as error:
        if "out of memory" in str(error).lower():
            raise MemoryError(str(error)) from error
        raise RenderError(f"Mitsuba stopped: {error}") from error


def interruptible(integrator: Any, scene: Any, sensor: Any, seed: int, samples: int) -> NDArray[np.float32]:
    """(H, W, C) scalar image; Ctrl-C stops it in a fraction of a second. `RenderError` or `MemoryError`: it failed."""

    def work() -> NDArray[np.float32]:
        mi.set_variant(SCALAR)
        return np.array(integrator.render(scene, sensor=sensor, seed=seed, spp=samples))

    with ThreadPoolExecutor(1, "forestgen-render") as pool:
        image = pool.submit(work)
        try:
            while not wait([image], timeout=0.05).done:
                pass
        except BaseException:
            integrator.cancel()
            raise
    try:
        return image.result()
    except MemoryError:
        raise
    except Exception as error:
        raise RenderError(f"Mitsuba stopped: {error}") from error


def check_scalar() -> str:
    """Trace one ray in the scalar variant; what was used."""
    with mi.variant_context(SCALAR):
        scene = mi.load_dict({"type": "scene", "shape": {"type": "sphere"}})
        hit = scene.ray_intersect_preliminary(mi.Ray3f([0, 0, -5], [0, 0, 1]))
        if abs(hit.t - 4.0) > 1e-4:
            raise RuntimeError(f"a ray that should travel 4 m travels {hit.t} m")
        return f"works, {dr.thread_count()} threads"


def check_llvm() -> str:
    """Compile and run a kernel in the LLVM variant."""
    library = find_llvm()
    if library is None:
        raise RuntimeError("no libLLVM found")
    with mi.variant_context(LLVM):
        total = dr.sum(dr.arange(mi.Float, 100))[0]
        if total != 4950:
            raise RuntimeError(f"the sum of 0 to 99 came out as {total}")
    return f"works, {library}"


def path_tracer(kind: str, max_depth: int, **more: Any) -> Any:
    """A path tracer of Mitsuba's, with the settings of all images."""
    settings = {"type": kind, "max_depth": max_depth, "rr_depth": ROULETTE_DEPTH, "block_size": BLOCK_PX}
    return mi.load_dict(settings | more)
