"""Which variant traces identity."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from forestgen.core.errors import ResourceError
from forestgen.render import variant
from forestgen.render.variant import CUDA, LLVM, TRACING_ENVIRONMENT, dr, mi, on_device, require, tracing_variant, using
from support.error_messages import raises_error


@pytest.mark.parametrize(("named", "variant"), [(None, LLVM), ("llvm", LLVM), ("cuda", CUDA), ("CUDA", CUDA)])
def test_the_environment_chooses(monkeypatch, named, variant):
    monkeypatch.delenv(TRACING_ENVIRONMENT, raising=False)
    if named is not None:
        monkeypatch.setenv(TRACING_ENVIRONMENT, named)
    assert tracing_variant() == variant


def test_a_device_that_nobody_knows_is_refused(monkeypatch):
    monkeypatch.setenv(TRACING_ENVIRONMENT, "abacus")
    with raises_error(ResourceError):
        tracing_variant()


def test_cuda_without_a_device_is_refused_with_the_way_out(monkeypatch):
    def none() -> str:
        raise RuntimeError("no CUDA driver")

    monkeypatch.setattr(variant, "cuda_devices", none)
    with raises_error(ResourceError):
        require(CUDA)
    require(LLVM)


def test_a_process_that_was_forked_after_an_image_is_refused(monkeypatch):
    """Its renderer would wait for threads that the fork has not copied."""
    monkeypatch.setitem(variant._ready, "process", -1)
    with raises_error(ResourceError):
        variant.mitsuba()


def test_one_kernel_serves_arrays_from_any_place():
    """Dr.Jit's own conversion would compile two: for memory that begins at a multiple of 32 bytes, and elsewhere."""
    with using(LLVM), dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        for shift in range(8):
            values = np.arange(64.0 + shift, dtype=np.float32)[shift:]
            doubled = on_device(mi.Float, values) * 2.0
            np.testing.assert_array_equal(np.array(doubled), values * 2)
        assert len({one["hash"] for one in dr.kernel_history() if one["type"] == dr.KernelType.JIT}) == 1


def test_a_change_of_variant_loads_no_integrators():
    with using("llvm_ad_spectral"):
        pass
    with using(LLVM):
        assert not hasattr(sys.modules["mitsuba.python.ad.integrators"], "prb")
